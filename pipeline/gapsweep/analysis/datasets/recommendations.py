"""The simplest adequate model for each parameter set of a study: ``advice.nc``.

`gapsweep.study.least_model` has the criteria.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.errors import ModelError, StudyError
from gapsweep.model.contact import Piecewise
from gapsweep.model.labels import family, law_of
from gapsweep.model.oscillator import Gap
from gapsweep.study.grid import START
from gapsweep.study.least_model import Approximation, Model, approximation, approximations
from gapsweep.study.schema import coordinates
from gapsweep.study.study import Study
from gapsweep.variables import Variable

MODEL_FLAGS = (("none", -1), *((model.name.lower(), int(model)) for model in Model))
APPROXIMATION = "approximation"

# Over all dimensions but representation; `SCREENED` over parameter sets and smooth laws.
VARIABLES = {
    "model": Variable("i1", "1", "simplest adequate model", -1, MODEL_FLAGS),
    "rtol": Variable("f8", "1", "relative tolerance of the solver"),
    "bound": Variable("f8", "m", "bound of the displacement, inf: unknown"),
}
SCREENED = {
    "force_error": Variable("f8", "1", "largest force error over the forcing amplitude"),
    "is_adequate": Variable(
        "i1", "1", "whether force_error is below the allowed error", -1, (("no", 0), ("yes", 1))
    ),
}
_MOST_STARTS = 3  # initial conditions that are named one by one
_PART = 65_536  # points whose numbers are in memory at a time


def advice(study: Study, error: float | None = None) -> xr.Dataset:
    """Advice for every point of a study, and static screening of smooth laws.

    Parameters
    ----------
    study : Study
    error : float, optional
        Error of the steady amplitude to meet; that of the study's ``[auto]`` if None.

    Returns
    -------
    Dataset
        `VARIABLES` over every dimension but the representation, -1 for cells without a point;
        `SCREENED` over the dimensions of parameter sets and `approximation`: the study's smooth
        laws and, per family, the one with the smallest adequate power of ten. Attribute `error`.
    """
    if not study.model.is_oscillator:
        raise StudyError(
            [
                f"{study.source}: system: advice is for oscillators only; the report of a run "
                "shows the adequate laws"
            ]
        )
    grid = study.grid
    error = study.spec.auto.error if error is None else error
    asked = grid.requested.any(axis=0)
    model = np.full(asked.shape, -1, "i1")
    rtol, bound = np.full((2, *asked.shape), np.nan)
    cells = np.flatnonzero(asked)
    for first in range(0, len(cells), _PART):
        part = cells[first : first + _PART]
        found = study.advice(part, error)  # cells of the first representation; it has no effect
        model.flat[part] = [one.model for one in found]
        rtol.flat[part] = [one.rtol for one in found]
        bound.flat[part] = [one.bound for one in found]
    variables = {
        name: (grid.dims[1:], values, VARIABLES[name].attributes)
        for name, values in (("model", model), ("rtol", rtol), ("bound", bound))
    }
    labels, screened = _screened(study, error)
    for name, values in screened.items():
        variables[name] = ((*grid.scene_dims, APPROXIMATION), values, SCREENED[name].attributes)
    values = grid.coordinates()
    return xr.Dataset(
        variables,
        {
            APPROXIMATION: (APPROXIMATION, labels, {"long_name": "smooth law"}),
            **{
                name: (along, values[name], variable.attributes)
                for name, (along, variable) in coordinates(grid.dims[1:], grid.structure).items()
            },
        },
        {"study": study.name, "title": study.title, "error": error},
    )


def _screened(study: Study, error: float) -> tuple[list[str], dict[str, Any]]:
    """Labels of smooth laws, and their force error and adequacy in every parameter set.

    They are the study's smooth laws and, per family, the one with the smallest adequate power of
    ten as its parameter.
    """
    grid = study.grid
    own = dict.fromkeys(law_of(label) for label in grid.representations)
    smooth = [r for r in own if family(r) not in (None, Piecewise)]
    others = tuple(i for i, dim in enumerate(grid.dims) if dim not in grid.scene_dims)
    asked = grid.requested.any(axis=others)
    screened = {}
    for at in zip(*np.nonzero(asked), strict=True):
        here = dict(zip(grid.scene_dims, map(int, at), strict=True))
        axes = {name: grid.axes[name][i] for name, i in here.items()}
        gap = axes["gap"] if "gap" in axes else Gap(axes["j_1"], axes["j_2"])
        forcing = axes.get("forcing", study.oscillator.forcing)
        K_ratio = axes.get("K_ratio", 1.0)
        least = approximations(axes["K_c"], gap, forcing, error=error, K_ratio=K_ratio)
        rest = [label for label in smooth if label not in {one.label for one in least}]
        given = {"error": error, "fit_range": study.spec.fit.range, "K_ratio": K_ratio}
        screened[at] = [*least, *_each(rest, axes["K_c"], gap, forcing, **given)]
    labels = list(dict.fromkeys(one.label for scene in screened.values() for one in scene))
    force_error = np.full((*asked.shape, len(labels)), np.nan)
    is_adequate = np.full(force_error.shape, -1, "i1")
    for at, some in screened.items():
        for one in some:
            place = (*at, labels.index(one.label))
            force_error[place], is_adequate[place] = one.force_error, one.is_adequate
    return labels, {"force_error": force_error, "is_adequate": is_adequate}


def _each(
    labels: list[str], K_c: float, gap: Gap, forcing: float, **given: float
) -> list[Approximation]:
    found = []
    for label in labels:
        try:
            one = approximation(label, K_c, gap, forcing, **given)
        except ModelError:  # a fit with a pole in its range
            one = Approximation(label=label, force_error=np.inf, is_adequate=False)
        found.append(one)
    return found


def sentences(found: xr.Dataset) -> list[dict[str, Any]]:
    """The results of `advice` in words, by parameter set and initial condition.

    Returns
    -------
    list of dict
        ``K_c``, ``gap``, further swept parameters by name, ``starts``, a list of ``start``, the
        initial conditions that need the same models, and ``advice``, a list of ``from``,
        ``to`` [Hz], ``model`` and ``reason``; ``approximations``, a sentence.
    """
    scenes = []
    dims = found["force_error"].dims[:-1]
    for place in np.ndindex(*(found.sizes[dim] for dim in dims)):
        here = found.isel(dict(zip(dims, place, strict=True)))
        if not (here["model"] >= 0).any():
            continue
        j_1, j_2 = (float(here[name]) for name in ("j_1", "j_2"))
        scenes.append(
            {
                **{str(dim): float(here[dim]) for dim in dims if dim != "gap"},
                "gap": Gap(j_1, j_2).label,
                "starts": [
                    {"start": _starts(some), "advice": _ranges(some)} for some in _alike(here)
                ],
                "approximations": _approximations(here),
            }
        )
    return scenes


def _alike(here: xr.Dataset) -> Iterator[xr.Dataset]:
    """Groups of initial conditions that need the same model at every frequency."""
    groups: dict[bytes, list[int]] = {}
    for i, models in enumerate(here["model"].transpose(START, "omega").values):
        if (models >= 0).any():
            groups.setdefault(models.tobytes(), []).append(i)
    return (here.isel({START: some}) for some in groups.values())


def _starts(some: xr.Dataset) -> str:
    n = some.sizes[START]
    if n > _MOST_STARTS:
        first, last = (_start(some.isel({START: i})) for i in (0, -1))
        is_row = np.ptp(some[START].values) == n - 1
        return (
            f"{n} initial conditions, {first} to {last}"
            if is_row
            else f"{n} initial conditions, as {first}, {last}"
        )
    return "; ".join(_start(some.isel({START: i})) for i in range(n))


def _start(one: xr.Dataset) -> str:
    if str(one["start"].values) != "fixed":
        return str(one["start"].values).replace("_", " ")
    x, v = float(one["x_0"]), float(one["v_0"])
    return "rest" if x == v == 0.0 else f"x = {1e3 * x:.4g} mm, v = {1e3 * v:.4g} mm/s"


def _ranges(some: xr.Dataset) -> list[dict[str, Any]]:
    """Intervals of frequency with the same model, each with its rtol and reason."""
    one = some.isel({START: 0})
    asked = np.flatnonzero(one["model"].values >= 0)
    omega, model, rtol = (one[name].values[asked] for name in ("omega", "model", "rtol"))
    bound = some["bound"].max(START).values[asked]
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
            "a wall may be reached; the exact law with located contacts has the lowest cost of the "
            "adequate models"
        )
    stays = f"|x| is at most {1e3 * bound:.3g} mm, no wall is reached"
    return f"{stays}{'; the cubic stiffness is negligible' if model is Model.LINEAR else ''}"


def _approximations(here: xr.Dataset) -> str:
    rows = [
        (str(label), float(value), int(yes))
        for label, value, yes in zip(
            here[APPROXIMATION].values,
            here["force_error"].values,
            here["is_adequate"].values,
            strict=True,
        )
        if yes >= 0
    ]
    good = ", ".join(f"{label} ({value:.2g})" for label, value, yes in rows if yes)
    bad = ", ".join(f"{label} ({value:.2g})" for label, value, yes in rows if not yes)
    text = f"smooth laws whose force error is below the allowed error: {good or 'none'}"
    text = f"{text}; others: {bad}" if bad else text
    how = "in brackets: maximum force error / forcing (no bound on the response; run the study)"
    return f"{text}; {how}" if rows else text
