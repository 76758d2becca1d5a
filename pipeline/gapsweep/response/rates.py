"""What moves scenes, at a single state: derivatives by time, and eigenvalues about a rest."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.reference_scenes import OscillatorScene, SystemScene
from gapsweep.model.system import System
from gapsweep.response.ensemble import Scene

Array = NDArray[np.float64]

# A rest this near to a wall, as a share of the gap and its place, is on it.
_ON_WALL = 1e-7
_STILL = 1e-10


def largest_rate(scene: Scene, y: Array) -> float:
    """Largest real part [1/s] of an eigenvalue of the motion about a state of rest.

    A rate beside which the fastest is so great that rounding makes it is zero. NaN on a wall, where
    the motion is not the same on either side.
    """
    system = scene.oscillator
    assert isinstance(system, System), "an oscillator is forced"
    gaps = system.directions @ y[: system.n]
    for gap, law in zip(gaps, scene.laws, strict=True):
        near = _ON_WALL * (law.gap.width + abs(gap))
        if min(abs(gap - law.gap.j_2), abs(gap + law.gap.j_1)) <= near:
            return math.nan
    n = len(y)
    state = np.concatenate([y, np.eye(n).ravel()])
    slopes = np.asarray(right_side(scene, tangent=True)(0.0, state))[n:].reshape(n, n)
    found = np.linalg.eigvals(slopes)
    largest = float(found.real.max())
    return 0.0 if abs(largest) <= _STILL * np.abs(found).max() else largest


def rates(scene: Scene, y: Array) -> Array:
    """Derivative of a state by time, at forcing phase zero."""
    return np.asarray(right_side(scene, tangent=False)(0.0, y))


def right_side(scene: Scene, *, tangent: bool) -> Callable[[float, Array], Any]:
    """The equation of motion, with the laws as they are."""
    form = SystemScene if isinstance(scene.oscillator, System) else OscillatorScene
    solver = scene.solver
    given = scene.omega, 0.0, solver.rtol, solver.atol
    return form(scene.oscillator, scene.laws, *given, tangent=tangent).rhs(None)
