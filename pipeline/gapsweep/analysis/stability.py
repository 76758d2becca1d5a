"""Where methods fail: every method on hard scenes whose right answer is known.

Four things can come of a run. It ends with a status; it is `right`; it solves its own law but that
law's answer is not the exact one (`model_error`); or it says ok and has not even solved its own law
(`silent_wrong`), which no engine of ours may do at tight tolerances. Definitions: docs/bench.md.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.arrays import Array
from gapsweep.analysis.closed_forms import closed_form, energy_drift, plain_duffing
from gapsweep.analysis.force_error import in_gap
from gapsweep.analysis.scenes import (
    Method,
    Scene,
    coordinates,
    law_or_none,
    methods,
    scenes,
    tolerances,
)
from gapsweep.analysis.truth import (
    NONE,
    TIGHT,
    Motion,
    Scale,
    Truth,
    distance,
    growth,
    motion,
    reach_scale,
    settled,
    truth,
)
from gapsweep.execution.isolated import CallError, Isolated
from gapsweep.execution.progress import DEFAULT_TIMEOUT
from gapsweep.integrate.problem import Solver
from gapsweep.model.contact import ContactLaw
from gapsweep.model.equilibria import (
    equilibria,
    linear_stiffness,
    restoring_slope,
)
from gapsweep.model.labels import EXACT
from gapsweep.model.oscillator import Oscillator
from gapsweep.status import Status
from gapsweep.study.study import Study
from gapsweep.variables import STATUS_FLAGS, Variable, empty, with_attributes


class Outcome(IntEnum):
    """What came of a run; the order is part of the file."""

    NOT_REQUESTED = -1
    RIGHT = 0
    MODEL_ERROR = 1
    FAILED = 2
    UNDECIDED = 3
    SILENT_WRONG = 4


# A solver promises its tolerance for every step; a few steps are not held to that.
_FEW_STEPS = 100
# Share of the motion's reach from which on a deviation is one of the answer [-].
WRONG = 1e-2
# What the references themselves are good for, before disturbances grow.
_TRUTH = 1e-9
# Tolerances from which on a silent wrong answer is a fault.
TIGHT_RTOL = 1e-6
# Forcing periods by which a start is put off where its phase is looked at.
LATER = 10**6

_CELL = ("scene", "method", "tolerance")
_PAIR = ("scene", "method")
OUTCOME_FLAGS = tuple((outcome.name.lower(), int(outcome)) for outcome in Outcome)
VARIABLES = {
    "outcome": (
        _CELL,
        Variable("i1", "1", "what came of the run", Outcome.NOT_REQUESTED, OUTCOME_FLAGS),
    ),
    "status": (
        _CELL,
        Variable("i1", "1", "outcome of the motion", Status.NOT_REQUESTED, STATUS_FLAGS),
    ),
    "solver_error": (_CELL, Variable("f8", "1", "deviation from the same law's own answer")),
    "total_error": (_CELL, Variable("f8", "1", "deviation from the exact law's answer")),
    "allowed_error": (_CELL, Variable("f8", "1", "largest solver error that is not wrong")),
    "n_contacts": (_CELL, Variable("i8", "1", "wall crossings, in and out", 0)),
    "n_steps": (_CELL, Variable("i8", "1", "accepted steps", 0)),
    "layer_over_step": (
        _CELL,
        Variable("f8", "1", "thickness of the smoothing layer over the mean way of a step"),
    ),
    "reference_distance": (
        _PAIR,
        Variable("f8", "1", "distance of two independent tight solutions of the law"),
    ),
    "growth": (_PAIR, Variable("f8", "1", "largest growth of a disturbance of the start")),
    "n_equilibria": (_PAIR, Variable("i4", "1", "static equilibria of the law", 0)),
    "n_wells": (_PAIR, Variable("i4", "1", "stable equilibria of the law", 0)),
    "n_wells_exact": (("scene",), Variable("i4", "1", "stable equilibria of the exact law", 0)),
    "in_gap_frequency": (
        _PAIR,
        Variable("f8", "Hz", "frequency of small motions amid the gap, NaN on a hilltop"),
    ),
    "stiffness_ratio": (
        ("scene",),
        Variable("f8", "1", "stiffness in contact over that in the gap"),
    ),
    "n_periods": (("scene",), Variable("i4", "1", "forcing periods that are followed", 0)),
}


def stability(
    study: Study,
    say: Callable[[str], None] | None = None,
    timeout: float = DEFAULT_TIMEOUT,
) -> xr.Dataset | None:
    """What comes of every method on every scene whose right answer is stated.

    Parameters
    ----------
    study : Study
    say : callable, optional
        Told what is done next, for this takes minutes.
    timeout : float
        Time [s] that a method with a law of the user's own may take for a scene; it is alone in
        a process.

    Returns
    -------
    Dataset
        Over `scene`, `method` and `tolerance` (the rung of a method's ladder), `expected` over
        `scene`; None if the study has no such scene. Attribute `n_silent_wrong` counts those at
        rtol 1e-6 or tighter.
    """
    found, ladder = scenes(study, with_answer=True), methods(study)
    if not found:
        return None
    sizes = {
        "scene": len(found),
        "method": len(ladder),
        "tolerance": max(len(method.rungs) for method in ladder),
    }
    arrays = empty(VARIABLES, sizes)
    with Isolated(timeout) as alone:
        for s, scene in enumerate(found):
            if say is not None:
                say(f"stability: scene {s + 1} of {len(found)}, {scene.name}")
            for (m, r), values in _scene_values(scene, ladder, alone):
                for name, value in values.items():
                    arrays[name][(s, m, r)[: arrays[name].ndim]] = value
    rtol = tolerances(ladder)
    tight = rtol["rtol"][1] <= TIGHT_RTOL * (1.0 + 1e-12)
    silent = (arrays["outcome"] == Outcome.SILENT_WRONG) & tight
    stated = [scene.expected for scene in found]
    coords = coordinates(found, ladder) | rtol
    coords["expected"] = ("scene", stated, {"units": "1", "long_name": "known right answer"})
    return xr.Dataset(
        with_attributes(VARIABLES, arrays),
        coords,
        {
            **study.attributes,
            "n_silent_wrong": int(np.sum(silent)),
            "tight_rtol": TIGHT_RTOL,
            "wrong": WRONG,
        },
    )


def _scene_values(
    scene: Scene, ladder: list[Method], alone: Isolated
) -> Iterator[tuple[tuple[int, int], dict[str, Any]]]:
    """Everything about one scene, by method and rung."""
    judges: dict[str, Judge] = {}
    for m, method in enumerate(ladder):
        if method.label in scene.without:
            continue
        if ":" not in method.representation:
            of_rungs = _method_values(scene, method, judges)
        else:
            try:
                of_rungs = alone(_method_values, scene, method, {})
            except CallError as lost:
                failed = {"status": lost.status, "outcome": Outcome.FAILED}
                of_rungs = [failed] * len(method.rungs)
        yield from (((m, r), values) for r, values in enumerate(of_rungs))


# ---- The run, and what it should be ------------------------------------------------------


def observed(scene: Scene, law: ContactLaw | None, solver: Solver) -> Motion:
    """The motion, run as the scene's known answer asks."""
    if scene.expected == "phase":
        return motion(scene, law, solver, later=LATER)
    if scene.expected == "mirror":
        return _negated(motion(_mirrored(scene), law, solver))
    return motion(scene, law, solver)


def _mirrored(scene: Scene) -> Scene:
    oscillator = replace(scene.oscillator, forcing=-scene.oscillator.forcing)
    return replace(scene, oscillator=oscillator, x_0=-scene.x_0, v_0=-scene.v_0)


def _negated(run: Motion) -> Motion:
    return replace(run, section=-run.section)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judge:
    """What runs of one law in one scene are held against.

    Attributes
    ----------
    own, exact : Truth
        Right answers of the law itself and of the exact one.
    scale : Scale
    growth : float
        Largest growth of a disturbance [-].
    energies : (callable, callable) or None
        Energy [J] of states ``(x, v)`` by the law itself and by the exact one, where it is what
        must not change.
    period : float
        Length of the motion [s].
    apart : float
        Distance of the law's two references [-], also if one of them has been dropped.
    """

    own: Truth
    exact: Truth
    scale: Scale
    growth: float
    energies: tuple[Callable[[Array], Array], Callable[[Array], Array]] | None
    period: float
    apart: float

    def verdict(self, run: Motion, solver: Solver) -> dict[str, Any]:
        """Outcome, errors and counts of a run."""
        solver_error, total_error = self._errors(run, solver.engine)
        allowed = self._allowed(run, solver)
        return {
            "outcome": self._outcome(run, solver_error, total_error, allowed, solver.rtol),
            "status": run.status,
            "solver_error": solver_error,
            "total_error": total_error,
            "allowed_error": allowed,
            "n_contacts": run.n_contacts,
            "n_steps": run.n_steps,
            "reference_distance": self.apart,
            "growth": self.growth,
        }

    def way(self, run: Motion) -> float:
        """Mean way of a step [m]."""
        if not run.n_steps:
            return math.nan
        return self.scale.speed * self.period / run.n_steps

    def _errors(self, run: Motion, engine: str) -> tuple[float, float]:
        if self.energies is None:
            own, exact = self.own.for_engine(engine), self.exact.for_engine(engine)
            return distance(run, own, self.scale), distance(run, exact, self.scale)
        if run.status is not Status.OK:
            return math.nan, math.nan
        drifts = (energy(run.section) for energy in self.energies)
        own_drift, exact_drift = (float(np.max(np.abs(drift))) for drift in drifts)
        return own_drift, exact_drift

    def _allowed(self, run: Motion, solver: Solver) -> float:
        """Largest error of a run that keeps its tolerance in every step."""
        steps = max(run.n_steps, _FEW_STEPS)
        tolerance = solver.rtol + solver.atol / self.scale.length
        # Nothing makes energy grow; an error of both states counts about twice in it.
        grown = 10.0 if self.energies is not None else self.growth
        return max(tolerance * steps, _TRUTH) * grown

    def _outcome(
        self, run: Motion, solver_error: float, total_error: float, allowed: float, rtol: float
    ) -> Outcome:
        if run.status is not Status.OK:
            return Outcome.FAILED
        survived = [motion.status is Status.OK for motion in (self.own.compiled, self.own.scipy)]
        if survived[0] != survived[1]:
            return Outcome.UNDECIDED
        # A law whose own solution fails has no answer; to come through it is to be wrong.
        if not solver_error <= allowed:
            return Outcome.SILENT_WRONG
        # As large as an answer, and yet no larger than the tolerance grown by the motion.
        if solver_error > max(WRONG, 10.0 * rtol):
            return Outcome.UNDECIDED
        return Outcome.RIGHT if total_error <= max(WRONG, solver_error) else Outcome.MODEL_ERROR


def _method_values(scene: Scene, method: Method, judges: dict[str, Judge]) -> list[dict[str, Any]]:
    """What came of a method on a scene, rung by rung; `judges` gains those that were missing."""
    if EXACT not in judges:
        judges[EXACT] = judge(scene, EXACT, None)
    if method.own not in judges:
        judges[method.own] = judge(scene, method.own, judges[EXACT])
    own = judges[method.own]
    law = law_or_none(scene, method.representation)
    predicted = predictors(scene, law)
    found = []
    for solver in method.rungs:
        run = observed(scene, law, solver)
        layer = {"layer_over_step": (math.nan if law is None else law.layer) / own.way(run)}
        found.append(own.verdict(run, solver) | predicted | layer)
    return found


def judge(scene: Scene, representation: str, exact: Judge | None) -> Judge:
    """The judge of a law's runs; `exact` is that of the exact law, None for itself."""
    law = law_or_none(scene, representation)
    energies = None
    if scene.expected == "energy" and law is not None:
        energies = energy_drift(scene, law), energy_drift(scene, scene.law(EXACT))
    answer = _truth(scene, representation, law)
    scale = exact.scale if exact else reach_scale(scene, answer.compiled)
    grown = math.nan
    if law is not None and answer.compiled.status is Status.OK:
        grown = float(growth(scene, law, answer.compiled.section)[-1])
    apart = answer.distance(scale)
    if scene.expected not in ("energy", "mirror") and representation != EXACT:
        answer = settled(scene, representation, answer, scale, _TRUTH * grown)
    return Judge(
        own=answer,
        exact=exact.own if exact else answer,
        scale=scale,
        growth=grown,
        energies=energies,
        period=scene.n_periods / scene.omega,
        apart=apart,
    )


def _truth(scene: Scene, representation: str, law: ContactLaw | None) -> Truth:
    """The right answer of a law; of the exact one, by what the scene knows better than any run."""
    if scene.expected == "energy":
        # The compiled motion gives the scale; what counts is the energy.
        run = motion(scene, law, TIGHT["compiled"])
        return Truth(run, run)
    if representation != EXACT and scene.expected == "mirror":
        # A fit need not be odd: its own image is that of the mirrored scene.
        there = truth(_mirrored(scene), representation)
        return Truth(_negated(there.compiled), _negated(there.scipy))
    if representation != EXACT or scene.expected not in ("duffing", "linear"):
        return truth(scene, representation)
    if scene.expected == "linear":
        closed = closed_form(scene)
        return Truth(closed, closed)
    plain = truth(plain_duffing(scene), EXACT)
    touches = plain.reach > min(scene.gap.j_1, scene.gap.j_2) and scene.gap.j_1 + scene.gap.j_2 > 0
    # The stated answer is none if the plain motion would reach a wall.
    return replace(plain, compiled=NONE) if touches else plain


# ---- What could have been known before -----------------------------------------------------


def predictors(scene: Scene, law: ContactLaw | None) -> dict[str, Any]:
    """Static equilibria, in-gap frequency and stiffness ratio: no integration is needed."""
    exact = equilibria(scene.oscillator, scene.law(EXACT), scene.fit_range)
    k = linear_stiffness(scene.oscillator)
    found: dict[str, Any] = {
        "n_wells_exact": int(np.sum(exact.stable)),
        "stiffness_ratio": (k + scene.K_c) / k,
        "n_periods": scene.n_periods,
    }
    if law is None:
        return found
    balance = equilibria(scene.oscillator, law, scene.fit_range)
    return found | {
        "n_equilibria": balance.x.size,
        "n_wells": int(np.sum(balance.stable)),
        "in_gap_frequency": _in_gap_frequency(scene.oscillator, law, scene.fit_range),
    }


def _in_gap_frequency(oscillator: Oscillator, law: ContactLaw, x_max: float) -> float:
    low, high = in_gap(law.gap, x_max)
    plain = replace(oscillator, alpha=0.0)
    stiffness = float(restoring_slope(plain, law, 0.5 * (low + high)))
    return math.sqrt(stiffness / oscillator.mass) / (2.0 * math.pi) if stiffness > 0 else math.nan
