"""Datasets of studies that sweep any number: every scene is what it is by itself."""

import numpy as np
import pytest
import xarray as xr
from tests.builders.datasets import (
    branches,
    chaotic,
    datasets,
    failed,
    over_forcing,
    over_walls,
    periodic,
    tables,
)

from gapsweep.analysis.agreement.comparison import agreement
from gapsweep.analysis.claims import NotInRunError, Run
from gapsweep.analysis.datasets.timing import timing
from gapsweep.analysis.dimensions import over, scene_dims
from gapsweep.report.html import write_report
from gapsweep.report.inputs import Inputs
from gapsweep.report.sections.overview import is_wide, sections
from gapsweep.report.verdicts import contacts, in_words
from gapsweep.status import Status
from gapsweep.study.grid import COORDINATE

LABELS = ["piecewise", "piecewise@half", "tanh-1e4"]
HALF = {"protocol": {"half": {"rtol": 5e-10}}}
OMEGA = (5.0, 6.0, 7.0)
FORCING = (2.0, 4.0)
J_1, J_2 = [0.2e-3, 0.4e-3], [0.4e-3, 0.6e-3, 0.8e-3]


def answer(label, omega, start, forcing=3.0):
    """Peaks grow with the forcing; tanh is 1 % off, chaotic at 6 Hz and fails at 7 Hz."""
    x = (1.0 + 0.01 * LABELS.index(label) + 0.3 * start) * forcing * 1e-3 / omega
    if label == "tanh-1e4" and omega == 6.0:
        return chaotic([(x, 0.0), (0.5 * x, 1e-4), (0.2 * x, 0.0)], omega)
    return failed() if label == "tanh-1e4" and omega == 7.0 else periodic([(x, 0.0)], omega)


STUDY = tables(LABELS, OMEGA, starts=2, sweeps=["sweep_up"], **HALF)


@pytest.fixture(scope="module")
def forced(tmp_path_factory):
    return over_forcing(tmp_path_factory.mktemp("forced"), STUDY, answer, FORCING)


@pytest.fixture(scope="module")
def walled(tmp_path_factory):
    return over_walls(tmp_path_factory.mktemp("walled"), LABELS[::2], OMEGA, J_1, J_2, answer)


def test_a_scene_is_all_but_representation_frequency_and_start():
    dims = ("representation", "K_c", "j_1", "j_2", "omega", "zeta", "initial_condition")
    assert scene_dims(dims) == ["K_c", "j_1", "j_2", "zeta"]
    frequency = ("representation", "K_c", "gap", "omega")
    assert over(frequency, dims) == dims[:-1]
    assert over(("K_c", "gap", "regime"), dims) == ("K_c", "j_1", "j_2", "zeta", "regime")


@pytest.mark.parametrize("analysis", [agreement, lambda responses, _: timing(responses)])
def test_every_forcing_is_what_it_is_by_itself(forced, tmp_path, analysis):
    whole = analysis(*forced)
    for i, force in enumerate(FORCING):
        alone = datasets(tmp_path, STUDY, lambda *at, f=force: answer(*at, f))
        mine, theirs = whole.isel(forcing=i, drop=True), analysis(*alone)
        assert set(mine) == set(theirs)
        for name in theirs:
            xr.testing.assert_identical(mine[name], theirs[name])


def test_dimensions_keep_the_order_of_the_responses(forced):
    compared = agreement(*forced)
    assert compared["amplitude_error"].dims == forced[0]["status"].dims
    assert compared["n_attractors"].dims == ("representation", "K_c", "gap", "omega", "forcing")
    assert compared["recall_pooled_floor"].dims == ("K_c", "gap", "forcing", "regime")
    assert timing(forced[0])["nfev_mean"].dims == ("representation", "K_c", "gap", "forcing")
    assert compared["forcing"].values.tolist() == list(FORCING)


@pytest.mark.parametrize("analysis", [agreement, lambda responses, _: timing(responses)])
def test_wall_distances_are_a_gap(walled, analysis):
    split, labelled = (analysis(*files) for files in walled)
    for a, b in ((a, b) for a in J_1 for b in J_2):
        mine = split.sel(j_1=a, j_2=b, drop=True)
        theirs = labelled.sel(gap=f"{1e3 * a:g}/{1e3 * b:g}", drop=True)
        for name in theirs:
            np.testing.assert_array_equal(mine[name].values, theirs[name].values)


def test_claims_select_any_parameter(forced, walled):
    run = Run({"responses": forced[0], "agreement": agreement(*forced)})
    points = run.points("tanh-10000", 1.4e4, "0.4/0.4", "amplitude", forcing=4.0)
    assert points["amplitude"].values[0] == pytest.approx(1.02 * 4e-3 / 5.0)
    assert points.sizes["point"] == len(OMEGA)
    with pytest.raises(NotInRunError, match=r"no values at .* forcing 5"):
        run.points("piecewise", 1.4e4, "0.4/0.4", "amplitude", forcing=5.0)
    run = Run({"responses": walled[0][0]})
    points = run.points("piecewise", 1.4e4, None, "status", j_1=J_1[0], j_2=J_2[1])
    assert points["j_2"] == J_2[1]


def test_contacts_are_told_apart_by_every_parameter(forced, walled):
    found = contacts(agreement(*forced))
    assert [contact.others for contact in found] == ["forcing = 2 N", "forcing = 4 N"]
    assert [contact.place for contact in found] == [
        "14000 N/m, 0.4/0.4 mm, forcing = 2 N",
        "14000 N/m, 0.4/0.4 mm, forcing = 4 N",
    ]
    gaps = [contact.gap for contact in contacts(agreement(*walled[0]))]
    assert gaps == ["0.2/0.4", "0.2/0.6", "0.4/0.4", "0.2/0.8", "0.4/0.6", "0.4/0.8"]
    assert gaps == [contact.gap for contact in contacts(agreement(*walled[1]))]


def test_many_contacts_are_counted(tmp_path):
    study = tables(["piecewise", "tanh-1e4"], [5.0])
    study["sweep"][0]["K_c"] = [1e4 + i for i in range(20)]
    found = contacts(agreement(*datasets(tmp_path, study, answer)))
    said = " ".join(in_words(found))
    assert len(found) == 20
    assert "for 20 cases" in said
    assert said.count("10019") == 0


@pytest.mark.parametrize(
    ("changes", "wide"),
    [
        ({}, False),
        ({"K_c": [1e4 + i for i in range(16)]}, False),
        ({"K_c": [1e4 + i for i in range(17)]}, True),
    ],
)
def test_sixteen_scenes_have_figures_of_their_own(tmp_path, changes, wide):
    study = tables(["piecewise", "tanh-1e4"], [5.0])
    study["sweep"][0] |= changes
    assert is_wide(datasets(tmp_path, study, answer)[0]) == wide


def page_of(folder, files):
    responses, attractors = files
    compared, costs = agreement(*files), timing(responses)
    path = folder / "page" / "index.html"
    return write_report(path, Inputs(responses, costs, compared, attractors)).read_text()


def test_few_values_of_another_axis_have_curves_each_and_rows_of_their_own(forced, tmp_path):
    page = page_of(tmp_path, forced)
    assert 'id="overview"' in page
    assert 'id="scene-' not in page
    assert "figures over forcing frequency, for each of 2 values of forcing amplitude. ds." in page
    for force in FORCING:  # too few for an axis
        where = f"piecewise, K_c = 14000 N/m, gap 0.4/0.4 mm, forcing = {force:g} N"
        assert f"Peak displacement of every attractor: {where}" in page
    (part,) = sections(Inputs(forced[0], timing(forced[0]), agreement(*forced), forced[1]))
    (compared, costs) = part.tables
    rows = {row[0]: row[-1] for row in compared.rows}  # each scene's own
    for force in FORCING:
        assert rows[f"tanh-1e4, forcing = {force:g} N"] == "6 of 9"
        assert f"exact law, other settings, forcing = {force:g} N" in rows
    assert len(rows) == 4
    assert [row[-1] for row in costs.rows] == ["18"] * 3


def test_one_parameter_alone_is_a_bifurcation_diagram(forced):
    files = [ds.isel(omega=[0]) for ds in forced]
    (part,) = sections(Inputs(files[0], timing(files[0]), attractors=files[1]))
    figures = list(part.figures)
    said = [figure.description.partition(",")[0] for figure in figures]
    assert said == ["Bifurcation diagram", "Attractors and their basins"] * 2
    for figure in figures:
        (panel,) = (axes for axes in figure.figure.axes if axes.get_visible())
        assert panel.get_xlabel() == "forcing amplitude [N]"
    dots = figures[0].figure.axes[0].lines[2:]  # behind the walls
    assert sorted({x for line in dots for x in line.get_xdata()}) == list(FORCING)


def test_branches_along_a_parameter_lie_in_its_figures_and_have_a_table(forced):
    """Of the representation that is drawn, and only where they are along the axis."""
    files = [ds.isel(omega=[0]) for ds in forced]
    labels = files[0]["representation"].values[[0, 0]]
    found = branches([[1, 1, 0, 0]] * 2, [[0, 1, 0, 0]] * 2, representation=labels)
    found = found.rename(omega="forcing").assign_attrs(along="forcing")
    found["forcing"][:] = found["forcing"] - 4.0
    (part,) = sections(Inputs(files[0], timing(files[0]), None, files[1], branches=found))
    has_lines = ["dashed where unstable" in figure.caption for figure in part.figures]
    assert has_lines == [True, True, False, False]
    titles = [table.title for table in part.tables]
    assert "Special points of the branches" in titles
    for other in (found.assign_attrs(along="x_max"), None):
        (part,) = sections(Inputs(files[0], timing(files[0]), None, files[1], branches=other))
        assert [table.title for table in part.tables] == titles[:-1]


def test_many_starts_at_one_place_are_a_map_of_the_starts(tmp_path):
    study = tables(["piecewise"], [5.0])
    states = [[1e-5 * i, 1e-3 * k] for i in range(26) for k in range(20)]
    study["sweep"][0]["initial_condition"] = states
    responses, found = datasets(tmp_path, study, lambda *_: periodic([(1e-3, 0.0)], 5.0))
    (figure,) = next(sections(Inputs(responses, timing(responses), attractors=found))).figures
    axes = figure.figure.axes[0]
    assert axes.get_xlabel() == "initial displacement [mm]"
    assert axes.images[0].get_array().shape[:2] == (20, 26)
    assert figure.caption.endswith(
        "Class: periodic everywhere. Period: P1 everywhere. Attractor: 0 everywhere. "
        "Amplitude: 1 mm everywhere."
    )


def test_a_grid_of_starts_at_one_frequency_is_drawn_as_its_plane(tmp_path):
    study = tables(["piecewise", "tanh-1e4"], [5.0])
    states = [[1e-5 * i, 1e-3 * k] for i in range(6) for k in range(5)]
    study["sweep"][0]["initial_condition"] = states

    def two(label, omega, start):
        return periodic([(1e-3 * (1 + start % 2), 0.0)], omega)

    page = page_of(tmp_path, datasets(tmp_path, study, two))
    assert page.count("Attractor, peak: ") == 2
    assert "Extrema of the steady response" not in page


@pytest.mark.parametrize("stiffnesses", [[1.4e4, 2e4], [1.4e4, 1.40000001e4, 2e4]])
def test_planes_of_several_contacts_have_pictures_of_each(tmp_path, stiffnesses):
    study = tables(["piecewise"], [5.0])
    states = [[1e-5 * i, 1e-3 * k] for i in range(6) for k in range(5)]
    study["sweep"][0] |= {"initial_condition": states, "K_c": stiffnesses}
    page = page_of(tmp_path, datasets(tmp_path, study, answer))
    assert page.count("Attractor, peak: ") == len(stiffnesses)


def test_a_law_has_no_empty_pictures_where_it_was_not_swept(forced):
    responses, attractors = (ds.copy() for ds in forced)
    here = responses["representation"] == "tanh-1e4", responses["forcing"] == FORCING[1]
    is_left = here[0] & here[1]
    responses["status"] = responses["status"].where(~is_left, Status.NOT_REQUESTED)
    (part,) = sections(Inputs(responses, timing(responses), attractors=attractors))
    figures = list(part.figures)
    of_tanh = [one.description for one in figures if "tanh" in one.description]
    assert of_tanh
    assert all(f"forcing = {FORCING[0]:g} N" in said for said in of_tanh)


def test_coordinates_share_maps_of_classes_and_have_amplitudes_of_their_own(tmp_path):
    forces = (1.0, 2.0, 3.0, 4.0, 5.0)
    omega = np.arange(5.0, 10.0)
    study = tables(LABELS[2:], omega)
    responses, _ = over_forcing(tmp_path, study, answer, forces)
    names = ["amplitude", "x_max", "x_min", "extrema"]
    both = [responses[names]] * 2
    two = xr.concat(both, xr.DataArray(["q_1", "q_2"], dims=COORDINATE, name=COORDINATE))
    responses = responses.drop_vars(names).assign(two.transpose(..., COORDINATE))
    (figure,) = next(sections(Inputs(responses, timing(responses)))).figures
    labels = [axes.get_ylabel() for axes in figure.figure.axes if axes.get_label() == "<colorbar>"]
    assert [label.partition(":")[0] for label in labels] == ["q_1", "q_2"]
    assert figure.caption.startswith("Class, period, amplitude: tanh-1e4, K_c")


def test_scenes_with_swept_walls_of_one_distance_have_their_figures(tmp_path):
    split, _ = over_walls(tmp_path, LABELS[::2], OMEGA, J_1[:1], J_2[:1], answer)
    assert "K_c = 14000 N/m, gap 0.2/0.4 mm" in page_of(tmp_path, split)
    assert not is_wide(split[0])
