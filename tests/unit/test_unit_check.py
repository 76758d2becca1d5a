"""Numbers that are probably in another unit: the same warnings from a call and a study."""

import warnings
from dataclasses import asdict

import numpy as np
import pytest

import gapsweep as gs
from gapsweep.study.unit_check import bounded, doubts_of

USUAL = {"zeta": 0.02, "omega_n": 18.0, "mass": 12.0, "forcing": 50.0}
SPRING = 12.0 * (36.0 * np.pi) ** 2
GAP = (0.15e-3, 0.3e-3)
# From what a machine, or its contact, has otherwise to how each warning begins.
DOUBTS = {
    "usual": ({}, None),
    "percent": ({"zeta": 2.0}, "zeta = 2:"),
    "rad/s": ({"omega": (800.0, 900.0)}, "omega = 900 Hz:"),
    "gap in mm": ({"gap": (0.15, 0.3)}, "gap = 0.15 m:"),
    "one wall in mm": ({"gap": (0.15e-3, 0.3)}, None),
    "kN/mm": ({"K_c": 1.0}, "K_c = 1:"),
    "no contact": ({"K_c": 0.0, "gap": (0.15, 0.3)}, None),
    "softening": ({"gap": (0.15, 0.3), "alpha": -1e9}, None),
    "undamped": ({"gap": (0.15, 0.3), "zeta": 0.0}, None),
    "free mass": ({"omega_n": 0.0, "gap": (0.15, 0.3), "c": 5.0}, None),
    "start beyond the wall": ({"gap": (0.15, 0.15), "start": (0.2, 0.0)}, None),
    "wide layers": ({"label": "tanh-500"}, "epsilon = 500"),
    "wide layers of log": ({"label": "logarctan-500"}, "gamma = 500"),
    "layers that fit": ({"label": "arctan-1e4"}, None),
    "force in the gap": ({"label": "tanh-1e4", "K_c": 1e8}, "epsilon = 10000 /m: between"),
    "force in the gap of log": (
        {"label": "logarctan-1e4", "K_c": 1e8},
        "gamma = 10000 /m: between",
    ),
    "sharper": ({"label": "tanh-1e6", "K_c": 1e8}, None),
    "unforced": ({"label": "tanh-1e4", "K_c": 1e8, "forcing": 0.0}, None),
    "nanometres": ({"scale": 1e-9}, None),
    "kilometres": ({"scale": 1e3}, None),
    "gap of mm in nanometres": ({"scale": 1e-9, "gap": (0.15, 0.3)}, "gap = 1.5e-10 m:"),
    "layers in nanometres": ({"scale": 1e-9, "label": "tanh-500"}, "epsilon = 5e+11"),
}


def of_case(changed):
    """The numbers of a case: a machine, label, K_c, gap, frequencies and an initial state.

    A scale multiplies lengths, forces alike; stiffnesses stay.
    """
    told = {"omega": (16.0, 17.0), "K_c": 1e6, "gap": GAP, "label": "piecewise", "scale": 1.0}
    told |= {"start": (0.0, 0.0)} | USUAL | changed
    scale = told.pop("scale")
    machine = {
        n: told.pop(n) for n in ("zeta", "omega_n", "mass", "forcing", "alpha", "c") if n in told
    }
    machine["forcing"] *= scale
    name, dash, sharpness = told["label"].partition("-")
    label = f"{name}-{float(sharpness) / scale:g}" if dash else name
    gap = tuple(wall * scale for wall in told["gap"])
    return machine, label, told["K_c"], gap, told["omega"], told["start"]


def study_of(changed, **more):
    machine, label, K_c, gap, omega, start = of_case(changed)
    block = {"representation": label, "K_c": K_c, "gap": list(gap), "omega": list(omega)}
    block |= {"initial_condition": [list(start)]}
    return gs.Study.from_dict(
        {"study": {"name": "s"}, "oscillator": machine, "sweep": [block | more]}
    )


def warned(call, *arguments, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call(*arguments, **options)
    assert all(each.category is UserWarning for each in caught)
    assert all(each.filename == __file__ for each in caught)
    return [str(each.message) for each in caught]


@pytest.mark.parametrize("name", DOUBTS)
def test_a_call_and_a_study_have_the_same_doubts(name):
    changed, begins = DOUBTS[name]
    machine, label, K_c, gap, omega, start = of_case(changed)
    law = gs.contact_law(label, K_c, gs.Gap(*gap))
    found = list(doubts_of(study_of(changed)))
    assert len(found) == (begins is not None)
    assert all(text.startswith(begins) for text in found)
    assert [*doubts_of(study_of(changed), "far")] == [*found, "far"]
    oscillator = gs.Oscillator(**machine)
    given = dict(zip(("x_0", "v_0"), start, strict=True))
    assert warned(gs.simulate, oscillator, law, omega, **given, n_periods=1) == found


def test_a_force_in_the_gap_is_reported_where_the_softest_wall_has_it():
    coarse = {"label": "tanh-1e4"}
    assert not [*doubts_of(study_of(coarse, K_c=[1e4, 1e8]))]
    assert [text[:16] for text in doubts_of(study_of(coarse, K_c=[1e7, 1e8]))] == [
        "epsilon = 10000 "
    ]
    assert not [*doubts_of(study_of(coarse, K_c=[1e7, 1e8], forcing=[50.0, 5e4]))]


def test_values_given_as_factors_of_the_nominal_value_are_doubted():
    def found(**of):
        tables = study_of({}).spec.tables
        tables["uncertain"] = {"samples": 8, "quantities": ["amplitude"], "forcing": of}
        return [*doubts_of(gs.Study.from_dict(tables))]

    assert not found(normal=1.1, sd=0.1, nominal="times")
    assert not found(normal=50.0, sd=1.0)
    (message,) = found(normal=4.0, sd=0.1, nominal="times")
    assert "forcing" in message
    assert "4;" in message


def test_each_call_warns_once_where_it_is_written():
    law = gs.Tanh(1e6, gs.Gap(0.15, 0.3), 1.0)
    oscillator = gs.Oscillator(**USUAL | {"zeta": 3.0})
    grid = {"x": [0.0, 1e-4], "v": [0.0]}
    for call, given in ((gs.respond, {"omega": 17.0}), (gs.basins, {"omega": 17.0, **grid})):
        (message,) = warned(call, oscillator, law, **given)
        assert all(name in message for name in ("zeta = 3", "gap = 0.15 m", "epsilon = 1"))
    (message,) = warned(gs.branches, oscillator, law, "omega", (16.0, 18.0))
    assert "zeta = 3" in message


def system(damping, along=(1.0,), forcing=50.0, **more):
    n = len(along)
    load = gs.Harmonic(amplitude=[forcing] + [0.0] * (n - 1))
    return gs.System(
        mass=12.0 * np.eye(n), stiffness=SPRING * np.eye(n), damping=damping * np.eye(n),
        contacts={"stop": along}, forcing=[load], **more,
    )  # fmt: skip


def test_a_system_has_the_doubts_of_an_oscillator():
    """With one coordinate the same limits: the wall at 10 and 10.2 times the resonance."""
    damping = 2.0 * USUAL["zeta"] * 12.0 * 36.0 * np.pi
    resonance = 50.0 / (2.0 * USUAL["zeta"] * SPRING)
    for model in (gs.Oscillator(**USUAL), system(damping)):
        for factor, n in ((9.8, 0), (10.2, 1)):
            law = gs.Piecewise(1e6, gs.Gap(factor * resonance, 1.0))
            found = warned(gs.simulate, model, law, 17.0, n_periods=1)
            assert [text[:3] for text in found] == ["gap"] * n
    far = gs.Piecewise(1e6, gs.Gap(1.0, 1.0))
    for silent in (
        system(0.0),  # undamped
        system(damping, cubic=[gs.Cubic(along=[1.0], alpha=-1e9)]),
        system(damping, forcing=0.0),
    ):
        assert warned(gs.simulate, silent, far, 17.0, n_periods=1) == []
    two = system(damping, along=(0.0, 1.0), forcing=50.0)
    near = gs.Piecewise(1e6, gs.Gap(1e-4, 1e-4))
    assert warned(gs.simulate, two, near, 17.0, n_periods=1) == []  # the load is on the other one


def test_a_study_of_systems_has_them_for_each_contact():
    tables = {
        "study": {"name": "s"},
        "system": {
            "mass": [[12.0]], "stiffness": [[SPRING]], "damping": [[100.0]],
            "contacts": {"stop": [1.0], "far": [1.0]}, "forcing": [{"amplitude": [50.0]}],
        },
        "contact": {"far": {"gap": [1.0, 2.0]}},
        "sweep": [{"representation": "piecewise", "K_c": 1e6, "gap": list(GAP), "omega": 17.0}],
    }  # fmt: skip
    (found,) = doubts_of(gs.Study.from_dict(tables))
    assert found.startswith("gap = 1 at contact 'far':")


TABLES = {
    "in metres": ([-1e-3, -0.15e-3, 0.3e-3, 1e-3], [-8.0, 0.0, 0.0, 7.0], None),
    "in mm": ([-500.0, -150.0, 300.0, 500.0], [-8.0, 0.0, 0.0, 7.0], "gap = 150 m:"),
    "in mm without gap": ([-500.0, -150.0, 0.0, 300.0], [-8.0, -1.0, 0.0, 7.0], "gap = 150 m:"),
    "outwards": ([-1e-3, -0.15e-3, 0.3e-3, 1e-3], [8.0, 0.0, 0.0, -7.0], "force table: F = 8 N"),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_of_another_unit_or_sign_is_named_with_its_own_walls(name, tmp_path, monkeypatch):
    x, F, begins = TABLES[name]
    found = warned(gs.simulate, gs.Oscillator(**USUAL), gs.ForceTable(x, F), 17.0, n_periods=1)
    assert [text[: len(begins)] for text in found] == [begins] if begins else not found
    module = f"stop_{abs(hash(name))}"
    (tmp_path / f"{module}.py").write_text(
        f"import gapsweep as gs\nwall = gs.ForceTable({x}, {F})\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    block = {"representation": f"{module}:wall", "omega": [16.0, 17.0]}
    study = gs.Study.from_dict({"study": {"name": "s"}, "oscillator": USUAL, "sweep": [block]})
    assert list(doubts_of(study)) == found


def test_swept_parameters_count_where_any_point_passes():
    """The gap is out of reach at the smallest forcing only; at no zeta it is overdamped."""
    forcing = [1e-3, 50.0]
    assert list(doubts_of(study_of({}, forcing=forcing, zeta=[0.01, 0.9]))) == []
    assert len(list(doubts_of(study_of({}, forcing=1e-4)))) == 1


def test_the_paper_and_published_systems_are_usual():
    law = gs.Tanh(1.4e4, gs.Gap(0.0, 0.8e-3), 1e4)
    oscillator = gs.systems.paper_oscillator()
    assert asdict(oscillator)["alpha"] == 7e8
    assert warned(gs.simulate, oscillator, law, [0.1, 30.0], n_periods=1) == []
    for name, omega in (("two_masses", 0.1), ("gear_pair", 0.5), ("soft_impact_oscillator", 0.1)):
        model = getattr(gs.systems, name)()
        law = getattr(gs.systems, f"{name}_law")()
        assert warned(gs.simulate, model, law, omega, n_periods=1) == []


def test_a_method_of_a_study_warns_where_it_is_called(tmp_path):
    study = study_of({"zeta": 2.0})
    (said,) = warned(study.plan, cache=tmp_path / "none")
    assert said.startswith("zeta = 2:")
    (again,) = warned(gs.plan, study, cache=tmp_path / "none")
    assert again == said


def test_a_script_warns_at_its_top_level_and_in_code_without_a_name():
    code = "gs.simulate(gs.Oscillator(**usual), law, 17.0, n_periods=1)"
    law = gs.Piecewise(1e6, gs.Gap(0.15, 0.3))
    given = {"gs": gs, "usual": USUAL, "law": law}
    with pytest.warns(UserWarning, match="gap = 0.15 m:"):
        exec(code, given)


def test_bounds_before_a_run_tell_cases_that_may_touch_a_wall_from_others():
    """The motion is larger than a gap of 0.01 mm, and smaller than one of 0.4 m."""
    study = study_of({}, gap=[[0.01e-3, 0.01e-3], [0.4, 0.4]])
    assert " in 1 of 2 cases: " in bounded(study)


@pytest.mark.parametrize("gap", [0.01e-3, 0.4])
def test_bounds_before_a_large_run_are_few(gap, monkeypatch):
    asked = []
    advice = gs.Study.advice
    monkeypatch.setattr(gs.Study, "advice", lambda *of: asked.append(len(of[1])) or advice(*of))
    omega = {"start": 16.0, "stop": 18.0, "num": 50_000}
    K_c = {"start": 1e5, "stop": 1e6, "num": 50}
    assert bounded(study_of({}, omega=omega, K_c=K_c, gap=[[gap, gap]])) == ""
    assert sum(asked) < 20_000
