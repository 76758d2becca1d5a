"""Sections and sentences on benchmarks, from their two datasets."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.bench.judge import CellOutcome
from gapsweep.analysis.bench.pareto import TARGETS, corners
from gapsweep.model.labels import EXACT, Representation
from gapsweep.report.bench_figures import (
    STATUS_LETTERS,
    atlas,
    in_range,
    tolerance_figure,
    work_precision_figure,
    worst,
)
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Figured, Part, Table
from gapsweep.report.scales import plain
from gapsweep.status import Status

_NAMED = (
    CellOutcome.MODEL_ERROR,
    CellOutcome.FAILED,
    CellOutcome.UNDECIDED,
    CellOutcome.SILENT_WRONG,
)
# Largest error that matters in practice.
_USEFUL = 1e-2


@dataclass(frozen=True, slots=True)
class Conclusions:
    """Sentences on a dataset, and their numbers."""

    sentences: list[str]
    numbers: dict[str, Any]


def conclusions(dataset: xr.Dataset) -> Conclusions:
    """Sentences and numbers that summarize a dataset of ``gapsweep bench``."""
    dataset = dataset.load()
    return _atlas_conclusions(dataset) if "outcome" in dataset else _front_conclusions(dataset)


# ---- Work-precision -------------------------------------------------------------------------


def beaten(bench: xr.Dataset) -> dict[str, list[str]]:
    """Methods of other laws on the Pareto front at errors of 1e-2 or below, by scenario."""
    shown = bench["on_front"].astype(bool) & (bench["total_error"] <= _USEFUL)
    found = {}
    for scene in bench["scene"].values.tolist():
        there = shown.sel(scene=scene).any("tolerance")
        labels = bench["method"].values[there.values].tolist()
        if others := [label for label in labels if Representation(label).law != EXACT]:
            found[scene] = others
    return found


def _front_conclusions(bench: xr.Dataset) -> Conclusions:
    exceptions, rows = beaten(bench), _cheapest(bench)
    sentences = [*_on_front(bench, exceptions), *map(_cost, rows)]
    return Conclusions(sentences, {"cheapest": rows, "not_exact_on_front": exceptions})


def _on_front(bench: xr.Dataset, exceptions: dict[str, list[str]]) -> list[str]:
    """Sentences on the methods on the Pareto front, and on failed runs."""
    n = bench.sizes["scene"]
    sentences = [
        "The exact law with located contacts is the whole Pareto front at errors of 1e-2 and below "
        f"in {n - len(exceptions)} of {n} scenarios."
    ]
    sentences += [
        f"In {scene}, {', '.join(others)} {'is' if len(others) == 1 else 'are'} on the front, too."
        for scene, others in exceptions.items()
    ]
    failed = _failures(bench)
    if failed:
        sentences.append(f"Failed runs: {failed}.")
    return sentences


def _cost(row: Mapping[str, Any]) -> str:
    """Sentence on the cheapest method at a stiffness, gap and error."""
    corner = f"K_c = {plain(row['K_c'])} N/m, {row['gap']} mm, error {row['error']:.0e}"
    if not row["method"]:
        return f"{corner}: no method"
    runner_up = f"; next {row['next']} at {row['ratio']:.2g} times the cost" if row["next"] else ""
    seconds = f"{1e6 * row['cpu_time']:.3g} µs per simulated second"
    return f"{corner}: {row['method']}, {seconds}{runner_up}"


def _failures(bench: xr.Dataset) -> str:
    """Text with the numbers of failed runs by method and status."""
    counts = []
    for label in bench["method"].values.tolist():
        status = bench["status"].sel({"method": label}).values
        for each in Status:
            count = int(np.sum(status == each))
            if count and each not in (Status.OK, Status.NOT_REQUESTED):
                counts.append(f"{label} {each.label.replace('_', ' ')} {count}")
    return ", ".join(counts)


def _cheapest(bench: xr.Dataset) -> list[dict[str, Any]]:
    """Cheapest method at every stiffness, gap and target error, and the best of another law."""
    rows = []
    for target in TARGETS:
        for K_c, gap, cost in corners(bench, target):
            ranked = cost.to_series().dropna().sort_values()
            methods = [Representation(label) for label in ranked.index]
            best = methods[0] if methods else ""
            rivals = [method for method in methods if method.law != methods[0].law]
            rows.append(
                {
                    "K_c": K_c,
                    "gap": gap,
                    "error": target,
                    "method": best,
                    "cpu_time": float(ranked.iloc[0]) if best else None,
                    "next": str(rivals[0]) if rivals else "",
                    "ratio": float(ranked[rivals[0]] / ranked.iloc[0]) if rivals else None,
                }
            )
    return rows


def _cheapest_table(bench: xr.Dataset) -> Table:
    cells: dict[tuple[float, str], dict[float, str]] = {}
    for row in _cheapest(bench):
        text = "none"
        if row["method"]:
            text = f"{row['method']} {1e6 * row['cpu_time']:.3g} µs"
            text += f" ({row['next']} {row['ratio']:.2g}×)" if row["next"] else " (no other law)"
        cells.setdefault((row["K_c"], row["gap"]), {})[row["error"]] = text
    return Table(
        "Cheapest method per simulated second (next law and its cost ratio)",
        ["K_c [N/m], gap [mm]", *(f"error {target:.0e}" for target in TARGETS)],
        [
            [f"{plain(K_c)}, {gap}", *(by_target[target] for target in TARGETS)]
            for (K_c, gap), by_target in cells.items()
        ],
    )


def work_precision(inputs: Inputs) -> Iterator[Part]:
    """The section on costs and errors of methods."""
    if inputs.work_precision is None:
        return
    bench = inputs.work_precision.load()
    figures = [
        Figured(
            work_precision_figure(bench.isel(scene=bench["K_c"].values == K_c)),
            f"K_c = {plain(K_c)} N/m. Error compared with the exact law and processor time per "
            "simulated second, one point per tolerance. Filled and ringed: on the Pareto front "
            "(no other method is both cheaper and more accurate). Ticks at the bottom: model error "
            "of each law, a limit for every tolerance. Crosses on the right: failed runs. Bars: "
            "quartiles. Errors below ten times the difference of the two references are left out.",
            f"Work-precision diagrams, K_c = {plain(K_c)} N/m",
        )
        for K_c in np.unique(bench["K_c"].values).tolist()
    ]
    figures.append(
        Figured(
            tolerance_figure(bench),
            "Error over tolerance, compared with the accurate solution of the same law, medians "
            "over the scenarios: displacement and velocity at period ends, contact times, steady "
            "amplitude. Dashed: error equal to the tolerance.",
            "Error over tolerance",
        )
    )
    machine = (
        f"Measured on {bench.attrs['processor']} ({bench.attrs['machine']}), "
        f"load average {bench.attrs['load_average']:.2g} from other processes; "
        f"{int(bench['n_lanes'].max())} points per compiled call, one for scipy; medians of up to "
        f"{bench.attrs['n_repeats']} rounds, methods interleaved. First calls, which compile or "
        f"load code, took up to {float(bench['first_call_time'].max()):.2g} s and are left out."
    )
    yield Part(
        "work-precision",
        "Work-precision diagrams",
        [*_on_front(bench, beaten(bench)), machine],
        [_cheapest_table(bench)],
        figures,
    )


# ---- Stability --------------------------------------------------------------------------------


def _atlas_conclusions(stability: xr.Dataset) -> Conclusions:
    outcome = stability["outcome"]
    numbers: dict[str, Any] = {"n_silent_wrong": int(stability.attrs["n_silent_wrong"])}
    sentences = [
        f"Wrong results with status ok at rtol {stability.attrs['tight_rtol']:g} or tighter: "
        f"{numbers['n_silent_wrong']}."
    ]
    for name in ("tight", "loose"):
        where = in_range(stability, tight=name == "tight")
        counts = {
            o.name.lower(): int(((outcome == o) & where).sum())
            for o in CellOutcome
            if o is not CellOutcome.NOT_REQUESTED
        }
        numbers[name] = counts
        words = ", ".join(f"{n} {label.replace('_', ' ')}" for label, n in counts.items())
        sentences.append(f"Runs at {name} tolerances: {words}.")
    scenes, methods, rtol = (stability[name].values for name in ("scene", "method", "rtol"))
    silent = [
        {"scene": str(scenes[s]), "method": str(methods[m]), "rtol": float(rtol[m, r])}
        for s, m, r in np.argwhere(outcome.values == CellOutcome.SILENT_WRONG)
    ]
    numbers["silent_wrong"] = silent
    if silent:
        listed = "; ".join(f"{w['scene']} {w['method']} {w['rtol']:.0e}" for w in silent)
        sentences.append(f"Wrong with status ok: {listed}.")
    return Conclusions(sentences, numbers)


def stability(inputs: Inputs) -> Iterator[Part]:
    """The section on failures of methods."""
    if inputs.stability is None:
        return
    stability = inputs.stability.load()
    letters = ", ".join(f"{letter} {name}" for name, letter in STATUS_LETTERS.items())
    legend = (
        "R: correct. M: model error; the law is solved accurately, but differs from the exact law. "
        "?: undecided; the error is within the tolerance times the growth of perturbations, or the "
        "references disagree. !: wrong with status ok. "
        f"Failed runs: {letters}. A cell shows the worst outcome of its tolerances."
    )
    figures = [
        Figured(
            atlas(stability, tight=tight),
            ("Tolerances of 1e-6 and tighter. " if tight else "Looser tolerances. ") + legend,
            f"Failure atlas, {'tight' if tight else 'loose'} tolerances",
        )
        for tight in (True, False)
        if worst(stability, tight=tight).max() > CellOutcome.NOT_REQUESTED
    ]
    yield Part(
        "stability",
        "Failures of methods",
        _atlas_conclusions(stability).sentences,
        [_scene_table(stability), _law_table(stability)],
        figures,
    )


def _scene_table(stability: xr.Dataset) -> Table:
    """Table of outcomes of all methods in each scenario at tight tolerances."""
    outcome = worst(stability, tight=True)
    rows = []
    for scene in stability["scene"].values.tolist():
        here, one = outcome.sel(scene=scene), stability.sel(scene=scene)
        named = [", ".join(here["method"].values[here.values == o].tolist()) or "–" for o in _NAMED]
        rows.append(
            [
                scene,
                str(one["expected"].item()),
                f"{one['stiffness_ratio'].item():.3g}",
                f"{one['growth'].values[0]:.2g}",
                str(int(np.sum(here.values == CellOutcome.RIGHT))),
                *named,
            ]
        )
    header = ["Scenario", "Reference", "Stiffness ratio", "Growth", "Correct"]
    return Table(
        "Outcomes at tolerances of 1e-6 and tighter",
        [*header, "Model error", "Failed", "Undecided", "Wrong with status ok"],
        rows,
    )


def _law_table(stability: xr.Dataset) -> Table:
    """Table of properties of each law that need no integration, over all scenarios."""
    rows = []
    for label in stability["method"].values.tolist():
        one = stability.sel({"method": label})
        more = one["n_wells"] > one["n_wells_exact"]
        wells = f"{int(more.sum())} of {one.sizes['scene']}"
        ranges = [_range(one[name].values) for name in ("in_gap_frequency", "layer_over_step")]
        rows.append([label, wells, *ranges])
    header = ["Method", "Scenarios with false wells", "In-gap frequency [Hz]", "Layer / step"]
    return Table("Properties of the laws", header, rows)


def _range(values: Any) -> str:
    finite = np.asarray(values)[np.isfinite(values)]
    if not finite.size:
        return "–"
    low, high = float(finite.min()), float(finite.max())
    return f"{low:.3g}" if math.isclose(low, high, rel_tol=1e-3) else f"{low:.2g} to {high:.2g}"
