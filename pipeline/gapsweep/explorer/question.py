"""A setting of the page's sliders, and the ranges of the sliders."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Laws, Model
from gapsweep.model.contact import FIT_RANGE, OF_LABELS, OF_WALLS, ContactLaw, Piecewise, Rigid
from gapsweep.model.labels import EXACT, Representation, canonical_label, contact_law
from gapsweep.model.oscillator import Gap, Oscillator, checked
from gapsweep.variables import CONTACT, COORDINATE

Array = NDArray[np.float64]

MAX_APPROXIMATIONS = 3


@dataclass(frozen=True, slots=True)
class Scale:
    """A quantity of a slider or an axis: its title, its unit, and SI units in one of the shown."""

    title: str
    unit: str = ""
    factor: float = 1.0

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


@dataclass(frozen=True, eq=False)
class SliderModel:
    """A model and the walls of its contacts as functions of the sliders."""

    # From the values of `parameters`, by name, to the model.
    make: Callable[[Mapping[str, float]], Model]
    parameters: Mapping[str, float]  # initial values of the model's parameters
    # For every contact its `WALLS`: each the name of a slider, or a number.
    walls: Mapping[str, Mapping[str, str | float]]
    # Labels of the laws of contacts that do not follow the page's.
    laws: Mapping[str, str] = field(default_factory=dict)
    # Exact laws of contacts, of which the numbers of `walls` are replaced.
    exact: Mapping[str, Piecewise] = field(default_factory=dict)
    factor: float = 1.0  # displacement that is shown as 1, of those that are no lengths

    @cached_property
    def example(self) -> Model:
        """The model at the initial values of its parameters."""
        return self.make(self.parameters)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the sliders: walls, frequency, parameters."""
        several = [walls.get(name) for name in WALLS for walls in self.walls.values()]
        of_walls = dict.fromkeys(one for one in several if isinstance(one, str))
        return (*of_walls, "omega", *self.parameters)

    @property
    def is_oscillator(self) -> bool:
        """Whether the model is an oscillator."""
        return isinstance(self.example, Oscillator)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        q = self.example.coordinates
        lags = (f"z_{i + 1}" for i in range(self.example.n_lags))
        return (*q, *("v" if self.is_oscillator else f"v_{name}" for name in q), *lags)

    @cached_property
    def displacements(self) -> dict[str, Array]:
        """Direction of every displacement that can be shown, by name.

        They are the coordinates, and the contacts between several of them.
        """
        model = self.example
        found = dict(zip(model.coordinates, np.eye(model.n), strict=True))
        along = zip(model.contacts, np.reshape(model.directions, (-1, model.n)), strict=True)
        return found | {name: b for name, b in along if np.count_nonzero(b) > 1}

    def length(self, name: str) -> Scale:
        """Scale of a displacement: millimetres, or a power of ten of another unit."""
        unit, factor = self._shown(name)
        return Scale(f"displacement {name}" if self.is_oscillator else name, unit, factor)

    def speed(self, name: str) -> Scale:
        """Scale of the rate of a displacement."""
        unit, factor = self._shown(name, "/s")
        return Scale("velocity v" if self.is_oscillator else f"v_{name}", unit, factor)

    def _shown(self, name: str, rate: str = "") -> tuple[str, float]:
        """Unit in which a displacement or its rate is shown, and its value in SI units."""
        model, units = self.example, self.example.part_units
        known = dict(zip(model.contacts, units[CONTACT], strict=True))
        unit = (known | dict(zip(model.coordinates, units[COORDINATE], strict=True)))[name]
        if unit == "m":
            return f"mm{rate}", 1e-3
        own = "" if unit == "1" else f"{unit}{rate}"
        return f"{_power(self.factor)} {own}".strip(), self.factor

    def state(self, name: str) -> Scale:
        """Scale of a state."""
        number, q = self.states.index(name), self.example.coordinates
        if number < 2 * len(q):
            return (self.length, self.speed)[number // len(q)](q[number % len(q)])
        return Scale(name)


def _power(factor: float) -> str:
    """A power of ten as text, as 10⁻³; empty for 1."""
    exponent = str(round(math.log10(factor))).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return "" if factor == 1.0 else f"10{exponent}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """A setting of the page: all values that its figures depend on."""

    machine: SliderModel
    # Values of the sliders in SI units, in the order of `SliderModel.names`.
    values: tuple[float, ...]
    band: tuple[float, float]  # first and last frequency [Hz] of the response
    approximations: tuple[str, ...] = ()  # labels of the other laws
    start: tuple[float, ...] = ()  # initial state of the motion that is shown; empty: rest
    shown: str = ""  # name of the displacement that is shown; empty: the first coordinate
    # Names of the two states that differ in the basins; empty: the first coordinate and its
    # velocity.
    plane: tuple[str, ...] = ()
    fit_range: float = FIT_RANGE  # half-width [m] of the range on which polynomials are fitted
    over: str = ""  # name of the parameter on the second axis of the map
    # Its values there, in SI units; without values there is no map.
    over_values: tuple[float, ...] = ()
    model: Model = field(init=False, compare=False, repr=False)  # the model at these values

    def __post_init__(self) -> None:
        machine, given = self.machine, numbers(self)
        model = machine.make({name: given[name] for name in machine.parameters})
        default: dict[str, Any] = {
            "model": model,
            "start": self.start or (0.0,) * model.n_states,
            "shown": self.shown or model.coordinates[0],
            "plane": self.plane or (machine.states[0], machine.states[model.n]),
            "over": self.over or machine.names[0],
        }
        for name, value in default.items():
            object.__setattr__(self, name, value)
        if not model.slowest:
            raise ModelError(
                "natural frequency = 0 Hz: must be > 0 here; for a free mass use gapsweep.respond"
            )
        checked("omega", self.omega, low=0.0, strict=True)
        for state, number in zip(machine.states, self.start, strict=True):
            checked(state, number)
        low, high = self.band
        if not 0.0 < low < high:
            raise ModelError(f"frequencies {low:g} to {high:g} Hz: must be > 0 Hz and ascend")

    @property
    def omega(self) -> float:
        """Frequency [Hz] of the motion that is shown."""
        return numbers(self)["omega"]

    def gap(self, contact: str) -> Gap:
        """Gap of a contact."""
        return Gap(*(self._walls(contact)[name] for name in ("j_1", "j_2")))

    def _walls(self, contact: str) -> dict[str, float]:
        given = numbers(self)
        of = self.machine.walls[contact].items()
        return {name: given[one] if isinstance(one, str) else one for name, one in of}

    def laws(self, label: str) -> Laws:
        """The laws of all contacts, of a label unless the machine has another for a contact."""
        found: list[ContactLaw] = []
        for contact in self.machine.walls:
            law, exact = self.machine.laws.get(contact, label), self.machine.exact.get(contact)
            of_walls: dict[str, Any] = self._walls(contact) | {"gap": self.gap(contact)}
            of_walls = {name: of_walls[name] for name in of_walls.keys() - {"j_1", "j_2"}}
            if law == EXACT and exact is not None:
                found.append(replace(exact, **of_walls))
                continue
            one = Representation(law)
            if "K_c" not in of_walls and one.family != Rigid.family:
                raise ModelError("rigid walls have no stiffness for it; remove it")
            of_walls = {"K_c": 0.0} | of_walls
            others = {name for name in OF_LABELS if not one.takes(name)}
            # Other laws with losses have no damper in addition.
            others |= {"damping", "preload"} if law != EXACT and one.is_located else set()
            of_walls = {name: of_walls[name] for name in of_walls.keys() - others}
            found.append(contact_law(law, fit_range=self.fit_range, **of_walls))
        return tuple(found)

    @property
    def direction(self) -> Array:
        """Direction of the displacement that is shown."""
        return self.machine.displacements[self.shown]

    @property
    def clearance(self) -> tuple[float, float]:
        """Range of the displacement that is shown without contact; infinite without walls."""
        low, high = -math.inf, math.inf
        directions = np.reshape(self.model.directions, (-1, self.model.n))
        for contact, along in zip(self.machine.walls, directions, strict=True):
            ratio = float(along @ self.direction) / float(self.direction @ self.direction)
            if np.array_equal(ratio * self.direction, along):
                gap = self.gap(contact)
                ends = sorted((-gap.j_1 / ratio, gap.j_2 / ratio))
                low, high = max(low, ends[0]), min(high, ends[1])
        return low, high

    @property
    def of_basins(self) -> "Question":
        """The question without the values that its basins do not depend on, as a key for them."""
        return replace(self, band=(1.0, 2.0), over="", over_values=(), **_OF_NO_PLANE)

    @property
    def of_map(self) -> "Question":
        """The question without the values that its map does not depend on, as a key for it."""
        here = self.at(self.over, self.over_values[0]) if self.over_values else self
        return replace(here.at("omega", 1.0), plane=(), **_OF_NO_PLANE)

    def at(self, name: str, value: float) -> "Question":
        """The question with another value of a parameter that has a slider."""
        return asked(self, numbers(self) | {name: value})


_OF_NO_PLANE: dict[str, Any] = {"approximations": (), "start": ()}


def labels(text: str) -> tuple[Representation, ...]:
    """Approximations from a text that the user typed, as ``"tanh-1e4, poly-13"``.

    Raises `ModelError` if a label is unknown or is of a user law, or there are too many.
    """
    typed = map(canonical_label, text.replace(",", " ").split())
    found = tuple(dict.fromkeys(map(Representation, typed)))
    for law in found:
        # Otherwise any visitor of the page could choose code for this process to run.
        if law.is_own or law.is_auto:
            raise ModelError(f"{law}: cannot be typed here; use a law that is a formula")
    found = tuple(law for law in found if law != EXACT)
    if len(found) > MAX_APPROXIMATIONS:
        raise ModelError(
            f"{len(found)} approximations: must be <= {MAX_APPROXIMATIONS}; remove some"
        )
    return found


# --- sliders --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Dial:
    """A slider: name, scale, range and initial value, in the unit that it shows."""

    name: str  # name of the parameter
    scale: Scale
    low: float
    high: float
    value: float
    decades: bool = False

    @property
    def is_log(self) -> bool:
        """Whether the slider is logarithmic."""
        return self.decades and self.low > 0.0

    @property
    def tick(self) -> str:
        """JavaScript for the value at a place of the slider, `tick`."""
        return f"return String(Number(({'10 ** tick' if self.is_log else 'tick'}).toPrecision(4)))"

    def place(self, value: float) -> float:
        """The place of a value in SI units on the slider."""
        return self.scaled(value / self.scale.factor)

    def scaled(self, shown: float) -> float:
        """The place of a value in the displayed unit on the slider."""
        return math.log10(shown) if self.is_log else shown

    def at(self, place: float) -> float:
        """The value at a place of the slider, in SI units."""
        return float(self.scale.factor * (10.0**place if self.is_log else place))

    def along(self, n: int) -> tuple[float, ...]:
        """`n` values in SI units, evenly spaced on the slider."""
        places = np.linspace(self.scaled(self.low), self.scaled(self.high), n)
        return tuple(map(self.at, places.tolist()))


WALLS = ("K_c", "j_1", "j_2", *OF_WALLS)
_OVER_DECADES = ("K_c", "zeta", "mass")
# Scale and range: lower and upper end as multiples of the initial value, and the smallest upper end
# in SI units, of an oscillator.
DIALS: dict[str, tuple[Scale, float, float, float]] = {
    "K_c": (Scale("Contact stiffness K_c", "N/m"), 1e-2, 1e2, 1e4),
    "j_1": (Scale("Lower wall −j₁", "mm", 1e-3), 0.0, 3.0, 2e-3),
    "j_2": (Scale("Upper wall j₂", "mm", 1e-3), 0.0, 3.0, 2e-3),
    "K_ratio": (Scale("Stiffness of lower over upper wall"), 0.0, 2.0, 2.0),
    "damping": (Scale("Contact damping c_c", "N s/m"), 0.0, 5.0, 100.0),
    "preload": (Scale("Preload of both walls N₀", "N"), 0.0, 5.0, 1.0),
    "chi": (Scale("χ of Hunt–Crossley contact", "s/m"), 0.0, 5.0, 1.0),
    "restitution": (Scale("Coefficient of restitution e"), 0.0, 0.0, 1.0),
    "omega": (Scale("Frequency of the motion ω", "Hz"), 0.0, 0.0, 0.0),
    "forcing": (Scale("Forcing p", "N"), 0.0, 5.0, 1.0),
    "zeta": (Scale("Damping ratio ζ"), 0.05, 10.0, 0.1),
    "omega_n": (Scale("Natural frequency ω_n", "Hz"), 0.2, 4.0, 0.0),
    "mass": (Scale("Mass m", "kg"), 0.1, 10.0, 0.0),
    "alpha": (Scale("Cubic stiffness α", "10⁹ N/m³", 1e9), 0.0, 5.0, 1e9),
    "mean_load": (Scale("Mean load p₀", "N"), 0.0, 5.0, 1.0),
    "c": (Scale("Added damping c", "N s/m"), 0.0, 5.0, 10.0),
    "unbalance": (Scale("Unbalance u", "g m", 1e-3), 0.0, 5.0, 1e-2),
    "base_amplitude": (Scale("Amplitude of the base a", "mm", 1e-3), 0.0, 5.0, 1e-3),
    "base_damping": (Scale("Share of the damping at the base s"), 0.0, 1.0, 1.0),
}
_OF_A_SYSTEM = 0.2, 4.0  # range of a parameter as multiples of its value


def dials(question: Question, ranges: Mapping[str, Sequence[float]] | None = None) -> list[Dial]:
    """The sliders of a page that starts with a question.

    `ranges`: smallest and largest value that a study sweeps, in SI units; others get a range about
    their initial value.
    """
    given = {"omega": question.band, **(ranges or {})}
    example = question.machine.example
    return [
        _dial(name, value, given.get(name), example) for name, value in numbers(question).items()
    ]


def numbers(question: Question) -> dict[str, float]:
    """The values of a question that have a slider, by name, in SI units."""
    return dict(zip(question.machine.names, question.values, strict=True))


def asked(
    question: Question,
    values: Mapping[str, float],
    band: tuple[float, float] | None = None,
    **others: Any,
) -> Question:
    """The question with these values of the sliders, in SI units.

    Raises `ModelError` if one is out of range.
    """
    several = tuple(values[name] for name in question.machine.names)
    return replace(question, values=several, band=band or question.band, **others)


def _dial(name: str, value: float, given: Sequence[float] | None, model: Model) -> Dial:
    wall, _, contact = name.partition(" of ")
    in_metres = {*model.part_units[CONTACT]} <= {"m"}
    if is_oscillator := isinstance(model, Oscillator):
        scale, least, most, smallest_end = DIALS[name]
    elif wall in WALLS or name == "omega":
        known, least, most, end = DIALS[wall]
        title = f"{known.title} of {contact}" if contact else known.title
        is_known = in_metres or name == "omega"
        scale = replace(known, title=title) if is_known else Scale(title)
        smallest_end = 0.0 if known.unit else end
    else:
        scale, (least, most), smallest_end = Scale(name), _OF_A_SYSTEM, 0.0
    if given is not None and min(given) < max(given):
        low, high = min(given), max(given)
    else:
        low, high = sorted((least * value, most * value))
        low, high = min(low, 0.0) if value <= 0.0 else low, max(high, smallest_end)
    low, high = min(low, value), max(high, value)
    high = high if low < high else low + 1.0
    low, high, value = (each / scale.factor for each in (low, high, value))
    decades = name in _OVER_DECADES if is_oscillator else wall == "K_c"
    return Dial(name, scale, low, high, value, decades)
