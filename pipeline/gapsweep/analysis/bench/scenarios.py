"""The scenarios and methods of a study's ``[bench]``, as values to compute with."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Solver
from gapsweep.model.contact import ContactLaw
from gapsweep.model.labels import EXACT, NOT_LOCATED, Representation, contact_law
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.model.own_law import OwnLaw
from gapsweep.study.bench_tables import BenchSceneTable
from gapsweep.study.points import canonical
from gapsweep.study.schema import COORDINATES
from gapsweep.study.study import Study
from gapsweep.variables import Variable

COORDS = {name: COORDINATES[name][1] for name in ("K_c", "j_1", "j_2", "omega", "x_0", "v_0")}
_GAP = COORDINATES["gap"][1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A benchmark scenario: one motion that all methods compute."""

    name: str
    oscillator: Oscillator
    K_c: float  # contact stiffness [N/m]
    gap: Gap
    omega: float  # forcing frequency [Hz]
    x_0: float  # initial state [m], [m/s]
    v_0: float
    n_periods: int  # forcing periods of the motion
    expected: str | None  # kind of the known solution; None for work-precision
    fit_range: float  # half-width of the range of fits [m]
    without: tuple[str, ...]  # labels of methods that do not compute it
    own: Mapping[str, OwnLaw] = field(default_factory=dict, compare=False)  # user laws by label

    def law(self, representation: str) -> ContactLaw:
        """The contact law of a label without protocol.

        Raises `ModelError` if it cannot be built for this scenario.
        """
        if representation in self.own:
            return self.own[representation].law(self.K_c, self.gap)
        return contact_law(representation, self.K_c, self.gap, self.fit_range)


@dataclass(frozen=True, slots=True)
class Method:
    """A representation and its solvers, one for each of its tolerances (rungs)."""

    label: Representation
    rungs: tuple[Solver, ...]

    @property
    def own(self) -> Representation:
        """The law that the method solves: the exact law also for piecewise-noevents."""
        return EXACT if self.label.law == NOT_LOCATED else self.label.law


def scenarios(study: Study, *, with_answer: bool) -> list[Scenario]:
    """The scenarios of a study that state a known solution, or those that do not."""
    bench = study.spec.bench
    tables = bench.scene if bench else []
    wanted = [table for table in tables if (table.expected is not None) == with_answer]
    return [_scenario(study, table) for table in wanted]


def _scenario(study: Study, table: BenchSceneTable) -> Scenario:
    assert study.spec.bench is not None
    assert study.spec.oscillator is not None
    x_0, v_0 = table.start
    j_1, j_2 = table.gap
    return Scenario(
        name=table.name,
        oscillator=Oscillator(**table.merged(study.spec.oscillator).model_dump()),
        K_c=canonical(table.K_c),
        gap=Gap(canonical(j_1), canonical(j_2)),
        omega=canonical(table.omega),
        x_0=x_0,
        v_0=v_0,
        n_periods=table.horizon or study.spec.bench.horizon,
        expected=table.expected,
        fit_range=study.spec.approximation.range,
        without=tuple(table.without),
        own=dict(_own_laws(study)),
    )


def _own_laws(study: Study) -> Iterator[tuple[str, OwnLaw]]:
    """Label and law of the user laws of a study that can be loaded."""
    for label in study.own_laws:
        with suppress(ModelError):
            if (own := study.own_law(label)) is not None:
                yield label, own


def methods(study: Study) -> list[Method]:
    """The methods of a study, each with its solvers, the loosest tolerance first."""
    tables = study.spec.bench.method if study.spec.bench else []
    return [
        Method(
            table.label,
            tuple(replace(study.solver(table.label), rtol=r, atol=a) for r, a in table.rungs),
        )
        for table in tables
    ]


def law_or_none(scenario: Scenario, representation: str) -> ContactLaw | None:
    """The contact law of a label; None if it cannot be built for this scenario."""
    try:
        return scenario.law(representation)
    except ModelError:
        return None


def coordinates(scenarios: Sequence[Scenario], methods: Sequence[Method]) -> dict[str, Any]:
    """Coordinates of a dataset over scenarios and methods."""
    gaps = [scenario.gap for scenario in scenarios]
    columns = {
        name: [getattr(each, name) for each in (gaps if name in ("j_1", "j_2") else scenarios)]
        for name in COORDS
    }
    named = {"units": "1", "long_name": "name of the scenario"}
    label = {"units": "1", "long_name": "representation, with its solver protocol"}
    return {
        "scene": ("scene", [scenario.name for scenario in scenarios], named),
        "method": ("method", [method.label for method in methods], label),
        "gap": ("scene", [gap.label for gap in gaps], _GAP.attributes),
        **{name: ("scene", columns[name], COORDS[name].attributes) for name in COORDS},
    }


def tolerances(methods: Sequence[Method]) -> dict[str, Any]:
    """Coordinates ``rtol`` and ``atol`` over method and rung; NaN beyond a method's last rung."""
    n_rungs = max(len(method.rungs) for method in methods)
    found = {}
    for name, units in (("rtol", "1"), ("atol", "m")):
        values = np.full((len(methods), n_rungs), np.nan)
        for m, method in enumerate(methods):
            values[m, : len(method.rungs)] = [getattr(solver, name) for solver in method.rungs]
        kind = "relative" if name == "rtol" else "absolute"
        attributes = Variable("f8", units, f"{kind} tolerance").attributes
        found[name] = (("method", "tolerance"), values, attributes)
    return found
