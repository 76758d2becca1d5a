"""`gapsweep.special_gradient`: derivatives of the place of folds and grazes by parameters.

At a fold ``w · (I - M) = 0`` has a solution w, the left null vector. The place a of the fold along
the branch hence follows a parameter p by first derivatives::

    da/dp = -(w · ∂φ/∂p) / (w · ∂φ/∂a)

At a graze the turning point X of a gap stays on its wall::

    da/dp = -(dX/dp - dwall/dp) / (dX/da)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.continuation.curves import special_point_of
from gapsweep.continuation.gradient import PARAMETER, parameters_of
from gapsweep.continuation.special import GRAZES, Special
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Model, Solver
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.oscillator import called_as
from gapsweep.model.parameters import Parameter
from gapsweep.response.orbit_gradients import Cases, Orbits

Array = NDArray[np.float64]

_RTOL = 1e-13
_STEPS = 12  # of the secant method, and of Newton's
_CLOSED = 1e-15  # step that ends Newton's method, as a share of the orbit's size
_APART = 1e-4  # first step along the branch, as a share of the orbit's size
_FLAT = 1e-12  # part of a branch's direction along its parameter that counts as none
# Distance from the wall, on the side without contact, at which a graze is differentiated, as a
# share of the orbit's size.
_BEFORE = 1e-12


@called_as('gs.special_gradient(branches, 0, ["gap", "K_c"])')
def special_gradient(
    branches: xr.Dataset,
    point: int,
    parameters: str | Sequence[str],
    *,
    oscillator: Model | Callable[..., Model] | None = None,
    law: AnyLaw | None = None,
) -> xr.Dataset:
    """Return derivatives of the place of a fold or a graze along its branch.

    Parameters
    ----------
    branches : Dataset
        Result of `gapsweep.branches` of a forced model along a parameter.
    point : int
        Number of the special point, as of ``ds.gapsweep.special_points()``: a fold or a graze.
    parameters : str or sequence of str
        As in `gapsweep.gradient`.
    oscillator, law
        Model and law of the branches; required for branches from a file.

    Returns
    -------
    Dataset
        ``gradient`` over `parameter`: change of the branch's parameter at the special point, in its
        unit (Hz of frequencies) per SI unit of the parameter. ``value`` is the place itself.

    Raises
    ------
    ModelError
        If an argument is out of range, or the contacts are not located.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> br = gs.branches(gs.systems.paper_oscillator(), law, "omega", (9.0, 16.0), at=12.0)
    >>> found = gs.special_gradient(br, 0, ["gap", "forcing"])
    >>> found["gradient"].sizes["parameter"]
    2
    """
    points, kind, family, along = special_point_of(branches, point, oscillator, law)
    if kind not in (Special.FOLD, *GRAZES) or not family.is_forced:
        raise ModelError(
            f"point = {point}: is a {kind.name.lower()}; must be a fold or a graze of a forced "
            "model"
        )
    place = float(points[along].item())
    values = {**family.values, along: place}
    known = parameters_of([along], family.model, values)
    known += parameters_of(parameters, family.model, values)
    omega = place if along == "omega" else family.omega
    assert omega is not None
    model, laws = family.model_at(values), family.laws_at(values)
    multiple = int(points["period_multiple"].item())
    orbit = _Orbit(known, (model, laws, omega), multiple, points["start_state"].values.ravel())
    moved, gradient = orbit.fold() if kind == Special.FOLD else orbit.graze()
    return xr.Dataset(
        {"gradient": (PARAMETER, gradient), "value": ((), place + moved)},
        {PARAMETER: [each.name for each in known[1:]]},
        {"along": along, "special": kind.name.lower()},
    )


class _Orbit:
    """An orbit and the parameter along its branch, as unknowns (y, a) from a special point on."""

    def __init__(
        self, known: tuple[Parameter, ...], case: tuple[Any, Any, float], multiple: int, y: Array
    ) -> None:
        self._known, self._case, self._multiple = known, case, np.array([multiple])
        self._solver = Solver.of(rtol=_RTOL)
        self._start = np.append(y, 0.0)

    def _cases(self, a: float) -> Cases:
        model, laws, omega = self._known[0].shifted(*self._case, a)
        return Cases([model], [laws], np.array([omega]), self._known)

    def _linear(self, u: Array) -> tuple[Array, Array]:
        """Distance by which a motion misses to close, and its derivatives by (y, a, parameters)."""
        orbits = Orbits(self._cases(float(u[-1])), u[None, :-1], self._multiple, self._solver)
        found = orbits.run(np.zeros(1, np.intp), orbits.period, records=False)
        assert found.monodromy is not None
        assert found.columns is not None
        by_state = found.monodromy[0] - np.eye(len(u) - 1)
        return found.state[0] - u[:-1], np.concatenate([by_state, found.columns[0]], axis=1)

    def _corrected(self, u: Array, along: Array) -> tuple[Array, Array]:
        """The orbit on the hyperplane through u across a direction, and its derivatives."""
        last = np.inf
        for _ in range(_STEPS):
            missed, slopes = self._linear(u)
            matrix = np.vstack([slopes[:, : len(u)], along])
            step = np.linalg.solve(matrix, -np.append(missed, 0.0))
            length = float(np.abs(step[:-1]).max() / np.abs(u[:-1]).max())
            if length <= _CLOSED or length > 0.5 * last:
                return u, slopes
            u, last = u + step, length
        return u, slopes

    def fold(self) -> tuple[float, Array]:
        """Place of a fold relative to that of the special point, and its derivatives."""
        u, n = self._start, len(self._start)
        _, slopes = self._linear(u)
        along = _null(slopes[:, :n])
        origin, slopes = self._corrected(u, along)
        size = float(np.abs(origin[:-1]).max())
        last, s = (0.0, float(along[-1])), _APART * size
        for _ in range(_STEPS):
            u, slopes = self._corrected(origin + s * along, along)
            direction = _null(slopes[:, :n])
            value = float(direction[-1] * np.sign(direction @ along))
            if abs(value) <= _FLAT or value == last[1]:
                break
            (before, other), last = last, (s, value)
            s -= value * (s - before) / (value - other)
        left = np.linalg.svd(slopes[:, : n - 1].T)[2][-1]
        return float(u[-1]), -(left @ slopes[:, n:]) / (left @ slopes[:, n - 1])

    def graze(self) -> tuple[float, Array]:
        """Place of a graze relative to that of the special point, and its derivatives."""
        a, state = 0.0, self._start[:-1]
        for _ in range(_STEPS):
            orbits = Orbits(self._cases(a), state[None, :], self._multiple, self._solver)
            found = orbits.gradients()
            here = [name.startswith("graze") for name in found.names].index(True)
            (distance,), (slope,) = found.value[:, here], found.gradient[:, here]
            size = float(np.abs(state).max())
            if not found.is_ok[0]:
                raise ModelError("point: Newton's method finds no orbit at the graze")
            if -2.0 * _BEFORE * size < distance < 0.0:
                break
            # from the side without this contact, where no derivative grows
            change = -(distance + _BEFORE * size) / slope[0]
            a, state = a + change, found.state[0] + found.state_gradient[0, :, 0] * change
        return a, -slope[1:] / slope[0]


def _null(matrix: Array) -> Array:
    """Unit vector that a matrix with one column more than rows maps to zero."""
    return np.asarray(np.linalg.svd(matrix)[2][-1])
