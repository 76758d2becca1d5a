"""Responses of a search, computed from the recorded motion of every point.

One last call records a whole period of every orbit. A motion that is not periodic has its last
recording window, with all events.
"""

import math

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motions import VANISHED
from gapsweep.model.oscillator import Oscillator
from gapsweep.model.waves import ForceByPieces
from gapsweep.response import thresholds as limit
from gapsweep.response.classification import Classification, State
from gapsweep.response.compiled import read_extrema
from gapsweep.response.equilibrium import rates
from gapsweep.response.loads import largest_forces
from gapsweep.response.ragged import RaggedArrays, spans
from gapsweep.response.result import (
    LISTS,
    ExtremumKind,
    ResponseClass,
    Responses,
    Steady,
    columns_with,
)
from gapsweep.response.scene import CONFIRMING_RTOL, TANGENT_RTOL
from gapsweep.response.section import period_multiple, reach_of
from gapsweep.response.shooting import NewtonShooting
from gapsweep.response.window_call import Call
from gapsweep.response.windows import RecordedWindows
from gapsweep.status import Status

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

# Smallest motion of a contact relative to the whole motion. At 1e-6, chaos of a part of a system
# was classified as periodic; down to 1e-5 all classes were right.
_FAINT = 1e-5
_ROUNDING = 1e-12  # of the largest displacement: amplitude of what walls hold
_KINDS = int(ExtremumKind.MAXIMUM), int(ExtremumKind.MINIMUM), int(ExtremumKind.INFLECTION)
_LINEAR = 1e-3  # of a spring's stiffness: a cubic spring that adds less is negligible

# Messages of points that are unresolved because of their state, then other messages.
_REASONS = {
    State.NO_RETURN: (
        "the motion does not return to its section, the maxima of the first coordinate: it creeps, "
        "or another coordinate must be the first"
    ),
    State.HIDDEN: (
        "a contact or a cubic spring has less than 1e-5 of the kinetic energy, which is within "
        "solver error; simulate this part of the system separately"
    ),
    State.NOISY: (
        "the expected numerical noise, {noise:.2g} m, exceeds a tenth of the amplitude; lower atol "
        "and rtol, as atol={atol:.0e}"
    ),
    State.UNCONFIRMED: (
        "at rtol {rtol:g} the solver's orbit of {n} periods is not stable, has another period, or "
        "is gone (largest multiplier {modulus:.4g}); lower rtol"
    ),
    State.UNSTABLE_REST: (
        "the initial state is an unstable equilibrium (exponent {exponent}); choose another"
    ),
    State.LOCKED: (
        "the motion repeats after more than max_period_multiple = {largest} periods (raise it, to "
        "256 at most), or not on a stable orbit"
    ),
    State.GROWING: (
        "the displacement grew until the end: the motion is a transient or unbounded; allow more "
        "{time}"
    ),
}
_UNDAMPED = (
    "a motion without damping does not settle, and this motion does not repeat within "
    "max_period_multiple = {largest} periods; write {damping}"
)
_UNMEASURED = (
    "no stable orbit of up to max_period_multiple = {largest} periods was found, and no Lyapunov "
    "exponent was measured; allow more {time}"
)
_BLURRED = (
    "the motion repeats every {n} periods within the solver's noise, but shooting finds no stable "
    "orbit; lower rtol and atol"
)
_NEUTRAL = (
    "the motion repeats every {n} periods, but the mass has no spring: every position in the gap "
    "has such an orbit"
)
_SHRINKS = (
    "the Lyapunov exponent, {exponent}, is negative, but no stable orbit of up to "
    "max_period_multiple = {largest} periods was found; raise it (256 at most), or allow more "
    "{time}"
)
_STAYS = (
    "the Lyapunov exponent, {exponent}, is positive, but the motion repeats to 0.1 %: it "
    "leaves an unstable orbit slowly, or its chaos is weak; allow more {time}, or record more "
    "periods (n_periods)"
)
_UNCERTAIN = "the sign of the Lyapunov exponent, {exponent}, is not certain; allow more {time}"
_TIME = "time (max_decay_times, max_periods, t_max)"


# Class by state; a state without a class of the same name is unresolved.
_CLASSES = np.array(
    [ResponseClass.__members__.get(state.name, ResponseClass.UNRESOLVED) for state in State]
)
_CLASSES[State.FAILED] = ResponseClass.UNRESOLVED


def answers(
    windows: RecordedWindows, shooting: NewtonShooting, found: Classification, steady: Steady
) -> Responses:
    """Return the responses of all points of a search."""
    ensemble, t_settled = windows.ensemble, windows.t
    n = len(t_settled)
    states = _record(np.flatnonzero(found.has_orbit), windows, shooting)
    _rest(np.flatnonzero(found.has_stopped), windows, states)
    is_ok = windows.status == int(Status.OK)
    points, failures = np.flatnonzero(is_ok), np.flatnonzero(~is_ok)
    read, lists = _read_off(points, windows, found, steady)
    lists["section"] = section, counts = _section(points, windows, found, states, steady)
    read |= _precision(points, windows, shooting, found, read)
    read |= _stability(points, windows, shooting, found)
    read["t_settled"] = t_settled[points]
    end = section[(np.cumsum(counts) - len(windows.y))[:, None] + np.arange(len(windows.y))]
    n_q = ensemble.n_coordinates
    read["x_end"], read["v_end"] = end[:, :n_q], end[:, n_q : 2 * n_q]
    read["z_end"] = end[:, 2 * n_q :]
    columns = columns_with(read, points, n, ensemble.structure)
    messages: dict[int, str] = {}
    if failures.size:
        columns["status"][failures], messages = _failures(failures, windows)
    for state in (State.NO_RETURN, State.HIDDEN):
        here = (found.state == int(state)).nonzero()[0]
        messages |= dict.fromkeys(here.tolist(), _REASONS[state])
    for point in np.flatnonzero(columns["status"] == int(Status.UNRESOLVED)).tolist():
        messages.setdefault(point, _why_unresolved(point, windows, shooting, found, steady))
    columns |= ensemble.costs() | {"atol": ensemble.atol}
    of_all = {}
    found_lists = lists | {"multipliers": _multipliers(points, shooting, found)}
    for name, dtype in LISTS.items():
        items, some = found_lists[name]
        counts = np.zeros(n, np.int64)
        counts[points] = some
        of_all[name] = items.astype(dtype, copy=False), counts
    return Responses(columns, of_all, messages)


_NO_HOLD = ": beyond a rigid wall, or held by more walls than can move independently"


def _failures(failures: Numbers, windows: RecordedWindows) -> tuple[list[Status], dict[int, str]]:
    """Return the status of the points that failed, and a message for each, by point."""
    ensemble = windows.ensemble
    y = windows.y[:, failures]
    gaps = ensemble.gaps(ensemble.turning(failures, y))
    low, high = ensemble.valid_range[:, :, failures]
    has_left = np.asarray(((gaps < low) | (gaps > high)).any(axis=0))  # False for NaN
    statuses, messages = [], {}
    for k, point in enumerate(failures.tolist()):
        reached = Status(windows.status[point])
        statuses.append(Status.OUT_OF_FIT_RANGE if has_left[k] else reached)
        names = ensemble.system(point).coordinates
        places = ", ".join(f"{name} = {q:.3g} m" for name, q in zip(names, y[:, k], strict=False))
        why = ""
        if reached is Status.MODEL_INVALID:
            may_hold = any(law.losses.may_hold for law in ensemble.laws(point))
            why = _NO_HOLD if may_hold else ": the contact force there is no number"
        messages[point] = f"{reached.label} before t = {windows.t[point]:.6g} s at {places}{why}"
    return statuses, messages


def _why_unresolved(
    point: int,
    windows: RecordedWindows,
    shooting: NewtonShooting,
    found: Classification,
    steady: Steady,
) -> str:
    exponent, error = found.lyapunov[point], found.lyapunov_error[point]
    largest = steady.max_period_multiple
    n = period_multiple(
        windows.window(point), float(windows.resolution(np.array([point]))[0]), largest
    )
    if found.state[point] in _REASONS:
        reason = _REASONS[State(found.state[point])]
        n = n if found.state[point] != int(State.UNCONFIRMED) else int(shooting.n[point])
    elif n:
        reason = _BLURRED if windows.ensemble.system(point).is_held else _NEUTRAL
    elif windows.ensemble.settling_rate[point] <= 0.0:
        reason = _UNDAMPED
    elif math.isnan(exponent):
        reason = _UNMEASURED
    elif abs(exponent) <= limit.SURE * error:
        reason = _UNCERTAIN
    else:
        reason = _SHRINKS if exponent < 0.0 else _STAYS
    number, system = f"{exponent:.3g} ± {error:.1g} 1/s", windows.ensemble.system(point)
    remedy = f"damping = 0.1 * np.eye({system.n})"
    if isinstance(system, Oscillator):
        remedy = "zeta = 0.02" if system.omega_n else "c = 0.1"
    precision = {
        "modulus": abs(shooting.multipliers[point, 0]),
        "noise": float(windows.noise(np.array([point]), max(int(shooting.n[point]), 1))[0]),
        "atol": 0.01 * windows.ensemble.atol[point],
        "rtol": CONFIRMING_RTOL,
        "damping": remedy,
    }
    return reason.format(largest=largest, n=n, exponent=number, time=_TIME, **precision)


def _precision(
    points: Numbers,
    windows: RecordedWindows,
    shooting: NewtonShooting,
    found: Classification,
    read: dict[str, Array | Counts],
) -> dict[str, Array | Counts]:
    """Columns of noise and tolerance; responses with an amplitude near the noise are unresolved.

    A system without loads that vary is exempt: it may come to rest, with zero amplitude. So is one
    that walls hold.
    """
    ensemble, stopped = windows.ensemble, found.has_stopped[points]
    offset, swing = found.offset[points], np.asarray(read["amplitude"], float)
    noise = windows.noise(points, np.where(found.is_periodic, shooting.n, 1)[points])
    amplitude = reach_of(swing.T, ensemble.unit[:, points])
    is_noisy = (limit.NOISY * noise > amplitude) & found.is_classified[points] & ~stopped
    rests = _is_held(points, windows).any(axis=0) & (amplitude <= _ROUNDING * windows.reach[points])
    is_noisy &= ~rests
    for k in np.flatnonzero(is_noisy).tolist():
        system = ensemble.system(points[k])
        if isinstance(system, Oscillator):
            is_noisy[k] = system.is_loaded
        else:
            loads = [x for x in system.forcing if x.k or isinstance(x, ForceByPieces)]
            loads = system.forcing if any(system.is_modulated) else loads
            is_noisy[k] = np.any([load.amplitude for load in loads])
    found.state[points[is_noisy]] = State.NOISY
    read["status"][is_noisy & (read["status"] == int(Status.OK))] = Status.UNRESOLVED
    rtol = np.where(found.has_orbit[points], CONFIRMING_RTOL, TANGENT_RTOL)
    rtol = np.where(ensemble.solver.rtol > TANGENT_RTOL, rtol, ensemble.solver.rtol)
    return {
        "noise": np.where(np.isnan(offset), noise, offset),
        "stability_rtol": np.where(stopped, np.nan, rtol),
    }


def _stability(
    points: Numbers, windows: RecordedWindows, shooting: NewtonShooting, found: Classification
) -> dict[str, Array | Counts]:
    """Columns of class, period, multipliers and Lyapunov exponents of some points."""
    state, is_orbit = found.state[points], found.is_periodic[points]
    n, omega = shooting.n[points], shooting.omega[points]
    lyapunov, error = found.lyapunov[points], found.lyapunov_error[points]
    modulus = np.full(len(points), np.nan)
    largest = shooting.multipliers[points[is_orbit], 0]
    modulus[is_orbit] = np.hypot(largest.real, largest.imag)
    follows = is_orbit & np.isnan(lyapunov)
    shrinks = follows & (modulus > VANISHED)
    # An oscillating tangent that has shrunk to zero shrank at the mean rate of areas, an overdamped
    # one did not.
    rate = windows.ensemble.decay_rate[points]
    swings = follows & ~shrinks & (windows.ensemble.settling_rate[points] == rate)
    lyapunov[swings] = -rate[swings]
    error[swings | shrinks] = 0.0
    # numpy's logarithm differs between processors.
    logarithms = np.fromiter(map(math.log, modulus[shrinks].tolist()), float)
    lyapunov[shrinks] = logarithms * omega[shrinks] / n[shrinks]
    return {
        "period": np.where(is_orbit, n / omega, np.nan),
        "response_class": _CLASSES[state],
        "period_multiple": np.where(is_orbit, n, 0),
        "multiplier_abs": modulus,
        "lyapunov": lyapunov,
        "lyapunov_error": error,
    }


def _multipliers(
    points: Numbers, shooting: NewtonShooting, found: Classification
) -> tuple[NDArray[np.complex128], Counts]:
    """Floquet multipliers of the orbits among some points."""
    is_orbit, n = found.is_periodic[points], shooting.n_multipliers
    return shooting.multipliers[points[is_orbit], :n].ravel(), np.where(is_orbit, n, 0)


def _record(orbits: Numbers, windows: RecordedWindows, shooting: NewtonShooting) -> RaggedArrays:
    """Record a whole period of the orbits; return states (q, v, z) after each forcing period.

    Extrema and contact shares are stored in `windows`, as for other motions.
    """
    ensemble, states = windows.ensemble, RaggedArrays(len(shooting.n))
    if orbits.size:
        y, n = shooting.y[:, orbits], shooting.n[orbits]
        call = ensemble.call(orbits, y, n, np.zeros(len(orbits)), section_only=False)
        windows.y[:, orbits], windows.status[orbits] = y, call.status
        windows.extrema.put(windows.rows(orbits), *_whole_period(windows, orbits, y, call))
        windows.keep_loads(orbits, y, call, n, closed=True)
        section, counts = call.passings
        states.put(orbits, section.ravel(), len(y) * counts)
    return states


def _rest(points: Numbers, windows: RecordedWindows, states: RaggedArrays) -> None:
    """Record motions at rest, and those without return to the section: one state, no extrema."""
    if not points.size:
        return
    rows, y = windows.rows(points), windows.y[:, points]
    windows.extrema.put(rows, np.empty(0), np.zeros(len(rows), np.int64))
    gaps = windows.ensemble.gaps(windows.ensemble.turning(points, y))
    low, high = windows.ensemble.walls[:, :, points]
    windows.contact_share[:, points] = (gaps < low) | (gaps > high)
    windows.contacts_per_period[points] = 0.0
    windows.status[points] = Status.OK
    states.put(points, y.T.ravel(), np.full(len(points), len(y)))


def _section(
    points: Numbers,
    windows: RecordedWindows,
    found: Classification,
    states: RaggedArrays,
    steady: Steady,
) -> tuple[Array, Counts]:
    """Section of some points: of orbits as recorded, of other motions the end of their windows."""
    others = points[~(found.has_orbit | found.has_stopped)[points]]
    if others.size:
        n_states, _, width = windows.section.shape
        length = windows.length[others]
        counts = np.minimum(length, steady.max_period_multiple)
        last = spans(others * width + length - counts, counts)
        window = windows.section.reshape(n_states, -1)[:, last]
        window = window * np.repeat(windows.ensemble.unit[:, others], counts, axis=1)
        states.put(others, window.T.ravel(), n_states * counts)
    return states.of(points)


def _read_off(
    points: Numbers, windows: RecordedWindows, found: Classification, steady: Steady
) -> tuple[dict[str, Array | Counts], dict[str, tuple[Array | Counts, Counts]]]:
    """Return columns and lists computed from the recorded extrema of some points.

    Also sets `windows.reach` to the reach of the extrema, and the state of points with a contact or
    spring that is hidden by errors to `State.HIDDEN`.
    """
    ensemble, is_orbit = windows.ensemble, found.has_orbit[points]
    n_q, place = ensemble.n_coordinates, ensemble.turning(points, windows.y[:, points])
    x, counts = windows.extrema.of(windows.rows(points))
    closed = np.repeat(is_orbit, windows.n_turning)
    kinds, largest, smallest = read_extrema(x, counts, closed, place.T.ravel(), _KINDS)
    first = np.cumsum(counts) - counts
    # One row a point, one column for every coordinate, then for every gap.
    shape = -1, windows.n_turning
    largest, smallest = largest.reshape(shape), smallest.reshape(shape)
    counts, first = counts.reshape(shape), first.reshape(shape)
    x_max, x_min = largest[:, :n_q], smallest[:, :n_q]
    reach = np.maximum(np.abs(x_max), np.abs(x_min))
    windows.reach[points] = reach_of(reach.T, ensemble.unit[:, points])
    gap_max, gap_min = (ensemble.gaps(each.T) for each in (largest, smallest))
    low, high = ensemble.valid_range[:, :, points]
    has_left = (gap_max > high) | (gap_min < low)
    share = windows.contact_share[:, points]
    hidden = _hidden_contacts(points, windows, gap_max, gap_min)
    if n_q > 1:
        hidden |= _hidden_springs(points, windows, 0.5 * (x_max - x_min))
    found.state[points[hidden & ~found.has_stopped[points]]] = State.HIDDEN
    status = np.where(found.is_classified[points], int(Status.OK), int(Status.UNRESOLVED))
    status[has_left.any(axis=0)] = Status.OUT_OF_FIT_RANGE
    laws = zip(*map(ensemble.laws, points.tolist()), strict=True)
    forces = [largest_forces(*each) for each in zip(laws, gap_min, gap_max, strict=False)]
    force_max = np.array(forces).reshape(len(low), len(points)).T
    of_losses = windows.contact_force[:, points].T
    force_max = np.where(np.isnan(of_losses), force_max, of_losses)
    force_max[np.isinf(force_max)] = np.nan  # of impacts
    force_max[ensemble.is_modulated[:, points].T] = np.nan
    n_shown = np.minimum(counts[:, :n_q], steady.max_extrema)
    shown = spans(first[:, :n_q].ravel(), n_shown.ravel())
    columns = {
        "status": status,
        "n_extrema": counts[:, :n_q],
        "x_max": x_max,
        "x_min": x_min,
        "amplitude": 0.5 * (x_max - x_min),
        "force_max": force_max,
        "contact_share": share.T,
        "contacts_per_period": windows.contacts_per_period[points],
        "contact_x_max": gap_max.T,
        "contact_x_min": gap_min.T,
    }
    n_items = n_shown.sum(axis=1)
    return columns, {"extrema": (x[shown], n_items), "extremum_kind": (kinds[shown], n_items)}


def _hidden_contacts(
    points: Numbers, windows: RecordedWindows, gap_max: Array, gap_min: Array
) -> Mask:
    """Points with a contact near its wall that moves less than errors of the other coordinates."""
    ensemble = windows.ensemble
    whole = ensemble.gap_units(points) * windows.reach[points]
    faint = 0.5 * (gap_max - gap_min) < _FAINT * whole
    margin = ensemble.solver.rtol * whole
    # A smooth law changes its stiffness near the same walls: faint motion there is hidden, too.
    walls = ensemble.felt_walls[:, :, points]
    near = ((gap_min - margin <= walls) & (walls <= gap_max + margin)).any(axis=0)
    return np.asarray((faint & near & ~_is_held(points, windows)).any(axis=0))


def _is_held(points: Numbers, windows: RecordedWindows) -> Mask:
    """Contacts that a wall holds all the time: they do not move, shape (n_contacts, m)."""
    ensemble = windows.ensemble
    always = windows.contact_share[:, points] > 1.0 - _FAINT
    gaps = ensemble.gaps(ensemble.turning(points, windows.y[:, points]))
    near = _ROUNDING * ensemble.gap_units(points) * windows.reach[points]
    is_there = (np.abs(gaps - ensemble.walls[:, :, points]) <= near).any(axis=0)
    return np.asarray(always & is_there & ensemble.may_hold[:, points])


def _hidden_springs(points: Numbers, windows: RecordedWindows, half: Array) -> Mask:
    """Points with a relevant cubic spring that moves less than errors of the other coordinates.

    Parameters
    ----------
    half : ndarray, shape (m, n_coordinates)
        Half the ranges of coordinates [m].
    """
    ensemble = windows.ensemble
    unit = ensemble.unit[: ensemble.n_coordinates, points].T
    whole = _FAINT * windows.reach[points]
    hidden = np.zeros(len(points), bool)
    for k in np.flatnonzero((half < whole[:, None] * unit).any(axis=1)).tolist():
        system = ensemble.system(points[k])
        for spring in system.cubic:
            along = spring.along
            moves = np.abs(along) @ half[k]  # at most
            # Linear stiffness against it; inertia where contacts or other coordinates hold it.
            inertia = along @ system.mass @ along * (2.0 * math.pi * ensemble.omega[points[k]]) ** 2
            stiffness = (abs(along @ system.stiffness @ along) + inertia) / (along @ along) ** 2
            is_faint = moves < whole[k] * np.linalg.norm(along * unit[k])
            hidden[k] |= is_faint and abs(spring.alpha) * moves**2 > _LINEAR * stiffness
    return hidden


def _whole_period(
    windows: RecordedWindows, orbits: Numbers, y: Array, call: Call
) -> tuple[Array, Counts]:
    """Extrema [m] of orbits over a whole period, and the number of each row.

    The end of an orbit differs from its start in the last bits. An extremum there could be missed,
    or counted twice: then the velocities have opposite signs, and the acceleration decides which of
    both happened.
    """
    ensemble, n_q = windows.ensemble, windows.ensemble.n_coordinates
    x, counts = windows.extrema_of(call)
    counts = counts.ravel()
    v_start, v_end = (ensemble.turning(orbits, each[n_q:]).T.ravel() for each in (y, call.y))
    turned = np.flatnonzero(v_start * v_end < 0.0)
    if not turned.size:
        return x, counts
    missed, doubled = np.zeros(len(counts), bool), np.zeros(len(counts), bool)
    at = ensemble.turning(orbits, call.y).T.ravel()
    for row in turned.tolist():
        k, which = divmod(row, windows.n_turning)
        orbit = orbits[[k]]
        a = rates(ensemble, int(orbits[k]), call.y[:, k])[n_q : 2 * n_q]
        a_turning = ensemble.turning(orbit, a[:, None])[which, 0]
        missed[row] = (v_start[row] - v_end[row]) * a_turning > 0.0
        doubled[row] = not missed[row] and counts[row] > 0
    if doubled.any():
        x = np.delete(x, (np.cumsum(counts) - counts)[doubled])
        counts = counts - doubled
    if missed.any():
        x = np.insert(x, np.cumsum(counts)[missed], at[missed])
    return x, counts + missed
