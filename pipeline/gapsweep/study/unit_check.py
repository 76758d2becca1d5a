"""Warnings of probable unit errors, of laws that all motions leave, and of untouched walls."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.model.contact import ContactLaw
from gapsweep.model.doubts import doubts
from gapsweep.model.labels import EXACT, Representation
from gapsweep.model.oscillator import Gap
from gapsweep.model.table import ForceTable
from gapsweep.status import Status
from gapsweep.study.grid import START, starts_of
from gapsweep.study.study import Study

_IN_CASE = ("representation", "omega", START)  # dimensions within a parameter set
_SAMPLED = (4096, 256, 16, 1)  # few points show for most parameter sets that walls may be reached
_MOST, _MOST_MODELS = 100_000, 10_000  # points with a bound, and their models: some seconds


def never_reached(
    values: Callable[[str], Any],
    dims: Sequence[str],
    labels: Sequence[str],
    *,
    in_metres: bool = True,
) -> str:
    """Sentence on cases in which no steady response of the exact law touches a wall.

    It is empty if there are fewer of them than of others.

    `values`: from the name of a variable of ``responses.nc`` to its values.
    `dims` and `labels`: dimensions of a sweep point, and representations: all count if the exact
    law is not swept.
    `in_metres`: whether the model is an oscillator; the displacements of a system are those at its
    contacts.
    """
    rows = [labels.index(EXACT)] if EXACT in labels else list(range(len(labels)))
    # Impacts on rigid walls take no time; a motion that stays on a wall has no contacts.
    names = ["contacts_per_period", "contact_share", "x_max", "x_min"]
    if not in_metres and np.size(values("contact_x_max")):  # there with several parts only
        names[2:] = "contact_x_max", "contact_x_min"
    n_contacts, share, x_max, x_min = (np.asarray(values(name)) for name in names)
    if not share.size:  # the file cannot be read
        return ""
    within = tuple(i for i, dim in enumerate(dims) if dim in _IN_CASE)
    reach = np.maximum(x_max[rows], -x_min[rows])
    # Largest values over contacts.
    reach, share = (
        each.reshape(*each.shape[: len(dims)], -1).max(axis=-1) for each in (reach, share[rows])
    )
    known = np.isfinite(reach)
    n_cases = np.count_nonzero(known.any(within))
    never = known.any(within) & ~((share > 0.0) | (n_contacts[rows] > 0.0)).any(within)
    if not never.any() or 2 * never.sum() < n_cases:  # few such cases are no sign of wrong units
        return ""
    factor, unit = (1e3, " mm") if in_metres else (1.0, "")
    largest = factor * reach.max(within, initial=0.0, where=known)[never].max()
    where, gap = f" in {never.sum()} of {n_cases} cases", ""
    if never.sum() == n_cases:
        where = ""
        if in_metres:  # contacts of a system may have other gaps
            nearest = factor * min(np.min(values(name)) for name in ("j_1", "j_2"))
            gap = f", gap {nearest:.3g} mm"
    units = "metres" if in_metres else "the unit of the coordinates"
    return (
        f"the wall is never reached{where}: |x| at most {largest:.3g}{unit}{gap}; gaps are in "
        f"{units}, frequencies in hertz, and zeta = 0.02 is 2 %"
    )


def _out_of_range(status: NDArray[Any], labels: Sequence[Representation]) -> Iterator[str]:
    """Yield a sentence for each representation of which all points left the range of its law."""
    for label, some in zip(labels, status, strict=False):  # none if the file cannot be read
        n = np.count_nonzero(some != Status.NOT_REQUESTED)
        if 0 < n == np.count_nonzero(some == Status.OUT_OF_FIT_RANGE):
            remedy = "increase range in [approximation]" if label.is_fitted else "extend its table"
            yield f"{label}: all {n} points leave its range (out_of_fit_range); {remedy}"


def bounded(study: Study) -> str:
    """Sentence of `never_reached` before a run, from the bounds of `advise`.

    It is empty for unforced systems, or if bounds of more than 100,000 points or 10,000 models
    would be needed.
    """
    grid = study.grid
    models = [len(axis) for name, axis in grid.axes.items() if name in study.spec.model]
    if not _may_be_reached(study) or math.prod(models) > _MOST_MODELS:
        return ""
    asked = grid.requested.any(axis=0)
    is_within = [dim in _IN_CASE for dim in grid.dims[1:]]
    shape = [1 if inside else n for inside, n in zip(is_within, asked.shape, strict=True)]
    bound, n_left = np.full(shape, np.nan), _MOST  # largest of each parameter set
    for step in _SAMPLED:
        wanted = (asked & ~np.isinf(bound)).ravel()[::step]
        n_left -= int(np.count_nonzero(wanted))
        if n_left < 0:
            return ""
        cells = step * np.flatnonzero(wanted)
        at = np.unravel_index(cells, asked.shape)
        case = tuple(0 * i if inside else i for inside, i in zip(is_within, at, strict=True))
        np.fmax.at(bound, case, study.advice(cells).bound.max(axis=1))
    may_reach = np.isinf(bound)
    known = np.where(may_reach, 0.0, bound)
    found = {"contacts_per_period": may_reach, "contact_share": may_reach}
    found |= {"x_max": known, "x_min": -known}
    found |= {f"contact_{name}": found[name] for name in ("x_max", "x_min")}
    values = grid.coordinates() | {name: some[None] for name, some in found.items()}
    in_metres = study.model.is_oscillator
    return never_reached(values.__getitem__, grid.dims, [EXACT], in_metres=in_metres)


def _may_be_reached(study: Study) -> bool:
    """Whether a wall that no motion reaches is a surprise: the model is forced, with contacts."""
    return study.model.default.is_forced and bool(study.model.contacts)


def doubts_of(study: Study, far: str = "", own: bool = True) -> Iterator[str]:
    """Warnings of numbers of a study that are probably in another unit, by the rules of calls.

    A sentence `far` on walls that are not reached comes last. User functions of contact laws, which
    may never return, are not called; without `own` user functions of systems are not called either,
    and such systems have no warnings.
    """
    grid, model = study.grid, study.model
    axes = {name: grid.axes[name] for name in study.spec.model if name in grid.axes}
    if not own and study.spec.system and study.spec.system.user_function:
        return
    ends = product(*({min(axis), max(axis)} for axis in axes.values()))
    points = [dict(zip(axes, end, strict=True)) for end in ends]  # bound the rules of oscillators
    if not model.is_oscillator:
        points = [*model.swept(grid.axes, grid.requested)] or [{}]
    ratio, K_c = max(grid.axes.get("K_ratio", (1.0,))), grid.axes.get("K_c", (0.0,))
    gaps = grid.gaps if {"gap", "j_1"} & grid.axes.keys() else (Gap(0.0, 0.0),)
    laws = []
    for label, gap, stiffness in product(grid.representations, gaps, {min(K_c), max(K_c)}):
        with suppress(ModelError):  # an invalid law is reported at its use
            laws.append(tuple(_laws(study, label, stiffness, gap, ratio, own)))
    omega, starts = grid.axes.get("omega", 0.0), starts_of(grid.axes).states
    yield from doubts([model.at(some) for some in points], laws, omega, starts) if laws else ()
    yield from _doubts_of_factors(study)
    yield from [far] * bool(far)


def _doubts_of_factors(study: Study) -> Iterator[str]:
    """Warnings of uncertain factors of a nominal value that are probably values themselves."""
    for name, table in study.spec.uncertain.tables.items() if study.spec.uncertain else ():
        factor = float(table.distribution.ppf(0.5)) if table.nominal == "times" else 1.0
        if not 0.5 <= factor <= 2.0:
            yield (
                f"uncertain.{name}: the median of the factors is {factor:g}; leave out nominal = "
                f"'times' if these are values of {name}"
            )


def doubts_of_run(study: Study, values: Callable[[str], Any]) -> Iterator[str]:
    """Warnings of `doubts_of`, and of results: walls not reached, laws that all motions leave.

    `values` is as for `never_reached`.
    """
    grid = study.grid
    far = ""
    if _may_be_reached(study):
        in_metres = study.model.is_oscillator
        far = never_reached(values, grid.dims, grid.representations, in_metres=in_metres)
    yield from doubts_of(study, far)
    yield from _out_of_range(values("status"), grid.representations)


def _laws(
    study: Study, swept: Representation, K_c: float, gap: Gap, ratio: float, own: bool
) -> Iterator[ContactLaw]:
    """The laws of all contacts; the exact law in place of fits and of user functions."""
    for name, one in zip(study.model.contacts, study.model.laws(swept.law), strict=True):
        given: dict[str, Any] = {"K_c": K_c, "gap": (gap.j_1, gap.j_2), "K_ratio": ratio}
        if name in study.spec.contact:
            given |= study.spec.contact[name].model_dump(exclude_none=True)
        law = study.own_law(one)  # its module has been imported in another process before
        source = law and (law.load() if own else law.source)
        is_code = law is not None and not isinstance(source, ForceTable)
        is_exact = one.is_auto or one.is_fitted or is_code
        walls = Gap(*given["gap"])
        yield study.law(EXACT if is_exact else one, given["K_c"], walls, given["K_ratio"])
