"""Forces by pieces as arguments, in text files and in study files; their kernels and keys."""

import json
import math
from dataclasses import asdict

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gapsweep as gs
from gapsweep.integrate.stepping.loop import advance
from gapsweep.model.structure import read_structure, structure_of
from gapsweep.model.waves import Wave

MACHINE = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03}
LAW = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
BLOCK = {"representation": "piecewise", "K_c": 1.4e4, "gap": [4e-4, 4e-4], "omega": [5.0, 9.0]}
RECORD = gs.Record([0.0, 1.0], [0.0, 2.0])


def study(force, **block):
    tables = {"study": {"name": "s"}, "oscillator": MACHINE | {"forcing": force}}
    return gs.Study.from_dict(tables | {"sweep": [BLOCK | block]})


def with_record(**others):
    return gs.Oscillator(**MACHINE, **others, forcing=RECORD)


def test_a_table_is_closed_or_jumps_at_the_end_of_the_period():
    turns = np.array([0.0, 0.2, 0.6, 0.8, 0.9999999, 1.0, 7.8])
    closed = gs.PeriodicForce([0.0, 0.6], [1.0, 4.0]).at(turns)
    assert_allclose(closed, np.interp(turns, [0.0, 0.6, 1.0], [1, 4, 1], period=1.0), atol=1e-12)
    jumping = gs.PeriodicForce([0.0, 1.0], [1.0, 4.0]).at(turns)
    assert_allclose(jumping, 1.0 + 3.0 * (turns % 1.0), atol=1e-12)
    twice = gs.PeriodicForce([0.0, 0.6, 0.6], [1.0, 4.0, -1.0]).at([0.59999999, 0.6, 0.8])
    assert_allclose(twice, [4.0, -1.0, 0.0], atol=1e-6)


def test_times_may_be_seconds_of_a_period():
    turns, force = [0.0, 0.2, 0.6], [1.0, 4.0, -3.0]
    found = gs.PeriodicForce(np.multiply(0.02, turns), force, period=0.02)
    assert_allclose(found.at([0.1, 0.7]), gs.PeriodicForce(turns, force).at([0.1, 0.7]))


def test_a_force_keeps_its_shape_where_the_largest_force_is_swept():
    oscillator = study({"t": [0.0, 0.25], "levels": [-2.0, 4.0]}, forcing=[1.0, 8.0])
    found = oscillator.model.at({"forcing": 8.0})
    load = gs.Switched([0.0, 0.25], [-4.0, 8.0])
    assert (found.forcing, found.wave) == (8.0, load.wave)


WRONG = {
    "unsorted times": (lambda: gs.PeriodicForce([0.0, 0.5, 0.3], [1, 2, 3]), "t[2] = 0.3"),
    "a time that is no number": (lambda: gs.PeriodicForce([0, math.nan], [1, 2]), "t[1] = nan"),
    "a force that is no number": (lambda: gs.Record([0, 1], [1, math.nan]), "f[1] = nan"),
    "an empty table": (lambda: gs.PeriodicForce([], []), "1 to 100000 times"),
    "an empty record": (lambda: gs.Record([], []), "1 to 100000 times"),
    "one point": (lambda: gs.Record([0.0], [1.0]), "2 or more"),
    "other lengths": (lambda: gs.Switched([0, 0.5], [1.0]), "a force for each t"),
    "more than a period": (lambda: gs.Switched([0, 5], [1, 2]), "period=0.02"),
    "a late beginning": (lambda: gs.Switched([0.1, 0.5], [1, 2]), "t[0] = 0.1"),
    "a jump without a knot": (
        lambda: gs.PeriodicForce([0.0], lambda t: float(t < 0.3)),
        "t = 0.3 periods",
    ),
    "a function that raises": (lambda: gs.PeriodicForce([0.0], lambda t: 1 / 0), "ZeroDivision"),
    "a function of text": (lambda: gs.PeriodicForce([0.0], lambda t: "a"), "must be a number"),
    "a direction of an oscillator": (
        lambda: gs.Oscillator(**MACHINE, forcing=gs.Switched([0], [1], along=[1.0])),
        "along is for systems",
    ),
    "no direction in a system": (
        lambda: gs.System(mass=np.eye(2), stiffness=np.eye(2), forcing=[RECORD]),
        "along=[1.0, 0.0]",
    ),
    "a record and a period": (
        lambda: gs.System(
            mass=np.eye(1), stiffness=np.eye(1), forcing=[RECORD, gs.Switched([0], [1])]
        ),
        "Record",
    ),
    "a steady response to a record": (lambda: gs.respond(with_record(), LAW), "gs.simulate"),
    "the frequency of a record": (
        lambda: gs.simulate(with_record(), LAW, 9.0, t_end=1.0),
        "leave omega out",
    ),
    "branches under a record": (
        lambda: gs.branches(with_record(), LAW, along="K_c", between=(1.0, 2.0)),
        "gs.simulate",
    ),
    "basins under a record": (
        lambda: gs.basins(with_record(), LAW, x=(-1e-3, 1e-3), v=(-0.1, 0.1)),
        "gs.simulate",
    ),
    "the settings of ode45": (
        lambda: gs.simulate(
            gs.Oscillator(**MACHINE, forcing=gs.Switched([0], [1])),
            *(LAW, 9.0),
            t_end=1.0,
            controller="ode45",
        ),
        "force by pieces",
    ),
    "a file as a force": (
        lambda: gs.Oscillator(**MACHINE, forcing="f.csv"),
        "from_csv('force.csv'",
    ),
    "an array as a force": (
        lambda: gs.Oscillator(**MACHINE, forcing=np.zeros(200)),
        "array of shape (200,)",
    ),
    "a file that is missing": (lambda: study({"table": "nowhere.csv"}), "nowhere.csv"),
    "the name of a file only": (lambda: study("force.csv"), 'table = "force.csv"'),
    "a file that is a number": (lambda: study({"table": 3}), "force.csv"),
    "unsorted times in a study": (
        lambda: study({"t": [0.0, 0.7, 0.5], "f": [1.0, 2.0, 3.0]}),
        "oscillator.forcing: t[2]",
    ),
    "two kinds in a study": (
        lambda: study({"t": [0.0], "f": [1.0], "levels": [1.0]}),
        "f, for straight lines",
    ),
    "metres in a study": (lambda: study({"t": [0.0], "levels": ["1 m"]}), "number in N"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_forces_are_refused_in_one_line(name):
    call, words = WRONG[name]
    with pytest.raises(gs.GapsweepError) as raised:
        call()
    (line,) = str(raised.value).splitlines()
    assert words in line


FILES = {
    "plain": "0, 1\n0.5, 3\n",
    "in milliseconds and kilonewtons": "time [ms]; force [kN]\n0; 0.001\n500; 0.003\n",
    "with a comment": "# t [s], F [N]\n0 1\n0.5 3\n",
    "with units in parentheses": "time (ms), force (kN)\n0, 0.001\n500, 0.003\n",
    "with units after a slash": "t / ms; F / kN\n0; 0.001\n500; 0.003\n",
    "with units in names": "time_ms,force_kN\n0, 0.001\n500, 0.003\n",
    "with words in names": "time_rel,force_cell\n0, 1\n0.5, 3\n",
}


@pytest.mark.parametrize("name", FILES)
def test_records_of_text_files(name, tmp_path):
    (tmp_path / "force.csv").write_text(FILES[name])
    found = gs.Record.from_csv(tmp_path / "force.csv")
    assert_allclose(found.at([-1.0, 0.25, 0.5, 9.0]), [1.0, 2.0, 3.0, 3.0], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time [mm], force [N]\n0, 1\n1, 2\n", "'time [mm]'"),
        ("time [s], force [kg]\n0, 1\n1, 2\n", "'force [kg]'"),
        ("time [s], force [push]\n0, 1\n1, 2\n", "'force [push]'"),
        ("", "no line with a number"),
    ],
)
def test_files_with_wrong_units_are_refused_in_one_line(text, words, tmp_path):
    (tmp_path / "force.csv").write_text(text)
    with pytest.raises(gs.ModelError) as raised:
        gs.Record.from_csv(tmp_path / "force.csv")
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_file_in_seconds_needs_a_period(tmp_path):
    (tmp_path / "force.csv").write_text("time [ms], force [N]\n0, 1\n10, 3\n")
    with pytest.raises(gs.ModelError, match=r"period=0\.02"):
        gs.PeriodicForce.from_csv(tmp_path / "force.csv")
    found = gs.PeriodicForce.from_csv(tmp_path / "force.csv", period=0.02)
    assert_allclose(found.at([0.25, 0.75]), [2.0, 2.0])


def test_numbers_of_a_file_enter_a_study_and_its_keys(tmp_path):
    """The same numbers in a file and in the study have one structure; other numbers another key."""
    text = ["[oscillator]", *(f"{name} = {value}" for name, value in MACHINE.items()), "{}"]
    sweep = "[[sweep]]\nrepresentation = 'piecewise'\nK_c = 1.4e4\ngap = [4e-4, 4e-4]\nomega = 9.0"
    path = tmp_path / "s.toml"
    path.write_text("\n".join(["[study]\nname = 's'", *text, sweep]).format(
        'forcing = { table = "force.csv", period = "20 ms" }'
    ))  # fmt: skip

    def identity():
        found = gs.Study.load(path)
        read = gs.Study.from_dict(json.loads(found.json))
        assert read.structure == found.structure
        ((_, points),) = found.points(np.array([0]))
        return found, points.kind.identity

    (tmp_path / "force.csv").write_text("t [ms], F [N]\n0, 1\n10, 3\n")
    first, key = identity()
    assert first.oscillator.forcing == 3.0
    inline = study({"t": [0.0, 0.5], "f": [1.0, 3.0]})
    assert inline.structure == first.structure
    (tmp_path / "force.csv").write_text("t [ms], F [N]\n0, 1\n12, 3\n")
    assert identity()[1] != key


def test_structures_are_read_from_json():
    loads = [gs.Switched([0.0, 0.3], [1.0, 2.0], along=[1.0, 3.0]), gs.Harmonic(amplitude=[1.0, 0])]
    system = gs.System(mass=np.eye(2), stiffness=np.eye(2), forcing=loads)
    oscillator = gs.Oscillator(**MACHINE, forcing=gs.Switched([0.0, 0.3], [1.0, 2.0]))
    for model in (system, oscillator):
        structure = structure_of(model)
        again = read_structure(json.loads(json.dumps(asdict(structure))))
        assert again == structure
        made = again.system(structure.row(model))
        assert structure_of(made) == structure
        assert np.array_equal(structure.row(made), structure.row(model))
    assert read_structure({}) == structure_of(gs.systems.paper_oscillator())


def test_a_wave_shows_its_values_at_knots_and_beyond():
    wave = Wave((0.25, 1.0), ((1.0, 0.0), (2.0, 4.0)))
    assert_allclose(wave.at([0.0, 0.25, 0.5, 1.0, -0.5]), [1.0, -1.0, 0.0, 1.0, 0.0])


@pytest.mark.parametrize("order", [1, 3, 5])
def test_advice_bounds_the_motion_under_a_square_wave(order):
    """Its harmonics resonate at fractions of the natural frequency, where a cosine does not."""
    model = gs.Oscillator(mass=1.0, omega_n=1.0, zeta=0.03, forcing=gs.Switched([0, 0.5], [1, -1]))
    omega, free = 1.0 / order, gs.Piecewise(0.0, gs.Gap(1.0, 1.0))
    run = gs.simulate(model, free, omega, n_periods=60)
    reach = np.abs(run.extrema).max()
    cosine = 1.0 / abs((2.0 * math.pi) ** 2 * complex(1.0 - omega**2, 0.06 * omega))
    assert reach > 1.2 * cosine

    def advised(gap):
        return gs.advise(model, gs.Piecewise(1e4, gs.Gap(gap, gap)), omega).model.name

    assert [advised(0.99 * reach), advised(50.0 * reach)] == ["EXACT", "LINEAR"]


def test_the_number_of_knots_and_harmonics_compiles_nothing():
    """A force of three knots loads or compiles the kernel; more knots and harmonics use it."""

    def run(n_knots, n_harmonics):
        turns = np.arange(n_knots) / n_knots
        loads = [gs.PeriodicForce(turns, np.cos(2.0 * np.pi * turns))]
        loads += [gs.Harmonic(amplitude=[1.0 / (k + 1)], k=k + 1) for k in range(n_harmonics)]
        system = gs.System(
            mass=[[3.0]], stiffness=[[3e3]], damping=[[6.0]], contacts={"x": [1.0]}, forcing=loads
        )
        gs.simulate(system, LAW, 9.0, n_periods=1)
        return len(advance.signatures)

    n_kernels = run(3, 0)
    assert [run(50, 0), run(2000, 0), run(3, 40)] == [n_kernels] * 3
