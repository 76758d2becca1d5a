"""Decisions on hand-made datasets: every kind, every verdict, floors, missing data."""

import json

import numpy as np
import pytest
import xarray as xr

from gapsweep.analysis.claims import evaluated, outcome, verdicts
from gapsweep.study.claims import Claim, Number, Test

LABELS = ["piecewise", "piecewise@half", "tanh-1e4", "arctan-1e4"]
STUDY = {
    "solver": {"engine": "compiled", "rtol": 1e-9, "atol": 1e-12},
    "protocol": {"half": {"rtol": 5e-10, "atol": 5e-13}},
}
COORDINATES = {
    "representation": LABELS,
    "K_c": [1.4e4],
    "gap": ["0.4/0.4"],
    "omega": [1.0, 2.0, 3.0],
    "initial_condition": [0, 1, 2],
    "x_0": ("initial_condition", [0.0, 1e-3, np.nan]),
    "v_0": ("initial_condition", [0.0, 0.0, np.nan]),
    "start": ("initial_condition", ["fixed", "fixed", "sweep_up"]),
    "j_1": ("gap", [4e-4]),
    "j_2": ("gap", [4e-4]),
}
POINT = ("representation", "K_c", "gap", "omega", "initial_condition")
FLAGS = {"flag_values": np.array([0, 1, 2], "i1"), "flag_meanings": "periodic chaotic unresolved"}


def over(dims, values):
    """An array over `dims`: one number per representation, or given in full shape."""
    shape = [len(COORDINATES[dim]) for dim in dims]
    values = np.asarray(values, dtype=float)
    if values.ndim == 1 and len(dims) > 1:
        values = values.reshape(-1, *([1] * (len(dims) - 1)))
    return dims, np.broadcast_to(values, shape).copy()


def datasets(period=(1, 1, 1, 3), recall=(1.0, 0.98, 0.9, 0.3), cost=(2.0, 2.1, 1.0, 1.02)):
    dims, multiple = over(POINT, period)
    responses = xr.Dataset(
        {
            "period_multiple": (dims, multiple.astype("i4")),
            "response_class": (dims, (multiple == 0).astype("i1"), FLAGS),
            "amplitude": over(POINT, np.arange(1.0, 5.0)),
            "x_max": over(POINT, np.zeros(4)),
            "status": (dims, np.zeros(multiple.shape, "i1")),
        },
        COORDINATES,
        {"study_json": json.dumps(STUDY)},
    )
    agreement = xr.Dataset({"recall": over(POINT[:4], recall)}, COORDINATES)
    timing = xr.Dataset({"cpu_time_mean": over(POINT[:3], cost)}, COORDINATES)
    static = xr.Dataset({"poly_rmse": (("degree",), [8.0, 1.0, 0.125])}, {"degree": [2, 4, 8]})
    return {"responses": responses, "agreement": agreement, "timing": timing, "static": static}


def number(data="agreement", variable="recall", label="tanh-1e4", statistic="mean", **more):
    at = {} if data == "static" else {"representation": label}
    return {"data": data, "variable": variable, "at": at, "statistic": statistic} | more


def compare(op, threshold, given=None, **more):
    return {
        "says": "it holds",
        "kind": "compare",
        "number": given or number(),
        "op": op,
        "threshold": threshold,
    } | more


def decided(*tests, data=None, **more):
    claim = Claim(id=1, place="Fig. 0", text="a claim", why="a reason", test=list(tests), **more)
    (entry,) = verdicts([claim], datasets() if data is None else data)["claims"]
    return entry


def value(made=None, /, **given):
    return evaluated(Number(**given), datasets() if made is None else made).value


TRUE, FALSE = compare(">", 0.5), compare("<", 0.5)
OPEN = compare(">", 0.5, number(label="poly-99"))


@pytest.mark.parametrize(
    ("tests", "combine", "verdict"),
    [
        ([TRUE, TRUE], "all", "confirmed"),
        ([FALSE, FALSE], "all", "refuted"),
        ([TRUE, FALSE], "all", "partly"),
        ([TRUE, FALSE, OPEN], "all", "partly"),
        ([TRUE, OPEN], "all", "undecidable"),
        ([FALSE, OPEN], "all", "undecidable"),
        ([FALSE, TRUE, OPEN], "any", "confirmed"),
        ([FALSE, FALSE], "any", "refuted"),
        ([FALSE, OPEN], "any", "undecidable"),
    ],
)
def test_verdict_follows_from_the_tests(tests, combine, verdict):
    assert decided(*tests, combine=combine)["verdict"] == verdict


def test_entry_carries_numbers_floor_and_sentence():
    entry = decided(TRUE)
    (test,) = entry["tests"]
    assert test["value"] == pytest.approx(0.9)
    assert test["floor"] == pytest.approx(0.02)
    assert test["n"] == 3
    assert entry["sentence"] == "Holds (1 of 1): it holds (0.9 > 0.5, floor 0.02)."
    json.dumps(entry, allow_nan=False)


def test_what_the_paper_leaves_unstated_is_said():
    claim = Claim(id=1, place="Fig. 0", text="a claim", why="none", undecidable="the gap")
    (entry,) = verdicts([claim], {})["claims"]
    assert entry["verdict"] == "undecidable"
    assert "the gap" in entry["sentence"]


def test_a_threshold_within_the_floor_decides_nothing():
    # Exact against exact finds 0.98 of itself: whether a law finds 0.99 cannot be told.
    entry = decided(compare(">=", 0.99))
    assert entry["verdict"] == "undecidable"
    assert "floor" in entry["sentence"]
    noisy = datasets(recall=(1.0, 0.4, 0.9, 0.3))
    assert decided(TRUE, data=noisy)["verdict"] == "undecidable"


def test_numbers_of_responses_must_be_further_from_the_threshold_than_the_floor():
    share = number("responses", "", "arctan-1e4", "share", where={"period_multiple": {"is": 3}})
    assert decided(compare(">", 0.5, share))["verdict"] == "confirmed"
    noisy = datasets(period=(1, 3, 1, 3))
    assert decided(compare(">", 0.5, share), data=noisy)["verdict"] == "undecidable"


def test_without_a_second_exact_law_nothing_is_decided():
    alone = {n: d.sel(representation=LABELS[2:] + LABELS[:1]) if n != "static" else d
             for n, d in datasets().items()}  # fmt: skip
    entry = decided(TRUE, data=alone)
    assert entry["verdict"] == "undecidable"
    assert "no floor" in entry["sentence"]


@pytest.mark.parametrize("name", ["agreement", "responses", "timing", "static"])
def test_absent_datasets_leave_claims_undecidable(name):
    variables = {"agreement": "recall", "responses": "amplitude", "timing": "cpu_time_mean",
                 "static": "poly_rmse"}  # fmt: skip
    data = datasets()
    del data[name]
    entry = decided(compare(">", 0.0, number(name, variables[name])), data=data)
    assert entry["verdict"] == "undecidable"
    assert f"no {name}.nc" in entry["sentence"]


def test_absent_variables_and_labels_are_named():
    test = outcome(Test(**compare(">", 0.0, number(variable="nothing"))), datasets())
    assert "nothing" in test["reason"]
    test = outcome(Test(**compare(">", 0.0, number(at={"K_c": 1.0}))), datasets())
    assert "K_c = 1.0" in test["reason"]
    test = outcome(Test(**compare(">", 0.0, number(range={"omega": [8, 9]}))), datasets())
    assert "no omega" in test["reason"]


def test_static_numbers_have_no_floor():
    test = compare("<", -1.0, number("static", "poly_rmse", statistic="slope", along="degree"))
    entry = decided(test)
    assert entry["verdict"] == "confirmed"
    assert entry["tests"][0]["floor"] == 0.0
    assert entry["tests"][0]["value"] == pytest.approx(-3.0)


@pytest.mark.parametrize(("label", "holds"), [("tanh-1e4", False), ("arctan-1e4", True)])
def test_compare_against_another_number(label, holds):
    cost = number("timing", "cpu_time_mean", "piecewise", "only")
    against = {"at": {"representation": label}}
    by_ratio = compare(">=", 1.9, cost, against=against)
    assert decided(by_ratio)["tests"][0]["value"] == pytest.approx(2.0 if not holds else 2 / 1.02)
    recall = compare("<", -0.1, number(), against={"at": {"representation": "arctan-1e4"}},
                     by="difference")  # fmt: skip
    assert decided(recall)["verdict"] == "refuted"
    zero = compare("<", 1.0, number(), against=against)
    assert decided(zero, data=datasets(recall=(1.0, 1.0, 0.0, 0.0)))["verdict"] == "undecidable"


@pytest.mark.parametrize(
    ("order", "verdict"),
    [
        (["arctan-1e4", "tanh-1e4"], "confirmed"),
        (["tanh-1e4", "arctan-1e4"], "refuted"),
        (["piecewise@half", "piecewise"], "undecidable"),
    ],
)
def test_order_must_exceed_the_floor(order, verdict):
    of = [{"at": {"representation": label}} for label in order]
    entry = decided({"says": "it rises", "kind": "order", "number": number(), "of": of})
    assert entry["verdict"] == verdict


@pytest.mark.parametrize(("factor", "verdict"), [(1.5, "confirmed"), (1.01, "undecidable")])
def test_alike_is_a_factor(factor, verdict):
    of = [{"at": {"representation": label}} for label in ("tanh-1e4", "arctan-1e4")]
    test = {"says": "alike", "kind": "alike", "number": number("timing", "cpu_time_mean"),
            "of": of, "threshold": factor}  # fmt: skip
    assert decided(test)["verdict"] == verdict
    different = datasets(cost=(2.0, 2.0, 1.0, 3.0))
    assert decided(test, data=different)["verdict"] == "refuted"


@pytest.mark.parametrize(
    ("start", "expected"), [("rest", 1.0), ("scattered", 2.0), ("sweep_up", 3.0), ("fixed", 1.5)]
)
def test_starts_are_chosen_by_kind(start, expected):
    data = datasets()
    data["responses"]["amplitude"][:] = np.array([1.0, 2.0, 3.0])
    given = number("responses", "amplitude", start=start)
    assert value(data, **given) == expected


def test_frequencies_are_chosen_by_range_and_step():
    data = datasets()
    data["responses"]["amplitude"][:] = np.array([1.0, 2.0, 4.0])[:, None]
    given = number("responses", "amplitude")
    assert value(data, **given, range={"omega": [2, 3]}) == 3.0
    assert value(data, **given, every=2.0) == 2.0
    assert value(data, **(given | {"statistic": "argmax", "along": "omega"})) == 3.0
    rise = given | {"statistic": "largest_rise", "along": "omega"}
    assert value(data, **rise) == pytest.approx(1.0)


def test_shares_count_what_was_asked_for():
    data = datasets()
    data["responses"]["status"][..., 0, :] = 1  # not requested
    data["responses"]["period_multiple"][2, 0, 0] = [[3, 3, 3], [3, 1, 1], [1, 1, 1]]
    given = number("responses", "", "tanh-1e4", "share", where={"period_multiple": {"is": 3}})
    assert value(data, **given) == pytest.approx(1 / 6)
    assert value(data, **given, any_over="initial_condition") == pytest.approx(1 / 2)
    first = given | {"statistic": "first", "along": "omega"}
    assert value(data, **first) == 2.0


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ({"is": 1}, 1 / 3), ({"in": [1, 2]}, 2 / 3), ({"above": 1}, 2 / 3), ({"below": 2}, 1 / 3),
        ({"outside": [2, 2]}, 2 / 3),
    ],
)  # fmt: skip
def test_conditions(condition, expected):
    data = datasets()
    data["responses"]["period_multiple"][:] = np.array([1, 2, 3])
    given = number("responses", "", "tanh-1e4", "share", where={"period_multiple": condition})
    assert value(data, **given) == pytest.approx(expected)


def test_flags_are_named_by_their_meaning():
    chaotic = number(
        "responses", "", "tanh-1e4", "share", where={"response_class": {"is": "chaotic"}}
    )
    assert value(datasets(period=(1, 1, 0, 1)), **chaotic) == 1.0
    wrong = compare(">", 0, chaotic | {"where": {"response_class": {"is": "odd"}}})
    assert "'odd'" in decided(wrong)["sentence"]


def test_basin_shares_are_summed_and_averaged():
    data = datasets()
    shares = np.array([[0.75, 0.25], [1.0, 0.0], [0.5, 0.5]])
    multiples = np.array([[1, 3], [1, -1], [3, 3]])
    full = (4, 1, 1, 3, 2)
    data["attractors"] = xr.Dataset(
        {
            "basin_share": ((*POINT[:4], "attractor"), np.broadcast_to(shares, full)),
            "period_multiple": ((*POINT[:4], "attractor"), np.broadcast_to(multiples, full)),
        },
        {k: v for k, v in COORDINATES.items() if k in POINT[:4]},
    )
    given = number("attractors", "", "tanh-1e4", "share", where={"period_multiple": {"is": 3}},
                   any_over="attractor", weight="basin_share")  # fmt: skip
    assert value(data, **given) == pytest.approx(1.25 / 3)


def test_a_missing_response_can_be_the_worst_error():
    data = datasets()
    dims, errors = over(POINT, np.full(4, 0.01))
    errors[2, 0, 0, :2] = np.nan
    data["agreement"]["amplitude_error"] = (dims, errors)
    given = number(variable="amplitude_error", statistic="median")
    found = evaluated(Number(**given), data)
    assert (found.value, found.n, found.n_missing) == (0.01, 3, 6)
    worst = compare("<=", 0.05, given | {"missing": "worst"})
    assert decided(worst, data=data)["verdict"] == "refuted"
    assert decided(worst, data=data)["tests"][0]["value"] is None


def test_costs_are_per_forcing_period():
    data = datasets()
    data["responses"]["cpu_time"] = over(POINT, np.full(4, 6.0))
    data["responses"]["t_simulated"] = over(POINT, np.full(4, 2.0))
    given = number("responses", "cpu_time", per_period=True, range={"omega": [3, 3]})
    assert value(data, **given) == 1.0
