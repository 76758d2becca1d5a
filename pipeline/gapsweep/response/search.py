"""The search for steady responses of many points at once; see `gapsweep.response.respond`.

Every point is in a `Phase`, which says what it waits for. All that wait for a stretch of motion
share a call of the engine, so do all that shoot at an orbit, and all whose disturbance grows.
Arithmetic and decisions are on columns: none of them sees another point's row.
"""

import math
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.answers import answers
from gapsweep.response.approach import NEAR, approach, farthest, is_slow
from gapsweep.response.ensemble import ASTRAY, AT_REST, Ensemble
from gapsweep.response.found import SURE, Found, Phase
from gapsweep.response.limits import Limits
from gapsweep.response.rates import REST, about_rest
from gapsweep.response.result import Responses, Steady
from gapsweep.response.section import (
    ALIKE,
    DEVIATIONS,
    converging_multiples,
    likely_multiple,
    period_multiples,
    prime_multiple,
    repeat_nearly,
)
from gapsweep.response.shooting import Growths, Shots
from gapsweep.response.tori import LONG, SHORT, ZERO, stay, stay_within, watch
from gapsweep.response.walks import Walks
from gapsweep.status import Status

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]
Answer = Callable[..., None]


def _for_some(method: Answer) -> Answer:
    """A branch that no point takes costs nothing: at most turns a few of them have any."""

    @wraps(method)
    def guarded(self: "Search", points: Numbers, *columns: Any) -> None:
        if points.size:
            method(self, points, *columns)

    return guarded


_FIRST_WINDOW = 5
_LOOKS = 4
# Forcing periods at most for what shrinks slower than damping says, and looks at it.
_PATIENCE, _LOOKS_LATER = 1e5, 8
# Shooting is worth a try when section points repeat within this share of the reach.
_CLOSE = 0.1
# Newton may move this share of the response's reach; from farther away it leads anywhere.
_SMALL_STEP = 0.2
# A multiplier this close to the circle belongs to a bifurcation: shooting decides nothing there.
_INSIDE = 1.0 - 1e-6
_SCATTERED = 10.0  # times the predicted noise, of a section that its solver scatters
_ON_CIRCLE = 1e-6  # how near to 1 an undamped orbit's multipliers are found
# Of ten batches, chance alone exceeds that once in 130 times; this, once in ten thousand.
_BEYOND_DOUBT = 6.0


class Search:
    """Steady responses of an ensemble.

    Parameters
    ----------
    ensemble : Ensemble
    start : ndarray, shape (n_states, n)
        States to start from.
    steady : Steady
    """

    def __init__(self, ensemble: Ensemble, start: Array, steady: Steady) -> None:
        n = len(ensemble.omega)
        self._ensemble, self._steady = ensemble, steady
        self._omega, self._walks = ensemble.omega, Walks(ensemble, start)
        n_states = len(start)
        self._shots = Shots(n_states, n, n_states - int(ensemble.is_free))
        self._growths = Growths(n_states, n)
        self._limits = Limits.of(ensemble, steady)
        # Forcing periods of the stretch waited for: unrecorded, then added to the window.
        self._pause, self._window = np.zeros((2, n), np.int64)
        self._settled, self._goal = np.zeros(n, bool), np.zeros(n)  # goal: distance from an orbit
        self._look = np.full(n, min(_FIRST_WINDOW, steady.n_periods))  # size of the next window
        # Forcing periods after which a full window is looked at: rattled motions come near their
        # orbits by chance, and are looked at before it is full, too.
        self._portion = -(-steady.n_periods // (_LOOKS if ensemble.is_rattled else 1))
        self._found = Found(n)
        self._has_time, self._has_waited = np.zeros((2, n), bool)  # beyond the limits
        self._phase = np.full(n, int(Phase.LOOK))
        self._wait(np.arange(n))

    def responses(self) -> Responses:
        """Advance all points until each has its answer."""
        while (self._phase < Phase.ENDED).any():
            phase = self._phase
            moves, shoots = phase < Phase.LAST, (phase > Phase.LAST) & (phase < Phase.GROW)
            last, grows = phase == Phase.LAST, phase == Phase.GROW
            # What most points wait for; last what is best shared by all.
            if shoots.sum() > moves.sum():
                self._shoot(np.flatnonzero(shoots))
            elif moves.any():
                self._advance(np.flatnonzero(moves))
            elif grows.any():
                self._grown(*self._growths.advance(self._ensemble, np.flatnonzero(grows)))
            elif last.any():
                self._advance_last(np.flatnonzero(last))
            else:
                self._tell(np.flatnonzero(phase == Phase.TELL))
        return answers(self._ensemble, self._walks, self._shots, self._found, self._steady)

    def _advance(self, points: Numbers) -> None:
        """Pauses and the windows after them in one call: no lane waits in between."""
        phase, pause, window = self._phase[points], self._pause[points], self._window[points]
        # A long stretch goes on in the next call: the others need not wait for it.
        n = self._ensemble.at_a_time(points, pause + window)
        paused = np.minimum(pause, n)
        recorded = n - paused
        if not self._ensemble.is_chained:
            recorded[paused > 0] = 0
        self._walks.advance(points, paused, recorded)
        self._pause[points], self._window[points] = pause - paused, window - recorded
        is_ok = self._walks.status[points] == Status.OK
        self._fail(points[~is_ok])
        is_over = is_ok & (paused + recorded == pause + window)
        self._look_at(points[is_over & (phase == Phase.LOOK)])
        self._arrive(points[is_over & (phase == Phase.APPROACH)])
        self._finish(points[is_over & (phase == Phase.PAUSE)])

    def _ask(self, points: Numbers, phase: int, pause: Any, window: Any) -> None:
        """Wait for a stretch of motion."""
        self._phase[points], self._pause[points], self._window[points] = phase, pause, window

    def _advance_last(self, points: Numbers) -> None:
        self._walks.advance(points, self._pause[points], self._window[points], section_only=False)
        is_ok = self._walks.status[points] == Status.OK
        self._fail(points[~is_ok])
        self._phase[points] = Phase.ENDED  # of a torus, and of what failed
        self._look_at(points[is_ok & ~self._found.is_quasiperiodic[points]])

    @_for_some
    def _wait(self, points: Numbers) -> None:
        """A pause, then a window: a full one from the second of a settled motion on."""
        limits, was_settled = self._limits, self._settled[points]
        n_left = limits.last[points] - self._walks.n_periods[points]
        pause = np.minimum(limits.pause[points], n_left)
        if self._ensemble.is_free:  # where growth sets in, damping about rest says nothing
            pause = np.minimum(pause, np.maximum(self._walks.n_periods[points], _FIRST_WINDOW))
        begin = self._walks.n_periods[points] + pause
        self._settled[points] = begin >= limits.settled[points]
        self._look[points[was_settled]] = self._steady.n_periods
        # A growth costs more than the first look at a settled motion.
        is_new = self._settled[points] & ~was_settled
        is_last = (begin + self._look[points] >= limits.last[points]) & ~is_new
        self._ask(points[is_last], Phase.PAUSE, pause[is_last], 0)
        others = points[~is_last]
        self._walks.forget(others)
        portion = np.where(self._settled[others], self._portion, self._steady.n_periods)
        self._ask(others, Phase.LOOK, pause[~is_last], np.minimum(self._look[others], portion))

    @_for_some
    def _record_last(self, points: Numbers) -> None:
        """A whole window, for the motion may be what is left when no orbit is found."""
        self._walks.forget(points)
        self._ask(points, Phase.LAST, 0, self._steady.n_periods)

    @_for_some
    def _look_at(self, points: Numbers) -> None:
        """Shoot where the window contracts to a repeat."""
        reach, same = self._walks.reach[points], self._walks.same[points]
        n = converging_multiples(
            self._walks.section,
            self._walks.length,
            points,
            np.maximum(_CLOSE * reach, same),
            np.minimum(ALIKE * reach, same),
            self._steady.max_period_multiple,
        )
        shot = points[n > 0]
        # Below the solver's own noise Newton makes no orbit close better.
        goal = np.maximum(1e-10 * reach, 0.1 * same)[n > 0]
        noise = self._walks.noise()[shot] * np.sqrt(n[n > 0])
        furthest = _SMALL_STEP * reach[n > 0]
        self._shots.aim(shot, self._walks.y[:, shot], n[n > 0], goal, noise, furthest)
        self._phase[shot] = Phase.SHOOT
        self._go_on(points[n == 0])

    @_for_some
    def _go_on(self, points: Numbers) -> None:
        """No orbit so far: the rest of the window, or, once it is full and the motion has settled,
        whether that repeats itself all the same.
        """
        length, full = self._walks.length[points], self._steady.n_periods
        left = np.maximum(np.minimum(self._look[points], full) - length, 0)
        goes_on = left > 0
        self._ask(points[goes_on], Phase.LOOK, 0, np.minimum(left[goes_on], self._portion))
        may_repeat = ~goes_on & self._settled[points] & (length >= full)
        self._repeat(points[may_repeat])
        self._end_look(points[~(goes_on | may_repeat)])

    def _shoot(self, points: Numbers) -> None:
        phase = self._phase[points]
        is_found, is_lost = self._shots.advance(self._ensemble, points)
        self._hit(points[is_found], phase[is_found])
        self._miss(points[is_lost], phase[is_lost])

    @_for_some
    def _hit(self, points: Numbers, phase: Counts) -> None:
        """Shots that found an orbit."""
        modulus = np.abs(self._shots.multipliers[points, 0])
        shooting = phase == Phase.SHOOT
        inside = points[shooting & (modulus < _INSIDE)]
        # Kinks that are not located scatter a section more than its predicted noise.
        is_rattled = self._ensemble.is_rattled
        same = (_SCATTERED if is_rattled else 1.0) * self._walks.same
        tolerance = np.maximum(same, 1e-6 * self._walks.reach)[inside]
        # A slow orbit of several periods is not known any better than noise is amplified.
        amplified = same[inside] / (1.0 - np.abs(self._shots.multipliers[inside, 0]))
        near = NEAR * self._walks.reach[inside]
        part = self._shots.parts(inside, np.maximum(tolerance, np.minimum(amplified, near)))
        is_whole = part == self._shots.n[inside]
        self._compare(inside[is_whole])
        self._shots.shorten(inside[~is_whole], part[~is_whole], is_scattered=is_rattled)
        is_undamped = self._ensemble.settling_rate[points] == 0.0
        on_circle = 1.0 + max(_ON_CIRCLE, self._ensemble.solver.rtol)
        stays = modulus < np.where(is_undamped, on_circle, 1.0)
        if self._ensemble.has_own_tangent:
            # Newton multiplies what the solver strays in a period by 1 / (1 - modulus): about a
            # slow orbit that is far, and the motion is there if it had the time to settle.
            is_near = self._shots.last_step[points] <= NEAR * self._walks.reach[points]
            if self._ensemble.is_free:  # undamped orbits form families: Newton has no step
                is_near |= is_undamped
            has_settled = is_slow(self._shots, points, self._steady.n_periods) & stays
            has_settled &= self._walks.n_periods[points] >= self._limits.last[points]
            n_repeats = (self._walks.n_periods[points] / self._shots.n[points])[has_settled]
            has_settled[has_settled] = modulus[has_settled] ** n_repeats <= NEAR
            stays &= is_near | has_settled
        self._close(points[~shooting & stays])
        refused = ~np.where(shooting, modulus < _INSIDE, stays)
        self._miss(points[refused], phase[refused])

    @_for_some
    def _miss(self, points: Numbers, phase: Counts) -> None:
        """Shots without an orbit that may be the motion's own."""
        shot = points[phase == Phase.SHOOT]
        is_part = self._shots.restore(shot)
        self._compare(shot[is_part])
        self._go_on(shot[~is_part])
        self._end_look(points[phase == Phase.REPEAT])
        self._aperiodic(points[phase == Phase.RATTLE])

    @_for_some
    def _compare(self, points: Numbers) -> None:
        """Whether the motion itself approaches an orbit: the guard against a swapped attractor.

        Else it goes on for as long as its slowest multiplier needs to come near, and must be near
        then. What would take longer than the motion is watched is not waited for: near the orbit
        it must have shrunk at least half as much over its window as the multiplier says.
        """
        walks, full = self._walks, self._steady.n_periods
        slow = is_slow(self._shots, points, full)
        found = approach(walks, self._shots, points, slow)
        # Transient chaos that has ended late leaves as much time as it took, once.
        late = (self._growths.n_periods[points] > 0) & ~self._has_waited[points]
        more = np.where(late, self._limits.last[points], 0)
        n_left = np.maximum(self._limits.last[points] - walks.n_periods[points], more)
        waits = ~found.is_own & (found.stretch <= n_left)
        away, n, self._goal[points] = points[waits], self._shots.n[points[waits]], found.goal
        self._has_waited[points[waits & late]] = True
        walks.forget(points[waits & slow])
        # Whole periods of the orbit: its start is what the motion must be near to in the end.
        window = np.where(slow[waits], np.maximum(full // n, 1) * n, 0)
        self._ask(away, Phase.APPROACH, found.stretch[waits], window)
        stays = ~found.is_own & ~waits
        # It is on its way, and what grew before says nothing of it.
        grows = self._found.lyapunov[points] > SURE * self._found.lyapunov_error[points]
        grew = points[stays & found.has_shrunk & grows]
        self._found.lyapunov[grew] = self._found.lyapunov_error[grew] = np.nan
        is_own = found.is_own | (stays & found.has_shrunk & found.is_near)
        self._close(points[is_own])
        self._go_on(points[~is_own & ~waits])

    @_for_some
    def _arrive(self, points: Numbers) -> None:
        slow = is_slow(self._shots, points, self._steady.n_periods)
        is_near = farthest(self._walks, self._shots, points, slow) <= self._goal[points]
        self._close(points[is_near])
        away = points[~is_near]
        # A window that is to go on begins anew: what was not recorded would be a gap in it.
        self._walks.forget(away[self._walks.length[away] < self._look[away]])
        begin = self._walks.n_periods[away] - self._walks.length[away]
        self._settled[away] |= begin >= self._limits.settled[away]
        self._go_on(away)

    @_for_some
    def _repeat(self, points: Numbers) -> None:
        """A settled motion that repeats itself, though shooting could not improve on it.

        At loose tolerances the solver's noise is larger than any Newton residual allowed. What
        repeats less well, or not for long, creeps past where there is no orbit, or round a torus.
        """
        walks, largest = self._walks, self._steady.max_period_multiple
        same = walks.same
        found = period_multiples(walks.section, walks.length, points, same[points], largest)
        found *= stay(walks, points, found > 0, self._limits.longest[points], largest)
        self._end_look(points[found == 0])
        for point, n in zip(points[found > 0].tolist(), found[found > 0].tolist(), strict=True):
            # So coarse that it also repeats sooner?
            section = walks.window(point)
            n = prime_multiple(section[:, -n:], same[point] * math.sqrt(n))
            if not self._ensemble.has_own_tangent:
                # A kink that is passed unlocated scatters more than that.
                sooner = likely_multiple(section, _CLOSE * walks.reach[point], n)
                n = sooner if sooner and n % sooner == 0 else n
            self._as_it_is(point, n, Phase.REPEAT)

    def _as_it_is(self, point: int, n: int, phase: int) -> None:
        """The next n forcing periods as an orbit, closed or not, if they contract to one."""
        one, anywhere, nowhere = np.array([point]), np.array([math.inf]), np.zeros(1)
        noise = self._walks.noise(n)[one]
        self._shots.aim(one, self._walks.y[:, one], np.array([n]), anywhere, noise, nowhere)
        self._phase[point] = phase

    @_for_some
    def _end_look(self, points: Numbers) -> None:
        """Nothing found: another look later, if there is time."""
        is_last = self._walks.n_periods[points] >= self._limits.last[points]
        again = points[~is_last]
        self._look[again] = np.minimum(2 * self._look[again], self._steady.n_periods)
        self._wait(again)
        self._finish(points[is_last])

    @_for_some
    def _finish(self, points: Numbers) -> None:
        """No time left: the growth of a disturbance, then the last window, then what they say.

        In this order, because transient chaos may end during the growth: the window that a verdict
        rests on is the last of the motion.
        """
        # A motion that was given no time to settle is nobody's example; without damping nothing
        # is long enough.
        may_grow = self._settled[points] & (self._ensemble.settling_rate[points] > 0.0)
        may_grow &= self._growths.n_least <= self._limits.longest[points]
        grows = may_grow & (self._growths.n_periods[points] == 0)
        self._begin_growth(points[grows])
        is_recorded = self._walks.has_extrema(points)
        self._record_last(points[~grows & ~is_recorded])
        told = points[~grows & is_recorded]
        self._phase[told] = np.where(self._found.is_locked[told], Phase.ENDED, Phase.TELL)

    @_for_some
    def _grown(self, points: Numbers, status: Counts) -> None:
        growths = self._growths
        # What failed did so within the next block.
        elapsed = (growths.n_blocks[points] + (status != Status.OK)) * growths.n_periods[points]
        self._walks.arrive(points, self._growths.y[:, points], status, elapsed)
        self._fail(points[status != Status.OK])
        going = points[status == Status.OK]
        self._found.lyapunov[going], self._found.lyapunov_error[going] = growths.exponents(going)
        self._record_last(going)

    def _tell(self, points: Numbers) -> None:
        """What motions without a period are: those with a zero exponent may be quasiperiodic.

        A growth is doubled until the exponent is not zero beyond doubt, and as well known as the
        user wants, or until its time is over.
        """
        growths, found = self._growths, self._found
        exponent, error = found.lyapunov[points], found.lyapunov_error[points]
        shear = growths.shear(points, self._omega[points])
        may_circle = np.abs(exponent) <= np.maximum(_BEYOND_DOUBT * error, shear)
        may_circle &= len(self._walks.y) > 2
        is_long = growths.is_long(points)
        n_doubled = 2 * growths.n_all_periods(points)
        is_undecided = (may_circle | (np.abs(exponent) <= SURE * error)) & ~is_long
        wanted = self._steady.lyapunov_error  # a short measurement may miss intermittent chaos
        is_rough = np.full(len(points), wanted is not None) & (~is_long | (error > (wanted or 0.0)))
        # Another solver's tangent says less of the motion the longer it is.
        goes_on = is_undecided | (is_rough & (n_doubled <= self._steady.max_periods))
        goes_on &= self._ensemble.has_own_tangent & (n_doubled <= self._limits.longest[points])
        goes_on &= growths.n_periods[points] > 0  # without damping no measurement was started
        growths.double(points[goes_on], self._walks.y[:, points[goes_on]])
        self._phase[points[goes_on]] = Phase.GROW
        # What turns about a torus shrinks and grows again, never by as much as it parts.
        high, low = np.maximum(SURE * error, shear), -np.maximum(SURE * error, 0.5 * shear)
        is_zero = is_long & (low <= exponent) & (exponent <= high)
        self._circle(points[may_circle & ~is_long & ~goes_on], SHORT)
        self._circle(points[may_circle & is_zero], ZERO)
        self._circle(points[may_circle & is_long & (exponent > high)], LONG)
        shrinks = (self._phase[points] == Phase.TELL) & (exponent < -SURE * error)
        self._give_time(points[shrinks], exponent[shrinks])
        left = self._phase[points] == Phase.TELL
        contracts = left & shrinks & (not self._ensemble.has_own_tangent)
        self._phase[points[left & is_zero]] = Phase.ENDED
        self._aperiodic(points[left & ~is_zero & ~contracts])
        for point in points[contracts].tolist():
            self._rattle(point)

    @_for_some
    def _give_time(self, points: Numbers, exponent: Array) -> None:
        """Once, what shrinks, by the rate that is known now: damping may have promised another."""
        limits, omega = self._limits, self._growths.omega(points)
        n_periods = np.ceil(math.log(REST) / exponent * omega)
        may = ~self._has_time[points] & (n_periods <= np.minimum(limits.longest[points], _PATIENCE))
        points, n_periods = points[may], n_periods[may].astype(np.int64)
        limits.last[points] = self._walks.n_periods[points] + n_periods
        limits.pause[points] = np.maximum(n_periods // _LOOKS_LATER, 1)
        self._has_time[points] = True
        self._walks.unrecord(points)
        self._wait(points)

    def _begin_growth(self, points: Numbers) -> None:
        y, rate = self._walks.y[:, points], self._ensemble.settling_rate[points]
        longest = self._limits.last[points] - self._steady.n_periods
        self._growths.begin(points, y, rate, self._omega[points], longest)
        self._phase[points] = Phase.GROW

    @_for_some
    def _circle(self, points: Numbers, windows: dict[int, float]) -> None:
        """Watch motions for so long that they run round a torus, if they are on one."""
        watched = watch(self._walks, points, windows, self._limits.longest[points])
        self._found.is_quasiperiodic[points] = watched.is_torus
        self._found.is_locked[points] = watched.is_locked
        at = watched.is_torus | watched.is_locked  # it takes longer to get there than damping says
        told, y, n_periods = points[at], watched.y[:, at], watched.n_periods[at]
        self._walks.arrive(told, y, self._walks.status[told], n_periods)
        self._record_last(told)

    def _rattle(self, point: int) -> None:
        """A motion whose solver rattles it about a periodic orbit, more than its tolerances say.

        A kink passed unlocated throws a step off by more than its error estimate. The tangent is
        another solver's, so that the exponent tells this from chaos; what does not contract, or
        scatters more than the solver strays, is on its way or has another period.
        """
        lyapunov, reach = self._found.lyapunov[point], self._walks.reach[point]
        window, largest = self._walks.window(point), self._steady.max_period_multiple
        scatter = self._growths.scatter(point, float(self._omega[point]), lyapunov)
        n = likely_multiple(window, _CLOSE * reach, largest, DEVIATIONS * scatter)
        if n:
            self._as_it_is(point, n, Phase.RATTLE)
        else:
            self._aperiodic(np.array([point]))

    @_for_some
    def _close(self, points: Numbers) -> None:
        """The response is the orbit that shooting found."""
        # Measured before, an exponent is that of the way here, unless the motion is rattled.
        others = points[self._phase[points] != Phase.RATTLE]
        self._found.lyapunov[others] = self._found.lyapunov_error[others] = np.nan
        self._phase[points] = Phase.ENDED
        self._found.is_periodic[points] = True

    @_for_some
    def _aperiodic(self, points: Numbers) -> None:
        self._phase[points] = Phase.ENDED
        walks, largest = self._walks, self._steady.max_period_multiple
        # On an unstable orbit a disturbance grows too, and beside a bifurcation so slowly that the
        # motion stays near: but there it repeats itself.
        section, length = walks.section[:, points], walks.length[points]
        is_alike = repeat_nearly(section, length, walks.step_error[points], largest)
        exponent, error = self._found.lyapunov[points], self._found.lyapunov_error[points]
        unlike = points[(exponent >= -SURE * error) & ~is_alike]
        self._found.is_growing[unlike] = ~stay_within(walks, unlike)
        self._found.is_chaotic[points] = (exponent > SURE * error) & ~is_alike
        self._found.is_chaotic[points] &= ~self._found.is_growing[points]

    @_for_some
    def _fail(self, points: Numbers) -> None:
        found, ensemble, walks = self._found, self._ensemble, self._walks
        self._phase[points] = Phase.ENDED
        found.is_astray[points] = walks.status[points] == ASTRAY
        at_rest = points[walks.status[points] == AT_REST]
        found.is_at_rest[at_rest], found.lyapunov_error[at_rest] = True, 0.0
        for point in at_rest.tolist():
            rest = about_rest(ensemble, point, walks.y[:, point])
            found.lyapunov[point], found.offset[point] = rest
