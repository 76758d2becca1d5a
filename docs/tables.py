"""Reference pages made from the code: datasets from the schema, commands from the command line."""

from collections.abc import Iterable, Iterator

import click

from gapsweep.analysis.agreement import branch_agreement
from gapsweep.analysis.agreement.metrics import variables
from gapsweep.analysis.datasets import branches_file as branches
from gapsweep.analysis.datasets import fit_file, histories, risk, static
from gapsweep.analysis.datasets.timing import COSTS
from gapsweep.cli.main import commands
from gapsweep.continuation import dataset as continued
from gapsweep.model.labels import FAMILIES
from gapsweep.response.result import CLASS_FLAGS, KIND_FLAGS
from gapsweep.response.search import TRANSITIONS
from gapsweep.status import Status
from gapsweep.study.schema import (
    ATTRACTOR_VARIABLES,
    COORDINATES,
    N_ATTRACTORS,
    POINT_DIMS,
    VARIABLES,
)
from gapsweep.variables import CONTACT, COORDINATE, LAG, STATUS_FLAGS, Variable

_WIDTH = 80


def pages() -> dict[str, str]:
    """Text of every generated page, by name."""
    return {
        "coordinates": _table(("coordinate", "over", *_FACTS), _coordinates()),
        "responses": _table(("variable", "over", *_FACTS), _responses()),
        "attractors": _table(("variable", "over", *_FACTS), _attractors()),
        "agreement": _table(("variable", "over", "units", "meaning"), _agreement()),
        "timing": _table(("variable", "over", "units", "meaning"), _timing()),
        "static": _table(("variable", "over", *_FACTS), _static()),
        "histories": _table(("variable", "over", *_FACTS), _histories()),
        "branches": _table(("variable", "over", *_FACTS), _branches()),
        "risk": _table(("variable", "over", *_FACTS), _risk()),
        "fit": _table(("variable", "over", *_FACTS), _fit()),
        "flags": _table(("variable", "value", "meaning"), _flags()),
        "laws": _table(("label, as", "in Python", "force F_c(x)"), _laws()),
        "commands": "\n".join(_commands(commands, "gapsweep")),
    }


_FACTS = ("type", "units", "meaning")


def states() -> str:
    """States of the search for steady responses: function, and the states that may follow."""
    rows = (
        f"{state.name:15}{function:17}{' '.join(each.name for each in after)}\n"
        for state, (function, after) in TRANSITIONS.items()
    )
    return "".join(rows)


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    lines = [list(head), *([text.replace("|", r"\|") for text in row] for row in rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _row(name: str, over: Iterable[str], variable: Variable) -> tuple[str, ...]:
    return (f"`{name}`", ", ".join(over), variable.dtype, variable.units, variable.long_name)


def _laws() -> Iterator[tuple[str, ...]]:
    for law in FAMILIES.values():
        yield ", ".join(f"`{label}`" for label in law.examples), f"`{law.__name__}`", law.words


def _coordinates() -> Iterator[tuple[str, ...]]:
    return (_row(name, [dim], variable) for name, (dim, variable) in COORDINATES.items())


def _responses() -> Iterator[tuple[str, ...]]:
    return (_row(name, ["point", *_lists(v)], v) for name, v in VARIABLES.items())


def _attractors() -> Iterator[tuple[str, ...]]:
    yield _row("n_attractors", ["case"], N_ATTRACTORS)
    for name, variable in ATTRACTOR_VARIABLES.items():
        yield _row(name, ["case", "attractor", *_lists(variable)], variable)


def _lists(variable: Variable) -> Iterator[str]:
    """The dimensions within a point that an oscillator has."""
    return (dim for dim in variable.dims if dim not in (COORDINATE, CONTACT, LAG))


def _agreement() -> Iterator[tuple[str, ...]]:
    for name, metric in variables():
        over = ", ".join(metric.dims).replace(", ".join(POINT_DIMS), "point")
        yield f"`{name}`", over, metric.units, f"{metric.number}: {metric.long_name}"


def _timing() -> Iterator[tuple[str, ...]]:
    for name, (units, long_name) in COSTS.items():
        for statistic in ("mean", "median"):
            yield f"`{name}_{statistic}`", "case", units, f"{long_name}, {statistic}"
    yield "`n_points`", "case", "1", "sweep points measured"
    yield "`n_points_elsewhere`", "case", "1", "points of other machines"


def _static() -> Iterator[tuple[str, ...]]:
    for name, variable in static.CURVES.items():
        yield _row(name, ["case", "displacement"], variable)
    for name, variable in (static.SCENE_VARIABLES | static.FORCED_VARIABLES).items():
        yield _row(name, ["case"], variable)
    for name, variable in static.VISITED_VARIABLES.items():
        yield _row(name, ["K_c", "gap", "forcing"], variable)
    for name, variable in static.CONTACT_VARIABLES.items():
        yield _row(name, ["K_c", "gap"], variable)
    for name, variable in static.LIST_VARIABLES.items():
        yield _row(name, ["case", static.EQUILIBRIUM], variable)


def _histories() -> Iterator[tuple[str, ...]]:
    for name, variable in histories.SCENE.items():
        yield _row(name, ["history"], variable)
    for name, variable in {**histories.VARIABLES, **histories.AXES}.items():
        yield _row(name, variable.dims, variable)


def _branches() -> Iterator[tuple[str, ...]]:
    for name, variable in continued.VARIABLES.items():
        yield _row(name, [continued.BRANCH, continued.STEP, *_lists(variable)], variable)
    for name, variable in (continued.OF_BRANCH | continued.OF_CURVE).items():
        yield _row(name, [continued.BRANCH], variable)
    for name, (_, variable) in continued.OF_ATTRACTOR.items():
        yield _row(f"attractor_{name}", [continued.ATTRACTOR, *variable.dims], variable)
    for name, variable in branches.OF_STUDY.items():
        yield _row(name, variable.dims, variable)
    for name, variable in branch_agreement.VARIABLES.items():
        yield _row(name, [branch_agreement.MATCH], variable)


def _risk() -> Iterator[tuple[str, ...]]:
    for name, variable in (risk.RISK | risk.INDICES).items():
        yield _row(name, variable.dims, variable)


def _fit() -> Iterator[tuple[str, ...]]:
    for name, variable in fit_file.VARIABLES.items():
        yield _row(name, variable.dims, variable)


def _flags() -> Iterator[tuple[str, ...]]:
    known = (
        ("status", STATUS_FLAGS),
        ("response_class", CLASS_FLAGS),
        ("extremum_kind", KIND_FLAGS),
        ("special, curve_kind", continued.SPECIAL_FLAGS),
        ("begins, ends", continued.END_FLAGS),
    )
    for name, flags in known:
        for meaning, value in flags:
            failed = name == "status" and Status(value).failed
            yield f"`{name}`", str(value), f"{meaning}{' (failed)' if failed else ''}"


def _commands(command: click.Command, path: str) -> Iterator[str]:
    """A heading and the help of a command, and of all below it."""
    settings = commands.context_settings | {"terminal_width": _WIDTH}
    context = click.Context(command, info_name=path, **settings)
    yield f"## {path}\n\n```text\n{command.get_help(context)}\n```\n"
    for name, child in getattr(command, "commands", {}).items():
        yield from _commands(child, f"{path} {name}")
