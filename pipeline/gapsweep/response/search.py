"""The search for the steady responses of many points at once: a table of states.

A point is one parameter set with one initial condition. Its search runs

    transient -> recording window -> period test -> Newton shooting -> basin check -> PERIODIC

and, where no orbit is found in time, on to

    Lyapunov exponent -> last window -> torus test -> QUASIPERIODIC, CHAOTIC or unresolved.

Every point is in one `State`. A state has a function: it takes all points in that state (or in one
of the few states that share it), moves or measures their motions, and returns the next state of
each. No point depends on another one's row. Forced and autonomous motions differ only in their
section: an `Ensemble` maps over forcing periods, a `PoincareMap` over returns, also called periods.
Thresholds and their reasons: `gapsweep.response.thresholds`.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.problem import is_late
from gapsweep.response import thresholds as limit
from gapsweep.response.answers import answers
from gapsweep.response.basin_check import basin_check, distances, is_slow
from gapsweep.response.classification import Classification, State
from gapsweep.response.compiled import contracting_multiples
from gapsweep.response.ensemble import ASTRAY, AT_REST, Ensemble
from gapsweep.response.equilibrium import linear_stability
from gapsweep.response.lyapunov import LyapunovExponents
from gapsweep.response.quasiperiodic import MOST_POINTS, persists, torus_test
from gapsweep.response.result import Responses, Steady
from gapsweep.response.scene import CONFIRMING_RTOL, TANGENT_RTOL
from gapsweep.response.section import (
    drifts,
    likely_multiple,
    norm,
    period_multiple,
    period_multiples,
    prime_multiple,
    repeat_nearly,
)
from gapsweep.response.shooting import NewtonShooting
from gapsweep.response.windows import RecordedWindows
from gapsweep.status import Status

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]
States = NDArray[np.int64]

# Function of each state, and the states that it may return in addition to the state itself. The
# first ones call the engine, for all points that wait for one function together; others decide.
TRANSITIONS: dict[State, tuple[str, tuple[State, ...]]] = {
    State.RECORD: ("integrate", (State.PERIOD_TEST, State.STOPPED)),
    State.APPROACH: ("integrate", (State.APPROACHED, State.STOPPED)),
    State.LAST_TRANSIENT: ("integrate", (State.TIME_OVER, State.STOPPED)),
    State.SHOOT: ("shoot", (State.ORBIT_FOUND, State.NO_ORBIT)),
    State.SHOOT_REPEAT: (
        "measure_orbit", (State.PERIODIC, State.CONFIRM, State.NEXT_WINDOW)),
    State.SHOOT_NOISY: ("measure_orbit", (State.PERIODIC, State.CONFIRM, State.CHAOS_TEST)),
    State.CONFIRM: ("confirm", (State.PERIODIC, State.UNCONFIRMED)),
    State.LYAPUNOV: ("measure_exponent", (State.LAST_WINDOW, State.STOPPED)),
    State.LAST_WINDOW: ("record_last", (State.PERIOD_TEST, State.QUASIPERIODIC, State.STOPPED)),
    State.TORUS_TEST: ("test_torus", (State.LAST_WINDOW, State.SIGN_TEST)),
    State.APPROACHED: ("check_approach", (State.PERIODIC, State.CONFIRM, State.NO_REPEAT)),
    State.PERIOD_TEST: ("test_period", (State.SHOOT, State.NO_REPEAT)),
    State.ORBIT_FOUND: ("reduce_period", (State.BASIN_CHECK, State.SHOOT, State.NO_ORBIT)),
    State.NO_ORBIT: ("restore_orbit", (State.BASIN_CHECK, State.NO_REPEAT)),
    State.BASIN_CHECK: (
        "check_basin", (State.PERIODIC, State.CONFIRM, State.APPROACH, State.NO_REPEAT)),
    State.NO_REPEAT: ("continue_window", (State.RECORD, State.REPEAT_TEST, State.NEXT_WINDOW)),
    State.REPEAT_TEST: ("test_repeat", (State.SHOOT_REPEAT, State.NEXT_WINDOW)),
    State.NEXT_WINDOW: (
        "schedule_window", (State.RECORD, State.LAST_TRANSIENT, State.TIME_OVER)),
    State.TIME_OVER: (
        "end_search", (State.LYAPUNOV, State.LAST_WINDOW, State.EXPONENT_TEST, State.LOCKED)),
    State.EXPONENT_TEST: ("test_exponent", (State.LYAPUNOV, State.TORUS_TEST, State.SIGN_TEST)),
    State.SIGN_TEST: (
        "test_sign",
        (State.RECORD, State.LAST_TRANSIENT, State.SHOOT_NOISY, State.CONFIRM, State.CHAOS_TEST,
         State.UNRESOLVED)),
    State.CHAOS_TEST: ("test_chaos", (State.CHAOTIC, State.GROWING, State.UNRESOLVED)),
    State.STOPPED: (
        "classify_stop",
        (State.EQUILIBRIUM, State.UNSTABLE_REST, State.NO_RETURN, State.FAILED)),
}  # fmt: skip


# Functions in the order in which they are called: decisions, windows, shots. The rest is left to
# the end, for all points to share.
_FUNCTIONS = [
    *dict.fromkeys(TRANSITIONS[s][0] for s in sorted(TRANSITIONS, key=State.APPROACHED.__gt__))
]
_AFTER_MOTION = np.array([State.PERIOD_TEST, State.APPROACHED, State.TIME_OVER])
_WINDOWS, _LAST_SHOT = map(_FUNCTIONS.index, ("integrate", "measure_orbit"))
# Number of each state's function; a class has none.
_FUNCTION = np.array(
    [_FUNCTIONS.index(TRANSITIONS[s][0]) if s in TRANSITIONS else len(_FUNCTIONS) for s in State]
)


class Search:
    """Search for the steady responses of an ensemble.

    Parameters
    ----------
    ensemble : Ensemble
    start : ndarray, shape (n_states, n)
        Initial states.
    steady : Steady
    """

    def __init__(self, ensemble: Ensemble, start: Array, steady: Steady) -> None:
        n, n_states = len(ensemble.omega), len(start)
        self._ensemble, self._steady = ensemble, steady
        self._windows = RecordedWindows(ensemble, start)
        self._shooting = NewtonShooting(n_states, n, ensemble.n_multipliers)
        # Ensembles that compute exponents and confirm orbits: the same if the solver is tight.
        self._exact, self._tight = map(ensemble.tight, (TANGENT_RTOL, CONFIRMING_RTOL))
        self._confirmed = NewtonShooting(n_states, n, ensemble.n_multipliers)
        self._exponents = LyapunovExponents(n_states, n)
        self._found = Classification(n)
        # Periods between windows, to settle, until the last window, and for an exponent or a torus.
        self._pause, self._settling, self._last, self._longest = time_budget(ensemble, steady)
        # Periods that the points integrate next: unrecorded, then added to the window.
        self._transient, self._recording = np.zeros((2, n), np.int64)
        self._is_settled, self._goal = np.zeros(n, bool), np.zeros(n)  # goal [m]: of an approach
        self._size = np.full(n, min(limit.FIRST_WINDOW, steady.n_periods))  # of the next window
        # A motion with scattered section points is near an orbit by chance: it is tested often.
        self._part = -(-steady.n_periods // (limit.WINDOW_PARTS if ensemble.is_noisy else 1))
        self._has_extension = np.zeros(n, bool)  # beyond the time limit
        self._verdict = np.full(n, int(State.EXPONENT_TEST))  # if the last window shows no orbit
        self.state = self._found.state
        self.state[:] = self._schedule(np.arange(n))

    def responses(self) -> Responses:
        """Advance all points until each has its class; return their responses."""
        while True:
            function = _FUNCTION[self.state]
            k = int(function.min())
            if is_late():
                late = function < len(_FUNCTIONS)
                self._windows.status[late], self.state[late] = Status.TIMED_OUT, State.FAILED
                break
            if k == len(_FUNCTIONS):
                break
            if k == _WINDOWS:  # most points wait for windows or shots: call what more of them need
                shots = function[(function > k) & (function <= _LAST_SHOT)]
                k = int(shots.min()) if len(shots) > np.count_nonzero(function == k) else k
            points = (function == k).nonzero()[0]
            self.state[points] = getattr(self, f"_{_FUNCTIONS[k]}")(points)
        return answers(self._windows, self._shooting, self._found, self._steady)

    # --- transient and recording window -----------------------------------------------------------

    def _schedule(self, points: Numbers) -> States:
        """Schedule a transient and a window, a full one from the second of a settled motion on."""
        windows, was_settled = self._windows, self._is_settled[points]
        n_left = self._last[points] - windows.n_periods[points]
        transient = np.minimum(self._pause[points], n_left)
        transient = self._ensemble.bounded_transient(transient, windows.n_periods[points])
        begin = windows.n_periods[points] + transient
        self._is_settled[points] = begin >= self._settling[points]
        self._size[points[was_settled]] = self._steady.n_periods
        # An exponent costs more than the first window of a settled motion.
        is_new = self._is_settled[points] & ~was_settled
        is_last = (begin + self._size[points] >= self._last[points]) & ~is_new
        part = np.where(self._is_settled[points], self._part, self._steady.n_periods)
        self._transient[points] = transient
        self._recording[points] = np.where(is_last, 0, np.minimum(self._size[points], part))
        windows.clear(points[~is_last])
        return np.where(is_last, State.LAST_TRANSIENT, State.RECORD)

    def _integrate(self, points: Numbers) -> States:
        """Integrate the next part of each point's transient and window; return the next states.

        A long motion takes several calls and keeps its state until the last of them. If a transient
        and the window after it cannot be chained, the window begins with the next call.
        """
        state, windows = self.state[points], self._windows
        transient, recording = self._transient[points], self._recording[points]
        # At most so many periods a call, so that other points need not wait for a long motion.
        n = self._ensemble.at_a_time(points, transient + recording)
        passed = np.minimum(transient, n)
        recorded = n - passed
        if not self._ensemble.is_chained:
            recorded[passed > 0] = 0
        windows.integrate(points, passed, recorded)
        self._transient[points], self._recording[points] = transient - passed, recording - recorded
        is_over = passed + recorded == transient + recording
        after = _AFTER_MOTION[state]
        is_ok = windows.status[points] == int(Status.OK)
        return np.where(is_ok, np.where(is_over, after, state), State.STOPPED)

    def _test_period(self, points: Numbers) -> States:
        """Start shooting for points whose window contracts to a periodic orbit."""
        windows = self._windows
        reach, resolution = windows.reach[points], windows.resolution(points)
        n = contracting_multiples(
            windows.section,
            windows.length,
            points,
            np.maximum(limit.CLOSE * reach, resolution),
            np.minimum(limit.ALIKE * reach, resolution),
            self._steady.max_period_multiple,
        )
        repeats = n > 0
        if repeats.any():
            shot, n, reach = points[repeats], n[repeats], reach[repeats]
            # Newton's method cannot close an orbit better than the solver's noise.
            goal = np.maximum(limit.NEWTON_GOAL * reach, 0.1 * resolution[repeats])
            noise = windows.noise(shot) * np.sqrt(n)
            self._shooting.start(
                shot, windows.y[:, shot], n, goal, noise, limit.NEWTON_RANGE * reach
            )
        return np.where(repeats, State.SHOOT, State.NO_REPEAT)

    def _continue_window(self, points: Numbers) -> States:
        """Record the rest of the window; once it is full and the motion has settled, test whether
        it repeats itself although shooting found no orbit.
        """
        length, full = self._windows.length[points], self._steady.n_periods
        left = np.maximum(np.minimum(self._size[points], full) - length, 0)
        goes_on = left > 0
        self._transient[points[goes_on]] = 0
        self._recording[points[goes_on]] = np.minimum(left, self._part)[goes_on]
        may_repeat = self._is_settled[points] & (length >= full)
        after = np.where(may_repeat, State.REPEAT_TEST, State.NEXT_WINDOW)
        return np.where(goes_on, State.RECORD, after)

    def _schedule_window(self, points: Numbers) -> States:
        """Schedule another window, twice as long as the one before, if there is time."""
        has_time = self._windows.n_periods[points] < self._last[points]
        again, after = points[has_time], np.full(len(points), State.TIME_OVER)
        self._size[again] = np.minimum(2 * self._size[again], self._steady.n_periods)
        after[has_time] = self._schedule(again)
        return after

    # --- periodic orbits --------------------------------------------------------------------------

    def _shoot(self, points: Numbers) -> States:
        """Do one Newton step on the map over the orbit's periods."""
        is_found, is_lost = self._step(points, self._ensemble, self._shooting)
        return np.where(is_found, State.ORBIT_FOUND, np.where(is_lost, State.NO_ORBIT, State.SHOOT))

    def _step(
        self, points: Numbers, ensemble: Ensemble, shooting: NewtonShooting
    ) -> tuple[Mask, Mask]:
        """Do one Newton step; return which points found their orbit, and which are lost."""
        y, n = shooting.y[:, points], shooting.n[points]
        call = ensemble.call(points, y, n, np.zeros(len(n)), tangent=True)
        return shooting.step(points, call)

    def _reduce_period(self, points: Numbers) -> States:
        """Shoot over a part of the period if the orbit's points repeat after that part."""
        modulus = np.abs(self._shooting.multipliers[points, 0])
        is_stable = modulus < limit.STABLE
        inside, reach = points[is_stable], self._windows.reach[points[is_stable]]
        # Kinks that are not located scatter a section more than its predicted noise.
        is_noisy = self._ensemble.is_noisy
        scatter = (limit.KINK_SCATTER if is_noisy else 1.0) * self._windows.resolution(inside)
        # A slow orbit of several periods is only known up to the amplified noise.
        amplified = np.minimum(scatter / (1.0 - modulus[is_stable]), limit.NEAR * reach)
        part = self._shooting.parts(
            inside, np.maximum(np.maximum(scatter, limit.SAME_POINT * reach), amplified)
        )
        is_whole = part == self._shooting.n[inside]
        self._shooting.shorten(inside[~is_whole], part[~is_whole], is_scattered=is_noisy)
        after = np.full(len(points), State.NO_ORBIT)
        after[is_stable] = np.where(is_whole, State.BASIN_CHECK, State.SHOOT)
        return after

    def _restore_orbit(self, points: Numbers) -> States:
        """Restore the longer orbit if no shorter one is stable."""
        return np.where(self._shooting.restore(points), State.BASIN_CHECK, State.NO_REPEAT)

    def _check_basin(self, points: Numbers) -> States:
        """Test whether the motion approaches the orbit, which may be another attractor.

        If not, the motion is integrated for as long as the slowest multiplier needs to bring it
        near, and must be near then. If that would exceed the time limit, a motion near its orbit
        must have come nearer over its window, by at least half as much as the multiplier predicts.
        """
        windows, full = self._windows, self._steady.n_periods
        slow = is_slow(self._shooting, points, full)
        seen = basin_check(windows, self._shooting, points, slow)
        n_left = self._last[points] - windows.n_periods[points]
        waits = ~seen.is_own & (seen.stretch <= n_left)
        away, n, self._goal[points] = points[waits], self._shooting.n[points[waits]], seen.goal
        windows.clear(points[waits & slow])
        # Whole periods of the orbit: in the end the motion must be near the orbit's start.
        self._transient[away] = seen.stretch[waits]
        self._recording[away] = np.where(slow[waits], np.maximum(full // n, 1) * n, 0)
        stays = ~seen.is_own & ~waits
        is_own = seen.is_own | (stays & seen.has_shrunk & seen.is_near)
        accepted = self._accept(points[is_own])
        return np.where(is_own, accepted, np.where(waits, State.APPROACH, State.NO_REPEAT))

    def _check_approach(self, points: Numbers) -> States:
        """Test whether the motion has come near its orbit; if not, continue its window."""
        windows = self._windows
        slow = is_slow(self._shooting, points, self._steady.n_periods)
        is_near = distances(windows, self._shooting, points, slow) <= self._goal[points]
        accepted = self._accept(points[is_near])
        away = points[~is_near]
        # A window that is continued begins again: the part not recorded would be missing in it.
        windows.clear(away[windows.length[away] < self._size[away]])
        begin = windows.n_periods[away] - windows.length[away]
        self._is_settled[away] |= begin >= self._settling[away]
        return np.where(is_near, accepted, State.NO_REPEAT)

    def _accept(
        self, points: Numbers, *, is_noisy: Mask | bool = False, y: Array | None = None
    ) -> State:
        """Return the next state of points with a found orbit: periodic, or confirmation first.

        Shooting at tight tolerances, which confirms orbits, is started.

        `points`: shape (m,).
        `is_noisy`: shape (m,); whether an orbit keeps its measured Lyapunov exponent, which decides
        its class if it is not confirmed; the exponents of all others become NaN.
        `y`: shape (n_states, m); states in which shooting starts; None: those of the found orbits.
        """
        forgets = points[np.broadcast_to(~np.asarray(is_noisy), len(points))]
        self._found.lyapunov[forgets] = self._found.lyapunov_error[forgets] = np.nan
        if self._exact is self._ensemble:
            return State.PERIODIC
        reach, n = self._windows.reach[points], self._shooting.n[points]
        # Without damping Newton's method has no step: only the multipliers are computed.
        is_undamped = self._ensemble.settling_rate[points] == 0.0
        goal = np.where(is_undamped, np.inf, limit.SAME_POINT * reach)
        noise = self._tight.solver.rtol / self._ensemble.solver.rtol * self._windows.noise(points)
        furthest = limit.NEWTON_RANGE * reach
        y = self._shooting.y[:, points] if y is None else y
        self._confirmed.start(points, y, n, goal, noise * np.sqrt(n), furthest)
        return State.CONFIRM

    def _confirm(self, points: Numbers) -> States:
        """Do one Newton step at tight tolerances to confirm that a stable, prime orbit exists."""
        confirmed, reach = self._confirmed, self._windows.reach[points]
        is_found, is_lost = self._step(points, self._tight, confirmed)
        stays = is_found & (np.abs(confirmed.multipliers[points, 0]) < self._bound(points))
        stable = points[stays]
        part = confirmed.parts(stable, 10.0 * limit.SAME_POINT * reach[stays])
        is_whole = part == confirmed.n[stable]
        stays[stays] = is_whole
        if self._ensemble.is_noisy:  # its errors may have hidden a shorter period
            confirmed.shorten(stable[~is_whole], part[~is_whole], is_scattered=True)
            is_found[np.isin(points, stable[~is_whole])] = False
        self._shooting.n[points[stays]] = confirmed.n[points[stays]]
        self._shooting.multipliers[points] = np.where(
            is_found[:, None], confirmed.multipliers[points], np.nan
        )
        after = np.where(is_found | is_lost, State.UNCONFIRMED, State.CONFIRM)
        return np.where(stays, State.PERIODIC, after)

    def _bound(self, points: Numbers, largest: float = limit.STABLE) -> Array:
        """Moduli of multipliers below which orbits are stable; just above 1 without damping."""
        on_circle = 1.0 + max(limit.ON_CIRCLE, self._ensemble.solver.rtol)
        return np.where(self._ensemble.settling_rate[points] == 0.0, on_circle, largest)

    def _test_repeat(self, points: Numbers) -> States:
        """Test whether a settled motion repeats itself, although shooting found no orbit.

        At loose tolerances the solver's noise exceeds every allowed Newton residual. A motion that
        repeats less well, or not for long, drifts where there is no orbit, or on a torus.
        """
        windows, largest = self._windows, self._steady.max_period_multiple
        resolution = windows.resolution(points)
        found = period_multiples(windows.section, windows.length, points, resolution, largest)
        found *= persists(windows, points, found > 0, self._longest[points], largest)
        some = found > 0
        for point, n, noise in zip(
            *(each[some].tolist() for each in (points, found, resolution)), strict=True
        ):
            # Does it repeat sooner, within this larger tolerance?
            section = windows.window(point)
            n = prime_multiple(section[:, -n:], noise * math.sqrt(n))
            if not self._ensemble.has_own_tangent:
                # A kink that is not located scatters more than that.
                sooner = likely_multiple(section, limit.CLOSE * windows.reach[point], n)
                n = sooner if sooner and n % sooner == 0 else n
            self._start_measurement(point, n)
        return np.where(found > 0, State.SHOOT_REPEAT, State.NEXT_WINDOW)

    def _start_measurement(self, point: int, n: int) -> None:
        """Take the next n periods of a motion as an orbit, closed or not."""
        one, anywhere, nowhere = np.array([point]), np.array([math.inf]), np.zeros(1)
        noise = self._windows.noise(one, n)
        y = self._windows.y[:, one]
        self._shooting.start(one, y, np.array([n]), anywhere, noise, nowhere)

    def _measure_orbit(self, points: Numbers) -> States:
        """Test whether an orbit taken from the motion is stable, by its multipliers."""
        shooting, ensemble, windows = self._shooting, self._ensemble, self._windows
        is_found, _ = self._step(points, ensemble, shooting)
        modulus = np.abs(shooting.multipliers[points, 0])
        stays = is_found & (modulus < self._bound(points, 1.0))
        if ensemble.has_own_tangent:
            # Newton multiplies the solver's error in a period by 1 / (1 - modulus): far for a slow
            # orbit, and the motion is on it if it had the time to settle.
            is_near = shooting.last_step[points] <= limit.NEAR * windows.reach[points]
            is_near |= ensemble.has_families[points]  # of orbits: Newton has no step
            has_settled = is_slow(shooting, points, self._steady.n_periods) & stays
            has_settled &= windows.n_periods[points] >= self._last[points]
            n_repeats = (windows.n_periods[points] / shooting.n[points])[has_settled]
            has_settled[has_settled] = modulus[has_settled] ** n_repeats <= limit.NEAR
            stays &= is_near | has_settled
        is_repeat = self.state[points] == State.SHOOT_REPEAT
        accepted = self._accept(points[stays], is_noisy=~is_repeat[stays])
        after = np.where(is_repeat, State.NEXT_WINDOW, State.CHAOS_TEST)
        return np.where(stays, accepted, after)

    # --- aperiodic motions ------------------------------------------------------------------------

    def _end_search(self, points: Numbers) -> States:
        """Measure the exponent after the time limit, then record the last window, then classify.

        In this order, because transient chaos may end while the exponent is measured. A class is
        based on the last window of the motion.
        """
        exponents, rate = self._exponents, self._ensemble.settling_rate[points]
        # A motion without enough time to settle has no class; without damping no time is enough.
        grows = self._is_settled[points] & (rate > 0.0) & (exponents.n_periods[points] == 0)
        grows &= exponents.n_least <= self._longest[points]
        new = points[grows]
        spent = self._last[new] - self._steady.n_periods
        exponents.start(new, self._windows.y[:, new], rate[grows], self._ensemble.omega[new], spent)
        is_recorded = self._windows.has_extrema(points)
        after = np.where(is_recorded, self._verdict[points], State.LAST_WINDOW)
        return np.where(grows, State.LYAPUNOV, after)

    def _measure_exponent(self, points: Numbers) -> States:
        """Integrate the next blocks with the tangent; set exponents of finished measurements."""
        exponents, found, after = self._exponents, self._found, self.state[points]
        over, status = exponents.advance(self._exact, points)
        is_ok = status == Status.OK
        # A motion that failed did so within the next block.
        elapsed = (exponents.n_blocks[over] + ~is_ok) * exponents.n_periods[over]
        self._windows.move_to(over, exponents.y[:, over], status, elapsed)
        known = over[is_ok]
        found.lyapunov[known], found.lyapunov_error[known] = exponents.exponents(known)
        after[np.searchsorted(points, over)] = np.where(is_ok, State.LAST_WINDOW, State.STOPPED)
        return after

    def _record_last(self, points: Numbers) -> States:
        """Record a whole window with all events: the response, if the window shows no orbit."""
        windows, full = self._windows, np.full(len(points), self._steady.n_periods)
        windows.clear(points)
        windows.integrate(points, np.zeros_like(full), full, section_only=False)
        is_torus = self._verdict[points] == State.QUASIPERIODIC
        is_ok = windows.status[points] == Status.OK
        return np.where(
            is_ok, np.where(is_torus, State.QUASIPERIODIC, State.PERIOD_TEST), State.STOPPED
        )

    def _is_zero(self, points: Numbers) -> tuple[Mask, Mask]:
        """Whether exponents are zero after a long measurement; whether they may be (torus)."""
        exponent, error = self._found.lyapunov[points], self._found.lyapunov_error[points]
        shear = self._exponents.linear_growth(points, self._ensemble.omega[points])
        # Disturbances on a torus shrink and grow in turn, by less than they grow in the long run.
        high = np.maximum(limit.SURE * error, shear)
        low = -np.maximum(limit.SURE * error, 0.5 * shear)
        is_zero = self._exponents.is_long(points) & (low <= exponent) & (exponent <= high)
        may_be = np.abs(exponent) <= np.maximum(limit.BEYOND_DOUBT * error, shear)
        return is_zero, may_be & (len(self._windows.y) > 2)

    def _test_exponent(self, points: Numbers) -> States:
        """Double the measurement until the exponent is surely not zero and has the standard error
        that the user requested, or until the time is over.
        """
        exponents, steady = self._exponents, self._steady
        exponent, error = self._found.lyapunov[points], self._found.lyapunov_error[points]
        is_zero, may_be_zero = self._is_zero(points)
        is_long = exponents.is_long(points)
        n_doubled = 2 * exponents.n_all_periods(points)
        is_undecided = (may_be_zero | (np.abs(exponent) <= limit.SURE * error)) & ~is_long
        wanted = steady.lyapunov_error  # a short measurement may miss intermittent chaos
        is_rough = np.full(len(points), wanted is not None) & (~is_long | (error > (wanted or 0.0)))
        # The longer a tangent of another solver, the less it belongs to the motion.
        goes_on = is_undecided | (is_rough & (n_doubled <= steady.max_periods))
        goes_on &= self._ensemble.has_own_tangent & (n_doubled <= self._longest[points])
        goes_on &= exponents.n_periods[points] > 0  # without damping no measurement was started
        exponents.extend(points[goes_on], self._windows.y[:, points[goes_on]])
        may_be_torus = may_be_zero & (~is_long | is_zero | (exponent > 0.0))
        after = np.where(may_be_torus, State.TORUS_TEST, State.SIGN_TEST)
        return np.where(goes_on, State.LYAPUNOV, after)

    def _test_torus(self, points: Numbers) -> States:
        """Integrate motions long enough to recognise a torus, and test for it.

        Tested are points with windows of one kind, as many as fit in memory; the others wait.
        """
        is_zero, _ = self._is_zero(points)
        kind = np.where(is_zero, 0, np.where(self._exponents.is_long(points), 1, 2))
        windows = (limit.ZERO_WINDOWS, limit.LONG_WINDOWS, limit.SHORT_WINDOWS)[kind[0]]
        tested = np.flatnonzero(kind == kind[0])[: MOST_POINTS // max(windows)]
        some, after = points[tested], self.state[points]
        seen = torus_test(self._windows, some, windows, self._longest[some])
        at = seen.is_torus | seen.is_locked  # settling takes longer than damping predicts
        verdict = np.where(seen.is_torus, State.QUASIPERIODIC, State.LOCKED)
        self._verdict[some[at]] = verdict[at]
        status = self._windows.status[some[at]]
        self._windows.move_to(some[at], seen.y[:, at], status, seen.n_periods[at])
        after[tested] = np.where(at, State.LAST_WINDOW, State.SIGN_TEST)
        return after

    def _test_sign(self, points: Numbers) -> States:
        """Give contracting motions more time, or search an orbit with scattered section points."""
        exponent, error = self._found.lyapunov[points], self._found.lyapunov_error[points]
        is_zero, _ = self._is_zero(points)
        after = np.where(is_zero, State.UNRESOLVED, State.CHAOS_TEST)
        contracts = exponent < -limit.SURE * error
        is_extended = contracts.copy()
        is_extended[contracts] = self._extend(points[contracts], exponent[contracts])
        after[is_extended] = self._schedule(points[is_extended])
        if not self._ensemble.has_own_tangent:
            for k in np.flatnonzero(contracts & ~is_extended).tolist():
                after[k] = self._noisy_orbit(int(points[k]))
        return after

    def _extend(self, points: Numbers, exponent: Array) -> Mask:
        """Extend the search, once, by the time to settle at the exponent's rate; True if extended.

        Damping may have predicted faster settling.
        """
        n_periods = np.ceil(math.log(limit.REST) / exponent * self._exponents.omega(points))
        may = n_periods <= np.minimum(self._longest[points], limit.MOST_EXTENSION)
        may &= ~self._has_extension[points]
        some, n_periods = points[may], n_periods[may].astype(np.int64)
        self._last[some] = self._windows.n_periods[some] + n_periods
        self._pause[some] = np.maximum(n_periods // limit.EXTENSION_WINDOWS, 1)
        self._has_extension[some] = True
        self._windows.discard_extrema(some)
        return np.asarray(may)

    def _noisy_orbit(self, point: int) -> State:
        """Test whether a contracting motion is periodic, but scattered by solver errors.

        At a kink that is not located the error of a step exceeds its estimate. The tangent has a
        different solver, so that the exponent distinguishes scatter from chaos; a motion with more
        scatter than solver errors is a transient or has another period. With a loose solver it must
        scatter about the orbit on which the tight solver has settled.
        """
        windows, largest = self._windows, self._steady.max_period_multiple
        window, reach = windows.window(point), windows.reach[point]
        allowed = limit.DEVIATIONS * self._scatter(point)
        if self._exact is self._ensemble:
            n = likely_multiple(window, limit.CLOSE * reach, largest, allowed)
            if n:
                self._start_measurement(point, n)
            return State.SHOOT_NOISY if n else State.CHAOS_TEST
        one, y = np.array([point]), self._exponents.y[:, [point]]
        call = self._exact.call(one, y, windows.length[one], np.zeros(1))
        n = period_multiple(call.section, limit.ALIKE * reach, largest)
        shifted = [np.roll(call.section, k, axis=1)[:, n:] for k in range(n)]
        apart = [np.square(norm(window[:, n:] - orbit)).mean() for orbit in shifted]
        if not apart or math.sqrt(min(apart)) > min(allowed, limit.NEWTON_RANGE * reach):
            return State.CHAOS_TEST
        self._start_measurement(point, n)
        self._shooting.omega[point] = self._ensemble.omega[point]
        return self._accept(one, is_noisy=True, y=call.y)

    def _scatter(self, point: int) -> float:
        """RMS distance [m] of two section points of one phase that is due to solver errors.

        The solver errors of the periods add up in random directions, and shrink with the exponent,
        which is < 0.
        """
        y = self._windows.window(point) * self._ensemble.unit[:, [point]]
        n, never = np.ones(y.shape[1], np.int64), np.full(y.shape[1], np.inf)
        shrinks = 2.0 * self._found.lyapunov[point]
        call = self._ensemble.call(n * point, y, n, never, tangent=True)
        strayed = math.sqrt(float(np.square(call.strayed).mean()))
        return math.sqrt(2.0 / -math.expm1(shrinks / self._ensemble.omega[point])) * strayed

    def _test_chaos(self, points: Numbers) -> States:
        """Test for chaos: positive exponent, section without repetition, and bounded motion."""
        windows, largest = self._windows, self._steady.max_period_multiple
        # Disturbances of an unstable orbit grow, too; near a bifurcation so slowly that the motion
        # stays near it, but then it repeats itself.
        section, length = windows.section[:, points], windows.length[points]
        is_alike = repeat_nearly(section, length, windows.step_error(points), largest)
        exponent, error = self._found.lyapunov[points], self._found.lyapunov_error[points]
        unlike = (exponent >= -limit.SURE * error) & ~is_alike
        grows = drifts(section[: self._ensemble.n_coordinates], length) & unlike
        unlike &= ~grows
        grows[unlike] = ~self._ensemble.stays_bounded(points[unlike], windows.y[:, points[unlike]])
        is_chaotic = (exponent > limit.SURE * error) & ~is_alike
        after = np.where(is_chaotic, State.CHAOTIC, State.UNRESOLVED)
        return np.where(grows, State.GROWING, after)

    def _classify_stop(self, points: Numbers) -> States:
        """Classify motions that did not reach their end: at rest, without return, or failed."""
        found, status = self._found, self._windows.status[points]
        after = np.where(status == ASTRAY, State.NO_RETURN, State.FAILED)
        for k in np.flatnonzero(status == AT_REST).tolist():
            point = int(points[k])
            rate, offset = linear_stability(self._ensemble, point, self._windows.y[:, point])
            found.lyapunov[point], found.lyapunov_error[point] = rate, 0.0
            found.offset[point] = offset
            after[k] = State.UNSTABLE_REST if rate > 0.0 else State.EQUILIBRIUM
        return after


def time_budget(ensemble: Ensemble, steady: Steady) -> tuple[Any, Any, Any, Array]:
    """Return the time limits of a search in periods, each of shape (n,).

    Returns
    -------
    pause, settling, last : ndarray of int
        Periods between windows, to settle, and until the last window.
    longest : ndarray
        Periods of each later measurement of an exponent or a torus; infinity without `t_max`.
    """
    rate, omega = ensemble.settling_rate, ensemble.omega
    # Without damping no motion settles: one that does not repeat at once never will.
    with np.errstate(over="ignore"):
        decay_periods = np.divide(omega, rate, out=np.zeros(len(rate)), where=rate > 0.0)
    shares = 1.0 / limit.TRANSIENT_SHARE, 1.0 / steady.settle_tol
    times = np.array([*map(math.log, shares), steady.max_decay_times])[:, None]
    pause, settling, longest = np.ceil(
        np.minimum(times * decay_periods, limit.MOST_PERIODS)
    ).astype(np.int64)
    # A full window more: with slow forcing there is no period between settling and the end.
    last = np.maximum(settling, np.minimum(longest, steady.max_periods)) + steady.n_periods
    at_a_time = omega * (math.inf if steady.t_max is None else steady.t_max)
    last = np.floor(np.minimum(last, np.maximum(1.0, at_a_time))).astype(np.int64)
    return np.maximum(1, np.minimum(pause, last)), settling, last, at_a_time
