"""Rotating unbalances and moving bases against closed forms, at every door."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.oracles.equation import Equation

import gapsweep as gs

MACHINE = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 0.0}
OMEGA = np.array([2.0, 4.6, 5.0, 9.0, 40.0])
FREE = gs.Piecewise(0.0, gs.Gap(1.0, 1.0))
WALLS = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.3e-3))
LOADS = {
    "unbalance": {"unbalance": 2e-4},
    "base": {"base_amplitude": 0.3e-3},
    "damper to the ground": {"base_amplitude": 0.3e-3, "base_damping": 0.0},
    "all": {"unbalance": 2e-4, "base_amplitude": -0.3e-3, "base_damping": 0.4, "forcing": 2.0},
    "all, with a weight": {
        **{"unbalance": 2e-4, "base_amplitude": -0.3e-3, "base_damping": 0.4, "forcing": 2.0},
        **{"mean_load": 1.0, "c": 5.0},
    },
}


def machine(**changes):
    return gs.Oscillator(**(MACHINE | changes))


def linear(oscillator, omega):
    """Complex amplitude of the steady relative displacement [m], and the mean."""
    o, w = oscillator, 2.0 * np.pi * omega
    k, damper = o.mass * (2.0 * np.pi * o.omega_n) ** 2, 4.0 * np.pi * o.zeta * o.omega_n * o.mass
    damper += o.c
    a, s = o.base_amplitude, o.base_damping
    dynamic = k - o.mass * w**2 + 1j * damper * w
    # Of the absolute displacement: spring and damper pull the mass after the base.
    absolute = (o.forcing + o.unbalance * w**2 + a * (k + 1j * s * damper * w)) / dynamic
    return absolute - a, o.mean_load / k


def one_mass(oscillator):
    """The same machine as a system, with loads by their own classes."""
    o = oscillator
    loads = [gs.Harmonic(amplitude=[o.forcing]), gs.Harmonic(amplitude=[o.mean_load], k=0)]
    loads.append(gs.Unbalance(along=[1.0], unbalance=o.unbalance))
    base = {"base_amplitude": o.base_amplitude, "base_damping": o.base_damping}
    loads.append(gs.BaseMotion(along=[1.0], **base))
    return gs.System(
        mass=[[o.mass]],
        stiffness=[[o.mass * o.omega_n_rad**2]],
        damping=[[2.0 * o.mass * o.zeta * o.omega_n_rad + o.c]],
        contacts={"x": [1.0]},
        forcing=loads,
    )


@pytest.mark.parametrize("name", LOADS)
@pytest.mark.parametrize("is_system", [False, True], ids=["oscillator", "system"])
def test_linear_responses_are_the_closed_form(name, is_system):
    oscillator = machine(**LOADS[name])
    model = one_mass(oscillator) if is_system else oscillator
    found = gs.respond(model, FREE, OMEGA, rtol=1e-13)
    expected, mean = linear(oscillator, OMEGA)
    section = np.stack([np.array(each) for each in found.section])[:, :2]
    scale = np.abs(expected) + mean
    assert np.abs(found.amplitude - np.abs(expected)).max() <= 1e-12 * scale.max()
    assert (np.abs(section[:, 0] - expected.real - mean) <= 1e-12 * scale).all()
    rate = 2.0 * np.pi * OMEGA
    assert (np.abs(section[:, 1] / rate + expected.imag) <= 1e-12 * scale).all()


@pytest.mark.parametrize("name", LOADS)
def test_motions_with_contact_agree_with_an_independent_method(name):
    oscillator, omega = machine(alpha=7e8, **LOADS[name]), 6.0
    equation = Equation(oscillator, [WALLS], omega)
    rates, t_end = equation.rates([None]), 4.0 / omega
    exact = solve_ivp(rates, (0.0, t_end), [1e-4, 0.0], "DOP853", rtol=1e-12, atol=1e-16)
    for engine, error in (("compiled", 1e-9), ("scipy", 1e-8)):
        for model, start in ((oscillator, {"x_0": 1e-4}), (one_mass(oscillator), {"q_0": 1e-4})):
            if model is not oscillator and oscillator.alpha:
                cubic = [gs.Cubic(along=[1.0], alpha=oscillator.alpha)]
                model = replace(model, cubic=cubic)
            run = gs.simulate(model, WALLS, omega, t_end=t_end, rtol=1e-12, engine=engine, **start)
            assert run.n_contacts > 2
            assert np.ravel(run.x_end)[0] == pytest.approx(exact.y[0, -1], abs=error * 1e-3)
            assert np.ravel(run.v_end)[0] == pytest.approx(exact.y[1, -1], abs=error * 1e-1)


@pytest.mark.parametrize("name", ["unbalance", "base"])
def test_default_tolerances_are_those_of_the_system(name):
    oscillator = machine(**LOADS[name])
    ours, theirs = (
        gs.respond(model, WALLS, OMEGA).atol for model in (oscillator, one_mass(oscillator))
    )
    assert ours == pytest.approx(theirs, rel=1e-12)


def test_studies_sweep_unbalance_and_base():
    swept = {"unbalance": [0.0, "200 g mm"], "base_amplitude": ["0.1 mm", 0.0]}
    swept |= {"base_damping": ["40 %", 1.0], "omega": [4.6, "540 rpm"]}
    block = {"representation": "piecewise", "K_c": 1.4e4, "gap": [4e-4, 3e-4]} | swept
    study = gs.Study.from_dict(
        {"study": {"name": "s"}, "oscillator": MACHINE | {"forcing": 1.0}, "sweep": [block]}
    )
    assert study.grid.axes["unbalance"] == (0.0, 2e-4)
    keys = set()
    for _, points in study.points(np.arange(study.grid.requested.size)):
        keys |= set(points.keys().tolist())
        (rows, models), refused = points.models()
        assert not refused
        assert len(rows) == len(points)
        for row in range(len(points)):
            values = {name: points.column(name)[row] for name in swept}
            model = models.take([row]).systems[0]
            o = machine(forcing=1.0, **{n: v for n, v in values.items() if n != "omega"})
            load = o.at(values["omega"]).forcing
            if isinstance(model, gs.Oscillator):
                assert model.at(values["omega"]).forcing == pytest.approx(load, rel=1e-15)
            else:
                assert o.damper_load
    assert len(keys) == 16


def test_system_studies_have_the_loads_of_calls():
    given = {"mass": [[3.0]], "stiffness": [[3e3]], "damping": [[5.0]], "contacts": {"x": [1.0]}}
    loads = [
        {"unbalance": "200 g mm", "along": [1.0], "k": 2, "scale": "u"},
        {"base_amplitude": "0.3 mm", "along": [1.0], "base_damping": 0.5},
    ]
    block = {"representation": "piecewise", "K_c": 1.4e4, "gap": [4e-4, 3e-4], "omega": 9.0}
    tables = {"study": {"name": "s"}, "system": given | {"forcing": loads}}
    study = gs.Study.from_dict(tables | {"parameters": {"u": 0.5}, "sweep": [block]})
    system = gs.System(
        **given,
        forcing=[
            gs.Unbalance(along=[1.0], unbalance=1e-4, k=2),
            gs.BaseMotion(along=[1.0], base_amplitude=0.3e-3, base_damping=0.5),
        ],
    )
    pairs = zip(study.model.default.forcing, system.forcing, strict=True)
    for ours, theirs in pairs:
        assert ours.amplitude.tolist() == pytest.approx(theirs.amplitude.tolist(), rel=1e-15)
        assert (ours.k, ours.power, ours.phase) == (theirs.k, theirs.power, theirs.phase)


def test_several_masses_on_a_base_move_as_in_absolute_coordinates():
    mass, chain = np.diag([1.0, 2.0]), np.array([[30.0, -10.0], [-10.0, 10.0]])
    damping, ground = 0.02 * chain, np.diag([0.0, 0.3])
    y, omega = 0.01, 0.7
    w = 2.0 * np.pi * omega
    base = gs.BaseMotion(along=[1.0, 1.0], base_amplitude=y)
    system = gs.System(mass=mass, stiffness=chain, damping=damping, forcing=[base])
    # In absolute coordinates the first mass is pulled by the base's spring, 20, and its damper.
    dynamic = chain - w**2 * mass + 1j * w * damping
    absolute = np.linalg.solve(dynamic, [20.0 * y + 1j * w * 0.4 * y, 0.0])
    found = gs.respond(system, {}, omega, rtol=1e-12)
    assert found.amplitude == pytest.approx(np.abs(absolute - y), rel=1e-10)
    assert base.at(omega, [0.0, 0.5 / omega]) == pytest.approx(np.array([[y, y], [-y, -y]]))
    moved = np.array(found.section[:2]) + base.at(omega, 0.0)
    assert moved == pytest.approx(absolute.real, rel=1e-9)
    both = gs.System(mass=mass, stiffness=chain, damping=damping + ground, forcing=[base])
    assert len(both.forcing) == 1


@pytest.mark.parametrize(
    ("name", "along"),
    [
        ("unbalance", "omega"),
        ("damper to the ground", "omega"),
        ("unbalance", "unbalance"),
        ("unbalance", "base_amplitude"),
    ],
)
def test_branches_follow_the_closed_form(name, along):
    oscillator = machine(zeta=0.1, **LOADS[name])
    between = {"omega": (2.0, 12.0), "unbalance": (1e-4, 5e-4), "base_amplitude": (1e-4, 5e-4)}
    given = {} if along == "omega" else {"omega": 4.6}
    found = gs.branches(oscillator, FREE, along=along, between=between[along], **given)
    values, amplitude = found[along].values.ravel(), found["amplitude"].values.ravel()
    some = np.isfinite(values)
    assert some.sum() > 3
    expected = [
        abs(linear(oscillator, value)[0])
        if along == "omega"
        else abs(linear(replace(oscillator, **{along: value}), 4.6)[0])
        for value in values[some]
    ]
    assert amplitude[some] == pytest.approx(np.array(expected), rel=1e-7)


@pytest.mark.parametrize("name", ["base", "damper to the ground", "all"])
def test_absolute_displacements_are_the_closed_form(name):
    oscillator = machine(**LOADS[name])
    low, high = gs.absolute_range(gs.respond(oscillator, FREE, OMEGA, rtol=1e-12))
    expected = np.abs(linear(oscillator, OMEGA)[0] + oscillator.base_amplitude)
    scale = np.abs(oscillator.base_amplitude)
    assert np.abs(high - expected).max() < 1e-8 * scale + 1e-8 * expected.max()
    assert high == pytest.approx(-low, rel=1e-6)
    run = gs.simulate(oscillator, FREE, OMEGA[:2], t_end=0.5, dense_output=True)
    base = oscillator.base_amplitude * np.cos(2.0 * np.pi * OMEGA[:2] * 0.3)
    assert run.absolute(0.3) - run.sample(0.3)[0] == pytest.approx(base, rel=1e-12)


def test_absolute_displacements_of_systems_are_refused():
    found = gs.respond(one_mass(machine(**LOADS["base"])), FREE, 9.0)
    with pytest.raises(gs.ModelError, match=r"absolute_range: .*BaseMotion\.at"):
        gs.absolute_range(found)


def test_datasets_of_studies_have_absolute_displacements(tmp_path):
    block = {"representation": "piecewise", "K_c": 0.0, "gap": [1.0, 1.0], "omega": [4.6, 9.0]}
    tables = {"oscillator": MACHINE, "sweep": [block | {"base_amplitude": [0.0, 1e-4]}]}
    study = gs.Study.from_dict({"study": {"name": "s"}} | tables)
    responses = gs.run(study, out=tmp_path / "run", cache=tmp_path / "cache", workers=1)
    found = responses.gapsweep.with_absolute()
    for a in (0.0, 1e-4):
        for omega in (4.6, 9.0):
            moved = linear(machine(base_amplitude=a), np.array(omega))[0] + a
            peak = found["absolute_max"].sel(base_amplitude=a, omega=omega).item()
            assert peak == pytest.approx(abs(moved), rel=1e-6, abs=1e-12)


def test_wrong_loads_are_refused():
    for build, words in (
        (lambda: machine(base_damping=1.5), "base_damping = 1.5: must be in 0..1"),
        (lambda: machine(unbalance="3 kg"), "unbalance = '3 kg': must be a number in kg m"),
        (lambda: gs.Unbalance(along=[1.0], unbalance=math.nan), "unbalance = nan"),
        (lambda: gs.BaseMotion([1.0], 1e-3), "along, base_amplitude"),
        (
            lambda: gs.System(
                mass=[[1.0]], stiffness=[[1.0]], forcing=[gs.Unbalance(along=[1, 1], unbalance=1)]
            ),
            "unbalance: along: has the shape",
        ),
    ):
        with pytest.raises(gs.ModelError, match=words.replace("(", r"\(")):
            build()
