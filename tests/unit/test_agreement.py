"""`agreement.nc` as a whole: a made-up study with everything in it, summed up independently."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from tests.builders.datasets import chaotic, datasets, failed, periodic, tables, unresolved

from gapsweep import ResponseClass, Status
from gapsweep.analysis.agreement.comparison import agreement, length_scale
from gapsweep.analysis.agreement.metrics import METRICS, REGIMES, variables
from gapsweep.stages import stages_of
from gapsweep.store import netcdf
from gapsweep.study.study import Study

LABELS = ["piecewise", "piecewise@half", "piecewise@jitter", "tanh-1e4", "tanh-1e4@paper"]
OMEGA = np.round(np.arange(5.0, 9.0, 0.25), 12)
PROTOCOLS = {
    "half": {"rtol": 5e-10, "atol": 5e-13},
    "jitter": {"start_jitter": 1e-9},
    "paper": {"rtol": 1e-4, "atol": 1e-7, "controller": "ode45"},
}
SCENE = {"K_c": 0, "gap": 0}


def answer(label, omega, i):
    """Any class of response, reproducibly; exact-against-exact ones differ a little."""
    seed = [int(omega * 100), i]
    spread = {"piecewise": 0.0, "piecewise@half": 1e-9, "piecewise@jitter": 2e-9}.get(label, 1e-5)
    kind = np.random.default_rng(seed if spread < 1e-6 else [*seed, len(label)]).integers(9)
    rng = np.random.default_rng(seed)
    noise = spread * np.random.default_rng([*seed, len(label)]).normal()
    if kind == 0:
        return failed()
    if kind == 1:
        return unresolved(rng.normal(0, 5e-4, (32, 2)) + noise, omega)
    if kind == 2:
        return chaotic(rng.normal(0, 5e-4, (32, 2)) + noise, omega)
    return periodic(rng.normal(0, 5e-4, (kind - 2, 2)) + noise, omega)


STUDY = tables(LABELS, OMEGA, starts=3, sweeps=("sweep_up",), protocol=PROTOCOLS)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return datasets(tmp_path_factory.mktemp("made"), STUDY, answer)


@pytest.fixture(scope="module")
def whole(files):
    return agreement(*files).isel(SCENE)


def test_a_study_has_only_the_files_that_it_asks_for():
    files = {stage.file for stage in stages_of(Study.from_dict(tables(["tanh-1e4"], [7.0])))}
    others = {"agreement.nc", "histories.nc", "work_precision.nc", "stability.nc"}
    assert "static.nc" in files
    assert not files & others


def test_exact_law_agrees_with_itself(whole):
    exact = whole.sel(representation="piecewise", regime="all")
    for name, metric in variables():
        if metric.worst and not name.endswith(("_ci", "_floor")):
            values = exact[name].values[np.isfinite(exact[name].values)]
            assert values.size, name
            assert set(values.tolist()) == {1.0 if metric.worst == "min" else 0.0}, name
    assert exact["cpu_time_per_period_ratio"] == 1.0


@pytest.mark.parametrize("name", [name for name, metric in METRICS.items() if metric.statistics])
def test_summaries_are_those_of_the_points(files, whole, name):
    exact = files[0].isel(SCENE).sel(representation="piecewise")
    points = exact["response_class"]
    frequencies = {
        "periodic": (points == ResponseClass.PERIODIC).all("initial_condition"),
        "chaotic": (points == ResponseClass.CHAOTIC).any("initial_condition"),
    }
    for label in LABELS:
        for regime in REGIMES:
            values = whole[name].sel(representation=label)
            if regime != "all" and "initial_condition" in values.dims:
                values = values.where(points == REGIMES.index(regime) - 1)
            elif regime != "all":
                values = values.where(frequencies[regime])
            values = np.abs(values.values[np.isfinite(values.values)])
            for statistic in METRICS[name].statistics:
                found = whole[f"{name}_{statistic}"].sel(representation=label, regime=regime)
                q = {"median": 0.5, "p95": 0.95}.get(statistic)
                expected = np.nan
                if values.size:
                    expected = np.mean(values) if q is None else np.quantile(values, q)
                assert_allclose(found, expected, rtol=1e-6)


def test_pooled_shares_are_those_of_the_counts(whole):
    total = whole[[f"n_attractors{s}" for s in ("", "_exact", "_matched")]].sum("omega")
    n, n_exact, n_matched = total.data_vars.values()
    pooled = whole.sel(regime="all")
    assert_allclose(pooled["precision_pooled"], n_matched / n)
    assert_allclose(pooled["recall_pooled"], n_matched / n_exact)
    assert_allclose(pooled["f1_pooled"], 2 * n_matched / (n + n_exact))


def test_unresolved_and_failed_points_are_counted_not_dropped(files, whole):
    responses = files[0].isel(SCENE)
    kinds = responses["response_class"]
    exact = kinds.sel(representation="piecewise")
    for label in LABELS:
        ours = kinds.sel(representation=label)
        for regime, here in zip(REGIMES, (exact >= 0, exact == 0, exact == 1), strict=True):
            row = whole.sel(representation=label, regime=regime)
            assert row["n_points"] == here.sum()
            assert row["n_unresolved"] == (here & (ours == ResponseClass.UNRESOLVED)).sum()
            assert row["n_failed"] == (here & (ours == ResponseClass.FAILED)).sum()
            both = responses["amplitude"].notnull().sel(representation=[label, "piecewise"])
            assert row["n_compared"] == (here & both.all("representation")).sum()


def test_floor_is_the_worst_of_exact_against_exact(whole):
    assert whole.attrs["floor_representations"] == "piecewise@half piecewise@jitter"
    exact = whole.sel(representation=["piecewise@half", "piecewise@jitter"])
    for name, metric in variables():
        if f"{name}_floor" in whole:
            worst = exact[name].min if metric.worst == "min" else abs(exact[name]).max
            assert_array_equal(whole[f"{name}_floor"], worst("representation"))
    floor = whole["amplitude_error_median_floor"].sel(regime="all")
    assert 0.0 < floor < whole["amplitude_error_median"].sel(regime="all")[-1]


def test_no_protocol_for_it_no_floor(tmp_path):
    study = tables(["piecewise", "piecewise@paper"], [7.0], protocol=PROTOCOLS)
    result = agreement(*datasets(tmp_path, study, answer))
    assert result.attrs["floor_representations"] == ""
    assert all(result[name].isnull().all() for name in result if name.endswith("_floor"))


def test_shares_and_intervals_are_in_their_range(whole):
    for name, metric in variables():
        values = whole[name].values[np.isfinite(whole[name].values)]
        if metric.worst == "min":
            assert np.all((values >= 0.0) & (values <= 1.0)), name
        if f"{name}_ci" in whole:
            low, high = (whole[f"{name}_ci"].sel(bound=b) for b in ("low", "high"))
            known = low.notnull() & high.notnull()
            assert (low <= high).where(known, True).all(), name
            few = name.endswith("_p95")  # eight blocks are too few for a tail
            assert known.sel(regime="all").any() or few, name


def test_starts_have_no_order(tmp_path, whole):
    order = [2, 0, 1, 3]
    shuffled = datasets(tmp_path, STUDY, lambda label, w, i: answer(label, w, order[i]))
    result = agreement(*shuffled).isel(SCENE)
    for name, metric in METRICS.items():
        for statistic in metric.statistics:
            assert_allclose(result[f"{name}_{statistic}"], whole[f"{name}_{statistic}"], rtol=1e-9)


def test_scenes_are_apart_and_what_was_not_asked_for_is_empty(tmp_path):
    study = tables(["piecewise", "tanh-1e4"], [7.0, 8.0])
    study["sweep"] += tables(["tanh-1e4"], [8.0], gap=(0.0, 0.8e-3))["sweep"]
    result = agreement(*datasets(tmp_path, study, lambda _, w, i: periodic([[1e-3, 0.0]], w)))
    ours = result.sel(representation="tanh-1e4", K_c=1.4e4, regime="all")
    assert ours["n_points"].values.tolist() == [2, 1]
    assert ours["n_compared"].values.tolist() == [2, 0]
    assert ours["f1_pooled"].values.tolist()[0] == 1.0
    assert np.isnan(ours["f1_pooled"].values[1])
    assert ours["amplitude_error"].count() == 2


def test_points_missing_from_the_cache_count_as_failed(tmp_path):
    def some(label, omega, i):
        return None if label == "tanh-1e4" and omega == 7.0 else periodic([[1e-3, 0.0]], omega)

    files = datasets(tmp_path, tables(["piecewise", "tanh-1e4"], [7.0, 8.0]), some)
    assert (files[0]["status"] == Status.INTERRUPTED).sum() == 1
    row = agreement(*files).isel(SCENE).sel(representation="tanh-1e4", regime="all")
    assert (row["n_points"], row["n_compared"], row["n_failed"]) == (2, 1, 1)


def test_an_uneven_force_has_no_mirror_images(tmp_path):
    def mirrored(label, omega, i):
        return periodic([[1e-3 if label == "piecewise" else -1e-3, 2e-4]], omega, extrema=[9e-4])

    responses, attractors = datasets(tmp_path, tables(LABELS[::3], [7.0]), mirrored)
    distances = []
    for is_odd in (True, False):
        uneven = {"tables_json": json.dumps({"tanh-1e4": {"is_odd": is_odd}})}
        found = agreement(responses.assign_attrs(uneven), attractors)
        distances.append(found["attractor_distance"].sel(representation="tanh-1e4").max().item())
    assert distances[0] < distances[1]


def test_without_a_gap_lengths_are_in_ranges_of_the_response(tmp_path):
    study = tables(["piecewise", "tanh-1e4"], [7.0], gap=(0.0, 0.0))
    amplitudes = {"piecewise": 1e-3, "tanh-1e4": 1.09e-3}
    files = datasets(tmp_path, study, lambda x, w, i: periodic([[amplitudes[x], 0.0]], w))
    row = agreement(*files).isel(SCENE).sel(representation="tanh-1e4", regime="all")
    assert_allclose(row["attractor_distance"], 0.09e-3)
    assert row["f1"] == 1.0  # within 5 % of the range, 2 mm


@pytest.mark.parametrize("gap", [(0.0, 0.0), (0.4e-3, 0.4e-3)])
@pytest.mark.parametrize(("ours", "exact"), [(0.0, 0.0), (1e10, 1e-3), (1e160, 1e-3), (0.0, 1e-3)])
def test_responses_at_rest_or_run_away_do_not_stop_it(tmp_path, gap, ours, exact):
    amplitudes = {"piecewise": exact, "tanh-1e4": ours}
    study = tables(amplitudes, [7.0, 8.0], gap=gap)
    files = datasets(tmp_path, study, lambda x, w, i: periodic([[amplitudes[x], 0.0]], w))
    row = agreement(*files).isel(SCENE).sel(representation="tanh-1e4", regime="all")
    assert row["class_agreement_mean"] == 1.0
    assert (row["amplitude_error_median"] == 0.0) == (ours == exact)


def test_file_explains_itself(files, tmp_path):
    result = agreement(*files)
    netcdf.write(result, tmp_path / "agreement.nc", {})
    with xr.open_dataset(tmp_path / "agreement.nc") as read:
        assert set(read.data_vars) == {name for name, _ in variables()}
        for name, variable in read.data_vars.items():
            assert all(variable.attrs[key] for key in ("units", "long_name", "definition")), name
            assert variable.dtype == METRICS[name].dtype if name in METRICS else True
        assert read["j_1"].dims == ("gap",)
        assert read.attrs["study_json"] == files[0].attrs["study_json"]


def test_documentation_names_every_metric():
    text = (Path(__file__).parents[2] / "docs" / "reference" / "metrics.md").read_text()
    assert [name for name in METRICS if f"`{name}`" not in text] == []


def test_a_wall_that_nothing_comes_near_to_is_no_scale_of_errors():
    """The scale is what moves: an error of a third stays one, wherever the far wall stands."""
    moving = SimpleNamespace(
        amplitude=np.array([[0.0, 1e-3], [3e-3, 9.0]]),
        exists=np.array([[True, True], [True, False]]),
        noise=np.array([[1e-12, 1e-12], [np.nan, 1e-12]]),
        found=SimpleNamespace(section=np.zeros((1, 1, 1, 2))),
    )
    assert length_scale(2e-3, moving) == 2e-3  # it is reached
    assert length_scale(1e6, moving) == length_scale(1.0, moving) == 6e-3
    dying = SimpleNamespace(**vars(moving) | {"amplitude": np.full((2, 2), 1e-12)})
    dying.noise = np.full((2, 2), 1e-12)
    assert length_scale(1e-3, dying) == 1e-3  # what is left of a motion that dies out is no scale
