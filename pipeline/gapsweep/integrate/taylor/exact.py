"""Many points of the exact contact law at once: arrays in, arrays and event lists out.

`integrate` is the compiled engine behind ``simulate(..., engine="compiled")`` for the piecewise
law: it prepares one table row per point, runs `exact_kernel.advance` on it, and drains its buffers.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import lane_rows as row
from . import record
from .exact_kernel import BUDGET_SPENT, BUFFER_FULL, FINISHED, OK, RUNNING, advance
from .roots import MAX_DEGREE, work_space
from .sample import sample_steps

FloatArray = NDArray[np.float64]

# Degree of the Taylor polynomial by relative tolerance: the cheapest measured on the benchmark
# scenes. (smallest rtol it is used for, degree)
ORDERS = ((2e-5, 8), (2e-8, 12), (2e-11, 16), (0.0, 20))
# The absolute part of a step's tolerance never exceeds rtol times this part of the motion's
# natural size: a step at high order costs so little more that a generous atol buys nothing, and
# would only spoil motions much smaller than a metre. It is never zero in motion, so that a
# start at rest, without an amplitude of its own, gets a finite step.
_FLOOR_SHARE = 1e-3
# Shortest step that makes progress, in rad of the natural or forcing frequency: a stiffness of 1e9
# N/m takes steps a million times longer, and a run of shorter ones would never end.
_MIN_STEP = 1e-10
_CLOCK_ROUNDING = 4.0 * np.finfo(float).eps
_LOG_ROWS = 1 << 14
_DENSE_ROWS = 1 << 11
_BUDGET = 1 << 16  # vector steps per call of the kernel, about 20 ms: Ctrl-C is answered in between


@dataclass(frozen=True, slots=True)
class Exact:
    """Outcome of `integrate`; arrays of shape (n,) unless noted, one entry per point.

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
    tangent: bool = False,
    dense_output: bool = False,
    order: int | None = None,
    x_bound: float = 1e3,
    max_chatter: int = 100,
) -> Exact:
    """Integrate the freeplay oscillator with every contact located, many points in lanes.

    All array arguments broadcast to one shape (n,). A point's result does not depend, to the
    last bit, on which others share the call.

    Parameters
    ----------
    zeta, mass, alpha, forcing, K_c : array_like
        Damping ratio [-], mass [kg], cubic stiffness [N/m^3], forcing [N], contact stiffness [N/m].
    omega_n, omega : array_like
        Natural and forcing frequency [Hz], both > 0.
    j_1, j_2 : array_like
        Distances of the walls from the origin [m], >= 0; infinity: no wall.
    x_0, v_0, t_0, t_end : array_like
        Start [m, m/s, s] and end [s].
    record_from : array_like
        Time from which extrema, contacts and section points are recorded [s]. A start is not an
        event: only what happens after `t_0` is recorded.
    rtol, atol : float
        A step's error in displacement is kept near ``atol + rtol * max(|x|, |v| / w)`` with
        ``w = max(omega_n, omega)`` (rad/s): a velocity counts as the displacement it swings to. In
        contact, x counts from the wall and ``w**2`` grows by ``K_c / mass``. `atol` [m] can only
        tighten: it is limited to ``1e-3 * rtol`` of the motion's natural size.
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

    Returns
    -------
    Exact
    """
    given = (
        zeta,
        omega_n,
        mass,
        alpha,
        forcing,
        K_c,
        j_1,
        j_2,
        omega,
        x_0,
        v_0,
        t_0,
        t_end,
        record_from,
    )
    arrays = [
        np.asarray(a, dtype=float).ravel() for a in np.broadcast_arrays(*np.atleast_1d(*given))
    ]
    _check(dict(zip(_NAMES, arrays, strict=True)), rtol, atol)
    points = _points(*arrays, atol=atol, rtol=rtol)
    degree = order_for(rtol) if order is None else order
    if not 6 <= degree <= MAX_DEGREE:
        raise ValueError(f"order = {degree}: must lie in [6, {MAX_DEGREE}]")
    statuses = np.full(len(points) - 1, RUNNING)
    log, dense = _run(
        points, statuses, degree, tangent, (rtol, x_bound, float(max_chatter)), dense_output
    )
    return _outcome(points[:-1], statuses, arrays[_NAMES.index("t_end")], tangent, log, dense)


_NAMES = (
    "zeta",
    "omega_n",
    "mass",
    "alpha",
    "forcing",
    "K_c",
    "j_1",
    "j_2",
    "omega",
    "x_0",
    "v_0",
    "t_0",
    "t_end",
    "record_from",
)
_POSITIVE = ("omega_n", "mass", "omega")
_NOT_NEGATIVE = ("zeta", "K_c", "j_1", "j_2")
_MAY_BE_INFINITE = ("j_1", "j_2", "record_from")


def _check(values, rtol, atol):
    """Refuse what would make the kernel's arithmetic meaningless; names the offending value."""
    if not 1e-14 <= rtol <= 1e-1:
        raise ValueError(f"rtol = {rtol}: must lie in [1e-14, 0.1]")
    if not 0.0 <= atol < np.inf:
        raise ValueError(f"atol = {atol}: must be finite and >= 0")
    for name, array in values.items():
        is_bad = np.isnan(array) if name in _MAY_BE_INFINITE else ~np.isfinite(array)
        rule = "a number" if name in _MAY_BE_INFINITE else "finite"
        if name in _POSITIVE:
            is_bad, rule = is_bad | (array <= 0), "finite and > 0"
        elif name in _NOT_NEGATIVE:
            is_bad, rule = is_bad | (array < 0), rule + " and >= 0"
        if is_bad.any():
            raise ValueError(f"{name} = {array[is_bad][0]}: must be {rule}")
    if (values["t_end"] < values["t_0"]).any():
        raise ValueError("t_end lies before t_0")


def _points(
    zeta,
    omega_n,
    mass,
    alpha,
    forcing,
    K_c,
    j_1,
    j_2,
    omega,
    x_0,
    v_0,
    t_0,
    t_end,
    record_from,
    *,
    atol,
    rtol,
):
    """The table of points that the kernel reads, shape (n + 1, N_ROWS); the idle point is last."""
    n_rad, omega_rad = 2 * np.pi * omega_n, 2 * np.pi * omega
    points = np.zeros((len(zeta) + 1, row.N_ROWS))
    table = points[:-1].T
    table[row.X], table[row.V] = x_0, v_0
    table[row.TANGENT], table[row.TANGENT + 3] = 1.0, 1.0
    table[row.STIFFNESS], table[row.DAMPING] = n_rad**2, 2 * zeta * n_rad
    table[row.CUBIC], table[row.PUSH], table[row.CONTACT] = alpha / mass, forcing / mass, K_c / mass
    table[row.LOWER], table[row.UPPER] = -j_1, j_2
    table[row.OMEGA], table[row.OMEGA_RAD], table[row.PERIOD] = omega, omega_rad, 1.0 / omega
    table[row.VELOCITY_SCALE] = 1.0 / np.maximum(n_rad, omega_rad)
    table[row.CONTACT_SCALE] = 1.0 / np.sqrt(np.maximum(n_rad, omega_rad) ** 2 + K_c / mass)
    forced_size = np.abs(forcing) / mass / (n_rad**2 + omega_rad**2)
    start_size = np.maximum(np.abs(x_0), np.abs(v_0) * table[row.VELOCITY_SCALE])
    floor = rtol * _FLOOR_SHARE * np.maximum(forced_size, start_size)
    table[row.FLOOR] = np.minimum(floor, atol) if atol > 0 else floor
    table[row.RATE] = np.sqrt(n_rad**2 + K_c / mass) + omega_rad
    table[row.MIN_STEP] = _MIN_STEP / np.maximum(n_rad, omega_rad)
    _set_clocks(table, t_0, t_end, record_from, omega)
    table[row.MODE] = _start_mode(table)
    _set_idle(points[-1])
    return points


def _set_clocks(table, t_0, t_end, record_from, omega):
    # The product is rounded to a whole number if t_0 was meant as one: its rounding and that of
    # t_0 are of one size. Everything later counts from the start, so nothing else is lost.
    start = t_0 * omega
    tau = start - np.floor(start)
    end = tau + (t_end - t_0) * omega
    stop = t_end * omega
    end = np.where((tau == 0.0) & (stop == np.rint(stop)), stop - start, end)
    # An end that rounding alone separates from a whole period is meant as one: else its section
    # point would be lost.
    whole = np.rint(end)
    end = np.where(np.abs(end - whole) <= _CLOCK_ROUNDING * (1.0 + end), whole, end)
    table[row.TAU] = table[row.TAU_START] = tau
    table[row.T_START] = t_0
    table[row.END_CYCLE] = np.floor(end)
    table[row.END_TAU] = end - np.floor(end)
    table[row.RECORD_CLOCK] = tau + (record_from - t_0) * omega


def _start_mode(table):
    """Contact mode at the start. On a wall the first derivative of x that is not zero decides;
    up to the fourth none of them depends on the mode, because the lower ones are zero then."""
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
    is_above = (x > table[row.UPPER]) | ((x == table[row.UPPER]) & (heading > 0))
    is_below = (x < table[row.LOWER]) | ((x == table[row.LOWER]) & (heading < 0))
    return np.where(is_above, 1.0, np.where(is_below, -1.0, 0.0))


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
    point[[row.END_CYCLE, row.RECORD_CLOCK]] = np.inf


def _run(points, statuses, degree, tangent, limits, dense_output):
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
    points = rows[:, 0].astype(np.int64)
    # numpy sorts keys of 16 bits in linear time, ten times as fast as wider ones
    order = np.argsort((points & 0xFFFF).astype(np.uint16), kind="stable")
    if len(points) and points.max() > 0xFFFF:
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
    counts = {
        name: table[r].astype(np.int64)
        for name, r in (("n_contacts", row.N_CONTACTS), ("n_steps", row.N_STEPS))
    }
    return Exact(
        x=table[row.X].copy(),
        v=table[row.V].copy(),
        t=np.where(statuses == OK, t_end, table[row.T_START] + elapsed * table[row.PERIOD]),
        mode=table[row.MODE].astype(np.int64),
        status=statuses,
        n_rejected=np.zeros_like(statuses),
        nfev=counts["n_steps"].copy(),
        monodromy=monodromy,
        log=log,
        dense=dense,
        **counts,
    )
