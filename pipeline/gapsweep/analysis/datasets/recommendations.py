"""The simplest adequate model for each parameter set of a study: ``advice.nc``.

`gapsweep.study.least_model` derives it; smooth laws are chosen by `contact_errors.ADEQUATE`.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.datasets.contact_errors import (
    TOO_COARSE,
    allowed_error,
    at_resonance,
    expected_range,
    needed,
    rms_error,
)
from gapsweep.analysis.dimensions import scene_dims
from gapsweep.analysis.dimensions import scenes as in_turn
from gapsweep.errors import ModelError, StudyError
from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.model.labels import Representation, canonical_label, contact_law
from gapsweep.model.laws import LAWS
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.model.parameters import with_numbers
from gapsweep.study.grid import CONTACT, START
from gapsweep.study.least_model import Model
from gapsweep.study.schema import coordinates
from gapsweep.study.study import Study
from gapsweep.variables import Variable, empty, with_attributes

MODEL_FLAGS = (("none", -1), *((model.name.lower(), int(model)) for model in Model))
APPROXIMATION = "approximation"

# Over all dimensions but representation; `SCREENED` over parameter sets and smooth laws.
VARIABLES = {
    "model": Variable("i1", "1", "simplest adequate model", -1, MODEL_FLAGS),
    "rtol": Variable("f8", "1", "relative tolerance of the solver"),
    "bound": Variable("f8", "m", "bound of the displacement, inf: unknown", dims=(CONTACT,)),
}
SCREENED = {
    "force_error": Variable("f8", "1", "RMS force error over the forcing amplitude"),
    "is_adequate": Variable(
        "i1", "1", "whether force_error is allowed", -1, (("no", 0), ("yes", 1))
    ),
}
# Per family any law of it, to find the smallest parameter; the last only for studies with fits.
_SEEDS = {law.family: law.examples[0] for law in LAWS if law.is_sharpened}
_FITTED = {law.family: law.examples[0] for law in LAWS if law.symbol and not law.is_sharpened}
_NOT_REACHED = "no wall is reached, so that no contact law has an effect"
_OF_OSCILLATORS = (
    "smooth laws are not judged: the rule needs the visited displacements, which a run of a system "
    "shows"
)
_MOST_STARTS = 3  # initial conditions that are named one by one
_PART = 65_536  # points whose numbers are in memory at a time


def advice(study: Study, error: float | None = None, share: float = 0.95) -> xr.Dataset:
    """Advice for every point of a study at nominal values, and static screening of smooth laws.

    Parameters
    ----------
    error : float, optional
        Error of the steady amplitude to meet; that of the study's ``[auto]`` if None.
    share : float
        Share of the exact law's attractors that smooth laws are to find, as in `static_error`.

    Returns
    -------
    Dataset
        `VARIABLES` over every dimension but the representation, -1 for cells without a point;
        `SCREENED`, of oscillators, over the dimensions of parameter sets and `approximation`: the
        study's smooth laws and, per family, the one with the smallest adequate parameter, in the
        displacements of `expected_range`. Attributes `error`, `share` and `allowed_force_error`.
    """
    study = study.nominal
    model = study.model.default
    if not (model.is_forced and model.contacts):
        raise StudyError(f"{study.source}: system: advice needs a forcing and a contact")
    grid = study.grid
    error = study.spec.auto.error if error is None else error
    asked = grid.requested.any(axis=0)
    parts = [CONTACT] if CONTACT in grid.parts else []
    table = {
        name: replace(
            one.in_units(grid.units),
            dims=(*grid.dims[1:], *(dim for dim in one.dims if dim in parts)),
        )
        for name, one in VARIABLES.items()
    }
    sizes = dict(zip(grid.dims[1:], asked.shape, strict=True))
    values = empty(table, sizes | {dim: len(grid.parts[dim]) for dim in parts})
    cells = np.flatnonzero(asked)
    for first in range(0, len(cells), _PART):
        part = cells[first : first + _PART]
        found = study.advice(part, error)  # cells of the first representation; it has no effect
        for name, array in values.items():
            array.reshape(asked.size, -1)[part] = getattr(found, name).reshape(len(part), -1)
    variables = with_attributes(table, values)
    labels, screened = _screened(study, share) if study.model.is_oscillator else ([], {})
    for name, values in screened.items():
        variables[name] = ((*grid.scene_dims, APPROXIMATION), values, SCREENED[name].attributes)
    coords: dict[str, Any] = {}
    if labels:
        coords[APPROXIMATION] = (APPROXIMATION, labels, {"long_name": "smooth law"})
    numbers = grid.coordinates()
    described = coordinates(grid.dims[1:], grid.structure, grid.units)
    for name, (along, variable) in described.items():
        coords[name] = (along, numbers[name], variable.attributes)
    about = {"study": study.name, "title": study.title, "error": error, "share": share}
    return xr.Dataset(variables, coords, about | {"allowed_force_error": allowed_error(share)})


def _screened(study: Study, share: float) -> tuple[list[str], dict[str, Any]]:
    """Labels of smooth laws, and their force error and adequacy in every parameter set.

    They are the study's smooth laws and, per family, the one with the smallest adequate parameter.
    """
    grid = study.grid
    own = dict.fromkeys(one.law for one in grid.representations)
    smooth = [law for law in own if law.law_type and not issubclass(law.law_type, Piecewise)]
    seeds = _SEEDS | (_FITTED if any(law.family in _FITTED for law in smooth) else {})
    others = tuple(i for i, dim in enumerate(grid.dims) if dim not in grid.scene_dims)
    asked = grid.requested.any(axis=others)
    screened: dict[Any, dict[str, float]] = {}
    for at in zip(*np.nonzero(asked), strict=True):
        here = dict(zip(grid.scene_dims, map(int, at), strict=True))
        axes = {name: grid.axes[name][i] for name, i in here.items()}
        gap = axes["gap"] if "gap" in axes else Gap(axes["j_1"], axes["j_2"])
        walls = axes["K_c"], gap, axes.get("K_ratio", 1.0)
        oscillator = at_resonance(with_numbers(study.oscillator, axes), grid.omega)
        forcing = abs(oscillator.forcing)
        placed = partial(_placed, oscillator, *walls, study.spec.approximation.range)
        labels = []
        for name, seed in seeds.items():
            with suppress(ModelError):  # of a fit whose range does not reach the walls
                value = needed(*placed(seed), forcing, share)
                labels += [canonical_label(f"{name}-{value:g}")] if value > 0.0 else []
        screened[at] = {}
        for label in dict.fromkeys([*labels, *smooth]):
            screened[at][label] = np.inf
            with suppress(ModelError):  # of a fit with a pole in its range
                law, visited = placed(label)
                screened[at][label] = rms_error(law, *visited) / forcing if forcing else np.nan
    labels = list(dict.fromkeys(label for scene in screened.values() for label in scene))
    force_error = np.full((*asked.shape, len(labels)), np.nan)
    for at, some in screened.items():
        for label, value in some.items():
            force_error[(*at, labels.index(label))] = value
    is_adequate = np.where(np.isnan(force_error), -1, force_error <= allowed_error(share))
    return labels, {"force_error": force_error, "is_adequate": is_adequate.astype("i1")}


def _placed(
    oscillator: Oscillator, K_c: float, gap: Gap, K_ratio: float, fit_range: float, label: str
) -> tuple[ContactLaw, tuple[float, float]]:
    """A law, and the displacements that are expected of the oscillator with it."""
    law = contact_law(label, K_c, gap, fit_range, K_ratio=K_ratio)
    return law, expected_range(oscillator, law, fit_range)


def sentences(found: xr.Dataset) -> list[dict[str, Any]]:
    """The results of `advice` in words, by parameter set and initial condition.

    Returns
    -------
    list of dict
        ``K_c``, ``gap``, further swept parameters by name, ``starts``, a list of ``start``, the
        initial conditions that need the same models, and ``advice``, a list of ``from``,
        ``to`` [Hz], ``model`` and ``reason``; ``approximations``, a sentence; ``laws``, the smooth
        laws with their force errors, none if no wall is reached.
    """
    scenes = []
    dims = scene_dims(found["model"].dims)
    for at in in_turn(found, dims):
        here = found.isel(at)
        if not (here["model"] >= 0).any():
            continue
        walls = [float(here[name]) for name in ("j_1", "j_2") if name in here.coords]
        if _in_metres(here):
            gap = {"gap": Gap(*walls).label}
        else:  # in the unit of the system, unless every contact has its own gap
            gap = {"gap": "/".join(f"{wall:.12g}" for wall in walls)} if walls else {}
        may_reach = bool((here["model"] == Model.EXACT).any())
        rows = _assessed(here) if may_reach and "force_error" in here else {}
        text = _approximations(here, rows) if "force_error" in here else _OF_OSCILLATORS
        scenes.append(
            {
                **{dim: float(here[dim]) for dim in dims if dim != "gap"},
                **gap,
                "starts": [
                    {"start": _starts(some), "advice": _ranges(some)} for some in _alike(here)
                ],
                "approximations": text if may_reach else _NOT_REACHED,
                "laws": [
                    {"law": label, "force_error": error, "is_adequate": is_adequate}
                    for label, (error, is_adequate) in rows.items()
                    if np.isfinite(error)  # a fit that could be made
                ],
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
            f"{n} initial conditions (first: {first}; last: {last})"
            if is_row
            else f"{n} initial conditions, as {first}, {last}"
        )
    return "; ".join(_start(some.isel({START: i})) for i in range(n))


def _start(one: xr.Dataset) -> str:
    if str(one["start"].values) != "fixed":
        return str(one["start"].values).replace("_", " ")
    if "units" not in one["x_0"].attrs:
        state = [x for name in ("x_0", "v_0", "z_0") if name in one for x in one[name].values.flat]
        return f"({', '.join(f'{x:.4g}' for x in state)})" if any(state) else "rest"
    x, v = float(one["x_0"]), float(one["v_0"])
    return "rest" if x == v == 0.0 else f"x = {1e3 * x:.4g} mm, v = {1e3 * v:.4g} mm/s"


def _ranges(some: xr.Dataset) -> list[dict[str, Any]]:
    """Intervals of frequency with the same model, each with its rtol and reason."""
    one = some.isel({START: 0})
    asked = np.flatnonzero(one["model"].values >= 0)
    omega, model, rtol = (one[name].values[asked] for name in ("omega", "model", "rtol"))
    of_contacts = [dim for dim in some["bound"].dims if dim not in one["model"].dims]
    bound = some["bound"].max(of_contacts).values[asked]
    starts = [0, *(np.flatnonzero(np.diff(model)) + 1).tolist()]
    ends = [*starts[1:], len(model)]
    return [
        {
            "from": float(omega[a]),
            "to": float(omega[b - 1]),
            "model": Model(int(model[a])).name.lower(),
            "rtol": float(rtol[a]),
            "reason": _reason(Model(int(model[a])), _length(some, float(np.max(bound[a:b])))),
        }
        for a, b in zip(starts, ends, strict=True)
    ]


def _in_metres(some: xr.Dataset) -> bool:
    return some["bound"].attrs.get("units") == "m"


def _length(some: xr.Dataset, length: float) -> str:
    return f"{1e3 * length:.3g} mm" if _in_metres(some) else f"{length:.3g}"


def _reason(model: Model, bound: str) -> str:
    if model is Model.EXACT:
        return (
            "a wall may be reached; the exact law with located contacts has the lowest cost of the "
            "adequate models"
        )
    stays = f"|x| is at most {bound}, no wall is reached"
    return f"{stays}{'; the cubic stiffness is negligible' if model is Model.LINEAR else ''}"


def _assessed(here: xr.Dataset) -> dict[Representation, tuple[float, bool]]:
    """Force error of each assessed law of a case, and whether it is small enough."""
    return {
        Representation(label): (float(here["force_error"][i]), bool(here["is_adequate"][i]))
        for i, label in enumerate(here[APPROXIMATION].values)
        if here["is_adequate"][i] >= 0
    }


def _approximations(here: xr.Dataset, rows: Mapping[Representation, tuple[float, bool]]) -> str:
    if not rows:
        return "smooth laws are judged by their force error over the forcing, which is 0"
    least: dict[type[ContactLaw], float] = {}
    for law, (_, is_adequate) in rows.items():
        if is_adequate and law.law_type is not None and law.law_type.symbol:
            known = least.get(law.law_type, np.inf)
            least[law.law_type] = min(float(law.parameter), known)
    good = "; ".join(
        f"{law.family}: {law.symbol} >= {value:g}{' /m' if law.is_sharpened else ''}"
        for law, value in least.items()
    )
    limit = float(here.attrs["allowed_force_error"])
    text = (
        f"smooth laws that find {here.attrs['share']:.0%} of the exact law's periodic attractors "
        f"(RMS force error at most {limit:g} of the forcing): {good or 'none'}"
    )
    for words, low, high in (
        ("Run the study to judge", limit, TOO_COARSE),
        ("Too coarse", TOO_COARSE, np.inf),
    ):
        some = [
            f"{label} (force error {value:.2g})"
            for label, (value, _) in rows.items()
            if low < value <= high
        ]
        text += f". {words}: {', '.join(some)}" * bool(some)
    return text
