"""Tables of the report: rows of texts, from the datasets of a run."""

import warnings
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import xarray as xr

from gapsweep.analysis.agreement.metrics import BOUND
from gapsweep.analysis.dimensions import At, by_coordinate, scene_dims
from gapsweep.continuation.dataset import ATTRACTOR
from gapsweep.continuation.special import Special
from gapsweep.model.labels import EXACT, Representation
from gapsweep.report.branch_lines import (
    KINDS,
    REPRESENTATION,
    in_scene,
    of_orbits,
    of_scene,
    on_no_branch,
)
from gapsweep.report.branch_lines import label as of_axis
from gapsweep.report.parts import Table
from gapsweep.report.scales import drawn

_COUNTS = ("nfev", "n_steps", "n_rejected")
_MOST_ROWS = 40  # rows of special points
# Verdicts, the worst first.
VERDICTS = ("refuted", "partly", "confirmed", "undecidable")


def scene_tables(
    agreement: xr.Dataset | None,
    timing: xr.Dataset,
    labels: Sequence[str],
    over: str = "",
    apart: Sequence[tuple[str, At]] = (),
) -> list[Table]:
    """Tables of agreement with the exact law, if that was computed, and of cost.

    `agreement` and `timing`: one parameter set of the files of a run; several give medians without
    intervals.
    `labels`: representations computed there.
    `over`: added to the titles.
    `apart`: parameter sets, in words, whose agreement has separate rows.
    """
    labels = sorted(
        labels, key=lambda label: Representation(label).protocol != ""
    )  # laws first, then protocols
    tables = []
    if agreement is not None and agreement.attrs["reference"] in labels:
        for part, suffix in by_coordinate(agreement):
            rows = [
                [f"{law}{where}", *numbers]
                for where, at in apart or [("", {})]
                for law, *numbers in _agreement_rows(part.isel(at), labels)
            ]
            title = f"Agreement with the exact law{suffix}{'' if apart else over}"
            tables.append(Table(title, _AGREEMENT, rows, _OF_AGREEMENT))
    title = f"Cost per sweep point (medians over the points of each law){over}"
    notes = [
        _OF_COST,
        *([_OF_PROTOCOLS] if any(Representation(label).protocol for label in labels) else []),
    ]
    notes.append(f"Processor times were measured on {timing.attrs['measured_on'] or 'no machine'}.")
    tables.append(Table(title, _TIMING, list(_timing_rows(timing, labels)), notes))
    return [table for table in tables if table.rows]


def _agreement_rows(agreement: xr.Dataset, labels: list[str]) -> Iterator[list[str]]:
    """Rows of agreement per representation; the last is the exact law with other settings."""
    pooled = condensed(agreement[list(_SHOWN)].sel(regime="all").load())
    floors = str(agreement.attrs["floor_representations"]).split()
    for label in labels:
        if label not in (agreement.attrs["reference"], *floors):
            row = pooled.sel(representation=label)
            if row["n_points"].item() == 0:  # not swept there
                continue
            compared = f"{row['n_compared'].item()} of {row['n_points'].item()}"
            yield [label, *_agreement(row), compared]
    if floors and pooled["n_points"].sel(representation=floors).sum() > 0:
        yield ["exact law, other settings", *_agreement(pooled, floor="_floor"), ""]


_AGREEMENT = [
    "Representation",
    "Amplitude error, median (95 % interval)",
    "95th percentile",
    "Attractors found",
    "Attractors correct",
    "Same class",
    "Basin distance",
    "Points compared",
]
_OF_AGREEMENT = [
    "Amplitude error, for equal initial conditions: |A − A_exact| / max(A_exact, G/2). G is the "
    "width of the gap, at most the largest range of the exact law (for systems, its median range). "
    "The answer compares paired attractors instead.",
    "Attractors found: share of the exact law's attractors with a match; correct: share of the "
    "law's attractors with a match.",
    "Same class: both responses have the same period multiple, or both are chaotic, unresolved or "
    "failed. Basin distance: half the sum of the differences of the basin shares, 0 to 1.",
]
_TIMING = [
    "Representation",
    "Processor time [ms]",
    "Force evaluations",
    "Steps",
    "Rejected",
    "Contacts per period, mean",
    "Points",
]
_OF_COST = (
    "Processor time: of a whole sweep point, transients included; costs in the answer are per "
    "forcing period."
)
_OF_PROTOCOLS = (
    "A label with @ marks a law with other solver settings or initial conditions; see provenance."
)
_POOLED = (
    "amplitude_error_median",
    "amplitude_error_p95",
    "recall_pooled",
    "precision_pooled",
    "class_agreement_mean",
    "basin_distance_mean",
)
_SHOWN = (
    *_POOLED,
    *(f"{name}_floor" for name in _POOLED),
    "amplitude_error_median_ci",
    "n_compared",
    "n_points",
)


def _agreement(row: xr.Dataset, floor: str = "") -> list[str]:
    median, p95, found, right, same, distance = (float(row[name + floor]) for name in _POOLED)
    interval = "" if floor else _interval(row["amplitude_error_median_ci"])
    shares = (percent(share) for share in (p95, found, right, same))
    return [percent(median) + interval, *shares, number(distance)]


def _interval(bounds: xr.DataArray) -> str:
    low, high = (percent(float(bound)) for bound in bounds)
    return f" ({low.removesuffix(' %')}–{high})" if "–" not in (low, high) else ""


def _timing_rows(timing: xr.Dataset, labels: list[str]) -> Iterator[list[str]]:
    timing = timing.load()
    contacts = timing["contacts_per_period_mean"]
    contacts = contacts.mean(scene_dims(contacts.dims))
    timing = condensed(timing)
    for label in labels:
        row = timing.sel(representation=label)
        cpu = number(1e3 * row["cpu_time_median"].item())
        others = row["n_points_elsewhere"].item()
        points = f"{row['n_points'].item()}"
        points += f" (+{others} of other machines, not shown)" if others else ""
        counts = [number(row[f"{n}_median"].item()) for n in _COUNTS]
        touched = number(contacts.sel(representation=label).item())
        yield [label, cpu, *counts, touched, points]


def special_points(found: xr.Dataset | None, here: xr.Dataset, along: str) -> Iterator[Table]:
    """Tables of special points of branches, also compared with the exact law; lost attractors.

    Mirror images of an orbit share a row. If the second table has the points of approximations,
    the first one has only those of the exact law.

    `found`: ``branches.nc``, or ``curves.nc``: then over the second parameter in place of the peak.
    `here`: the parameter set.
    `along`: the parameter.
    """
    if found is not None and f"attractor_{along}" in found and "attractor_on_branch" in found:
        yield from _lost_attractors(found, here, along)
    height = "x_max" if found is None else str(found.attrs.get("second", "x_max"))
    part = of_scene(found, here, along, height)
    if found is None or part is None or not (part["special"] > 0).any():
        return
    x, y, special, multiple = of_orbits(part, along, height, "special", "period_multiple")
    labels = np.broadcast_to(part.coords.get(REPRESENTATION, ""), len(x)).astype(str)
    peaks: dict[tuple[int, int, str, float], set[str]] = {}
    is_listed = np.full(labels.shape, True)
    if "match_representation" in found and EXACT in labels:
        is_listed = labels == EXACT
    for i, k in np.argwhere((special > 0) & is_listed[:, None]):
        point = special[i, k], multiple[i, k], labels[i], float(f"{x[i, k]:.7g}")
        peaks.setdefault(point, set()).add(f"{y[i, k]:.6g}")
    head = ["Kind", "Period", "Representation"]
    rows = [
        [_kind(kind), f"{n:.0f}", law, f"{at:.7g}", ", ".join(sorted(peaks[kind, n, law, at]))]
        for kind, n, law, at in sorted(peaks)
    ]
    axes = [of_axis(part[name]) for name in (along, height)]
    if rows:
        title = "branches" if height == "x_max" else "curves"
        yield _cut(f"Special points of the {title}", [*head, *axes], rows)
    if "match_representation" not in found:
        return
    matches = found.isel(match=in_scene(found, here, "match", "match_"))
    laws = matches["match_representation"].values
    columns = [matches[f"match_{name}"].values for name in ("kind", "period_multiple")]
    columns += [drawn(matches[f"match_{name}"]) for name in ("exact", "law", "difference")]
    rows = [
        [_kind(kind), f"{n}", law, *(f"{v:.7g}" if np.isfinite(v) else "–" for v in values)]
        for law, kind, n, *values in zip(laws, *columns, strict=True)
    ]
    if rows:
        title = f"Special points compared with the exact law, {of_axis(part[along])}"
        yield _cut(title, [*head, "Exact law", "Approximation", "Difference"], rows)


def _lost_attractors(found: xr.Dataset, here: xr.Dataset, along: str) -> Iterator[Table]:
    """Periodic attractors of a parameter set that lie on no branch."""
    inside = in_scene(found, here, ATTRACTOR, "attractor_")
    lost = found.isel({ATTRACTOR: inside & on_no_branch(found)})
    names = f"attractor_{along}", "attractor_x_max"
    values = [drawn(lost[name]) for name in names]
    others = (lost[f"attractor_{name}"].values for name in ("period_multiple", "start_state"))
    labels = np.broadcast_to(lost[f"attractor_{REPRESENTATION}"].values, len(values[0]))
    rows = [
        [law, f"{n}", f"{at:.7g}", f"{peak:.6g}", ", ".join(f"{x:.9g}" for x in state)]
        for law, at, peak, n, state in zip(labels, *values, *others, strict=True)
    ]
    if rows:
        head = ["Representation", "Period", *(of_axis(lost[name]) for name in names)]
        yield _cut("Attractors on no branch", [*head, "State: displacements, velocities"], rows)


def _kind(kind: float) -> str:
    return f"{Special(int(kind)).symbol}, {KINDS[Special(int(kind))][1]}"


def _cut(title: str, header: list[str], rows: list[list[str]]) -> Table:
    """A table of the distinct rows, at most 40."""
    rows = [list(row) for row in dict.fromkeys(map(tuple, rows))]
    n = f", {_MOST_ROWS} of {len(rows)}: all are in branches.nc" if len(rows) > _MOST_ROWS else ""
    return Table(title + n, header, rows[:_MOST_ROWS])


def condensed(dataset: xr.Dataset) -> xr.Dataset:
    """Medians over parameter sets, and sums of counts; a single set is returned unchanged.

    Medians of agreement leave out sets without a compared point, whose metrics are trivial.
    """
    dims = [dim for dim in scene_dims(dataset.dims) if dim != BOUND]
    if not dims:
        return dataset
    counted = [name for name, variable in dataset.items() if variable.dtype.kind == "i"]
    # A median of intervals is no interval.
    intervals = {name: np.nan * dataset[name] for name in dataset if str(name).endswith("_ci")}
    measured = dataset.drop_vars(counted).assign(intervals)
    if "n_compared" in counted:
        n = dataset["n_compared"]
        # The reproducibility limits have no representation.
        own = [name for name in measured if set(n.dims) <= set(measured[name].dims)]
        measured = measured.assign(measured[own].where(n > 0))
    with warnings.catch_warnings():
        # numpy warns where no set has a number: NaN is correct there.
        warnings.simplefilter("ignore", RuntimeWarning)
        middle = measured.median(dims)
    return middle.assign(dataset[counted].sum(dims))


def tally(counts: Mapping[str, int]) -> str:
    """Numbers of claims by verdict, in words."""
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])


def number(value: float) -> str:
    """A number as text: three significant digits, or all digits before the decimal point."""
    if not np.isfinite(value):
        return "–"
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def percent(value: float) -> str:
    """A share or a relative error as text in percent, three significant digits."""
    if not np.isfinite(value):
        return "–"
    return f"{100.0 * value:.0f} %" if abs(value) >= 1.0 else f"{number(100.0 * value)} %"
