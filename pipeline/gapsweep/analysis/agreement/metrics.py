"""Variables of `agreement.nc`: metrics with units, formulas and summaries.

``docs/reference/metrics.md`` explains them to readers. A4 to A14 are the numbers of the metrics
there; A1 to A3 compare forces and need no responses.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from gapsweep.analysis.agreement.attractor_sets import CLOSE
from gapsweep.analysis.agreement.bootstrap import BLOCK, FEWEST_BLOCKS, LEVEL, N_DRAWS
from gapsweep.analysis.agreement.jumps import JUMP, STEEPER, WINDOW
from gapsweep.analysis.agreement.law_tables import CLASSES
from gapsweep.response.section import CLOUD_CLOSE, CLOUD_SHARE
from gapsweep.study.schema import POINT_DIMS

SCENE = POINT_DIMS[:3]
FREQUENCY = POINT_DIMS[:4]
REGIME, BOUND = "regime", "bound"
POOLED = (*SCENE, REGIME)
REGIMES = ("all", "periodic", "chaotic")
BOUNDS = ("low", "high")

STATISTICS = {
    "median": "median of the absolute value",
    "p95": "95th percentile of the absolute value",
    "mean": "mean",
}


@dataclass(frozen=True, slots=True)
class Metric:
    """A variable of ``agreement.nc``."""

    number: str  # number of the metric in the documentation, A4 to A14
    dims: tuple[str, ...]
    units: str
    long_name: str
    definition: str
    # Its summaries over frequencies and initial conditions: keys of `STATISTICS`.
    statistics: tuple[str, ...] = ()
    # ``max`` or ``min``: which of the values of the exact law against itself is the worst, the
    # reproducibility limit; empty if the metric has none.
    worst: str = ""
    interval: bool = False  # whether a confidence interval is stored
    dtype: str = "f8"


_G = (
    "G: width of the gap, but no more than the largest range of an exact response (if 0, and of "
    "systems, their median range)"
)
_SPREAD = ("median", "p95")
_MEAN = ("mean",)


def _error(number: str, dims: tuple[str, ...], units: str, name: str, formula: str) -> Metric:
    """A metric ``>= 0`` that is 0 for complete agreement."""
    return Metric(number, dims, units, name, formula, _SPREAD, "max", dtype="f4")


def _share(number: str, dims: tuple[str, ...], name: str, formula: str) -> Metric:
    """A metric from 0 to 1 that is 1 for complete agreement."""
    return Metric(number, dims, "1", name, formula, _MEAN, "min", dtype="f4")


def _pooled(number: str, units: str, name: str, formula: str, worst: str = "") -> Metric:
    return Metric(number, POOLED, units, name, formula, worst=worst, interval=True)


def _count(number: str, dims: tuple[str, ...], name: str, formula: str) -> Metric:
    return Metric(number, dims, "1", name, formula, dtype="i4")


METRICS: dict[str, Metric] = {
    "amplitude_error": _error(
        "A4", POINT_DIMS, "1", "amplitude error at equal initial conditions",
        f"|A - A_exact| / max(A_exact, G/2); A: half the range; {_G}",
    ),
    "amplitude_error_paired": _error(
        "A4", FREQUENCY, "1", "amplitude error of paired attractors",
        "mean of |A - A_exact| / max(A_exact, G/2) over all pairs of the one-to-one assignment of "
        "attractors (see n_attractors_matched), close or not",
    ),
    "jump_shift": Metric(
        "A5", POINT_DIMS, "Hz", "shift of a jump, at the frequency below the exact jump",
        "omega of the jump - omega of the exact one; a jump: neighbours on a curve, both periodic, "
        f"|dA| >= {JUMP} max(A, G/2) and > {STEEPER:g} times the steps before and after; matched "
        f"one to one with the same direction within {WINDOW:g} Hz, NaN if with none", dtype="f4",
    ),
    "class_agreement": _share(
        "A9", POINT_DIMS, "same class of response",
        f"1 if both are the same of {', '.join(CLASSES)}; else 0; its mean is the raw accuracy",
    ),
    "attractor_distance": Metric(
        "A10", FREQUENCY, "m", "distance of paired attractors",
        "mean over all pairs of the one-to-one assignment, close or not, of the Hausdorff distance "
        f"of the sections; for two chaotic ones of its {CLOUD_SHARE:g} quantile", dtype="f4",
    ),
    "n_attractors": _count(
        "A10", FREQUENCY, "attractors found",
        "attractors reached from the initial conditions computed with both representations; mirror "
        "images count once if the gap is symmetric",
    ),
    "n_attractors_exact": _count(
        "A10", FREQUENCY, "attractors found with the exact law", "as n_attractors"
    ),
    "n_attractors_matched": _count(
        "A10", FREQUENCY, "attractors that match an exact one",
        "pairs of the one-to-one assignment (the most pairs within the tolerance; of these the "
        f"least total distance) within the tolerance: Hausdorff distance <= {CLOSE} G; for two "
        f"chaotic ones {CLOUD_SHARE:g} quantile <= max({CLOSE} G, {CLOUD_CLOSE} extent)",
    ),
    "precision": Metric(
        "A10", FREQUENCY, "1", "share of the attractors that are right",
        "n_attractors_matched / n_attractors", dtype="f4",
    ),
    "recall": Metric(
        "A10", FREQUENCY, "1", "share of the exact attractors that are found",
        "n_attractors_matched / n_attractors_exact", dtype="f4",
    ),
    "f1": Metric(
        "A10", FREQUENCY, "1", "agreement of the attractor sets",
        "2 n_attractors_matched / (n_attractors + n_attractors_exact)", dtype="f4",
    ),
    "precision_pooled": _pooled(
        "A10", "1", "share of the attractors that are right, over frequencies",
        "sum of n_attractors_matched / sum of n_attractors", "min",
    ),
    "recall_pooled": _pooled(
        "A10", "1", "share of the exact attractors that are found, over frequencies",
        "sum of n_attractors_matched / sum of n_attractors_exact", "min",
    ),
    "f1_pooled": _pooled(
        "A10", "1", "agreement of the attractor sets, over frequencies",
        "2 sum of n_attractors_matched / sum of (n_attractors + n_attractors_exact)", "min",
    ),
    "basin_distance": Metric(
        "A11", FREQUENCY, "1", "total variation of the basin shares",
        "1/2 sum |phi - phi_exact| over matched attractors, unmatched ones and no attractor; phi: "
        "share of the N fixed initial conditions computed with both; NaN if N < 2",
        _MEAN, "max", dtype="f4",
    ),
    "basin_distance_error": Metric(
        "A11", FREQUENCY, "1", "standard error of the total variation of the basin shares",
        "1/2 sqrt(sum (phi (1 - phi) + phi_exact (1 - phi_exact)) / N)", dtype="f4",
    ),
    "same_attractor": _share(
        "A12", POINT_DIMS, "initial condition leads to the matching attractor",
        "1 if the two attractors match (see n_attractors_matched); 0 if not or if only one of the "
        "responses is on an attractor; NaN if none is",
    ),
    "cpu_time_per_period_ratio": _pooled(
        "A14", "1", "CPU time per forcing period, relative to the exact law",
        "sum of cpu_time / sum of omega t_simulated, over that of the exact law at the same points",
    ),
    "contacts_per_period": _pooled(
        "A14", "1", "contacts of steady responses per forcing period", "mean over points compared"
    ),
    "n_points": _count("all", POOLED, "sweep points", "in the study"),
    "n_compared": _count("all", POOLED, "sweep points compared", "with both responses"),
    "n_unresolved": _count("all", POOLED, "sweep points unresolved", "of class unresolved"),
    "n_failed": _count("all", POOLED, "sweep points failed", "of class failed"),
}  # fmt: skip


def variables() -> Iterator[tuple[str, Metric]]:
    """All variables of the file by name: metrics, summaries, intervals, reproducibility limits."""
    for name, metric in METRICS.items():
        yield from _with_companions(name, metric)
        for statistic in metric.statistics:
            what = STATISTICS[statistic]
            summary = Metric(
                metric.number,
                POOLED,
                metric.units,
                f"{metric.long_name}, {what}",
                f"{what} over the points of the regime; {metric.definition}",
                worst=metric.worst,
                interval=True,
            )
            yield from _with_companions(f"{name}_{statistic}", summary)


def _with_companions(name: str, metric: Metric) -> Iterator[tuple[str, Metric]]:
    yield name, metric
    if metric.interval:
        interval = replace(
            metric,
            dims=(*metric.dims, BOUND),
            long_name=f"{metric.long_name}, {LEVEL:.0%} confidence interval",
            definition=f"percentiles of {N_DRAWS} bootstrap draws of whole blocks of {BLOCK:g} Hz; "
            f"NaN for fewer than {FEWEST_BLOCKS} blocks (of a 95th percentile: 20)",
        )
        yield f"{name}_ci", interval
    if metric.worst and metric.dims == POOLED:
        floor = replace(
            metric,
            dims=metric.dims[1:],
            long_name=f"{metric.long_name}, exact against exact",
            definition=f"{metric.worst} of {name} over floor_representations (absolute values if "
            "signed); NaN if there are none",
        )
        yield f"{name}_floor", floor
