"""Figures of nonlinear dynamics: what is drawn against motions simulated here."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from tests.builders.datasets import datasets, datasets_by_place, tables
from tests.builders.studies import PAPER
from tests.readers.figures import overlaps

import gapsweep as gs
import gapsweep.report.accessor  # plain xarray.load_dataset does not bring it along
from gapsweep.analysis.datasets.histories import histories
from gapsweep.report.inputs import Inputs
from gapsweep.report.maps import picture
from gapsweep.report.marks import marks_of
from gapsweep.report.sections import contact_losses, findings
from gapsweep.report.style import NOT_PERIODIC

mpl.use("Agg")
OSCILLATOR, LAW = gs.systems.paper_oscillator(), gs.Piecewise(1.4e6, gs.Gap(4e-4, 4e-4))
# Chaos, an orbit that strikes both walls, three and two periods, free motion within the gap.
OMEGA = [6.0, 8.0, 11.0, 12.75, 14.0]
PERIODS = [0, 1, 3, 2, 1]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    study = tables(["piecewise"], OMEGA)
    study["sweep"][0]["K_c"] = [1.4e6]
    folder = tmp_path_factory.mktemp("made")
    return datasets(folder, study, lambda _, omega, __: gs.respond(OSCILLATOR, LAW, omega))


@pytest.fixture(scope="module")
def responses(files):
    return files[0]


@pytest.fixture(scope="module")
def settled():
    """Motions from rest, by frequency, over 2,400 forcing periods: the last 24 are looked at."""
    return {
        omega: gs.simulate(OSCILLATOR, LAW, omega, n_periods=2400, dense_output=True)
        for omega in OMEGA
    }


@pytest.fixture
def ax():
    return Figure(figsize=(6.0, 4.0), layout="constrained").subplots()


def points(axes, shade=None):
    """All points of an axes but walls and legend entries, sorted."""
    lines = [ln for ln in axes.lines if ln.get_linestyle() != "--" and ln.get_label()[:1] == "_"]
    chosen = [ln for ln in lines if shade in (None, to_hex(ln.get_color()))]
    pairs = np.concatenate([np.column_stack(ln.get_data()) for ln in chosen])
    return pairs[np.lexsort(pairs.T[::-1])]


def test_a_response_of_period_n_has_n_section_points_where_its_motion_settles(
    responses, settled, ax
):
    assert responses.gapsweep.bifurcation("section_x", ax=ax) is ax
    drawn = points(ax)
    for omega, n in zip(OMEGA[1:], PERIODS[1:], strict=True):
        x = np.unique(drawn[drawn[:, 0] == omega, 1])
        assert len(x) == n
        assert_allclose(x, np.sort(1e3 * settled[omega].section[-n:, 0]), atol=1e-5)
    chaotic = points(ax, NOT_PERIODIC)
    assert set(chaotic[:, 0]) == {6.0}
    assert len(chaotic) == 32  # those that are stored
    assert (ax.get_xlabel(), ax.get_ylabel()) == (
        "forcing frequency [Hz]",
        "section displacement [mm]",
    )
    assert overlaps(ax.figure) == []


def test_exponents_are_those_of_the_monodromy_and_chaos_lies_above_zero(responses, ax):
    responses.gapsweep.lyapunov(ax=ax)
    drawn = {line.get_label(): line.get_data() for line in ax.lines}
    periodic, chaotic = drawn["piecewise"], drawn["piecewise, not periodic"]
    omega, n = 12.75, 2
    start = responses.sel(omega=omega).squeeze()
    state = [float(start[name][0]) for name in ("section_x", "section_v")]
    run = gs.simulate(OSCILLATOR, LAW, omega, *state, n_periods=n, tangent=True)
    rate = np.log(np.abs(np.linalg.eigvals(run.monodromy)).max()) * omega / n
    at = periodic[0].tolist().index(omega)
    assert periodic[1][at] == pytest.approx(rate, rel=1e-3)
    assert (periodic[1] < 0.0).all()
    assert chaotic[0].tolist() == [6.0]
    (bar,) = (line.get_ydata()[:2] for line in ax.lines if np.isnan(line.get_ydata()[-1:]).any())
    assert bar[0] > 0.0  # even three standard errors lower
    error = responses["lyapunov_error"].sel(omega=6.0).item()
    assert bar - chaotic[1] == pytest.approx([-3.0 * error, 3.0 * error])
    assert 0.0 in [line.get_ydata()[0] for line in ax.lines]
    assert ax.get_ylabel() == "largest Lyapunov exponent [1/s]"


def test_the_contact_force_is_that_of_the_law_where_the_motion_turns(responses, settled, ax):
    responses.gapsweep.frequency_response("force_max", ax=ax)
    (line,) = (line for line in ax.lines if len(line.get_xdata()))
    drawn = {x: y for x, y in zip(*line.get_data(), strict=True) if np.isfinite(x)}
    for omega in OMEGA[1:]:
        extrema = settled[omega].extrema[-24:]
        assert drawn[omega] == pytest.approx(np.abs(LAW.force(extrema)).max(), rel=1e-6)
    assert drawn[14.0] == 0.0
    assert ax.get_ylabel() == "largest contact force [N]"


def test_impact_speeds_are_slopes_of_the_displacement_where_it_passes_a_wall(
    responses, settled, ax
):
    responses.gapsweep.impacts(n_periods=8, ax=ax)
    drawn, h = points(ax), 1e-8
    for omega, n in zip(OMEGA[1:4], PERIODS[1:4], strict=True):
        run = settled[omega]
        times = run.t_contacts[run.t_contacts > run.t_end - (n + 1e-6) / omega]
        times = times[times < run.t_end - 1e-6 / omega]
        slopes = (run.sample(times + h)[0] - run.sample(times - h)[0]) / (2.0 * h)
        outwards = np.sign(slopes) == np.sign(run.sample(times)[0])
        expected = np.sort(1e3 * np.abs(slopes[outwards]))
        assert_allclose(drawn[drawn[:, 0] == omega, 1], expected, rtol=1e-4)
    assert np.sum(drawn[:, 0] == 8.0) == 2  # a wall each
    assert not np.any(drawn[:, 0] == 14.0)
    assert set(points(ax, NOT_PERIODIC)[:, 0]) == {6.0}
    assert ax.get_ylabel() == "impact speed [mm/s]"


DAMPINGS = [0.0, 60.0]


@pytest.fixture(scope="module")
def lossy(tmp_path_factory):
    study = tables(["piecewise"], [9.0])
    study["sweep"][0] |= {"K_c": [1.4e5], "damping": DAMPINGS}

    def response(place):
        law = gs.Piecewise(1.4e5, gs.Gap(4e-4, 4e-4), damping=DAMPINGS[place["damping"]])
        return gs.respond(OSCILLATOR, law, 9.0)

    folder = tmp_path_factory.mktemp("lossy")
    return datasets_by_place(folder, gs.Study.from_dict(study), response)[0]


def test_the_forcing_supplies_what_damping_and_contacts_lose(lossy):
    for damping in DAMPINGS:
        one = lossy.sel(damping=damping).squeeze()
        law = gs.Piecewise(1.4e5, gs.Gap(4e-4, 4e-4), damping=damping)
        state, n = [float(one[f"section_{name}"][0]) for name in "xv"], int(one["period_multiple"])
        run = gs.simulate(OSCILLATOR, law, 9.0, *state, n_periods=n, dense_output=True)
        t = run.t_end * (np.arange(200_000) + 0.5) / 200_000  # midpoints
        _, v = run.sample(t)
        c = 2.0 * OSCILLATOR.zeta * OSCILLATOR.mass * 2.0 * np.pi * OSCILLATOR.omega_n
        power = OSCILLATOR.forcing * np.cos(2.0 * np.pi * 9.0 * t) * v - c * v**2
        lost = lossy.gapsweep.with_losses()["energy_lost"].sel(damping=damping).item()
        worked = np.mean(OSCILLATOR.forcing**2) / c
        assert lost == pytest.approx(power.mean() / 9.0, rel=1e-6, abs=1e-9 * worked)
        assert (lost > 1e-4) == (damping > 0.0)


def test_the_area_of_a_loop_is_the_energy_in_its_legend(lossy, ax):
    lossy.gapsweep.force_loop(damping=60.0, ax=ax)
    (marks,) = marks_of(ax)
    x, force = 1e-3 * np.asarray(marks.x), np.asarray(marks.y)
    area = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(x))
    (words,) = (text.get_text() for text in ax.get_legend().get_texts())
    n = int(lossy["period_multiple"].sel(damping=60.0).item())
    assert float(words.split()[1]) == pytest.approx(area / n, rel=1e-2)
    assert force.max() == pytest.approx(lossy["force_max"].sel(damping=60.0).item(), rel=1e-3)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("displacement [mm]", "contact force [N]")
    assert "damping = 60 N s/m" in ax.get_title(loc="left")
    with pytest.raises(gs.DatasetError, match=r"damping: .* choose: damping=0"):
        lossy.gapsweep.force_loop(ax=ax)


def test_the_report_lists_the_energy_of_contacts_that_lose_any(lossy):
    (part,) = contact_losses.sections(Inputs(lossy, lossy))
    (row,) = next(iter(part.tables)).rows
    lost = lossy.gapsweep.with_losses()["energy_lost"].sel(damping=60.0).item()
    assert row[0] == "piecewise, damping = 60 N s/m"
    assert float(row[2]) == pytest.approx(lost, rel=5e-3)
    n = lossy["contacts_per_period"].sel(damping=60.0).item()
    assert float(row[3]) == pytest.approx(lost / n, rel=5e-3)
    (figured,) = part.figures
    assert len(marks_of(figured.figure.axes[0])) == 1
    elastic = lossy.isel(damping=[0])
    assert [*contact_losses.sections(Inputs(elastic, elastic))] == []
    own = lossy.assign_coords(representation=["module:spring"])  # never imported
    assert [*contact_losses.sections(Inputs(own, own))] == []


E, GAP, STRIKES, FREE = 0.8, 4e-4, 9.0, 14.0


@pytest.fixture(scope="module")
def rigid(tmp_path_factory):
    study = tables([f"rigid-{E}"], [STRIKES, FREE])
    law = gs.Rigid(gs.Gap(GAP, GAP), restitution=E)
    folder = tmp_path_factory.mktemp("rigid")
    return datasets(folder, study, lambda _, omega, __: gs.respond(OSCILLATOR, law, omega))[0]


def speeds_of_impacts(x, v):
    """Speeds [m/s] of all impacts of a forcing period, by scipy with an event at each."""
    o, rate, t, found = OSCILLATOR, 2.0 * np.pi * STRIKES, 0.0, []
    rate_n = 2.0 * np.pi * o.omega_n

    def slope(t, y):
        spring = rate_n**2 * y[0] + o.alpha / o.mass * y[0] ** 3
        return y[1], o.forcing / o.mass * np.cos(rate * t) - 2.0 * o.zeta * rate_n * y[1] - spring

    def meets(t, y):
        return GAP - abs(y[0])

    meets.terminal, meets.direction = True, -1.0
    while t < 1.0 / STRIKES:
        run = solve_ivp(slope, (t, 1.0 / STRIKES), (x, v), events=meets, rtol=1e-11, atol=1e-15)
        t, (x, v) = run.t[-1], run.y[:, -1]
        if run.status == 1:
            found.append(abs(v))
            x, v = np.copysign(GAP * (1.0 - 1e-14), x), -E * v
    return np.sort(found)


def test_energy_and_impact_speeds_on_rigid_walls(rigid, ax):
    """The report has no loop of an infinite force."""
    one = rigid.sel(omega=STRIKES).squeeze()
    assert int(one["period_multiple"]) == 1
    speeds = speeds_of_impacts(*(float(one[f"section_{name}"][0]) for name in "xv"))
    (part,) = contact_losses.sections(Inputs(rigid, rigid))
    (row,) = next(iter(part.tables)).rows
    lost = 0.5 * OSCILLATOR.mass * (1.0 - E**2) * np.sum(speeds**2)
    assert row[0] == f"rigid-{E}"
    assert f"omega = {STRIKES:g} Hz" in row[1]
    assert float(row[2]) == pytest.approx(lost, rel=5e-3)
    assert float(row[3]) == pytest.approx(lost / speeds.size, rel=5e-3)
    assert [*part.figures] == []
    rigid.gapsweep.impacts(ax=ax)
    assert_allclose(points(ax), [(STRIKES, 1e3 * u) for u in speeds], rtol=1e-5)


def test_an_impact_on_a_rigid_wall_touches_it(rigid, ax):
    """It takes no time, and the motion does not pass the wall."""
    (part,) = findings.sections(Inputs(rigid, rigid))
    said = " ".join(part.sentences)
    assert "touches a wall in 1 of 2" in said
    assert "never reached" not in said
    two = rigid.isel(K_c=[0, 0]).assign_coords(K_c=[1.0, 2.0])  # a map has two axes
    two.gapsweep.contact_map(y="K_c", ax=ax)
    named = {text.get_text() for text in ax.get_legend().get_texts()}
    assert named == {"both walls", "no wall"}


def test_a_section_has_as_many_points_as_asked_for_or_one_for_each_period(responses, ax):
    responses.gapsweep.poincare(omega=6.0, n_points=700, ax=ax)
    one = responses.sel(omega=6.0).squeeze()
    start = float(one["section_x"][0]), float(one["section_v"][0])
    run = gs.simulate(OSCILLATOR, LAW, 6.0, *start, n_periods=700)
    assert_allclose(np.column_stack(ax.lines[0].get_data()), 1e3 * run.section)
    # The points that are stored are the first ones.
    stored = np.column_stack([one["section_x"], one["section_v"]])
    assert_allclose(1e-3 * np.column_stack(ax.lines[0].get_data())[:5], stored[1:6], rtol=1e-4)
    three = Figure().subplots()
    responses.gapsweep.poincare(omega=11.0, ax=three)
    x, _ = three.lines[0].get_data()
    assert_allclose(np.sort(x), np.sort(1e3 * responses["section_x"].sel(omega=11.0).squeeze()[:3]))
    assert ax.get_title(loc="left").endswith("omega = 6 Hz")


def test_an_attractor_has_the_section_of_the_responses_that_end_on_it(files, ax):
    responses, attractors = files
    attractors.isel(attractor=0).gapsweep.poincare(omega=11.0, ax=ax)
    x = responses["section_x"].sel(omega=11.0).squeeze()[:3]
    assert_allclose(np.sort(ax.lines[0].get_xdata()), np.sort(1e3 * x), rtol=1e-6)
    with pytest.raises(gs.DatasetError, match=r"attractor: .* room for one .*isel\(attractor=0\)"):
        attractors.isel(attractor=[0, 0]).gapsweep.poincare(omega=11.0)


def test_the_mean_displacement_of_a_loaded_oscillator_is_in_no_spectrum(tmp_path, ax):
    """In a linear spring within a wide gap: only the forcing is left."""
    model = gs.systems.paper_oscillator(alpha=0.0, mean_load=100.0)
    block = {"representation": "piecewise", "K_c": 1.4e4, "gap": [1.0, 1.0], "omega": [7.0]}
    table = {"oscillator": PAPER | {"alpha": 0.0, "mean_load": 100.0}, "sweep": [block]}
    ds = made(tmp_path, table, model, gs.Piecewise(1.4e4, gs.Gap(1.0, 1.0)))
    assert ds["x_min"].item() > 10.0 * ds["amplitude"].item()
    ds.gapsweep.waterfall(ax=ax)
    ((frequency, height),) = ridges(ax)
    assert np.abs(frequency[height > 0.0] - 7.0).max() < 1.01 * 7.0 / 60
    assert float(ax.texts[1].get_text().split()[0]) == pytest.approx(
        1e3 * ds["amplitude"].item(), rel=0.05
    )


def ridges(axes):
    """Frequencies and heights of every line of a waterfall, from below."""
    lines = [(each.x, each.y) for each in marks_of(axes) if each.colour == "#000000"]
    return lines[::-1]  # the lowest is in front


def test_spectra_have_their_lines_at_the_forcing_and_its_fractions(responses, ax):
    responses.gapsweep.waterfall(ax=ax)
    rows = ridges(ax)
    assert len(rows) == len(OMEGA)
    assert [text.get_text() for text in ax.get_yticklabels()] == ["6", "8", "11", "12.75", "14"]
    for number, (omega, n) in enumerate(zip(OMEGA, PERIODS, strict=True)):
        frequency, height = rows[number]
        assert height.min() == number  # what is small is flat
        if not n:
            continue
        lines = frequency[height > number]
        # Hann: half the amplitude in the two adjacent bins.
        off = np.abs(lines - np.rint(n * lines / omega) * omega / n)
        assert off.max() < 1.01 * omega / 60
        assert np.any(np.abs(lines - omega / n) < 1e-9)
    # Free motion within the gap is nearly harmonic.
    frequency, height = rows[-1]
    assert frequency[height.argmax()] == pytest.approx(14.0)
    assert overlaps(ax.figure) == []


def test_heights_of_a_waterfall_are_logarithms_of_amplitudes(responses, ax):
    """The free motion is nearly harmonic: its line is as high as its amplitude."""
    responses.gapsweep.waterfall(omega=[8.0, 14.0], ax=ax)
    lowest, free = (max(height) for _, height in ridges(ax))
    words = [text.get_text() for text in ax.texts]
    floor, top = (float(text.split()[0]) for text in words)
    assert top / floor == pytest.approx(1e3, rel=0.05)
    amplitude = 1e3 * responses["amplitude"].sel(omega=14.0).item()
    (bar,) = [line.get_ydata() for line in ax.lines if line.get_color() == "black"]
    rise = np.ptp(bar) / np.log10(top / floor)
    assert lowest == pytest.approx(np.ptp(bar))  # the highest of all
    assert free - 1.0 == pytest.approx(rise * np.log10(amplitude / floor), abs=0.05)


def test_stored_spectra_are_drawn_as_they_are(ax):
    study = tables(["piecewise"], [9.0])
    study["history"] = [
        {"representation": ["piecewise"], "K_c": 1.4e4, "gap": [4e-4, 4e-4], "start": [0, 0],
         "omega": omega, "t_end": 40.0}
        for omega in (9.0, 7.0)
    ]  # fmt: skip
    stored = histories(gs.Study.from_dict(study))
    stored.gapsweep.waterfall(ax=ax)
    # In the order of the frequency, not of the tables.
    assert [f[h.argmax()] for f, h in ridges(ax)] == pytest.approx([7.0, 9.0])
    with pytest.raises(gs.DatasetError, match=r"omega: .* room for one value .* 7, 9; choose"):
        stored.gapsweep.waterfall(along="x_0")


def test_cells_of_the_regime_map_are_the_classes_of_their_responses(tmp_path):
    forcing = [2.0, 4.0, 8.0]
    study = tables(["piecewise"], OMEGA[:3])
    study["sweep"][0] |= {"K_c": [1.4e6], "forcing": forcing}

    def response(place):
        model = gs.systems.paper_oscillator(forcing=forcing[place["forcing"]])
        return gs.respond(model, LAW, OMEGA[place["omega"]])

    ds, _ = datasets_by_place(tmp_path, gs.Study.from_dict(study), response)
    drawn, _ = picture(ds, "period_multiple", "omega", "forcing", {})
    for row, load in enumerate(forcing):
        for column, omega in enumerate(OMEGA[:3]):
            one = gs.respond(gs.systems.paper_oscillator(forcing=load), LAW, omega)
            name = f"P{one.period_multiple}" if one.period_multiple else "chaotic"
            assert drawn.names[drawn.kind[row, column]] == name
    ax = Figure(figsize=(6.0, 4.0), layout="constrained").subplots()
    ds.gapsweep.contact_map(y="forcing", ax=ax)
    walls = set()
    for load in forcing:
        for omega in OMEGA[:3]:
            run = gs.simulate(gs.systems.paper_oscillator(forcing=load), LAW, omega, n_periods=900)
            late = run.t_contacts[run.t_contacts > 0.9 * run.t_end]
            walls.add("both walls" if late.size else "no wall")
    assert {text.get_text() for text in ax.get_legend().get_texts()} == walls
    assert len(walls) == 2
    ax.clear()
    ds.gapsweep.poincare(omega=6.0, forcing=4.0, ax=ax)
    start = ds.sel(omega=6.0, forcing=4.0).squeeze()
    state = [float(start[name][0]) for name in ("section_x", "section_v")]
    n = len(ax.lines[0].get_xdata())
    run = gs.simulate(gs.systems.paper_oscillator(forcing=4.0), LAW, 6.0, *state, n_periods=n)
    assert_allclose(np.column_stack(ax.lines[0].get_data()), 1e3 * run.section)


def made(tmp_path, study, model, law):
    """Responses of a study from rest over its frequencies."""
    study = gs.Study.from_dict({"study": {"name": "made"}, **study})
    at = study.grid.omega
    return datasets_by_place(tmp_path, study, lambda p: gs.respond(model, law, at[p["omega"]]))[0]


def coupled(tmp_path, omega):
    """Two masses with freeplay between them, forced at the first: responses, system and law."""
    arrays = {
        "mass": [[1.0, 0.0], [0.0, 0.5]],
        "damping": [[0.1, 0.0], [0.0, 0.1]],
        "stiffness": [[1.0, 0.0], [0.0, 0.2]],
        "contacts": {"between": [1.0, -1.0]},
        "coordinates": ["x_1", "x_2"],
        "units": {"x_1": "1", "x_2": "1"},
    }
    sweep = {"representation": "piecewise", "K_c": 10.0, "gap": [1.0, 1.0], "omega": omega}
    table = {"system": {**arrays, "forcing": [{"amplitude": [1.0, 0.0]}]}, "sweep": [sweep]}
    system = gs.System(**arrays, forcing=[gs.Harmonic(amplitude=[1.0, 0.0])])
    law = gs.Piecewise(10.0, gs.Gap(1.0, 1.0))
    return made(tmp_path, table, system, law), system, law


def test_of_systems_the_relative_displacement_is_the_difference_of_two_coordinates(tmp_path, ax):
    ds, system, law = coupled(tmp_path, [0.16, 0.22])
    ds.gapsweep.poincare("contact_section_x", omega=0.16, n_points=50, ax=ax)
    start = ds.sel(omega=0.16).squeeze().isel(section_point=0)
    state = {"q_0": start["section_x"].values, "v_0": start["section_v"].values}
    run = gs.simulate(system, law, 0.16, **state, n_periods=50, dense_output=True)
    q_1, q_2, v_1, v_2 = run.section.T
    assert_allclose(ax.lines[0].get_data(), [q_1 - q_2, v_1 - v_2])
    ax.clear()
    ds.gapsweep.poincare(omega=0.16, n_points=50, coordinate="x_2", ax=ax)
    assert_allclose(ax.lines[0].get_data(), [q_2, v_2])
    assert ax.get_xlabel() == "x_2: section displacement"
    history = gs.plot(run, "between", start=0.0).axes[0]
    (line, *walls) = history.lines
    t, drawn = line.get_data()
    assert_allclose(drawn, np.subtract(*run.sample(t)[0].T), atol=1e-12)
    assert sorted(wall.get_ydata()[0] for wall in walls) == [-1.0, 1.0]
    with pytest.raises(gs.ModelError, match="coordinates x_1, x_2, contacts between"):
        gs.plot(run, "bottom")
    slower, waterfall = (Figure().subplots() for _ in range(2))
    ds.gapsweep.impacts(ax=slower)
    assert points(slower)[:, 1].min() > 0.0
    ds.gapsweep.waterfall("contact_section_x", ax=waterfall)
    assert len(ridges(waterfall)) == 2


def gear_study(omega, ratio):
    block = {"K_c": 1.0, "gap": [1.0, 1.0], "omega": omega, "K_ratio": ratio}
    return {
        "system": {"function": "gear_pair"},
        "sweep": [{"representation": "piecewise", **block}],
    }


def oscillator_study(omega, ratio):
    block = {"K_c": 1.4e4, "gap": [4e-4, 4e-4], "omega": omega, "K_ratio": ratio}
    return {"oscillator": PAPER, "sweep": [{"representation": "piecewise", **block}]}


@pytest.mark.parametrize("ratio", [0.0, 1.0])
@pytest.mark.parametrize(
    ("study", "model", "K_c", "wall", "omega"),
    [
        (gear_study, gs.systems.gear_pair(), 1.0, 1.0, [0.06, 0.12, 0.16]),
        (oscillator_study, OSCILLATOR, 1.4e4, 4e-4, [7.0, 30.0]),
    ],
)
def test_walls_are_touched_where_a_motion_goes_beyond_them(
    tmp_path, ax, study, model, K_c, wall, omega, ratio
):
    """A wall without stiffness is none."""
    law = gs.Piecewise(K_c, gs.Gap(wall, wall), K_ratio=ratio)
    ds = made(tmp_path, study(omega, ratio), model, law)
    two = ds.isel(K_c=[0, 0]).assign_coords(K_c=[1.0, 2.0])  # a map has two axes
    two.gapsweep.contact_map(y="K_c", ax=ax)
    expected = set()
    for at in omega:
        run = gs.simulate(model, law, at, n_periods=600, dense_output=True)
        x = run.sample(np.linspace(run.t_end - 8.0 / at, run.t_end, 20_000))[0]
        lower, upper = ratio > 0.0 and x.min() < -wall, x.max() > wall
        name = "both walls" if lower and upper else "upper wall" if upper else "no wall"
        expected.add("always on upper wall" if x.min() > wall else name)
    assert {text.get_text() for text in ax.get_legend().get_texts()} == expected
    assert len(expected) > 1


def test_what_cannot_be_drawn_is_refused_with_a_remedy(responses, tmp_path):
    plain = responses.drop_attrs(deep=False)
    dropped = responses.isel(omega=0, drop=True)
    calls = {
        "study_json: .* gs.open": lambda: plain.gapsweep.poincare(omega=6.0),
        "omega: .* room for one value .* omega=6": lambda: responses.gapsweep.poincare(),
        "omega: no coordinate .* drop=True": lambda: dropped.gapsweep.poincare(),
        "omega = 9.0: not in this dataset": lambda: responses.gapsweep.poincare(omega=9.0),
        "variable = 'x_max': must be section_x or contact_section_x": lambda: (
            responses.gapsweep.poincare("x_max", omega=6.0)
        ),
        "variable = 'force_max': must be section_x": lambda: responses.gapsweep.waterfall(
            "force_max"
        ),
        "contact_section_x: no variable": lambda: responses.gapsweep.poincare(
            "contact_section_x", omega=6.0
        ),
        "force_max: no variable": lambda: responses[["x_max"]].gapsweep.impacts(),
        "x_min: no variable": lambda: responses[["x_max"]].gapsweep.contact_map(),
        "section_x: no variable": lambda: responses[["period_multiple"]].gapsweep.poincare(),
    }
    for message, call in calls.items():
        with pytest.raises(gs.DatasetError, match=message):
            call()
    ds, *_ = coupled(tmp_path, [0.16])
    with pytest.raises(gs.DatasetError, match=r"coordinate: .* choose: coordinate='x_1'"):
        ds.gapsweep.poincare()
    with pytest.raises(gs.DatasetError, match=r"2 of the 4 components .* give coordinate="):
        ds.sel(coordinate="x_1").gapsweep.poincare()
    block = {"representation": "piecewise", "K_c": 1.0, "gap": [1.0, 1.0]}
    arrays = {"mass": [[1.0]], "stiffness": [[1.0]], "damping": [[0.1]], "contacts": {"x": [1.0]}}
    free, law = gs.System(**arrays), gs.Piecewise(1.0, gs.Gap(1.0, 1.0))
    study = gs.Study.from_dict({"study": {"name": "free"}, "system": arrays, "sweep": [block]})
    still = datasets_by_place(tmp_path, study, lambda _: gs.respond(free, law))[0]
    with pytest.raises(gs.DatasetError, match=r"nothing forces this system.* gs\.plot"):
        still.gapsweep.poincare()
