"""What is asked of a sweep point, and what is answered: plain values, no computation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np

from gapsweep.errors import ModelError
from gapsweep.model.oscillator import checked, whole
from gapsweep.status import Status


class ResponseClass(IntEnum):
    """What kind of motion the steady response is; the order is part of the schema."""

    PERIODIC = 0
    CHAOTIC = 1
    UNRESOLVED = 2
    FAILED = 3


class ExtremumKind(IntEnum):
    """What a zero-velocity point is; the order is part of the schema."""

    MINIMUM = -1
    INFLECTION = 0
    MAXIMUM = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Steady:
    """When a response counts as steady, and how much of it is recorded.

    Parameters
    ----------
    settle_tol : float
        Share [-] of a disturbance that may be left when a motion without a period is taken
        for settled, in (0, 0.1].
    max_decay_times, max_periods : float, int
        Times ``1/(ζ ω_n)`` and forcing periods, the fewer of which a motion is watched for a
        period, but never shorter than it needs to settle; then it is asked for its exponent.
        Transient chaos may last many decay times. Both ``> 0``.
    t_max : float, optional
        Bound [s] of the time that it is watched, also where it then has not settled, ``> 0``.
    n_periods : int
        Forcing periods in a full recording window, at least twice `max_period_multiple`.
    max_period_multiple : int
        Largest period multiple looked for, 1 to 256.
    max_extrema : int
        Extrema kept per point, 1 to 65536.
    """

    settle_tol: float = 1e-6
    max_decay_times: float = 113.0
    max_periods: int = 10_000
    t_max: float | None = None
    n_periods: int = 64
    max_period_multiple: int = 32
    max_extrema: int = 256

    def __post_init__(self) -> None:
        durations = (
            "settle_tol",
            "max_decay_times",
            *(("t_max",) if self.t_max is not None else ()),
        )
        for name in durations:
            value = checked(name, getattr(self, name), low=0.0, strict=True)
            object.__setattr__(self, name, value)
        if self.settle_tol > 0.1:
            raise ModelError(f"settle_tol = {self.settle_tol:g}: must be <= 0.1")
        for name, largest in (
            ("max_period_multiple", 256),
            ("max_extrema", 65536),
            ("n_periods", 10**6),
            ("max_periods", 10**7),
        ):
            object.__setattr__(self, name, whole(name, getattr(self, name), 1, largest))
        if not 2 * self.max_period_multiple <= self.n_periods:
            raise ModelError(
                f"n_periods = {self.n_periods}: must be >= 2 max_period_multiple "
                f"({2 * self.max_period_multiple})"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Steady response of one sweep point, or of an array of them.

    It has an attribute for every dataset variable: a plain value, or an array of values.

    Attributes
    ----------
    status : Status
    response_class : ResponseClass
    period_multiple : int
        n of a period-n response, 0 if none was found.
    extrema : tuple of float
        Steady zero-velocity displacements [m] in order of time: over n periods if periodic,
        else over the last window; at most `max_extrema`.
    extremum_kind : tuple of int
        `ExtremumKind` of each.
    n_extrema : int
        Their true count.
    x_max, x_min, amplitude : float
        Peak, trough and half their difference [m]; NaN if the point failed.
    multipliers : tuple of float
        Real and imaginary parts of the two Floquet multipliers over n periods, largest modulus
        first; empty if not periodic.
    multiplier_abs : float
        Largest modulus [-]; NaN if not periodic.
    lyapunov, lyapunov_error : float
        Largest Lyapunov exponent [1/s] and its standard error: zero, as it follows from the
        multipliers, if periodic, unless the solver rattles the motion about its orbit. NaN where
        it could not be told.
    section : tuple of float
        Section points ``x, v, x, v, ...`` [m], [m/s]: the n of a periodic response, else the
        last `max_period_multiple` of the window.
    n_contacts, n_steps, n_rejected, nfev : int
        Cost of the whole point, settling included.
    t_settled : float
        Simulated time [s] after which the response was accepted.
    t_simulated : float
        Simulated time in all [s], shooting included.
    noise : float
        Predicted scatter [m] of section points one response period (one forcing period if there
        is none) apart, from the solver's tolerances alone.
    x_end, v_end : float
        Last section point [m], [m/s]: where a sweep's next point starts.
    cpu_time : float
        Processor time of the integration [s].
    message : str
        Why the point failed, empty otherwise.
    """

    status: Status
    response_class: ResponseClass = ResponseClass.FAILED
    period_multiple: int = 0
    extrema: tuple[float, ...] = ()
    extremum_kind: tuple[int, ...] = ()
    n_extrema: int = 0
    x_max: float = math.nan
    x_min: float = math.nan
    amplitude: float = math.nan
    multipliers: tuple[float, ...] = ()
    multiplier_abs: float = math.nan
    lyapunov: float = math.nan
    lyapunov_error: float = math.nan
    section: tuple[float, ...] = ()
    n_contacts: int = 0
    n_steps: int = 0
    n_rejected: int = 0
    nfev: int = 0
    t_settled: float = math.nan
    t_simulated: float = math.nan
    noise: float = math.nan
    x_end: float = math.nan
    v_end: float = math.nan
    cpu_time: float = math.nan
    message: str = ""

    @classmethod
    def of_many(cls, responses: "Sequence[Response]", shape: tuple[int, ...]) -> "Response":
        """Responses as one, whose attributes are arrays."""
        columns: dict[str, Any] = {}
        for field in fields(cls):
            values = [getattr(response, field.name) for response in responses]
            if isinstance(values[0], tuple | str):
                column = np.empty(len(values), dtype=object)
                column[:] = [v if isinstance(v, str) else np.array(v) for v in values]
            else:
                column = np.array(values)
            columns[field.name] = column.reshape(shape)
        return cls(**columns)

    @property
    def ended(self) -> Any:
        """Whether the motion has an end that another can start from."""
        return np.isfinite(self.x_end) & np.isfinite(self.v_end)
