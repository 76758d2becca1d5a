"""Start-wise metrics of made-up responses, against the definitions."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.builders.datasets import datasets, failed, periodic, tables

from gapsweep.analysis.agreement.bootstrap import ratio
from gapsweep.analysis.agreement.law_tables import law_table
from gapsweep.analysis.agreement.pointwise import cost_sums, start_metrics

G = 0.8e-3
W = 7.0


@pytest.fixture
def slabs(tmp_path):
    def pair(ours, exact):
        answers = {"piecewise": exact, "tanh-1e4": ours}
        study = tables(answers, [W], gap=(0.0, G), starts=len(exact))
        files = datasets(tmp_path, study, lambda label, _, i: answers[label][i])
        return [law_table(*files, {"representation": r, "K_c": 0, "gap": 0}) for r in (1, 0)]

    return pair


@pytest.fixture
def compare(slabs):
    def metrics(ours, exact):
        found = start_metrics(*slabs(ours, exact), G / 2)
        return {name: values[0].tolist() for name, values in found.items()}

    return metrics


def test_amplitude_error_of_small_responses_is_relative_to_half_the_gap(compare):
    ours = [periodic([[x, 0.0]], W) for x in (1.1e-3, 0.2e-3)]
    exact = [periodic([[x, 0.0]], W) for x in (1.0e-3, 0.1e-3)]
    assert_allclose(compare(ours, exact)["amplitude_error"], [0.1, 0.25])


def test_points_without_a_response_are_compared_by_class_alone(compare):
    some = periodic([[1e-3, 0.0]], W)
    away = periodic([[1e-3, 0.0]], W, amplitude=np.inf)
    result = compare([failed(), some, failed(), away], [some, failed(), failed(), some])
    assert result["class_agreement"] == [0.0, 0.0, 1.0, 1.0]
    assert np.isnan(result["amplitude_error"]).all()


def test_costs_are_summed_where_both_have_a_response(slabs):
    some = periodic([[1e-3, 0.0]], W)
    exact = [periodic([[1e-3, 0.0]], W, contacts_per_period=7.0), some, failed()]
    ours, theirs = slabs([some, failed(), some], exact)
    sums = {name: values[0].tolist() for name, values in cost_sums(ours, theirs).items()}
    assert_allclose(sums["contacts_per_period"], [[2.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    assert_allclose(sums["cpu_time_per_period_ratio"], [[0.5, 10.0 * W] * 2, [0.0] * 4, [0.0] * 4])
    elsewhere = replace(theirs, host=theirs.host + 1)
    assert not cost_sums(ours, elsewhere)["cpu_time_per_period_ratio"].any()


def test_longer_runs_do_not_make_a_law_dearer(slabs):
    exact = [periodic([[1e-3, 0.0]], W, cpu_time=1.0, t_simulated=10.0)]
    ours = [periodic([[1e-3, 0.0]], W, cpu_time=6.0, t_simulated=30.0)]
    sums = cost_sums(*slabs(ours, exact))
    assert_allclose(ratio(sums["cpu_time_per_period_ratio"].sum((0, 1))), 2.0)
