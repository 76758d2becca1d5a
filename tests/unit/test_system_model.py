"""Systems as data: what they refuse, by name, and what a start of one must look like."""

import numpy as np
import pytest

import gapsweep as gs

ONE = np.eye(2)
GIVEN = {
    "mass": ONE,
    "stiffness": ONE,
    "contacts": {"stop": [1.0, 0.0]},
    "forcing": [gs.Harmonic(amplitude=[1.0, 0.0])],
}
LAW = gs.Piecewise(10.0, gs.Gap(0.1, 0.1))
HUGE = 10**400  # no float
RAGGED = [[1.0, 0.0], [0.0]]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mass": RAGGED}, "mass"),
        ({"mass": "heavy"}, "mass"),
        ({"mass": ONE * (1.0 + 1.0j)}, "mass"),
        ({"mass": [[HUGE, 0], [0, 1]]}, "mass"),
        ({"mass": np.ones((2, 2))}, "positive definite"),
        ({"mass": ONE * 1e-300}, "1e-50"),
        ({"mass": [[1.0, 0.1], [0.2, 1.0]]}, "symmetric"),
        ({"mass": np.eye(17), "stiffness": np.eye(17)}, "1..16"),
        ({"stiffness": np.eye(3)}, "shape"),
        ({"contacts": [[1.0, 0.0]]}, "contacts"),
        ({"contacts": None}, "contacts"),
        ({"contacts": {1: [1.0, 0.0]}}, "contacts"),
        ({"contacts": {"stop": [0.0, 0.0]}}, "direction"),
        ({"contacts": {str(i): [1.0, 0.0] for i in range(9)}}, "number of contacts"),
        ({"forcing": gs.Harmonic(amplitude=[1.0, 0.0])}, "sequence of gapsweep.Harmonic"),
        ({"forcing": None}, "forcing"),
        ({"forcing": [1.0]}, "forcing"),
        ({"forcing": [gs.Harmonic(amplitude=[1.0])]}, "amplitude"),
        ({"cubic": gs.Cubic(along=[1.0, 0.0], alpha=1.0)}, "sequence of gapsweep.Cubic"),
        ({"cubic": [1.0]}, "cubic"),
        ({"cubic": [gs.Cubic(along=[0.0, 0.0], alpha=1.0)]}, "direction"),
        ({"modulation": {"stop": gs.Modulation(depth=0.1)}}, "modulation of 'stop'"),
        ({"modulation": {"stop": [0.1]}}, "modulation of 'stop'"),
        ({"modulation": {"other": [gs.Modulation(depth=0.1)]}}, "must be one of"),
        ({"modulation": [0.1]}, "modulation"),
        ({"lags": 3.0}, "Lags"),
        ({"lags": gs.Lags(ONE, ONE, ONE, RAGGED)}, "of_lags"),
        ({"lags": gs.Lags([[1.0], [1.0]], [[1.0, 1.0]], [[1.0, 1.0]], -1.0)}, "of_lags"),
        ({"lags": gs.Lags(*(np.zeros(s) for s in ((2, 0), (0, 2), (0, 2), (0, 0))))}, "lags"),
        ({"lags": gs.Lags(np.ones((2, 17)), np.ones((17, 2)), np.ones((17, 2)), np.eye(17))}, "16"),
        ({"coordinates": 3}, "names"),
        ({"coordinates": ([], [])}, "names"),
        ({"coordinates": ("a", "a")}, "different"),
    ],
)  # fmt: skip
def test_what_is_no_system_is_refused_by_name(changes, words):
    with pytest.raises(gs.ModelError, match=words):
        gs.System(**(GIVEN | changes))


def test_numbers_too_large_for_a_float_are_refused():
    with pytest.raises(gs.ModelError, match="phase"):
        gs.Harmonic(amplitude=[1.0, 0.0], phase=HUGE)
    with pytest.raises(gs.ModelError, match=r"power = 2: must be .* 0\.\.0"):
        gs.Harmonic(amplitude=[1.0, 0.0], k=0, power=2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"law": None}, "law"),
        ({"law": {"stop": 3}}, "law"),
        ({"law": {"other": LAW, 1: LAW}}, "must name"),
        ({"omega": None}, "omega"),
        ({"x_0": 1.0}, "x_0"),
        ({"x_0": "far"}, "x_0"),
        ({"q_0": [1.0, 2.0, 3.0]}, "q_0"),
        ({"q_0": RAGGED}, "q_0"),
        ({"q_0": [HUGE, 0]}, "q_0"),
        ({"z_0": 1.0}, "z_0"),
        ({"z_0": [1.0]}, "z_0"),
        ({"z_0": RAGGED}, "z_0"),
        ({"omega": [1.0, 2.0, 3.0], "q_0": np.zeros((2, 2))}, "q_0"),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_name(changes, words):
    given = {"law": LAW, "omega": 1.0, "t_end": 1.0} | changes
    with pytest.raises(gs.ModelError, match=words):
        gs.simulate(gs.System(**GIVEN), **given)


def test_a_modulation_without_terms_is_none():
    free = GIVEN | {"forcing": [], "modulation": {"stop": []}}
    assert not gs.System(**free).is_forced


def test_a_body_that_nothing_holds_may_start_at_any_time():
    """Of a free body no period limits what the clock must tell apart; z_0 may be empty."""
    body = gs.System(mass=[[2.0]], stiffness=[[0.0]], forcing=[gs.Harmonic(amplitude=[2.0])])
    run = gs.simulate(body, {}, 1.0, t_0=0.25, t_end=1.25, v_0=[3.0], z_0=[])
    turn = 2.0 * np.pi
    drift = (np.sin(turn * 1.25) - np.sin(turn * 0.25)) / turn
    assert run.v_end[0] == pytest.approx(3.0 + drift, abs=1e-8)
    # x = int v: the load's own motion is -cos / turn^2, and its speed at the start is no part of it
    assert run.q_end[0] == pytest.approx(3.0 - 1.0 / turn, abs=1e-8)
