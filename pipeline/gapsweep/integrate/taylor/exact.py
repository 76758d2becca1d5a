"""Many points of the exact contact law at once: arrays in, arrays and event lists out.

The compiled engine behind ``simulate(..., engine="compiled")`` for the piecewise law. `scenes`
prepares one table row per oscillator, `run` puts starts into copies of the rows, runs
`exact_kernel.advance` on them and drains its buffers; `integrate` does both.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import lane_rows as row
from . import record
from .exact_kernel import BUDGET_SPENT, BUFFER_FULL, FINISHED, OK, RUNNING, advance
from .roots import MAX_DEGREE, work_space
from .sample import sample_steps
from .starts import BACKWARD, NOT_FINITE, ON_WALL, set_starts

FloatArray = NDArray[np.float64]

# Degree of the Taylor polynomial by relative tolerance: the cheapest measured on the benchmark
# scenes. (smallest rtol it is used for, degree)
ORDERS = ((2e-5, 8), (2e-8, 12), (2e-11, 16), (0.0, 20))
# Shortest step that makes progress, in rad of the natural or forcing frequency: a stiffness of 1e9
# N/m takes steps a million times longer, and a run of shorter ones would never end.
_MIN_STEP = 1e-10
_LOG_ROWS = 1 << 14
_DENSE_ROWS = 1 << 11
_BUDGET = 1 << 16  # vector steps per call of the kernel, about 20 ms: Ctrl-C is answered in between


@dataclass(frozen=True, slots=True)
class Exact:
    """Outcome of `run`; arrays of shape (n,) unless noted, one entry per point.

    Attributes
    ----------
    x, v : ndarray
        State at the end [m, m/s]; of a failed point, where it failed.
    t : ndarray
        Time reached [s]; `t_end` where status is OK.
    mode : ndarray of int
        Contact at the end: -1 lower wall, 0 gap, +1 upper wall.
    status : ndarray of int
        `exact_kernel.OK`, DIVERGED, STEP_UNDERFLOW or CHATTER.
    n_contacts, n_steps, n_rejected, nfev : ndarray of int
        Wall crossings, in and out, each counted once; steps; steps refused (always zero: the step
        size comes from the series itself); Taylor expansions.
    reach : ndarray
        Largest modulus of x at the start and at the ends of steps [m].
    monodromy : ndarray, shape (n, 2, 2), or None
        Derivative of (x, v) at the end by (x, v) at the start.
    log : ndarray, shape (n_events, 5)
        Recorded events (point, kind, t, x, v) as in `record`, sorted by point, then in time
        within each kind.
    dense : ndarray, shape (n_rows, 3 + order + 1), or None
        Recorded steps (point, start, length, coefficients), sorted by point and time.
    """

    x: FloatArray
    v: FloatArray
    t: FloatArray
    mode: NDArray[np.int64]
    status: NDArray[np.int64]
    n_contacts: NDArray[np.int64]
    n_steps: NDArray[np.int64]
    n_rejected: NDArray[np.int64]
    nfev: NDArray[np.int64]
    reach: FloatArray
    monodromy: FloatArray | None
    log: FloatArray = field(repr=False)
    dense: FloatArray | None = field(repr=False)

    def events(self, point: int, *kinds: int) -> FloatArray:
        """Recorded events of one point, all kinds or those given: columns t, x, v, kind."""
        first, last = np.searchsorted(self.log[:, record.POINT], [point, point + 1])
        rows = self.log[first:last]
        if kinds:
            rows = rows[np.isin(rows[:, record.KIND], kinds)]
        return rows[:, [record.TIME, record.DISPLACEMENT, record.VELOCITY, record.KIND]]

    def sample(
        self, t: ArrayLike, points: ArrayLike | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """x and v between the steps, from their own series.

        Parameters
        ----------
        t : array_like, shape (n_t,) or (n_points, n_t)
            Times [s] within the recorded part; one row for all points or one for each.
        points : array_like of int, optional
            Which points; default all.

        Returns
        -------
        x, v : ndarray, shape (n_points, n_t)

        Raises
        ------
        ValueError
            If dense output was not asked for, or a time lies outside the recorded part.
        """
        if self.dense is None:
            raise ValueError("no dense output: call integrate(..., dense_output=True)")
        points = np.arange(len(self.x)) if points is None else np.atleast_1d(points)
        times = np.ascontiguousarray(
            np.broadcast_to(t, (len(points), np.shape(t)[-1])), dtype=float
        )
        first, last = (np.searchsorted(self.dense[:, 0], points + k) for k in (0, 1))
        x, v, outside = sample_steps(self.dense, first, last, times)
        if outside >= 0:
            raise ValueError(f"a time lies outside the recorded part of point {points[outside]}")
        return x, v


def order_for(rtol: float) -> int:
    """Degree of the Taylor polynomial used at a relative tolerance."""
    return next(order for smallest, order in ORDERS if rtol >= smallest)


@dataclass(frozen=True, slots=True)
class Scenes:
    """Oscillators between walls as the kernel takes them: all of a point but its start and end.

    Attributes
    ----------
    table : ndarray, shape (n + 1, N_ROWS)
        Rows as the kernel reads them, the idle point last. `FLOOR` holds the size [m] of the
        motion that the forcing keeps up against all springs.
    rtol, atol : float
        As in `scenes`.
    order : int
        Degree of the Taylor polynomial at that tolerance.
    """

    table: FloatArray
    rtol: float
    atol: float
    order: int


def integrate(
    *,
    zeta: ArrayLike,
    omega_n: ArrayLike,
    mass: ArrayLike,
    alpha: ArrayLike,
    forcing: ArrayLike,
    K_c: ArrayLike,
    j_1: ArrayLike,
    j_2: ArrayLike,
    omega: ArrayLike,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
    t_0: ArrayLike = 0.0,
    t_end: ArrayLike,
    record_from: ArrayLike = np.inf,
    rtol: float = 1e-9,
    atol: float = 1e-12,
    **options: Any,
) -> Exact:
    """Integrate the freeplay oscillator with every contact located, many points in lanes.

    All array arguments broadcast to one shape (n,). A point's result does not depend, to the
    last bit, on which others share the call.

    Parameters
    ----------
    zeta, omega_n, mass, alpha, forcing, K_c, j_1, j_2, omega, rtol, atol
        As in `scenes`.
    x_0, v_0, t_0, t_end, record_from, **options
        As in `run`.

    Returns
    -------
    Exact
    """
    given = zeta, omega_n, mass, alpha, forcing, K_c, j_1, j_2, omega
    given += x_0, v_0, t_0, t_end, record_from
    arrays = [np.array(a, dtype=float).ravel() for a in np.broadcast_arrays(*np.atleast_1d(*given))]
    prepared = scenes(*arrays[:9], rtol=rtol, atol=atol)
    return run(prepared, np.arange(arrays[0].size), *arrays[9:], **options)


def scenes(
    zeta: FloatArray,
    omega_n: FloatArray,
    mass: FloatArray,
    alpha: FloatArray,
    forcing: FloatArray,
    K_c: FloatArray,
    j_1: FloatArray,
    j_2: FloatArray,
    omega: FloatArray,
    *,
    rtol: float,
    atol: float,
) -> Scenes:
    """Prepare oscillators; `run` then starts them as often as wanted.

    Parameters
    ----------
    zeta, mass, alpha, forcing, K_c : ndarray, shape (n,)
        Damping ratio [-], mass [kg], cubic stiffness [N/m^3], forcing [N], contact stiffness [N/m].
    omega_n, omega : ndarray, shape (n,)
        Natural and forcing frequency [Hz], both > 0.
    j_1, j_2 : ndarray, shape (n,)
        Distances of the walls from the origin [m], >= 0; infinity: no wall.
    rtol, atol : float
        A step's error in velocity is kept below about `rtol` times the speed that the state's
        energy amounts to, in the gap or beside the wall, whichever springs hold it; that of a
        disturbance below a part of `rtol` of its own size. `atol` [m] can only tighten: it is
        limited to ``1e-3 * rtol`` of the motion's natural size.
    """
    if not 1e-14 <= rtol <= 1e-1:
        raise ValueError(f"rtol = {rtol}: must lie in [1e-14, 0.1]")
    if not 0.0 <= atol < np.inf:
        raise ValueError(f"atol = {atol}: must be finite and >= 0")
    _check(zeta=zeta, omega_n=omega_n, mass=mass, alpha=alpha, forcing=forcing, omega=omega)
    _check(K_c=K_c, j_1=j_1, j_2=j_2)
    n_rad, omega_rad = 2 * np.pi * omega_n, 2 * np.pi * omega
    points = np.zeros((len(zeta) + 1, row.N_ROWS))
    table = points[:-1].T
    table[row.TANGENT], table[row.TANGENT + 3] = 1.0, 1.0
    table[row.STIFFNESS], table[row.DAMPING] = n_rad**2, 2 * zeta * n_rad
    table[row.CUBIC], table[row.PUSH], table[row.CONTACT] = alpha / mass, forcing / mass, K_c / mass
    table[row.LOWER], table[row.UPPER] = -j_1, j_2
    table[row.OMEGA], table[row.OMEGA_RAD], table[row.PERIOD] = omega, omega_rad, 1.0 / omega
    table[row.FLOOR] = _forced_size(table, np.minimum(j_1, j_2))
    table[row.RATE] = np.sqrt(n_rad**2 + K_c / mass) + omega_rad
    table[row.MIN_STEP] = _MIN_STEP / np.maximum(n_rad, omega_rad)
    _set_idle(points[-1])
    return Scenes(points, rtol, atol, order_for(rtol))


def run(
    prepared: Scenes,
    which: NDArray[np.intp],
    x_0: FloatArray,
    v_0: FloatArray,
    t_0: FloatArray,
    t_end: FloatArray,
    record_from: FloatArray,
    *,
    queue: NDArray[np.intp] | None = None,
    section_only: bool = False,
    tangent: bool = False,
    dense_output: bool = False,
    order: int | None = None,
    x_bound: float = 1e3,
    max_chatter: int = 100,
) -> Exact:
    """Integrate prepared oscillators from their starts.

    Parameters
    ----------
    prepared : Scenes
    which : ndarray of int, shape (n,)
        Number of the scene of each point.
    x_0, v_0, t_0, t_end : ndarray, shape (n,)
        Start [m, m/s, s] and end [s].
    record_from : ndarray, shape (n,)
        Time from which extrema, contacts and section points are recorded [s]. A start is not an
        event: only what happens after `t_0` is recorded.
    queue : ndarray of int, shape (n,), optional
        The points in the order in which lanes take them; default as they stand.
    section_only : bool
        Record section points alone: a search for extrema in every step costs as much as the step.
    tangent : bool
        Also integrate the variational equation. Its jump at a contact is the identity, because
        the contact force is continuous.
    dense_output : bool
        Keep every step's series from `record_from` on, for `Exact.sample`.
    order : int, optional
        Degree of the Taylor polynomial; default by `order_for`.
    x_bound : float
        A point that leaves ``|x| <= x_bound`` [m] has diverged.
    max_chatter : int
        Crossings in a row, each within 1e-6 rad of the fastest oscillation, that end a point as
        chatter.
    """
    degree = prepared.order if order is None else order
    if not 6 <= degree <= MAX_DEGREE:
        raise ValueError(f"order = {degree}: must lie in [6, {MAX_DEGREE}]")
    points = np.empty((len(which) + 1, row.N_ROWS))
    starts = x_0, v_0, t_0, t_end, record_from, section_only
    outcome = set_starts(points, prepared.table, which, *starts, prepared.rtol, prepared.atol)
    if outcome == NOT_FINITE:
        _check(x_0=x_0, v_0=v_0, t_0=t_0, t_end=t_end, record_from=record_from)
    if outcome == BACKWARD:
        raise ValueError("t_end lies before t_0")
    if outcome == ON_WALL:
        _set_mode_on_walls(points[:-1].T)
    statuses = np.full(len(which), RUNNING)
    limits = prepared.rtol, x_bound, float(max_chatter)
    queue = np.arange(len(which)) if queue is None else queue
    log, dense = _drained(points, queue, statuses, degree, tangent, limits, dense_output)
    return _outcome(points[:-1], statuses, t_end, tangent, log, dense)


_POSITIVE = ("omega_n", "mass", "omega")
_NOT_NEGATIVE = ("zeta", "K_c", "j_1", "j_2")
_MAY_BE_INFINITE = ("j_1", "j_2", "record_from")


def _check(**values):
    """Refuse what would make the kernel's arithmetic meaningless; names the offending value."""
    for name, array in values.items():
        is_bad = np.isnan(array) if name in _MAY_BE_INFINITE else ~np.isfinite(array)
        rule = "a number" if name in _MAY_BE_INFINITE else "finite"
        if name in _POSITIVE:
            is_bad, rule = is_bad | (array <= 0), "finite and > 0"
        elif name in _NOT_NEGATIVE:
            is_bad, rule = is_bad | (array < 0), rule + " and >= 0"
        if is_bad.any():
            raise ValueError(f"{name} = {array[is_bad][0]}: must be {rule}")


def _forced_size(table, to_wall):
    """Displacement [m] that the forcing keeps up against the springs, and the wall if it is met."""
    push = np.abs(table[row.PUSH])
    cubic = np.cbrt(np.abs(table[row.CUBIC]) * push**2)
    springs = table[row.STIFFNESS] + cubic + table[row.OMEGA_RAD] ** 2
    free = push / springs
    beyond = np.maximum(free - to_wall, 0.0)
    return free - beyond * (table[row.CONTACT] / (springs + table[row.CONTACT]))


def _set_mode_on_walls(points):
    """Contact mode of points that start on a wall: the first derivative of x that is not zero
    decides; up to the fourth none of them depends on the mode, because the lower ones are zero
    then."""
    on_wall = (points[row.X] == points[row.UPPER]) | (points[row.X] == points[row.LOWER])
    table = points[:, on_wall]
    x, v = table[row.X], table[row.V]
    push, omega_rad = table[row.PUSH], table[row.OMEGA_RAD]
    cosine, sine = _cos_sin_of_period(table[row.TAU])
    with np.errstate(over="ignore", invalid="ignore"):  # such a start diverges in the kernel
        acceleration = (
            push * cosine
            - table[row.DAMPING] * v
            - x * (table[row.STIFFNESS] + table[row.CUBIC] * x * x)
        )
    heading = np.sign(v)
    for derivative in (acceleration, -push * omega_rad * sine, -push * omega_rad**2 * cosine):
        heading = np.where(heading == 0.0, np.sign(derivative), heading)
    is_above = (x == table[row.UPPER]) & (heading > 0)
    is_below = (x == table[row.LOWER]) & (heading < 0)
    points[row.MODE, on_wall] = np.where(is_above, 1.0, np.where(is_below, -1.0, 0.0))


def _cos_sin_of_period(tau):
    """cos and sin of 2 pi tau, exactly 0 or 1 at quarter periods as in the kernel."""
    quarter = np.rint(4 * tau)
    angle = (4 * tau - quarter) * (np.pi / 2)
    z = np.exp(1j * angle) * np.array([1, 1j, -1, -1j])[quarter.astype(int) % 4]
    return z.real, z.imag


def _set_idle(point):
    """Rest without forcing, walls or end: what a lane does when no point waits for it."""
    point[[row.OMEGA, row.PERIOD, row.UPPER, row.FLOOR]] = 1.0
    point[row.LOWER] = -1.0
    point[[row.END_CYCLE, row.RECORD_CLOCK, row.EVENT_CLOCK]] = np.inf


def _drained(points, queue, statuses, degree, tangent, limits, dense_output):
    """Call the kernel until all points have ended; returns what it recorded."""
    lanes = np.empty((row.N_ROWS, row.WIDTH))
    lane_point = np.full(row.WIDTH, -2)
    coefficients = np.zeros(((3 if tangent else 1) * (degree + 1), row.WIDTH))
    is_recording = bool(np.isfinite(points[:-1, row.RECORD_CLOCK]).any())
    room = row.WIDTH * (degree + 4)
    log = np.empty((_LOG_ROWS if is_recording else room + 1, record.N_FIELDS))
    dense = np.empty((_DENSE_ROWS if dense_output else 0, record.DENSE_HEAD + degree + 1))
    fill, progress = np.zeros(2, np.int64), np.zeros(2, np.int64)
    logs, denses, work = [], [], work_space(degree)
    outcome = BUDGET_SPENT
    while outcome != FINISHED:
        outcome = advance(
            lanes,
            lane_point,
            points,
            queue,
            statuses,
            progress,
            coefficients,
            (0,) * degree,
            (0,) * int(tangent),
            limits,
            log,
            dense,
            fill,
            work,
            _BUDGET,
        )
        if outcome in (BUFFER_FULL, FINISHED):
            logs.append(log[: fill[0]].copy())
            denses.append(dense[: fill[1]].copy())
            fill[:] = 0
    return _by_point(logs), _by_point(denses) if dense_output else None


def _by_point(pieces):
    """All rows in the order of their points; rows of one point keep theirs."""
    rows = np.concatenate(pieces) if len(pieces) > 1 else pieces[0]
    if not len(rows):
        return rows
    points = rows[:, 0].astype(np.int64)
    # numpy sorts keys of 16 bits in linear time, ten times as fast as wider ones
    order = np.argsort((points & 0xFFFF).astype(np.uint16), kind="stable")
    if points.max() > 0xFFFF:
        high = (points >> 16).astype(np.uint16)
        order = order[np.argsort(high[order], kind="stable")]
    return rows.take(order, axis=0)


def _outcome(points, statuses, t_end, tangent, log, dense):
    table = points.T
    elapsed = table[row.CYCLE] + (table[row.TAU] - table[row.TAU_START])
    monodromy = None
    if tangent:
        # columns are the images of a unit displacement and of a unit velocity
        monodromy = (
            table[row.TANGENT : row.TANGENT + 4].T.reshape(-1, 2, 2).transpose(0, 2, 1).copy()
        )
    n_steps = table[row.N_STEPS].astype(np.int64)
    return Exact(
        x=table[row.X].copy(),
        v=table[row.V].copy(),
        t=np.where(statuses == OK, t_end, table[row.T_START] + elapsed * table[row.PERIOD]),
        mode=table[row.MODE].astype(np.int64),
        status=statuses,
        n_contacts=table[row.N_CONTACTS].astype(np.int64),
        n_steps=n_steps,
        n_rejected=np.zeros_like(statuses),
        nfev=n_steps,
        reach=table[row.REACH].copy(),
        monodromy=monodromy,
        log=log,
        dense=dense,
    )
