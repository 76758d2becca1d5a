"""Studies of systems on real workers: every number is that of `gapsweep.respond`."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from numpy.testing import assert_array_equal
from tests.builders.datasets import exported
from tests.builders.studies import SECTION, TWO_MASSES, changed

import gapsweep as gs
from gapsweep import pipeline
from gapsweep.execution.plan import plan
from gapsweep.response.result import ResponseClass
from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import verify

pytestmark = pytest.mark.extended

STEADY = {"settle_tol": 1e-3, "n_periods": 16, "max_period_multiple": 8}
FORCED = changed(
    TWO_MASSES,
    sweep__0__omega=[0.3, 0.45, 0.8],
    sweep__0__initial_condition=[
        "sweep_up",
        {"sobol": 3, "x": [[-0.3, 0.3], [-0.3, 0.3]], "v": [[-1.0, 1.0], [-1.0, 1.0]]},
    ],
    sweep__0__representation=["piecewise", "piecewise@loose"],
    protocol={"loose": {"rtol": 1e-5}},
    solver={"rtol": 1e-8},
    steady=STEADY,
)
FREE = changed(
    SECTION,
    sweep__0__speed=[2.0, 6.0, 12.0, 18.0, 60.0],
    sweep__0__initial_condition={
        "sobol": 4,
        "x": [[-0.01, 0.01], [-0.05, 0.05], [-0.1, 0.1]],
        "v": [[0.0, 0.0]] * 3,
    },
    solver={"rtol": 1e-7},
)
GEAR = {
    "study": {"name": "gears"},
    "system": {"function": "gear_pair"},
    "parameters": {"mean_load": 0.1},
    "sweep": [
        {
            "representation": ["piecewise", "piecewise@loose"],
            "K_c": 1.0,
            "gap": [[1.0, 1.0]],
            "omega": [0.08, 0.13, 0.2],
            "initial_condition": ["sweep_up", {"sobol": 3, "x": [[-1.2, 1.2]], "v": [[-1, 1]]}],
        }
    ],
    "protocol": {"loose": {"rtol": 1e-5}},
    "solver": {"rtol": 1e-8},
    "steady": STEADY,
}
STUDIES = {"forced": FORCED, "free": FREE, "gear": GEAR}
OF_COORDINATES = ("x_max", "x_min", "amplitude", "n_extrema")
OF_CONTACTS = ("force_max", "contact_share")
PLAIN = ("status", "response_class", "period_multiple", "lyapunov", "n_steps", "t_settled")


@pytest.fixture(scope="module", params=STUDIES)
def made(request, client, tmp_path_factory):
    """A study, its folder and its responses."""
    folder = tmp_path_factory.mktemp(request.param)
    study = gs.Study.from_dict(STUDIES[request.param])
    with gs.run(study, client, out=folder / "out", cache=folder / "c-cache") as responses:
        return study, folder, responses.load()


def at(responses, **where):
    return responses.isel(representation=0, K_c=-1, gap=0, **where)


def direct(study, responses):
    """Stored responses of fixed initial conditions, each part with the result of `respond`."""
    here = at(responses, initial_condition=responses["start"].values == "fixed")
    n = study.structure.n
    q_0, v_0 = (here[name].values.reshape(-1, n) for name in ("x_0", "v_0"))
    rtol = study.solver("piecewise").rtol
    if study.name == "section":
        law = gs.Piecewise(3.9, gs.Gap(0.03, 0.03))
        for i, speed in enumerate(responses["speed"].values.tolist()):
            system = gs.systems.typical_section(speed, density=1.2)
            found = gs.respond(system, law, q_0=q_0, v_0=v_0, rtol=rtol)
            yield here.isel(speed=i), found
        return
    system, laws = forced(study)
    steady = gs.Steady(**STEADY)
    for i, omega in enumerate(responses["omega"].values.tolist()):
        found = gs.respond(system, laws, omega, q_0=q_0, v_0=v_0, rtol=rtol, steady=steady)
        yield here.isel(omega=i), found


def forced(study):
    """The system of a forced study, made without it, and its laws."""
    if study.name == "gears":
        return gs.systems.gear_pair(mean_load=0.1), gs.systems.gear_pair_law()
    tables = TWO_MASSES["system"]
    system = gs.System(
        **{name: tables[name] for name in ("mass", "stiffness", "damping", "contacts")},
        forcing=[gs.Harmonic(amplitude=[1.0, 0.0])],
    )
    return system, {
        "stop": gs.Piecewise(100.0, gs.Gap(0.1, 0.2)),
        "between": gs.Piecewise(50.0, gs.Gap(0.5, 0.4), K_ratio=2.0),
    }


def test_every_number_is_that_of_respond(made):
    study, _, responses = made
    for here, found in direct(study, responses):
        dataset = found.to_dataset()
        assert {*here.data_vars} - {*dataset} == {"attractor", "host"}
        for name in {*here.data_vars} & {*dataset} - {"cpu_time"} | {"x_0", "v_0"}:
            xr.testing.assert_identical(dataset[name].variable, here[name].variable)
        free = () if "omega" in responses.dims else ("period",)
        more = () if study.structure.n == 1 else ("contact_x_max", "contact_x_min")
        for name in (*PLAIN, *OF_COORDINATES, *OF_CONTACTS, *free, *more):
            expected = getattr(found, name)
            assert_array_equal(here[name].values.reshape(expected.shape), expected, name)
        n = here["n_extrema"].values.reshape(-1, study.structure.n)
        extrema = here["extrema"].values.reshape(*here["extrema"].shape[:2], -1)
        for point in np.flatnonzero(found.status == 0).tolist():
            shown = [extrema[point, : n[point, i], i] for i in range(n.shape[1])]
            assert_array_equal(np.concatenate(shown), found.extrema[point])
            names = [x for x in ("section_x", "section_v", "section_z") if x in here]
            parts = [np.atleast_2d(here[name].values[point].T) for name in names]
            section = np.concatenate(parts).T
            section = section[np.isfinite(section).all(axis=1)]
            assert_array_equal(section.ravel(), found.section[point])


def test_motions_at_contacts_are_those_of_the_coordinates_along_their_directions(made):
    study, folder, responses = made
    names = [f"contact_section_{part}" for part in "xv"]
    if study.structure.n == 1:
        assert not {*names, "contact_x_max"} & {*responses}
        return
    along = np.array([*study.model.default.contacts.values()])
    with xr.open_dataset(folder / "out" / "attractors.nc") as attractors:
        for dataset in (responses, attractors.load()):
            for name in names:
                expected = dataset[name.removeprefix("contact_")].values @ along.T
                found = dataset[name].values
                np.testing.assert_allclose(found.reshape(expected.shape), expected, atol=1e-15)
                assert ("units" in dataset[name].attrs) == ("contact_unit" not in dataset)
            ends = abs(dataset[["x_max", "x_min"]]).to_dataarray().max("variable").values
            largest = abs(dataset[["contact_x_max", "contact_x_min"]]).to_dataarray()
            bound = ends @ np.abs(along).T
            largest = largest.max("variable").values.reshape(bound.shape)
            known = np.isfinite(bound)
            assert known.any()
            assert (largest[known] <= bound[known] * (1.0 + 1e-12)).all()


def test_a_failure_is_data_of_the_same_shape(made):
    study, _, responses = made
    if study.name == "section":  # beyond its flutter speed nothing bounds it
        lost = at(responses, speed=-1)
        assert (lost["status"].values == gs.Status.DIVERGED).all()
        assert (lost["response_class"].values == ResponseClass.FAILED).all()
        assert lost["x_max"].shape == (4, 3)
        assert np.isnan(lost["x_max"].values).all()


def test_datasets_have_the_dimensions_and_names_of_the_system(made):
    study, folder, responses = made
    structure = study.structure
    for name, names in study.grid.parts.items():
        assert responses[name].values.tolist() == list(names)
    along = ("coordinate",) * (structure.n > 1)
    contacts = ("contact",) * (len(structure.contacts) > 1)
    assert responses["x_max"].dims == (*study.grid.dims, *along)
    assert responses["force_max"].dims == (*study.grid.dims, *contacts)
    assert responses["extrema"].dims == (*study.grid.dims, "extremum", *along)
    assert responses["x_0"].dims == responses["v_0"].dims == ("initial_condition", *along)
    assert {*study.grid.parts} == {"coordinate", "contact", "lag"} & {*responses.dims}
    assert ("units" in responses["x_max"].attrs) == ("coordinate_unit" not in responses)
    meanings = responses["response_class"].attrs["flag_meanings"].split()
    assert meanings[1:] == [kind.name.lower() for kind in ResponseClass]
    for name, variable in responses.data_vars.items():
        for other in variable.coords:
            assert {*responses[other].dims} <= {*variable.dims}, (name, other)
    with xr.open_dataset(folder / "out" / "attractors.nc") as attractors:
        assert attractors.sizes["multiplier"] == structure.n_states
        dims = tuple(dim for dim in study.grid.dims if dim != "initial_condition")
        assert attractors["x_max"].dims == (*dims, "attractor", *along)


def test_starts_that_end_alike_share_an_attractor(made):
    _study, folder, responses = made
    with xr.open_dataset(folder / "out" / "attractors.nc") as attractors:
        ids = responses["attractor"].values
        kinds = ResponseClass.PERIODIC, ResponseClass.EQUILIBRIUM
        ok = np.isin(responses["response_class"].values, kinds)
        assert (ids[ok] >= 0).all()
        peaks = attractors["x_max"].load()
        for place in np.argwhere(ok).tolist():
            *scene, _ = place
            there = peaks.values[*scene, ids[*place]]
            ours = responses["x_max"].values[*place]
            assert np.allclose(there, ours, rtol=2e-3, atol=1e-5)


def test_a_sweep_goes_on_from_state_to_state(made):
    study, _, responses = made
    if "omega" not in responses.dims:
        return
    up = responses["start"].values.tolist().index("sweep_up")
    system, laws = forced(study)
    q, v = np.zeros((2, system.n))
    for i, omega in enumerate(responses["omega"].values.tolist()):
        found = gs.respond(system, laws, omega, q_0=q, v_0=v, rtol=1e-8, steady=gs.Steady(**STEADY))
        here = at(responses, omega=i, initial_condition=up)
        assert_array_equal(here["x_max"].values, found.x_max)
        q, v = (np.reshape(end, system.n) for end in (found.x_end, found.v_end))


def test_nothing_is_computed_twice_and_all_is_sound(made):
    study, folder, _ = made
    planned = pipeline.plan(study, folder / "c-cache")
    assert planned.n_missing == 0
    with Cache(folder / "c-cache") as store:
        assert verify(store).is_sound


def test_the_report_shows_every_coordinate(made):
    study, folder, _ = made
    report = folder / "out" / "report"
    pages = [report / "index.html", *report.glob("figures/section-*.html")]
    page = "".join(path.read_text() for path in pages)
    for name in study.grid.parts.get("coordinate", ()):
        assert f", {name}" in page
    assert "walls within the axis" in page or study.name != "gears"
    # Coordinates of the masses are in metres; the other models declare theirs.
    for unit in (" mm", "N/m"):
        assert (unit in page) == (study.name == "masses")
    assert "[m]" not in page


def test_initial_states_of_one_coordinate_lie_in_a_plane(made):
    study, _, responses = made
    here = at(responses).isel({dim: 0 for dim in ("omega", "speed") if dim in responses.dims})
    if study.structure.n > 1:
        with pytest.raises(gs.DatasetError, match="of several coordinates lie in no plane"):
            here.gapsweep.attractors()
        return
    axes = here.gapsweep.attractors(ax=Figure().subplots())
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("initial displacement", "initial velocity")


def test_laws_are_compared_coordinate_by_coordinate(made):
    study, folder, _ = made
    path = folder / "out" / "agreement.nc"
    assert path.exists() == (len(study.grid.representations) > 1)
    if path.exists():
        with xr.open_dataset(path) as agreement:
            is_last = agreement["amplitude_error_median"].dims[-1] == "coordinate"
            assert is_last == (study.structure.n > 1)
            loose = agreement.sel(representation="piecewise@loose", regime="all")
            assert float(loose["amplitude_error_median"].max()) < 1e-3
            assert (loose["n_points"] > 0).all()


def test_query_has_a_column_for_every_coordinate(made, capsys):
    from gapsweep.cli.query_output import Form, written

    study, _folder, responses = made
    written(at(responses).expand_dims(["representation", "K_c", "gap"]), Form("csv"), None)
    header = capsys.readouterr().out.splitlines()[0].split(",")
    names = study.grid.parts.get("coordinate")
    assert {f"x_max[{name}]" for name in names} if names else {"x_max"} <= {*header}


def test_what_needs_one_displacement_is_left_out_with_a_word(made):
    study, folder, _ = made
    assert not (folder / "out" / "static.nc").exists()
    from gapsweep.analysis.datasets.recommendations import advice

    if study.model.default.is_forced:
        assert "force_error" not in advice(study)
    else:
        with pytest.raises(gs.StudyError, match="advice needs a forcing"):
            advice(study)


def test_what_is_not_stored_yet_is_interrupted_in_the_shape_of_the_rest(made, tmp_path):
    study, _, responses = made
    with Cache(tmp_path / "empty-cache") as store:
        exported(plan(study, store), tmp_path)
    with xr.open_dataset(tmp_path / "responses.nc") as empty:
        assert empty["x_max"].shape == responses["x_max"].shape
        assert (empty["status"] == gs.Status.INTERRUPTED).all()
        assert np.isnan(empty["section_x"]).all()


def test_starts_in_parts_are_written_as_all_at_once(made, tmp_path, monkeypatch):
    study, folder, responses = made
    monkeypatch.setattr("gapsweep.execution.layout.PIECE", 3)
    files = tmp_path / "responses.nc", tmp_path / "attractors.nc"
    with Cache(folder / "c-cache") as store:
        exported(plan(study, store), tmp_path)
    with xr.open_dataset(files[0]) as again:
        xr.testing.assert_equal(again.load(), responses)
    with (
        xr.open_dataset(files[1]) as again,
        xr.open_dataset(folder / "out" / "attractors.nc") as whole,
    ):
        xr.testing.assert_equal(again.load(), whole.load())


def test_results_that_are_removed_while_they_are_read_leave_no_file(made, tmp_path, monkeypatch):
    study, folder, _ = made
    monkeypatch.setattr("gapsweep.execution.layout.PIECE", 3)
    n_read, find = [], Cache.found

    def losing(cache, places, structure):
        """The last points of the third piece are not there."""
        found = find(cache, places, structure)
        n_read.append(len(found.at))
        kept = slice(len(found.at) - (len(n_read) == 3))
        rows = np.arange(len(found.at))[kept]
        return replace(
            found, at=found.at[kept], responses=found.responses.take(rows), host=found.host[kept]
        )

    with Cache(folder / "c-cache") as store:
        planned = plan(study, store)
        monkeypatch.setattr(Cache, "found", losing)
        with pytest.raises(gs.StoreError, match="1 points of this run were removed"):
            exported(planned, tmp_path)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(("stiffness", "n_places"), [(100.0, 1), (-100.0, 2)])
def test_laws_that_come_to_rest_alike_agree(stiffness, n_places, client, tmp_path):
    """Every start ends in the middle, or against either stop; tanh is softer only beside a wall."""
    tables = {
        "study": {"name": "rests"},
        "system": {
            "mass": [[1.0]],
            "damping": [[4.0]],
            "stiffness": [[stiffness]],
            "contacts": {"stop": [1.0]},
        },
        "sweep": [
            {
                "representation": ["piecewise", "piecewise@loose", "tanh-1e3"],
                "K_c": 500.0,
                "gap": [[0.1, 0.1]],
                "initial_condition": {"sobol": 8, "x": [[-0.3, 0.3]], "v": [[-1.0, 1.0]]},
            }
        ],
        "protocol": {"loose": {"rtol": 1e-4}},
    }
    study, out = gs.Study.from_dict(tables), tmp_path / "out"
    with gs.run(study, client, out=out, cache=tmp_path / "c-cache") as responses:
        assert (responses["response_class"] == ResponseClass.EQUILIBRIUM).all()
        assert (responses["attractor"] >= 0).all()
    with xr.open_dataset(out / "agreement.nc") as agreement:
        assert (agreement["n_attractors_exact"] == n_places).all()
        for name in ("precision", "recall", "same_attractor"):
            assert (agreement[name] == 1.0).all(), name
        # Of laws beside the exact one: each start ends where its own does.
        assert (agreement["basin_distance"].dropna("representation", how="all") == 0.0).all()


def test_a_system_without_contacts_has_neither_forces_nor_gaps(client, tmp_path):
    tables = {
        "study": {"name": "linear"},
        "system": {
            "mass": [[1.0]],
            "damping": [[0.2]],
            "stiffness": [[4.0]],
            "forcing": [{"amplitude": [1.0]}],
        },
        "sweep": [{"representation": "piecewise", "omega": [0.2, 0.3]}],
    }
    study = gs.Study.from_dict(tables)
    with gs.run(study, client, out=tmp_path / "out", cache=tmp_path / "c-cache") as responses:
        rate = 2.0 * np.pi * responses["omega"].values
        amplitude = 1.0 / np.abs(4.0 - rate**2 + 0.2j * rate)
        np.testing.assert_allclose(responses["amplitude"].values.ravel(), amplitude, rtol=1e-6)
        assert not {"force_max", "contact_share", "gap", "K_c"} & {*responses.variables}


MODULE = """
import gapsweep as gs


def make(a, b):
    if a != b:
        raise ValueError("no such system")
    return gs.System(
        mass=[[a]], damping=[[1.0]], stiffness=[[b]], contacts={"stop": [1.0]},
        forcing=[gs.Harmonic(amplitude=[1.0])],
    )
"""
PAIRS = {
    "study": {"name": "pairs"},
    "system": {"function": "pairs_of_mine:make"},
    "parameters": {"a": 1.0, "b": 1.0},
    "sweep": [
        {"representation": "piecewise", "K_c": 5.0, "gap": [0.1, 0.1], "omega": 0.3, "a": x, "b": x}
        for x in (1.0, 2.0)
    ],
}


def test_a_query_has_the_systems_of_its_own_points(client, tmp_path, monkeypatch):
    """Its grid is a part of the study's: the systems are those of the part's values."""
    (tmp_path / "pairs_of_mine.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    study = gs.Study.from_dict(PAIRS)
    found = gs.query(study, client, cache=tmp_path / "c-cache", a=2.0)
    assert found["a"].values.tolist() == [2.0]
    assert (found["status"] == gs.Status.OK).sum() == 1


def test_a_function_is_asked_only_where_a_block_has_points(tmp_path, monkeypatch):
    (tmp_path / "pairs_of_mine.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    study = gs.Study.from_dict(PAIRS)
    with Cache(tmp_path / "c-cache") as store:
        planned = plan(study, store)
        assert planned.n_points == 2
        exported(planned, tmp_path)
    with xr.open_dataset(tmp_path / "responses.nc") as found:
        assert (found["status"] == gs.Status.INTERRUPTED).sum() == 2
