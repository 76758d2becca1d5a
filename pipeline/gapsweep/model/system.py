"""Systems of several coordinates with contacts, as data: frozen, checked arrays.

The equation of motion, with `F_j` the contact law of contact j::

    M q'' + C q' + K q + sum_i alpha_i (a_i.q)^3 a_i + sum_j s_j(t) b_j F_j(b_j.q) + D z
        = sum_k p_k cos(2 pi k omega t + phi_k) + sum_l p_l w_l(omega t)
    z' = E q' + G q + H z

with waves w_l by pieces (`gapsweep.model.waves`).

Only the arrays of a system enter the results computed for it.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.model.arrays import array, numbers
from gapsweep.model.oscillator import SMALLEST, called_as, checked, share, whole
from gapsweep.model.waves import ForceByPieces
from gapsweep.variables import CONTACT, COORDINATE, LAG, Units

Array = NDArray[np.float64]

_UNITS = ("m", "rad", "1")  # of coordinates and contacts
MAX_COORDINATES, MAX_LAGS, MAX_CONTACTS, MAX_HARMONIC = 16, 16, 8, 1000
_STILL = 1e-12  # of the fastest rate: slower rates count as zero
LATE = -0.5 * math.pi  # phase of a load a quarter period after another


def _all_of(name: str, value: Any, *kinds: type) -> tuple[Any, ...]:
    """Return `value` as a tuple; raise a `ModelError` if it is no sequence of these classes."""
    found = tuple(value) if isinstance(value, Sequence) else (None,)
    if not all(isinstance(each, kinds) for each in found):
        words = " or ".join(f"gapsweep.{kind.__name__}(...)" for kind in kinds)
        raise ModelError(f"{name} = {value!r}: must be a sequence of {words}")
    return found


def _named(name: str, value: Any) -> Mapping[str, Any]:
    """Return `value`; raise a `ModelError` if it is no mapping with strings as keys."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ModelError(f"{name} = {value!r}: must map names to values")
    return value


@called_as("gs.Harmonic(amplitude=[30.0, 0.0]), or with k=0 for a constant load")
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Harmonic:
    """A harmonic load, or a constant one (``k = 0``).

    Parameters
    ----------
    amplitude : array_like, shape (n,)
        Generalised forces [N], or with `power` [N s] or [kg m].
    k : int
        Multiple of the forcing frequency, 0 to 1000.
    phase : float
        Phase [rad] in ``amplitude * cos(2 pi k omega t + phase)``.
    power : int
        The amplitude is multiplied by ``(2 pi k omega)**power``: 0, or 1 for a damper at a moving
        base, or 2 for an unbalance and other loads of inertia.

    Examples
    --------
    >>> import gapsweep as gs
    >>> load = gs.Harmonic(amplitude=[0.0, 2.0], k=3)  # on the second coordinate, thrice as fast
    >>> preload = gs.Harmonic(amplitude=[1.0, 0.0], k=0)
    """

    amplitude: Any
    k: int = 1
    phase: float = 0.0
    power: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "k", whole("k", self.k, 0, MAX_HARMONIC))
        object.__setattr__(self, "phase", checked("phase", self.phase))
        object.__setattr__(self, "power", whole("power", self.power, 0, 2 if self.k else 0))

    def harmonics(self, mass: Array, damping: Array) -> tuple["Harmonic", ...]:
        """Return the load itself, as the other kinds of loads return their harmonics."""
        return (self,)

    @property
    def start(self) -> float:
        """Factor of the amplitude at phase zero of the forcing."""
        return math.cos(self.phase)

    def growth(self, omega_rad: Any) -> Any:
        """Return the factor of the amplitude at an angular frequency [rad/s], or several."""
        return (self.k * omega_rad) ** self.power + 0.0 * omega_rad


@called_as("gs.Unbalance(along=[1.0, 0.0], unbalance=1e-3)")
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Unbalance:
    """A rotating unbalance: a load ``unbalance (2 pi k omega)² cos(2 pi k omega t + phase) along``.

    Parameters
    ----------
    along : array_like, shape (n,)
        Direction of the force [-].
    unbalance : float
        Mass times eccentricity [kg m].
    k, phase
        As in `Harmonic`; a shaft that turns k times in a forcing period.

    Examples
    --------
    >>> import gapsweep as gs
    >>> rotor = gs.Unbalance(along=[1.0, 0.0], unbalance="20 g mm")
    """

    along: Any
    unbalance: float
    k: int = 1
    phase: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "unbalance", checked("unbalance", self.unbalance))

    def harmonics(self, mass: Array, damping: Array) -> tuple[Harmonic, ...]:
        """Return the load as harmonics, for matrices of a system."""
        amplitude = self.unbalance * array("unbalance: along", self.along, mass.shape[:1])
        return (Harmonic(amplitude=amplitude, k=self.k, phase=self.phase, power=2),)


@called_as("gs.BaseMotion(along=[1.0, 1.0], base_amplitude=1e-3)")
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BaseMotion:
    """A base that moves by ``base_amplitude cos(2 pi k omega t + phase)``, as loads.

    The coordinates of the system are relative to the base: coordinate i has the absolute
    displacement ``q_i + along_i y``, with the displacement y of the base. All springs and contacts
    to the surroundings are connected to the base.

    Parameters
    ----------
    along : array_like, shape (n,)
        Displacement of every coordinate in a rigid motion with the base, over that of the base [-]:
        1 for each displacement in its direction.
    base_amplitude : float
        Amplitude [m].
    base_damping : float
        Share of the damping that is connected to the base [-], 0 to 1; the rest is connected to the
        ground.
    k, phase
        As in `Harmonic`.

    Examples
    --------
    >>> import gapsweep as gs
    >>> base = gs.BaseMotion(along=[1.0, 1.0], base_amplitude="0.5 mm")
    >>> base.at(10.0, 0.1).tolist()  # on both coordinates, after a period
    [0.0005, 0.0005]
    """

    along: Any
    base_amplitude: float
    base_damping: float = 1.0
    k: int = 1
    phase: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "base_amplitude", checked("base_amplitude", self.base_amplitude))
        object.__setattr__(self, "base_damping", share("base_damping", self.base_damping))
        object.__setattr__(self, "along", numbers("base: along", self.along))
        object.__setattr__(self, "phase", checked("phase", self.phase))

    def harmonics(self, mass: Array, damping: Array) -> tuple[Harmonic, ...]:
        """Return the loads on relative coordinates as harmonics, for matrices of a system."""
        moved = self.base_amplitude * array("base: along", self.along, mass.shape[:1])
        inertia = Harmonic(amplitude=mass @ moved, k=self.k, phase=self.phase, power=2)
        late = (1.0 - self.base_damping) * (damping @ moved)
        if not late.any():
            return (inertia,)
        return inertia, Harmonic(amplitude=late, k=self.k, phase=self.phase + LATE, power=1)

    def at(self, omega: float, t: ArrayLike) -> Array:
        """Return absolute less relative displacements at a frequency [Hz], shape (..., n)."""
        turns = 2.0 * math.pi * self.k * checked("omega", omega) * numbers("t", t)
        moved: Array = np.multiply.outer(np.cos(turns + self.phase), self.along)
        return self.base_amplitude * moved


@called_as("gs.Cubic(along=[1.0, -1.0], alpha=7e8)")
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Cubic:
    """A cubic spring along a direction, with the force ``alpha (a.q)^3 a``.

    Parameters
    ----------
    along : array_like, shape (n,)
        Direction a [-].
    alpha : float
        Cubic stiffness [N/m³]; negative values soften.

    Examples
    --------
    >>> import gapsweep as gs
    >>> spring = gs.Cubic(along=[1.0, -1.0], alpha=7e8)  # between two coordinates
    """

    along: Any
    alpha: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "alpha", checked("alpha", self.alpha))


@called_as("gs.Modulation(depth=0.2)")
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Modulation:
    """Periodic stiffness: a contact's force times ``1 + sum depth cos(2 pi k omega t + phase)``.

    The force of a contact's damping does not vary with it.

    Parameters
    ----------
    depth : float
        Amplitude of the stiffness variation relative to the mean stiffness [-].
    k : int
        Multiple of the forcing frequency, 1 to 1000.
    phase : float
        Phase [rad].

    Examples
    --------
    >>> import gapsweep as gs
    >>> mesh = gs.Modulation(depth=0.2)  # the contact's force times 1 + 0.2 cos(2 pi omega t)
    """

    depth: float
    k: int = 1
    phase: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "depth", checked("depth", self.depth))
        object.__setattr__(self, "k", whole("k", self.k, 1, MAX_HARMONIC))
        object.__setattr__(self, "phase", checked("phase", self.phase))


@dataclass(frozen=True, slots=True, eq=False)
class Lags:
    """First-order states, such as aerodynamic lags or filters: ``z' = E q' + G q + H z``.

    Parameters
    ----------
    force : array_like, shape (n, m)
        D: the term ``D z`` on the left side of the equation of motion.
    of_speed, of_place : array_like, shape (m, n)
        E and G: influence of the velocities and the coordinates.
    of_lags : array_like, shape (m, m)
        H: influence of the states themselves.

    Examples
    --------
    >>> import gapsweep as gs
    >>> lags = gs.Lags(
    ...     force=[[1.0], [0.0]], of_speed=[[0.0, 1.0]], of_place=[[0.0, 0.0]], of_lags=[[-5.0]]
    ... )
    """

    force: Any
    of_speed: Any
    of_place: Any
    of_lags: Any


_LOADS = Harmonic, Unbalance, BaseMotion, ForceByPieces


@called_as("gs.System(mass=M, stiffness=K, contacts={'stop': [1.0, 0.0]})")
@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class System:
    """A system with n coordinates: matrices, contacts, cubic springs and harmonic loads.

    Parameters
    ----------
    mass, stiffness : array_like, shape (n, n)
        M, symmetric and positive definite [kg], and K [N/m].
    damping : array_like, shape (n, n), optional
        C [N s/m]; zero by default.
    contacts : mapping of str to array_like, shape (n,)
        Direction b of every contact, by name: the contact has the displacement ``b·q``.
    cubic : sequence of Cubic
    forcing : sequence of Harmonic, Unbalance, BaseMotion, PeriodicForce, Switched or Record
        Loads, kept as harmonics and waves. A system is unforced if it has no periodic load, only
        constant ones and records, and no `modulation`.
    modulation : mapping of str to sequence of Modulation
        Periodic stiffness of contacts, by name.
    lags : Lags, optional
    coordinates : sequence of str, optional
        Names; ``q_1``, ``q_2``, ... by default.
    units : mapping of str to str
        Units of coordinates and of contacts, by name: ``"m"``, the default, ``"rad"``, or ``"1"``
        of a nondimensional model. A contact has the unit of the coordinates in its direction, or
        metres if these differ. They name axes and columns and change no number.

    Raises
    ------
    ModelError
        If an array has the wrong shape or is not of numbers, or M is not positive definite.

    Examples
    --------
    >>> import gapsweep as gs
    >>> system = gs.System(
    ...     mass=[[1.0, 0.0], [0.0, 2.0]],
    ...     stiffness=[[30.0, -10.0], [-10.0, 20.0]],
    ...     damping=[[0.3, -0.1], [-0.1, 0.2]],
    ...     contacts={"stop": [1.0, 0.0]},
    ...     forcing=[gs.Harmonic(amplitude=[1.0, 0.0])],
    ... )
    >>> gs.respond(system, gs.Piecewise(100.0, gs.Gap(0.02, 0.02)), omega=0.8).status.label
    'ok'
    """

    mass: Any
    stiffness: Any
    damping: Any = None
    contacts: Mapping[str, Any] = field(default_factory=dict)
    cubic: Sequence[Cubic] = ()
    forcing: Sequence[Any] = ()
    modulation: Mapping[str, Sequence[Modulation]] = field(default_factory=dict)
    lags: Lags | None = None
    coordinates: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        mass = numbers("mass", self.mass)
        if mass.ndim != 2:
            raise ModelError(f"mass: has the shape {mass.shape}, must be n rows of n columns")
        n = len(mass)
        whole("number of coordinates (rows of mass)", n, 1, MAX_COORDINATES)
        square = {"mass": self.mass, "stiffness": self.stiffness}
        square["damping"] = np.zeros((n, n)) if self.damping is None else self.damping
        for name, value in square.items():
            self._set(name, array(name, value, (n, n)))
        _check_mass(self.mass)
        contacts = _named("contacts", self.contacts)
        directions = {k: array(f"contact {k!r}", b, (n,)) for k, b in contacts.items()}
        whole("number of contacts", len(directions), 0, MAX_CONTACTS)
        for name, direction in directions.items():
            if not direction.any():
                raise ModelError(f"contact {name!r}: its direction must not be zero")
        self._set("contacts", directions)
        self._set("cubic", tuple(_along(each, n) for each in _all_of("cubic", self.cubic, Cubic)))
        self._set("forcing", self._loads(_all_of("forcing", self.forcing, *_LOADS)))
        terms = {
            k: _all_of(f"modulation of {k!r}", each, Modulation)
            for k, each in _named("modulation", self.modulation).items()
        }
        for name in terms:
            if name not in directions:
                raise ModelError(f"modulation of {name!r}: must be one of {list(directions)}")
        self._set("modulation", terms)
        if self.lags is not None:
            self._set("lags", _lags(self.lags, n))
        self._set("coordinates", _names(self.coordinates, n))
        units = _named("units", self.units)
        for name, unit in units.items():
            if name not in (*self.coordinates, *directions):
                known = ", ".join((*self.coordinates, *directions))
                raise ModelError(f"units of {name!r}: must be one of {known}")
            if unit not in _UNITS:
                raise ModelError(
                    f"units of {name!r}: {unit!r} must be one of {', '.join(map(repr, _UNITS))}; "
                    "all numbers are in SI units"
                )
        self._set("units", units)

    def _loads(self, given: Sequence[Any]) -> tuple[Any, ...]:
        several = (load.harmonics(self.mass, self.damping) for load in given)
        loads = tuple(_loaded(load, self.n) for some in several for load in some)
        if len({load.wave.in_seconds for load in loads if isinstance(load, ForceByPieces)}) > 1:
            raise ModelError("forcing: has a gapsweep.Record and a periodic wave: give one of them")
        return loads

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        contacts = f", contacts {', '.join(self.contacts)}" if self.contacts else ""
        lags = f", {self.n_lags} lags" if self.n_lags else ""
        return f"<gapsweep.System: coordinates {', '.join(self.coordinates)}{contacts}{lags}>"

    @property
    def parts(self) -> dict[str, tuple[str, ...]]:
        """Dimensions of a response (coordinate, contact, lag) with several entries, and labels."""
        lags = tuple(f"z_{i + 1}" for i in range(self.n_lags))
        found = {COORDINATE: tuple(self.coordinates), CONTACT: tuple(self.contacts), LAG: lags}
        return {name: labels for name, labels in found.items() if len(labels) > 1}

    @property
    def part_units(self) -> Units:
        """Units of all coordinates, and of the displacements of all contacts."""
        of_coordinates = [self.units.get(name, "m") for name in self.coordinates]
        of_contacts = []
        for name, direction in self.contacts.items():
            own = {unit for unit, b in zip(of_coordinates, direction, strict=True) if b}
            of_contacts.append(self.units.get(name, own.pop() if len(own) == 1 else "m"))
        return {COORDINATE: of_coordinates, CONTACT: of_contacts}

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.mass)

    @property
    def n_lags(self) -> int:
        """Number of first-order states."""
        return 0 if self.lags is None else len(self.lags.of_lags)

    @property
    def is_forced(self) -> bool:
        """Whether loads or stiffnesses depend on time."""
        return any(self.modulation.values()) or any(load.k > 0 for load in self.forcing)

    @property
    def n_states(self) -> int:
        """Length of a state (q, v, z)."""
        return 2 * self.n + self.n_lags

    @property
    def sizes(self) -> Hashable:
        """Sizes and load harmonics of the system; systems integrated together share them."""
        harmonics = tuple((load.k, load.phase, hasattr(load, "wave")) for load in self.forcing)
        terms = tuple(map(len, self.modulation.values()))
        return self.n, self.n_lags, len(self.contacts), len(self.cubic), harmonics, terms

    @property
    def harmonics(self) -> list[Harmonic]:
        """Harmonic and constant loads, in the order of `forcing`."""
        return [load for load in self.forcing if isinstance(load, Harmonic)]

    @property
    def waves(self) -> list[ForceByPieces]:
        """Loads by pieces, in the order of `forcing`."""
        return [load for load in self.forcing if isinstance(load, ForceByPieces)]

    @property
    def directions(self) -> Array:
        """Directions of the contacts, shape (n_contacts, n)."""
        return np.array([*self.contacts.values()]).reshape(-1, self.n)

    @property
    def is_modulated(self) -> NDArray[np.bool_]:
        """Whether the stiffness of a contact changes with time, shape (n_contacts,)."""
        return np.array([bool(self.modulation.get(name)) for name in self.contacts], bool)

    @property
    def is_held(self) -> bool:
        """Whether the stiffness matrix is regular: no rigid-body mode without contact."""
        return int(np.linalg.matrix_rank(self.stiffness)) == self.n

    @property
    def decay_rate(self) -> float:
        """Rate [1/s] at which volumes in state space contract, divided by the number of states."""
        return -float(np.trace(first_order(self))) / self.n_states

    @property
    def settling_rate(self) -> float:
        """Smallest decay rate of a free motion without contact, at most `decay_rate` [1/s].

        Rigid-body modes, which only contacts restrain, do not count.
        """
        rates = -np.linalg.eigvals(first_order(self)).real
        decaying: list[float] = rates[rates > _STILL * np.abs(rates).max()].tolist()
        return max(0.0, min([self.decay_rate, *decaying]))

    @property
    def slowest(self) -> float:
        """Smallest nonzero natural frequency without contact [Hz], 0 if there is none."""
        moduli = np.abs(np.linalg.eigvals(first_order(self)))
        held = moduli[moduli > _STILL * moduli.max(initial=0.0)]
        return float(held.min(initial=math.inf)) / (2.0 * math.pi) if held.size else 0.0

    @property
    def fastest(self) -> float:
        """Largest modulus of the eigenvalues of the linear system without contact [Hz]."""
        return float(np.abs(np.linalg.eigvals(first_order(self))).max()) / (2.0 * math.pi)

    @property
    def deflection(self) -> float:
        """Estimate of the largest static displacement without contact, as `held` returns it [m]."""
        return self.held(np.zeros_like(self.stiffness))

    def held(self, walls: Array) -> float:
        """Estimate the largest static displacement under all loads [m], scaled as by `unit`.

        `walls` is a stiffness matrix [N/m] that is added. Cubic springs are left out if there are
        several coordinates; a load that grows with the frequency moves a free mass.
        """
        matrices = self.stiffness + walls, self.damping, self.mass
        places = [np.linalg.lstsq(matrices[load.power], load.amplitude)[0] for load in self.forcing]
        scale = np.sqrt(np.diag(self.mass).min() / np.diag(self.mass))
        length = sum(float((np.abs(place) / scale).max()) for place in places)
        if self.n == 1 and self.cubic:
            spring = abs(float(self.stiffness[0, 0]))
            cubic = sum(abs(each.alpha) * float(each.along[0]) ** 4 for each in self.cubic)
            whole = spring + math.cbrt(cubic * (spring * length) ** 2)
            length *= spring / whole if whole else 1.0
        return length

    def unit(self, omega_rad: ArrayLike) -> Array:
        """Return the scale of every state for a motion of one metre, shape (n_states, ...).

        Scales of coordinates and velocities have the kinetic energy of the lightest coordinate;
        first-order states follow from these motions.

        Parameters
        ----------
        omega_rad : float or array_like
            Angular frequency of the motion [rad/s].
        """
        rate, masses = np.asarray(omega_rad, float), np.diag(self.mass)
        place = np.sqrt(masses.min() / masses)
        along = np.multiply.outer(place, np.ones_like(rate)), np.multiply.outer(place, rate)
        if self.lags is None:
            return np.concatenate(along)
        of_place, of_speed = np.abs(self.lags.of_place), np.abs(self.lags.of_speed)
        fastest = np.abs(np.linalg.eigvals(self.lags.of_lags)).max()
        driven = np.moveaxis(of_place + np.multiply.outer(rate, of_speed), (-2, -1), (0, 1))
        lags = (np.moveaxis(driven, 1, -1) * place).max(axis=-1) / np.maximum(rate, fastest)
        return np.concatenate([*along, np.where(lags > 0.0, lags, 1.0)])


def _check_mass(mass: Array) -> None:
    if not np.array_equal(mass, mass.T):
        i, j = np.unravel_index(np.argmax(np.abs(mass - mass.T)), mass.shape)
        raise ModelError(
            f"mass: [{i}][{j}] = {mass[i, j]:g}, [{j}][{i}] = {mass[j, i]:g}: must be symmetric"
        )
    smallest = float(np.linalg.eigvalsh(mass)[0])
    try:
        np.linalg.cholesky(mass)
        is_definite = smallest > 0.0
    except np.linalg.LinAlgError:
        is_definite = False
    if not is_definite:
        raise ModelError(
            f"mass: its smallest eigenvalue is {smallest:g}: must be positive definite"
        )
    if smallest < SMALLEST:
        raise ModelError(f"mass: its smallest eigenvalue is {smallest:g}: must be >= {SMALLEST:g}")


def _names(given: Any, n: int) -> tuple[str, ...]:
    names = tuple(given) if isinstance(given, Sequence) else (given,)
    names = names or tuple(f"q_{i + 1}" for i in range(n))
    are_names = all(isinstance(name, str) for name in names)
    if not are_names or len(names) != n or len(set(names)) != n:
        raise ModelError(f"coordinates = {given!r}: must be {n} different names")
    return names


def _along(cubic: Cubic, n: int) -> Cubic:
    along = array("cubic: along", cubic.along, (n,))
    if not along.any():
        raise ModelError("cubic: its direction must not be zero")
    return Cubic(along=along, alpha=cubic.alpha)


def _loaded(load: Harmonic | ForceByPieces, n: int) -> Harmonic | ForceByPieces:
    if isinstance(load, ForceByPieces):
        return load
    name = f"forcing: amplitude at power {load.power}" if load.power else "forcing: amplitude"
    amplitude = array(name, load.amplitude, (n,))
    return replace(load, amplitude=amplitude)


def _lags(lags: Any, n: int) -> Lags:
    if not isinstance(lags, Lags):
        raise ModelError(f"lags = {lags!r}: must be a gapsweep.Lags(...)")
    of_lags = numbers("lags: of_lags", lags.of_lags)
    m = whole(
        "number of lags (rows of of_lags)", of_lags.shape[0] if of_lags.ndim else 0, 1, MAX_LAGS
    )
    return Lags(
        array("lags: force", lags.force, (n, m)),
        array("lags: of_speed", lags.of_speed, (m, n)),
        array("lags: of_place", lags.of_place, (m, n)),
        array("lags: of_lags", lags.of_lags, (m, m)),
    )


def fraction(phase: float) -> float:
    """Return a phase [rad] as a fraction of the period, in [0, 1)."""
    turns = phase / (2.0 * math.pi)
    return turns - math.floor(turns)


def first_order(system: System) -> Array:
    """Matrix of the linear part out of contact, for states (q, v, z); shape (2 n + m, 2 n + m)."""
    n, m = system.n, system.n_lags
    matrix = np.zeros((2 * n + m, 2 * n + m))
    matrix[:n, n : 2 * n] = np.eye(n)
    matrix[n : 2 * n, :n] = -np.linalg.solve(system.mass, system.stiffness)
    matrix[n : 2 * n, n : 2 * n] = -np.linalg.solve(system.mass, system.damping)
    if (lags := system.lags) is not None:
        matrix[n : 2 * n, 2 * n :] = -np.linalg.solve(system.mass, lags.force)
        matrix[2 * n :] = np.hstack([lags.of_place, lags.of_speed, lags.of_lags])
    return matrix
