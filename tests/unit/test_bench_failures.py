"""Stability: wrong answers are seen, failures keep their status, invariants hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import brentq
from tests.builders.studies import PAPER
from tests.readers.figures import overlaps

import gapsweep as gs
from gapsweep.analysis.bench import cells
from gapsweep.analysis.bench.closed_forms import closed_form, contact_energy, energy_drift
from gapsweep.analysis.bench.judge import CellOutcome as Outcome
from gapsweep.analysis.bench.judge import judge, observed
from gapsweep.analysis.bench.references import motion
from gapsweep.analysis.bench.scenarios import scenarios
from gapsweep.analysis.bench.stability import stability
from gapsweep.execution.isolated import CallError
from gapsweep.integrate import compiled
from gapsweep.integrate.problem import Solver
from gapsweep.integrate.runge_kutta import representations
from gapsweep.model.equilibria import equilibria, linear_stiffness
from gapsweep.report.bench_figures import STATUS_LETTERS, atlas, worst
from gapsweep.report.inputs import Inputs
from gapsweep.report.sections.benchmarks import conclusions
from gapsweep.report.sections.benchmarks import stability as section_of
from gapsweep.status import Status

WORKFLOW = Path(__file__).parents[2] / "workflows" / "stability.toml"
SWEEP = {"representation": ["piecewise"], "K_c": [1.4e4], "gap": [[4e-4, 4e-4]], "omega": [7.0]}
HARD = {
    "name": "hard",
    "K_c": 1.4e6,
    "gap": [4e-4, 4e-4],
    "omega": 9.0,
    "expected": "reference",
    "horizon": 2,
}
FREE = {"zeta": 0.0, "forcing": 0.0}
RUNS_AWAY = {"K_c": 1.4e4, "oscillator": {"alpha": -7e9, "forcing": 4e3}, "horizon": 9}
RTOL = [1e-2, 1e-6, 1e-9]
LABELS = ("piecewise", "tanh-1e4", "poly-13")
SOLVER = Solver.of(rtol=1e-9, atol=1e-12)


def study_of(*tables, labels=("piecewise",), **more):
    methods = [{"label": label, "rtol": RTOL} for label in labels]
    bench = {"scene": list(tables), "method": methods}
    whole = {"study": {"name": "hard"}, "oscillator": PAPER, "sweep": [SWEEP], "bench": bench}
    return gs.Study.from_dict(whole | more)


def scene_of(**changes):
    return scenarios(study_of(HARD | changes), with_answer=True)[0]


def outcomes(*tables, labels=("piecewise",)):
    found = stability(study_of(*tables, labels=labels))
    return found["outcome"].transpose("scene", "method", "tolerance").values


# ---- Wrong answers --------------------


def test_engine_with_a_wrong_smooth_force_is_silent_and_wrong(monkeypatch):
    # At every tolerance, so that its tight solution is as wrong: scipy's is the witness.
    of_numbers = representations.of_numbers

    def broken(law, K_c, **others):
        return of_numbers(law, K_c=1.01 * K_c, **others)

    monkeypatch.setattr(representations, "of_numbers", broken)
    found = outcomes(HARD, labels=["arctan-1e6"])[0, 0]
    assert found.tolist()[1:] == [Outcome.SILENT_WRONG] * 2


@pytest.mark.parametrize("expected", ["reference", "phase", "mirror"])
def test_method_with_a_wrong_force_is_silent_and_wrong(expected, monkeypatch):
    def broken(scene, representation):
        return scene.law(representation).__class__(1.01 * scene.K_c, scene.gap)

    table = HARD | {"expected": expected, "omega": 8.0}
    assert outcomes(table).max() == Outcome.RIGHT
    monkeypatch.setattr(cells, "law_or_none", broken)
    found = stability(study_of(table))
    # A tolerance of a hundredth excuses it, finer ones do not.
    assert found["outcome"].values[0, 0, 1:].tolist() == [Outcome.SILENT_WRONG] * 2
    assert found.attrs["n_silent_wrong"] == 2
    assert (found["status"] == Status.OK).all()
    assert "hard piecewise 1e-09" in " ".join(conclusions(found).sentences)


def test_energy_that_leaks_is_silent_and_wrong(monkeypatch):
    table = HARD | {"oscillator": FREE, "start": [0.0, 0.05], "expected": "energy", "horizon": 10}
    assert outcomes(table)[0, 0, 1:].tolist() == [Outcome.RIGHT] * 2

    def damped(scene, law, solver):
        leaking = replace(scene.oscillator, zeta=1e-4)
        return motion(replace(scene, oscillator=leaking), law, solver)

    monkeypatch.setattr(cells, "observed", damped)
    assert outcomes(table)[0, 0, 1:].tolist() == [Outcome.SILENT_WRONG] * 2


@pytest.mark.extended
def test_model_error_is_the_models():
    found = outcomes(HARD, labels=["piecewise", "tanh-1e4", "tanh-1e9"])[0, :, 2]
    assert found.tolist() == [Outcome.RIGHT, Outcome.MODEL_ERROR, Outcome.RIGHT]


def test_fit_that_is_not_odd_is_no_fault_of_the_solver():
    table = HARD | {"expected": "mirror", "K_c": 1.4e4}
    [[tight]] = outcomes(table, labels=["ratpoly-5/5"])[..., 2]
    assert tight in (Outcome.RIGHT, Outcome.MODEL_ERROR)


@pytest.mark.parametrize(
    "table",
    [
        {"expected": "duffing", "gap": [0.0, 0.0]},
        {"expected": "duffing", "gap": [3e-3, 3e-3]},
        {"expected": "linear", "gap": [0.0, 0.0], "oscillator": {"alpha": 0.0}},
        {"expected": "linear", "K_c": 0.0, "oscillator": {"alpha": 0.0}},
        {"expected": "phase", "omega": 8.0, "K_c": 1.4e4},
        {"expected": "mirror", "omega": 12.0, "start": [1e-4, 0.01]},
        {"gap": [0.0, 8e-4]},
        {"gap": [1e-9, 1e-9]},
        {"K_c": 1e9, "horizon": 1},
        {"omega": 200.0, "horizon": 100},
        *(
            {"oscillator": FREE, "omega": 5.0, "start": [-4e-4 * (1.0 + depth), 0.0]}
            for depth in (1e-3, 1e-6, 1e-10, 1e-14, -1e-14, -1e-10, -1e-6, -1e-3)
        ),
    ],
    ids=str,
)
def test_the_exact_law_is_right_where_the_answer_is_known(table):
    assert outcomes(HARD | table)[0, 0, 1:].tolist() == [Outcome.RIGHT] * 2


def test_stated_answer_that_a_wall_spoils_decides_nothing():
    found = outcomes(HARD | {"expected": "duffing"})
    assert found[0, 0].tolist() == [Outcome.UNDECIDED] * 3


def test_reference_that_steps_over_a_layer_is_no_witness():
    graze = {"oscillator": FREE, "omega": 5.0, "start": [-0.40000000004e-3, 0.0]}
    found = stability(study_of(HARD | graze, labels=["tanh-1e9"]))
    assert found["reference_distance"] > 1e-7
    assert found["outcome"].values[0, 0].tolist()[1:] == [Outcome.RIGHT] * 2


def test_growth_excuses_loose_tolerances_only():
    unstable = {"K_c": 1.4e4, "omega": 14.0, "start": [-3.276477662115262e-3, 0.16400737822108036]}
    found = stability(study_of(HARD | unstable | {"horizon": 25}))
    assert float(found["growth"][0, 0]) > 1e4
    assert found["outcome"].values[0, 0, 2] == Outcome.RIGHT
    assert Outcome.SILENT_WRONG not in found["outcome"].values


# ---- Statuses --------------------


@pytest.mark.parametrize(
    ("representation", "changes", "status"),
    [
        ("piecewise", {"K_c": 1e35, "start": [5.0, 0.0]}, Status.STEP_UNDERFLOW),
        ("tanh-1e4", {"K_c": 1e35, "start": [5.0, 0.0]}, Status.STEP_UNDERFLOW),
        ("piecewise", RUNS_AWAY, Status.DIVERGED),
        ("tanh-1e4", RUNS_AWAY, Status.DIVERGED),
        ("poly-13", {"K_c": 1.4e4, "oscillator": {"forcing": 100.0}}, Status.OUT_OF_FIT_RANGE),
        ("ratpoly-7/5", {"K_c": 1.4e4, "start": [0.012, 0.0]}, Status.MODEL_INVALID),
    ],
)
def test_failures_keep_their_status(representation, changes, status):
    scene = scene_of(**changes)
    run = observed(scene, scene.law(representation), SOLVER)
    assert run.status is status
    answer = judge(scene_of(), "piecewise", None)
    assert answer.verdict(run, SOLVER)["outcome"] is Outcome.FAILED


def test_pole_in_the_way_is_model_invalid():
    law = gs.contact_law("ratpoly-7/5", 1.4e4, gs.Gap(4e-4, 4e-4))
    run = gs.simulate(gs.systems.paper_oscillator(), law, 9.0, 0.012, t_end=1.0)
    assert Status(run.status) is Status.MODEL_INVALID


def test_law_that_cannot_be_built_is_model_invalid():
    scene = scene_of(gap=[4e-4, 4e-4])
    assert observed(scene, None, SOLVER).status is Status.MODEL_INVALID


def test_chatter_is_a_failure_with_its_status(monkeypatch):
    scene = scene_of(gap=[1e-12, 1e-12], start=[0.0, 0.05])
    monkeypatch.setattr(compiled.batch, "MOST_SHORT", 0.0)
    run = observed(scene, scene.law("piecewise"), SOLVER)
    assert run.status is Status.CHATTER
    answer = judge(scene_of(), "tanh-1e4", judge(scene_of(), "piecewise", None))
    assert answer.verdict(run, SOLVER)["outcome"] is Outcome.FAILED


# ---- Invariants and closed forms --------------------


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12])
def test_energy_is_conserved_over_ten_thousand_contacts(rtol):
    scene = scene_of(oscillator=FREE, start=[0.0, 0.05], omega=1.0, horizon=105, expected="energy")
    law = scene.law("piecewise")
    run = motion(scene, law, Solver.of(rtol=rtol, atol=1e-3 * rtol))
    assert run.n_contacts > 10_000
    drift = np.abs(energy_drift(scene, law)(run.section))
    # No more than one tolerance per contact; nothing jumps.
    assert drift.max() < max(1e4 * rtol, 1e-9)
    assert np.abs(np.diff(drift)).max() < max(1e3 * rtol, 1e-10)


def test_contact_energy_is_that_of_the_spring():
    law = gs.Piecewise(1.4e6, gs.Gap(0.0, 8e-4))
    x = np.array([-1e-3, -1e-9, 0.0, 5e-4, 8.1e-4, 2e-3])
    beyond = np.array([-1e-3, -1e-9, 0.0, 0.0, 1e-5, 1.2e-3])
    assert_allclose(contact_energy(law, x), 0.5 * 1.4e6 * beyond**2, rtol=1e-12, atol=2e-15)


@pytest.mark.parametrize("K_c", [0.0, 3e4])
def test_closed_form_is_the_linear_motion(K_c):
    linear = {"oscillator": {"alpha": 0.0, "zeta": 0.1}, "expected": "linear"}
    scene = scene_of(**linear, K_c=K_c, gap=[0.0, 0.0], start=[1e-3, -0.02])
    run = gs.simulate(
        scene.oscillator, scene.law("piecewise"), 9.0, 1e-3, -0.02, t_end=2 / 9.0, engine="scipy",
        rtol=1e-12, atol=1e-15,
    )  # fmt: skip
    assert_allclose(closed_form(scene).section, run.section, rtol=1e-8)


@pytest.mark.parametrize(("K_c", "j"), [(1.4e6, 4e-4), (1.4e7, 4e-4), (1.4e6, 1.5e-3)])
def test_false_wells_of_tanh_vanish_above_the_threshold(K_c, j):
    oscillator, gap = gs.systems.paper_oscillator(), gs.Gap(j, j)

    def n_extra(log_epsilon):
        law = gs.Tanh(K_c, gap, 10.0**log_epsilon)
        return equilibria(oscillator, law, 4e-3).x.size - 1

    def springs(x):
        return linear_stiffness(oscillator) * x + oscillator.alpha * x**3

    rule = 0.139 * K_c / springs(j)
    assert n_extra(np.log10(0.9 * rule)) == 4  # a well and a saddle beside either wall
    assert n_extra(np.log10(1.1 * rule)) == 0
    threshold = 10.0 ** brentq(lambda e: n_extra(e) - 2.0, np.log10(0.9 * rule),
                               np.log10(1.1 * rule), xtol=1e-5)  # fmt: skip
    assert_allclose(threshold, rule, rtol=0.03)
    # The dip of the layer, 0.1392/ε deep, lies 0.639/ε before the wall: springs push less there.
    assert_allclose(threshold, 0.13923 * K_c / springs(j - 0.6392 / threshold), rtol=2e-3)


# ---- The atlas --------------------


@pytest.fixture(scope="module")
def mixed():
    strong = HARD | {"name": "strong", "K_c": 1.4e4, "oscillator": {"forcing": 100.0}, "horizon": 1}
    left_out = HARD | {"name": "without", "without": ["tanh-1e4"]}
    return stability(study_of(HARD, strong, left_out, labels=LABELS))


@pytest.mark.extended
def test_processes_compute_the_same_cells_as_this_one(mixed):
    here = stability(study_of(HARD, labels=LABELS))
    for name in here.data_vars:
        assert_array_equal(mixed[name].sel(scene=["hard"]), here[name])


def test_a_scenario_that_takes_too_long_is_timed_out_in_all_its_cells(monkeypatch):
    class Impatient:
        def __init__(self, timeout):
            assert timeout == 7.0

        __enter__, __exit__ = (lambda self: self), (lambda *_: None)

        def __call__(self, function, scenario, group):
            if scenario.name == "slow":
                raise CallError(Status.TIMED_OUT, "")
            return function(scenario, group)

    monkeypatch.setattr(cells, "Isolated", Impatient)
    slow = HARD | {"name": "slow", "without": ["tanh-1e4"]}
    found = stability(study_of(slow, HARD, labels=["piecewise", "tanh-1e4"]), timeout=7.0)
    assert (found["status"].sel(scene="hard") == Status.OK).all()
    lost = found.sel(scene="slow")
    assert (lost["status"][0] == Status.TIMED_OUT).all()
    assert (lost["outcome"][0] == Outcome.FAILED).all()
    assert (lost["status"][1] == Status.NOT_REQUESTED).all()
    assert atlas(found, tight=True).axes[0].texts[0].get_text() == "T"


def test_atlas_shows_the_worst_of_each_range(mixed):
    tight = worst(mixed, tight=True)
    assert tight.sel(scene="hard").values.tolist()[:2] == [Outcome.RIGHT, Outcome.MODEL_ERROR]
    assert tight.sel({"scene": "strong", "method": "poly-13"}) == Outcome.FAILED
    assert tight.sel({"scene": "without", "method": "tanh-1e4"}) == Outcome.NOT_REQUESTED
    spoilt = mixed.copy(deep=True)
    spoilt["outcome"][0, 0, 1] = Outcome.SILENT_WRONG
    spoilt["outcome"][0, 0, 2] = Outcome.FAILED
    assert worst(spoilt, tight=True)[0, 0] == Outcome.SILENT_WRONG
    assert worst(spoilt, tight=False)[0, 0] != Outcome.SILENT_WRONG


def test_atlas_has_a_letter_in_every_cell_and_no_overlaps(mixed):
    figure = atlas(mixed, tight=True)
    letters = [text.get_text() for text in figure.axes[0].texts]
    assert letters[:3] in (["R", "M", "M"], ["R", "M", "?"])
    assert letters[5] == "O"
    assert letters[7] == ""
    assert overlaps(figure) == []
    words = [text.get_text() for text in figure.legends[0].texts]
    legend = " ".join([*words, figure.axes[0].get_xlabel()])
    every = {*"RM?!", *STATUS_LETTERS.values()}
    assert {letter for letter in every if f" {letter}: " in f" {legend}"} == every


def test_false_wells_are_predicted(mixed):
    assert mixed["n_wells_exact"].values.tolist() == [1, 1, 1]
    assert mixed["n_wells"].sel({"scene": "hard", "method": "tanh-1e4"}) > 1
    assert mixed["n_wells"].sel({"scene": "hard", "method": "piecewise"}) == 1
    assert_allclose(mixed["in_gap_frequency"].sel({"scene": "hard", "method": "piecewise"}), 5.0)


def test_report_lists_scenes_and_laws(mixed):
    [part] = section_of(Inputs(mixed, mixed, stability=mixed))
    assert part.sentences[0].endswith(": 0.")
    assert [row[0] for row in part.tables[0].rows] == ["hard", "strong", "without"]
    assert len(part.figures) == 2


def test_the_workflow_has_the_hard_scenes():
    study = gs.Study.load(WORKFLOW)
    found = scenarios(study, with_answer=True)
    assert len(found) == len(study.spec.bench.scene)
    assert max(scene.K_c for scene in found) == 1e9
    assert {scene.expected for scene in found} == {
        "reference", "energy", "duffing", "linear", "phase", "mirror"
    }  # fmt: skip
