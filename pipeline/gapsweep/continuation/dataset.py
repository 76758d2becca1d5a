"""Branches as an `xarray.Dataset`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gapsweep.continuation.branches import Branches
from gapsweep.continuation.family import AMPLITUDE
from gapsweep.continuation.orbits import Orbit
from gapsweep.continuation.recognise import Branch
from gapsweep.continuation.seed import Attractor
from gapsweep.continuation.special import Special
from gapsweep.quantities import UNITS
from gapsweep.variables import COORDINATE, PARTS, POINT, Variable

if TYPE_CHECKING:
    import xarray as xr

BRANCH, STEP, STATE, MULTIPLIER, ATTRACTOR = "branch", "step", "state", "multiplier", "attractor"
_POINT = (BRANCH, STEP)
_ENDS = (
    *("none", "window", "closed", "branch_point", "max_steps", "step_too_small", "equilibrium"),
    "resonance",
)
END_FLAGS = tuple((name, i) for i, name in enumerate(_ENDS))
SPECIAL_FLAGS = tuple((kind.name.lower(), int(kind)) for kind in Special)
_STATUS = (("ok", 0), ("not_requested", 1))
_STABLE = (("none", -1), ("unstable", 0), ("stable", 1))
_NEUTRAL = 1e-6  # by which multipliers of free motions and on curves are off the unit circle

VARIABLES = {
    "period": Variable("f8", "s", "period of the orbit"),
    "x_max": Variable("f8", "m", "peak displacement", dims=(COORDINATE,)),
    "x_min": Variable("f8", "m", "trough displacement", dims=(COORDINATE,)),
    "amplitude": Variable("f8", "m", "half the range of the displacement", dims=(COORDINATE,)),
    "period_multiple": Variable("i4", "1", "forcing periods in one period of the orbit", 0),
    "n_contacts": Variable("i4", "1", "wall crossings in a period, in and out", 0),
    "stable": Variable("i1", "1", "whether the orbit is stable", -1, _STABLE),
    "special": Variable("i1", "1", "kind of special point", 0, SPECIAL_FLAGS),
    "status": Variable("i1", "1", "whether there is an orbit", 1, _STATUS),
    "multiplier_real": Variable(
        "f8", "1", "real part of the Floquet multipliers", dims=(MULTIPLIER,)
    ),
    "multiplier_imag": Variable(
        "f8", "1", "imaginary part of the Floquet multipliers", dims=(MULTIPLIER,)
    ),
    "start_state": Variable("f8", "", "initial state of the orbit", dims=(STATE,)),
}
OF_BRANCH = {
    "n_orbits": Variable("i4", "1", "orbits of the branch", 0),
    "begins": Variable(
        "i1", "1", "reason for the end of the branch before its first orbit", 0, END_FLAGS
    ),
    "ends": Variable(
        "i1", "1", "reason for the end of the branch after its last orbit", 0, END_FLAGS
    ),
    "parent": Variable("i4", "1", "branch from which this branch bifurcates, -1: none", -1),
}
# Names in `Attractor` and variables of the attractors that branches start from.
OF_ATTRACTOR = {
    "on_branch": ("branch", Variable("i4", "1", "branch of the attractor, -1: none")),
    "period_multiple": ("multiple", Variable("i4", "1", "forcing periods in one period of it")),
    "period": ("period", Variable("f8", "s", "period of the attractor")),
    "x_max": ("x_max", Variable("f8", "m", "peak of the first coordinate")),
    "start_state": ("section", Variable("f8", "", "a state on the attractor", dims=(STATE,))),
}
CURVE_KIND = "curve_kind"
OF_CURVE = {CURVE_KIND: Variable("i1", "1", "kind of special points", 0, SPECIAL_FLAGS)}


def dataset(found: Branches) -> "xr.Dataset":
    """Dataset of branches: orbits over `branch` and `step`, rows behind a branch's end missing."""
    import xarray as xr

    equations, branches = found.equations, found.found
    family, window = equations.family, equations.windows[0]
    model = family.example
    longest = max((len(branch.orbits) for branch in branches), default=0)
    sizes = {BRANCH: len(branches), STEP: longest, COORDINATE: model.n}
    sizes |= {STATE: equations.n_states, MULTIPLIER: equations.n_states - equations.has_period}
    names = [each.name for each in equations.windows if each.name != AMPLITUDE]
    swept = {
        name: Variable("f8", UNITS.get(name, ""), f"{name} along the branch") for name in names
    }
    table = swept | VARIABLES
    is_neutral = family.is_conservative or len(equations.windows) > 1  # as on curves
    data: dict[str, Any] = {}
    for name, variable in table.items():
        dims = tuple(d for d in variable.dims if d != COORDINATE or model.n > 1)
        values = np.full([sizes[d] for d in (*_POINT, *dims)], variable.missing, variable.dtype)
        for i, branch in enumerate(branches):
            rows = [_value(name, orbit, names, is_neutral=is_neutral) for orbit in branch.orbits]
            values[i, : len(rows)] = np.reshape(rows, (len(rows), *values.shape[2:]))
        form = variable.in_units(model.part_units)
        data[name] = ((*_POINT, *dims), values, form.attributes)
    for name, variable in (OF_BRANCH | (OF_CURVE if len(names) > 1 else {})).items():
        rows = [_of_branch(name, branch) for branch in branches]
        data[name] = ((BRANCH,), np.array(rows, variable.dtype), variable.attributes)
    data |= of_attractors(found.attractors, equations.n_states)
    values = np.array([each.value for each in found.attractors], float)
    words = {"long_name": f"{window.name} of the attractor"}
    data[f"attractor_{window.name}"] = ((ATTRACTOR,), values, words)
    coordinates: dict[str, Any] = {BRANCH: np.arange(len(branches)), STEP: np.arange(longest)}
    if model.n > 1:
        labels = list(model.coordinates)
        coordinates[COORDINATE] = (COORDINATE, labels, PARTS[COORDINATE].attributes)
    made = xr.Dataset(data, coordinates)
    made.attrs = {
        "along": window.name,
        "between": [window.low, window.high],
        "model": repr(family.model),
        "law": repr(family.law),
        "rtol": equations.solver.rtol,
        "n_lost": found.n_lost,
    }
    if len(names) > 1:
        second = equations.windows[1]
        made.attrs |= {"second": second.name, "range": [second.low, second.high]}
    if equations.solver.atol is not None:
        made.attrs["atol"] = equations.solver.atol
    if family.omega is not None:
        made.attrs["forcing_frequency"] = family.omega
    made.encoding["family"] = family
    return made


def of_attractors(attractors: Sequence[Attractor], n_states: int) -> dict[str, Any]:
    """Variables over `attractor`."""
    data: dict[str, Any] = {}
    for name, (of, form) in OF_ATTRACTOR.items():
        rows = [np.ravel(getattr(each, of))[: n_states if form.dims else 1] for each in attractors]
        values = np.reshape(rows, (-1, n_states) if form.dims else -1).astype(form.dtype)
        data[f"attractor_{name}"] = ((ATTRACTOR, *form.dims), values, form.attributes)
    return data


def special_points(found: "xr.Dataset") -> "xr.Dataset":
    """Special points over `point`: those of each branch in its order, branch after branch."""
    import xarray as xr

    found = found if BRANCH in found.dims else found.expand_dims(BRANCH)
    places = np.argwhere(found["special"].transpose(BRANCH, STEP).values > 0).T
    return found.isel({n: xr.DataArray(i, dims=POINT) for n, i in zip(_POINT, places, strict=True)})


def _value(name: str, orbit: Orbit, swept: list[str], *, is_neutral: bool) -> Any:
    """One value of an orbit."""
    if name in swept:
        return orbit.parameters[swept.index(name)]
    if name == "amplitude":
        return 0.5 * (orbit.x_max - orbit.x_min)
    if name == "status":
        return 0
    if name == "stable":
        largest = np.abs(orbit.multipliers).max(initial=0.0)
        return int(largest <= 1.0 + _NEUTRAL if is_neutral else largest < 1.0)
    if name == "multiplier_real":
        return orbit.multipliers.real
    if name == "multiplier_imag":
        return orbit.multipliers.imag
    return orbit.state if name == "start_state" else getattr(orbit, name)


def _of_branch(name: str, branch: Branch) -> int:
    if name == "n_orbits":
        return len(branch.orbits)
    if name in ("parent", CURVE_KIND):
        return branch.parent if name == "parent" else int(branch.kind)
    return _ENDS.index(branch.ends[0 if name == "begins" else 1])
