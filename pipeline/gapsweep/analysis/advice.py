"""The least model that each scene of a study needs: ``advice.nc``.

What the choice rests on stands in `gapsweep.study.advice`.
"""

from typing import Any

import numpy as np
import xarray as xr

from gapsweep.errors import ModelError
from gapsweep.model.labels import AUTO
from gapsweep.study.advice import Model, StandIn, stand_in, stand_ins
from gapsweep.study.schema import COORDINATES, POINT_DIMS, Variable
from gapsweep.study.study import Study

MODEL_FLAGS = (("none", -1), *((model.name.lower(), int(model)) for model in Model))
SWEPT = POINT_DIMS[1:]
STAND_IN = "stand_in"

VARIABLES: dict[str, tuple[tuple[str, ...], Variable]] = {
    "model": (SWEPT, Variable("i1", "1", "least model that is adequate", -1, MODEL_FLAGS)),
    "rtol": (SWEPT, Variable("f8", "1", "relative tolerance of the solver")),
    "bound": (SWEPT, Variable("f8", "m", "what the displacement never exceeds, inf: not certain")),
    "force_error": (
        (*SWEPT[:2], STAND_IN),
        Variable("f8", "1", "largest difference from the exact force / forcing"),
    ),
    "is_adequate": (
        (*SWEPT[:2], STAND_IN),
        Variable("i1", "1", "whether the smooth law meets the error", -1, (("no", 0), ("yes", 1))),
    ),
}


def advice(study: Study, error: float | None = None) -> xr.Dataset:
    """Advice for every scene and start of a study, and static screening of smooth laws.

    Parameters
    ----------
    study : Study
    error : float, optional
        Error of the steady amplitude to meet; that of the study's ``[auto]`` if None.

    Returns
    -------
    Dataset
        `VARIABLES` over K_c, gap, omega and initial_condition, -1 where no representation is
        asked for; over K_c, gap and `stand_in` the study's own smooth laws and, per family, the
        one with the smallest adequate power of ten. Attribute `error`.
    """
    grid = study.grid
    error = study.spec.auto.error if error is None else error
    asked = grid.requested.any(axis=0)
    model = np.full(asked.shape, -1, "i1")
    rtol, bound = np.full((2, *asked.shape), np.nan)
    for place in zip(*np.nonzero(asked), strict=True):
        k, g, w, i = map(int, place)
        found = study.advice((0, k, g, w, i), error)
        model[place], rtol[place], bound[place] = found.model, found.rtol, found.bound
    screened = _screened(study, error)
    labels = list(dict.fromkeys(one.label for scene in screened.values() for one in scene))
    force_error = np.full((*asked.shape[:2], len(labels)), np.nan)
    is_adequate = np.full(force_error.shape, -1, "i1")
    for scene, some in screened.items():
        for one in some:
            at = (*scene, labels.index(one.label))
            force_error[at], is_adequate[at] = one.force_error, one.is_adequate
    tables = {
        "model": model,
        "rtol": rtol,
        "bound": bound,
        "force_error": force_error,
        "is_adequate": is_adequate,
    }
    return xr.Dataset(
        {name: (dims, tables[name], v.attributes) for name, (dims, v) in VARIABLES.items()},
        _coordinates(study) | {STAND_IN: (STAND_IN, labels, {"long_name": "smooth law"})},
        {"study": study.name, "title": study.title, "error": error},
    )


def _screened(study: Study, error: float) -> dict[tuple[int, int], list[StandIn]]:
    """The study's smooth laws and the least adequate ones, by stiffness and gap."""
    grid, forcing = study.grid, study.oscillator.forcing
    own = dict.fromkeys(label.partition("@")[0] for label in grid.representations)
    smooth = [r for r in own if r != AUTO and ":" not in r and not r.startswith("piecewise")]
    screened = {}
    for k, K_c in enumerate(grid.K_c):
        for g, gap in enumerate(grid.gaps):
            if grid.requested[:, k, g].any():
                least = stand_ins(K_c, gap, forcing, error=error)
                others = [label for label in smooth if label not in {one.label for one in least}]
                screened[k, g] = [*least, *_each(others, K_c, gap, study, error)]
    return screened


def _each(labels: list[str], K_c: float, gap: Any, study: Study, error: float) -> list[StandIn]:
    found = []
    for label in labels:
        try:
            one = stand_in(
                label,
                K_c,
                gap,
                study.oscillator.forcing,
                error=error,
                fit_range=study.spec.fit.range,
            )
        except ModelError:  # a fit with a pole in its range
            one = StandIn(label=label, force_error=np.inf, is_adequate=False)
        found.append(one)
    return found


def _coordinates(study: Study) -> dict[str, Any]:
    grid = study.grid
    axes = {
        "K_c": list(grid.K_c),
        "gap": [gap.label for gap in grid.gaps],
        "j_1": [gap.j_1 for gap in grid.gaps],
        "j_2": [gap.j_2 for gap in grid.gaps],
        "omega": list(grid.omega),
        "initial_condition": list(range(len(grid.starts))),
        "x_0": [s.x_0 if s.kind == "fixed" else np.nan for s in grid.starts],
        "v_0": [s.v_0 if s.kind == "fixed" else np.nan for s in grid.starts],
        "start": [start.kind for start in grid.starts],
    }
    return {
        name: (COORDINATES[name][0], values, COORDINATES[name][1].attributes)
        for name, values in axes.items()
    }


def sentences(found: xr.Dataset) -> list[dict[str, Any]]:
    """What `advice` found, by scene and start, in words.

    Returns
    -------
    list of dict
        ``K_c``, ``gap``, ``starts`` and ``advice``, a list of ``from``, ``to`` [Hz], ``model``
        and ``reason``; ``stand_ins``, a sentence.
    """
    scenes = []
    for k, g in np.ndindex(found.sizes["K_c"], found.sizes["gap"]):
        here = found.isel(K_c=k, gap=g)
        if not (here["model"] >= 0).any():
            continue
        scenes.append(
            {
                "K_c": float(here["K_c"]),
                "gap": str(here["gap"].values),
                "starts": [
                    {"start": _start(one), "advice": _ranges(one)}
                    for one in (
                        here.isel(initial_condition=i)
                        for i in range(here.sizes["initial_condition"])
                    )
                    if (one["model"] >= 0).any()
                ],
                "stand_ins": _stand_ins(here),
            }
        )
    return scenes


def _start(one: xr.Dataset) -> str:
    if str(one["start"].values) != "fixed":
        return str(one["start"].values).replace("_", " ")
    x, v = float(one["x_0"]), float(one["v_0"])
    return "rest" if x == v == 0.0 else f"x = {1e3 * x:.4g} mm, v = {1e3 * v:.4g} mm/s"


def _ranges(one: xr.Dataset) -> list[dict[str, Any]]:
    """Neighbouring frequencies that need the same model, together."""
    asked = np.flatnonzero(one["model"].values >= 0)
    names = ("omega", "model", "bound", "rtol")
    omega, model, bound, rtol = (one[name].values[asked] for name in names)
    starts = [0, *(np.flatnonzero(np.diff(model)) + 1).tolist()]
    ends = [*starts[1:], len(model)]
    return [
        {
            "from": float(omega[a]),
            "to": float(omega[b - 1]),
            "model": Model(int(model[a])).name.lower(),
            "rtol": float(rtol[a]),
            "reason": _reason(Model(int(model[a])), float(np.max(bound[a:b]))),
        }
        for a, b in zip(starts, ends, strict=True)
    ]


def _reason(model: Model, bound: float) -> str:
    if model is Model.EXACT:
        return (
            "a wall may be reached: the exact law, contacts located, is the cheapest adequate one"
        )
    stays = f"|x| never exceeds {1e3 * bound:.3g} mm, no wall is reached"
    return f"{stays}{'; nor is the cubic spring seen' if model is Model.LINEAR else ''}"


def _stand_ins(here: xr.Dataset) -> str:
    rows = [
        (str(label), float(value), int(yes))
        for label, value, yes in zip(
            here[STAND_IN].values,
            here["force_error"].values,
            here["is_adequate"].values,
            strict=True,
        )
        if yes >= 0
    ]
    good = ", ".join(f"{label} ({value:.2g})" for label, value, yes in rows if yes)
    bad = ", ".join(f"{label} ({value:.2g})" for label, value, yes in rows if not yes)
    text = f"adequate where contacts cannot be located: {good or 'none'}"
    return f"{text}; not adequate: {bad}" if bad else text
