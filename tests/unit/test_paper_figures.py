"""The paper's figures: which are drawn, from what, and that nothing is lost or overprinted."""

import re

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose
from tests.builders.studies import PAPER
from tests.readers.figures import is_redrawn, overlaps
from workflows.paper import scenes
from workflows.paper.figures import LIMITS, band_rows, costs, figures, sections
from workflows.paper.ladders import ladders
from workflows.paper.measures import late_periods
from workflows.paper.paper_figures import diagram, histories_and_spectra, start_scan
from workflows.paper.refined import starts
from workflows.paper.static_figures import (
    CONSTRAINED,
    force_curves,
    static_convergence,
    unit_forces,
)

import gapsweep as gs
from gapsweep.analysis.claims import Run
from gapsweep.analysis.datasets import static as static_part
from gapsweep.analysis.datasets.histories import histories
from gapsweep.analysis.spectra import N_PERIODS, SAMPLES_PER_PERIOD
from gapsweep.report.figure_data import as_csv
from gapsweep.report.figures import bifurcation
from gapsweep.report.parts import rendered
from gapsweep.report.pictures import is_picture
from gapsweep.report.scenes import caption_of_starts
from gapsweep.report.style import MATPLOTLIB, colour
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

WEAK, STRONG = (("piecewise", *grade) for grade in (scenes.WEAK, scenes.STRONG))
OMEGA = np.arange(1.0, 31.0)
STARTS = ["fixed", "fixed", "sweep_up", "sweep_down"]
METRES = {"units": "m"}
SOFT_SWEEP = {
    "representation": ["piecewise"],
    "K_c": [1.4e4],
    "gap": [[4e-4, 4e-4]],
    "omega": [9.0],
}
PERIODIC, CHAOTIC = int(ResponseClass.PERIODIC), int(ResponseClass.CHAOTIC)


def responses_of(labels, K_c=(1.4e4,), gaps=((0.4, 0.4),)):
    """Made-up responses: peaks fall with frequency, a millimetre apart between labels."""
    dims = ("representation", "K_c", "gap", "omega", "initial_condition")
    sizes = (len(labels), len(K_c), len(gaps), OMEGA.size, len(STARTS))
    peak = np.broadcast_to(1e-3 / OMEGA[:, None], sizes).copy()
    peak += 1e-5 * np.arange(sizes[0])[:, None, None, None, None]
    extrema = np.stack([peak, -0.5 * peak, np.full(sizes, np.nan)], axis=-1)
    j_1, j_2 = 1e-3 * np.array(gaps).T
    return xr.Dataset(
        {
            "x_max": (dims, peak, METRES),
            "x_min": (dims, -0.5 * peak, METRES),
            "amplitude": (dims, 0.75 * peak, METRES),
            "period_multiple": (dims, np.ones(sizes, "i4")),
            "noise": (dims, np.full(sizes, 2e-6), METRES),
            "nfev": (dims, np.full(sizes, 500.0)),
            "cpu_time": (dims, np.full(sizes, 1e-3)),
            "t_simulated": (dims, np.broadcast_to(10.0 / OMEGA[:, None], sizes).copy()),
            "extrema": ((*dims, "extremum"), extrema, METRES),
            "response_class": (dims, np.full(sizes, PERIODIC, "i1")),
            "status": (dims, np.zeros(sizes, "i1")),
        },
        {
            "representation": list(labels),
            "K_c": list(K_c),
            "gap": [f"{a:g}/{b:g}" for a, b in gaps],
            "j_1": ("gap", j_1, METRES),
            "j_2": ("gap", j_2, METRES),
            "omega": OMEGA,
            "initial_condition": range(len(STARTS)),
            "x_0": ("initial_condition", [0.0, 4e-4, np.nan, np.nan]),
            "v_0": ("initial_condition", [0.0, 0.0, np.nan, np.nan]),
            "start": ("initial_condition", STARTS),
        },
    )


@pytest.fixture(autouse=True)
def report_style():
    with mpl.rc_context(MATPLOTLIB):
        yield


@pytest.fixture
def scene():
    return responses_of(WEAK).isel(K_c=0, gap=0)


@pytest.fixture(scope="module")
def kept():
    table = {"representation": list(LIMITS), "K_c": 1.4e6, "gap": [0.0, 8e-4], "t_end": 8.0}
    sweep = {"representation": ["piecewise"], "K_c": [1.4e6], "gap": [[0.0, 8e-4]]}
    tables = {
        "study": {"name": "kept"},
        "oscillator": PAPER,
        "sweep": [sweep | {"omega": [11.0]}],
        "history": [table | {"omega": omega} for omega in (11.0, 21.75)],
    }
    return histories(gs.Study.from_dict(tables))


def points(axes, label):
    """Displacements [mm] of all points drawn for a label."""
    lines = [line for line in axes.lines if to_hex(line.get_color()) == colour(label).lower()]
    return np.sort(np.concatenate([line.get_ydata() for line in lines]))


def drawn_of(responses, **more):
    return list(figures(Run({"responses": responses, **more})))


def numbers(responses, **more):
    return [re.match(r"Figure ([^.]+)\.", d.caption)[1] for d in drawn_of(responses, **more)]


def peaks(scene):
    """Peaks from the fixed initial conditions, those of the exact law behind the others."""
    panels = {law: [(one, (0, 1)) for one in dict.fromkeys((WEAK[0], law))] for law in WEAK}
    return diagram(scene, panels, 3, peaks=True)


def extrema(scene, at=0):
    return diagram(scene, {law: [(law, (at,))] for law in WEAK}, 1)


def overlay(limits, front, rear):
    hits = np.isin(OMEGA, OMEGA[[3, 7]])
    return diagram(limits, {"both": [(rear, (0,)), (front, (0,))]}, 1, ticks={"both": hits})


def test_no_text_lies_on_another(scene, kept):
    scene["status"][3, 2:9] = Status.UNRESOLVED
    scene["status"][3, 9:15] = Status.ERROR
    assert not overlaps(peaks(scene))
    assert not overlaps(extrema(scene))
    assert not overlaps(histories_and_spectra(kept))


def test_every_representation_has_its_peaks_before_those_of_the_exact_law(scene):
    fixed = scene["x_max"].isel(initial_condition=[0, 1])
    exact = np.sort(fixed.sel(representation="piecewise").values.ravel()) * 1e3
    for axes, label in zip(peaks(scene).axes, WEAK, strict=True):
        assert axes.get_title(loc="left") == label
        own = np.sort(fixed.sel(representation=label).values.ravel()) * 1e3
        assert_allclose(points(axes, label), own)
        assert_allclose(points(axes, "piecewise"), exact)


def test_peaks_far_above_the_exact_law_are_on_the_edge_of_a_linear_axis(scene):
    scene["x_max"][1, 3, 0] = 9e-3
    axes = peaks(scene).axes[1]
    ticks = [line for line in axes.lines if line.get_marker() == "|"]
    assert [line.get_xdata().tolist() for line in ticks] == [[OMEGA[3]]]
    assert axes.get_ylim()[1] < 2.0
    assert axes.get_yscale() == "linear"


def test_the_csv_of_a_figure_draws_it_again(scene, kept, limits):
    scene["x_max"][1, 3, 0] = 9e-3
    assert is_redrawn(peaks(scene))
    scene["response_class"][2, 4:6, 0] = CHAOTIC
    assert is_redrawn(extrema(scene))
    assert is_redrawn(overlay(limits.isel(K_c=0, gap=0), LIMITS[2], LIMITS[0]))
    assert is_redrawn(histories_and_spectra(kept))


def test_the_csv_names_law_class_and_axes(scene):
    scene["response_class"][1, 3] = CHAOTIC
    about, *rows = as_csv(peaks(scene)).splitlines()
    assert about == "# panel 1: piecewise; x: forcing frequency [Hz]; y: peak displacement [mm]"
    law = WEAK[1]
    chaotic = [row for row in rows if row.startswith(f'2,"{law}, not periodic",point,4,')]
    heights = {float(row.split(",")[-2]) for row in chaotic}
    assert heights == {float(f"{1e3 * x:.6g}") for x in scene["x_max"].values[1, 3, :2]}


def test_every_extremum_is_drawn_from_its_initial_condition(scene):
    scene["extrema"][..., 1, :] *= 0.5
    for at in (0, 1):
        for axes, label in zip(extrema(scene, at).axes, WEAK, strict=True):
            own = scene["extrema"].sel(representation=label).isel(initial_condition=at)
            heights = own.values.ravel() * 1e3
            assert_allclose(points(axes, label), np.sort(heights[np.isfinite(heights)]))


def test_shades_say_the_class(scene):
    scene["response_class"][2, 4:6] = CHAOTIC
    scene["response_class"][2, 10] = ResponseClass.UNRESOLVED
    bars = extrema(scene).axes[2].patches
    spans = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in bars]
    assert spans == [(4.5, 5.5), (5.5, 6.5), (10.5, 11.5)]
    shades = [bar.get_facecolor() for bar in bars]
    assert shades[0] == shades[1] != shades[2]


def test_a_band_says_what_any_start_finds(scene):
    scene["response_class"][2, 4, 1] = CHAOTIC
    scene["response_class"][2, 4:6, 2] = ResponseClass.UNRESOLVED
    bars = bifurcation(scene).axes[2].patches
    assert [(bar.get_label(), bar.get_x()) for bar in bars] == [
        ("_chaotic", 4.5),
        ("_unresolved", 5.5),
    ]


@pytest.fixture
def limits():
    return responses_of(LIMITS, K_c=(1.4e6,), gaps=[(0.0, 0.8)])


def test_an_overlay_has_the_law_behind_larger_and_ticks_where_they_differ(limits):
    one = limits.isel(K_c=0, gap=0)
    front, rear = LIMITS[2], LIMITS[0]
    (axes,) = overlay(one, front, rear).axes
    sizes = {}
    for line in axes.lines:
        if len(line.get_xdata()) > 2:
            sizes[to_hex(line.get_color())] = line.get_markersize()
    assert sizes[colour(rear).lower()] > 1.5 * sizes[colour(front).lower()]
    assert list(sizes) == [colour(rear).lower(), colour(front).lower()]
    extrema = one["extrema"].sel(representation=front).isel(initial_condition=0).values.ravel()
    assert_allclose(points(axes, front), 1e3 * np.sort(extrema[np.isfinite(extrema)]))
    assert [path[0, 0] for path in axes.collections[0].get_segments()] == OMEGA[[3, 7]].tolist()


def test_figure_10_counts_where_peak_and_trough_are_the_same(limits):
    limits["x_max"][:] = limits["x_max"][0]
    limits["x_max"][1, ..., 4:7, 0] += 1e-4  # from rest, without events
    limits["x_min"][1, ..., 7:13, 1] = np.nan  # from +0.4 mm: no response is not the same
    (drawn,) = drawn_of(limits)
    counted = r"(\d+) % \(piecewise-noevents on piecewise, from ([^)]+)\)"
    shares = {start: share for share, start in re.findall(counted, drawn.caption)}
    assert shares == {"rest": "90", "+0.4 mm": "80"}
    assert not overlaps(drawn.figure)


def test_figure_10_needs_all_its_laws_but_not_the_tight_solver(limits):
    assert numbers(limits) == ["10"]
    assert numbers(limits.isel(representation=[0, 1, 2])) == []
    labels = [f"{law}@paper" for law in LIMITS]
    assert numbers(limits.assign_coords(representation=labels)) == ["10, their solver"]


def test_histories_show_six_periods_and_the_lines_of_the_spectrum(kept):
    axes = histories_and_spectra(kept).axes
    assert len(axes) == 2 * kept.sizes["history"]
    for h, (motion, spectrum) in enumerate(zip(axes[::2], axes[1::2], strict=True)):
        own = motion.lines[-len(LIMITS) :]
        shades = [to_hex(line.get_color()) for line in own]
        assert shades == [colour(law).lower() for law in LIMITS]
        assert own[0].get_linewidth() > own[1].get_linewidth() > own[2].get_linewidth()
        t, x = own[0].get_data()
        assert_allclose((t[0], t[-1]), (0.0, 6.0), atol=0.01)
        steady = kept["x"].sel(representation="piecewise", part="steady").values[h]
        assert_allclose(x, steady[-t.size :] * 1e3)
        multiple, amplitude = spectrum.lines[0].get_data()
        forced = np.argmin(np.abs(multiple - 1.0))
        assert_allclose(amplitude[forced], kept["spectrum"].values[h, 0, forced] * 1e3)


def test_a_failed_history_leaves_the_others(kept):
    failed = kept.copy(deep=True)
    failed["x"][0, 1] = np.nan
    failed["spectrum"][0, 1] = np.nan
    assert not overlaps(histories_and_spectra(failed))


def test_figures_are_those_the_run_has_points_for(kept):
    assert numbers(responses_of(WEAK)) == ["6b", "8b"]
    gaps = [(1.1, 1.1), (1.5, 1.5), (0.0, 0.8)]
    assert numbers(responses_of(WEAK, gaps=gaps)) == ["6a", "6a, smallest gap", "6c"]
    assert numbers(responses_of(WEAK, K_c=(1.4e3, 1.4e6))) == ["8a", "8c"]
    assert numbers(responses_of(STRONG, gaps=[(0.0, 0.8)])) == ["7"]
    assert numbers(responses_of(STRONG, K_c=(1.4e6,))) == ["9"]
    hard = responses_of(LIMITS, K_c=(1.4e6,), gaps=[(0.0, 0.8)])
    paper = kept.assign_coords(representation=[f"{law}@paper" for law in LIMITS])
    assert numbers(hard, histories=paper) == ["10", "11, their solver"]
    assert numbers(responses_of(WEAK, K_c=(2e4,))) == []


def test_captions_compare_frequencies_with_those_of_the_paper():
    responses = responses_of(WEAK, K_c=(1.4e4, 1.4e6))
    period, trough = responses["period_multiple"], responses["x_min"]
    period.loc[
        {"representation": "logarctan-1e4", "omega": [22.0, 26.0], "initial_condition": 0}
    ] = 3
    trough.loc[
        {"representation": "ratpoly-5/3", "omega": slice(3.0, 7.0), "initial_condition": 0}
    ] = -1.0
    drawn = {d.name: d.caption for d in drawn_of(responses)}
    assert "Here period 3 (number of frequencies): log-arctan 22-26 Hz (2)." in drawn["Fig. 6b"]
    for start, found in (("rest", "RatPoly 5/3 3-7 Hz (5)"), ("+0.4 mm", "none")):
        words = f"negative mean from {start} (number of frequencies): {found}."
        assert words in drawn["Fig. 8c"]
        assert words not in drawn["Fig. 8b"]


def test_the_bands_come_first_and_empty_sections_are_left_out():
    (drawn,) = rendered(sections(Run({"responses": responses_of(WEAK)})))
    assert drawn["anchor"] == "paper"
    (table,) = drawn["tables"]
    assert {row[0] for row in table["rows"]} == {"6b", "8b"}
    assert [is_picture(each["svg"]) for each in drawn["figures"]] == [True] * 2
    few = Run({"responses": responses_of(["poly-5"], K_c=(2e4,))})
    assert rendered(sections(few)) == []


def test_bands_are_the_frequencies_found_from_both_initial_conditions():
    responses = responses_of(WEAK)
    responses["period_multiple"][0, ..., 16:20, 1] = 3  # from +0.4 mm
    responses["period_multiple"][0, ..., 18, :2] = 3
    responses["status"][2, ..., 1] = Status.NOT_REQUESTED
    lows = {"low": 15.0, "high": 25.0, "peak": 10.0}
    shape = (len(WEAK), 2)
    ends = {name: (("representation", "start"), np.full(shape, f)) for name, f in lows.items()}
    bands = xr.Dataset(ends, {"representation": list(WEAK), "start": list(scenes.STARTS)})
    bands["low"][1] = np.nan
    bands["peak"][0, 0] = 11.0
    found = band_rows(Run({"responses": responses, "bands": bands}))
    rows = {tuple(row[:4]): row[4:] for row in found}
    three = "8b", "subharmonic 17-21", "period 3"
    assert rows[*three, "+0.4 mm"] == ["17\u201120", *5 * ["–"]]
    assert rows[*three, "rest"] == ["19", *5 * ["–"]]
    widest = rows["8b", "subharmonic 17-21", "period 3, widest, bisected", "rest"]
    assert widest[:2] == ["15.00\u201125.00", "–"]
    peaks = [rows["8b", "primary peak", "jump, bisected", name][0] for name in scenes.STARTS]
    assert peaks == ["11.00", "10.00"]
    assert not any(row[0] == "9" for row in found)  # the hard contact was not swept


def test_a_scan_finds_rest_without_period_3_and_the_released_mass_with_it_in_the_band():
    found = starts(
        gs.Study.from_dict({"study": {"name": "scan"}, "oscillator": PAPER, "sweep": [SOFT_SWEEP]})
    )
    shares = {
        name: [float(found[share].sel(x_0=x, v_0=v, method="nearest")) for share in found]
        for name, (x, v) in scenes.STARTS.items()
    }
    assert shares["rest"] == [0.0, 0.0]
    assert shares["+0.4 mm"][0] > 0.75
    assert shares["+0.4 mm"][1] == 0.0
    # An independent integration found the ends of the band: 17.4 to 20.6 Hz, and 17.0 Hz.
    assert_allclose(shares["+0.4 mm"][0], (33 + 1) / 41, atol=0.06)
    figure = start_scan(found)
    assert not overlaps(figure)
    everywhere = figure.axes[1].lines[0].get_xydata()
    assert_allclose(sorted(everywhere[:, 1]), sorted(100.0 * found["inside"].values.ravel()))


@pytest.mark.extended
def test_figure_2c_has_both_stiffnesses_and_figure_5_its_ladders():
    study = gs.Study.from_dict(
        {"study": {"name": "forces"}, "oscillator": PAPER, "sweep": [SOFT_SWEEP]}
    )
    static = static_part.static(study).sel(gap="0.4/0.4")
    hard, soft = 1.4e6, 1.4e3
    forces = unit_forces(static, ("poly-13", "poly-13" + CONSTRAINED))
    figure = force_curves(static, forces, (hard, soft))
    assert not overlaps(figure)
    gap = gs.Gap(4e-4, 4e-4)
    for row, K_c in zip(np.reshape(figure.axes, (2, 2)), (hard, soft), strict=True):
        x, force = row[0].lines[1].get_data()
        law = gs.contact_law("poly-13", K_c, gap)
        assert_allclose(force, law.force(1e-3 * x), atol=1e-9 * K_c)
        _, error = row[1].lines[1].get_data()
        x = static["x"].values
        assert_allclose(error, law.force(x) - gs.Piecewise(K_c, gap).force(x), atol=1e-9 * K_c)
    x, constrained = 1e-3 * x, figure.axes[0].lines[2]
    middle = np.interp([-1e-3, 0.0, 1e-3], *constrained.get_data()) / hard  # at 1 µm
    assert_allclose(middle, 0.0, atol=1e-7)  # neither a constant nor a linear term
    assert not overlaps(static_convergence(ladders(study).sel(gap="0.4/0.4")))


def test_costs_are_those_of_a_forcing_period_however_long_the_run():
    responses = responses_of([f"{law}@paper" for law in WEAK])
    responses["nfev"][3] *= 2.0
    responses["t_simulated"][3] *= 4.0
    (table,) = costs(Run({"responses": responses}))
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["piecewise"] == ["50", "1", "100", "1", "48.7", "1"]
    assert rows["tanh-1e4"] == ["25", "0.5", "25", "0.25", "7.66", "0.157"]
    without = responses.isel(representation=[0, 1, 2, 4, 5])
    (table,) = costs(Run({"responses": without}))
    assert "tanh-1e4" not in {row[0] for row in table.rows}


def test_a_figure_needs_the_exact_law_and_half_of_the_representations():
    assert numbers(responses_of(WEAK[1:])) == []
    assert numbers(responses_of(WEAK[:2])) == []
    assert numbers(responses_of(WEAK[:3])) == ["6b", "8b"]


def test_a_diagram_needs_one_of_the_initial_conditions_of_the_paper():
    assert numbers(responses_of(WEAK).isel(initial_condition=[2, 3])) == []
    assert numbers(responses_of(WEAK).isel(initial_condition=[1, 2])) == ["6b", "8b"]
    elsewhere = responses_of(WEAK).assign_coords(x_0=("initial_condition", [1e-3] * 4))
    assert numbers(elsewhere) == ["6b"]


def test_diagrams_have_a_column_for_each_initial_condition():
    _, diagrams = drawn_of(responses_of(WEAK))
    titles = [axes.get_title(loc="left") for axes in diagrams.figure.axes]
    assert titles[:4] == [f"{law}, from {at}" for law in WEAK[:2] for at in ("+0.4 mm", "rest")]
    assert len(titles) == 12
    assert not overlaps(diagrams.figure)


def test_diagrams_are_drawn_for_the_tight_solver_and_for_the_papers():
    labels = [*WEAK, *(f"{label}@paper" for label in WEAK), "piecewise@half"]
    assert numbers(responses_of(labels)) == ["6b", "8b", "8b, their solver"]
    drawn = drawn_of(responses_of(labels))
    assert ["solver" in one.caption for one in drawn] == [False, False, True]


def test_points_not_asked_for_are_left_out():
    responses = responses_of(WEAK)
    responses["status"][5] = Status.NOT_REQUESTED
    responses["status"][:, :, :, 20:] = Status.NOT_REQUESTED
    first = drawn_of(responses)[0]
    assert len(first.figure.axes) == 5
    assert first.figure.axes[0].get_xlim()[1] < 21.0
    assert "200 points." in first.caption  # of the fixed initial conditions


def test_captions_count_what_has_no_response():
    responses = responses_of(WEAK)
    responses["status"][1, :, :, :5] = Status.UNRESOLVED
    responses["status"][2] = Status.ERROR
    responses["x_max"][2] = np.nan
    first = drawn_of(responses)[0]
    assert "10 unresolved, 60 failed" in first.description


def test_a_scene_without_any_result_draws(scene, tmp_path):
    for name in ("x_max", "x_min", "extrema"):
        scene[name][:] = np.nan
    peaks(scene).savefig(tmp_path / "peaks.png", dpi=30)
    extrema(scene).savefig(tmp_path / "stack.png", dpi=30)


@pytest.mark.parametrize("n_kept", [60, 59, 31, 8])
@pytest.mark.parametrize(
    ("motion", "period"),
    [
        (lambda t: np.cos(2 * np.pi * t), 1),
        (lambda t: np.cos(2 * np.pi * t) + 0.5 * np.sin(np.pi * t), 2),  # alike at whole periods
        (lambda t: np.cos(2 * np.pi * t) + 0.5 * np.sin(2 * np.pi * t / 3), 3),
        (lambda t: np.cos(2 * np.pi * t) + 0.01 * np.sin(np.pi * t), 1),  # less than a plot shows
        (lambda t: np.cos(2 * np.pi * t) + t, 0),
        (lambda t: np.full(t.size, np.nan), 0),
    ],
)
def test_the_period_at_the_end_of_a_history_is_what_a_plot_shows(motion, period, n_kept):
    x = np.full(N_PERIODS * SAMPLES_PER_PERIOD, np.nan)
    here = slice(n_kept * SAMPLES_PER_PERIOD)
    x[here] = 1e-3 * motion(np.arange(x[here].size) / SAMPLES_PER_PERIOD)
    dims = ("history", "representation", "part", "sample")
    history = xr.Dataset(
        {"x": (dims, x[None, None, None])},
        {"part": ["steady"], "j_1": ("history", [4e-4]), "j_2": ("history", [4e-4]),
         "n_periods": ("history", [n_kept])},
    )  # fmt: skip
    assert late_periods(history).tolist() == [[period]]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"a": ["1", "1"], "b": ["1", "1"]}, ""),
        ({"a": ["12", "12"], "b": ["12", "12"]}, " from 2 initial conditions"),
        ({"a": ["1", "123"], "b": ["1", "123"]}, " from 1 to 3 initial conditions per frequency"),
        ({"a": ["1", "2"], "b": ["1", "2"]}, " from 1 of 2 initial conditions per frequency"),
        (
            {"a": ["12", "12"], "b": ["1", "1"]},
            ", of b from 1 initial condition, of a from 2 initial conditions",
        ),
        (
            {"a": ["12", "12"], "b": ["12", "12"], "c": ["1", ""]},
            ", of c from 1 initial condition, of the other laws from 2 initial conditions",
        ),
    ],
)
def test_captions_say_how_many_starts_there_are(asked, said):
    wanted = [[[str(n) in at for n in (1, 2, 3)] for at in of_law] for of_law in asked.values()]
    status = np.where(wanted, Status.OK, Status.NOT_REQUESTED)
    dims = ("representation", "omega", "initial_condition")
    scene = xr.Dataset({"status": (dims, status)}, {"representation": list(asked)})
    assert caption_of_starts(scene) == said
