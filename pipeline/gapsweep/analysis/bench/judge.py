"""Judgement of runs: deviations from independent solutions, and outcome.

A run fails with a status, is `right`, solves its own law with a result that differs from the exact
law's (`model_error`), or reports ok although its own law is not solved (`silent_wrong`).
Definitions: docs/reference/bench.md.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np

from gapsweep.analysis.bench.closed_forms import closed_form, energy_drift, plain_duffing
from gapsweep.analysis.bench.references import (
    NONE,
    TIGHT,
    References,
    Scale,
    ScenarioRun,
    distance,
    event_time_distance,
    gap_scale,
    growth,
    motion,
    reach_scale,
    references,
    settled,
)
from gapsweep.analysis.bench.scenarios import Scenario, law_or_none
from gapsweep.integrate.problem import Solver
from gapsweep.model.contact import ContactLaw
from gapsweep.model.labels import EXACT
from gapsweep.status import Status


class CellOutcome(IntEnum):
    """Outcome of a method's run on a scenario; files store its number."""

    NOT_REQUESTED = -1
    RIGHT = 0
    MODEL_ERROR = 1
    FAILED = 2
    UNDECIDED = 3
    SILENT_WRONG = 4


# Least number of steps in the bound of the error: a solver meets its tolerance in every step.
_FEW_STEPS = 100
# Deviation relative to the scale from which on a result is wrong [-].
WRONG = 1e-2
# Error of the references before the growth of disturbances [-].
_REFERENCE_ERROR = 1e-9
# Errors below this many distances of the two references cannot be measured.
FLOOR = 10.0
# Forcing periods by which scenarios of kind `phase` shift the initial time.
LATER = 10**6


def observed(scenario: Scenario, law: ContactLaw | None, solver: Solver) -> ScenarioRun:
    """The motion of a scenario; shifted in time for `phase`, mirrored and back for `mirror`."""
    if scenario.expected == "phase":
        return motion(scenario, law, solver, later=LATER)
    if scenario.expected == "mirror":
        return _negated(motion(_mirrored(scenario), law, solver))
    return motion(scenario, law, solver)


def _mirrored(scenario: Scenario) -> Scenario:
    oscillator = replace(scenario.oscillator, forcing=-scenario.oscillator.forcing)
    return replace(scenario, oscillator=oscillator, x_0=-scenario.x_0, v_0=-scenario.v_0)


def _negated(run: ScenarioRun) -> ScenarioRun:
    return replace(run, section=-run.section)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judge:
    """References of one law in one scenario, and the rules that compare runs with them."""

    scenario: Scenario
    law: ContactLaw | None  # None if the law cannot be built in this scenario
    # `own`, `exact`: reference solutions of the law and of the exact law.
    own: References
    exact: References
    scale: Scale
    growth: float  # largest growth of a disturbance [-]
    apart: float  # distance of the law's two references [-], before one may have been replaced

    def verdict(self, run: ScenarioRun, solver: Solver) -> dict[str, Any]:
        """Outcome, errors and counts of a run."""
        solver_error, total_error = self._errors(run, solver.engine)
        allowed = self._allowed(run, solver)
        limit = FLOOR * max(self.apart, self.exact.distance(self.scale))
        return {
            "outcome": self._outcome(run, solver_error, total_error, allowed, solver.rtol),
            "solver_error": solver_error,
            "total_error": total_error,
            "allowed_error": allowed,
            "at_reference_floor": total_error < limit,
            "bounded_error": max(total_error, limit) if total_error == total_error else math.nan,
            "event_time_error": event_time_distance(run, self.own.for_engine(solver.engine)),
            "model_error": distance(self.own.compiled, self.exact.compiled, self.scale),
            "reference_distance": self.apart,
            "growth": self.growth,
        } | {name: getattr(run, name) for name in COUNTED}

    def step_length(self, run: ScenarioRun) -> float:
        """Mean displacement in a step [m], from the scale of speeds; NaN without steps."""
        if not run.n_steps:
            return math.nan
        period = self.scenario.n_periods / self.scenario.omega
        return self.scale.speed * period / run.n_steps

    @property
    def _is_energy(self) -> bool:
        return self.scenario.expected == "energy" and self.law is not None

    def _errors(self, run: ScenarioRun, engine: str) -> tuple[float, float]:
        if not self._is_energy or self.law is None:
            own, exact = self.own.for_engine(engine), self.exact.for_engine(engine)
            return distance(run, own, self.scale), distance(run, exact, self.scale)
        if run.status is not Status.OK:
            return math.nan, math.nan
        own_drift, exact_drift = (
            float(np.max(np.abs(energy_drift(self.scenario, law)(run.section))))
            for law in (self.law, self.scenario.law(EXACT))
        )
        return own_drift, exact_drift

    def _allowed(self, run: ScenarioRun, solver: Solver) -> float:
        """Largest error of a run that meets its tolerance in every step."""
        steps = max(run.n_steps, _FEW_STEPS)
        tolerance = solver.rtol + (solver.atol or 0.0) / self.scale.length
        # Errors of energy do not grow; an error of both states counts about twice in energy.
        grown = 10.0 if self._is_energy else self.growth
        return max(tolerance * steps, _REFERENCE_ERROR) * grown

    def _outcome(
        self,
        run: ScenarioRun,
        solver_error: float,
        total_error: float,
        allowed: float,
        rtol: float,
    ) -> CellOutcome:
        if run.status is not Status.OK:
            return CellOutcome.FAILED
        survived = [motion.status is Status.OK for motion in (self.own.compiled, self.own.scipy)]
        if survived[0] != survived[1]:
            return CellOutcome.UNDECIDED
        # A law whose reference fails has no solution: a run with status ok is wrong.
        if not solver_error <= allowed:
            return CellOutcome.SILENT_WRONG
        # The error is large, but not larger than the tolerance times the growth.
        if solver_error > max(WRONG, 10.0 * rtol):
            return CellOutcome.UNDECIDED
        is_right = total_error <= max(WRONG, solver_error)
        return CellOutcome.RIGHT if is_right else CellOutcome.MODEL_ERROR


COUNTED = ("status", "n_contacts", "n_steps", "n_rejected", "nfev")


def judge(scenario: Scenario, representation: str, exact: Judge | None) -> Judge:
    """The judge of a law's runs; `exact` is the judge of the exact law (None: this is it)."""
    law = law_or_none(scenario, representation)
    answer = _references(scenario, representation, law)
    grown = math.nan
    if law is not None and answer.compiled.status is Status.OK:
        grown = float(growth(scenario, law, answer.compiled.section)[-1])
    if exact:
        scale = exact.scale
    elif scenario.expected:
        scale = reach_scale(scenario, answer.compiled)
    else:
        scale = gap_scale(scenario, answer.compiled.reach)
    apart = answer.distance(scale)
    is_compared = scenario.expected not in (None, "energy", "mirror")
    if is_compared and representation != EXACT:
        answer = settled(scenario, representation, answer, scale, _REFERENCE_ERROR * grown)
    return Judge(
        scenario=scenario,
        law=law,
        own=answer,
        exact=exact.own if exact else answer,
        scale=scale,
        growth=grown,
        apart=apart,
    )


def _references(scenario: Scenario, representation: str, law: ContactLaw | None) -> References:
    """Reference solutions of a law, from closed forms or symmetries if the scenario states them."""
    if scenario.expected == "energy":
        # The compiled motion gives the scale; errors are errors of the energy.
        run = motion(scenario, law, TIGHT["compiled"])
        return References(run, run)
    if representation != EXACT and scenario.expected == "mirror":
        # A fit may be uneven: the reference is the mirror image of the mirrored scenario.
        there = references(_mirrored(scenario), representation)
        return References(_negated(there.compiled), _negated(there.scipy))
    if representation != EXACT or scenario.expected not in ("duffing", "linear"):
        return references(scenario, representation)
    if scenario.expected == "linear":
        closed = closed_form(scenario)
        return References(closed, closed)
    plain, gap = references(plain_duffing(scenario), EXACT), scenario.gap
    touches = plain.compiled.reach > min(gap.j_1, gap.j_2) and gap.j_1 + gap.j_2 > 0
    # The stated answer is invalid if the motion without walls would reach one.
    return replace(plain, compiled=NONE) if touches else plain
