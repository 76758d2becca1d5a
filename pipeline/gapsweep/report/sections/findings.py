"""The main findings of a run, in sentences computed from its datasets."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.dimensions import REPRESENTATION, of_oscillator
from gapsweep.model.labels import EXACT
from gapsweep.report.drawing import labels_of
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Part
from gapsweep.report.scales import drawn, shown_unit
from gapsweep.report.tables import tally
from gapsweep.report.verdicts import COLUMNS, Contact
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status
from gapsweep.study.grid import CONTACT, START
from gapsweep.study.points import FIXED
from gapsweep.study.spec import check
from gapsweep.study.study import Study
from gapsweep.study.unit_check import doubts_of, never_reached
from gapsweep.variables import flags_of


def sections(inputs: Inputs) -> Iterator[Part]:
    """The main findings of a run, in sentences."""
    responses = inputs.responses
    # First, because without contacts all other findings are about the linear system.
    far = unreached_walls(responses)
    sentences = [*_doubtful(responses), *filter(None, [far])]
    sentences += [outcomes(responses), _tried(responses)]
    sentences += _along(responses)
    sentences += _touching(responses)
    if inputs.attractors is not None:
        sentences += _coexisting(inputs.attractors)
    sentences += counted(inputs.cases)
    if inputs.advice is not None:
        sentences.append(_choices(inputs.advice))
    if inputs.claims is not None:
        counts = inputs.claims["counts"]
        sentences.append(f"{sum(counts.values())} claims: {tally(counts)}.")
    yield Part("findings", "Findings", sentences)


def _doubtful(responses: xr.Dataset) -> list[str]:
    """Warnings of numbers of a study that probably have a wrong unit or sign.

    User code is not called; a study with a user function of systems has no warnings.
    """
    tables = json.loads(responses.attrs.get("study_json", "{}"))
    if not tables:
        return []
    study = Study(check(tables))
    return [f"{each[0].upper()}{each[1:]}." for each in doubts_of(study, own=False)]


_CURVE = 10  # values that make a curve
_LISTED = 3  # intervals of it that are listed


def unreached_walls(responses: xr.Dataset) -> str:
    """Sentence on cases or contacts in which no motion reaches a wall; empty if all do."""
    if of_oscillator(responses):
        dims = [str(dim) for dim in responses["status"].dims]
        sentence = never_reached(lambda name: responses[name].values, dims, labels_of(responses))
        return f"{sentence[0].upper()}{sentence[1:]}." if sentence else ""
    if "contact_share" not in responses:
        return ""
    share, ends = responses["contact_share"], abs(responses[["x_min", "x_max"]]).to_dataarray()
    is_touched = _touched(responses).any([dim for dim in share.dims if dim != CONTACT]).values
    largest = float(ends.where(np.isfinite(ends)).max())
    if is_touched.all() or not share.notnull().any() or not largest > 0.0:
        return ""
    names = responses[CONTACT].values[~is_touched] if CONTACT in responses.dims else ()
    of = f" of {', '.join(names)}" if len(names) else ""
    return (
        f"No steady motion reaches a wall{of}: the largest coordinate is {largest:.3g}; gaps are "
        "in the unit of the coordinates."
    )


def _touched(responses: xr.Dataset) -> xr.DataArray:
    """Whether each response touches a wall, of each contact of a system."""
    # Impacts on rigid walls take no time; their largest force is stored as NaN.
    meets = responses["force_max"].isnull() & (responses["contacts_per_period"] > 0.0)
    return (responses["contact_share"] > 0.0) | meets


_OF_SYSTEMS = {
    ResponseClass.QUASIPERIODIC: "quasiperiodic",
    ResponseClass.EQUILIBRIUM: "in equilibrium",
}


def outcomes(responses: xr.Dataset) -> str:
    """Sentence with the counts of sweep points by class, and with reasons of failures."""
    status, kind = (responses[n].values for n in ("status", "response_class"))
    asked = status != Status.NOT_REQUESTED
    counts = Counter(kind[asked].tolist())
    why = Counter(status[asked & (kind == ResponseClass.FAILED)].tolist())
    reasons = ", ".join(f"{n} {Status(s).label.replace('_', ' ')}" for s, n in sorted(why.items()))
    left = (responses["status"] == Status.OUT_OF_FIT_RANGE) & (
        responses["response_class"] != ResponseClass.FAILED
    )
    others_than = [dim for dim in left.dims if dim != REPRESENTATION]
    of_laws = zip(labels_of(responses), left.sum(others_than).values, strict=True)
    n_left = Counter[bool]()
    for label, n in of_laws:
        n_left[label.is_own] += int(n)  # among user laws, only tables have ends
    beyond = "".join(
        f"; {n_left[is_table]} with a steady response beyond {words}"
        for is_table, words in ((False, "the range of their fit"), (True, "the table's ends"))
        if n_left[is_table]
    )
    others = "".join(
        f"{counts[kind]} {words}, " for kind, words in _OF_SYSTEMS.items() if counts[kind]
    )
    return (
        f"{asked.sum()} sweep points: {counts[ResponseClass.PERIODIC]} periodic, {others}"
        f"{counts[ResponseClass.CHAOTIC]} chaotic, {counts[ResponseClass.UNRESOLVED]} unresolved "
        f"and {counts[ResponseClass.FAILED]} without a steady response"
        f"{f' ({reasons})' if reasons else ''}"
        f"{beyond}."
    )


def _tried(responses: xr.Dataset) -> str:
    """Sentence on the number of initial conditions at a point, and on its limits."""
    n = int((responses["status"] != Status.NOT_REQUESTED).sum(START).max())
    several = "1 initial condition was" if n == 1 else f"At most {n} initial conditions were"
    remedy = " Sweeps do not show coexisting attractors: add states to initial_condition."
    more = "" if FIXED in responses["start"].values else remedy
    return f"{several} tried at a point; further attractors may exist.{more}"


def _along(responses: xr.Dataset) -> Iterator[str]:
    """Sentences on intervals with chaotic or quasiperiodic responses, or with equilibria.

    An interval has such responses from at least one initial condition. There are no sentences if
    a run sweeps several axes, or fewer than 10 values. They are of the exact law if it was
    computed, else of the first law.
    """
    kinds = responses["response_class"]
    long = [dim for dim in kinds.dims if kinds.sizes[dim] > 1]
    dims = [dim for dim in long if dim not in (REPRESENTATION, START)]
    if len(dims) != 1 or kinds.sizes[dims[0]] < _CURVE:
        return
    x, label = responses[dims[0]], _exact_if_swept(responses)
    of_law = kinds.sel(representation=label).transpose(dims[0], ...).values.reshape(x.size, -1)
    some = " from some initial conditions" if START in long else ""
    for kind in (ResponseClass.CHAOTIC, *_OF_SYSTEMS):
        ranges = _ranges((of_law == kind).any(axis=1), drawn(x))
        if ranges:
            words = _OF_SYSTEMS.get(kind, "chaotic")
            unit = shown_unit(x)[1]
            where = f"{x.name} [{unit}]" if unit else x.name
            yield f"{label} is {words}{some} at {where} {ranges}."


def _touching(responses: xr.Dataset) -> Iterator[str]:
    """Sentence on the responses that touch a wall, of the exact law if computed, and where."""
    if "contact_share" not in responses:
        return
    label = _exact_if_swept(responses)
    here = responses.sel(representation=label)
    is_touching = _touched(here)
    if CONTACT in is_touching.dims:
        is_touching = is_touching.any(CONTACT)
    n, n_all = int(is_touching.sum()), int((here["status"] != Status.NOT_REQUESTED).sum())
    if not n:
        return
    where = ""
    if is_touching.sizes.get("omega", 1) > 1:
        at = is_touching.any([dim for dim in is_touching.dims if dim != "omega"])
        where = f", at omega [Hz] {_ranges(at.values, responses['omega'].values)}"
    yield f"{label} touches a wall in {n} of {n_all} steady responses{where}."


def _ranges(is_so: NDArray[np.bool_], x: NDArray[np.float64]) -> str:
    """Return intervals of a grid on which a condition holds: the 3 widest, ascending, as text."""
    edges = np.flatnonzero(np.diff(is_so, prepend=False, append=False)).reshape(-1, 2) - (0, 1)
    widest = sorted(sorted(edges.tolist(), key=lambda edge: edge[0] - edge[1])[:_LISTED])
    words = [f"{x[a]:.4g}{f' to {x[b]:.4g}' if b > a else ''}" for a, b in widest]
    more = [f"{len(edges) - _LISTED} more"] if len(edges) > _LISTED else []
    *first, last = [*words, *more] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def _exact_if_swept(dataset: xr.Dataset) -> str:
    labels = labels_of(dataset)
    return EXACT if EXACT in labels else labels[0]


def _coexisting(attractors: xr.Dataset) -> Iterator[str]:
    """Sentence on the number of points with coexisting attractors, of the exact law if computed."""
    label = _exact_if_swept(attractors)
    n = attractors["n_attractors"].sel(representation=label).values
    n_places, n_several = int((n > 0).sum()), int((n > 1).sum())
    if n_several:
        kind = "parameter sets and frequencies" if "omega" in attractors.dims else "parameter sets"
        places = f"{n_several} of {n_places} {kind}"
        yield f"{label} has coexisting attractors at {places} with a result (up to {n.max()})."


def counted(found: Sequence[Contact]) -> Iterator[str]:
    """Counts of approximations by verdict; no cost, since costs differ from run to run."""
    laws = [one for contact in found for one in contact.laws if one.is_approximation]
    counts = Counter(one.column for one in laws)
    if laws:
        said = ", ".join(f"{counts[verdict]} {verdict}" for verdict in COLUMNS)
        yield f"{len(laws)} pair{'s' * (len(laws) > 1)} of case and approximation: {said}."
    costs = [one for one in laws if np.isfinite(one.cost_ratio)]
    if costs and all(np.isnan(one.low) for one in costs):
        yield (
            "Costs relative to the exact law are marked with ?: their repeatability is unknown. To "
            "measure it, add piecewise@half and [protocol] half = { rtol = 5e-10, atol = 5e-13 } "
            "to the study, with enough frequencies."
        )


def _choices(advice: xr.Dataset) -> str:
    """Sentence on the models that representation ``auto`` uses, with their counts."""
    names = flags_of(advice["model"])
    chosen, counts = np.unique(advice["model"].values, return_counts=True)
    parts = [f"{n} {names[m]}" for m, n in zip(chosen, counts, strict=True) if m >= 0]
    return (
        f"For an error of {advice.attrs['error']:g}, auto uses the simplest adequate model of "
        f"{counts[chosen >= 0].sum()} parameter sets and initial conditions: {', '.join(parts)}."
    )
