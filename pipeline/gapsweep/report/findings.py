"""What the numbers of a run say, in sentences computed from its datasets."""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.report.style import colour
from gapsweep.report.tables import VERDICTS, number, percent
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

# The thickness of a plotted line: what the paper's claims call agreement, too.
FAITHFUL = 0.05
_SCENE = ("K_c", "gap")


def findings(
    responses: xr.Dataset,
    agreement: xr.Dataset | None,
    decided: Mapping[str, Any] | None,
    advice: xr.Dataset | None = None,
) -> list[str]:
    """The main findings of a run.

    Parameters
    ----------
    responses : Dataset
        As stored in ``responses.nc``.
    agreement : Dataset, optional
        As stored in ``agreement.nc``.
    decided : mapping, optional
        What stands in ``claims.json``.
    advice : Dataset, optional
        As stored in ``advice.nc``.
    """
    sentences = [outcomes(responses)]
    if agreement is not None and stand_ins(agreement):
        sentences += _faithful(agreement)
        sentences += _attractors(agreement)
        sentences += _costs(agreement)
    if advice is not None:
        sentences.append(_choices(advice))
    if decided is not None:
        sentences.append(_verdicts(decided))
    return sentences


def outcomes(responses: xr.Dataset) -> str:
    """How many sweep points came out how."""
    status, kind = (responses[n].values for n in ("status", "response_class"))
    asked = status != Status.NOT_REQUESTED
    counts = Counter({c: int(np.sum((kind == c) & asked)) for c in ResponseClass})
    return (
        f"Of {asked.sum()} sweep points {counts[ResponseClass.PERIODIC]} are periodic, "
        f"{counts[ResponseClass.CHAOTIC]} chaotic, {counts[ResponseClass.UNRESOLVED]} unresolved "
        f"and {counts[ResponseClass.FAILED]} failed."
    )


def stand_ins(agreement: xr.Dataset) -> list[str]:
    """Labels that are not the exact law under other solver settings, and are no protocol."""
    exact = {agreement.attrs["reference"], *str(agreement.attrs["floor_representations"]).split()}
    labels = [str(label) for label in agreement["representation"].values]
    return [label for label in labels if label not in exact and "@" not in label]


def scene_errors(agreement: xr.Dataset) -> xr.DataArray:
    """Median amplitude error of every stand-in in every scene, ``(representation, scene)``."""
    pooled = agreement["amplitude_error_median"].sel(
        regime="all", representation=stand_ins(agreement)
    )
    return pooled.stack(scene=_SCENE).dropna("scene", how="all")


def overview(agreement: xr.Dataset) -> dict[str, Any] | None:
    """Median amplitude errors of all scenes in one table, with the floors below.

    None if nothing stands in for the exact law.
    """
    if not stand_ins(agreement):
        return None
    errors = scene_errors(agreement)
    floor = agreement["amplitude_error_median_floor"].sel(regime="all")
    scenes = errors["scene"].values.tolist()
    floors = [float(floor.sel(K_c=K_c, gap=gap)) for K_c, gap in scenes]
    rows = [
        {
            "representation": str(label),
            "colour": colour(str(label)),
            "cells": [
                {"text": percent(error), "faithful": error < FAITHFUL}
                for error in errors.sel(representation=label).values.tolist()
            ],
        }
        for label in errors["representation"].values
    ]
    if np.isfinite(floors).any():
        cells = [{"text": percent(value), "faithful": False} for value in floors]
        name = "exact against exact"
        rows.append({"representation": name, "colour": colour("piecewise"), "cells": cells})
    heads = [f"{number(K_c)} N/m, {gap} mm" for K_c, gap in scenes]
    return {"scenes": heads, "rows": rows, "has_floors": bool(np.isfinite(floors).any())}


def _faithful(agreement: xr.Dataset) -> Iterator[str]:
    errors = scene_errors(agreement)
    ranked = sorted(
        (
            (float(median), str(label))
            for label, median in zip(
                errors["representation"].values, errors.median("scene").values, strict=True
            )
            if np.isfinite(median)
        ),
    )
    if not ranked:
        return
    n_scenes = errors.sizes["scene"]
    if n_scenes > 1:
        shares = []
        for _, label in ranked:
            row = errors.sel(representation=label).dropna("scene")
            shares.append(f"{label} in {int((row < FAITHFUL).sum())} of {row.size}")
        yield (
            f"Half of the amplitudes lie within {percent(FAITHFUL)} of the exact law's: "
            f"{', '.join(shares)} scenes."
        )
    (best, closest), (worst, farthest) = ranked[0], ranked[-1]
    if len(ranked) > 1:
        yield (
            f"Closest to the exact law{' over all scenes' if n_scenes > 1 else ''} is {closest} "
            f"(median amplitude error {percent(best)}), farthest {farthest} ({percent(worst)})."
        )
    floor = agreement["amplitude_error_median_floor"].sel(regime="all")
    if np.isfinite(floor).any():
        yield (
            f"Exact against exact, the same number is {percent(float(floor.max()))} at most: "
            "what lies below cannot be told from rounding."
        )


def _attractors(agreement: xr.Dataset) -> Iterator[str]:
    recall = agreement["recall_pooled"].sel(regime="all", representation=stand_ins(agreement))
    several = (agreement["n_attractors_exact"] > 1).any()
    found = recall.mean(_SCENE)
    if not several or not np.isfinite(found).any():
        return
    found = found.dropna("representation").sortby(found.dropna("representation"), ascending=False)
    parts = [
        f"{label} {percent(float(share))}"
        for label, share in zip(found["representation"].values, found.values, strict=True)
    ]
    yield f"Share of the exact law's attractors that are found: {', '.join(parts)}."


def _costs(agreement: xr.Dataset) -> Iterator[str]:
    ratio = agreement["cpu_time_ratio"].sel(regime="all", representation=stand_ins(agreement))
    ratio = ratio.stack(scene=_SCENE).dropna("scene", how="all")
    if not ratio.size:
        return
    n_scenes = ratio.sizes["scene"]
    dearer = int((ratio.min("representation") >= 1.0).sum())
    if n_scenes > 1 or dearer:
        where = f" in {dearer} of {n_scenes} scenes" if n_scenes > 1 else ""
        yield f"The exact law with located contacts is the cheapest representation{where}."
    typical = ratio.median("scene").dropna("representation")
    typical = typical.sortby(typical)
    parts = [
        f"{label} {number(float(v))}"
        for label, v in zip(typical["representation"].values, typical.values, strict=True)
    ]
    over = ", median over scenes" if n_scenes > 1 else ""
    yield f"Processor time relative to the exact law{over}: {', '.join(parts)}."


def _choices(advice: xr.Dataset) -> str:
    """What representation ``auto`` has taken."""
    flags = advice["model"].attrs
    names = dict(zip(np.ravel(flags["flag_values"]), flags["flag_meanings"].split(), strict=True))
    chosen, counts = np.unique(advice["model"].values, return_counts=True)
    parts = [f"{n} {names[m]}" for m, n in zip(chosen, counts, strict=True) if m >= 0]
    return (
        f"For an error of {advice.attrs['error']:g}, auto takes as the least model that "
        f"{counts[chosen >= 0].sum()} scenes and starts need: {', '.join(parts)}."
    )


def _verdicts(decided: Mapping[str, Any]) -> str:
    counts = decided["counts"]
    parts = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])
    return f"Of {sum(counts.values())} claims: {parts}."
