"""Which cases of a study (stiffness, gap and further parameters) touch no wall."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from gapsweep.errors import ModelError
from gapsweep.model.contact import ContactLaw
from gapsweep.model.doubts import doubts
from gapsweep.model.labels import AUTO, EXACT, is_fitted, law_of
from gapsweep.model.oscillator import Gap
from gapsweep.study.grid import START, starts_of

if TYPE_CHECKING:
    from gapsweep.study.study import Study

_IN_CASE = ("representation", "omega", START)  # all other dimensions are of cases
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


def doubts_of(study: "Study", own: bool = True) -> Iterator[str]:
    """Warnings of numbers of a study that are probably in another unit: the rules of calls.

    Parameters
    ----------
    own : bool
        Whether code of the user may be run: force tables and functions of systems.
    """
    grid, model = study.grid, study.model
    axes = {name: grid.axes[name] for name in study.spec.model if name in grid.axes}
    if model.is_oscillator:  # corners bound each rule
        ends = product(*({min(axis), max(axis)} for axis in axes.values()))
        points = [dict(zip(axes, end, strict=True)) for end in ends]
    elif own:
        points = model.swept(grid.axes, grid.requested)
    else:
        return
    ratio, K_c = max(grid.axes.get("K_ratio", (1.0,))), max(grid.axes.get("K_c", (0.0,)))
    laws = []
    for label in grid.representations:
        for gap in grid.gaps if {"gap", "j_1"} & grid.axes.keys() else (Gap(0.0, 0.0),):
            with suppress(ModelError):  # of a law that cannot be used: reported where it is used
                laws.append(tuple(_laws(study, label, K_c, gap, ratio, own)))
    models = [model.at(some) for some in points] or [model.default]
    if laws:
        yield from doubts(models, laws, grid.axes.get("omega", 0.0), starts_of(grid.axes).states)


def _laws(
    study: "Study", label: str, K_c: float, gap: Gap, ratio: float, own: bool
) -> Iterator[ContactLaw]:
    """The laws of all contacts; of fitted ones the exact law, whose numbers they have."""
    for name, one in zip(study.model.contacts, study.model.labels(law_of(label)), strict=True):
        table = study.spec.contact.get(name)
        stiffness = K_c if table is None or table.K_c is None else table.K_c
        walls = gap if table is None or table.gap is None else Gap(*table.gap)
        r = ratio if table is None or table.K_ratio is None else table.K_ratio
        is_exact = one == AUTO or is_fitted(one) or (":" in one and not own)
        yield study.law(EXACT if is_exact else one, stiffness, walls, r)


def with_far(study: "Study", far: str) -> list[str]:
    """Those warnings, with one of walls out of reach in place of that of the gap, if not empty."""
    said = (each for each in doubts_of(study) if not (far and each.startswith("gap")))
    return [*said, *filter(None, [far])]
