"""No more model than a scene needs: bounds that hold, models that are adequate, `auto`."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import quad
from tests.builders.cache import point
from tests.builders.datasets import tables
from tests.builders.studies import PAPER, TOML

import gapsweep as gs
from gapsweep.analysis.datasets.contact_errors import ADEQUATE, expected_range
from gapsweep.analysis.datasets.recommendations import advice, sentences
from gapsweep.cli.main import FAULT, FINISHED, exit_code
from gapsweep.model.systems import paper_oscillator
from gapsweep.study.least_model import Model, advise

GAP = gs.Gap(0.4e-3, 0.4e-3)
LAW = gs.Piecewise(1.4e4, GAP)

oscillators = st.builds(
    gs.Oscillator,
    zeta=st.floats(0.01, 0.5) | st.floats(0.9, 3.0),
    omega_n=st.floats(3.0, 8.0),
    mass=st.floats(1.0, 5.0),
    alpha=st.floats(-1e9, 1e9),
    forcing=st.floats(0.1, 10.0),
)
frequencies = st.floats(0.5, 40.0)
starts = st.tuples(st.floats(-3e-4, 3e-4), st.floats(-0.02, 0.02))


@given(oscillators, frequencies, starts)
def test_no_motion_leaves_its_bound(oscillator, omega, start):
    far = gs.Gap(1e-3, 1e-3)
    found = advise(oscillator, gs.Piecewise(1.4e5, far), omega, start)
    if found.model is Model.EXACT:
        return
    (bound,) = found.bound
    assert abs(start[0]) <= bound < 1e-3
    law = gs.Piecewise(1.4e5, far)
    run = gs.simulate(oscillator, law, omega, *start, t_end=20.0 / omega + 3.0)
    assert run.n_contacts == 0
    assert np.max(np.abs(run.extrema), initial=abs(start[0])) <= bound * (1 + 1e-6)


@given(oscillators, frequencies)
def test_linear_scenes_meet_the_error(oscillator, omega):
    found = advise(oscillator, gs.Piecewise(1e5, GAP), omega, error=1e-2)
    if found.model is not Model.LINEAR:
        return
    assert found.oscillator.alpha == 0.0
    least = gs.respond(found.oscillator, found.law, omega, rtol=found.rtol)
    exact = gs.respond(oscillator, gs.Piecewise(1e5, GAP), omega)
    assert abs(least.amplitude - exact.amplitude) <= 1e-2 * max(exact.amplitude, 0.4e-3)


def test_gain_of_the_cubic_spring_is_the_integral_of_the_impulse_response():
    # One scene whose bound is known in closed form but for that integral.
    oscillator = paper_oscillator(zeta=0.1, forcing=0.0)
    natural = oscillator.omega_n_rad
    damped = natural * math.sqrt(1 - 0.1**2)
    pieces = [
        quad(lambda t: math.exp(-0.1 * natural * t) * abs(math.sin(damped * t)) / damped, a, b)[0]
        for a, b in zip(*(np.arange(n, 200 + n) * math.pi / damped for n in (0, 1)), strict=True)
    ]
    share = sum(pieces) * oscillator.alpha / oscillator.mass
    (bound,) = advise(oscillator, LAW, 5.0, (1e-4, -0.1 * natural * 1e-4)).bound
    assert_allclose(bound, 1e-4 + share * bound**3, rtol=1e-9)  # the envelope begins at 1e-4


@pytest.mark.parametrize(
    ("oscillator", "start"),
    [
        (paper_oscillator(zeta=0.0), (0.0, 0.0)),  # the cubic spring may pump without end
        (paper_oscillator(zeta=1.5), (4.1e-4, 0.0)),
        (paper_oscillator(zeta=0.0, omega_n=20.0, alpha=0.0), (0.0, 0.0)),  # resonance
        (paper_oscillator(), (5e-4, 0.0)),
        (paper_oscillator(), None),
        (paper_oscillator(mass=1e49, omega_n=1e3), (0.0, 0.0)),  # too stiff for a system
    ],
)
def test_nothing_is_left_out_where_nothing_is_certain(oscillator, start):
    found = advise(oscillator, LAW, 20.0, start)
    assert (found.model, found.bound, found.law) == (Model.EXACT, (math.inf,), LAW)


def masses(draw, n):
    """A chain of masses, springs and one damper to the ground, which couples the modes."""
    rng = np.random.default_rng(draw)
    k = rng.uniform(500.0, 3000.0, n + 1)
    stiffness = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    damping = np.zeros((n, n))
    damping[0, 0] = rng.uniform(20.0, 200.0)
    amplitude = rng.uniform(-4.0, 4.0, n)
    return gs.System(
        mass=np.diag(rng.uniform(1.0, 4.0, n)), stiffness=stiffness, damping=damping,
        contacts={"first": np.eye(n)[0], "between": [1.0, -1.0] + [0.0] * (n - 2)},
        cubic=[gs.Cubic(along=[1.0, -1.0] + [0.0] * (n - 2), alpha=10.0 ** rng.uniform(6.0, 9.0))],
        forcing=[
            gs.Harmonic(amplitude=amplitude),
            gs.Harmonic(amplitude=amplitude[::-1], k=3, phase=1.0),
            gs.Harmonic(amplitude=0.3 * amplitude, k=0),
        ],
    )  # fmt: skip


@given(st.integers(0, 10**6), st.sampled_from([2, 3]), st.floats(1.0, 40.0))
@settings(max_examples=25)
def test_no_motion_of_several_masses_leaves_its_bound(draw, n, omega):
    system, law = masses(draw, n), gs.Piecewise(1.4e5, gs.Gap(1e-2, 1e-2))
    start = 1e-3 * np.random.default_rng(draw).uniform(-1.0, 1.0, 2 * n)
    found = gs.advise(system, law, omega, start)
    if found.model is Model.EXACT:
        return
    run = gs.simulate(
        system, law, omega, q_0=start[:n], v_0=start[n:], n_periods=30, dense_output=True
    )
    assert run.n_contacts == 0
    q = run.sample(np.linspace(0.0, run.t_end, 4000))[0]
    for along, bound in zip(system.directions, found.bound, strict=True):
        assert np.abs(q @ along).max() <= bound * (1 + 1e-6)


@pytest.mark.parametrize("omega", [3.0, 5.0 / 3.0, 20.0])
def test_no_motion_under_a_switched_force_leaves_its_bound(omega):
    """Its third harmonic may be at resonance, where a cosine of the same peak is far from it."""
    force = gs.Switched([0.0, 0.25, 0.75], [1.0, -1.0, 1.0])
    oscillator = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.05, forcing=force, alpha=1e6)
    law, start = gs.Piecewise(1.4e5, gs.Gap(9e-3, 9e-3)), (1e-4, 0.0)
    found = gs.advise(oscillator, law, omega, start)
    assert found.model is not Model.EXACT
    run = gs.simulate(oscillator, law, omega, *start, n_periods=30)
    assert np.abs(run.extrema).max() <= found.bound[0]
    cosine = gs.advise(replace(oscillator, wave=None), law, omega, start)
    assert cosine.bound[0] < found.bound[0]


def test_one_mode_of_two_masses_has_the_bound_of_an_oscillator():
    """Two equal masses that move alike: one oscillator with twice the mass, spring and load."""
    one = gs.Oscillator(mass=6.0, omega_n=5.0, zeta=0.05, forcing=0.8, alpha=2e8)
    k, c = 3.0 * one.omega_n_rad**2, 0.1 * 3.0 * one.omega_n_rad
    pair = gs.System(
        mass=3.0 * np.eye(2), stiffness=[[2 * k, -k], [-k, 2 * k]], damping=c * np.eye(2),
        contacts={"wall": [0.5, 0.5]}, cubic=[gs.Cubic(along=[0.5, 0.5], alpha=2e8)],
        forcing=[gs.Harmonic(amplitude=[0.4, 0.4])],
    )  # fmt: skip
    found = gs.advise(pair, LAW, 8.0, [1e-4, 1e-4, 0.0, 0.0], error=1e-8)
    alike = gs.advise(one, LAW, 8.0, (1e-4, 0.0), error=1e-8)
    assert found.model is alike.model is Model.DUFFING
    assert_allclose(found.bound, alike.bound, rtol=1e-12)


def test_overdamped_motions_have_bounds_too():
    """A start that creeps back decays from where it is; forces of one sign add up to the static."""
    oscillator = paper_oscillator(zeta=2.0, alpha=0.0, forcing=0.0)
    assert advise(oscillator, LAW, 5.0, (3e-4, 0.0)).bound == pytest.approx([3e-4])
    static = paper_oscillator(zeta=2.0, forcing=0.0)
    (bound,) = advise(static, LAW, 5.0, (3e-4, 0.0)).bound
    stiffness = static.mass * static.omega_n_rad**2
    assert_allclose(bound, 3e-4 + static.alpha * bound**3 / stiffness, rtol=1e-9)


def test_a_wall_at_the_origin_is_always_reached():
    assert (
        advise(paper_oscillator(), gs.Piecewise(1.4e4, gs.Gap(0.0, 0.8e-3)), 30.0).model
        is Model.EXACT
    )


def rms_by_sums(law, low, high):
    """RMS force error [N] by the trapezoidal rule on points graded to the walls."""
    steps = np.geomspace(1e-14, 2.0 * (high - low), 20_001)
    near = np.add.outer([-law.gap.j_1, law.gap.j_2], [*-steps, 0.0, *steps]).ravel()
    x = np.union1d(np.clip(near, low, high), np.linspace(low, high, 20_001))
    below, above = np.minimum(x + law.gap.j_1, 0.0), np.maximum(x - law.gap.j_2, 0.0)
    error = law.force(x) - law.K_c * (law.K_ratio * below + above)
    return math.sqrt(np.trapezoid(error**2, x) / (high - low))


@pytest.mark.parametrize("label", ["tanh-1e4", "arctan-1e6", "logarctan-1e5", "poly-13"])
@pytest.mark.parametrize("gap", [GAP, gs.Gap(0.0, 0.8e-3)])
def test_force_error_over_the_forcing_and_the_parameter_it_needs(label, gap):
    """Of the named parameter the error is at most the limit, of a smaller one above it."""
    visited = (-1.1e-3, 2.3e-3)
    is_fit = label.startswith("poly")
    walls = (140.0 if is_fit else 1.4e3), gap
    law = gs.contact_law(label, *walls, K_ratio=0.4)
    found = gs.static_error(law, visited, forcing=-4.0)
    assert_allclose(found.force_error, rms_by_sums(law, *visited) / 4.0, rtol=1e-5)
    assert found.force_error == found.rmse / 4.0
    family = label.partition("-")[0]
    errors = [
        rms_by_sums(gs.contact_law(f"{family}-{value:g}", *walls, K_ratio=0.4), *visited) / 4.0
        for value in (found.needed, found.needed - 1 if is_fit else 0.9 * found.needed)
    ]
    assert errors[0] <= ADEQUATE * (1 + 1e-5) < errors[1]


def test_force_error_needs_a_forcing_and_a_law_with_a_parameter():
    tanh = gs.Tanh(1.4e4, GAP, 1e4)
    assert np.isnan(gs.static_error(tanh)[2:]).all()
    error = gs.static_error(tanh, forcing=0.0)
    assert math.isinf(error.force_error)
    assert math.isnan(error.needed)
    assert gs.static_error(gs.Piecewise(1.4e4, GAP), forcing=4.0)[2] == 0.0
    hard = gs.Polynomial(1.4e6, GAP, 13)
    assert math.isnan(gs.static_error(hard, forcing=4.0).needed)


def test_expected_range_is_that_of_the_main_resonance():
    """In closed form without contact; with contact, that of a sweep through the resonance."""
    linear = gs.Oscillator(mass=2.0, omega_n=3.0, zeta=0.05, forcing=0.5)
    peak = 0.5 / (2.0 * 0.05 * 2.0 * linear.omega_n_rad**2)
    for gap in (gs.Gap(1.0, 2.0), gs.Gap(0.1 * peak, 0.2 * peak)):
        free = gs.Piecewise(0.0, gap)
        assert_allclose(expected_range(linear, free), [-peak, peak], rtol=1e-2)
    wall = gs.Piecewise(2e4, gs.Gap(0.1 * peak, 0.3 * peak))
    omega = np.linspace(2.0, 12.0, 101)
    swept = [gs.respond(linear, wall, omega, x_0=x * peak) for x in (0.0, 0.5)]
    low = min(one.x_min.min() for one in swept)
    high = max(one.x_max.max() for one in swept)
    expected = expected_range(linear, wall)
    assert expected[0] <= low
    assert expected[1] >= high
    assert expected[1] - expected[0] <= 1.6 * (high - low)
    undamped = gs.Oscillator(mass=2.0, omega_n=3.0, zeta=0.0, forcing=0.5)
    assert expected_range(undamped, wall, 7e-3) == (-7e-3, 7e-3)


@pytest.mark.parametrize(("zeta", "forcing"), [(1.0, 4.0), (2.0, 10.0)])
def test_expected_range_includes_slow_motions_of_strong_damping(zeta, forcing):
    oscillator, law = paper_oscillator(zeta=zeta, forcing=forcing), gs.Piecewise(1.4e4, GAP)
    slow = gs.respond(oscillator, law, 0.1)
    assert_allclose(expected_range(oscillator, law), (slow.x_min, slow.x_max), rtol=0.01)


def test_a_fit_that_does_not_reach_the_walls_is_left_out():
    study = tables(["piecewise", "auto", "poly-13"], [6.0])
    study["sweep"][0]["gap"] = [[0.4e-3, 0.4e-3], [5e-3, 5e-3]]  # the default range is 4 mm
    found = advice(gs.Study.from_dict(study)).sel(approximation="poly-13")
    assert np.isfinite(found.force_error.values.ravel()).tolist() == [True, False]


@pytest.mark.parametrize("error", [0.0, 1e-12, 0.5, math.nan])
def test_absurd_errors_are_refused(error):
    with pytest.raises(gs.ModelError, match="error"):
        advise(paper_oscillator(), LAW, 5.0, error=error)


AUTO = {
    "study": {"name": "least"},
    "oscillator": PAPER,
    "sweep": [
        {
            "representation": ["piecewise", "auto"],
            "K_c": [1.4e4],
            "gap": [[0.4e-3, 0.4e-3]],
            "omega": [7.0, 12.0, 24.0, 30.0],
        }
    ],
}


@pytest.mark.extended
def test_auto_meets_its_error_and_says_what_it_chose(client, tmp_path):
    study = gs.Study.from_dict(AUTO)
    out, cache = tmp_path / "out", tmp_path / "cache"
    found = gs.run(study, client, out=out, cache=cache).isel(K_c=0, gap=0, initial_condition=0)
    exact, least = (found["amplitude"].sel(representation=r) for r in ("piecewise", "auto"))
    assert (abs(least - exact) <= 1e-3 * np.maximum(exact, 0.4e-3)).all()
    with gs.open(out / "advice.nc") as chosen:
        model = chosen["model"].isel(K_c=0, gap=0, initial_condition=0)
        assert model.values.tolist() == [Model.EXACT, Model.EXACT, Model.DUFFING, Model.LINEAR]
        assert (chosen["bound"].values[..., 2:, :] < 0.4e-3).all()
    page = (out / "report" / "index.html").read_text()
    assert "2 exact, 1 duffing, 1 linear" in page


def test_auto_shares_the_points_that_it_chooses():
    study = gs.Study.from_dict(AUTO)
    chosen = point(study, 1, 0, 0, 0, 0)
    assert (chosen.kind.representation, chosen.column("K_c")) == ("piecewise", 1.4e4)
    tables = json.loads(json.dumps(AUTO))
    solver = chosen.kind.solver
    tables["solver"] = {"rtol": solver.rtol, "atol": solver.atol}
    plain = point(gs.Study.from_dict(tables), 0, 0, 0, 0, 0)
    assert plain.keys() == chosen.keys()
    assert point(study, 1, 0, 0, 3, 0).column("alpha") == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"auto": {"error": 0.5}}, r"auto\.error = 0.5: must be <= 0.1"),
        (
            {"sweep": [AUTO["sweep"][0] | {"representation": ["auto@x"]}], "protocol": {"x": {}}},
            "leave out the protocol",
        ),
        (
            {
                "history": [
                    {
                        "representation": "auto",
                        "K_c": 1.0,
                        "gap": [0.0, 0.0],
                        "omega": 1.0,
                        "t_end": 9.0,
                    }
                ]
            },
            "history: 'auto' is not allowed",
        ),
    ],
)
def test_what_auto_cannot_do_is_refused(change, message):
    with pytest.raises(gs.StudyError, match=message):
        gs.Study.from_dict(AUTO | change)


def test_advice_covers_every_frequency_once():
    study = gs.Study.from_dict(AUTO)
    (scene,) = sentences(advice(study))
    (start,) = scene["starts"]
    assert [(p["from"], p["to"], p["model"]) for p in start["advice"]] == [
        (7.0, 12.0, "exact"),
        (24.0, 24.0, "duffing"),
        (30.0, 30.0, "linear"),
    ]
    assert start["start"] == "rest"


def test_where_no_wall_is_reached_no_smooth_law_is_named():
    far = AUTO["sweep"][0] | {"omega": [24.0, 30.0], "representation": ["piecewise", "tanh-1e4"]}
    (near,) = sentences(advice(gs.Study.from_dict(AUTO | {"sweep": [far | {"omega": [7.0]}]})))
    assert "tanh: epsilon >= " in near["approximations"]
    assert near["laws"]
    (scene,) = sentences(advice(gs.Study.from_dict(AUTO | {"sweep": [far]})))
    assert "no wall is reached" in scene["approximations"]
    assert "tanh" not in scene["approximations"]
    assert scene["laws"] == []


def test_starts_that_need_the_same_model_are_told_together():
    starts = [[0.0, 0.0], [1e-5, 0.0], [1.0, 0.0]]  # the last one beyond the walls
    study = gs.Study.from_dict(
        AUTO | {"sweep": [AUTO["sweep"][0] | {"initial_condition": starts, "omega": [30.0]}]}
    )
    (scene,) = sentences(advice(study))
    near, far = scene["starts"]
    assert near["start"] == "rest; x = 0.01 mm, v = 0 mm/s"
    assert far["start"] == "x = 1000 mm, v = 0 mm/s"
    assert [part["model"] for part in far["advice"]] == ["exact"]
    # what holds of both is what holds of the one that moves farther
    alone = AUTO["sweep"][0] | {"initial_condition": starts[1:2], "omega": [30.0]}
    (only,) = sentences(advice(gs.Study.from_dict(AUTO | {"sweep": [alone]})))
    assert near["advice"] == only["starts"][0]["advice"]


def test_command_advises_without_computing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text(
        f'oscillator = {TOML}\n[study]\nname = "s"\n[[sweep]]\n'
        'representation = ["piecewise", "tanh-1e4"]\n'
        "K_c = [1.4e4]\ngap = [[0.4e-3, 0.4e-3]]\nomega = [7.0, 30.0]\n"
    )
    assert exit_code(["advise", "s.toml", "--error", "1e-2"]) == FINISHED
    text = " ".join(capsys.readouterr().out.split())
    assert " 7 7 exact " in text
    named = re.search(r"tanh: epsilon >= (\S+) /m", text)
    law = gs.Tanh(1.4e4, GAP, float(named[1]))
    visited = expected_range(paper_oscillator(), law)
    assert 0.9 * ADEQUATE < rms_by_sums(law, *visited) / 4.0 <= ADEQUATE
    assert "tanh-1e4 (" in text
    assert exit_code(["advise", "s.toml", "--json"]) == FINISHED
    found = json.loads(capsys.readouterr().out)
    assert (found["error"], found["share"]) == (1e-3, 0.95)
    for each in found["scenes"][0]["laws"]:
        assert each["is_adequate"] == (each["force_error"] <= ADEQUATE)
    assert "not assessed" not in text
    assert exit_code(["advise", "s.toml", "--error", "2"]) == FAULT
    assert "error = 2: must be in" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["s.toml"]


def test_advice_names_laws_that_it_does_not_assess(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text("def bushing(x):\n    return 2e4 * x**3\n")
    (tmp_path / "s.toml").write_text(
        f'oscillator = {TOML}\n[study]\nname = "s"\n[[sweep]]\n'
        'representation = ["own:bushing", "tanh-1e4", "rigid-0.8", "piecewise"]\n'
        "K_c = [1.4e4]\ngap = [[0.4e-3, 0.4e-3]]\nomega = [7.0, 30.0]\n"
    )
    assert exit_code(["advise", "s.toml"]) == FINISHED
    text = capsys.readouterr().out
    assert all(f"{label}: not assessed" in text for label in ("own:bushing", "rigid-0.8"))
    assert exit_code(["advise", "s.toml", "--json"]) == FINISHED
    assert json.loads(capsys.readouterr().out)["not_assessed"] == ["own:bushing", "rigid-0.8"]


def test_an_unbalance_is_judged_by_its_force_next_to_the_natural_frequency():
    """At the highest speed it is several times as large, and any error a smaller share of it."""
    oscillator = {"mass": 12.0, "omega_n": 18.0, "zeta": 0.02, "forcing": 0.0, "unbalance": 2e-4}
    block = {"representation": ["piecewise", "tanh-1e5"], "K_c": 2.5e5, "gap": [2e-4, 2e-4]}
    of_study = {"study": {"name": "rotor"}, "oscillator": oscillator}
    found = [
        advice(gs.Study.from_dict(of_study | {"sweep": [block | {"omega": omega}]}))
        for omega in ([17.0, 18.0, 45.0], [17.0, 18.0])
    ]
    assert_allclose(*(each["force_error"].values for each in found))


def test_several_frequencies_are_refused():
    law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    with pytest.raises(gs.ModelError, match="2 cases: advise judges one"):
        gs.advise(gs.systems.paper_oscillator(), law, omega=[6.0, 9.0])
