"""The simplest adequate model of a case, from its parameters only.

Nothing is integrated, so no result can influence the choice (docs/decisions/0010-advice.md):

- *The walls are never reached.* The linear oscillator answers a force of magnitude f by at most
  L f, with L the integral of its impulse response's magnitude. As long as ``|x| <= b``, the cubic
  spring is such a force of at most ``|α| b³ / m``. Let b_0 bound the linear motion, transient
  included. If ``b = b_0 + L |α| b³ / m`` has a root below both walls, the motion never leaves it:
  plain Duffing, whose motion is the same.
- *The cubic spring is negligible.* By the same bound it changes the steady motion by at most
  ``L |α| b³ / m``, now with the linear steady amplitude as b_0. Below the error: linear.
- *A tolerance* of a tenth of the error is enough where that bound holds: then the steady motion is
  the only one, because the loop gain of the cubic spring is below one. If walls may be reached,
  there may be several, and the tolerance is the one that decides between them: errors of the
  transient must stay as small as those of an initial condition, for any error of the amplitude.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum

from gapsweep.errors import ModelError
from gapsweep.model.oscillator import OSCILLATOR, Gap, Oscillator, checked
from gapsweep.study.points import Points

DEFAULT_ERROR = 1e-3
SMALLEST_ERROR, LARGEST_ERROR = 1e-9, 0.1
# Solver tolerance: per allowed error, and largest one if it may decide between attractors.
_TOLERANCE, _CHOOSING_RTOL = 0.1, 1e-9


class Model(IntEnum):
    """Simplest adequate model of a case; the numbers are part of the schema."""

    EXACT = 0
    DUFFING = 1
    LINEAR = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """The simplest adequate model for one case and initial condition.

    Attributes
    ----------
    model : Model
    bound : float
        Upper bound of the displacement [m]; infinite if none is known.
    oscillator : Oscillator
        Oscillator to simulate: without the cubic spring if `model` is linear.
    K_c : float
        Contact stiffness to simulate [N/m]: 0 if the walls are never reached. Wall crossings are
        counted nevertheless.
    rtol : float
        Relative tolerance of the solver [-].
    """

    model: Model
    bound: float
    oscillator: Oscillator
    K_c: float
    rtol: float


def advise(
    oscillator: Oscillator,
    K_c: float,
    gap: Gap,
    omega: float,
    start: tuple[float, float] | None = (0.0, 0.0),
    *,
    error: float = DEFAULT_ERROR,
) -> Advice:
    """Return the simplest adequate model.

    Parameters
    ----------
    oscillator : Oscillator
    K_c : float
        Contact stiffness [N/m]; the stiffness ratio of the walls has no effect here.
    gap : Gap
    omega : float
        Forcing frequency [Hz].
    start : (float, float), optional
        Displacement [m] and velocity [m/s] at forcing phase zero; None if not known.
    error : float
        Allowed error of the steady amplitude, relative to the larger of the amplitude and half the
        gap; 1e-9 to 0.1.
    """
    check_error(error)
    bound, steady, moved = math.inf, 0.0, math.inf
    if start is not None and oscillator.is_classic:  # the bounds below hold for these only
        oscillator = oscillator.at(omega)
        oscillator = replace(oscillator, zeta=oscillator.damping_ratio, c=0.0)
        steady, transient = _linear_motion(oscillator, omega, start)
        cubic = _cubic_share(oscillator)
        bound = _smallest_root(steady + transient, cubic)
        moved = cubic * _smallest_root(steady, cubic) ** 3
    if not bound < min(gap.j_1, gap.j_2):
        return Advice(
            model=Model.EXACT,
            bound=math.inf,
            oscillator=oscillator,
            K_c=K_c,
            rtol=min(_TOLERANCE * error, _CHOOSING_RTOL),
        )
    is_linear = moved <= error * max(steady - moved, 0.5 * gap.width)
    return Advice(
        model=Model.LINEAR if is_linear else Model.DUFFING,
        bound=bound,
        oscillator=replace(oscillator, alpha=0.0) if is_linear else oscillator,
        K_c=0.0,
        rtol=_TOLERANCE * error,
    )


def check_error(error: float) -> float:
    """Return `error` as a float, if it is within 1e-9..0.1.

    Raises
    ------
    ModelError
        If `error` is out of this range.
    """
    error = checked("error", error)
    if not SMALLEST_ERROR <= error <= LARGEST_ERROR:
        raise ModelError(f"error = {error:g}: must be in {SMALLEST_ERROR:g}..{LARGEST_ERROR:g}")
    return error


def _linear_motion(
    oscillator: Oscillator, omega: float, start: tuple[float, float]
) -> tuple[float, float]:
    """Return the amplitude of the linear steady motion, and a bound of its transient [m]."""
    omega_rad, omega_n, zeta = 2.0 * math.pi * omega, oscillator.omega_n_rad, oscillator.zeta
    response = (
        (oscillator.forcing / oscillator.mass)
        / complex(omega_n**2 - omega_rad**2, 2.0 * zeta * omega_n * omega_rad)
        if (omega_rad != omega_n or zeta)
        else complex(math.inf)
    )
    steady = abs(response)
    if not math.isfinite(steady):  # resonance without damping
        return steady, math.inf
    x = start[0] - response.real
    v = start[1] + omega_rad * response.imag
    if zeta >= 1.0:  # no envelope; the energy of a free motion never grows
        return steady, math.hypot(x, v / omega_n)
    damped = omega_n * math.sqrt(1.0 - zeta**2)
    return steady, math.hypot(x, (v + oscillator.decay_rate * x) / damped)


def _cubic_share(oscillator: Oscillator) -> float:
    """L |α| / m [1/m²], with L the integral of the magnitude of the linear impulse response."""
    zeta = oscillator.zeta
    if oscillator.alpha == 0.0:
        return 0.0
    if not zeta > 0.0:
        return math.inf
    # From critical damping on the impulse response has one sign: its integral is the static gain.
    half_period = math.pi * zeta / math.sqrt(1.0 - zeta**2) if zeta < 1.0 else math.inf
    gain = 1.0 / (oscillator.omega_n_rad**2 * math.tanh(0.5 * half_period))
    return gain * abs(oscillator.alpha) / oscillator.mass


def _smallest_root(b_0: float, cubic: float) -> float:
    """Smallest positive b with ``b = b_0 + cubic b³``; infinite if there is none."""
    if cubic == 0.0:
        return b_0
    sine = 1.5 * math.sqrt(3.0 * cubic) * b_0
    if not sine <= 1.0:
        return math.inf
    return 2.0 / math.sqrt(3.0 * cubic) * math.sin(math.asin(sine) / 3.0)


def advised(table: Points, error: float) -> Iterator[Advice]:
    """Yield the simplest adequate model of each point, independent of its representation."""
    for row, numbers in enumerate(table.numbers.tolist()):
        point = dict(zip(table.kind.numbers, numbers, strict=True))
        yield advise(
            Oscillator(**{name: point[name] for name in OSCILLATOR}),
            point["K_c"],
            table.gap(row),
            point["omega"],
            None if table.kind.is_sweep else (point["x_0"], point["v_0"]),
            error=error,
        )
