"""Uncertain numbers: samples, probabilities and Sobol indices against closed forms.

A system without cubic spring depends on F/gap alone: m 1, c .05, k 1, walls at ± gap, K_c 2, 1.1
rad/s, from rest. The response is large if gap/.1745 < R F/.03 (R bisected by exact flows).
"""

import math

import numpy as np
import pytest
import scipy.stats as st
import xarray as xr
from tests.builders.studies import SECTION, changed, small_study

import gapsweep as gs
import gapsweep.report.accessor  # registers ds.gapsweep
from gapsweep.analysis.datasets.recommendations import advice
from gapsweep.analysis.datasets.risk import risk_of, safety
from gapsweep.execution.plan import plan
from gapsweep.report.marks import marks_of
from gapsweep.study.samples import drawn
from gapsweep.study.uncertain import UncertainTable

R = 1.0873784908816
OMEGA = 1.1 / (2.0 * math.pi)
OSCILLATOR = gs.Oscillator(mass=1.0, omega_n=0.5 / math.pi, zeta=0.025, forcing=0.03)
LARGE = {"large": {"quantity": "amplitude", "above": 0.2}}
UNCERTAIN = {
    **{"samples": 8, "repeats": 2, "quantities": ["force_max"]},
    "gap": {"normal": 4e-4, "sd": 2e-5},
}


def of_ratio(gap, forcing):
    """Lognormal distributions of gap and forcing, with the standard deviations of their logs."""
    return {"gap": st.lognorm(gap, scale=0.1745), "forcing": st.lognorm(forcing, scale=0.03)}


def is_large(samples):
    return samples.numbers["gap"] / 0.1745 < R * samples.numbers["forcing"] / 0.03


def exact(gap, forcing):
    """Probability, first and total indices of a large response, from the normal distribution."""
    z = math.log(R) / math.hypot(gap, forcing)
    p = st.norm.cdf(z)
    first = []
    for sd in (gap, forcing):
        rho = sd**2 / (gap**2 + forcing**2)
        both = st.multivariate_normal.cdf([z, z], cov=[[1.0, rho], [rho, 1.0]])
        first.append((both - p * p) / (p * (1.0 - p)))
    return p, first, [1.0 - each for each in first[::-1]]


def made_up(samples, amplitude, response_class=0):
    """Responses over samples, at one frequency and from one initial state."""
    dims, n = ("omega", "sample", "initial_condition"), len(samples)
    columns = {"amplitude": amplitude, "status": 0, "response_class": response_class}
    data = {name: (dims, np.broadcast_to(x, n)[None, :, None]) for name, x in columns.items()}
    return xr.Dataset(data, {n: ("sample", getattr(samples, n)) for n in ("matrix", "repeat")})


def risk(of, amplitude, events=None, response_class=0, **settings):
    """Risk of responses of which the amplitude is a function of the samples."""
    settings = {"samples": 256, "repeats": 8, "seed": 1, "indices": False} | settings
    samples = drawn(of, **settings)
    settings["quantities"] = ["amplitude"]
    table = UncertainTable.of_call(of, LARGE if events is None else events, settings)
    return risk_of(made_up(samples, amplitude(samples), response_class), table).squeeze()


def of_switch(samples):
    return np.where(is_large(samples), 0.24, 0.12)


@pytest.mark.parametrize("sd", [(0.05, 0.05), (0.05, 0.1), (0.02, 0.08)])
def test_probability_and_indices_of_the_closed_form(sd):
    found, (p, first, total) = (
        risk(of_ratio(*sd), of_switch, samples=2**14, indices=True),
        exact(*sd),
    )
    assert found["probability"] == pytest.approx(p, abs=1e-3)
    np.testing.assert_allclose(found["first_order"], first, atol=0.01)
    np.testing.assert_allclose(found["total"], total, atol=0.01)
    # The amplitude has two values, as the event.
    np.testing.assert_allclose(found["quantity_total"], found["total"], rtol=1e-9)


@pytest.mark.parametrize("sd", [(0.05, 0.05), (0.02, 0.08)])
def test_intervals_contain_the_probability_in_95_of_100_seeds(sd):
    several = [risk(of_ratio(*sd), of_switch, seed=seed) for seed in range(100)]
    p = exact(*sd)[0]
    assert 92 <= sum(float(one.low) <= p <= float(one.high) for one in several) <= 98


def test_responses_switch_where_exact_flows_do():
    found = gs.risk(
        OSCILLATOR, gs.Piecewise(2.0, gs.Gap(0.1745, 0.1745)), of_ratio(0.05, 0.1), OMEGA,
        events=LARGE, samples=256, seed=3,
    )  # fmt: skip
    expected = is_large(drawn(of_ratio(0.05, 0.1), 256, 8, 3)).mean()
    assert float(found["probability"].squeeze()) == expected
    assert float(found["n_undecided"].squeeze()) == 0.0


def test_indices_are_those_of_the_estimators():
    """Saltelli (2010) and Jansen (1999), written here as in their papers."""
    of = {name: st.uniform(0.0, 2.0) for name in "abc"}

    def amplitude(samples):
        a, b, c = samples.numbers.values()
        return np.sin(3.0 * a) + 7.0 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)

    found = risk(of, amplitude, {}, indices=True, repeats=2)
    y = amplitude(drawn(of, 256, 2, 1, indices=True)).reshape(2, 5, 256)
    y = y - y.mean()
    f_a, f_b = y[:, 0].ravel(), y[:, 1].ravel()
    variance = np.concatenate([f_a, f_b]).var()
    for i in range(3):
        mixed = y[:, 2 + i].ravel()
        first, total = np.mean(f_b * (mixed - f_a)), 0.5 * np.mean((f_a - mixed) ** 2)
        assert found["quantity_first_order"][i] == pytest.approx(first / variance, rel=1e-12)
        assert found["quantity_total"][i] == pytest.approx(total / variance, rel=1e-12)


def test_undecided_samples_widen_the_interval():
    of, classes = of_ratio(0.05, 0.05), np.zeros(2048, int)
    before = risk(of, of_switch, response_class=classes)
    classes[:100] = gs.ResponseClass.UNRESOLVED
    classes[1900:] = gs.ResponseClass.FAILED
    found = risk(of, of_switch, response_class=classes)
    assert float(found["n_undecided"]) == 248.0
    known = is_large(drawn(of, 256, 8, 1))[classes == 0]
    assert float(found["probability"]) == pytest.approx(known.mean())
    share = 248 / 2048
    assert float(found["high"] - found["low"]) > share > float(before["high"] - before["low"])
    assert found["quantile_low"][0] == -np.inf
    assert found["quantile_high"][-1] == np.inf
    every = risk(of, of_switch, response_class=np.full(2048, gs.ResponseClass.FAILED))
    assert np.isnan(every["probability"])
    assert [every["low"], every["high"]] == [0.0, 1.0]


def test_an_event_that_no_sample_shows_may_happen():
    found = risk(of_ratio(0.05, 0.05), lambda samples: np.full(len(samples), 0.1))
    # Clopper-Pearson: (1 - p)^n = .025
    assert [found["low"], found["high"]] == [0.0, pytest.approx(1.0 - 0.025 ** (1 / 2048))]


def test_classes_and_ranges_are_events():
    classes = np.repeat([0, 1, 0, gs.ResponseClass.FAILED], 512)
    events = {
        "chaos": {"response_class": "chaotic"},
        "failure": {"response_class": "failed"},
        "middle": {"quantity": "amplitude", "above": 1.0, "below": 2.0},
    }
    of = of_ratio(0.05, 0.05)
    found = risk(of, lambda samples: np.repeat([0.5, 1.5], 1024), events, classes)
    np.testing.assert_allclose(found["probability"], [1 / 3, 1 / 4, 1 / 3])


def test_quantiles_are_those_of_the_distribution():
    of = {"gap": st.norm(4e-4, 2e-5)}
    found = risk(of, lambda samples: samples.numbers["gap"], {}, samples=4096)
    levels = found["level"].values
    # A Sobol sequence has as many of its 4096 points below any value, within a few.
    np.testing.assert_allclose(of["gap"].cdf(found["quantile"]), levels, atol=4 / 4096)
    assert (found["quantile_low"] < found["quantile"]).all()
    assert (found["quantile"] < found["quantile_high"]).all()


def test_more_samples_begin_with_the_same():
    few, many = (drawn(of_ratio(0.05, 0.1), n, 3, 5, indices=True) for n in (16, 32))
    first = many.row < 16
    for name in ("gap", "forcing"):
        np.testing.assert_array_equal(many.numbers[name][first], few.numbers[name])
    assert len(set(many.numbers["gap"][many.matrix < 2])) == 3 * 2 * 32  # repeats differ


def study(tables=None, uncertain=None, **changes):
    tables = changed(tables or small_study(), **changes)
    return gs.Study.from_dict(tables | {"uncertain": uncertain or UNCERTAIN})


def points(one):
    return one.points(np.arange(one.grid.requested.size))[0][1]


def test_twice_the_samples_share_their_keys():
    few, many = (study(uncertain=UNCERTAIN | {"samples": n}) for n in (8, 16))
    keys = [{*plan(one).block(0).keys.tolist()} for one in (few, many)]
    assert keys[0] < keys[1]
    assert len(keys[1]) == 2 * len(keys[0])


def test_samples_replace_values_of_points():
    one = {"normal": 1.0, "sd": 0.01}
    uncertain = {
        **{
            "samples": 4,
            "repeats": 2,
            "quantities": ["x_max"],
            "gap": {"normal": [4e-4, 3e-4], "sd": 2e-5},
        },
        **{"K_c": {"lognormal": 1.0, "sd": 0.1, "nominal": "times"}, "x_0": one, "forcing": one},
        "K_ratio": {"normal": 0.0, "sd": 0.01, "nominal": "plus"},
    }
    found = study(uncertain=uncertain, sweep__0__representation="piecewise", sweep__0__omega=9.0)
    rows, numbers = points(found), found.grid.axes["sample"].numbers
    assert [*numbers] == ["j_1", "j_2", "K_c", "x_0", "forcing", "K_ratio"]
    for name in ("j_1", "j_2", "x_0", "forcing"):
        np.testing.assert_array_equal(rows.column(name), numbers[name])
    np.testing.assert_allclose(rows.column("K_c"), 1.4e4 * numbers["K_c"], rtol=1e-11)
    np.testing.assert_allclose(rows.column("K_ratio"), 1.0 + numbers["K_ratio"], rtol=1e-11)
    assert set(rows.column("mass")) == {3.0}


def test_ratios_of_distributions_have_no_unit():
    factor = {"normal": 1.0, "sd": "5 %", "nominal": "times"}
    uncertain = {"forcing": factor, "K_c": {"lognormal": "14 kN/m", "sd": "10 %"}}
    read = study(uncertain=UNCERTAIN | uncertain).spec.uncertain.parameter
    assert read["forcing"].sd == 0.05
    assert (read["K_c"].lognormal, read["K_c"].sd) == (1.4e4, 0.1)
    for name, wrong in (
        ("forcing", factor | {"sd": "0.1 N"}),
        ("K_c", {"lognormal": 1.0, "sd": "1 N/m"}),
    ):
        with pytest.raises(gs.StudyError, match=r"sd = '.*without dimension") as caught:
            study(uncertain=UNCERTAIN | {name: wrong})
        assert len(caught.value.problems) == 1


def test_one_number_moves_both_walls_around_swept_gaps():
    gap = {"normal": 0.0, "sd": 1e-5, "nominal": "plus"}
    changes = {"sweep__0__gap": [[3e-4, 4e-4], [5e-4, 5e-4]], "sweep__0__omega": 9.0}
    found = study(uncertain=UNCERTAIN | {"gap": gap}, **changes)
    rows, deviation = points(found), found.grid.axes["sample"].numbers["gap"]
    walls = np.stack([rows.column("j_1"), rows.column("j_2")]).reshape(2, 2, 16)
    np.testing.assert_allclose(walls[:, 0], [3e-4 + deviation, 4e-4 + deviation], rtol=1e-11)
    np.testing.assert_allclose(walls[:, 1], [5e-4 + deviation] * 2, rtol=1e-11)


def test_an_uncertain_gap_adds_no_wall():
    gap = {"gap": {"normal": 4e-4, "sd": 2e-5}}
    rows = points(study(uncertain=UNCERTAIN | gap, sweep__0__gap=[math.inf, 4e-4]))
    assert np.isinf(rows.column("j_1")).all()
    assert len({*rows.column("j_2")}) == 16


def test_parameters_of_systems_are_uncertain():
    uncertain = UNCERTAIN | {"speed": {"uniform": [8.0, 10.0]}, "gap": {"normal": 0.03, "sd": 1e-3}}
    found = study(SECTION, uncertain, sweep__0__speed=9.0)
    rows, speeds = points(found), found.grid.axes["sample"].numbers["speed"]
    (_, models), refused = rows.models()
    expected = gs.systems.typical_section(speed=float(speeds[3]), density=1.2)
    assert not refused
    np.testing.assert_array_equal(models.systems[models.system[3]].stiffness, expected.stiffness)


def test_models_of_samples_are_those_of_single_rows():
    """Also where one of them is invalid, which is refused without the others."""
    uncertain = UNCERTAIN | {"forcing": {"normal": 4.0, "sd": 0.1}, "K_ratio": {"uniform": [0, 2]}}
    labels = ["piecewise", "tanh-1e4", "poly-13"]
    found = study(small_study(), uncertain, sweep__0__omega=9.0, sweep__0__representation=labels)
    for _, rows in found.points(np.arange(48)):
        (_, models), refused = rows.models()
        assert not refused
        for k in range(16):
            (_, one), _ = rows.take([k]).models()
            assert models.systems[models.system[k]] == one.systems[0]
            assert models.laws[models.law[k]] == one.laws[0]
        damaged = rows.numbers.copy()
        damaged[3, rows.kind.numbers.index("mass")] = -1.0
        damaged[5, rows.kind.numbers.index("K_c")] = np.nan
        (kept, models), refused = type(rows)(rows.kind, damaged).models()
        assert sorted(refused) == [3, 5]
        assert "mass = -1" in str(refused[3])
        assert len(models) == len(kept) == 14


def test_missing_values_are_medians():
    tables = changed(small_study(), sweep__0__gap=None, oscillator__forcing=None)
    uncertain = UNCERTAIN | {"forcing": {"triangular": [1.0, 2.0, 5.0]}}
    found = study(tables, uncertain)
    assert found.grid.gaps == (gs.Gap(4e-4, 4e-4),)
    median = st.triang(0.25, 1.0, 4.0).median()
    assert found.oscillator.forcing == pytest.approx(median)


def test_distributions_of_all_kinds():
    """Shares below a value of each, from the distribution functions of scipy and of the data."""
    tables = {
        "lognormal": ({"lognormal": 4.0, "sd": 0.2}, st.lognorm(0.2, scale=4.0)),
        "uniform": ({"uniform": [3.0, 5.0]}, st.uniform(3.0, 2.0)),
        "truncated": (
            {"truncated": 4.0, "sd": 0.5, "low": 3.5, "high": 5.0},
            st.truncnorm(-1.0, 2.0, 4.0, 0.5),
        ),
    }
    for table, expected in tables.values():
        found = study(uncertain={"samples": 512, "quantities": ["x_max"], "forcing": table})
        drawn_ = found.grid.axes["sample"].numbers["forcing"]
        assert st.kstest(drawn_, expected.cdf).statistic < 0.003


def test_measured_values_from_a_file(tmp_path):
    gaps = np.random.default_rng(1).normal(4e-4, 2e-5, 50)
    (tmp_path / "gaps.csv").write_text("part,gap\n" + "".join(f"a,{gap}\n" for gap in gaps))
    uncertain = UNCERTAIN | {"samples": 512, "gap": {"data": "gaps.csv", "column": "gap"}}
    tables = small_study() | {"uncertain": uncertain}
    found = gs.Study.from_dict(tables, str(tmp_path / "study.toml")).grid.axes["sample"]
    values = found.numbers["gap"]
    np.testing.assert_allclose(
        np.quantile(values, [0.1, 0.5]), np.quantile(gaps, [0.1, 0.5]), rtol=1e-2
    )
    assert gaps.min() <= values.min()
    assert values.max() <= gaps.max()
    (tmp_path / "gaps.csv").write_text(
        "part; gap [mm]\n" + "".join(f"a b; {1e3 * gap}\n" for gap in gaps)
    )
    in_mm = gs.Study.from_dict(tables, str(tmp_path / "study.toml")).grid.axes["sample"]
    np.testing.assert_allclose(in_mm.numbers["gap"], values, rtol=1e-12)
    uncertain["gap"]["column"] = "width"
    with pytest.raises(gs.StudyError, match=r"'width': gaps.csv has part, gap"):
        gs.Study.from_dict(tables, str(tmp_path / "study.toml"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gap [s]\n4e-4\n", r"column 'gap \[s\]': gap = '1 s': must be a number in m"),
        (
            "gap [mm]\n0.4\nabout 0.5\n",
            r"line 3: about 0\.5: must have a finite number in column 1",
        ),
        ("part, gap\na, 4e-4\nb, nan\n", r"line 3: b, nan: must have a finite number in column 2"),
        ("part; gap\na 1; 0,4\n", "line 2: .*decimal points"),
        ("gap\n", "no line with a number"),
        ("4e-4\n5e-4\n", "column 'gap': gaps.csv has no titles"),
    ],
)
def test_bad_files_of_measured_values_have_one_line(text, words, tmp_path):
    (tmp_path / "gaps.csv").write_text(text)
    uncertain = UNCERTAIN | {"gap": {"data": "gaps.csv", "column": "gap"}}
    tables = small_study() | {"uncertain": uncertain}
    with pytest.raises(gs.StudyError, match=words) as caught:
        gs.Study.from_dict(tables, str(tmp_path / "study.toml"))
    assert len(caught.value.problems) == 1


def test_correlated_numbers():
    wanted = [[1.0, -0.6], [-0.6, 1.0]]
    found = drawn(of_ratio(0.05, 0.1), 1024, 4, 1, correlation=wanted).numbers
    logs = np.log([found["gap"] / 0.1745, found["forcing"] / 0.03])
    np.testing.assert_allclose(np.corrcoef(logs), wanted, atol=0.01)
    np.testing.assert_allclose(logs.std(axis=1), [0.05, 0.1], rtol=0.01)


def marks_in(axes):
    """Marks of an axes by the name of their data."""
    return {each.series: each for each in marks_of(axes)}


def a_run():
    """Made-up risk over two frequencies, as `risk_of` returns it from responses of a study."""
    of, settings = of_ratio(0.05, 0.1), {"samples": 64, "repeats": 4, "seed": 1, "indices": True}
    samples = drawn(of, **settings)
    found = made_up(samples, np.where(is_large(samples), 3e-3, 1e-3))
    found["amplitude"].attrs["units"] = "m"
    other = made_up(samples, 1e-3).assign(amplitude=found["amplitude"] / 2.0)
    both = xr.concat([found, other], dim="omega").assign_coords(omega=[1.0, 2.0])
    both = both.expand_dims(representation=["piecewise"]).transpose("representation", ...)
    events = {"large": {"quantity": "amplitude", "above": 2e-3}}
    return risk_of(both, UncertainTable.of_call(of, events, settings))


def test_figures_show_the_dataset():
    found = a_run()
    shown = marks_in(found.gapsweep.risk("large"))
    np.testing.assert_array_equal(shown["piecewise"].y, found["probability"].squeeze())
    ends = np.reshape(shown["piecewise, 95 % interval"].y, (2, 3))
    np.testing.assert_array_equal(ends[:, 0], found["low"].squeeze())
    np.testing.assert_array_equal(ends[:, 1], found["high"].squeeze())
    shown = marks_in(found.gapsweep.quantiles("amplitude"))
    np.testing.assert_allclose(shown["piecewise"].y, [3.0, 1.5])  # mm
    np.testing.assert_allclose(np.reshape(shown["piecewise, 5% to 95%"].y, (2, 3))[0, :2], [1, 3])
    shown = marks_in(found.gapsweep.tornado("large", omega=1.0))
    total = found["total"].isel(omega=0).squeeze().values
    np.testing.assert_allclose(np.reshape(shown["total"].x, (2, 3))[:, 1], np.sort(total))
    with pytest.raises(gs.DatasetError, match="probability"):
        found.drop_vars("probability").gapsweep.risk("large")


def test_medians_and_probabilities_of_all_laws_are_at_their_frequencies():
    """Bars are side by side, lines are not: a peak would seem to be at another frequency."""
    one = a_run()
    laws = xr.concat([one, one.assign_coords(representation=["tanh-1e4"])], dim="representation")
    for shown in (laws.gapsweep.quantiles("amplitude"), laws.gapsweep.risk("large")):
        several = marks_in(shown)
        for label in ("piecewise", "tanh-1e4"):
            np.testing.assert_array_equal(several[label].x, one["omega"])


def test_a_tornado_has_the_number_of_points_left_out():
    of, settings = of_ratio(0.05, 0.1), {"indices": True, "repeats": 2}
    kind = np.zeros(2 * 4 * 256, int)
    kind[[3, 3 + 256, 700]] = gs.ResponseClass.UNRESOLVED  # twice the point 3, and point 188
    found = risk(of, of_switch, response_class=kind, **settings)
    assert found["n_left_out"] == found["quantity_n_left_out"] == 2
    assert "2 Sobol points" in found.gapsweep.tornado("large").get_xlabel()
    whole = risk(of, of_switch, **settings)
    assert "left out" not in whole.gapsweep.tornado("large").get_xlabel()


def test_a_tornado_without_variance_says_so():
    found = risk(of_ratio(0.05, 0.1), lambda samples: 1.0 + 0.0 * samples.row, indices=True)
    assert "variance is 0" in found.gapsweep.tornado("large").get_xlabel()


def test_safe_values_are_judged_by_whole_intervals():
    p = xr.DataArray([[0.001, 0.04, 0.06, 0.2]], dims=("event", "gap"))
    risk = xr.Dataset({"probability": p, "low": p - 0.001, "high": p + 0.02}, {"event": ["large"]})
    assert safety(risk, "gap", "large", 0.05)["safe"].values.tolist() == [1, 0, -1, -1]


EVENT = {"name": "large", "quantity": "amplitude", "above": 1e-3}
MISTAKES = {
    "negative sd": ({"gap": {"normal": 4e-4, "sd": -1e-5}}, r"gap\.sd = -1e-05: must be > 0"),
    # cdf(0) of N(2, 1)
    "gap below zero": ({"gap": {"normal": 2e-4, "sd": 1e-4}}, r"gap < 0 with probability 0\.0228"),
    "K_c below zero": ({"K_c": {"uniform": [-1.0, 3.0]}}, r"K_c < 0 with probability 0\.25"),
    "below zero around the nominal": (
        {"gap": {"normal": 0.0, "sd": 4e-4, "nominal": "plus"}},
        r"gap < 0 at the nominal value 0\.0004 with probability 0\.159",
    ),
    "samples": ({"samples": 1000}, r"samples = 1000: must be a power of two, as 512 or 1024"),
    "quantity": ({"event": [EVENT | {"quantity": "amplitud"}]}, r"'amplitud': must be one"),
    "threshold": ({"event": [{"name": "a", "quantity": "x_max"}]}, r"no threshold; write above"),
    "two events of a name": ({"event": [EVENT, EVENT]}, r"'large': occurs twice"),
    "name": ({"gapp": {"normal": 4e-4, "sd": 1e-5}}, r"gapp: cannot be uncertain; .*K_c"),
    "nothing wanted": ({"quantities": []}, r"give quantities = \['amplitude'\], or an event"),
    "no number": ({"gap": None}, r"no uncertain number; write gap ="),
    "kind": ({"gap": {"gamma": 4e-4}}, r"gap\.gamma = 0\.0004: unknown key"),
    "text": ({"gap": "0.4 +- 0.05 mm"}, r"gap = '.*must be a distribution, as \{ normal"),
    "number": ({"gap": 4e-4}, r"gap = 0\.0004: must be a distribution"),
    "std": ({"gap": {"normal": 4e-4, "sdt": 1e-5}}, r"gap\.sdt = 1e-05: .*did you mean sd"),
    "no name": ({"event": [{"quantity": "amplitude", "above": 1.0}]}, r"write name = \"large\""),
    "no sd": ({"gap": {"normal": 4e-4}}, r"normal needs sd"),
    "descending": ({"gap": {"uniform": [5e-4, 4e-4]}}, r"uniform: .*must be ascending"),
    "matrix": ({"correlation": [[1.0, 0.2], [0.2, 1.0]]}, r"must be 1 rows of 1 numbers"),
    "swept": ({"omega_n": {"normal": 5.0, "sd": 0.1}}, r"omega_n: swept and uncertain"),
    "no file": ({"gap": {"data": "no.csv", "column": "gap"}}, r"no\.csv: cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_have_one_line(mistake):
    change, words = MISTAKES[mistake]
    uncertain = {name: value for name, value in (UNCERTAIN | change).items() if value is not None}
    changes = {"sweep__0__omega_n": [4.0, 5.0]} if mistake == "swept" else {}
    with pytest.raises(gs.StudyError, match=words) as caught:
        study(uncertain=uncertain, **changes)
    assert len(caught.value.problems) == 1


def test_advice_and_branches_are_for_nominal_values():
    uncertain = study()
    assert uncertain.nominal.grid.shape == (3, 1, 1, 3, 1)
    assert advice(uncertain).sizes == advice(gs.Study.from_dict(small_study())).sizes
    with pytest.raises(gs.StudyError, match=r"branches: not together with \[uncertain\]"):
        study(branches={})


def test_mistakes_of_calls():
    law, gap = gs.Piecewise(2.0, gs.Gap(0.2, 0.2)), {"gap": st.norm(0.2, 0.01)}
    calls = {
        "must be a distribution": ({"gap": 0.2}, {}),
        r"gap < 0 with probability 0\.0228": ({"gap": st.norm(0.2, 0.1)}, {}),
        "power of two": (gap, {"samples": 100}),
        "no threshold": (gap, {"events": {"large": {"quantity": "amplitude"}}}),
        "above = '1 N': must be a number in m": (
            gap,
            {"events": {"large": {"quantity": "amplitude", "above": "1 N"}}},
        ),
        "'amplitud': must be one of": (gap, {"quantities": ["amplitud"]}),
        "quantities = 3: must be a list": (gap, {"quantities": 3}),
        "quantities = 'amplitude': must be a list": (gap, {"quantities": "amplitude"}),
        "events = 3: must be events by name": (gap, {"events": 3}),
        "events = {'large': 3}: must be events by name": (gap, {"events": {"large": 3}}),
        "omega: cannot be uncertain": ({"omega": st.norm(9.0, 0.1)}, {}),
        "risk: got an unexpected keyword argument 'sample'": (gap, {"sample": 8}),
        "above = 0.2: must be < below = 0.1": (
            gap,
            {"events": {"both": {"quantity": "amplitude", "above": 0.2, "below": 0.1}}},
        ),
        "amplitude: cannot be uncertain": ({"amplitude": gap["gap"]}, {}),
        "'gapp': must be one of (?!.*\\b(omega|amplitude),)": ({"gapp": gap["gap"]}, {}),
        "v_1: must be|'v_1': must be": ({"v_1": gap["gap"]}, {}),
    }
    for words, (uncertain, options) in calls.items():
        with pytest.raises(gs.ModelError, match=words):
            gs.risk(
                OSCILLATOR, law, uncertain, OMEGA, **({"samples": 8, "events": LARGE} | options)
            )
    hunt_crossley = gs.HuntCrossley(2.0, law.gap, chi=1.0)
    with pytest.raises(gs.ModelError, match=r"'damping': must be one of .*chi"):
        gs.risk(OSCILLATOR, hunt_crossley, {"damping": st.uniform(1, 2)}, OMEGA, events=LARGE)
    with pytest.raises(gs.ModelError, match=r"omega = \[\]: must be at least one"):
        gs.risk(OSCILLATOR, law, gap, [], samples=8, events=LARGE)
    with pytest.raises(gs.StudyError, match="uncertain: missing"):
        gs.risk(gs.Study.from_dict(small_study()))


def test_limits_of_events_have_units_and_gaps_in_millimetres_are_warned_of():
    """Without contact the largest motion is F/(2 ζ k) = 0.25 m, below 0.3 m and above 200 mm."""
    machine = gs.Oscillator(mass=1.0, omega_n=1.0, zeta=0.02, forcing=0.01 * (2 * math.pi) ** 2)
    events = {
        "small": {"quantity": "amplitude", "above": "300 mm"},
        "large": {"quantity": "amplitude", "above": "200 mm"},
    }
    law = gs.Piecewise(100.0, gs.Gap(0.4, 0.4))
    with pytest.warns(UserWarning, match="gaps are in metres"):
        found = gs.risk(machine, law, {"gap": st.norm(400.0, 1.0)}, 1.0, events=events, samples=4)
    assert found["probability"].values.ravel().tolist() == [0.0, 1.0]


def test_initial_states_of_calls_are_uncertain():
    """Bistable at 1.3 rad/s: the upper attractor is reached beyond a velocity of .2915."""
    law, v = gs.Piecewise(2.0, gs.Gap(0.1745, 0.1745)), -0.04309582053817726
    threshold = 0.005277676573152593 + 0.2862056641
    found = gs.risk(
        OSCILLATOR, law, {"v_0": st.uniform(0.27, 0.04), "x_0": st.uniform(v, 1e-12)},
        1.3 / (2.0 * math.pi), events=LARGE, samples=64,
    )  # fmt: skip
    assert float(found["probability"].squeeze()) == pytest.approx(
        (0.31 - threshold) / 0.04, abs=0.01
    )
