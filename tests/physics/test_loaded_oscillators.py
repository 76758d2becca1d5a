"""Oscillators with a mean load, added damping or no spring, from study files and from calls."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.builders.studies import PAPER

import gapsweep as gs
from gapsweep.analysis.datasets.static import static
from gapsweep.execution.layout import Layout
from gapsweep.execution.task import Tile, respond_to
from gapsweep.model.equilibria import equilibria
from gapsweep.model.structure import general_form

# A gear on its shaft: no spring, a drag torque, backlash of 0.1 mm to both sides.
GEAR = {
    "study": {"name": "gear"},
    "oscillator": PAPER | {"omega_n": 0.0, "alpha": 0.0},
    "sweep": [
        {
            "representation": "piecewise",
            "K_c": 1e5,
            "gap": [1e-4, 1e-4],
            "omega": 20.0,
            "mean_load": [-2.0, 0.5],
            "c": [20.0, 40.0],
            "forcing": [4.0, 6.0],
        }
    ],
}


def test_a_free_gear_with_drag_is_swept_from_its_tables():
    study = gs.Study.from_dict(GEAR)
    ((_, table),) = study.points(np.arange(8))
    tiles = [Tile.of_one(table.take([row]), np.zeros(2)) for row in range(8)]
    law = gs.Piecewise(1e5, gs.Gap(1e-4, 1e-4))
    gear = gs.systems.paper_oscillator(omega_n=0.0, alpha=0.0)
    seen = set()
    for row in range(8):
        given = {name: table.column(name)[row] for name in ("mean_load", "c", "forcing")}
        model = replace(gear, **given)
        found = gs.respond(model, law, omega=20.0)
        assert respond_to(tiles[row]).columns["x_max"].item() == found.x_max
        if found.response_class is gs.ResponseClass.PERIODIC:
            seen.add(tuple(given.values()))
    assert len(seen) >= 6


@pytest.mark.parametrize("seed", range(6))
def test_an_oscillator_responds_as_its_system_of_one_coordinate(seed):
    rng = np.random.default_rng(seed)
    model = gs.systems.paper_oscillator(zeta=rng.uniform(0.02, 0.1), alpha=rng.uniform(0.0, 1e9))
    law = gs.Piecewise(10.0 ** rng.uniform(3.5, 5.0), gs.Gap(*rng.uniform(2e-4, 8e-4, 2)))
    law = law if seed % 3 else gs.Tanh(law.K_c, law.gap, 1e4)
    omega = np.linspace(4.0, 14.0, 8)
    ours, general = (gs.respond(each, law, omega) for each in (model, general_form(model)))
    assert np.array_equal(ours.response_class, general.response_class)
    assert np.array_equal(ours.period_multiple, general.period_multiple)
    for name in ("x_max", "x_min", "force_max", "contact_share", "multiplier_abs"):
        mine, other = getattr(ours, name), getattr(general, name)
        assert mine.shape == other.shape
        is_periodic = ours.period_multiple > 0
        assert mine[is_periodic] == pytest.approx(other[is_periodic], rel=1e-6), name


def test_added_damping_is_that_of_a_ratio():
    plain = gs.systems.paper_oscillator(zeta=0.05)
    added = gs.systems.paper_oscillator(zeta=0.02, c=2.0 * plain.mass * 0.03 * plain.omega_n_rad)
    law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    ours, other = (gs.respond(each, law, omega=9.0).x_max for each in (plain, added))
    assert ours == pytest.approx(other, rel=1e-9)
    for zeta in (0.03, 1.0, 3.0):
        plain = gs.systems.paper_oscillator(zeta=zeta)
        added = gs.systems.paper_oscillator(zeta=0.0, c=2.0 * plain.mass * zeta * plain.omega_n_rad)
        assert added.settling_rate == pytest.approx(plain.settling_rate, rel=1e-9)
        assert general_form(added).settling_rate == pytest.approx(added.settling_rate, rel=1e-9)


def test_a_mean_load_moves_the_equilibrium():
    model, law = gs.systems.paper_oscillator(mean_load=3.0), gs.Piecewise(1e4, gs.Gap(4e-4, 4e-4))
    found = equilibria(model, law, 1e-2)
    stiffness = model.mass * model.omega_n_rad**2
    x = brentq(lambda x: stiffness * x + 7e8 * x**3 + law.force(x) - 3.0, 0.0, 1e-2)
    assert found.x == pytest.approx([x])
    work = 0.5 * stiffness * x**2 + 0.25 * 7e8 * x**4 + 0.5e4 * max(x - 4e-4, 0.0) ** 2 - 3.0 * x
    assert found.energy == pytest.approx([work])


@pytest.mark.parametrize("given", [{"omega_n": -1.0}, {"omega_n": 1e-60}, {"c": -1.0}])
def test_what_no_machine_has_is_refused(given):
    with pytest.raises(gs.ModelError, match=next(iter(given))):
        gs.systems.paper_oscillator(**given)


def test_a_mean_load_breaks_the_mirror_symmetry():
    block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": [8.0, 9.0]}
    for oscillator, swept, expected in (
        ({"mean_load": 1.0}, {}, [False, False]),
        ({}, {"mean_load": [0.0, 1.0]}, [True, False, True, False]),
        ({}, {}, [True, True]),
    ):
        tables = {
            "study": {"name": "x"},
            "oscillator": PAPER | oscillator,
            "sweep": [block | swept],
        }
        study = gs.Study.from_dict(tables)
        layout = Layout.of(study.grid, study.steady, mean_load=study.oscillator.mean_load)
        (piece,) = layout.pieces()
        found = layout.is_symmetric(piece)
        assert found.tolist() == expected


def test_a_mass_that_its_load_drives_away_has_no_class():
    away = gs.systems.paper_oscillator(omega_n=0.0, alpha=0.0, mass=1.2, c=2.0, mean_load=-1.0)
    gap = gs.Gap(2e-4, 2e-4)
    for law in (gs.Tanh(1e4, gap, 1e5, K_ratio=0.0), gs.Piecewise(1e4, gap, K_ratio=0.0)):
        found = gs.respond(away, law, omega=9.0)
        assert found.response_class in (gs.ResponseClass.UNRESOLVED, gs.ResponseClass.FAILED)
        assert found.message


def test_a_free_mass_that_touches_nothing_is_told_why():
    free = gs.systems.paper_oscillator(omega_n=0.0, alpha=0.0, c=10.0, forcing=0.1)
    found = gs.respond(free, gs.Piecewise(1e4, gs.Gap(1.0, 1.0)), omega=9.0)
    assert found.response_class is gs.ResponseClass.UNRESOLVED
    assert "every position in the gap" in found.message


def test_static_equilibria_follow_a_swept_mean_load():
    block = {"representation": "piecewise", "K_c": 1e5, "gap": [2e-4, 2e-4], "omega": 20.0}
    tables = {
        "study": {"name": "x"},
        "oscillator": PAPER | {"omega_n": 0.0, "alpha": 0.0, "mean_load": 5.0},
        "sweep": [block | {"mean_load": [-2.0, 2.0]}],
    }
    found = static(gs.Study.from_dict(tables))["equilibrium_x"].squeeze()
    assert found.dims[0] == "mean_load"
    assert found.values.ravel() == pytest.approx([-2.2e-4, 2.2e-4])


def test_ode45_takes_added_damping_and_refuses_a_mean_load():
    law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    given = {"omega": 9.0, "t_end": 1.0, "controller": "ode45", "rtol": 1e-8, "atol": 1e-11}
    ours = gs.simulate(gs.systems.paper_oscillator(c=3.0), law, **given).x_end
    exact = gs.simulate(gs.systems.paper_oscillator(c=3.0), law, omega=9.0, t_end=1.0).x_end
    assert ours == pytest.approx(exact, abs=1e-8)
    with pytest.raises(gs.ModelError, match="mean_load"):
        gs.simulate(gs.systems.paper_oscillator(mean_load=1.0), law, **given).to_dataset()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"history": [{"mass": -1.0}]}, "history[0].mass = -1: must be > 0"),
        ({"sweep": [{"[parameters]": {"zeta": 0.1}}]}, "unknown key"),
        ({"sweep": [{"initial_condition": [[0.0, 0.0, 1.0]]}]}, "sweep[0].initial_condition: 3"),
        ({"oscillator": {"zeta": -1.0}, "sweep": [{"K_c": None}]}, "sweep[0].K_c: missing"),
    ],
)
def test_problems_name_their_place(change, said):
    block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    history = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    tables = {"study": {"name": "x"}, "oscillator": PAPER | change.get("oscillator", {})}
    blocks = [block | each for each in change.get("sweep", [{}])]
    tables["sweep"] = [{k: v for k, v in each.items() if v is not None} for each in blocks]
    tables["history"] = [history | {"t_end": 2.0} | each for each in change.get("history", [])]
    with pytest.raises(gs.StudyError) as refused:
        gs.Study.from_dict(tables)
    assert said in str(refused.value)
