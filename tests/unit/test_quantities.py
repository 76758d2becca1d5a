"""Quantities with units, in calls and in studies: plain SI numbers, and errors of one line."""

import math
import subprocess
import sys

import click
import numpy as np
import pint
import pytest

import gapsweep as gs
from gapsweep.cli import options
from gapsweep.model.systems import paper_oscillator
from gapsweep.study.axis_selection import positions

U = pint.UnitRegistry()
MACHINE = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
BLOCK = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
GAP = gs.Gap(4e-4, 4e-4)
RPM, RAD = 1.0 / 60.0, 0.5 / math.pi  # in Hz
# Parameter, text, SI number; g in m/s², pounds and inches by their definitions.
OF_MACHINES = [
    ("mass", "3000 g", 3.0),
    ("mass", "2 t", 2000.0),
    ("mass", "1 lb", 0.45359237),
    ("omega_n", "5 Hz", 5.0),
    ("omega_n", "0.005 kHz", 5.0),
    ("omega_n", "30 rad/s", 30.0 * RAD),
    ("omega_n", "300 rpm", 5.0),
    ("omega_n", "720 deg/s", 2.0),
    ("omega_n", "2 turn/s", 2.0),
    ("zeta", "3 %", 0.03),
    ("zeta", "3 percent", 0.03),
    ("forcing", "4 kN", 4e3),
    ("forcing", "2 kg * m / s^2", 2.0),
    ("mean_load", "1 lbf", 0.45359237 * 9.80665),
    ("alpha", "0.7 N/mm^3", 0.7e9),
    ("alpha", "0.7 N/mm³", 0.7e9),
    ("c", "2 N s/m", 2.0),
    ("c", "5 kg/s", 5.0),
]
OF_BLOCKS = [
    ("K_c", "14 kN/m", 14e3),
    ("K_c", "14 N/mm", 14e3),
    ("K_c", "80 lbf/inch", 80.0 * 0.45359237 * 9.80665 / 0.0254),
    ("j_1", "0.3 mm", 0.3e-3),
    ("j_1", "300 µm", 0.3e-3),
    ("j_1", "0.01 inch", 0.254e-3),
    ("K_ratio", "50 %", 0.5),
    ("omega", "1.5e3 rpm", 25.0),
    ("omega", "150 rad/s", 150.0 * RAD),
    ("x_0", "-0.3 mm", -0.3e-3),
    ("v_0", "36 km/h", 10.0),
    ("t_end", "2 min", 120.0),
    ("t_end", "500 ms", 0.5),
    ("atol", "1 nm", 1e-9),
]
WRONG = [
    ("mass", "3 N", "kg"),
    ("omega_n", "5 1/s", "rad/s"),  # cycles or radians
    ("omega_n", "5 s", "rad/s"),
    ("zeta", "3 Hz", "dimension"),
    ("forcing", "4 kg", "N"),
    ("mean_load", "20 degC", "N"),
    ("alpha", "0.7 N/m", "N/m³"),
    ("c", "2 N/m", "N s/m"),
    ("K_c", "14 kN", "N/m"),
    ("j_1", "0.3 rad", "m"),
    ("K_ratio", "1 m", "dimension"),
    ("omega", "9 1/min", "rpm"),
    ("omega", "9 m", "rpm"),
    ("x_0", "1 kg", "m"),
    ("t_end", "2 Hz", "s"),
]


def value(name, given):
    """The number that gapsweep computes with, from the place where it is stored."""
    if name in MACHINE or name in ("alpha", "c", "mean_load"):
        return getattr(gs.Oscillator(**(MACHINE | {name: given})), name)
    if name in ("K_c", "K_ratio"):
        return getattr(gs.Piecewise(**({"K_c": 1e4, "gap": GAP} | {name: given})), name)
    if name == "j_1":
        return gs.Gap(given, 0.0).j_1
    run = {"omega": 9.0, "t_end": 0.1} | {name: given}
    found = gs.simulate(paper_oscillator(), gs.Piecewise(1e4, GAP), **run).inputs
    return found[name].item() if hasattr(found[name], "item") else found[name]


def study_with(name, given):
    """The checked tables of a study with this value of a parameter."""
    tables = {"study": {"name": "s"}, "oscillator": dict(MACHINE), "sweep": [dict(BLOCK)]}
    if name in MACHINE or name in ("alpha", "c", "mean_load"):
        tables["oscillator"][name] = given
    elif name == "j_1":
        tables["sweep"][0]["gap"] = [given, 0.0]
    elif name in ("x_0", "v_0"):
        tables["sweep"][0]["initial_condition"] = [given, 0.0] if name == "x_0" else [0.0, given]
    elif name == "atol":
        tables["solver"] = {"atol": given}
    elif name == "t_end":
        history = BLOCK | {"t_end": given, "representation": "piecewise"}
        tables["history"] = [history]
    else:
        tables["sweep"][0][name] = given
    return gs.Study.from_dict(tables).spec.tables


def stored(name, tables):
    match name:
        case "j_1":
            return tables["sweep"][0]["gap"][0][0]
        case "x_0" | "v_0":
            return tables["sweep"][0]["initial_condition"][0][name == "v_0"]
        case "atol":
            return tables["solver"]["atol"]
        case "t_end":
            return tables["history"][0]["t_end"]
        case "K_c" | "K_ratio" | "omega":
            return tables["sweep"][0][name][0]
    return tables["oscillator"][name]


@pytest.mark.parametrize(("name", "text", "number"), [*OF_MACHINES, *OF_BLOCKS])
def test_quantities_are_plain_si_numbers(name, text, number):
    size, _, unit = text.partition(" ")
    quantity = U.Quantity(float(size), unit)
    for found in (value(name, quantity), value(name, text)):
        assert type(found) is float
        assert found == pytest.approx(number, rel=2e-15)
    for given in (text, quantity):
        found = stored(name, study_with(name, given))
        assert type(found) is float
        assert found == pytest.approx(number, rel=2e-15)


@pytest.mark.parametrize(("name", "text", "unit"), WRONG)
def test_other_dimensions_are_refused_in_one_line(name, text, unit):
    size, _, of = text.partition(" ")
    for given in (text, U.Quantity(float(size), of)):
        with pytest.raises(gs.ModelError) as called:
            value(name, given)
        with pytest.raises(gs.StudyError) as studied:
            study_with(name, given)
        for error in (called, studied):
            (line,) = str(error.value).splitlines()
            assert size.removesuffix(".0") in line
            assert "must be" in line
            assert unit in line


@pytest.mark.parametrize("power", [0, 1, 2])
def test_loads_of_systems_have_the_unit_of_their_power(power):
    def study(amplitude):
        load = {"amplitude": [amplitude], "power": power}
        system = {"mass": [[1.0]], "stiffness": [[1.0]], "forcing": [load]}
        tables = {"study": {"name": "s"}, "sweep": [{"representation": "piecewise", "omega": 1.0}]}
        return gs.Study.from_dict(tables | {"system": system})

    (load,) = study(("3 kN", "3 kN s", "3 t m")[power]).spec.system.forcing
    assert load.amplitude == [3e3]
    for wrong in ("3 mm", "much"):
        with pytest.raises(gs.StudyError, match=r"in N.* power = 1 in N s, with power = 2 in kg m"):
            study(wrong)


def test_no_rounding_of_a_conversion_is_left():
    assert gs.Gap("0.3 mm", 0.7 * U.mm) == gs.Gap(0.3e-3, 0.7e-3)
    texts = [f"{n} um" for n in range(1, 1000)]
    assert [value("j_1", each) for each in texts[::50]] == [n / 1e6 for n in range(1, 1000, 50)]


def test_axes_and_arrays_have_units():
    tables = {"study": {"name": "s"}, "oscillator": MACHINE}
    grid = {"start": "300 rpm", "stop": "1800 rpm", "num": 4}
    gaps = [["0.4 mm", "0.3 mm"], [2e-4, "200 um"]]
    sweep = [BLOCK | {"omega": grid, "gap": gaps, "zeta": ["2 %", "0.5 percent"]}]
    found = gs.Study.from_dict(tables | {"sweep": sweep}).grid
    assert found.omega == pytest.approx((5.0, 40.0 / 3.0, 65.0 / 3.0, 30.0), rel=1e-11)
    assert found.gaps == (gs.Gap(4e-4, 3e-4), gs.Gap(2e-4, 2e-4))
    assert found.axes["zeta"] == (0.005, 0.02)
    again = gs.Study.from_dict(
        tables | {"sweep": [sweep[0] | {"omega": np.array([300.0, 600.0]) * U.rpm}]}
    )
    assert again.grid.omega == (5.0, 10.0)


def test_arrays_of_calls_have_units():
    law = gs.Piecewise(1e4, ("0.4 mm", 4e-4))
    given = {"omega": np.array([300.0, 600.0]) * U.rpm, "x_0": [1.0 * U.mm, 2e-3]}
    run = gs.simulate(paper_oscillator(), law, t_end=100.0 * U.ms, **given)
    plain = gs.simulate(paper_oscillator(), law, omega=[5.0, 10.0], x_0=[1e-3, 2e-3], t_end=0.1)
    assert np.array_equal(run.x_end, plain.x_end)
    table = gs.ForceTable(x=np.array([-1.0, -0.4, 0.4, 1.0]) * U.mm, F=["-8 N", 0.0, 0.0, "8 N"])
    assert table.F == (-8.0, 0.0, 0.0, 8.0)
    assert table.x == (-1e-3, -4e-4, 4e-4, 1e-3)


def test_matrices_of_systems_have_units_of_coordinates_in_metres():
    system = gs.System(
        mass=np.diag([1000.0, 2000.0]) * U.g,
        stiffness=[["30 N/m", -10.0], [-10.0, 0.02 * U.kN / U.m]],
        damping=np.eye(2) * U.N * U.s / U.m,
        forcing=[
            gs.Harmonic(amplitude=[1.0 * U.kN, 0.0], phase="90 deg"),
            gs.Harmonic(amplitude=np.array([1.0, 0.0]) * U.g * U.mm, power=2),
        ],
    )
    assert np.array_equal(system.mass, np.diag([1.0, 2.0]))
    assert np.array_equal(system.stiffness, [[30.0, -10.0], [-10.0, 20.0]])
    assert system.forcing[0].phase == pytest.approx(0.5 * math.pi, rel=1e-15)
    assert system.forcing[1].amplitude.tolist() == [1e-6, 0.0]
    with pytest.raises(gs.ModelError, match=r"mass = .*newton.*kg"):
        gs.System(mass=np.eye(1) * U.N, stiffness=[[1.0]])
    with pytest.raises(gs.ModelError, match="without a unit"):
        gs.System(mass=[[1.0]], stiffness=[[1.0]], contacts={"stop": [1.0 * U.m]})


def test_selections_have_units():
    axis = [5.0, 9.0, 10.0]
    assert positions("omega", axis, "540 rpm").tolist() == [1]
    assert positions("omega", axis, [300 * U.rpm, 10.0]).tolist() == [0, 2]
    assert positions("omega", axis, slice("300 rpm", 550 * U.rpm)).tolist() == [0, 1]


def test_selections_of_the_command_line_have_units():
    wanted = options.selected(("omega=300 rpm,9", "K_c=14 kN/m:2e4", "zeta=2 %"))
    assert wanted == {"omega": [5.0, 9.0], "K_c": slice(14e3, 2e4), "zeta": [0.02]}
    with pytest.raises(click.BadParameter, match=r"omega = '3 mm': must be .* Hz"):
        options.selected(("omega=3 mm",))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: gs.branches(paper_oscillator(), gs.Piecewise(1e4, GAP), between=("3 m", 9.0)),
            "omega = '3 m': must be .* Hz",
        ),
        (lambda: gs.static_error(gs.Piecewise(1e4, GAP), 3 * U.kg), "visited = 3 kilogram: .* m,"),
        (lambda: gs.simulate(paper_oscillator(), gs.Piecewise(1e4, GAP), 9.0, t_end="9 Hz"), "s,"),
    ],
)
def test_calls_refuse_other_dimensions(call, words):
    with pytest.raises(gs.ModelError, match=words):
        call()


def test_ranges_of_calls_have_units():
    law = gs.Tanh(1e4, GAP, "10 1/mm")
    found = gs.static_error(law, ("-2 mm", 2 * U.mm), forcing="4 N")
    assert found == gs.static_error(law, (-2e-3, 2e-3), forcing=4.0)


@pytest.mark.parametrize(
    "law",
    [
        gs.Piecewise(1e4, GAP),
        gs.Arctan(1e4, GAP, 1e4),
        gs.LogArctan(1e4, GAP, 1e4),
        gs.Polynomial(1e4, GAP, 13),
        gs.ForceTable(x=[-1e-3, 0.0, 1e-3], F=[-8.0, 0.0, 8.0]),
        gs.law(lambda x: 1e9 * x**3, 1.0, gs.Gap(0.0, 0.0)),
    ],
    ids=str,
)
def test_displacements_of_laws_have_units(law):
    for given in (0.7 * U.mm, "0.7 mm"):
        assert law.force(given) == law.force(0.7e-3)
        assert law.derivative([given, 1e-4]).tolist() == law.derivative([0.7e-3, 1e-4]).tolist()
    with pytest.raises(gs.ModelError, match=r"x = .* hertz: must be .* m,"):
        law.force(1.0 * U.Hz)


def test_base_motions_have_units():
    machine = paper_oscillator(base_amplitude="1 mm")
    base = gs.BaseMotion(along=[2.0], base_amplitude="1 mm", phase="90 deg")
    for omega, t in ((540.0 * U.rpm, 12.5 * U.ms), ("9 Hz", "12.5 ms")):
        angle = 0.225 * math.pi
        assert machine.base(omega, t) == pytest.approx(1e-3 * math.cos(angle), rel=1e-12)
        assert base.at(omega, t) == pytest.approx([-2e-3 * math.sin(angle)], rel=1e-12)
        assert machine.at(omega) == machine.at(9.0)


def test_the_freeplay_of_a_flap_is_an_angle():
    law = gs.systems.typical_section_law(freeplay="2 deg")
    assert law.gap.j_1 == pytest.approx(math.radians(2.0), rel=1e-14)
    with pytest.raises(gs.ModelError, match=r"freeplay = '2 mm': must be .* rad,"):
        gs.systems.typical_section_law(freeplay="2 mm")


def test_parameters_of_user_laws_are_in_si_base_units():
    def hertz(x, k):
        return k * x * abs(x) ** 0.5

    law = gs.law(hertz, 1.0, gs.Gap(0.0, 0.0), k="2 kN/mm^1")
    assert law.parameters["k"] == 2e6
    with pytest.raises(gs.ModelError, match=r"k = '2 rpm': .* no frequency"):
        gs.law(hertz, 1.0, gs.Gap(0.0, 0.0), k="2 rpm")


@pytest.mark.parametrize(
    "text", ["0.4", "mm", "0.4 mmm", "1 mm + 2 mm", "2 m**9**9**9**9", "((", "0.4/0.4 m", "1e5"]
)
def test_other_text_is_no_number(text):
    with pytest.raises(gs.ModelError, match=r"j_1 = '.*': must be a number"):
        gs.Gap(text, 0.0)
    with pytest.raises(gs.StudyError, match="must be a number"):
        study_with("j_1", text)


def test_pint_is_loaded_only_for_text():
    code = (
        "import sys, gapsweep as gs; gs.Gap(4e-4, 4e-4); import gapsweep.study.study; "
        "assert 'pint' not in sys.modules; gs.Gap('1 mm', 0.0); assert 'pint' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
