"""The claims file: statements about the results, and the numbers that decide them.

A claim has tests; each takes numbers from one dataset of a run and compares them with a threshold,
with one another or with those of the exact law. What the tests may say is fixed here, so that a
claims file holds data only, no code; `gapsweep.analysis.claims` computes the verdicts.
"""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gapsweep.errors import StudyError

Data = Literal["responses", "attractors", "agreement", "static", "timing"]
Scalar = str | int | float
Condition = dict[Literal["is", "in", "outside", "above", "below"], Any]

Statistic = Literal[
    "only", "mean", "sum", "median", "p95", "max", "min", "share", "argmax",
    "slope", "largest_rise", "first",
]  # fmt: skip


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


def _fits(condition: Condition) -> bool:
    """Whether what is asked for is of the kind that the condition needs."""
    ((relation, wanted),) = condition.items()
    several = wanted if isinstance(wanted, list) else [wanted]
    numbers = all(isinstance(one, int | float) and not isinstance(one, bool) for one in several)
    if relation == "outside":
        return isinstance(wanted, list) and len(wanted) == 2 and numbers
    if relation in ("above", "below"):
        return not isinstance(wanted, list) and numbers
    return isinstance(wanted, list) == (relation == "in") and (
        numbers or all(isinstance(one, str) for one in several)
    )


class Number(_Table):
    """Where a number comes from: a variable, a selection, and how it is condensed.

    Attributes
    ----------
    data : str
        Dataset of the run, without its suffix.
    variable : str
        The variable to condense; with statistic ``share`` it may be left out.
    at : dict
        Labels along dimensions; a list selects several.
    range : dict
        Closed intervals along numeric dimensions.
    start : str
        Which starts: ``rest``, ``fixed`` (all but sweeps), ``scattered`` (fixed, not from rest),
        ``sweep_up``, ``sweep_down`` or ``all``.
    every : float
        Only frequencies [Hz] that are whole multiples of this.
    where : dict of str to dict
        Conditions on variables of the same dataset, all of which hold for what counts: ``is`` a
        number or flag meaning, ``in`` a list, ``outside`` a closed interval, ``above`` or
        ``below`` a number.
    any_over, weight : str
        With ``share``: a dimension along which one that counts is enough; a variable whose sum
        over what counts along dimension `any_over` is averaged instead.
    statistic : str
        ``only`` the one number selected; ``mean``, ``sum``, ``median``, ``p95``, ``max``, ``min``
        of what is not NaN; ``share`` of sweep points or scenes for
        which `where` holds; ``argmax`` the coordinate of the largest; ``first`` the smallest
        coordinate for which `where` holds; ``slope`` of log against log; ``largest_rise``, the
        largest relative increase from one value to the next; the last four along `along`.
    along : str
        Dimension of the last four.
    absolute : bool
        Take magnitudes first.
    per_period : bool
        Divide a variable of the responses by the number of forcing periods simulated.
    missing : str
        What a sweep point without a value is: ``dropped``, or the ``worst``, an infinite error.
    """

    data: Data
    variable: str = ""
    at: dict[str, Scalar | list[Scalar]] = {}
    range: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = {}
    start: Literal["rest", "fixed", "scattered", "sweep_up", "sweep_down", "all"] = "all"
    every: Annotated[float, Field(gt=0)] | None = None
    where: dict[str, Condition] = {}
    any_over: str = ""
    weight: str = ""
    statistic: Statistic = "only"
    along: str = ""
    absolute: bool = False
    per_period: bool = False
    missing: Literal["dropped", "worst"] = "dropped"

    @model_validator(mode="after")
    def _complete(self) -> "Number":
        problems = []
        needs_axis = self.statistic in ("argmax", "slope", "largest_rise", "first")
        if needs_axis != bool(self.along):
            problems.append(f"along: goes with statistic {self.statistic!r} only if it needs it")
        if self.statistic in ("share", "first"):
            if not self.where:
                problems.append(f"where: statistic {self.statistic!r} needs conditions")
        elif not self.variable:
            problems.append("variable: missing")
        if self.weight and not self.any_over:
            problems.append("any_over: missing, weight needs it")
        if self.per_period and self.data != "responses":
            problems.append("per_period: is for data 'responses' only")
        for name, condition in self.where.items():
            if len(condition) != 1:
                problems.append(f"where.{name}: must be one of is, in, outside, above, below")
            elif not _fits(condition):
                problems.append(f"where.{name} = {condition}: no such condition")
        if problems:
            raise ValueError("; ".join(problems))
        return self


class Test(_Table):
    """One decision.

    Attributes
    ----------
    says : str
        What holds if the test does, in a few words.
    kind : str
        ``compare``: the number stands in relation `op` to `threshold`; with `against`, its
        difference from or ratio to the number with these changes does. ``order``: the numbers
        of `of` (changes, in turn) rise, each by more than the floor. ``alike``: the numbers of
        `of` lie within a factor of `threshold`.
    number : Number
    against : dict
        Keys of `number` to be replaced for the other number; those of `at` one by one.
    by : str
        ``difference`` or ``ratio``.
    op, threshold
    of : list of dict
        As `against`.
    """

    __test__ = False  # no test of pytest's

    says: Annotated[str, Field(min_length=1)]
    kind: Literal["compare", "order", "alike"]
    number: Number
    against: dict[str, Any] | None = None
    by: Literal["difference", "ratio"] = "ratio"
    op: Literal["<", "<=", ">", ">="] = "<="
    threshold: float | None = None
    of: list[dict[str, Any]] = []

    @model_validator(mode="after")
    def _complete(self) -> "Test":
        if self.kind == "compare" and (self.threshold is None or self.of):
            raise ValueError("kind 'compare' needs threshold, and no of")
        if self.kind != "compare" and len(self.of) < 2:
            raise ValueError(f"of: kind {self.kind!r} needs two or more")
        if self.kind == "alike" and (self.threshold is None or self.threshold <= 1.0):
            raise ValueError("threshold: kind 'alike' needs a factor > 1")
        for changes in self.changes:
            try:
                varied(self.number, changes)
            except ValidationError as error:
                first = error.errors()[0]
                key = ".".join(str(part) for part in first["loc"])
                raise ValueError(f"against or of: {key}: {first['msg']}") from None
        return self

    @property
    def changes(self) -> list[dict[str, Any]]:
        """What is changed for each number beyond the first."""
        return [*self.of, *([self.against] if self.against is not None else [])]


def varied(number: Number, changes: dict[str, Any]) -> Number:
    """A number with some keys replaced; those of `at` and `range` one by one."""
    tables = number.model_dump(exclude_unset=True)
    for name, value in changes.items():
        merged = name in ("at", "range") and isinstance(value, dict)
        tables[name] = {**tables.get(name, {}), **value} if merged else value
    return Number.model_validate(tables)


class Claim(_Table):
    """One statement of the paper.

    Attributes
    ----------
    id : int
    place : str
        Figure, table or section.
    text : str
        The claim, in our own words.
    why : str
        Why these numbers and thresholds decide it.
    combine : str
        ``all``: confirmed if all tests hold, refuted if none does, partly if some; ``any``:
        confirmed if one holds, refuted if none does.
    undecidable : str
        What the paper leaves unstated; instead of tests.
    test : list of Test
    """

    id: Annotated[int, Field(ge=1)]
    place: Annotated[str, Field(min_length=1)]
    text: Annotated[str, Field(min_length=1)]
    why: Annotated[str, Field(min_length=1)]
    combine: Literal["all", "any"] = "all"
    undecidable: str = ""
    test: list[Test] = []

    @model_validator(mode="after")
    def _either(self) -> "Claim":
        if bool(self.undecidable) == bool(self.test):
            raise ValueError("needs either [[claim.test]] or undecidable")
        return self


class ClaimsFile(_Table):
    claim: Annotated[list[Claim], Field(min_length=1)]

    @model_validator(mode="after")
    def _once(self) -> "ClaimsFile":
        ids = [claim.id for claim in self.claim]
        twice = sorted({i for i in ids if ids.count(i) > 1})
        if twice:
            raise ValueError(f"claim.id = {twice[0]}: stands there more than once")
        return self


def read_claims(path: str | Path) -> list[Claim]:
    """Read and check a claims file.

    Raises
    ------
    StudyError
        One line per problem, each naming the file, the claim and the key.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        tables = tomllib.loads(text)
    except OSError as error:
        raise StudyError([f"{path}: cannot be read: {error.strerror}"]) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise StudyError([f"{path}: not valid TOML: {error}"]) from None
    try:
        return list(ClaimsFile.model_validate(tables).claim)
    except ValidationError as error:
        problems = [_problem(str(path), tables, e) for e in error.errors()]
        raise StudyError(list(dict.fromkeys(problems))) from None


def _problem(path: str, tables: dict[str, Any], error: Any) -> str:
    """One line: which claim, which key, what is wrong."""
    loc = list(error["loc"])
    name = ""
    if len(loc) > 1 and loc[0] == "claim" and isinstance(loc[1], int):
        claim = tables["claim"][loc[1]]
        known = isinstance(claim, dict) and "id" in claim
        name = f"claim {claim['id']}: " if known else f"claim[{loc[1]}]: "
        loc = loc[2:]
    where = ""
    for part in loc:
        where += f"[{part}]" if isinstance(part, int) else f".{part}"
    message = error["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if error["type"] == "extra_forbidden":
        message = "unknown key"
    value = error["input"]
    shown = f" = {value!r:.60}" if isinstance(value, str | int | float) else ""
    return f"{path}: {name}{where.lstrip('.')}{shown}{': ' if where else ''}{message}".replace(
        "\n", " "
    )
