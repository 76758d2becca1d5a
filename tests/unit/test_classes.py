"""Classes of responses, their confusion table, and Cohen's kappa."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose

from gapsweep import ResponseClass
from gapsweep.analysis.classes import CLASSES, NONE, class_numbers, confusion, kappa


@pytest.mark.parametrize(
    ("kind", "period", "name"),
    [
        (ResponseClass.PERIODIC, 1, "P1"),
        (ResponseClass.PERIODIC, 8, "P8"),
        (ResponseClass.PERIODIC, 9, "P>8"),
        (ResponseClass.PERIODIC, 32, "P>8"),
        (ResponseClass.CHAOTIC, 0, "chaotic"),
        (ResponseClass.UNRESOLVED, 0, "unresolved"),
        (ResponseClass.FAILED, 0, "failed"),
        (-1, 0, "failed"),  # asked for, but nothing is stored
    ],
)
def test_every_response_has_a_class(kind, period, name):
    arguments = [np.array([value]) for value in (True, int(kind), period)]
    assert CLASSES[class_numbers(*arguments)[0]] == name


def test_what_was_not_asked_for_has_no_class():
    assert class_numbers(np.array([False]), np.array([0]), np.array([1])).tolist() == [NONE]


def test_confusion_counts_points_asked_for_in_both():
    theirs = np.array([[0, 0, 1], [NONE, 11, 2]])
    ours = np.array([[0, 9, 1], [0, NONE, 10]])
    table = confusion(ours, theirs)
    where = np.argwhere(table).tolist()
    assert where == [[0, 0, 0], [0, 0, 9], [0, 1, 1], [1, 2, 10]]
    assert table.sum() == 4


def test_kappa_of_a_table_worked_out_by_hand():
    # 35 of 50 agree; chance (25 * 30 + 25 * 20) / 50^2 = 0.5; (0.7 - 0.5) / 0.5.
    assert_allclose(kappa(np.array([[20.0, 5.0], [10.0, 15.0]])), 0.4)


def test_kappa_where_there_is_nothing_to_tell_apart():
    assert kappa(np.diag([7.0, 0.0])) == 1.0
    assert np.isnan(kappa(np.array([[6.0, 1.0], [0.0, 0.0]])))  # the exact law: one class only
    assert np.isnan(kappa(np.zeros((2, 2))))
    # The exact law shows two classes, the other law one: no better than chance.
    assert kappa(np.array([[6.0, 0.0], [1.0, 0.0]])) == 0.0


tables = hnp.arrays(float, (3, 3), elements={"min_value": 0, "max_value": 50}).map(np.rint)


@given(tables)
def test_kappa_does_not_depend_on_the_order_or_number_of_points(table):
    value = kappa(table)
    assert np.isnan(value) or value <= 1.0
    order = [2, 0, 1]
    assert_allclose(kappa(table[np.ix_(order, order)]), value)
    assert_allclose(kappa(3.0 * table), value, atol=1e-12)
