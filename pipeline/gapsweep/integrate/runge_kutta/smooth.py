"""The compiled engine for smooth laws, users' laws, and the exact law without (or with restarted)
location.

`scenes` prepares one table row per oscillator; `run` puts starts into copies of the rows and runs
them in SIMD lanes: each lane has its own clock, step and end, and takes the next point of the batch
when it is done. `integrate` does both.
"""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import lanes as ln
from . import laws, tableaux
from .laws import Law
from .loop import drained

# At this tolerance and tighter the order-8 method is the cheaper one on the benchmark's scenes.
_HIGH_ORDER_FROM = 1e-2


@dataclass(frozen=True, slots=True)
class Run:
    """Result of `run`: arrays of shape (n_points,), and records sorted by point, then time.

    Attributes
    ----------
    x, v, t : ndarray
        State [m, m/s] and time [s] reached.
    status : ndarray of int
        0 ok, 3 out_of_fit_range, 4 diverged, 5 model_invalid, 6 step_underflow, 8 timed_out.
    n_contacts, n_steps, n_rejected, nfev : ndarray of int
        Wall passings in and out; accepted and rejected attempts; right-hand sides.
    tangent : ndarray, shape (n_points, 2, 2)
        Monodromy matrix of the run (identity unless asked for).
    records : ndarray, shape (n_records, N_EVENT_COLUMNS)
        See `extrema`, `section`, `steps`.
    """

    x: NDArray[np.float64]
    v: NDArray[np.float64]
    t: NDArray[np.float64]
    status: NDArray[np.int64]
    n_contacts: NDArray[np.int64]
    n_steps: NDArray[np.int64]
    n_rejected: NDArray[np.int64]
    nfev: NDArray[np.int64]
    reach: NDArray[np.float64]
    tangent: NDArray[np.float64]
    records: NDArray[np.float64]
    _replay: dict[str, Any] = field(repr=False)

    def _of_kind(self, kind: int, point: int) -> NDArray[np.float64]:
        first, last = np.searchsorted(self.records[:, ln.E_POINT], [point, point + 1])
        rows = self.records[first:last]
        return rows[rows[:, ln.E_KIND] == kind]

    def extrema(self, point: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times [s] and displacements [m] of zero velocity."""
        rows = self._of_kind(ln.EXTREMUM, point)
        return rows[:, ln.E_T], rows[:, ln.E_X]

    def section(self, point: int = 0) -> NDArray[np.float64]:
        """(t, x, v) at whole forcing periods, shape (n, 3)."""
        return self._of_kind(ln.SECTION, point)[:, [ln.E_T, ln.E_X, ln.E_V]]

    def contacts(self, point: int = 0) -> NDArray[np.float64]:
        """(t, x, v) of wall passings, shape (n, 3)."""
        return self._of_kind(ln.CONTACT, point)[:, [ln.E_T, ln.E_X, ln.E_V]]

    def sample(
        self, t: ArrayLike, point: int = 0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x(t) [m] and v(t) [m/s], needs ``dense_output=True``.

        Each value is one step of the same method from the start of the accepted step that holds
        t: as accurate as the run itself, where an interpolant would lose orders.
        """
        steps = self._of_kind(ln.STEP, point)
        t = np.atleast_1d(np.asarray(t, dtype=float))
        if steps.size == 0:
            raise ValueError(
                "nothing to sample: run with dense_output=True and a record_from before t"
            )
        first, last = steps[0, ln.E_T], steps[-1, ln.E_T] + steps[-1, ln.E_H]
        slack = 1e-12 * max(1.0, abs(last))
        if t.min() < first - slack or t.max() > last + slack:
            raise ValueError(f"t must lie in the recorded span [{first}, {last}] s")
        at = np.clip(np.searchsorted(steps[:, ln.E_T], t, side="right") - 1, 0, len(steps) - 1)
        return _replay_steps(self._replay, point, steps[at], t)


def _replay_steps(replay, point, steps, t):
    """One step of length t - t_step from each stored step start."""
    n = len(t)
    table = np.repeat(replay["table"][point : point + 1], n, axis=0)
    length = np.maximum(t - steps[:, ln.E_T], 0.0)
    table[:, ln.P_X], table[:, ln.P_V] = steps[:, ln.E_X], steps[:, ln.E_V]
    end = steps[:, ln.E_TAU] + length * table[:, ln.P_FREQUENCY]
    table[:, ln.P_PHASE] = steps[:, ln.E_TAU]
    table[:, ln.P_END_TURNS] = np.floor(end)
    table[:, ln.P_END_TAU] = end - np.floor(end)
    table[:, ln.P_RECORD] = np.inf
    settings = replay["settings"].copy()
    # Any error is accepted and the first step is the whole way: exactly one step.
    settings[ln.S_RTOL] = settings[ln.S_ATOL] = 1e200
    off = [ln.S_ODE45, ln.S_STOP_AT_LAYER, ln.S_TANGENT, ln.S_DENSE, ln.S_CONTACTS]
    settings[off] = 0.0
    settings[ln.S_FIRST_STEP] = 1e100
    results, _ = drained(replay["law"], replay["tableau"], table, np.arange(n), settings)
    return results[:, ln.R_X], results[:, ln.R_V]


def _split_turns(start_phase, span, frequency):
    """Whole turns and phase at the end, snapped to a whole turn where rounding alone separates
    them.
    """
    end = start_phase + span * frequency
    whole = np.rint(end)
    # No whole turn is meant as no time at all.
    is_whole = (whole > 0.0) & (np.abs(end - whole) <= 1e-13 * (1.0 + np.abs(end)))
    turns = np.where(is_whole, whole, np.floor(end))
    return turns, np.where(is_whole, 0.0, end - turns)


def _phase(t_0: float, frequency: float) -> float:
    """Fraction of a turn at t_0, exact for the doubles given; a rounded whole turn is 0."""
    if t_0 == 0.0:
        return 0.0
    turns = Fraction(t_0) * Fraction(frequency)
    fraction = float(turns - round(turns))
    # Half a unit in the last place of t_0 and of the frequency is all that the caller can have
    # meant.
    if abs(fraction) <= 2.3e-16 * abs(float(turns)):
        return 0.0
    return fraction % 1.0


@dataclass(frozen=True, slots=True)
class Scenes:
    """Oscillators with a law as the loop takes them: all of a point but its start and end.

    Attributes
    ----------
    kind : laws type
        The law as the loop is compiled for.
    table : ndarray, shape (n, N_COLUMNS)
        Rows as the loop reads them.
    method : Tableau
    settings : ndarray, shape (N_SETTINGS,)
    """

    kind: Any
    table: NDArray[np.float64]
    method: tableaux.Tableau
    settings: NDArray[np.float64]


def integrate(
    law: Law,
    *,
    omega: ArrayLike,
    t_end: ArrayLike,
    t_0: ArrayLike = 0.0,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
    record_from: ArrayLike = np.inf,
    zeta: ArrayLike = 0.03,
    omega_n: ArrayLike = 5.0,
    mass: ArrayLike = 3.0,
    alpha: ArrayLike = 7e8,
    forcing: ArrayLike = 4.0,
    tangent: bool = False,
    dense_output: bool = False,
    contacts: bool = False,
    **options: Any,
) -> Run:
    """Integrate many points of one law.

    All array arguments broadcast together.

    Parameters
    ----------
    law, omega, zeta, omega_n, mass, alpha, forcing, **options
        As in `scenes`.
    x_0, v_0, t_0, t_end, record_from, tangent, dense_output, contacts
        As in `run`.

    Returns
    -------
    Run
        Flat over points, in the order of the broadcast arrays.
    """
    given = zeta, omega_n, mass, alpha, forcing, omega, x_0, v_0, t_0, t_end, record_from
    broadcast = np.broadcast_arrays(*given, law.q[..., 0])[:-1]
    arrays = [np.ravel(a).astype(float) for a in broadcast]
    prepared = scenes(law, *arrays[:6], **options)
    which = np.arange(arrays[0].size)
    return run(
        prepared,
        which,
        *arrays[6:],
        tangent=tangent,
        dense_output=dense_output,
        contacts=contacts,
    )


def scenes(
    law: Law,
    zeta: NDArray[np.float64],
    omega_n: NDArray[np.float64],
    mass: NDArray[np.float64],
    alpha: NDArray[np.float64],
    forcing: NDArray[np.float64],
    omega: NDArray[np.float64],
    *,
    rtol: float = 1e-9,
    atol: float = 1e-12,
    controller: str = "native",
    method: tableaux.Tableau | None = None,
    x_bound: float = 1e3,
    max_attempts: float = 1e9,
    stop_at_layer: bool = True,
) -> Scenes:
    """Prepare oscillators; `run` then starts them as often as wanted.

    Parameters
    ----------
    law : Law
        From `representations`; its parameters may be arrays, shape (n,).
    zeta, mass, alpha, forcing : ndarray, shape (n,)
        Damping ratio [-], mass [kg], cubic stiffness [N/m^3], forcing amplitude [N].
    omega_n, omega : ndarray, shape (n,)
        Natural and forcing frequency [Hz], positive.
    rtol, atol : float
        Tolerances; error per step below ``atol + rtol * abs(y)``.
    controller : {"native", "ode45"}
        "ode45" is Dormand-Prince 5(4) with the step control of MATLAB's ode45.
    method : Tableau, optional
        Overrides the choice by tolerance.
    x_bound : float
        |x| beyond which a point is diverged [m].
    max_attempts : float
        Attempts after which a point is timed out.
    stop_at_layer : bool
        End native steps at the edges of a smoothing layer thinner than the step.
    """
    if controller not in ("native", "ode45"):
        raise ValueError(f"controller must be 'native' or 'ode45', not {controller!r}")
    if not (rtol > 0.0 and atol >= 0.0):
        raise ValueError(f"need rtol > 0 and atol >= 0, got {rtol} and {atol}")
    if not np.all(omega > 0.0):
        raise ValueError("omega must be positive")
    if method is None:
        method = (
            tableaux.DP5 if controller == "ode45" or rtol > _HIGH_ORDER_FROM else tableaux.DOP853
        )
    table = np.zeros((omega.size, ln.N_COLUMNS))
    omega_n_rad = 2.0 * np.pi * omega_n
    table[:, ln.P_FREQUENCY] = omega
    table[:, ln.P_FORCING] = forcing / mass
    table[:, ln.P_STIFFNESS] = omega_n_rad**2
    table[:, ln.P_DAMPING] = 2.0 * zeta * omega_n_rad
    table[:, ln.P_CUBIC] = alpha / mass
    table[:, ln.P_LAW :] = law.rows(mass, omega.size)
    if isinstance(law.kind, laws.Tanh):
        # Where the tail, exp(-2 |z|), is far below the tolerance, the layer has no edge to stop at
        # yet.
        reach = (3.0 - 0.5 * np.log(rtol)) / laws.TANH_SATURATION
        table[:, ln.P_LAW + laws.LAYER] *= min(1.0, max(0.1, reach))
    settings = np.zeros(ln.N_SETTINGS)
    settings[ln.S_RTOL], settings[ln.S_ATOL] = rtol, atol
    settings[ln.S_BOUND], settings[ln.S_MAX_ATTEMPTS] = x_bound, max_attempts
    settings[ln.S_ODE45] = controller == "ode45"
    settings[ln.S_STOP_AT_LAYER] = stop_at_layer and controller != "ode45"
    settings[ln.S_EXPONENT] = method.exponent
    return Scenes(law.kind, table, method, settings)


def run(
    prepared: Scenes,
    which: NDArray[np.intp],
    x_0: NDArray[np.float64],
    v_0: NDArray[np.float64],
    t_0: NDArray[np.float64],
    t_end: NDArray[np.float64],
    record_from: NDArray[np.float64],
    *,
    queue: NDArray[np.intp] | None = None,
    section_only: bool = False,
    tangent: bool = False,
    dense_output: bool = False,
    contacts: bool = False,
) -> Run:
    """Integrate prepared oscillators from their starts.

    Parameters
    ----------
    prepared : Scenes
    which : ndarray of int, shape (n,)
        Number of the scene of each point.
    x_0, v_0 : ndarray, shape (n,)
        State at t_0 [m, m/s].
    t_0, t_end, record_from : ndarray, shape (n,)
        Start, end, and start of recording [s]; ``record_from=inf`` records nothing.
    queue : ndarray of int, shape (n,), optional
        The points in the order in which lanes take them; default as they stand.
    section_only : bool
        Record section points alone: an extremum takes a probe or two.
    tangent : bool
        Carry the 2 x 2 variational equations.
    dense_output : bool
        Keep every step from `record_from` on, for `Run.sample`.
    contacts : bool
        Record wall passings of a law without located contacts too: a probe or two for each.
    """
    if not np.all(t_end >= t_0):
        raise ValueError("t_end must not lie before t_0")
    if dense_output:
        record_from = np.where(np.isfinite(record_from), record_from, t_0)
    table = prepared.table.take(which, axis=0)
    _set_starts(table, x_0, v_0, t_0, t_end, record_from)
    settings = prepared.settings.copy()
    settings[ln.S_TANGENT], settings[ln.S_DENSE] = tangent, dense_output
    settings[ln.S_CONTACTS], settings[ln.S_SECTION_ONLY] = contacts, section_only
    queue = np.arange(len(which)) if queue is None else queue
    results, records = drained(prepared.kind, prepared.method, table, queue, settings)
    return _result(prepared.kind, prepared.method, table, settings, results, records, t_0, t_end)


def _set_starts(table, x_0, v_0, t_0, t_end, record_from):
    """Put starts and ends into copies of rows of `Scenes`."""
    omega = table[:, ln.P_FREQUENCY]
    phase = np.zeros(len(table))
    if t_0.any():
        phase[:] = [_phase(t, f) for t, f in zip(t_0.tolist(), omega.tolist(), strict=True)]
    table[:, ln.P_X], table[:, ln.P_V], table[:, ln.P_PHASE] = x_0, v_0, phase
    table[:, ln.P_END_TURNS], table[:, ln.P_END_TAU] = _split_turns(phase, t_end - t_0, omega)
    table[:, ln.P_RECORD] = phase + (np.maximum(record_from, t_0) - t_0) * omega


def _result(kind, method, table, settings, results, records, t_0, t_end):
    counts = {name: results[:, column].astype(np.int64) for name, column in _COUNTS.items()}
    # Inside, times count from t_0 so that a late start loses no digits.
    records[:, ln.E_T] += t_0[records[:, ln.E_POINT].astype(np.int64)]
    return Run(
        x=results[:, ln.R_X].copy(),
        v=results[:, ln.R_V].copy(),
        t=t_end - results[:, ln.R_LEFT],
        reach=results[:, ln.R_REACH].copy(),
        tangent=results[:, ln.R_TANGENT : ln.R_REACH].reshape(-1, 2, 2).transpose(0, 2, 1).copy(),
        records=records,
        _replay={"law": kind, "tableau": method, "table": table, "settings": settings},
        **counts,
    )


_COUNTS = {
    "status": ln.R_STATUS,
    "n_contacts": ln.R_CONTACTS,
    "n_steps": ln.R_STEPS,
    "n_rejected": ln.R_REJECTED,
    "nfev": ln.R_NFEV,
}
