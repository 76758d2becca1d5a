"""Results of `gs.respond` and `gs.simulate`: their inputs, datasets, tables and pickles."""

import pickle

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_array_equal
from scipy.integrate import solve_ivp

import gapsweep as gs
from gapsweep.model.systems import paper_oscillator
from gapsweep.report.accessor import GapsweepAccessor

OSCILLATOR = paper_oscillator()
LAW = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
OMEGA, STARTS = np.array([7.0, 9.0, 11.0]), np.array([0.0, 2e-4])
QUICK = gs.Steady(settle_tol=1e-2, max_decay_times=6.0, n_periods=16, max_period_multiple=8)
TWO = (gs.systems.two_masses(), gs.systems.two_masses_law())
# What grows without bound from the second start.
SOFT = paper_oscillator(alpha=-7e8)


def responded(model=OSCILLATOR, law=LAW, omega=OMEGA, **given):
    return gs.respond(model, law, omega, steady=QUICK, **given)


RESULTS = {
    "one": lambda: responded(omega=9.0),
    "many": responded,
    "failing": lambda: responded(SOFT, omega=5.0, x_0=[0.0, 5e-3]),
    "system": lambda: responded(*TWO, omega=0.6),
    "systems": lambda: responded(*TWO, omega=[0.6, 0.8], q_0=[0.01, 0.0]),
    "models": lambda: responded([OSCILLATOR, SOFT], omega=[9.0, 5.0]),
    "run": lambda: gs.simulate(OSCILLATOR, LAW, 9.0, t_end=1.0),
    "runs": lambda: gs.simulate(OSCILLATOR, LAW, OMEGA, t_end=1.0, rtol=1e-7),
    "models run": lambda: gs.simulate([OSCILLATOR, SOFT], LAW, 9.0, n_periods=[5, 6]),
    "history": lambda: gs.simulate(OSCILLATOR, LAW, OMEGA, t_end=1.0, dense_output=True),
    "system run": lambda: gs.simulate(*TWO, 0.6, t_end=20.0),
    "system history": lambda: gs.simulate(*TWO, 0.6, t_end=20.0, dense_output=True),
}


@pytest.fixture(scope="module", params=RESULTS)
def result(request):
    return RESULTS[request.param]()


def test_inputs_compute_the_result_again(result):
    call = gs.respond if isinstance(result, gs.Response) else gs.simulate
    again = call(**result.inputs).to_dataset().drop_vars("cpu_time", errors="ignore")
    xr.testing.assert_identical(again, result.to_dataset().drop_vars("cpu_time", errors="ignore"))


def test_results_can_be_pickled(result):
    again = pickle.loads(pickle.dumps(result))
    xr.testing.assert_identical(again.to_dataset(), result.to_dataset())
    assert repr(again) == repr(result)


def test_results_are_files_and_tables(result, tmp_path):
    found = result.to_dataset()
    found.to_netcdf(tmp_path / "found.nc")
    with xr.open_dataset(tmp_path / "found.nc") as read:
        xr.testing.assert_equal(read, found)
    table, n_times = result.to_dataframe(), found.sizes.get("t", 1)
    assert len(table) == found["status"].size * n_times
    assert set(table["status"]) <= {status.label for status in gs.Status}
    assert "x_0" in table or "x_0[x_1]" in table
    html = result._repr_html_()
    assert "<table" in html
    assert "x_max" in html or "x_end" in html


def test_statuses_and_classes_are_members_in_every_form():
    one, many = RESULTS["one"](), RESULTS["failing"]()
    assert one.response_class is gs.ResponseClass.PERIODIC
    assert one.status is many.status[0] is gs.Status.OK
    assert many.response_class[1].name == "FAILED"
    assert_array_equal(many.response_class == gs.ResponseClass.FAILED, [False, True])
    assert_array_equal(many.status == gs.Status.DIVERGED, [False, True])
    assert "diverged" in many.to_dataset()["message"].values[1]
    runs = gs.simulate(SOFT, LAW, 5.0, x_0=[0.0, 5e-3], t_end=5.0)
    assert [status.label for status in runs.status] == ["ok", "diverged"]


@pytest.mark.parametrize(
    ("omega", "x_0", "dims"),
    [
        (9.0, 0.0, {}),
        (OMEGA, 0.0, {"omega": 3}),
        (9.0, STARTS, {"initial_condition": 2}),
        (OMEGA[:, None], STARTS, {"omega": 3, "initial_condition": 2}),
        (OMEGA, STARTS[:, None], {"omega": 3, "initial_condition": 2}),
        (OMEGA[:2], STARTS, {"point": 2}),
        (OMEGA[:2, None] + [[0.0, 0.1]], STARTS, {"point": 4}),
        (np.reshape([7.0, 8.0, 9.0, 10.0], (1, 2, 2)), 0.0, {"point": 4}),
    ],
)
def test_dimensions_follow_from_the_inputs(omega, x_0, dims):
    run = gs.simulate(OSCILLATOR, LAW, omega, x_0, t_end=0.5)
    found = run.to_dataset()
    assert dict(found.sizes) == dims
    assert found["x_end"].dims == tuple(dims)
    # Every value is at its own frequency and initial state.
    asked = np.broadcast_arrays(omega, x_0)
    for value, *inputs in zip(np.ravel(run.x_end), *map(np.ravel, asked), strict=True):
        alike = (found["omega"] == inputs[0]) & (found["x_0"] == inputs[1])
        assert value in found["x_end"].where(alike).values


def test_systems_without_dimensions_have_their_names_and_no_units_of_length():
    found = RESULTS["systems"]().to_dataset()
    assert found["x_max"].dims == ("omega", "coordinate")
    assert found["coordinate"].values.tolist() == list(TWO[0].coordinates)
    assert found["x_0"].values.tolist() == [0.01, 0.0]
    assert found["x_max"].attrs["units"] == "1"
    assert found["omega"].attrs["units"] == "Hz"
    assert found["section_x"].dims == ("omega", "section_point", "coordinate")


@pytest.mark.extended
def test_a_system_that_is_not_forced_has_no_frequency():
    section, law = gs.systems.typical_section(12.0), gs.systems.typical_section_law()
    found = gs.respond(section, law, q_0=[[0.01, 0.0, 0.0], [0.02, 0.0, 0.0]], rtol=1e-6)
    dataset = found.to_dataset()
    assert dataset["x_max"].dims == ("initial_condition", "coordinate")
    assert "omega" not in dataset.variables
    assert_array_equal(dataset["period"], found.period)
    assert_array_equal(dataset["z_end"], found.z_end)


def test_histories_are_those_of_the_run():
    run = RESULTS["system history"]()
    found = run.to_dataset()
    assert found["x"].dims == ("t", "coordinate")
    assert_array_equal(found["t"], run.t)
    assert_array_equal(found["x"], run.q)
    assert_array_equal(found["v"], run.v)


def test_inputs_of_several_dimensions_are_points():
    omega = np.array([[8.0, 9.0], [9.0, 10.0]])
    found = gs.respond(paper_oscillator(), gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4)), omega)
    dataset = found.to_dataset()
    assert dataset.sizes["point"] == 4
    assert dataset["x_max"].values.tolist() == found.x_max.ravel().tolist()
    assert gs.Response(status=gs.Status.OK)._repr_html_() is None


def test_coordinates_align_with_those_of_a_study():
    """Both are rounded to 12 digits, though a grid in a file has other last bits than linspace."""
    starts = np.linspace(0.0, 1e-3, 5)
    block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4]}
    block["omega"] = {"start": 5.0, "stop": 15.0, "num": 300}
    block["initial_condition"] = [[x, 0.0] for x in starts.tolist()]
    machine = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
    tables = {"study": {"name": "grid"}, "oscillator": machine, "sweep": [block]}
    study = gs.Study.from_dict(tables).grid.coordinates()
    omega = 5.0 + np.arange(300) / 299 * 10.0
    motions = gs.simulate(OSCILLATOR, LAW, omega[:, None], starts, t_end=1e-4).to_dataset()
    assert motions["omega"].values.tolist() == study["omega"].tolist()
    assert motions["x_0"].values.tolist() == study["x_0"].tolist()


def test_an_array_says_how_many_responses_touch_a_wall():
    """A linear oscillator whose amplitude p/k |H| passes the wall at resonance only.

    Every transient touches it.
    """
    linear, omega = paper_oscillator(alpha=0.0, forcing=1.0), [0.5, 5.0, 20.0]
    found = gs.respond(linear, gs.Piecewise(1.4e4, gs.Gap(2e-3, 2e-3)), omega, x_0=4e-3)
    assert found.n_contacts.all()
    spring, r = linear.mass * linear.omega_n_rad**2, np.array(omega) / linear.omega_n
    free = 1.0 / spring / np.hypot(1.0 - r**2, 2.0 * linear.zeta * r)
    n = np.count_nonzero(free > 2e-3)
    assert n == 1
    assert f"{n} touched a wall" in repr(found)
    assert found.to_dataset().attrs["touched_a_wall"] == f"{n} of 3 responses"
    assert found.contacts_per_period.tolist() == [0.0, 2.0, 0.0]


@pytest.mark.parametrize(("omega", "multiple"), [(5.0, 1), (8.0, 2), (10.0, 6)])
def test_contacts_per_period_are_those_of_the_steady_orbit(omega, multiple):
    """Against upward passages of the walls in a motion by scipy from the section."""
    model, low, high = paper_oscillator(), 0.2e-3, 1e-3
    found = gs.respond(model, gs.Piecewise(1e5, gs.Gap(low, high)), omega)
    assert found.period_multiple == multiple
    rate, spring = 2.0 * np.pi * omega, model.mass * model.omega_n_rad**2

    def motion(t, state):
        x, v = state
        wall = 1e5 * (max(x - high, 0.0) + min(x + low, 0.0))
        drag = 2.0 * model.zeta * model.omega_n_rad * model.mass * v
        force = model.forcing * np.cos(rate * t) - drag - spring * x - model.alpha * x**3 - wall
        return v, force / model.mass

    t = np.linspace(0.0, multiple / omega, 4001)
    states = solve_ivp(motion, t[[0, -1]], found.section[:2], t_eval=t, rtol=1e-9, atol=1e-13).y
    beyond = (states[0] > high) | (states[0] < -low)
    n = np.count_nonzero(beyond != np.roll(beyond, 1)) / 2
    assert found.contacts_per_period == n / multiple > 0.0


def test_csv_has_units_in_its_header_and_lengths_in_millimetres():
    law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    made = gs.respond(paper_oscillator(), law, [7.0, 30.0]).to_dataset()
    head, *rows = GapsweepAccessor(made).to_csv(digits=4).splitlines()
    first = dict(zip(head.split(","), rows[0].split(","), strict=True))
    assert first["omega [Hz]"] == "7.0"
    assert float(first["x_max [mm]"]) == pytest.approx(1e3 * made["x_max"].values[0], rel=1e-3)
    assert first["contacts_per_period"] == "2.0"
    assert "lyapunov [1/s]" not in first
    whole = GapsweepAccessor(made).to_csv("lyapunov").splitlines()[0]
    assert whole == "omega [Hz],lyapunov [1/s]"
