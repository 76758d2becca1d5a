"""How claims are written: quantities that are read from a run later, compared with operators.

A `Quantity` has one number for each law, degree or case. Comparing quantities makes a `Comparison`,
which becomes one test for each pair of numbers, and the words that say what was found. The paper
leaves some settings open: a claim is decided with the first value of each, and once more with every
other value of the settings that its quantities have used.
"""

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from gapsweep.analysis.claims import Claim, Found, NotInRunError, Number, Run, Test, verdict

SETTINGS: dict[str, dict[str, str]] = {
    "start": {"+0.4 mm": "from +0.4 mm", "rest": "from rest"},
    # Inside a step that a located contact ends; as protocols of the exact law end.
    "force": {"": "contact force as Eq. 1b", "-mode": "contact force by mode"},
    "share": {
        "amplitude": "errors relative to the exact amplitude",
        "gap": "errors relative to the exact amplitude or half of the gap, the larger one",
    },
    "gap": {"1.5/1.5": "gap 1.5 mm", "1.1/1.1": "gap 1.1 mm", "1.8/1.8": "gap 1.8 mm"},
    "unit": {"m": "x in m", "mm": "x in mm", "4 mm": "x as a share of 4 mm"},
}
# Where verdicts differ with this setting, nothing in the paper decides.
DECISIVE = "unit"
_MARKS = {True: "✓", False: "✗", None: "open"}


@dataclass(frozen=True)
class At:
    """A run, settings other than the first values, and which settings were used."""

    run: Run
    settings: dict[str, str]
    used: set[str] = field(default_factory=set)

    def __getitem__(self, setting: str) -> str:
        self.used.add(setting)
        return self.settings.get(setting, next(iter(SETTINGS[setting])))


Read = Callable[[At], Number]


@dataclass(frozen=True, eq=False)
class Quantity:
    """Numbers to be read: what they are, the name and reader of each, and how they are shown.

    Those with `log` are read as decimal logarithms, so that factors are compared; they are stated
    and shown as they are.
    """

    what: str
    parts: tuple[tuple[str, Read], ...]
    form: str = ".3g"
    log: bool = False

    def __lt__(self, other: Any) -> "Comparison":
        return Comparison(self, "<", other)

    def __le__(self, other: Any) -> "Comparison":
        return Comparison(self, "<=", other)

    def __gt__(self, other: Any) -> "Comparison":
        return Comparison(self, ">", other)

    def __ge__(self, other: Any) -> "Comparison":
        return Comparison(self, ">=", other)

    def __truediv__(self, other: "Quantity") -> "Quantity":
        """How many times the other's number each is, pair by pair."""
        divided = (lambda a, b: a - b) if self.log else (lambda a, b: a / b)
        return replace(self._with(other, "over", divided), form=".3g", log=self.log)

    def __sub__(self, other: "Quantity") -> "Quantity":
        return self._with(other, "minus", lambda a, b: a - b)

    def apart(self, other: "Quantity") -> "Quantity":
        """Pair by pair the larger over the smaller."""

        def ratio(a: Number, b: Number) -> Number:
            larger, smaller = (a, b) if a.value > b.value else (b, a)
            return larger - smaller if self.log else larger / smaller

        return replace(self._with(other, "against", ratio), form=".3g", log=self.log)

    def _with(
        self, other: "Quantity", word: str, number: Callable[[Number, Number], Number]
    ) -> "Quantity":
        def part(ours: tuple[str, Read], theirs: tuple[str, Read]) -> tuple[str, Read]:
            name = ours[0] if ours[0] == theirs[0] else f"{ours[0]} {word} {theirs[0]}"
            return name, lambda at: number(ours[1](at), theirs[1](at))

        what = f"{self.what} {word} {other.what}"
        if self.what == other.what:  # a ratio has no unit
            noun = {"minus": f"difference of {self.what}"}
            what = noun.get(word, f"ratio of {self.what.partition(' [')[0]}")
        return Quantity(what, tuple(part(*two) for two in pairs(self, other)), self.form)

    def listed(self, at: At) -> str:
        """What the numbers are, and each by its name."""
        numbers = (f"{name} {self.shown(read(at).value)}".strip() for name, read in self.parts)
        return f"{self.what}: {', '.join(numbers)}"

    def scaled(self, number: float) -> float:
        """A threshold as the numbers are read."""
        return math.log10(number) if self.log else number

    def shown(self, number: float) -> str:
        return f"{10.0**number if self.log else number:{self.form}}"


def pairs(one: Quantity, other: Quantity) -> list[tuple[tuple[str, Read], tuple[str, Read]]]:
    """Parts of the same names two by two, or else each with each."""
    names = ([name for name, _ in quantity.parts] for quantity in (one, other))
    if len(one.parts) > 1 and next(names) == next(names):
        return list(zip(one.parts, other.parts, strict=True))
    return list(product(one.parts, other.parts))


def alike(one: Quantity, other: Quantity, within: float) -> "Comparison":
    """The numbers differ by no more than a factor, pair by pair."""
    return one.apart(other) <= within


@dataclass(frozen=True)
class Comparison:
    """What must hold: numbers against a threshold, or against other numbers."""

    left: Quantity
    op: str
    right: Any

    def decided(self, at: At) -> tuple[list[Test], str]:
        """A test for each pair, and in words what was found."""
        return self._against_numbers(at) if self._is_pairwise else self._against_threshold(at)

    @property
    def _is_pairwise(self) -> bool:
        return isinstance(self.right, Quantity)

    def _against_threshold(self, at: At) -> tuple[list[Test], str]:
        left, limit = self.left, self.left.scaled(self.right)
        log = "log10 of " * left.log
        tests = [
            Test(f"{log}{left.what}{_of(name)}", read(at), self.op, limit)
            for name, read in left.parts
        ]
        found = (
            f"{name} {left.shown(test.number.value)} {_MARKS[test.holds]}".strip()
            for (name, _), test in zip(left.parts, tests, strict=True)
        )
        return tests, f"{left.what} {self.op} {left.shown(limit)}: {', '.join(found)}"

    def _against_numbers(self, at: At) -> tuple[list[Test], str]:
        left, right = self.left, self.right
        read = {part: part[1](at) for part in (*left.parts, *right.parts)}
        log = "log10 of " * left.log
        same = left.what == right.what
        tests, failed = [], []
        for ours, theirs in pairs(left, right):
            minus = "" if ours[0] == theirs[0] else f": {ours[0]} minus {theirs[0]}"
            what = left.what if same else f"{left.what} minus {right.what}, {ours[0]}"
            number = read[ours] - read[theirs]
            tests.append(Test(f"{log}{what}{minus}", number, self.op, 0.0))
            if tests[-1].holds is not True:
                failed.append(f"{ours[0]} {self.op} {theirs[0]} {_MARKS[tests[-1].holds]}")
        values = (
            ", ".join(f"{part[0]} {side.shown(read[part].value)}".strip() for part in side.parts)
            for side in (left, right)
        )
        between = self.op if same else f"{self.op} {right.what}:"
        but = "✓" if not failed else f"({', '.join(failed)})"
        return tests, f"{left.what}: {f' {between} '.join(values)} {but}"


def _of(name: str) -> str:
    return f": {name}" if name else ""


def claim(
    id: int,
    place: Any,
    quote: str,
    *comparisons: Comparison,
    note: str = "",
    context: Iterable[Quantity] = (),
    unstated: str = "",
) -> Claim:
    """A claim of the paper: its words, and what must hold for them.

    Parameters
    ----------
    place : str or a case with a `place` and `words`
        Figure, table or section.
    note : str
        Why these comparisons decide the words.
    context : iterable of Quantity
        Numbers that are shown and decide nothing.
    unstated : str
        What the text leaves open; the claim is then undecidable.
    """
    where, words = (place, "") if isinstance(place, str) else (place.place, f"{place.words}. ")

    def find(run: Run) -> Found:
        at = At(run, {})
        tests, found = _decided(comparisons, at)
        own, is_open_to = verdict(t.holds for t in tests), unstated
        used = [name for name in SETTINGS if name in at.used]
        usual = ", ".join(next(iter(SETTINGS[name].values())) for name in used if name != "share")
        said = [is_open_to, f"{usual}: {own}" if usual else "", found]
        said += [q.listed(at) for q in context]
        others = {}
        for name, (value, says) in ((n, v) for n in used for v in [*SETTINGS[n].items()][1:]):
            with suppress(NotInRunError):
                again, words = _decided(comparisons, At(run, {name: value}))
                other = verdict(t.holds for t in again)
                if name != DECISIVE:
                    others[says] = again
                elif other != own:
                    is_open_to = said[0] = f"Not in the text: the {DECISIVE} of x"
                if other != own or name != "share":  # a share that changes nothing is not named
                    more = f" ({words})" if other != own and name != DECISIVE else ""
                    said.append(f"{says}: {other}{more}")
        said = [one.replace(f"{where}, ", "") for one in said if one]
        sentence = ". ".join(one[0].upper() + one[1:] for one in said) + "."
        return ([], sentence, {}) if is_open_to else (tests, sentence, others)

    return Claim(id, where, quote, f"{words}{note}".strip(), find)


def _decided(comparisons: Iterable[Comparison], at: At) -> tuple[list[Test], str]:
    found = [comparison.decided(at) for comparison in comparisons]
    return [test for tests, _ in found for test in tests], "; ".join(text for _, text in found)
