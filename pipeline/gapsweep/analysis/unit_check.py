"""Which cases of a study (stiffness, gap and further parameters) touch no wall."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from gapsweep.errors import ModelError
from gapsweep.model.labels import EXACT
from gapsweep.model.table import ForceTable
from gapsweep.study.grid import START

if TYPE_CHECKING:
    from gapsweep.study.study import Study

_IN_CASE = ("representation", "omega", START)  # all other dimensions are of cases
_FAST, _SOFT = 30.0, 1e-3  # times the natural frequency, and the stiffness of the spring
_FAR = 10.0  # times the amplitude of the linear resonance
_NAMES = ("zeta", "omega_n", "mass", "forcing", "mean_load", "omega", "K_c", "wall")
_SAMPLED = 16  # every so many points of a study show for most cases that a wall may be reached


def never_reached(values: Callable[[str], Any], dims: Sequence[str], labels: Sequence[str]) -> str:
    """In which cases the exact law touches no wall, as one sentence; empty if in none.

    Parameters
    ----------
    values : callable
        From the name of a variable of ``responses.nc`` to its values.
    dims, labels : sequence of str
        Dimensions of a sweep point, and representations: all count if the exact law is not swept.
    """
    rows = [labels.index(EXACT)] if EXACT in labels else list(range(len(labels)))
    contacts, x_max, x_min = (np.asarray(values(n)) for n in ("n_contacts", "x_max", "x_min"))
    if not contacts.size:  # the file cannot be read
        return ""
    within = tuple(i for i, dim in enumerate(dims) if dim in _IN_CASE)
    reach = np.maximum(x_max[rows], -x_min[rows])
    known = np.isfinite(reach)
    n_cases = np.count_nonzero(known.any(within))
    never = known.any(within) & ~contacts[rows].any(within)
    if not never.any():
        return ""
    largest = 1e3 * reach.max(within, initial=0.0, where=known)[never].max()
    where, gap = f" in {never.sum()} of {n_cases} cases", ""
    if never.sum() == n_cases:
        nearest = 1e3 * min(np.min(values(name)) for name in ("j_1", "j_2"))
        where, gap = "", f", gap {nearest:.3g} mm"
    return (
        f"the wall is never reached{where}: |x| at most {largest:.3g} mm{gap}; gaps are in metres, "
        "frequencies in hertz, and zeta = 0.02 is 2 %"
    )


def bounded(study: "Study") -> str:
    """The same of a study of oscillators before it is run, from the bounds of `advise`."""
    grid = study.grid
    asked = grid.requested.any(axis=0)
    within = tuple(i for i, dim in enumerate(grid.dims[1:]) if dim in _IN_CASE)
    bound = np.full(asked.shape, np.nan)
    for step in (_SAMPLED, 1):
        may_reach = np.isinf(bound).any(within, keepdims=True)
        cells = np.flatnonzero(asked & ~may_reach)[::step]
        bound.flat[cells] = [one.bound for one in study.advice(cells)]
    found = {"n_contacts": np.isinf(bound), "x_max": bound, "x_min": -bound}
    values = grid.coordinates() | {name: some[None] for name, some in found.items()}
    return never_reached(values.__getitem__, grid.dims, [EXACT])


def doubtful_numbers(values: Mapping[str, Any]) -> Iterator[str]:
    """Warnings of numbers of a study that are probably in another unit.

    Parameters
    ----------
    values : mapping of str to number or array
        Parameters of the oscillator, and `omega`, `K_c` and `wall` (distances of the nearer walls
        [m]), where a study has them.
    """
    numbers = {name: np.asarray(values[name], float) for name in _NAMES if name in values}
    largest = {name: float(each.max()) for name, each in numbers.items() if each.size}
    least = {name: float(each.min()) for name, each in numbers.items() if each.size}
    if largest["zeta"] >= 1.0:
        yield (
            f"zeta = {largest['zeta']:g}: the oscillator is overdamped; zeta is a ratio, and 0.02 "
            "is 2 %"
        )
    natural = largest["omega_n"]
    if natural and largest.get("omega", 0.0) > _FAST * natural:
        yield (
            f"omega = {largest['omega']:g} Hz: more than {_FAST:g} times the natural frequency "
            f"omega_n = {natural:g} Hz; frequencies are in hertz, not in rad/s"
        )
    spring = least["mass"] * (2.0 * np.pi * least["omega_n"]) ** 2
    if 0.0 < largest.get("K_c", 0.0) < _SOFT * spring:
        yield (
            f"K_c = {largest['K_c']:g} N/m: less than {_SOFT:g} of the spring's stiffness "
            f"m (2π omega_n)² = {spring:.3g} N/m; K_c is in N/m"
        )
    if spring and least["zeta"] and "wall" in least:
        load = largest["forcing"] / (2.0 * least["zeta"]) + abs(largest["mean_load"])
        if 0.0 < _FAR * load / spring < least["wall"]:
            yield (
                f"gap = {least['wall']:g} m: more than {_FAR:g} times the amplitude of the linear "
                f"resonance, {load / spring:.2g} m; gaps are in metres"
            )


def wrong_tables(study: "Study") -> Iterator[str]:
    """Warnings of force tables in another unit than the walls, and of noise around zero."""
    walls = [wall for gap in study.grid.gaps for wall in (gap.j_1, gap.j_2) if wall]
    for label in study.own_laws:
        with suppress(ModelError):  # of a law that cannot be used: reported where it is used
            own = study.own_law(label)
            table = own and own.load()
            if isinstance(table, ForceTable):
                yield from (f"{label}: {doubt}" for doubt in _doubts_of_table(table, walls))


def _doubts_of_table(table: ForceTable, walls: Sequence[float]) -> Iterator[str]:
    ends = [abs(end) for end in table.valid_range if end]
    if walls and (max(ends) < min(walls) or min(ends) > 1e3 * max(walls)):
        yield (
            f"the force table reaches x = {max(ends):g}, the walls of the study are at "
            f"{min(walls):g} to {max(walls):g}: give both in metres"
        )
    force = np.array(table.F)
    (changes,) = np.nonzero(force[1:] * force[:-1] < 0.0)
    if changes.size > 2:  # a restoring force changes its sign at most once
        noise = 1.05 * np.abs(force[changes[0] + 1 : changes[-1] + 1]).max()
        yield (
            f"the force changes its sign {changes.size} times near x = 0: measurement noise acts "
            f"as stiffness there; write gs.ForceTable(x, F, noise={noise:.2g}) to set it to zero"
        )
