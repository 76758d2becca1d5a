"""An independent oracle: systems with freeplay, solved by matrix exponentials.

The motion of

    M q'' + C q' + K q + sum_j b_j F_j(b_j . q) + D z = sum_k p_k cos(2 pi k w t + phi_k),
    z' = E q' + G q + H z,

is linear as long as no contact opens or closes, and then a matrix exponential gives it exactly.
Each stretch of it goes on in short steps. Over a step every gap is a polynomial to rounding: its
extremes and its first exit are found on that, and the exit is polished on the exponential. Nothing
is discretised: what errors there are come from rounding, in numpy's `longdouble`, which has 64 bits
on x86 and may have no more than a double's 53 elsewhere.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

Real = np.longdouble
Array = NDArray[np.longdouble]
EPS = float(np.finfo(Real).eps)
PI = Real(4) * np.arctan(Real(1))

DEGREE = 32  # of a gap's Chebyshev polynomial over a step of REACH / (fastest rate) seconds:
REACH = 6.0  # its last coefficient is then about (REACH / 4)^DEGREE / DEGREE! = 2e-30
SLOWEST = 1e-2  # of the fastest rate with all contacts closed: steps are no longer than for that
TAIL = 1e3 * EPS  # the largest last coefficient that is taken, of the largest one
GRAZE = 1e2 * EPS  # of a gap's size: a deeper excursion is one, a shallower one is rounding
NEAR = 1e-3  # of a gap's size: extremes this close to a wall are looked at
_TERMS = 22  # of the exponential's series: 1/23! = 4e-23
_POLISH = 1e-12  # of a step: a larger correction of an exit's time is none
_MAX_ZERO_LENGTHS = 20  # crossings in a row at one instant, before it is called chatter
_GRID = np.linspace(-1.0, 1.0, 2 * DEGREE + 1)
_ANGLES = PI * (np.arange(DEGREE + 1, dtype=Real) + Real(0.5)) / (DEGREE + 1)
_TO_COEFFICIENTS = 2 * np.cos(np.outer(np.arange(DEGREE + 1), _ANGLES)) / (DEGREE + 1)
_TO_COEFFICIENTS[0] /= 2


@dataclass(frozen=True, eq=False)
class Contact:
    """A spring with freeplay: F = K_c (g - j_2) above j_2, K_1 (g + j_1) below -j_1, else 0.

    Parameters
    ----------
    b : ndarray, shape (n,)
        Direction: the contact feels g = b . q [m].
    K_c : float
        Contact stiffness [N/m].
    j_1, j_2 : float
        Distances of the lower and the upper wall from g = 0 [m], >= 0.
    K_ratio : float
        K_1 / K_c: stiffness of the lower wall over that of the upper.
    """

    b: ArrayLike
    K_c: float
    j_1: float
    j_2: float
    K_ratio: float = 1.0

    def stiffness(self, mode: int) -> float:
        """Contact stiffness [N/m] at the lower wall (-1), in the gap (0), at the upper wall (1)."""
        return {-1: self.K_ratio * self.K_c, 0: 0.0, 1: self.K_c}[mode]

    def force(self, g: ArrayLike) -> NDArray[np.float64]:
        """Restoring force [N], shape of `g` [m]."""
        above, below = np.maximum(g - self.j_2, 0.0), np.minimum(g + self.j_1, 0.0)
        return self.K_c * (above + self.K_ratio * below)


@dataclass(frozen=True, eq=False)
class Harmonic:
    """A load p cos(2 pi k w t + phase); k = 0 is a constant load p cos(phase).

    Parameters
    ----------
    p : ndarray, shape (n,)
        Amplitudes [N].
    k : int
        Multiple of the forcing frequency.
    phase : float
        In rad.
    """

    p: ArrayLike
    k: int = 1
    phase: float = 0.0


@dataclass(frozen=True, eq=False)
class System:
    """The equations of the module's docstring, without the forcing frequency w.

    Parameters
    ----------
    M, C, K : ndarray, shape (n, n)
        Mass [kg], damping [N s/m] and stiffness [N/m]; only M must be symmetric, and definite.
    contacts : tuple of Contact
    harmonics : tuple of Harmonic
    D, E, G, H : ndarray, shapes (n, m), (m, n), (m, n), (m, m), or None
        The m first-order lags: all four, or none.
    """

    M: ArrayLike
    C: ArrayLike
    K: ArrayLike
    contacts: tuple[Contact, ...] = ()
    harmonics: tuple[Harmonic, ...] = ()
    D: ArrayLike | None = None
    E: ArrayLike | None = None
    G: ArrayLike | None = None
    H: ArrayLike | None = None

    @property
    def n(self) -> int:
        """Degrees of freedom."""
        return len(self.M)

    @property
    def n_lags(self) -> int:
        return 0 if self.H is None else len(self.H)

    def lags(self, dtype: type = float) -> list[NDArray]:
        """D, E, G and H, with no rows or columns where there are no lags."""
        n, m = self.n, self.n_lags
        shapes = ((n, m), (m, n), (m, n), (m, m))
        given = (self.D, self.E, self.G, self.H)
        return [np.reshape(() if a is None else np.asarray(a, dtype), s)
                for a, s in zip(given, shapes, strict=True)]  # fmt: skip


@dataclass(frozen=True)
class Crossing:
    """A gap passes a wall."""

    t: float  # time [s]
    contact: int  # number of the contact
    wall: int  # +1 the upper, -1 the lower wall
    is_entry: bool  # whether contact begins here, or ends


@dataclass(frozen=True, eq=False)
class Motion:
    """Outcome of `motion`."""

    # `q`, `v`, `z`: shapes (n,), (n,), (m,); state at the end [m, m/s, the lags' own unit].
    q: NDArray[np.float64]
    v: NDArray[np.float64]
    z: NDArray[np.float64]
    # In order of time; those of one instant in the order they were taken in.
    crossings: tuple[Crossing, ...]
    modes: tuple[int, ...]  # contacts at the end: -1 lower wall, 0 gap, +1 upper wall
    # Shape (2 n + m, 2 n + m); derivative of (q, v, z) at the end by (q, v, z) at the start.
    monodromy: NDArray[np.float64]
    rate: float  # fastest undamped rate with all contacts closed [rad/s]
    # Smallest distance of a gap's extreme from a wall [m], crossed there or not; inf if all are
    # further than `NEAR` of the gap's size. A small one means that the crossings' number hangs on
    # as small a change of the motion.
    clearance: float

    @property
    def n_crossings(self) -> int:
        return len(self.crossings)

    @property
    def state(self) -> NDArray[np.float64]:
        """(q, v, z) at the end, shape (2 n + m,)."""
        return np.concatenate([self.q, self.v, self.z])

    @property
    def sensitivity(self) -> float:
        """Norm of the monodromy matrix for velocities in units of `rate`: errors grow by it."""
        unit = np.ones(len(self.monodromy))
        unit[len(self.q) : 2 * len(self.q)] = self.rate
        return float(np.linalg.norm(self.monodromy * unit / unit[:, None], 2))


def motion(
    system: System,
    omega: float,
    q_0: ArrayLike,
    v_0: ArrayLike,
    z_0: ArrayLike,
    t_end: float,
) -> Motion:
    """The motion from t = 0 to `t_end` [s].

    A start on a wall is in contact if the motion goes into it; that is no crossing. Raises
    `RuntimeError` if a contact opens and closes without end at one instant.

    Parameters
    ----------
    omega : float
        Forcing frequency w [Hz].
    q_0, v_0 : array_like, shape (n,)
        State at the start [m, m/s].
    z_0 : array_like, shape (m,)
        Lags at the start; () where there are none.
    """
    flows = _Flows(system, omega)
    n, m, rate = system.n, flows.n_states, flows.rate
    unit = np.ones(m, Real)
    unit[n : 2 * n] = rate
    state = np.concatenate([np.asarray(x, Real) for x in (q_0, v_0, z_0)]) / unit
    modes = _modes_at(flows, state, Real(0))
    tangent, clearance = np.eye(m, dtype=Real), np.inf
    crossings, n_zero_lengths = [], 0
    t, t_end = Real(0), Real(t_end)
    while t < t_end:
        flow = flows[modes]
        y = np.concatenate([state, flows.drive(t)])
        length = min(flow.step, t_end - t)
        leaving, extreme = _first_exit(flow, y, length)
        clearance = min(clearance, extreme)
        if leaving is not None:
            length, propagator = _arrive(flow, y, leaving)
        elif length == flow.step:
            propagator = flow.over_step
        else:
            propagator = exponential(flow.generator * length)
        state = propagator[:m] @ y
        tangent = propagator[:m, :m] @ tangent
        t += length
        if leaving is None:
            continue
        n_zero_lengths = n_zero_lengths + 1 if length == 0.0 else 0
        if n_zero_lengths > _MAX_ZERO_LENGTHS:
            raise RuntimeError(f"contact {leaving.exit.contact} chatters at t = {t} s")
        crossings.append(leaving.exit.crossing(t))
        modes = tuple(
            leaving.exit.next_mode if j == leaving.exit.contact else mode
            for j, mode in enumerate(modes)
        )
    end = (state * unit).astype(float)
    return Motion(
        q=end[:n],
        v=end[n : 2 * n],
        z=end[2 * n :],
        crossings=tuple(crossings),
        modes=modes,
        monodromy=(tangent * unit[:, None] / unit).astype(float),
        rate=float(rate),
        clearance=float(clearance),
    )


def exponential(matrix: Array) -> Array:
    """Exponential of square matrices, shape (..., n, n), by its series, scaled and squared."""
    norm = float(np.abs(matrix).sum(axis=-1).max(initial=0.0))
    n_squarings = max(0, math.frexp(norm)[1])
    scaled = matrix / Real(2.0**n_squarings)
    identity = np.eye(matrix.shape[-1], dtype=Real)
    total = identity + scaled / _TERMS
    for k in range(_TERMS - 1, 0, -1):
        total = identity + scaled @ total / k
    for _ in range(n_squarings):
        total = total @ total
    return total


def inverse(matrix: ArrayLike) -> Array:
    """Inverse of a well-conditioned matrix: a double's, refined by Newton's method."""
    exact = np.asarray(matrix, Real)
    result = np.linalg.inv(np.asarray(matrix, float)).astype(Real)
    for _ in range(2):
        result = result @ (2 * np.eye(len(exact), dtype=Real) - exact @ result)
    return result


# --- The linear flow between two crossings -----------------------------------------------------


@dataclass(frozen=True)
class _Exit:
    """A way out of a mode: `sign` (g - wall) is positive inside and falls through zero."""

    contact: int
    sign: int
    wall: Real
    mode: int
    next_mode: int

    def crossing(self, t: Real) -> Crossing:
        is_entry = self.mode == 0
        return Crossing(float(t), self.contact, self.next_mode if is_entry else self.mode, is_entry)


def _exits(contact: Contact, number: int, mode: int) -> Iterator[_Exit]:
    upper, lower = Real(contact.j_2), -Real(contact.j_1)
    if mode == 0:
        yield _Exit(number, -1, upper, 0, +1)
        yield _Exit(number, +1, lower, 0, -1)
    else:
        yield _Exit(number, mode, upper if mode > 0 else lower, mode, 0)


class _Flows(dict[tuple[int, ...], "_Flow"]):
    """The flow of every mode, built where it is first asked for.

    The augmented state is y = (q, v / rate, z, (cos, sin) of each harmonic, 1): one unit for
    displacements and velocities, so that the exponential loses nothing by their scales.
    """

    def __init__(self, system: System, omega: float) -> None:
        super().__init__()
        self.system = system
        self.n_states = 2 * system.n + system.n_lags
        self.compliance = inverse(system.M)  # of the masses, 1/kg
        self.multiples = np.array([h.k for h in system.harmonics], Real)
        self.phases = np.array([h.phase for h in system.harmonics], Real)
        self.omega = Real(omega)
        closed = np.asarray(system.K, float) + sum(
            max(c.stiffness(-1), c.K_c) * np.outer(c.b, c.b) for c in system.contacts
        )
        stiffest = np.abs(np.linalg.eigvals(self.compliance.astype(float) @ closed)).max()
        self.rate = max(Real(math.sqrt(stiffest)), 2 * PI * self.omega)
        self.gap_rows = np.zeros((len(system.contacts), self.size), Real)
        for row, contact in zip(self.gap_rows, system.contacts, strict=True):
            row[: system.n] = contact.b

    @property
    def size(self) -> int:
        return self.n_states + 2 * len(self.multiples) + 1

    def drive(self, t: Real) -> Array:
        """(cos, sin) of each harmonic and 1, from the absolute time: no error builds up."""
        angle = 2 * PI * np.mod(self.multiples * self.omega * t, 1) + self.phases
        return np.append(np.column_stack([np.cos(angle), np.sin(angle)]).ravel(), Real(1))

    def __missing__(self, modes: tuple[int, ...]) -> "_Flow":
        exits = [
            way
            for number, (contact, mode) in enumerate(zip(self.system.contacts, modes, strict=True))
            for way in _exits(contact, number, mode)
        ]
        slowest = SLOWEST * self.rate  # where nothing swings, as in free flight
        self[modes] = _Flow(self.generator(modes), self.gap_rows, exits, slowest)
        return self[modes]

    def generator(self, modes: tuple[int, ...]) -> Array:
        """Matrix L of y' = L y [1/s], shape (size, size)."""
        system, n, m = self.system, self.system.n, self.n_states
        stiffness, offset = np.asarray(system.K, Real), np.zeros(n, Real)
        for contact, mode in zip(system.contacts, modes, strict=True):
            if mode != 0:
                b, wall = np.asarray(contact.b, Real), contact.j_2 if mode > 0 else -contact.j_1
                spring = Real(contact.stiffness(mode))
                stiffness = stiffness + spring * np.outer(b, b)
                offset += spring * Real(wall) * b
        lag_force, by_velocity, by_displacement, by_lag = system.lags(Real)
        q, v, z = slice(0, n), slice(n, 2 * n), slice(2 * n, m)
        matrix = np.zeros((self.size, self.size), Real)
        matrix[q, v] = self.rate * np.eye(n)
        matrix[v, q] = -self.compliance @ stiffness / self.rate
        matrix[v, v] = -self.compliance @ np.asarray(system.C, Real)
        matrix[v, z] = -self.compliance @ lag_force / self.rate
        matrix[z, q], matrix[z, v], matrix[z, z] = by_displacement, by_velocity * self.rate, by_lag
        for i, harmonic in enumerate(system.harmonics):
            cos, sin = m + 2 * i, m + 2 * i + 1
            turn = 2 * PI * harmonic.k * self.omega
            matrix[v, cos] = self.compliance @ np.asarray(harmonic.p, Real) / self.rate
            matrix[cos, sin], matrix[sin, cos] = -turn, turn
        matrix[v, -1] = self.compliance @ offset / self.rate
        return matrix


class _Flow:
    """The flow of one mode.

    Attributes
    ----------
    generator : ndarray, shape (size, size)
    gap_rows : ndarray, shape (n_contacts, size)
        Gaps of an augmented state: g = gap_rows @ y.
    exits : list of _Exit
    step : longdouble
        Length of a step [s].
    over_step : ndarray, shape (size, size)
        Propagator of a step.
    coefficients : ndarray, shape (n_contacts, DEGREE + 1, size)
        Chebyshev coefficients of the gaps over a step, by the state at its start.
    """

    def __init__(
        self, generator: Array, gap_rows: Array, exits: list[_Exit], slowest: Real
    ) -> None:
        self.generator, self.gap_rows, self.exits = generator, gap_rows, exits
        fastest = np.abs(np.linalg.eigvals(generator.astype(float))).max()
        self.step = REACH / max(slowest, Real(fastest))
        self.coefficients = self._interpolated()
        while np.abs(self.coefficients[:, -2:]).max(initial=0) > TAIL:  # gaps are of size 1 by q
            self.step /= 2
            self.coefficients = self._interpolated()

    def _interpolated(self) -> Array:
        times = (np.cos(_ANGLES) + 1) / 2 * self.step
        at_nodes = self.gap_rows @ exponential(self.generator * times[:, None, None])
        return np.einsum("kn,njy->jky", _TO_COEFFICIENTS, at_nodes)

    @cached_property
    def over_step(self) -> Array:
        return exponential(self.generator * self.step)


def _modes_at(flows: _Flows, state: Array, t: Real) -> tuple[int, ...]:
    """Modes at the start; on a wall, by the first derivative of the gap that is not zero.

    The force has no jump: a gap's k-th derivative bends others from the (k + 2)-th on only. In
    order of k, every derivative is therefore that of modes known by then.
    """
    y = np.concatenate([state, flows.drive(t)])
    gaps, contacts = flows.gap_rows @ y, flows.system.contacts
    above = [g > Real(c.j_2) for g, c in zip(gaps, contacts, strict=True)]
    below = [g < -Real(c.j_1) for g, c in zip(gaps, contacts, strict=True)]
    modes = [int(a) - int(b) for a, b in zip(above, below, strict=True)]
    walls = {
        j: {side for side, wall in ((1, Real(c.j_2)), (-1, -Real(c.j_1))) if gaps[j] == wall}
        for j, c in enumerate(contacts)
    }
    undecided = [j for j in walls if walls[j]]
    for order in range(1, 2 * flows.size):
        if not undecided:
            break
        generator = flows.generator(tuple(modes)) / flows.rate
        derivatives, sizes = y, np.abs(y)
        for _ in range(order):
            derivatives, sizes = generator @ derivatives, np.abs(generator) @ sizes
        for j in list(undecided):
            derivative = flows.gap_rows[j] @ derivatives
            if abs(derivative) > GRAZE * (np.abs(flows.gap_rows[j]) @ sizes):
                direction = 1 if derivative > 0 else -1
                modes[j] = direction if direction in walls[j] else 0
                undecided.remove(j)
    return tuple(modes)


# --- Exits from a mode --------------------------------------------------------------------------


@dataclass(frozen=True)
class _Leaving:
    exit: _Exit
    after: Real  # s from the step's start


def _first_exit(flow: _Flow, y: Array, length: Real) -> tuple[_Leaving | None, float]:
    """The first exit within `length` [s], and the least distance of an extreme from a wall [m]."""
    gaps = flow.coefficients @ y
    stop, first, clearance = float(2 * length / flow.step - 1), None, np.inf
    for way in flow.exits:
        margin = way.sign * gaps[way.contact]
        margin[0] -= way.sign * way.wall
        s, extreme = _first_below(margin, stop)
        clearance = min(clearance, extreme)
        if s is not None:
            stop, first = s, _Leaving(way, (Real(s) + 1) / 2 * flow.step)
    return first, clearance


def _first_below(margin: Array, stop: float) -> tuple[float | None, float]:
    """First point in [-1, stop] at which a Chebyshev series falls below zero, or None.

    Between the points looked at it is monotone, for all its extremes are among them. At -1 it is
    zero or more; a value below is a zero, rounded. The second value is the extreme nearest zero.
    """
    size = float(np.abs(margin).sum())
    least = float(margin[0] - np.abs(margin[1:]).sum())
    if size == np.inf or least >= NEAR * size:
        return None, np.inf
    extremes = _extremes(margin, stop)
    clearance = float(np.abs(chebyshev.chebval(extremes, margin)).min(initial=np.inf))
    points = np.sort(np.concatenate([extremes, _GRID[stop > _GRID], [stop]]))
    values = chebyshev.chebval(points, margin)
    outside = np.flatnonzero(values[1:] < -GRAZE * size)
    if not outside.size:
        return None, clearance
    after = outside[0] + 1
    inside = np.flatnonzero(values[:after] > 0.0)
    if not inside.size:
        return -1.0, clearance
    before = inside[-1]
    root = brentq(
        lambda s: float(chebyshev.chebval(s, margin)), points[before], points[after], xtol=1e-15
    )
    return root, clearance


def _extremes(margin: Array, stop: float) -> NDArray[np.float64]:
    """Extremes of a Chebyshev series in (-1, stop); rounded inflections among them do no harm."""
    slope = chebyshev.chebder(margin).astype(float)
    roots = chebyshev.chebroots(chebyshev.chebtrim(slope, 1e-16 * np.abs(slope).max()))
    near = roots.real[np.abs(roots.imag) < 1e-5]
    return near[(near > -1.0) & (near < stop)]


def _arrive(flow: _Flow, y: Array, leaving: _Leaving) -> tuple[Real, Array]:
    """Time to an exit [s] and the propagator to there, by Newton's method from a good guess."""
    row, wall, after = flow.gap_rows[leaving.exit.contact], leaving.exit.wall, leaving.after
    propagator = exponential(flow.generator * after)
    back = flow.generator @ propagator
    late, speed = row @ propagator @ y - wall, row @ back @ y
    # One step of it, and none at a touch, where the speed says nothing. It is of rounding's size,
    # so that the propagator's change is its first derivative times it.
    if abs(late) <= min(after, _POLISH * flow.step) * abs(speed):
        after, propagator = after - late / speed, propagator - back * (late / speed)
    return after, propagator


# --- Random systems -----------------------------------------------------------------------------

DEFLECTION = 1e-3  # m: what the loads do to the springs without contacts, roughly


def random_system(
    rng: np.random.Generator,
    n: int,
    n_contacts: int,
    *,
    constant_load: bool = False,
    lags: bool = False,
) -> tuple[System, float]:
    """A system of `n` degrees of freedom, and a forcing frequency [Hz] for it.

    Natural frequencies .3 to 10 Hz, damping ratios .5 to 10 %, contacts of 1 to 1000 times the
    stiffness they act on, at coordinates or between two of them; one or two harmonics of .3 to
    5 Hz. Gaps are a share of the motion there would be without contacts. Stable with any contacts
    open and closed, but chaotic about as often as not: see `Motion.sensitivity`.
    """
    root = _rotation(rng, n) * _log_uniform(rng, 0.5, 2.0, n)
    modes = root @ _rotation(rng, n)  # M = modes modes^T
    rates = 2.0 * math.pi * _log_uniform(rng, 0.3, 10.0, n)
    damping = _log_uniform(rng, 0.005, 0.1, n)
    stiffness = _symmetric(modes, rates**2)
    omega = float(_log_uniform(rng, 0.3, 5.0))
    multiples = rng.permutation([1, 2, 3])[: rng.integers(1, 3)]
    harmonics = [Harmonic(_load(rng, stiffness), int(k), _angle(rng)) for k in multiples]
    if constant_load:
        harmonics.append(Harmonic(_load(rng, stiffness), 0, 0.0))
    free = System(
        M=_symmetric(modes, np.ones(n)),
        C=_symmetric(modes, 2.0 * damping * rates),
        K=stiffness,
        harmonics=tuple(harmonics),
    )
    contacts = [_spring(rng, stiffness, b) for b in _directions(rng, n, n_contacts)]
    if lags:
        free = _with_lags(rng, replace(free, contacts=tuple(contacts)))
    contacts = [_with_walls(rng, free, omega, contact) for contact in contacts]
    return replace(free, contacts=tuple(contacts)), omega


def random_start(
    rng: np.random.Generator,
    system: System,
    omega: float,
    periods: tuple[float, float] = (5.0, 20.0),
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """q_0, v_0, z_0 of the size of the motion without contacts; t_end [s], in so many periods."""
    amplitudes = _amplitudes(system, omega)
    turns = 2.0 * math.pi * omega * np.array([h.k for h in system.harmonics])
    # The motion without contacts, each harmonic at another phase and strength, and some disorder.
    phases = np.exp(1j * rng.uniform(-math.pi, math.pi, len(turns)))
    share = np.where(turns == 0.0, 1.0, rng.uniform(0.0, 1.2, len(turns)) * phases)
    size = np.abs(amplitudes).sum(axis=0)
    disorder = 0.1 * rng.standard_normal((2, system.n)) * size
    q_0 = (share @ amplitudes).real + disorder[0]
    v_0 = ((1j * turns * share) @ amplitudes).real + turns.max(initial=0.0) * disorder[1]
    z_0 = rng.standard_normal(system.n_lags) * size.mean()
    return q_0, v_0, z_0, rng.uniform(*periods) / omega


def _log_uniform(rng: np.random.Generator, low: float, high: float, size: int | None = None):
    return np.exp(rng.uniform(math.log(low), math.log(high), size))


def _angle(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.0, 2.0 * math.pi))


def _rotation(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


def _symmetric(modes: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = (modes * values) @ modes.T
    return (matrix + matrix.T) / 2.0


def _load(rng: np.random.Generator, stiffness: NDArray[np.float64]) -> NDArray[np.float64]:
    """A load [N] that deflects the springs by about DEFLECTION."""
    return stiffness @ (rng.standard_normal(len(stiffness)) * DEFLECTION)


def _with_lags(rng: np.random.Generator, system: System) -> System:
    """One or two lags of .2 to 5 Hz, their forces weak enough for all modes to be stable."""
    n, m = system.n, int(rng.integers(1, 3))
    decay = 2.0 * math.pi * _log_uniform(rng, 0.2, 5.0, m)
    lagged = replace(
        system,
        D=0.2 * system.K @ rng.standard_normal((n, m)),
        E=rng.standard_normal((m, n)),
        G=decay[:, None] * rng.standard_normal((m, n)) / 2.0,
        H=-np.diag(decay),
    )
    while not _is_stable(lagged):
        lagged = replace(lagged, D=lagged.D / 2.0)
    return lagged


def _is_stable(system: System) -> bool:
    """Whether every mode is, for itself."""
    flows = _Flows(system, 0.0)
    states = slice(0, flows.n_states)
    all_modes = itertools.product((0, 1), repeat=len(system.contacts))
    generators = [flows.generator(modes)[states, states].astype(float) for modes in all_modes]
    return np.linalg.eigvals(generators).real.max() < 0.0


def _directions(rng: np.random.Generator, n: int, n_contacts: int) -> list[NDArray[np.float64]]:
    """Different unit vectors or differences of two of them, shape (n,) each."""
    unit = np.eye(n)
    pairs = [unit[i] - unit[j] for i in range(n) for j in range(i)]
    candidates = [*unit, *pairs]
    chosen = rng.choice(len(candidates), size=n_contacts, replace=False)
    return [candidates[i] for i in chosen]


def _spring(
    rng: np.random.Generator, stiffness: NDArray[np.float64], b: NDArray[np.float64]
) -> Contact:
    """A contact without walls yet."""
    return Contact(b, float(b @ stiffness @ b * _log_uniform(rng, 1.0, 1000.0)), 0.0, 0.0)


def _with_walls(rng: np.random.Generator, free: System, omega: float, contact: Contact) -> Contact:
    """Walls within the motion there would be without it, about its mean; some have one at 0."""
    amplitudes = _amplitudes(free, omega) @ contact.b
    is_constant = np.array([h.k == 0 for h in free.harmonics])
    mean = float(amplitudes[is_constant].real.sum())
    size = float(np.abs(amplitudes[~is_constant]).sum())
    j_1, j_2 = (
        max(0.0, side * mean + share * size)
        for side, share in zip((-1.0, 1.0), rng.uniform(0.3, 1.0, 2), strict=True)
    )
    return replace(contact, j_1=0.0 if rng.random() < 0.1 and j_2 > 0.0 else j_1, j_2=j_2)


def _amplitudes(system: System, omega: float) -> NDArray[np.complex128]:
    """Steady motion without contacts [m], complex, shape (n_harmonics, n)."""
    lag_force, by_velocity, by_displacement, by_lag = system.lags()
    rows = []
    for harmonic in system.harmonics:
        turn = 2j * math.pi * harmonic.k * omega
        dynamic = system.K + turn * system.C + turn**2 * system.M
        lagged = np.linalg.solve(turn * np.eye(len(by_lag)) - by_lag,
                                 turn * by_velocity + by_displacement)  # fmt: skip
        load = harmonic.p * np.exp(1j * harmonic.phase)
        rows.append(np.linalg.solve(dynamic + lag_force @ lagged, load))
    return np.array(rows)
