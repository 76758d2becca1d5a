"""Claims: numbers with their floors, tests, and the rule that makes a verdict of them."""

import json
import math
import operator
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from gapsweep.analysis.claims import (
    CONFIRMED,
    PARTLY,
    REFUTED,
    UNDECIDABLE,
    Claim,
    NotInRunError,
    Number,
    Run,
    Test,
    claim,
    counted,
    mean,
    ratio_of_sums,
    share,
    stated,
    verdict,
)
from gapsweep.status import Status

NUMBERS = st.floats(-1e6, 1e6)
DIMS = ("representation", "K_c", "gap", "omega", "initial_condition")


# --- numbers ---------------------------------------------------------------------------------


def test_of_what_is_not_known_no_share_is_taken():
    known, unknown = [1.0, 0.0, 1.0], [np.nan] * 5
    assert share([*known, *unknown]).value == share(known).value
    assert share([*known, *unknown]).n == 3


def test_the_floor_of_a_share_is_twice_the_spread_of_shares_among_so_many():
    rng = np.random.default_rng(1)
    for n, likely in ((30, 0.5), (100, 0.2), (300, 0.9)):
        shares = [share(hits) for hits in rng.random((2000, n)) < likely]
        floors = np.mean([one.floor for one in shares])
        assert_allclose(floors, 2.0 * np.std([one.value for one in shares]), rtol=0.1)


@pytest.mark.parametrize(("hits", "value"), [([True] * 4, 1.0), ([False] * 4, 0.0)])
def test_all_or_none_of_a_few_is_not_certain(hits, value):
    found = share(hits)
    assert (found.value, found.n) == (value, 4)
    assert 0.2 < found.floor < 0.6


def test_the_floor_of_a_ratio_of_sums_is_twice_the_spread_of_other_samples():
    rng = np.random.default_rng(2)
    below = rng.lognormal(size=(400, 200))
    above = 3.0 * below * rng.lognormal(sigma=0.3, size=below.shape)
    found = [ratio_of_sums(a, b) for a, b in zip(above, below, strict=True)]
    assert_allclose(found[0].value, above[0].sum() / below[0].sum())
    spread = np.std([one.value for one in found])
    assert_allclose(np.mean([one.floor for one in found]), 2.0 * spread, rtol=0.15)


@pytest.mark.parametrize("op", [operator.sub, operator.truediv])
def test_two_shares_of_the_same_points_are_compared_in_pairs(op):
    """They move together: their difference and ratio scatter less than two of other points."""
    rng = np.random.default_rng(3)
    hard = rng.random((1000, 200)) < 0.5
    lucky = rng.random(hard.shape) < 0.1
    of = np.arange(200.0)
    pairs = [(share(a, of), share(b, of)) for a, b in zip(hard | lucky, hard, strict=True)]
    found = [op(a, b) for a, b in pairs]
    spread = np.std([one.value for one in found])
    assert_allclose(np.mean([one.floor for one in found]), 2.0 * spread, rtol=0.2)
    unlike = [op(replace(a, of=of + 0.5), b) for a, b in pairs]
    assert np.mean([one.floor for one in unlike]) > 1.5 * np.mean([one.floor for one in found])


@pytest.mark.parametrize("op", [operator.sub, operator.truediv])
def test_pairs_are_the_points_that_both_have(op):
    """One point without a number loses that pair alone, and not the pairing."""
    rng = np.random.default_rng(4)
    omega = xr.DataArray(np.arange(100.0), dims="omega")
    ours = (rng.random((2, 100)) < [[0.5], [0.8]]).astype(float)
    one, other = (xr.DataArray(row, {"omega": omega}) for row in ours)
    gone = one.where(omega != 7), other.where(omega != 20)
    both = (omega != 7) & (omega != 20)
    found, wanted = op(*map(mean, gone)), op(*(mean(row[both]) for row in (one, other)))
    assert (found.value, found.floor, found.n) == (wanted.value, wanted.floor, 98)
    aside = op(mean(one), mean(other.assign_coords(omega=omega + 0.5)))
    assert (aside.n, op(mean(one), mean(other.values)).n) == (200, 200)
    with pytest.raises(NotInRunError):
        op(mean(one.where(omega < 50)), mean(other.where(omega >= 50)))


def test_a_ratio_of_sums_takes_the_points_that_have_both():
    found = ratio_of_sums([2.0, np.nan, 4.0, 1.0], [1.0, 1.0, 2.0, np.nan])
    assert (found.value, found.n) == (2.0, 2)
    assert found.floor == 0.0  # each point has the same ratio
    assert ratio_of_sums([2.0], [1.0]).floor == 0.0


def test_of_nothing_there_is_no_number():
    for made in (lambda: share([]), lambda: ratio_of_sums([np.nan], [1.0])):
        with pytest.raises(NotInRunError):
            made()


def test_differences_and_ratios_carry_their_floors():
    one, other = Number(3.0, 0.3, 5), Number(2.0, 0.4, 6)
    difference = one - other
    assert (difference.value, difference.n) == (1.0, 11)
    assert_allclose(difference.floor, 0.5)
    ratio = one / other
    assert (ratio.value, ratio.n) == (1.5, 11)
    assert_allclose(ratio.floor, math.hypot(0.3, 1.5 * 0.4) / 2.0)
    assert math.isnan((one / Number(0.0)).value)


# --- tests and verdicts ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "op", "threshold", "holds"),
    [
        (1.0, "<", 2.0, True), (2.0, "<", 2.0, False), (2.0, "<=", 2.0, True),
        (3.0, "<=", 2.0, False), (3.0, ">", 2.0, True), (2.0, ">", 2.0, False),
        (2.0, ">=", 2.0, True), (1.0, ">=", 2.0, False), (math.nan, "<", 2.0, None),
    ],
)  # fmt: skip
def test_a_number_without_a_floor_decides_by_itself(value, op, threshold, holds):
    assert Test("", Number(value), op, threshold).holds is holds


@given(NUMBERS, st.floats(1e-6, 1e6), NUMBERS, st.sampled_from(["<", "<=", ">", ">="]))
def test_a_test_is_open_exactly_within_the_floor(value, floor, threshold, op):
    holds = Test("", Number(value, floor), op, threshold).holds
    assert (holds is None) == (abs(value - threshold) <= floor)
    assert holds in (None, Test("", Number(value), op, threshold).holds)


@given(st.lists(st.sampled_from([True, False, None])))
def test_only_what_all_tests_bear_out_is_confirmed(holds):
    n_held, n_failed, n_open = (holds.count(one) for one in (True, False, None))
    found = verdict(holds)
    is_told = bool(n_held and n_failed) or n_held + n_failed >= max(n_open, 1)
    assert (found == UNDECIDABLE) == (not is_told)
    assert (found == CONFIRMED) == (n_held > 0 and n_failed == n_open == 0)
    assert (found == REFUTED) == (is_told and n_held == 0)
    assert (found == PARTLY) == (is_told and n_held > 0 and n_failed + n_open > 0)


def made(id, *values, floor=0.0):
    """A claim that its numbers are above 1."""

    @claim(id, f"Fig. {id}", "It is large.", "It is above 1.")
    def large(run):
        return [Test("size", Number(value, floor), ">", 1.0) for value in values], "Measured."

    return large


def test_verdicts_are_fit_for_json_and_in_order():
    claims = {
        1: made(1, np.float32(2)),
        2: made(2, 0.5),
        3: made(3, 0.5, 2.0),
        4: made(4, math.nan),
    }
    ordered = stated({str(id): claims[id] for id in (4, 3, 1, 2)})
    assert ordered == list(claims.values())
    decided = counted([claim.decided(Run({})) for claim in ordered])
    found = json.loads(json.dumps(decided, allow_nan=False))
    assert [one["verdict"] for one in found["claims"]] == [CONFIRMED, REFUTED, PARTLY, UNDECIDABLE]
    assert found["counts"] == {CONFIRMED: 1, REFUTED: 1, PARTLY: 1, UNDECIDABLE: 1}
    (test,) = found["claims"][3]["tests"]
    expected = {"says": "size", "value": None, "floor": 0.0, "op": ">", "threshold": 1.0}
    assert test == {**expected, "holds": None, "n": 1}


def test_claims_are_counted_with_each_other_setting_too():
    """A claim that does not depend on a setting counts with its own verdict."""

    def holding(id, holds, **others):
        tests = {None: [], True: [Test("", Number(2.0), ">", 1.0)]}
        tests[False] = [Test("", Number(0.0), ">", 1.0)]
        with_others = {words: tests[one] for words, one in others.items()}
        return Claim(id, "", "", "", lambda run: (tests[holds], "", with_others)).decided(Run({}))

    claims = [holding(1, True, at_rest=False), holding(2, True, coarse=None), made(3, 2.0)]
    decided = [*claims[:2], claims[2].decided(Run({}))]
    assert [one["otherwise"] for one in decided] == [
        {"at_rest": REFUTED}, {"coarse": UNDECIDABLE}, {},
    ]  # fmt: skip
    found = counted(decided)
    assert found["counts"] == {CONFIRMED: 3, REFUTED: 0, PARTLY: 0, UNDECIDABLE: 0}
    assert found["otherwise"] == {
        "at_rest": {CONFIRMED: 2, REFUTED: 1, PARTLY: 0, UNDECIDABLE: 0},
        "coarse": {CONFIRMED: 2, REFUTED: 0, PARTLY: 0, UNDECIDABLE: 1},
    }


def test_open_tests_are_named():
    sentence = made(5, math.nan, 0.9, floor=0.2).decided(Run({}))["sentence"]
    assert sentence == "Measured. Open (no number, or within its uncertainty): size; size."


def test_what_the_run_has_not_leaves_a_claim_undecidable():
    asking = Claim(1, "", "", "", lambda run: run["ladders"])
    found = asking.decided(Run({}))
    assert found["verdict"] == UNDECIDABLE
    assert found["sentence"] == "Not decided: the run has no ladders.nc."


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (None, "must return a list of tests, a sentence.*, not None"),
        (([], "said", 3), "must return a list of tests"),
        (([Number(1.0)], "said"), "must return a list of tests"),
        (([], "said", {"rest": [1]}), "must return a list of tests"),
        (([], "said", {"\n": []}), "must be one printable line"),
        (([], 5), "sentence: must be text, not 5"),
        (([], "half \ud800"), "sentence: must be one printable line, without '.ud800'"),
        (([], "two\nlines"), "sentence: must be one printable line"),
    ],
)
def test_what_a_claim_must_return(found, said):
    with pytest.raises((TypeError, ValueError), match=said):
        Claim(7, "", "", "", lambda run: found).decided(Run({}))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"threshold": "2"}, "threshold: must be a number, not '2'"),
        ({"op": "=="}, "op: must be one of <, <=, >, >=, not '=='"),
        ({"number": 1.0}, "number: must be a Number, not 1.0"),
        ({"says": None}, "says: must be text, not None"),
    ],
)
def test_what_a_test_must_hold(changed, said):
    with pytest.raises((TypeError, ValueError), match=said):
        Test(**{"says": "", "number": Number(1.0), "op": "<", "threshold": 2.0, **changed})


@pytest.mark.parametrize("threshold", [math.nan, math.inf, -math.inf])
def test_a_threshold_that_is_no_number_is_stored_as_none(threshold):
    endless = Test("", Number(math.inf), ">", threshold)
    assert endless.holds is (True if threshold == -math.inf else None)
    found = Claim(7, "", "", "", lambda run: ([endless], "")).decided(Run({}))
    assert json.loads(json.dumps(found, allow_nan=False))["tests"][0]["threshold"] is None


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"id": "a"}, "claim 'a': id: must be a whole number from 1"),
        ({"id": True}, "id: must be a whole number"),
        ({"id": 0}, "id: must be a whole number"),
        ({"text": 5}, "claim 3: text: must be text, not 5"),
        ({"why": None}, "claim 3: why: must be text, not None"),
        ({"place": "\x1b[2J"}, "claim 3: place: must be one printable line"),
    ],
)
def test_what_a_claim_must_state(changed, said):
    with pytest.raises((TypeError, ValueError), match=said):
        claim(**{"id": 3, "place": "", "text": "", "why": "", **changed})(len)


def test_claims_of_a_module_are_found_once_and_numbered_apart():
    one, other = made(1), made(2)
    names = {"a": one, "b": other, "also": one, "Claim": Claim, "n": 1}
    assert stated(names) == [one, other]
    with pytest.raises(ValueError, match="claim 1: must have different numbers"):
        stated({"a": one, "b": made(1)})
    with pytest.raises(ValueError, match="no claims"):
        stated({"Claim": Claim})


# --- the run ---------------------------------------------------------------------------------


@pytest.fixture
def run():
    """Two laws from rest, from elsewhere and swept up; one point was not asked for."""
    status = np.full((2, 1, 1, 4, 3), Status.OK)
    status[0, 0, 0, 3, 0] = Status.NOT_REQUESTED
    return Run(
        {
            "responses": xr.Dataset(
                {"status": (DIMS, status), "x": (DIMS, np.arange(24.0).reshape(status.shape))},
                {
                    "representation": ["piecewise", "tanh-1e4"],
                    "K_c": [1.4e4],
                    "gap": ["0.4/0.4"],
                    "omega": [1.0, 2.0, 3.0, 4.0],
                    "start": ("initial_condition", ["fixed", "fixed", "sweep_up"]),
                    "x_0": ("initial_condition", [0.0, 1e-3, np.nan]),
                    "v_0": ("initial_condition", [0.0, 0.0, np.nan]),
                },
            )
        }
    )


@pytest.mark.parametrize(
    ("how", "values"),
    [
        ({}, [0, 3, 6]),
        ({"band": (2.0, 3.0)}, [3, 6]),
        ({"start": "scattered"}, [1, 4, 7, 10]),
        ({"start": "sweep_up", "band": (4.0, 9.0)}, [11]),
    ],
)
def test_points_are_those_that_were_asked_for(run, how, values):
    assert run.points("piecewise", 1.4e4, "0.4/0.4", "x", **how)["x"].values.tolist() == values


@pytest.mark.parametrize(
    "asked",
    [
        lambda run: run.points("piecewise", 1.4e4, "0.4/0.4", "x", band=(4.0, 5.0)),
        lambda run: run.points("poly-3", 1.4e4, "0.4/0.4", "x"),
        lambda run: run.points("piecewise", 1.4e4, "0.4/0.4", "x", data="agreement"),
        lambda run: run.select("responses", gap="0/0"),
        lambda run: run.select("static", gap="0/0"),
    ],
)
def test_what_is_not_there_is_said_to_be_absent(run, asked):
    with pytest.raises(NotInRunError):
        asked(run)


def test_a_missing_variable_is_named(run):
    with pytest.raises(NotInRunError, match=r"responses\.nc has no nfev"):
        run.scene("responses", "piecewise", 1.4e4, "0.4/0.4", "x", "nfev")
    with pytest.raises(NotInRunError, match=r"no values at representation poly-3, K_c 14000"):
        run.scene("responses", "poly-3", 1.4e4, "0.4/0.4", "x")


def test_selections_are_read_once(run):
    first = run.select("responses", gap="0.4/0.4", K_c=1.4e4)
    assert run.select("responses", K_c=1.4e4, gap="0.4/0.4") is first
