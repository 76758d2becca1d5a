"""Responses as columns: to rows and back, some of them, several together."""

from dataclasses import asdict, fields, replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal, assert_equal

import gapsweep as gs
from gapsweep.integrate.problem import Solver
from gapsweep.model.systems import paper_oscillator
from gapsweep.response.ragged import RaggedArrays, spans
from gapsweep.response.respond import respond_all
from gapsweep.response.result import COLUMNS, LISTS, Response, Responses
from gapsweep.response.scene import Scene

ASYMMETRIC = gs.Gap(0.0, 0.8e-3)

INPUTS = next(each for each in fields(Response) if each.name == "inputs")


@pytest.fixture(scope="module")
def responses():
    """Responses of every class, alternating between several laws."""
    steady = gs.Steady(settle_tol=1e-2, max_decay_times=6.0)
    laws = [
        gs.Piecewise(1.4e6, ASYMMETRIC),
        gs.Tanh(1.4e4, ASYMMETRIC, 1e4),
        gs.Piecewise(1.4e4, ASYMMETRIC),
    ]
    points = [(paper_oscillator(), law, w, 0.0) for w in (7.0, 14.0, 21.75) for law in laws]
    points.insert(2, (paper_oscillator(alpha=-7e8), laws[2], 5.0, 5e-3))
    return respond_all(
        [
            Scene(oscillator=oscillator, law=law, omega=omega, solver=Solver.of())
            for oscillator, law, omega, _ in points
        ],
        [(x_0, 0.0) for *_, x_0 in points],
        steady,
    )


def test_every_field_of_an_oscillators_response_is_a_column_a_list_or_the_message():
    assert {f.name for f in fields(Response)} == {
        *COLUMNS,
        *LISTS,
        "message",
        "inputs",
    }


def test_columns_have_the_types_and_the_order_of_the_table(responses):
    found = {name: column.dtype.str[1:] for name, column in responses.columns.items()}
    assert [*found.items()] == [
        (name, variable.dtype) for name, variable in COLUMNS.items() if name in found
    ]
    assert {*COLUMNS} - {*found} == {"period", "z_end", "contact_x_max", "contact_x_min"}
    for name, (items, counts) in responses.lists.items():
        assert items.dtype.str[1:] == LISTS[name]
        assert counts.dtype == np.int64
        assert counts.sum() == len(items)
    assert list(responses.messages) == [2]


def test_rows_are_plain_values_and_make_the_same_columns_again(responses):
    rows = responses.rows()
    assert {row.response_class for row in rows} >= {gs.ResponseClass.PERIODIC,
                                                     gs.ResponseClass.FAILED}  # fmt: skip
    assert rows[2].status is gs.Status.DIVERGED
    assert rows[2].message.startswith("diverged before t = ")
    for k, row in enumerate(rows):
        assert repr(responses.row(k)) == repr(row)
        for field in set(fields(row)) - {INPUTS}:
            value = getattr(row, field.name)
            if field.name == "multipliers":
                assert (value.dtype, value.ndim) == (np.dtype(complex), 1)
                continue
            kind = (gs.Status, gs.ResponseClass, int, float, str, tuple)
            assert type(value) in kind, field.name
            if isinstance(value, tuple):
                assert {type(item) for item in value} <= {int, float}
    assert_same(Responses.of(rows), responses)


def test_some_rows_and_several_parts(responses):
    numbers = np.array([4, 2, 2, 9])
    some = responses.take(numbers)
    assert [repr(row) for row in some.rows()] == [repr(responses.row(k)) for k in numbers]
    parts = [responses.take(part) for part in ([0, 1, 2], [], range(3, 10))]
    assert_same(Responses.concatenated(parts), responses)
    nobody = respond_all([], (0.0, 0.0), gs.Steady())
    assert len(Responses.concatenated([])) == len(Responses.of([])) == len(nobody) == 0


def test_one_response_whose_attributes_are_arrays(responses):
    one = responses.shaped((2, 5))
    for k, at in enumerate(np.ndindex(2, 5)):
        for field in set(fields(one)) - {INPUTS}:
            value = getattr(responses.row(k), field.name)
            assert_array_equal(getattr(one, field.name)[at], value, field.name)
    assert one.n_steps.dtype == one.extremum_kind[0, 0].dtype == np.int64
    assert type(one.status[0, 0]) is gs.Status


def test_the_order_is_that_of_the_scenes():
    laws = [gs.Piecewise(1.4e4, ASYMMETRIC), gs.Tanh(1.4e4, ASYMMETRIC, 1e4)]
    steady = gs.Steady(settle_tol=1e-2)
    scenes = [
        Scene(oscillator=paper_oscillator(), law=law, omega=omega, solver=Solver.of())
        for omega in (6.0, 7.0)
        for law in laws
    ]
    together = respond_all(scenes, (0.0, 0.0), steady).rows()
    for scene, found in zip(scenes, together, strict=True):
        alone = respond_all([scene], (0.0, 0.0), steady).row(0)
        # NaN is NaN here, which the records' own equality leaves open.
        assert_equal(asdict(replace(found, cpu_time=0.0)), asdict(replace(alone, cpu_time=0.0)))


def test_lists_keep_what_was_put_last():
    lists = RaggedArrays(4)
    lists.put(np.array([2, 0]), np.array([1.0, 2.0, 3.0]), np.array([2, 1]))
    lists.put(np.array([2, 3]), np.array([4.0]), np.array([1, 0]))
    items, counts = lists.of(np.array([3, 2, 0]))
    assert items.tolist() == [4.0, 3.0]
    assert counts.tolist() == [0, 1, 1]
    assert lists.counts.tolist() == [1, -1, 1, 0]
    assert spans(np.array([7, 1, 3]), np.array([2, 0, 1])).tolist() == [7, 8, 3]


def assert_same(a, b):
    for name in a.columns:
        assert_array_equal(a.columns[name], b.columns[name], name)
    for name in LISTS:
        for x, y in zip(a.lists[name], b.lists[name], strict=True):
            assert_array_equal(x, y, name)
    assert a.messages == b.messages


def test_a_response_is_one_short_line():
    one = Response(
        status=gs.Status.OK, response_class=gs.ResponseClass.PERIODIC, period_multiple=3,
        x_min=-4e-4, x_max=1.234567e-3, contact_share=0.1,
    )  # fmt: skip
    assert repr(one) == (
        "<gapsweep.Response: periodic, period multiple 3, ok, x_min -0.0004, x_max 0.00123457>"
    )
    assert "no contact" in repr(replace(one, contact_share=0.0))
    lost = Response(status=gs.Status.DIVERGED)
    assert repr(lost) == "<gapsweep.Response: failed, diverged, x_min nan, x_max nan>"
    system = replace(one, x_min=np.array([-1.0, -2.0]), x_max=np.array([1.0, 2.0]))
    assert repr(system).endswith("x_min -1 -2, x_max 1 2>")
    several = Responses.of([one, lost, one, one]).shaped((2, 2))
    assert (
        repr(several)
        == "<gapsweep.Response of shape (2, 2): 3 periodic, 1 failed, 3 touched a wall>"
    )
