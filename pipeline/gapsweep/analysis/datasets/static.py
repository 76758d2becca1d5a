"""The static analysis of a study: properties of its contact laws without integration.

For every representation, stiffness and gap, and for other swept parameters of spring, mass and
walls: force curve and force error (A1 of the metrics), frequency of small motions in the gap (A2),
static equilibria and their barriers (A3); for every stiffness and gap the sharpness from which tanh
has no false equilibrium; and the RMS force error over the visited displacements as a share of the
forcing, by which a law is chosen (docs/explanation/rule.md).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.datasets.contact_errors import (
    ADEQUATE,
    at_resonance,
    error_of_parts,
    expected_range,
    in_gap,
    largest_in_gap,
    rms_errors,
    static_error,
    tanh_threshold,
)
from gapsweep.analysis.dimensions import Array
from gapsweep.errors import ModelError
from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.model.equilibria import equilibria, linear_stiffness, restoring_slope
from gapsweep.model.labels import EXACT, Representation
from gapsweep.model.laws.tanh import Tanh
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.model.parameters import with_numbers
from gapsweep.study.schema import COORDINATES
from gapsweep.study.study import Study
from gapsweep.user_code.package_digest import numerics_fingerprint
from gapsweep.variables import Variable

Values = dict[str, Any]

EQUILIBRIUM, DISPLACEMENT = "equilibrium", "displacement"
# Parameters other than those of the walls: force curves do not depend on them.
_SPRING = ("omega_n", "mass", "alpha", "mean_load")
_N_UNIFORM = 801
# Distances from a wall [m]: from the layer of tanh-1e9 on, 6 per decade.
_FINEST, _N_PER_DECADE = 1e-10, 6

CURVES = {
    "force": Variable("f8", "N", "contact force on the mass"),
    "force_error": Variable("f8", "N", "contact force minus that of the exact law"),
}
SCENE_VARIABLES = {
    "rmse": Variable("f8", "N", "RMS force error over the fit range"),
    "r_squared": Variable(
        "f8", "1", "coefficient of determination of the force over the fit range"
    ),
    "fit_rmse": Variable("f8", "N", "RMS force error of a fit at its data points"),
    "rmse_in_gap": Variable("f8", "N", "RMS force error in the gap"),
    "rmse_outside": Variable("f8", "N", "RMS force error outside the gap"),
    "in_gap_force": Variable("f8", "N", "largest force between the walls"),
    "force_at_zero": Variable("f8", "N", "contact force at x = 0"),
    "in_gap_frequency": Variable(
        "f8", "Hz", "frequency of small motions about the middle of the gap"
    ),
    "in_gap_frequency_error": Variable("f8", "1", "in_gap_frequency over omega_n, minus 1"),
    "frequency_at_zero": Variable("f8", "Hz", "frequency from the slope of the law at x = 0"),
    "frequency_at_zero_error": Variable("f8", "1", "frequency_at_zero over omega_n, minus 1"),
    "n_equilibria": Variable("i4", "1", "number of static equilibria in the fit range", 0),
    "n_wells": Variable("i4", "1", "number of stable static equilibria", 0),
    "lowest_barrier": Variable("f8", "J", "lowest energy to leave a static well"),
    "refusal": Variable("str", "1", "reason why the law is invalid, else empty"),
}
# Over the forcing, too, where it is swept.
VISITED_VARIABLES = {
    "visited_min": Variable("f8", "m", "lowest displacement of the exact law"),
    "visited_max": Variable("f8", "m", "highest displacement of the exact law"),
}
FORCED_VARIABLES = {
    "force_error_ratio": Variable(
        "f8", "1", "RMS force error over the visited displacements, over the forcing amplitude"
    ),
}
_STABILITY = (("none", -1), ("unstable", 0), ("stable", 1))
CONTACT_VARIABLES = {
    "tanh_threshold": Variable(
        "f8",
        "m-1",
        "sharpness above which tanh has no false well, NaN if unknown; where tanh is swept",
    ),
}
LIST_VARIABLES = {
    "equilibrium_x": Variable("f8", "m", "positions of the static equilibria"),
    "equilibrium_stable": Variable("i1", "1", "stability of the equilibria", -1, _STABILITY),
    "equilibrium_energy": Variable("f8", "J", "potential energy at the equilibria, zero at x = 0"),
    "equilibrium_frequency": Variable("f8", "Hz", "frequency of small motions in each well"),
    "equilibrium_barrier": Variable("f8", "J", "energy to leave each well"),
}


def static(study: Study, responses: xr.Dataset | None = None) -> xr.Dataset:
    """Force, errors, frequencies and equilibria of laws over all swept parameters.

    A law that cannot be built or evaluated leaves NaN and its reason in ``refusal``; so does a user
    law, since its code could hang or end this process.

    Parameters
    ----------
    study : Study
        Its representations are evaluated without protocols, each once.
    responses : Dataset, optional
        Responses of the study, for the displacements that the exact law visits. Without them, or
        without the exact law, the range is that of `expected_range`; attribute `visited` of
        ``force_error_ratio`` says which.

    Returns
    -------
    Dataset
        With title, study, study_json as attributes.
    """
    grid, x_max = study.grid, study.spec.approximation.range
    labels = tuple(dict.fromkeys(one.law for one in grid.representations if not one.is_auto))
    x = dict(zip(grid.gaps, displacements(grid.gaps, x_max), strict=True))
    swept = {name: grid.axes[name] for name in grid.scene_dims if name in (*_SPRING, "K_ratio")}
    axes: dict[str, Sequence[Any]] = {"K_c": grid.K_c, "gap": grid.gaps, **swept}
    settings = [dict(zip(axes, each, strict=True)) for each in product(*axes.values())]
    springs = {name: axis for name, axis in axes.items() if name in _SPRING}
    # One oscillator for all walls that it meets.
    oscillators = {
        each: with_numbers(study.oscillator, dict(zip(springs, each, strict=True)))
        for each in product(*springs.values())
    }
    models = [
        (
            oscillators[tuple(each[name] for name in springs)],
            *(each["K_c"], each["gap"], each.get("K_ratio", 1.0)),
        )
        for each in settings
    ]
    sizes = {"representation": len(labels), **{dim: len(axis) for dim, axis in axes.items()}}

    @cache
    def of_walls(label: Representation, K_c: float, gap: Gap, K_ratio: float) -> Values:
        if label.is_own:
            return {"refusal": "user law: not evaluated"}
        return _unless_refused(_of_walls, x[gap], study, label, K_c, gap, K_ratio)

    of_all = [
        _unless_refused(_of_spring, oscillator, of_walls(label, *walls), x_max)
        for label in labels
        for oscillator, *walls in models
    ]
    is_first = [all(each[n] == axis[0] for n, axis in springs.items()) for each in settings]
    of_first = [one for one, first in zip(of_all, is_first * len(labels), strict=True) if first]
    of_walls_alone = {dim: size for dim, size in sizes.items() if dim not in springs}
    longest = max([1, *(values.get("n_equilibria", 0) for values in of_all)])
    variables: dict[str, Any] = {}
    for table, values, over in (
        (SCENE_VARIABLES, of_all, sizes),
        (CURVES, of_first, of_walls_alone | {DISPLACEMENT: len(x[grid.gaps[0]])}),
        (LIST_VARIABLES, of_all, sizes | {EQUILIBRIUM: longest}),
    ):
        for name, variable in table.items():
            filled = _filled(variable, name, values, over)
            variables[name] = (tuple(over), filled, variable.attributes)
    if any(one.family == Tanh.family for one in labels):  # a bisection for each contact
        thresholds = [
            tanh_threshold(oscillator, K_c, gap, x_max, K_ratio)
            for oscillator, K_c, gap, K_ratio in models
        ]
        described = CONTACT_VARIABLES["tanh_threshold"].attributes
        shape = [len(axis) for axis in axes.values()]
        variables["tanh_threshold"] = (tuple(axes), np.reshape(thresholds, shape), described)
    coords = _coordinates(labels, axes)
    described = {"units": "m", "long_name": "displacement"}
    coords["x"] = (("gap", DISPLACEMENT), [*x.values()], described)
    attributes = {
        **study.attributes,
        "numerics_fingerprint": numerics_fingerprint(),
        "fit_range": x_max,
    }
    laws = [values.get("law") for values in of_all]
    return _with_forcing(xr.Dataset(variables, coords, attributes), study, laws, models, responses)


def _with_forcing(
    dataset: xr.Dataset,
    study: Study,
    laws: Sequence[ContactLaw | None],
    models: Sequence[tuple[Oscillator, *tuple[Any, ...]]],
    responses: xr.Dataset | None,
) -> xr.Dataset:
    """Add the forcing, an axis where it is swept, the visited range and the force error in it."""
    dims, described = COORDINATES["forcing"]
    swept = study.grid.axes.get("forcing")
    forcing = np.array([study.oscillator.forcing] if swept is None else swept)
    if swept is None:
        dataset["forcing"] = (), forcing[0], described.attributes
    else:
        dataset = dataset.assign_coords(forcing=(dims, forcing, described.attributes))
    over = [*map(str, dataset["in_gap_force"].dims), *(() if swept is None else ("forcing",))]
    shape = [*(dataset.sizes[dim] for dim in over)]
    loaded = {
        oscillator: [
            at_resonance(replace(oscillator, forcing=p), study.grid.omega) for p in forcing.tolist()
        ]
        for oscillator in dict.fromkeys(oscillator for oscillator, *_ in models)
    }
    loads = np.array([[abs(one.forcing) for one in loaded[model[0]]] for model in models])
    ranges, x_max = _visited(responses, over[1:]), study.spec.approximation.range
    is_expected = ranges is None
    if ranges is None:
        exact = [Piecewise(K_c, gap, K_ratio=ratio) for _, K_c, gap, ratio in models]
        pairs = zip(models, exact, strict=True)
        ranges = np.array(
            [expected_range(one, law, x_max) for model, law in pairs for one in loaded[model[0]]]
        )
    of_models = ranges.reshape(*loads.shape, 2)
    errors = np.full((len(laws), len(forcing)), np.nan)
    for i, law in enumerate(laws):
        at = i % len(models)
        if law is not None:
            end = getattr(law, "fit_range", np.inf) if is_expected else np.inf
            found = rms_errors(law, np.clip(of_models[at], -end, end))
            np.divide(found, loads[at], out=errors[i], where=loads[at] > 0.0)
    said = "expected at the main resonance" if is_expected else "by the exact law's responses"
    for (name, variable), values in zip(VISITED_VARIABLES.items(), ranges.T, strict=True):
        dataset[name] = over[1:], values.reshape(shape[1:]), variable.attributes
    ((name, variable),) = FORCED_VARIABLES.items()
    about = {**variable.attributes, "visited": said, "adequate": ADEQUATE}
    return dataset.assign({name: (over, np.reshape(errors, shape), about)})


def _visited(responses: xr.Dataset | None, dims: Sequence[str]) -> Array | None:
    """Lowest and highest displacement [m] of the exact law in every case, if there are any."""
    if responses is None or EXACT not in responses["representation"]:
        return None
    some = responses[["x_min", "x_max"]].sel(representation=EXACT)
    if "gap" not in some.dims:
        some = some.drop_vars("gap", errors="ignore").stack(gap=("j_1", "j_2"), create_index=False)
    rest = [dim for dim in some.dims if dim not in dims]
    low, high = some["x_min"].min(rest), some["x_max"].max(rest)
    return np.stack([one.transpose(*dims).values.ravel() for one in (low, high)], axis=1)


def _coordinates(labels: Sequence[str], axes: Mapping[str, Sequence[Any]]) -> dict[str, Any]:
    values: dict[str, list[Any]] = {
        "representation": list(labels),
        **{name: list(axis) for name, axis in axes.items()},
        "gap": [gap.label for gap in axes["gap"]],
        "j_1": [gap.j_1 for gap in axes["gap"]],
        "j_2": [gap.j_2 for gap in axes["gap"]],
    }
    return {
        name: (COORDINATES[name][0], axis, COORDINATES[name][1].attributes)
        for name, axis in values.items()
    }


def displacements(gaps: Sequence[Gap], x_max: float) -> Array:
    """Displacements [m] of the force curves of gaps, shape (number of gaps, n).

    Uniform over ``±x_max``, graded to both walls of the gap. The last one is repeated in rows that
    have fewer.
    """
    n = max(2, round(_N_PER_DECADE * np.log10(2.0 * x_max / _FINEST)))
    steps = np.geomspace(_FINEST, 2.0 * x_max, n)
    steps = np.concatenate([-steps, [0.0], steps])
    rows = []
    for gap in gaps:
        near = np.add.outer([-gap.j_1, gap.j_2], steps).ravel()
        points = np.concatenate([np.linspace(-x_max, x_max, _N_UNIFORM), near])
        rows.append(np.unique(points[np.abs(points) <= x_max]))
    longest = max(map(len, rows))
    return np.array([np.pad(row, (0, longest - len(row)), mode="edge") for row in rows])


def _unless_refused(measured: Callable[..., Values], *given: Any) -> Values:
    """The values that a function measures for a law, or else the reason of its refusal."""
    try:
        return measured(*given)
    except ModelError as error:
        return {"refusal": str(error)}


def _of_walls(x: Array, study: Study, label: str, K_c: float, gap: Gap, K_ratio: float) -> Values:
    """The law, and the values that depend on the law only, not on the oscillator."""
    law, x_max = study.law(label, K_c, gap, K_ratio), study.spec.approximation.range
    force = law.force(x)
    return {
        "law": law,
        "force": force,
        "force_error": force - law.exact.force(x),
        "in_gap_force": largest_in_gap(law, x_max),
        "force_at_zero": float(law.force(0.0)),
        **_errors(law, x_max),
    }


def _of_spring(oscillator: Oscillator, of_walls: Values, x_max: float) -> Values:
    """The values of `of_walls`, and those that depend on law and oscillator."""
    if "law" not in of_walls:
        return of_walls
    law = of_walls["law"]
    return of_walls | _in_gap(oscillator, law, x_max) | _wells(oscillator, law, x_max)


def _errors(law: ContactLaw, x_max: float) -> Values:
    rmse, r_squared, *_ = static_error(law, x_max)
    within, rest = error_of_parts(law, x_max)
    return {
        "rmse": rmse,
        "r_squared": r_squared,
        "fit_rmse": getattr(law, "rmse", np.nan),
        "rmse_in_gap": within,
        "rmse_outside": rest,
    }


def _in_gap(oscillator: Oscillator, law: ContactLaw, x_max: float) -> Values:
    """Metric A2: frequencies of small motions in the gap and at x = 0.

    The cubic spring is left out, so that the exact law has omega_n everywhere.
    """
    values = {}
    low, high = in_gap(law.gap, x_max)
    middle = 0.5 * (low + high) if high > low else np.nan
    for name, x in (("in_gap_frequency", middle), ("frequency_at_zero", 0.0)):
        stiffness = linear_stiffness(oscillator) + float(law.derivative(x))
        values[name] = float(_frequency(oscillator, np.array(stiffness)))
        exact = oscillator.omega_n or np.nan
        values[f"{name}_error"] = values[name] / exact - 1.0
    return values


def _wells(oscillator: Oscillator, law: ContactLaw, x_max: float) -> Values:
    """Metric A3: static equilibria, with their stability, energy, frequency and barrier."""
    found = equilibria(oscillator, law, x_max)
    slope = restoring_slope(oscillator, law, found.x)
    barriers = found.barrier[np.isfinite(found.barrier)]
    return {
        "n_equilibria": found.x.size,
        "n_wells": int(found.stable.sum()),
        "lowest_barrier": float(np.min(barriers)) if barriers.size else np.nan,
        "equilibrium_x": found.x,
        "equilibrium_stable": found.stable,
        "equilibrium_energy": found.energy,
        "equilibrium_frequency": np.where(found.stable, _frequency(oscillator, slope), np.nan),
        "equilibrium_barrier": found.barrier,
    }


def _frequency(oscillator: Oscillator, stiffness: Array) -> Array:
    """Natural frequency [Hz] of the mass on a spring; NaN if the spring pushes outwards."""
    real = np.where(stiffness >= 0.0, stiffness, np.nan)
    return np.asarray(np.sqrt(real / oscillator.mass) / (2.0 * np.pi))


def _filled(
    variable: Variable, name: str, found: Sequence[Values], over: Mapping[str, int]
) -> NDArray[Any]:
    """One array of a variable's values in all settings, padded with its missing value."""
    shape = tuple(over.values())
    if variable.dtype == "str":
        return np.reshape(np.array([values.get(name, "") for values in found], dtype=str), shape)
    array = np.full(shape, variable.missing, dtype=variable.dtype)
    rows = array.reshape(len(found), -1)
    for row, values in zip(rows, found, strict=True):
        if name in values:
            value = np.atleast_1d(values[name])
            row[: value.size] = value
    return array
