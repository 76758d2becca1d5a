"""What moves scenes, at a single state: derivatives by time, and eigenvalues about a rest."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.reference_scenes import OscillatorScene, SystemScene
from gapsweep.model.system import System
from gapsweep.response.ensemble import Scene
from gapsweep.response.section import norm

Array = NDArray[np.float64]

# A rest this near to a wall, as a share of the gap and its place, is on it.
_ON_WALL = 1e-7
_STILL = 1e-10


def about_rest(scene: Scene, y: Array, unit: Array) -> tuple[float, float]:
    """What a state of rest does to a motion beside it, and how far off it lies.

    Returns
    -------
    rate : float
        Largest real part [1/s] of an eigenvalue of the motion about it. A rate beside which the
        fastest is so great that rounding makes it is zero. NaN on a wall, where the motion is not
        the same on either side.
    offset : float
        Distance [m] of `y` from the rest, as a section point, by Newton's step.
    """
    n = len(y)
    state = np.concatenate([y, np.eye(n).ravel()])
    found = np.asarray(right_side(scene, tangent=True)(0.0, state))
    speed, slopes = found[:n], found[n:].reshape(n, n)
    offset = float(norm(np.linalg.lstsq(slopes, speed)[0] / unit))
    growth = np.linalg.eigvals(slopes)
    largest = float(growth.real.max())
    if _is_on_wall(scene, y):
        return math.nan, offset
    return 0.0 if abs(largest) <= _STILL * np.abs(growth).max() else largest, offset


def _is_on_wall(scene: Scene, y: Array) -> bool:
    system = scene.oscillator
    assert isinstance(system, System), "an oscillator is forced"
    gaps = system.directions @ y[: system.n]
    return any(
        min(abs(gap - law.gap.j_2), abs(gap + law.gap.j_1)) <= _ON_WALL * (law.gap.width + abs(gap))
        for gap, law in zip(gaps, scene.laws, strict=True)
    )


def rates(scene: Scene, y: Array) -> Array:
    """Derivative of a state by time, at forcing phase zero."""
    return np.asarray(right_side(scene, tangent=False)(0.0, y))


def right_side(scene: Scene, *, tangent: bool) -> Callable[[float, Array], Any]:
    """The equation of motion, with the laws as they are."""
    form = SystemScene if isinstance(scene.oscillator, System) else OscillatorScene
    solver = scene.solver
    given = scene.omega, 0.0, solver.rtol, solver.atol
    return form(scene.oscillator, scene.laws, *given, tangent=tangent).rhs(None)
