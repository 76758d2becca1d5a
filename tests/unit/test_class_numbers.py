"""Numbers of the classes of responses."""

import numpy as np
import pytest

from gapsweep import ResponseClass
from gapsweep.analysis.agreement.law_tables import CLASSES, NONE, class_numbers


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
