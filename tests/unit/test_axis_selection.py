"""Selection along an axis: one rule of what is equal, and messages that say what there is."""

import decimal
import math
import re

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from gapsweep.study.axis_selection import is_several, listed, numbers_of_sweeps, positions
from gapsweep.study.points import canonical
from gapsweep.variables import canonical_values

LABELS = ["piecewise", "tanh-1e4", "tanh-1e4@paper", "mine:spring"]
AXES = st.lists(st.floats(-1e6, 1e6).map(canonical), min_size=1, max_size=20, unique=True)


@given(AXES, st.data())
def test_what_is_held_is_found_where_it_is(axis, data):
    wanted = data.draw(st.lists(st.sampled_from(axis), min_size=1))
    found = positions("omega", axis, wanted)
    assert found.tolist() == sorted({axis.index(value) for value in wanted})
    assert positions("omega", axis, np.array(wanted)).tolist() == found.tolist()
    assert positions("omega", axis, xr.DataArray(wanted)).tolist() == found.tolist()


@given(AXES, st.data())
def test_numbers_are_equal_to_twelve_digits(axis, data):
    value = data.draw(st.sampled_from(axis))
    assert positions("K_c", axis, value * (1.0 + 1e-14)).tolist() == [axis.index(value)]
    if value and canonical(value * (1.0 + 1e-10)) not in axis:
        with pytest.raises(ValueError, match=r"K_c = .*: not in this dataset, which has"):
            positions("K_c", axis, value * (1.0 + 1e-10))


@given(AXES, st.data())
def test_slices_hold_both_ends(axis, data):
    ends = data.draw(st.lists(st.sampled_from(axis), min_size=2, max_size=2))
    low, high = sorted(ends)
    found = positions("omega", axis, slice(low, high)).tolist()
    assert found == [i for i, value in enumerate(axis) if low <= value <= high]
    assert positions("omega", axis, slice(None, high)).tolist() == [
        i for i, value in enumerate(axis) if value <= high
    ]
    assert positions("omega", axis, slice(None)).size == len(axis)


@pytest.mark.parametrize(
    ("name", "axis", "wanted", "found"),
    [
        ("representation", LABELS, "tanh-10000", [1]),
        ("representation", LABELS, ("tanh-1.0e4@paper", "piecewise"), [0, 2]),
        ("representation", LABELS, "mine:spring", [3]),
        ("representation", ["response"], "response", [0]),  # no label of a law, but what there is
        ("gap", ["0.4/0.4", "0/0.8"], "0.40/0.4", [0]),
        ("gap", ["0.4/0.4", "0/0.8"], slice(None), [0, 1]),
        ("start", ["fixed", "fixed", "sweep_up"], "fixed", [0, 1]),
        ("start", ["rest", "+0.4 mm"], "+0.4 mm", [1]),  # a label, no quantity
        ("initial_condition", [0, 1, 2], range(2), [0, 1]),
        ("x_0", [0.0, np.nan, 1e-3], 1e-3, [2]),
        ("omega", 7.0, 7, [0]),  # a selection before has left a scalar
    ],
)
def test_spellings_and_kinds_of_axes(name, axis, wanted, found):
    assert positions(name, axis, wanted).tolist() == found


@pytest.mark.parametrize(
    ("wanted", "found"),
    [
        ("sweep_up", 2),
        (["sweep_down", 0], [3, 0]),
        (1, 1),
        (slice(0, 1), slice(0, 1)),
        ("fixed", "fixed"),  # not one initial condition
    ],
)
def test_sweeps_have_names(wanted, found):
    assert numbers_of_sweeps(wanted, ["fixed", "fixed", "sweep_up", "sweep_down"]) == found


@pytest.mark.parametrize(
    ("name", "axis", "wanted", "said"),
    [
        (
            "omega",
            [7.0, 7.5],
            8.1,
            "omega = 8.1: not in the study, which has 7, 7.5; the nearest is 7.5",
        ),
        (
            "omega",
            [7.0, 7.5],
            np.float64(8.1),
            "omega = 8.1: not in the study, which has 7, 7.5; the nearest is 7.5",
        ),
        (
            "omega",
            [7.0],
            slice(20, 30),
            "omega = 20 to 30: no values in this range; the study has 7",
        ),
        ("omega", [7.0], slice(1, 9, 2), "omega = slice(1, 9, 2): must be a slice without a step"),
        ("omega", [7.0], slice("a", 9), "omega = slice('a', 9, None): the ends must be numbers"),
        ("omega", [7.0], [], "omega = []: empty; name at least one value"),
        ("K_c", [1.4e4], "hard", "K_c = 'hard': not in the study, which has 14000"),
        ("K_c", [1.4e4], None, "K_c = None: not in the study, which has 14000"),
        ("K_c", [1.4e4], math.nan, "K_c = nan: not in the study, which has 14000"),
        (
            "gap",
            ["0/0.8"],
            slice(0, 1),
            "gap = slice(0, 1, None): must be a label or a list of labels",
        ),
        ("gap", ["0/0.8"], "wide", "gap = 'wide': not in the study, which has 0/0.8"),
        (
            "representation",
            LABELS[:2],
            "tan",
            "representation = 'tan': not in the study, which has piecewise, tanh-1e4",
        ),
    ],
)
def test_what_is_not_there_is_named_in_one_line(name, axis, wanted, said):
    with pytest.raises(ValueError, match=re.escape(said)) as raised:
        positions(name, axis, wanted, "the study")
    assert str(raised.value) == said


def test_of_many_values_both_ends_are_listed():
    assert listed(np.arange(9.0)) == "0, 1, 2, ..., 6, 7, 8"
    assert listed(["a", "b"]) == "a, b"


@pytest.mark.parametrize(
    "wanted", [[1.0], (1.0,), range(2), np.ones(2), slice(1), xr.DataArray([1])]
)
def test_several(wanted):
    assert is_several(wanted)


@pytest.mark.parametrize(
    "wanted", [1.0, "ab", None, np.float64(1.0), np.array(1.0), xr.DataArray(1)]
)
def test_one(wanted):
    assert not is_several(wanted)


def rounded(x):
    """A finite number with 12 significant decimal digits, halves to even, as the nearest float."""
    context = decimal.Context(prec=12, rounding=decimal.ROUND_HALF_EVEN)
    return float(context.create_decimal(decimal.Decimal(x))) + 0.0


def test_arrays_are_rounded_to_the_last_bit_as_decimal_numbers():
    rng = np.random.default_rng(1)
    anything = rng.standard_normal(2000) * 10.0 ** rng.integers(-30, 30, 2000)
    powers = 10.0 ** np.arange(-30, 30)
    near_powers = np.concatenate([np.nextafter(powers, 0.0), powers * (1.0 - 4e-13)])
    halves = (rng.integers(10**11, 10**12, 2000) + 0.5) / 10.0 ** rng.integers(0, 23, 2000)
    several = np.concatenate([anything, powers, near_powers, halves, [0.0, -0.0, 5e-324, 1.7e308]])
    found = canonical_values(several.reshape(2, -1)).ravel()
    expected = np.array([rounded(x) for x in several.tolist()])
    np.testing.assert_array_equal(found.view(np.int64), expected.view(np.int64))
    np.testing.assert_array_equal(canonical_values([np.inf, np.nan]), [np.inf, np.nan])
