"""A setting of the page's sliders, and the ranges of the sliders."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapsweep.errors import ModelError
from gapsweep.model.contact import FIT_RANGE, ContactLaw, Piecewise
from gapsweep.model.labels import EXACT, Representation, canonical_label, contact_law
from gapsweep.model.oscillator import OSCILLATOR, Gap, Oscillator, checked
from gapsweep.model.systems import paper_oscillator
from gapsweep.study.study import Study

MAX_APPROXIMATIONS = 3
DEFAULT_APPROXIMATIONS = ("tanh-1e4",)
# First frequency of the page in natural frequencies: above resonance, where contacts matter.
_LOOKED_AT = 1.8


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """A setting of the page: all values that its figures depend on.

    Attributes
    ----------
    oscillator : Oscillator
    K_c, K_ratio : float
        Stiffness [N/m] of the upper wall, and of the lower over the upper [-].
    gap : Gap
    approximations : tuple of str
        Labels of the other laws.
    band : (float, float)
        First and last frequency [Hz] of the response.
    omega : float
        Frequency [Hz] of the motion that is shown.
    start : (float, float)
        Initial displacement [m] and velocity [m/s] of this motion.
    fit_range : float
        Half-width [m] of the range on which polynomials are fitted.
    over : str
        Name of the parameter on the second axis of the map.
    over_values : tuple of float
        Its values there, in SI units; without values there is no map.
    """

    oscillator: Oscillator
    K_c: float
    gap: Gap
    band: tuple[float, float]
    omega: float
    K_ratio: float = 1.0
    approximations: tuple[str, ...] = ()
    start: tuple[float, float] = (0.0, 0.0)
    fit_range: float = FIT_RANGE
    over: str = "K_c"
    over_values: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.oscillator.omega_n:
            raise ModelError("omega_n = 0: must be > 0 here; for a free mass use gapsweep.respond")
        checked("omega", self.omega, low=0.0, strict=True)
        for name, value in zip(("x_0", "v_0"), self.start, strict=True):
            checked(name, value)
        low, high = self.band
        if not 0.0 < low < high:
            raise ModelError(f"frequencies {low:g} to {high:g} Hz: must be > 0 Hz and ascend")

    def law(self, label: str) -> ContactLaw:
        """The contact law of a label, with the stiffness and gap of the question."""
        return contact_law(label, self.K_c, self.gap, self.fit_range, K_ratio=self.K_ratio)

    @property
    def of_basins(self) -> "Question":
        """The question without the values that its basins do not depend on, as a key for them."""
        return replace(self, band=(1.0, 2.0), over="", over_values=(), **_OF_NO_PLANE)

    @property
    def of_map(self) -> "Question":
        """The question without the values that its map does not depend on, as a key for it."""
        here = self.at(self.over, self.over_values[0]) if self.over_values else self
        return replace(here, omega=1.0, **_OF_NO_PLANE)

    def at(self, name: str, value: float) -> "Question":
        """The question with another value of a parameter that has a slider."""
        others = ("approximations", "start", "fit_range", "over", "over_values")
        kept = {each: getattr(self, each) for each in others}
        return asked(numbers(self) | {name: value}, self.band, **kept)


_OF_NO_PLANE: dict[str, Any] = {"approximations": (), "start": (0.0, 0.0)}


def labels(text: str) -> tuple[Representation, ...]:
    """Approximations from a text that the user typed, as ``"tanh-1e4, poly-13"``.

    Raises
    ------
    ModelError
        If a label is unknown or is of a user law, or there are too many.
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
    """A slider: name, title, unit, range and initial value, in the unit that it shows."""

    name: str  # name of the parameter
    title: str
    unit: str
    factor: float  # SI units in one of the shown
    low: float
    high: float
    value: float

    @property
    def is_log(self) -> bool:
        """Whether the slider is logarithmic."""
        return self.name in _OVER_DECADES and self.low > 0.0

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def tick(self) -> str:
        """JavaScript for the value at a place of the slider, `tick`."""
        return f"return String(Number(({'10 ** tick' if self.is_log else 'tick'}).toPrecision(4)))"

    def place(self, value: float) -> float:
        """The place of a value in SI units on the slider."""
        return self.scaled(value / self.factor)

    def scaled(self, shown: float) -> float:
        """The place of a value in the displayed unit on the slider."""
        return math.log10(shown) if self.is_log else shown

    def at(self, place: float) -> float:
        """The value at a place of the slider, in SI units."""
        return float(self.factor * (10.0**place if self.is_log else place))

    def along(self, n: int) -> tuple[float, ...]:
        """`n` values in SI units, evenly spaced on the slider."""
        places = np.linspace(self.scaled(self.low), self.scaled(self.high), n)
        return tuple(map(self.at, places.tolist()))


_OVER_DECADES = ("K_c", "zeta", "mass")
# Title, unit, its value in SI units, and the range: lower and upper end as multiples of the initial
# value, and the smallest upper end in SI units.
_DIALS: dict[str, tuple[str, str, float, float, float, float]] = {
    "K_c": ("Contact stiffness K_c", "N/m", 1.0, 1e-2, 1e2, 1e4),
    "j_1": ("Lower wall −j₁", "mm", 1e-3, 0.0, 3.0, 2e-3),
    "j_2": ("Upper wall j₂", "mm", 1e-3, 0.0, 3.0, 2e-3),
    "K_ratio": ("Stiffness of lower over upper wall", "", 1.0, 0.0, 2.0, 2.0),
    "omega": ("Frequency of the motion ω", "Hz", 1.0, 0.0, 0.0, 0.0),
    "forcing": ("Forcing p", "N", 1.0, 0.0, 5.0, 1.0),
    "zeta": ("Damping ratio ζ", "", 1.0, 0.05, 10.0, 0.1),
    "omega_n": ("Natural frequency ω_n", "Hz", 1.0, 0.2, 4.0, 0.0),
    "mass": ("Mass m", "kg", 1.0, 0.1, 10.0, 0.0),
    "alpha": ("Cubic stiffness α", "10⁹ N/m³", 1e9, 0.0, 5.0, 1e9),
    "mean_load": ("Mean load p₀", "N", 1.0, 0.0, 5.0, 1.0),
    "c": ("Added damping c", "N s/m", 1.0, 0.0, 5.0, 10.0),
    "unbalance": ("Unbalance u", "g m", 1e-3, 0.0, 5.0, 1e-2),
    "base_amplitude": ("Amplitude of the base a", "mm", 1e-3, 0.0, 5.0, 1e-3),
    "base_damping": ("Share of the damping at the base s", "", 1.0, 0.0, 1.0, 1.0),
}


def dials(question: Question, ranges: Mapping[str, Sequence[float]] | None = None) -> list[Dial]:
    """The sliders of a page that starts with a question.

    Parameters
    ----------
    question : Question
    ranges : mapping of str to sequence of float, optional
        Smallest and largest value that a study sweeps, in SI units; others get a range about
        their initial value.
    """
    given = {"omega": question.band, **(ranges or {})}
    return [_dial(name, value, given.get(name)) for name, value in numbers(question).items()]


def numbers(question: Question) -> dict[str, float]:
    """The values of a question that have a slider, by name, in SI units."""
    oscillator, gap = question.oscillator, question.gap
    found = {name: getattr(oscillator, name) for name in OSCILLATOR}
    found |= {name: getattr(question, name) for name in ("K_c", "K_ratio", "omega")}
    found |= {"j_1": gap.j_1, "j_2": gap.j_2}
    return {name: found[name] for name in _DIALS}


def asked(values: Mapping[str, float], band: tuple[float, float], **others: Any) -> Question:
    """The question with these values of the sliders, in SI units.

    Raises
    ------
    ModelError
        If one is out of range.
    """
    return Question(
        oscillator=Oscillator(**{name: values[name] for name in OSCILLATOR}),
        gap=Gap(values["j_1"], values["j_2"]),
        band=band,
        K_c=values["K_c"],
        K_ratio=values["K_ratio"],
        omega=values["omega"],
        **others,
    )


def _dial(name: str, value: float, given: Sequence[float] | None) -> Dial:
    title, unit, factor, least, most, smallest_end = _DIALS[name]
    if given is not None and min(given) < max(given):
        low, high = min(given), max(given)
    else:
        low, high = sorted((least * value, most * value))
        low, high = min(low, 0.0) if value <= 0.0 else low, max(high, smallest_end)
    low, high = min(low, value), max(high, value)
    return Dial(name, title, unit, factor, low / factor, high / factor, value / factor)


# --- where it starts ------------------------------------------------------------------------------


def of_model(
    oscillator: Oscillator | None = None,
    law: ContactLaw | None = None,
    *,
    approximations: Sequence[str] = DEFAULT_APPROXIMATIONS,
) -> Question:
    """The initial question of the page for an oscillator and a contact law.

    Raises
    ------
    ModelError
        If an argument has another type or is out of range.
    """
    oscillator = paper_oscillator() if oscillator is None else oscillator
    law = Piecewise(K_c=1.4e4, gap=Gap(0.4e-3, 0.4e-3)) if law is None else law
    if not isinstance(oscillator, Oscillator):
        raise ModelError(f"oscillator = {oscillator!r:.80}: must be a gapsweep.Oscillator")
    _check_cosine(oscillator)
    if not isinstance(law, ContactLaw):
        raise ModelError(f"law = {law!r:.80}: must be a contact law, as gapsweep.Piecewise")
    return Question(
        oscillator=oscillator,
        K_c=law.K_c,
        K_ratio=law.K_ratio,
        gap=law.gap,
        approximations=labels(" ".join(approximations)),
        band=(0.4 * oscillator.omega_n, 3.0 * oscillator.omega_n),
        omega=_LOOKED_AT * oscillator.omega_n,
    )


def _check_cosine(oscillator: Oscillator) -> None:
    if oscillator.wave is not None:
        raise ModelError(
            "forcing: explore draws responses to a cosine only; for a force by pieces use "
            "gapsweep.respond, gapsweep.frequency_response or a study"
        )


def refuse_systems(tables: Mapping[str, Any], source: object) -> None:
    """Raise an error for the tables of a study of systems, before its user code is imported.

    Raises
    ------
    ModelError
    """
    if tables.get("system") is not None:
        raise ModelError(
            f"{source}: a study of systems; explore accepts oscillators only. For systems use "
            "the report of 'gapsweep run', ds.gapsweep.bifurcation() and map() of gapsweep.open, "
            "gapsweep.respond and gapsweep.simulate"
        )


def of_study(study: Study) -> tuple[Question, dict[str, tuple[float, float]]]:
    """The initial question of the page for a study of oscillators, and its swept ranges.

    Raises
    ------
    ModelError
        If a value of the study is out of the range of the page.
    """
    _check_cosine(study.oscillator)
    grid = study.grid
    ranges = {
        name: (min(axis), max(axis))
        for name, axis in grid.axes.items()
        if name in _DIALS and name not in ("j_1", "j_2")
    }
    for name in ("j_1", "j_2"):
        walls = [getattr(gap, name) for gap in grid.gaps]
        ranges[name] = min(walls), max(walls)
    band = ranges.pop("omega")
    is_one = band[0] == band[1]
    if is_one:
        band = 0.5 * band[0], 2.0 * band[1]
    # The first requested cell: in a union of blocks, other cells may be no points.
    first = np.argwhere(grid.requested)[0]
    point = {name: axis[k] for (name, axis), k in zip(grid.axes.items(), first, strict=True)}
    gap = point.get("gap") or Gap(point["j_1"], point["j_2"])
    values = {name: getattr(study.oscillator, name) for name in OSCILLATOR} | {"K_ratio": 1.0}
    values |= {name: value for name, value in point.items() if name in _DIALS}
    values |= {"j_1": gap.j_1, "j_2": gap.j_2}
    if not is_one:
        values["omega"] = min(max(_LOOKED_AT * values["omega_n"], band[0]), band[1])
    ours = [law for law in _plain(grid.representations) if not law.is_own]
    others = [law for law in ours if law != EXACT and not law.is_auto]
    question = asked(values, band, approximations=tuple(others[:1]), fit_range=study.spec.fit.range)
    return question, ranges


def not_computed(study: Study) -> str:
    """A note that the page does not compute user-defined laws; empty if there are none."""
    own = [law for law in _plain(study.grid.representations) if law.is_own]
    if not own:
        return ""
    return (
        f"Not computed here: the user-defined {', '.join(own)}. Squares: stored results; black: "
        "the piecewise-linear law, with K_c and the gap of the sliders."
    )


def _plain(representations: Sequence[Representation]) -> list[Representation]:
    """Distinct representations without their protocols."""
    return list(dict.fromkeys(one.law for one in representations))
