"""Messages about problems of a study file: a line per problem, with the allowed values."""

import difflib
from collections.abc import Collection
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from gapsweep.errors import ModelError
from gapsweep.quantities import allowed, without_units, written
from gapsweep.study.units import units_of

_MOST = 50  # problems that are described
_BOUNDS = {
    "greater_than": ("gt", ">"),
    "greater_than_equal": ("ge", ">="),
    "less_than_equal": ("le", "<="),
}
_WORDS = {
    "model_type": "must be a table",
    "dict_type": "must be a table",
    "list_type": "must be a list",
    "string_type": "must be text, in quotes",
    "bool_type": "must be true or false",
    "finite_number": "must be finite",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "union_tag_invalid": "must be a state [1e-3, 0], { sobol = ... }, 'sweep_up' or 'sweep_down'",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "must be letters, digits, '.', '_' and '-', without spaces; 64 at "
    "most, a letter or digit first",
}
# Example of a missing key.
EXAMPLES = {
    "study": '[study] with name = "my-study"',
    "sweep": "[[sweep]] with representation, K_c, gap and omega",
    "name": 'name = "my-study"',
    "representation": 'representation = ["piecewise", "tanh-1e4"]',
    "K_c": "K_c = 1.4e4, in N/m",
    "gap": "gap = [4e-4, 4e-4], in m, or j_1 and j_2",
    "omega": "omega = { start = 1.0, stop = 30.0, step = 0.5 }, in Hz",
    "mass": "mass = 3.0, in kg",
    "omega_n": "omega_n = 5.0, in Hz",
    "chi": "chi = [0.1, 0.3], in s/m",
    "restitution": "restitution = [0.6, 0.8]",
    "zeta": "zeta = 0.03, where 0.03 is 3 %",
    "forcing": "forcing = 4.0, in N",
    "t_end": "t_end = 20.0, in s",
    "start": "start = 1.0",
    "stop": "stop = 30.0",
    "event": 'name = "large"',
    "rays": "rays = 32",
    "x": "x = [-2e-3, 2e-3], in m",
    "v": "v = [-0.05, 0.05], in m/s",
}
_RANGES = "must be a range for each coordinate, as [-0.1, 0.1] or [[-0.1, 0.1], [-0.1, 0.1]]"
# Allowed form of these keys as a whole; problems inside have separate messages.
_FORMS = {
    "gap": "must be the distances of both walls [m], as [4e-4, 4e-4], or a list of such pairs",
    "initial_condition": "must be x [m] and v [m/s], as [0.0, 0.0], 'sweep_up', 'sweep_down', "
    "{ sobol = ..., x = ..., v = ... }, { grid = ..., x = ..., v = ... }, or a list",
    "x": _RANGES,
    "v": _RANGES,
    "uncertain": "must be a distribution, as { normal = 4e-4, sd = 2e-5 }",
}
# Allowed form of keys of a system, also for problems inside.
_MATRIX = "must be a matrix, a list for each row, as [[2.0, 0.0], [0.0, 1.0]]"
_OF_SYSTEMS = {
    "mass": _MATRIX,
    "stiffness": _MATRIX,
    "damping": _MATRIX,
    "contacts": "must be names and directions, as { stop = [1.0, 0.0] }",
    "forcing": "must be a list of tables, as [{ amplitude = [1.0, 0.0] }]",
}
_SHAPES = ("list_type", "dict_type", "model_type", "too_short", "too_long")
# For alternatives, by the one that the discriminator assumes if none is given.
_EITHER = {"step": "give step or num", "sobol": "give sobol or grid"}
# Tags of unions, which are no keys of a file.
_OF_FORCING = {"number", "wave"}
_TAGS = {"list", "step", "num", "sobol", "grid", "sweep", "several", *_OF_FORCING}
# The field with the model's parameters in a block, and its alias in locations.
_PARAMETERS, _APART = "parameter", "[parameters]"

Loc = tuple[str | int, ...]


def problems(
    source: str, error: ValidationError, spec: type[BaseModel], parameters: Collection[str]
) -> list[str]:
    """Return one line per problem: location, value, and what is allowed.

    `parameters`: names of the model's parameters.
    """
    errors = error.errors(include_url=False)
    lines = [_problem(source, each, spec, parameters) for each in errors[:_MOST]]
    lines = list(dict.fromkeys(lines))
    if len(errors) > _MOST:
        lines.append(f"{source}: and {len(errors) - _MOST} more problems")
    return lines


def _problem(source: str, error: Any, spec: type[BaseModel], names: Collection[str]) -> str:
    kind, loc, value = error["type"], error["loc"], error["input"]
    if kind == "missing" and loc[-1] in _EITHER and loc[-1] in loc[:-1]:
        message, loc = _EITHER[loc[-1]], loc[:-1]
    else:
        message = _message(error, spec, names)
    where = _path(loc)
    shown = "" if kind == "missing" or isinstance(value, dict) else f" = {value!r:.80}"
    at = f"{source}: {where:.200}{shown}" if where else source
    return f"{at}: {message:.1000}"


def _message(error: Any, spec: type[BaseModel], names: Collection[str]) -> str:
    """Return the message for one error: the problem, and what is allowed."""
    kind, loc, value = error["type"], error["loc"], error["input"]
    if kind in _SHAPES and (field := _form_at(loc)):
        return _FORMS[field]
    if kind == "list_type" and isinstance(value, dict) and _tables(loc, spec):
        return f"must be a list of tables; write [[{_path(loc)}]]"
    if kind in _SHAPES and loc[:1] == ("system",) and (parts := {*loc} & {*_OF_SYSTEMS}):
        return _OF_SYSTEMS[str(parts.pop())]
    if kind in ("too_short", "too_long"):
        n = error["ctx"]["min_length" if kind == "too_short" else "max_length"]
        return f"must have {'at least one value' if n == 1 else f'{n} values'}"
    if kind in _BOUNDS:
        name, sign = _BOUNDS[kind]
        return f"must be {sign} {error['ctx'][name]:g}"
    if kind == "extra_forbidden" and loc[-2:] == ("num", "step"):
        return "give step or num, not both"
    if kind == "extra_forbidden":
        return f"unknown key{_likely(loc, spec, names)}"
    if kind == "missing":
        key = "event" if "event" in loc else loc[-1]
        return f"missing; write {EXAMPLES[key]}" if key in EXAMPLES else "missing"
    if kind == "float_type":
        return f"must be {_number(loc, value)}{_instead(loc, value)}"
    text = str(error["msg"]).removeprefix("Value error, ").replace("Input should be", "must be")
    return _WORDS.get(kind, text.removeprefix(f"{value!r}: "))


def _number(loc: Loc, value: Any) -> str:
    """Return which number is allowed, with all its units for a quantity of another dimension."""
    if loc[0] == "system" and loc[-2:-1] == ("amplitude",):
        return f"{allowed('N')}; with power = 1 in N s, with power = 2 in kg m"
    units = "" if loc[0] == "parameters" else units_of(loc)
    try:
        without_units("", value, units)
    except ModelError:
        return "a number" if units is None else allowed(units)
    return f"a number, in {written(units)}" if units and units != "1" else "a number"


def _instead(loc: Loc, value: Any) -> str:
    """Return a hint for a value that is no number but a likely intention; empty without one."""
    if loc[0] == "oscillator" and isinstance(value, list | dict):
        return "; write swept values in [[sweep]]"
    if loc[:2] == ("oscillator", "forcing") and isinstance(value, str) and "." in value:
        return '; write forcing = { table = "force.csv", period = "20 ms" } for a file'
    if value in ("inf", None) and {"gap", "j_1", "j_2"} & {*loc}:
        return "; write inf, without quotes, where there is no wall"
    if isinstance(value, str) and ":" in value:
        return "; write a range as { start = 1.0, stop = 30.0, step = 0.5 }"
    return ""


def _form_at(loc: Loc) -> str:
    """Return the key of `_FORMS` at the end of a location without tags and numbers; else empty."""
    if loc[:2] == ("uncertain", _APART):
        return "uncertain" if len(loc) == 3 else ""
    names = [part for part in loc if isinstance(part, str) and part not in _TAGS - {"sweep"}]
    return names[-1] if names and names[-1] in _FORMS else ""


def _likely(loc: Loc, spec: type[BaseModel], parameters: Collection[str]) -> str:
    """Return the question for a key of similar spelling in the same table, else all its keys."""
    keys = [key for table in _tables(loc[:-1], spec) for key in table.model_fields]
    is_swept = _PARAMETERS in keys
    keys += [*parameters] * is_swept
    # Another form of the table may have the key.
    known = [key for key in dict.fromkeys(keys) if key not in (loc[-1], _PARAMETERS)]
    folded = {key.casefold(): key for key in known}
    # Above the likeness of damping and base_damping.
    alike = difflib.get_close_matches(str(loc[-1]).casefold(), folded, n=1, cutoff=0.75)
    if alike:
        return f"; did you mean {folded[alike[0]]}?"
    more = "; parameters of a [system] must be in [parameters]" * is_swept
    return f"; known keys: {', '.join(known)}{more}"


def _tables(loc: Loc, spec: type[BaseModel]) -> list[type[BaseModel]]:
    """Return the classes of tables that a location allows; an empty list if it allows none."""
    found = [spec]
    for i, part in enumerate(loc):
        name = _PARAMETERS if part == _APART and loc[i + 1 :] else part
        fields = [table.model_fields[name] for table in found if name in table.model_fields]
        if fields and not (part in _TAGS and i > 2):  # nor do numbers and protocols lead further in
            found = [table for field in fields for table in _of(field.annotation)]
    return found


def _of(annotation: Any) -> list[type[BaseModel]]:
    """Return the classes of tables in a type annotation, without nested ones."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for part in get_args(annotation) for table in _of(part)]


def _path(loc: Loc) -> str:
    """``("sweep", 0, "omega", "step", "step")`` as ``sweep[0].omega.step``."""
    text, was_tag = "", False
    for i, part in enumerate(part for part in loc if part != _APART):
        was_tag = part in _TAGS and not was_tag and i > (1 if part in _OF_FORCING else 2)
        if not was_tag:
            text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".")
