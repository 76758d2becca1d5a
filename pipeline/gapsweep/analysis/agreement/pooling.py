"""Summaries of metrics over the points and frequencies of a parameter set, with intervals.

Periodic and chaotic motions have separate summaries. A point has the regime of the exact
response; a frequency is chaotic if any of its exact responses is, periodic if all are.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from gapsweep.analysis.agreement.bootstrap import blocks, pooled, quantiles
from gapsweep.analysis.agreement.law_tables import FAILED, UNRESOLVED, LawTable
from gapsweep.analysis.agreement.metrics import METRICS
from gapsweep.analysis.agreement.pointwise import cost_sums
from gapsweep.analysis.dimensions import Array, Bools, Ints

Summaries = Iterator[tuple[str, Any]]

_QUANTILES = {"median": 0.5, "p95": 0.95}


def summaries(ours: LawTable, exact: LawTable, values: dict[str, Array]) -> Summaries:
    """Summaries of one law in one parameter set, by name of the variable.

    `values`: shape (n_omega, n_starts) or (n_omega,); the point-wise and frequency-wise metrics.
    """
    block = blocks(ours.omega)
    of_points = [np.ones_like(exact.requested), exact.periodic, exact.chaotic]
    regimes = {2: of_points, 1: _regimes_of_frequencies(ours, exact)}
    for name, metric in METRICS.items():
        if metric.statistics == ("mean",):
            yield from _means(name, values[name], regimes[values[name].ndim], block)
        elif metric.statistics:
            yield from _spread(name, values[name], regimes[values[name].ndim], block)
    yield from _set_ratios(values, regimes[1], block)
    for name, sums in cost_sums(ours, exact).items():
        yield from _pooled(name, sums, regimes[2], block)
    yield from _counts(ours, exact, regimes[2])


def _regimes_of_frequencies(ours: LawTable, exact: LawTable) -> list[Bools]:
    common = ours.requested & exact.requested
    periodic = np.asarray(common.any(axis=1) & (exact.periodic | ~common).all(axis=1))
    return [np.ones_like(periodic), periodic, np.asarray((exact.chaotic & common).any(axis=1))]


def _spread(
    name: str, values: Array, regimes: list[Bools], block: Ints
) -> Iterator[tuple[str, Array]]:
    known = np.isfinite(values)
    statistics = METRICS[name].statistics
    q = tuple(_QUANTILES[statistic] for statistic in statistics)
    found: list[tuple[Array, Array]] = []
    for regime in regimes:
        at = np.nonzero(known & regime)
        # If all motions are periodic, the first two regimes are equal.
        same = found and len(at[0]) == np.count_nonzero(known)
        found.append(found[0] if same else quantiles(np.abs(values[at]), block[at[0]], q))
    for i, statistic in enumerate(statistics):
        yield f"{name}_{statistic}", np.stack([estimates[i] for estimates, _ in found])
        yield f"{name}_{statistic}_ci", np.stack([intervals[i] for _, intervals in found])


def _means(name: str, values: Array, regimes: list[Bools], block: Ints) -> Summaries:
    known = np.isfinite(values)
    sums = np.stack([np.where(known, values, 0.0), known], axis=-1)
    yield from _pooled(f"{name}_mean", sums, regimes, block)


def _set_ratios(values: dict[str, Array], regimes: list[Bools], block: Ints) -> Summaries:
    n, n_exact, n_matched = (values[f"n_attractors{x}"] for x in ("", "_exact", "_matched"))
    shares = {
        "precision_pooled": (n_matched, n),
        "recall_pooled": (n_matched, n_exact),
        "f1_pooled": (2.0 * n_matched, n + n_exact),
    }
    for name, (top, bottom) in shares.items():
        yield from _pooled(name, np.stack([top, bottom], axis=-1), regimes, block)


def _counts(ours: LawTable, exact: LawTable, regimes: list[Bools]) -> Summaries:
    counted = {
        "n_points": ours.requested,
        "n_compared": ours.exists & exact.exists,
        "n_unresolved": ours.class_number == UNRESOLVED,
        "n_failed": ours.class_number == FAILED,
    }
    for name, cells in counted.items():
        yield name, [np.count_nonzero(cells & regime) for regime in regimes]


def _pooled(name: str, sums: Array, regimes: list[Bools], block: Ints) -> Summaries:
    """Ratio of sums over all points of each regime, and its confidence interval."""
    found = []
    for regime in regimes:
        chosen = np.where(regime[..., None], sums, 0.0)
        by_frequency = chosen.sum(axis=1) if chosen.ndim == 3 else chosen
        found.append(pooled(by_frequency, block))
    yield name, [estimate for estimate, _ in found]
    yield f"{name}_ci", [interval for _, interval in found]
