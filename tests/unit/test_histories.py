"""Time histories and their spectra against closed forms and known sinusoids."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.builders.cache import all_keys
from tests.builders.studies import PAPER

import gapsweep as gs
from gapsweep.analysis.datasets.histories import histories, sampled
from gapsweep.analysis.spectra import SAMPLES_PER_PERIOD, spectrum
from gapsweep.stages import SETTINGS, STAGES
from gapsweep.status import Status
from gapsweep.store import netcdf

SCENE = {"representation": ["piecewise"], "K_c": 1.4e4, "gap": [0.4e-3, 0.4e-3], "omega": 10.0}
SWEEP = {"representation": ["piecewise"], "K_c": [1.4e4], "gap": [[4e-4, 4e-4]], "omega": [7.0]}


def study_of(*tables, **more):
    whole = {
        "study": {"name": "kept"},
        "oscillator": PAPER,
        "sweep": [SWEEP],
        "history": list(tables),
    }
    return gs.Study.from_dict(whole | more)


def kept(table, **more):
    return histories(study_of(SCENE | table, **more)).isel(history=0, representation=0)


LINEAR = {"alpha": 0.0, "forcing": 4.0, "omega_n": 5.0, "mass": 3.0, "zeta": 0.03}


def linear_amplitude(omega, K_c=0.0):
    """Amplitude [m] of the linear oscillator with the contact spring always engaged."""
    w, w_n = 2 * np.pi * omega, 2 * np.pi * 5.0
    return 4.0 / 3.0 / np.hypot(w_n**2 + K_c / 3.0 - w**2, 2 * 0.03 * w_n * w)


@pytest.mark.parametrize(("K_c", "gap"), [(0.0, [4e-4, 4e-4]), (3e3, [0.0, 0.0])])
def test_linear_oscillator_shows_its_closed_form_amplitude(K_c, gap):
    one = kept({"K_c": K_c, "gap": gap, "t_end": 30.0, "omega": 7.0}, oscillator=LINEAR)
    amplitude = linear_amplitude(7.0, K_c)
    on_it = int(one["n_periods"])
    assert_allclose(one["frequency"][on_it], 7.0)
    assert_allclose(one["spectrum"][on_it], amplitude, rtol=1e-6)
    assert_allclose(one["spectrum"][on_it + 1], 0.5 * amplitude, rtol=1e-6)  # Hann's neighbours
    rest = np.delete(one["spectrum"].values, [on_it - 1, on_it, on_it + 1])
    assert rest.max() < 1e-6 * amplitude
    assert_allclose(np.abs(one["x"].sel(part="steady")).max(), amplitude, rtol=1e-3)
    assert one["period_multiple"] == 1


def test_start_begins_at_the_start_and_velocity_is_the_derivative():
    one = kept({"start": [1e-3, -0.02], "t_end": 8.0})
    start = one.sel(part="start")
    assert_allclose((start["x"][0], start["v"][0], start["t"][0]), (1e-3, -0.02, 0.0), atol=1e-15)
    t, x, v = (one.sel(part="steady")[name].values for name in ("t", "x", "v"))
    step = t[1] - t[0]
    assert_allclose((x[2:] - x[:-2]) / (2 * step), v[1:-1], atol=2e-3 * np.abs(v).max())


def test_samples_are_those_of_a_simulation():
    one = kept({"t_end": 8.0}).sel(part="steady")
    law = gs.contact_law("piecewise", 1.4e4, gs.Gap(4e-4, 4e-4))
    for i in (0, 5000):
        there = gs.simulate(gs.systems.paper_oscillator(), law, 10.0, t_end=float(one["t"][i]))
        assert_allclose((one["x"][i], one["v"][i]), (there.x_end, there.v_end), rtol=1e-5)
    assert_allclose(one["t"][-1], 8.0 - 0.1 / SAMPLES_PER_PERIOD)


def test_harmonics_lie_at_multiples_of_the_forcing():
    one = kept({"K_c": 1.4e6, "omega": 9.0, "gap": [0.0, 8e-4], "t_end": 60.0})
    n = int(one["n_periods"])
    strong = np.flatnonzero(one["spectrum"].values > 1e-2 * one["spectrum"].values.max())
    multiple = int(one["period_multiple"])
    assert multiple
    nearest = np.round(strong * multiple / n) * n / multiple
    assert np.all(np.abs(strong - nearest) <= 1)  # Hann spreads a line over three bins
    assert strong.size > 3


@pytest.mark.parametrize("periods", [3, 60])
def test_spectrum_of_known_sinusoids(periods):
    n = periods * 256
    t = np.arange(n) / n
    x = -0.7 + 0.3 * np.cos(2 * np.pi * 24 * t + 1.0) + 0.02 * np.sin(2 * np.pi * 90 * t)
    found = spectrum(x)
    assert_allclose(found[[0, 24, 90]], [0.7, 0.3, 0.02], rtol=1e-12)


def test_spectrum_obeys_parseval():
    x = np.random.default_rng(1).standard_normal(512)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(512) / 512)
    found = spectrum(x)
    power = found[0] ** 2 + found[-1] ** 2 + 0.5 * np.sum(found[1:-1] ** 2)
    assert_allclose(power, np.mean((x * window) ** 2) / window.mean() ** 2)


def test_bins_are_multiples_of_the_resolution_up_to_half_the_sampling():
    t, frequency = sampled(4.0, 10.3)
    assert t.shape == (2, 41 * 256)  # 41 whole periods fit
    assert_allclose(frequency[41], 4.0)
    assert_allclose(frequency[-1], 4.0 * SAMPLES_PER_PERIOD / 2)


def test_short_and_long_histories_share_a_file(tmp_path):
    both = study_of(SCENE | {"t_end": 1.0}, SCENE | {"t_end": 8.0, "representation": "tanh-1e4"})
    found = histories(both)
    assert_array_equal(found["n_periods"], [10, 60])
    wanted = [[Status.OK, Status.NOT_REQUESTED], [Status.NOT_REQUESTED, Status.OK]]
    assert_array_equal(found["status"], wanted)
    assert np.isfinite(found["x"].values[0, 0, :, :2560]).all()
    assert np.isnan(found["x"].values[0, 0, :, 2560:]).all()
    assert all({"units", "long_name"} <= set(v.attrs) for v in found.variables.values())
    netcdf.write(found, tmp_path / "histories.nc", {})
    with netcdf.read(tmp_path / "histories.nc") as again:
        assert_array_equal(again["spectrum"], found["spectrum"])
        assert again["status"].attrs["flag_meanings"].split()[0] == "ok"


def test_protocol_of_a_label_is_used():
    protocols = {"jitter": {"start_jitter": 1e-5}, "loose": {"rtol": 1e-2, "atol": 1e-4}}
    labels = ["piecewise", "piecewise@jitter", "piecewise@loose"]
    study = study_of(SCENE | {"t_end": 1.0, "representation": labels}, protocol=protocols)
    plain, jitter, loose = histories(study).isel(history=0)["x"].sel(part="start").values
    assert_allclose(jitter[0] - plain[0], 1e-5)
    assert loose[0] == plain[0]
    assert np.nanmax(np.abs(loose - plain)) > 1e-8


def test_failures_are_statuses():
    runs_away = PAPER | {"alpha": -7e9, "forcing": 4e3}
    table = SCENE | {"t_end": 1.0, "representation": ["no_such_module:spring", "piecewise"]}
    found = histories(study_of(table, oscillator=runs_away)).isel(history=0)
    assert_array_equal(found["status"], [Status.MODEL_INVALID, Status.DIVERGED])
    assert np.isnan(found["x"]).all()
    assert np.isnan(found["spectrum"]).all()


@pytest.mark.slow  # each law is compiled
def test_raising_and_undefined_laws_are_statuses():
    labels = ["tests.misbehaving.forces:raising", "tests.misbehaving.forces:undefined"]
    found = histories(study_of(SCENE | {"t_end": 1.0, "representation": labels}))
    assert_array_equal(found["status"], [[Status.ERROR, Status.MODEL_INVALID]])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"t_end": 0.05}, "t_end = 0.05 s: must be within 0.1..1000 s"),
        ({"t_end": 2000.0}, "t_end = 2000 s"),
        ({"representation": []}, "history[0].representation"),
        ({"representation": ["piecewise@none"]}, "protocol 'none'"),
        ({"omega": -1.0}, "history[0].omega"),
        ({"start": [0.0]}, "history[0].start"),
        ({"speed": 1.0}, "history[0].speed"),
    ],
)
def test_wrong_tables_are_refused(change, named):
    with pytest.raises(gs.StudyError) as caught:
        study_of({"t_end": 8.0} | SCENE | change)
    assert named in "\n".join(caught.value.problems)


def test_histories_change_no_cache_key():
    without, plus = study_of(), study_of(SCENE | {"t_end": 8.0})
    assert all_keys(without) == all_keys(plus)
    assert json.loads(plus.json)["history"][0]["t_end"] == 8.0


def test_the_stage_depends_on_the_study_only():
    (stage,) = (s for s in STAGES if s.file == "histories.nc")
    assert (stage.inputs, stage.sources) == ((), (SETTINGS,))


SWEPT = {"omega_n": [20.0], "forcing": [40.0], "K_ratio": [0.01], "K_c": [1.4e6]}
UNLIKE = {"t_end": 20.0, "omega": 8.0, "K_c": 1.4e6}


def extremes(one):
    x = one["x"].sel(part="steady")
    return x.min().item(), x.max().item()


def test_the_only_value_that_is_swept_is_that_of_a_history():
    """As its steady response has it: of a stop that is softer below than above."""
    study = study_of(SCENE | UNLIKE, sweep=[SWEEP | SWEPT])
    one = histories(study).isel(history=0, representation=0)
    law = gs.contact_law("piecewise", 1.4e6, gs.Gap(4e-4, 4e-4), K_ratio=0.01)
    oscillator = gs.systems.paper_oscillator(omega_n=20.0, forcing=40.0)
    steady = gs.respond(oscillator, law, omega=8.0)
    assert_allclose(extremes(one), (steady.x_min, steady.x_max), rtol=5e-3)  # between samples
    assert steady.x_min < -2 * steady.x_max
    assert [one[name].item() for name in ("omega_n", "forcing", "K_ratio")] == [20.0, 40.0, 0.01]


def test_of_several_values_a_history_says_its_own():
    sweep = SWEEP | SWEPT | {"K_ratio": [0.01, 1.0], "zeta": [0.02, 0.03]}
    with pytest.raises(
        gs.StudyError, match=r"history\[0\].zeta: swept by the study; choose one value"
    ):
        study_of(SCENE | UNLIKE | {"K_ratio": 1.0}, sweep=[sweep])
    study = study_of(SCENE | UNLIKE | {"K_ratio": 1.0, "zeta": 0.02}, sweep=[sweep])
    one = histories(study).isel(history=0, representation=0)
    assert one["zeta"].item() == 0.02
    law = gs.contact_law("piecewise", 1.4e6, gs.Gap(4e-4, 4e-4))
    oscillator = gs.systems.paper_oscillator(omega_n=20.0, forcing=40.0, zeta=0.02)
    steady = gs.respond(oscillator, law, omega=8.0)
    assert_allclose(extremes(one), (steady.x_min, steady.x_max), rtol=5e-3)  # between samples
