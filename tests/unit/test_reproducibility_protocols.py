"""Protocols of the exact law that measure reproducibility, and those that do not."""

import json

import pytest

from gapsweep.analysis.agreement.self_agreement import floor_labels

LABEL = "piecewise@other"


def floors(protocol, solver=None, labels=(LABEL,)):
    study = {"solver": solver or {}, "protocol": {"other": protocol}}
    return floor_labels(json.dumps(study), ["piecewise", *labels])


@pytest.mark.parametrize(
    "protocol",
    [
        {"rtol": 5e-10, "atol": 5e-13},
        {"rtol": 5e-10},
        {"atol": 5e-13},
        {"start_jitter": 1e-9},
        {"start_jitter": -1e-9},
        {"start_jitter": 1e-9, "rtol": 5e-10},
    ],
)
def test_tighter_or_jittered_is_a_floor(protocol):
    assert floors(protocol) == [LABEL]


@pytest.mark.parametrize(
    "protocol",
    [
        {"rtol": 1e-4, "atol": 1e-7, "controller": "ode45"},
        {"rtol": 1e-8},
        {"rtol": 5e-10, "atol": 1e-11},
        {"rtol": 5e-10, "restart": True},
        {"rtol": 5e-10, "contact_force": "as_written"},
        {"engine": "scipy", "rtol": 1e-10, "atol": 1e-13},
        {"start_jitter": 1e-5},
        {"start_jitter": 1e-9, "rtol": 1e-4},
        {},
        {"rtol": 1e-9, "start_jitter": 0.0},  # what it is anyway
    ],
)
def test_anything_else_is_none(protocol):
    assert floors(protocol) == []


def test_tighter_is_meant_against_the_solver_of_the_study():
    assert floors({"rtol": 5e-6, "atol": 1e-9}, {"rtol": 1e-5, "atol": 1e-9}) == [LABEL]
    assert floors({"rtol": 5e-6}, {"rtol": 1e-6}) == []


@pytest.mark.parametrize("label", ["tanh-1e4@other", "piecewise-noevents@other", "piecewise@gone"])
def test_only_the_exact_law_under_a_known_protocol(label):
    assert floors({"start_jitter": 1e-9}, labels=[label]) == []


def test_no_study_no_floor():
    assert floor_labels("", ["piecewise", LABEL]) == []
