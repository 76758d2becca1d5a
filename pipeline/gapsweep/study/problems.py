"""What is wrong in a study file, in words: a line per problem, with what is allowed."""

import difflib
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

_BOUNDS = {
    "greater_than": ("gt", ">"),
    "greater_than_equal": ("ge", ">="),
    "less_than_equal": ("le", "<="),
}
_WORDS = {
    "model_type": "must be a table",
    "missing": "missing",
    "union_tag_invalid": "must be { sobol = ... }, 'sweep_up' or 'sweep_down'",
    "string_pattern_mismatch": "must be letters, digits, '.', '_' and '-', without spaces; 64 at "
    "most, a letter or digit first",
}
# What stands for these as a whole; what is wrong inside of it has words of its own.
_FORMS = {
    "gap": "must be the distances of both walls [m], as [4e-4, 4e-4], or a list of such pairs",
    "initial_condition": "must be x [m] and v [m/s], as [0.0, 0.0], 'sweep_up', 'sweep_down', "
    "{ sobol = ..., x = ..., v = ... }, { grid = ..., x = ..., v = ... }, or a list",
}
_SHAPES = ("list_type", "model_type", "too_short", "too_long")
# Of two forms of one thing, those that the discriminator takes where neither is told.
_EITHER = {"step": "give step or num", "sobol": "give sobol or grid"}
# The tags of unions: ours, not the user's.
_TAGS = {"list", "step", "num", "sobol", "grid", "sweep", "several"}
_OF_WHAT = {"oscillator", "system"}  # of which a block of points is: the tag behind its number

Loc = tuple[str | int, ...]


def problems(source: str, error: ValidationError, spec: type[BaseModel]) -> list[str]:
    """One line for each: where, the offending value, what is allowed."""
    return list(dict.fromkeys(_problem(source, each, spec) for each in error.errors()))


def _problem(source: str, error: Any, spec: type[BaseModel]) -> str:
    kind, loc, value = error["type"], error["loc"], error["input"]
    message = error["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if kind in _SHAPES and (field := _form_at(loc)):
        message = _FORMS[field]
    elif kind == "list_type" and isinstance(value, dict):
        message = f"must be in double brackets: [[{_path(loc)}]]"
    elif kind in ("too_short", "too_long"):
        n = error["ctx"]["min_length" if kind == "too_short" else "max_length"]
        message = f"must have {'at least one value' if n == 1 else f'{n} values'}"
    elif kind in _BOUNDS:
        name, sign = _BOUNDS[kind]
        message = f"must be {sign} {error['ctx'][name]:g}"
    elif kind == "extra_forbidden" and loc[-2:] == ("num", "step"):
        message = "give step or num, not both"
    elif kind == "extra_forbidden":
        message = f"unknown key{_likely(loc, spec)}"
    elif kind == "missing" and loc[-1] in _EITHER and loc[-1] in loc[:-1]:
        message, loc = _EITHER[loc[-1]], loc[:-1]
    else:
        message = _WORDS.get(kind, message)
    where = _path(loc)
    shown = "" if kind == "missing" or isinstance(value, dict) else f" = {value!r:.80}"
    return f"{source}: {where}{shown}: {message}" if where else f"{source}: {message}"


def _form_at(loc: Loc) -> str:
    """Which of `_FORMS` a place is in, if nothing but tags and numbers follow it; empty if none."""
    names = [part for part in loc if isinstance(part, str) and part not in _TAGS - {"sweep"}]
    return names[-1] if names and names[-1] in _FORMS else ""


def _likely(loc: Loc, spec: type[BaseModel]) -> str:
    """Which key of the same table is meant, if one is alike."""
    first, last = str(loc[0]), str(loc[-1])
    known = set(spec.model_fields) if len(loc) == 1 else _keys(spec.model_fields[first].annotation)
    alike = difflib.get_close_matches(last, known, n=1)
    return f"; did you mean {alike[0]}?" if alike else ""


def _keys(annotation: Any) -> set[str]:
    """Names of all fields of the tables in an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        fields = annotation.model_fields
        return set(fields).union(*(_keys(field.annotation) for field in fields.values()))
    return set().union(*map(_keys, get_args(annotation)))


def _path(loc: Loc) -> str:
    """``("sweep", 0, "omega", "step", "step")`` as ``sweep[0].omega.step``."""
    text, was_tag = "", False
    if loc[:1] == ("sweep",) and loc[2:3] and loc[2] in _OF_WHAT:
        loc = (*loc[:2], *loc[3:])
    for i, part in enumerate(loc):
        was_tag = part in _TAGS and not was_tag and i > 2
        if not was_tag:
            text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".")
