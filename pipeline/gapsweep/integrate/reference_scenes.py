"""Right-hand sides of the reference engine, for an oscillator and for a system."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.contact import ContactLaw
from gapsweep.model.contact_modes import HOLD, MODES, ON, SLACK
from gapsweep.model.oscillator import Oscillator
from gapsweep.model.system import first_order
from gapsweep.model.user_law import UserLaw
from gapsweep.model.waves import Wave

Array = NDArray[np.float64]
State = tuple[float, ...]
# Below this tolerance RK45 needs ten times the steps of DOP853.
TIGHT = 1e-6
_TOUCH = 1e-12

# Contact mode of every contact; None: the laws themselves, nothing is located.
Modes = tuple[int, ...] | None
Force = Callable[[float, float], float]


@dataclass(frozen=True, slots=True)
class ReferenceScene:
    """Model, laws, forcing and tolerances of one motion, with its right-hand side.

    A state is (q, v, z), then, with the tangent, the solutions that start from unit states. Times
    count from `t_0`; loads by pieces have the polynomials that hold at the time `piece`.
    """

    system: Any
    laws: tuple[ContactLaw, ...]
    omega: float
    theta_0: float
    rtol: float
    atol: float
    tangent: bool
    contact_force: str = "by_mode"
    t_0: float = 0.0
    piece: float = 0.0

    @property
    def method(self) -> str:
        return "RK45" if self.rtol >= TIGHT else "DOP853"

    @property
    def located(self) -> bool:
        return all(law.is_located for law in self.laws)

    @property
    def directions(self) -> Array:
        """Directions of the contacts, shape (n_contacts, n)."""
        return np.reshape(self.system.directions, (-1, self.n))

    @property
    def n_states(self) -> int:
        """Length of (q, v, z)."""
        return int(self.system.n_states)

    def rhs(self, modes: Modes) -> Callable[[float, Array], State]:
        """Return the right-hand side of the equation of motion in some contact modes."""
        raise NotImplementedError

    def knots(self, t_end: float) -> list[float]:
        """Times between zero and `t_end`, and this, at which a piece of a load ends."""
        return [t_end]

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return int(self.system.n)

    def gap(self, contact: int, q: Sequence[float] | Array) -> float:
        """Displacement of a contact between its walls [m]."""
        return float(self.directions[contact] @ q[: self.n])

    def wall(self, contact: int, side: int) -> float:
        return self.laws[contact].walls[side > 0]

    def force(self, contact: int, modes: Modes) -> Force:
        """Return the contact force: the law itself, or the branch of a located law in a mode."""
        law = self.laws[contact]
        if modes is None or self.contact_force == "as_written" or not law.has_modes:
            return lambda x, v: float(law.force(x, v))
        if isinstance(law, UserLaw):
            return self._in_mode(law.continued.force, contact, modes[contact])
        if abs(modes[contact]) != ON:
            return lambda x, v: 0.0
        return self.pressure(contact, modes[contact])

    def _in_mode(self, function: Callable[..., float], contact: int, mode: int) -> Force:
        """Return a function of `Continued` in the interval of the gap that a mode allows."""
        low, high = self.laws[contact].walls
        if mode:
            low, high = (high, math.inf) if mode > 0 else (-math.inf, low)
        return partial(function, low=low, high=high)

    def pressure(self, contact: int, mode: int) -> "Pressure":
        """Force of the exact law at the wall of a mode, as if the contact pulled."""
        law = self.laws[contact]
        stiffness, preload = law.stiffnesses[mode > 0], math.copysign(law.losses.preload, mode)
        chi = math.copysign(law.losses.chi, mode)
        rest = self.wall(contact, mode) - (preload / stiffness if stiffness else 0.0)
        return Pressure(stiffness, rest, law.losses.damping, chi)

    def damping(self, contact: int, modes: Modes) -> Force:
        """Return the derivative by the speed of the contact force that `force` returns [N s/m]."""
        law = self.laws[contact]
        if not law.losses:
            return lambda x, v: 0.0
        if modes is None or not law.has_modes:
            return lambda x, v: float(law.derivative_by_speed(x, v))
        if isinstance(law, UserLaw):
            return self._in_mode(law.continued.damping, contact, modes[contact])
        if abs(modes[contact]) != ON:
            return lambda x, v: 0.0
        pressure = self.pressure(contact, modes[contact])
        return lambda x, v: pressure.of_speed(x)

    def watched(self, contact: int, mode: int) -> "list[Watched]":
        """Return what may end a mode: the gap at a wall, or the force at zero."""
        losses = self.laws[contact].losses
        never_pulls, found = losses.never_pulls, []
        if not (never_pulls and MODES[abs(mode)].acts) or losses.preload:
            sides = (-1, 1) if not mode else (1 if mode > 0 else -1,)
            found = [Watched(contact, side, bool(mode), self.wall(contact, side)) for side in sides]
        if never_pulls and mode:
            side, force = (1 if mode > 0 else -1), self.pressure(contact, mode)
            found.append(Watched(contact, side, MODES[abs(mode)].acts, 0.0, force))
        return found

    def value(self, watched: "Watched", t: float, y: Sequence[float] | Array) -> float:
        """Value of a watched quantity in a state."""
        if watched.hold:
            return watched.hold(t, np.asarray(y))
        gap = self.gap(watched.contact, y)
        if watched.force is None:
            return gap
        return watched.force(gap, self.gap(watched.contact, y[self.n :]))

    def jumped(self, y: State, before: tuple[int, ...], modes: tuple[int, ...]) -> State:
        """Return the state after a change of modes at a wall: only the tangent jumps."""
        if not self.tangent or not any(law.losses for law in self.laws):
            return y
        n, found = self.n, np.array(y)
        images = found[self.n_states :].reshape(self.n_states, self.n_states)  # a view
        for k, b in enumerate(self.directions):
            if HOLD in (abs(modes[k]), abs(before[k])):
                continue
            gap, speed = self.gap(k, y), self.gap(k, y[n:])
            jump = self.force(k, modes)(gap, speed) - self.force(k, before)(gap, speed)
            if modes[k] != before[k] and speed:
                along = images[:, :n] @ b
                images[:, n : 2 * n] -= jump / speed * np.outer(along, self.pull[:, k])
        return tuple(found.tolist())

    @property
    def pull(self) -> Array:
        """Accelerations by unit forces of the contacts [1/kg], shape (n, n_contacts)."""
        return np.asarray(np.linalg.inv(np.atleast_2d(self.system.mass)) @ self.directions.T)

    @property
    def compliance(self) -> Array:
        """``b'M^-1 b`` of every contact [1/kg], shape (n_contacts,)."""
        return np.asarray(np.einsum("ki,ik->k", self.directions, self.pull))

    def slope(self, contact: int, modes: Modes) -> Force:
        """Return the slope of the contact force that `force` returns."""
        law = self.laws[contact]
        if modes is None or self.contact_force == "as_written" or not law.has_modes:
            return lambda x, v: float(law.derivative(x, v))
        mode = modes[contact]
        if isinstance(law, UserLaw):
            return self._in_mode(law.continued.slope, contact, mode)
        stiffness = law.stiffnesses[mode > 0]
        stiffness = stiffness if abs(mode) == ON else 0.0
        if not (chi := math.copysign(law.losses.chi, mode)):
            return lambda x, v: stiffness
        return lambda x, v: stiffness * (1.0 + chi * v)

    def modes_at(self, t: float, y: State) -> tuple[int, ...]:
        """Initial contact modes; on a wall the velocity decides, then the acceleration."""
        modes = tuple(self._beyond(k, y) for k in range(len(self.laws)))
        for contact in range(len(self.laws)):
            if self.laws[contact].losses.is_rigid:  # see `reference_impacts`
                modes = (*modes[:contact], 0, *modes[contact + 1 :])
            elif self.gap(contact, y) in (self.wall(contact, -1), self.wall(contact, 1)):
                here = Watched(contact, 1, False, self.gap(contact, y))
                modes = self.passed(t, y, modes, here)
        return modes

    def _beyond(self, contact: int, y: State) -> int:
        gap = self.gap(contact, y)
        mode = int(gap > self.wall(contact, 1)) - int(gap < self.wall(contact, -1))
        if mode and self.laws[contact].losses.never_pulls:
            speed = self.gap(contact, y[self.n :])
            return mode if mode * self.pressure(contact, mode)(gap, speed) >= 0.0 else SLACK * mode
        return mode

    def passed(self, t: float, y: State, modes: tuple[int, ...], hit: "Watched") -> tuple[int, ...]:
        """Return the modes after a contact reached a wall, or its force zero.

        At a wall the velocity decides, then the acceleration.
        """
        contact, wall = hit.contact, hit.at

        def changed(mode: int) -> tuple[int, ...]:
            return (*modes[:contact], mode, *modes[contact + 1 :])

        if hit.force is not None:
            return changed(MODES[abs(modes[contact])].after_zero * hit.side)
        if hit.hold:
            return changed((-hit.side if hit.falls else hit.side) if hit.at else 0)
        free = changed(0)
        rates = np.asarray(self.rhs(free)(t, np.array(y)))
        v, a = (self.gap(contact, rates[i * self.n :]) for i in (0, 1))
        # A contact shorter than a picosecond cannot be distinguished from a touch.
        heading = v if abs(v) > _TOUCH * abs(a) else a
        for mode in (1, -1):
            if wall == self.wall(contact, mode) and mode * heading > 0.0:
                return changed(mode)
        return free


@dataclass(frozen=True, slots=True)
class Pressure:
    """Force of a contact at one wall, while it acts, as a function of displacement and speed."""

    stiffness: float
    rest: float  # place of the gap without force; without a preload that of the wall
    damping: float
    chi: float  # for speeds upwards

    def __call__(self, x: float, v: float) -> float:
        spring = self.stiffness * (x - self.rest)
        spring = spring * (1.0 + self.chi * v) if self.chi else spring
        return spring + self.damping * v if self.damping else spring

    def of_speed(self, x: float) -> float:
        """Derivative of the force by the speed [N s/m]."""
        return self.damping + self.stiffness * self.chi * (x - self.rest)


@dataclass(frozen=True, slots=True)
class Watched:
    """A quantity of a contact whose passing of a value ends the contact's mode.

    Attributes
    ----------
    contact : int
    side : int
        -1 for the lower wall, +1 for the upper one.
    falls : bool
        Whether `side` times the quantity falls through the value, in contact, or rises.
    at : float
        That value: of the wall [m], or of a force [N]: zero, or the preload.
    force : Pressure, optional
        The force [N] that is watched; None: the gap.
    hold : callable, optional
        The force [N] that holds the contact on a wall, of time and state; it is watched.
    """

    contact: int
    side: int
    falls: bool
    at: float
    force: Pressure | None = None
    hold: Callable[[float, Array], float] | None = field(default=None, compare=False)


def scene_of(system: Any) -> type[ReferenceScene]:
    """Return the class of right-hand side for a model."""
    return OscillatorScene if isinstance(system, Oscillator) else SystemScene


class OscillatorScene(ReferenceScene):
    """Right-hand side of an oscillator in plain floats, ten times as fast as with arrays."""

    __slots__ = ()

    def gap(self, contact: int, q: Sequence[float] | Array) -> float:
        return float(q[0])

    def rhs(self, modes: Modes) -> Callable[[float, Array], State]:
        o = self.system
        damping, stiffness = 2.0 * o.decay_rate, o.omega_n_rad**2
        cubic, forcing, mass = o.alpha / o.mass, o.at(self.omega).forcing / o.mass, o.mass
        omega_rad, theta_0 = 2.0 * math.pi * self.omega, self.theta_0
        contact = self.force(0, modes)

        def f(t: float, y: Array) -> State:
            x, v = y[:2].tolist()
            drive = forcing * math.cos(omega_rad * t + theta_0)
            force = contact(x, v)
            return v, drive - damping * v - (stiffness + cubic * x * x) * x - force / mass

        if not self.tangent:
            return f
        contact_slope = self.slope(0, modes)
        damper = self.damping(0, modes)

        def with_tangent(t: float, y: Array) -> State:
            x, v, *tangent = y.tolist()
            slope = stiffness + 3.0 * cubic * x * x + contact_slope(x, v) / mass
            damped = damping + damper(x, v) / mass
            (a, a_dot), (b, b_dot) = tangent[:2], tangent[2:]
            images = a_dot, -damped * a_dot - slope * a, b_dot, -damped * b_dot - slope * b
            return (*f(t, y[:2]), *images)

        return with_tangent


class SystemScene(ReferenceScene):
    """Right-hand side of a system, with arrays."""

    __slots__ = ()

    def knots(self, t_end: float) -> list[float]:
        found = {t_end}
        for load in self.system.waves:
            ends = np.array(load.wave.ends)
            if load.k:
                turns = np.arange(-1, math.ceil(t_end * self.omega) + 2)
                times = (np.add.outer(turns, ends).ravel() - self.turn) / self.omega
            else:
                times = ends - self.t_0
            found.update(times[(times > 0.0) & (times < t_end)].tolist())
        return sorted(found)

    def _value(self, wave: Wave) -> Callable[[float], float]:
        """Return the present polynomial of a wave as a function of time."""
        rate, start = (1.0, self.t_0) if wave.in_seconds else (self.omega, self.turn)
        now = start + self.piece * rate
        whole = 0.0 if wave.in_seconds else math.floor(now)
        ends, coefficients = wave.table
        piece = min(int(np.searchsorted(ends, now - whole, side="right")), len(ends) - 1)
        knot = ends[piece] + whole - start if math.isfinite(ends[piece]) else 0.0
        terms = coefficients[piece, ::-1].tolist()

        def value(t: float) -> float:
            return reduce(lambda total, term: total * (rate * t - knot) + term, terms, 0.0)

        return value

    @property
    def turn(self) -> float:
        """Phase at time zero, in periods."""
        return self.theta_0 / (2.0 * math.pi)

    def rhs(self, modes: Modes) -> Callable[[float, Array], State]:
        system, n, n_states = self.system, self.system.n, self.n_states
        linear, directions = first_order(system), self.directions
        inverse = np.linalg.inv(system.mass)
        cubics = [(c.along, inverse @ c.along * c.alpha) for c in system.cubic]
        pull = self.pull
        contacts = range(len(self.laws))
        lossy = [bool(law.losses) for law in self.laws]
        dampers = [self.damping(k, modes) for k in contacts]
        forces = [self.force(k, modes) for k in contacts]
        slopes = [self.slope(k, modes) for k in contacts]
        terms = [system.modulation.get(name, ()) for name in system.contacts]
        omega_rad = 2.0 * math.pi * self.omega
        loads = [
            (h.growth(omega_rad) * (inverse @ h.amplitude), h.k, h.phase) for h in system.harmonics
        ]
        waves = [(inverse @ w.amplitude, self._value(w.wave)) for w in system.waves]

        def rates(theta: float) -> list[float]:
            return [
                1.0 + sum(m.depth * math.cos(m.k * theta + m.phase) for m in ms) for ms in terms
            ]

        def f(t: float, y: Array) -> Any:
            state, theta = y[:n_states], omega_rad * t + self.theta_0
            found = linear @ state
            push = sum((p * math.cos(k * theta + phase) for p, k, phase in loads), np.zeros(n))
            for along, value in waves:
                push += along * value(t)
            for along, cubic in cubics:
                push -= cubic * (along @ state[:n]) ** 3
            for k, rate in zip(contacts, rates(theta), strict=True):
                gap = float(directions[k] @ state[:n])
                push -= pull[:, k] * (rate * forces[k](gap, 0.0))
                if lossy[k]:
                    speed = float(directions[k] @ state[n : 2 * n])
                    push -= pull[:, k] * (forces[k](gap, speed) - forces[k](gap, 0.0))
            found[n : 2 * n] += push
            if not self.tangent:
                return found
            jacobian = linear.copy()
            for along, cubic in cubics:
                jacobian[n : 2 * n, :n] -= 3.0 * (along @ state[:n]) ** 2 * np.outer(cubic, along)
            for k, rate in zip(contacts, rates(theta), strict=True):
                gap, speed = (float(directions[k] @ state[i : i + n]) for i in (0, n))
                along = np.outer(pull[:, k], directions[k])
                jacobian[n : 2 * n, :n] -= rate * slopes[k](gap, speed) * along
                if lossy[k]:
                    jacobian[n : 2 * n, n : 2 * n] -= dampers[k](gap, speed) * along
            images = y[n_states:].reshape(n_states, n_states)
            return np.concatenate([found, (images @ jacobian.T).ravel()])

        return f
