"""Agreement metrics on hand-made responses, and the Hausdorff distance by brute force."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from gapsweep import ResponseClass, Status
from gapsweep.analysis.agreement import agreement, hausdorff
from gapsweep.analysis.timing import timing
from gapsweep.study.schema import POINT_DIMS

numbers = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=8).map(np.array)


@given(numbers, numbers)
def test_hausdorff_is_the_largest_nearest_distance(a, b):
    table = np.abs(a[:, None] - b[None, :])
    assert hausdorff(a, b) == max(table.min(axis=0).max(), table.min(axis=1).max())
    assert hausdorff(a, b) == hausdorff(b, a)
    assert hausdorff(a, np.append(a, np.nan)) == 0.0


def test_hausdorff_of_an_empty_set_is_unknown():
    assert np.isnan(hausdorff(np.array([np.nan]), np.array([1.0])))


def responses(amplitude, period, extrema, status=None, host=None, cpu_time=None):
    """Two representations (exact first) at as many frequencies as columns are given."""
    shape = (2, 1, 1, np.shape(amplitude)[1], 1)

    def grid(values, dtype=float):
        return POINT_DIMS, np.reshape(np.array(values, dtype), shape)

    zeros = np.zeros(shape)
    return xr.Dataset(
        {
            "amplitude": grid(amplitude),
            "period_multiple": grid(period, int),
            "response_class": grid(np.where(np.array(period) > 0, ResponseClass.PERIODIC, 2), int),
            "status": grid(np.zeros(shape) if status is None else status, int),
            "extrema": ((*POINT_DIMS, "extremum"), np.reshape(extrema, (*shape, -1))),
            "host": (POINT_DIMS, np.reshape(zeros if host is None else host, shape).astype(int),
                     {"flag_meanings": "left right"}),
            "cpu_time": grid(zeros if cpu_time is None else cpu_time),
            **{name: grid(zeros, int) for name in ("nfev", "n_steps", "n_rejected", "n_contacts")},
        },
        coords={
            "representation": ["piecewise", "tanh-1e4"],
            "K_c": [1.4e4],
            "gap": ["0.4/0.4"],
            "j_1": ("gap", [0.4e-3]),
            "j_2": ("gap", [0.4e-3]),
            "omega": np.arange(1.0, shape[3] + 1),
            "initial_condition": [0],
        },
        attrs=dict.fromkeys(("title", "study", "study_json", "numerics_fingerprint"), ""),
    )  # fmt: skip


def test_metrics_of_known_responses():
    data = responses(
        amplitude=[[1e-3, 0.1e-3], [1.1e-3, 0.2e-3]],
        period=[[1, 1], [1, 2]],
        extrema=[[[1e-3, -1e-3], [1e-4, -1e-4]], [[1.1e-3, -1.1e-3], [2e-4, -2e-4]]],
    )
    result = agreement(data).sel(representation="tanh-1e4").squeeze()
    # The second amplitude is below half the gap, 0.4 mm, which then is the scale.
    assert_allclose(result["amplitude_error"], [0.1, 0.25])
    assert_allclose(result["extrema_distance"], [1e-4, 1e-4])
    assert result["class_agreement"].values.tolist() == [1.0, 0.0]
    assert_allclose(result["amplitude_error_median"], 0.175)
    assert_allclose(result["class_agreement_mean"], 0.5)


def test_exact_law_agrees_with_itself():
    data = responses([[1e-3, 2e-3]] * 2, [[1, 0]] * 2, [[[1e-3], [2e-3]]] * 2)
    result = agreement(data)
    assert (result["amplitude_error"] == 0).all()
    assert (result["class_agreement"] == 1).all()


def test_points_without_a_response_are_counted_not_dropped():
    nan = np.nan
    data = responses(
        amplitude=[[1e-3, 1e-3], [nan, 1e-3]],
        period=[[1, 1], [0, 1]],
        extrema=[[[1e-3], [1e-3]], [[nan], [1e-3]]],
        status=[[0, 0], [Status.DIVERGED, 0]],
    )
    result = agreement(data).sel(representation="tanh-1e4").squeeze()
    assert (int(result["n_compared"]), int(result["n_points"])) == (1, 2)
    assert np.isnan(result["class_agreement"].values[0])


def test_no_exact_law_no_agreement():
    data = responses([[1e-3]] * 2, [[1]] * 2, [[[1e-3]]] * 2)
    assert agreement(data.isel(representation=[1])) is None


def test_times_of_different_machines_are_never_mixed():
    data = responses(
        [[1e-3] * 3] * 2, [[1] * 3] * 2, [[[1e-3]] * 3] * 2,
        host=[[0, 1, 1], [1, 1, 0]], cpu_time=[[100.0, 2.0, 4.0], [1.0, 3.0, 100.0]],
    )  # fmt: skip
    result = timing(data)
    assert_allclose(result["cpu_time_mean"].squeeze(), [3.0, 2.0])
    assert result["n_points_elsewhere"].values.ravel().tolist() == [1, 1]
    assert result.attrs["measured_on"] == "right"


@pytest.mark.parametrize("make", [agreement, timing])
def test_every_variable_has_a_unit_and_a_name(make):
    data = responses([[1e-3]] * 2, [[1]] * 2, [[[1e-3]]] * 2)
    for variable in make(data).data_vars.values():
        assert variable.attrs["units"]
        assert variable.attrs["long_name"]
