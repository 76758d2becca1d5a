"""The compiled engine for all laws but the exact one with contacts located inside the step.

`scenes` prepares one table row per oscillator, `system_scenes` per system; `run` puts starts into
copies of the rows and runs them in SIMD lanes: each lane has its own clock, step and end, and takes
the next point of the batch when it is done.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.integrate.taylor.scenes import Scenes as ExactScenes
from gapsweep.integrate.taylor.starts import CLOCK_ROUNDING, PRODUCT_ROUNDING
from gapsweep.status import DIVERGED_AT

from . import lanes as ln
from . import laws, parameters, tableaux
from .laws import Law
from .loop import drained

Array = NDArray[np.float64]

# At this tolerance and tighter the order-8 method is the cheaper one on the benchmark's scenes.
_HIGH_ORDER_FROM = 1e-2
_MOST_ATTEMPTS = 1e9  # after which a point is timed out


@dataclass(frozen=True, slots=True)
class Run:
    """Result of `run`: arrays of shape (n_points,), and records sorted by point, then time.

    Attributes
    ----------
    at : Rows
    state : ndarray, shape (n_points, n_states)
        Coordinates [m], velocities [m/s] and first-order states reached.
    t : ndarray
        Time [s] reached.
    status : ndarray of int
        0 ok, 3 out_of_fit_range, 4 diverged, 5 model_invalid, 6 step_underflow, 8 timed_out.
    n_contacts, n_steps, n_rejected, nfev : ndarray of int
        Wall passings in and out; accepted and rejected attempts; right-hand sides.
    reach : ndarray, shape (n_points, n)
        Largest modulus of every coordinate at the start and at the ends of steps [m].
    tangent : ndarray, shape (n_points, n_states, n_states)
        Monodromy matrix of the run (identity unless asked for).
    records : ndarray, shape (n_records, n_event_columns)
        Columns and kinds as in `lanes`.
    """

    at: ln.Rows
    state: Array
    t: Array
    status: NDArray[np.int64]
    n_contacts: NDArray[np.int64]
    n_steps: NDArray[np.int64]
    n_rejected: NDArray[np.int64]
    nfev: NDArray[np.int64]
    reach: Array
    tangent: Array
    records: Array
    _replay: dict[str, Any] = field(repr=False)

    def sample(self, t: ArrayLike, point: int = 0) -> Array:
        """States at times t [s], shape (n_states, n_t); needs ``dense_output=True``.

        Each value is one step of the same method from the start of the accepted step that holds
        t: as accurate as the run itself, where an interpolant would lose orders.
        """
        first, last = np.searchsorted(self.records[:, ln.E_POINT], [point, point + 1])
        rows = self.records[first:last]
        steps = rows[rows[:, ln.E_KIND] == ln.STEP]
        t = np.atleast_1d(np.asarray(t, dtype=float))
        if steps.size == 0:
            raise ValueError("nothing to sample: ask for dense_output=True")
        start, end = steps[0, ln.E_T], steps[-1, ln.E_T] + steps[-1, ln.E_H]
        slack = 1e-12 * max(1.0, abs(end))
        if t.min() < start - slack or t.max() > end + slack:
            raise ValueError(f"t must lie in the recorded span [{start}, {end}] s")
        at = np.clip(np.searchsorted(steps[:, ln.E_T], t, side="right") - 1, 0, len(steps) - 1)
        return _replay_steps(self.at, self._replay, point, steps[at], t)


def _replay_steps(at: ln.Rows, replay: dict[str, Any], point: int, steps: Array, t: Array) -> Array:
    """One step of length t - t_step from each stored step start."""
    n = len(t)
    table = np.repeat(replay["table"][point : point + 1], n, axis=0)
    length = np.maximum(t - steps[:, ln.E_T], 0.0)
    table[:, at.q : at.q + at.n_states] = steps[:, ln.E_STATE : ln.E_STATE + at.n_states]
    end = steps[:, ln.E_TAU] + length * table[:, at.omega]
    table[:, at.tau] = table[:, at.phase_0] = steps[:, ln.E_TAU]
    table[:, at.end_turns] = np.floor(end)
    table[:, at.end_tau] = end - np.floor(end)
    table[:, at.record_turns] = np.inf
    # Any error is accepted and the first step is the whole way: exactly one step.
    wide = {"rtol": 1e200, "atol": 1e200, "first_step": 1e100}
    off = ("is_ode45", "cuts_at_layers", "tangent", "dense", "contacts")
    settings = replay["settings"]._replace(**wide, **dict.fromkeys(off, False))
    order = np.arange(n), np.zeros(n + 1, bool)
    results, _ = drained(at, replay["kinds"], replay["tableau"], table, order, settings)
    return np.asarray(results[:, ln.R_STATE : ln.R_STATE + at.n_states].T)


def _split_turns(
    start_phase: Array, t_0: Array, t_end: Array, frequency: Array
) -> tuple[Array, Array]:
    """Whole turns and phase at the end, snapped to a whole turn that only rounding misses."""
    first, last = t_0 * frequency, t_end * frequency
    # Late times round so coarsely that their difference is no whole turn where both are.
    are_whole = (start_phase == 0.0) & (np.abs(last - np.rint(last)) <= PRODUCT_ROUNDING * last)
    turns = np.where(are_whole, np.rint(last) - np.rint(first), (t_end - t_0) * frequency)
    end = start_phase + turns
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
    # Half a unit in the last place of t_0 and of the frequency is all that can have been meant.
    if abs(fraction) <= 2.3e-16 * abs(float(turns)):
        return 0.0
    return fraction % 1.0


@dataclass(frozen=True, slots=True)
class Scenes:
    """Systems with their laws as the loop takes them: all of a point but its start and end.

    Attributes
    ----------
    at : Rows
    kinds : tuple of laws types
        The law of every contact as the loop is compiled for.
    table : ndarray, shape (n, n_columns + n_contacts * N_PARAMETERS)
        Rows as the loop reads them.
    method : Tableau
    settings : Settings
    """

    at: ln.Rows
    kinds: tuple[Any, ...]
    table: Array
    method: tableaux.Tableau
    settings: ln.Settings


def scenes(
    law: Law,
    zeta: Array,
    omega_n: Array,
    mass: Array,
    alpha: Array,
    forcing: Array,
    omega: Array,
    **options: Any,
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
    **options
        As in `prepared`.
    """
    if not np.all(omega > 0.0):
        raise ValueError("omega must be positive")
    at, omega_n_rad = ln.PLAIN, 2.0 * np.pi * omega_n
    table = np.zeros((omega.size, at.n_columns))
    table[:, at.omega], table[:, at.period] = omega, 1.0 / omega
    table[:, at.push] = forcing / mass
    table[:, at.stiffness] = omega_n_rad**2
    table[:, at.damping] = 2.0 * zeta * omega_n_rad
    table[:, at.cubic] = alpha / mass
    table[:, at.h_min] = 1e-17 / np.maximum(omega, np.sqrt(table[:, at.stiffness]))
    table[:, at.h_max] = table[:, at.period]
    return prepared(at, [law], mass, table, **options)


def system_scenes(kernel_laws: Sequence[Law], exact: ExactScenes, **options: Any) -> Scenes:
    """Prepare systems; `run` then starts them as often as wanted.

    Parameters
    ----------
    kernel_laws : sequence of Law
        Of every contact; its parameters may be arrays, shape (n,).
    exact : ExactScenes
        The same systems, n of them, for the exact kernel: the equation of motion is the same.
    **options
        As in `prepared`.
    """
    at, given, rows = ln.Rows.of(exact.at), exact.at, exact.table[:-1]
    table = np.zeros((len(rows), at.n_columns))
    for name in ln.EQUATION:
        here, there, size = at.first[name], given.first[name], at.blocks[name]
        table[:, here : here + size] = rows[:, there : there + size]
    multiples = [
        rows[:, given.first[name] : given.first[name] + given.blocks[name]].max(axis=1, initial=1.0)
        for name in ("multiple", "depth_multiple")
    ]
    table[:, at.h_min] = 1e-17 / np.maximum(table[:, at.omega], np.sqrt(rows[:, given.fastest]))
    table[:, at.h_max] = table[:, at.period] / np.maximum(*multiples)
    return prepared(at, kernel_laws, np.ones(len(rows)), table, **options)


def prepared(
    at: ln.Rows,
    kernel_laws: Sequence[Law],
    mass: Array,
    table: Array,
    *,
    rtol: float,
    atol: float,
    controller: str,
    restart: bool = False,
) -> Scenes:
    """Scenes whose equations stand in a table; `scenes` and `system_scenes` make it.

    Parameters
    ----------
    rtol, atol : float
        Tolerances; error per step below ``atol + rtol * abs(y)``.
    controller : {"native", "ode45"}
        "ode45" is Dormand-Prince 5(4) with the step control of MATLAB's ode45.
    restart : bool
        Whether the step size is chosen anew at every located contact.
    """
    is_low = controller == "ode45" or rtol > _HIGH_ORDER_FROM
    method = tableaux.DP5 if is_low else tableaux.DOP853
    parts = [table]
    for law in kernel_laws:
        rows = law.rows(mass, len(table))
        # Where the tail of tanh, exp(-2 |z|), is far below the tolerance, its layer has no edge.
        reach = (3.0 - 0.5 * np.log(rtol)) / parameters.TANH_SATURATION
        rows[rows[:, parameters.SATURATION] > 0.0, parameters.LAYER] *= min(1.0, max(0.1, reach))
        parts.append(rows)
    has_layer, has_range = (
        any((rows[:, row] > 0.0).any() for rows in parts[1:])
        for row in (parameters.LAYER, parameters.RANGE)
    )
    settings = ln.Settings(
        rtol=rtol,
        atol=atol,
        bound=DIVERGED_AT,
        max_attempts=_MOST_ATTEMPTS,
        exponent=float(method.exponent),
        is_ode45=controller == "ode45",
        is_located=any(getattr(x.kind, "number", None) == laws.LOCATED for x in kernel_laws),
        restarts=restart,
        cuts_at_layers=has_layer and controller != "ode45",
        has_range=has_range,
    )
    return Scenes(at, tuple(law.kind for law in kernel_laws), np.hstack(parts), method, settings)


def run(
    prepared: Scenes,
    which: NDArray[np.intp],
    start: Array,
    t_0: Array,
    t_end: Array,
    record_from: Array,
    *,
    queue: NDArray[np.intp] | None = None,
    follows: NDArray[np.bool_] | None = None,
    section_only: bool = False,
    tangent: bool = False,
    dense_output: bool = False,
    contacts: bool = False,
) -> Run:
    """Integrate prepared systems from their starts.

    Parameters
    ----------
    prepared : Scenes
    which : ndarray of int, shape (n,)
        Number of the scene of each point.
    start : ndarray, shape (n, n_states)
        States at t_0.
    t_0, t_end, record_from : ndarray, shape (n,)
        Start, end, and start of recording [s]; ``record_from=inf`` records nothing.
    queue : ndarray of int, optional
        The points that follow none in the order in which lanes take them; default as they stand.
    follows : ndarray of bool, shape (n,), optional
        Which points begin where those before them end; default none. Their `start` is not read.
        What follows a failure has failed.
    section_only : bool
        Record section points alone: an extremum takes a probe or two.
    tangent : bool
        Carry the variational equations.
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
    at = prepared.at
    _set_starts(at, table, start, t_0, t_end, record_from)
    settings = prepared.settings._replace(
        tangent=tangent, dense=dense_output, contacts=contacts, section_only=section_only
    )
    follows = np.append(np.zeros(len(which), bool) if follows is None else follows, False)
    queue = np.flatnonzero(~follows[:-1]) if queue is None else queue
    order = queue, follows
    results, records = drained(at, prepared.kinds, prepared.method, table, order, settings)
    replay: dict[str, Any] = {"kinds": prepared.kinds, "tableau": prepared.method}
    replay |= {"table": table, "settings": settings}
    return _result(at, replay, results, records, t_0, t_end)


def _set_starts(
    at: ln.Rows, table: Array, start: Array, t_0: Array, t_end: Array, record_from: Array
) -> None:
    """Put starts and ends into copies of rows of `Scenes`."""
    omega = table[:, at.omega]
    phase = np.zeros(len(table))
    if t_0.any():
        phase[:] = [_phase(t, f) for t, f in zip(t_0.tolist(), omega.tolist(), strict=True)]
    table[:, at.q : at.q + at.n_states] = start
    table[:, at.tau] = table[:, at.phase_0] = phase
    # A clock that starts at a phase cannot tell shorter steps from none.
    coarse = CLOCK_ROUNDING * phase * table[:, at.period]
    table[:, at.h_min] = np.maximum(table[:, at.h_min], coarse)
    table[:, at.end_turns], table[:, at.end_tau] = _split_turns(phase, t_0, t_end, omega)
    table[:, at.record_turns] = phase + (np.maximum(record_from, t_0) - t_0) * omega


def _result(
    at: ln.Rows, replay: dict[str, Any], results: Array, records: Array, t_0: Array, t_end: Array
) -> Run:
    counts = {name: results[:, column].astype(np.int64) for name, column in _COUNTS.items()}
    # Inside, times count from t_0 so that a late start loses no digits.
    records[:, ln.E_T] += t_0[records[:, ln.E_POINT].astype(np.int64)]
    s = at.n_states
    ends = np.cumsum([ln.R_STATE, s, s * s])
    state, tangent, reach = np.split(results, ends, axis=1)[1:]
    return Run(
        at=at,
        state=state.copy(),
        t=t_end - results[:, ln.R_LEFT],
        reach=reach.copy(),
        tangent=tangent.reshape(-1, s, s).transpose(0, 2, 1).copy(),
        records=records,
        _replay=replay,
        **counts,
    )


_COUNTS = {
    "status": ln.R_STATUS,
    "n_contacts": ln.R_CONTACTS,
    "n_steps": ln.R_STEPS,
    "n_rejected": ln.R_REJECTED,
    "nfev": ln.R_NFEV,
}
