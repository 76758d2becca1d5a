"""The states of the search for steady responses: its table says what its functions do."""

import numpy as np
import pytest
from tests.builders.studies import LABELS

import gapsweep as gs
from gapsweep.model.systems import paper_oscillator
from gapsweep.response.classification import State
from gapsweep.response.search import TRANSITIONS, Search

CLASSES = {state for state in State if state >= State.PERIODIC}


def reachable(state, without=()):
    """States that a point may come to."""
    seen, left = set(), [state]
    while left:
        for after in TRANSITIONS.get(left.pop(), ((), ()))[1]:
            if after not in seen and after not in without:
                seen.add(after)
                left.append(after)
    return seen


def test_every_state_but_the_classes_has_its_row_in_order():
    assert list(TRANSITIONS) == [state for state in State if state not in CLASSES]
    for state, (function, after) in TRANSITIONS.items():
        assert callable(getattr(Search, f"_{function}"))
        assert len(set(after)) == len(after) > 0
        assert state not in after


def test_every_state_can_be_reached_and_left_for_a_class():
    found_later = {State.HIDDEN, State.NOISY}  # when the recorded motion is read
    assert reachable(State.RECORD) | {State.RECORD} == set(State) - found_later
    for state in TRANSITIONS:
        assert reachable(state) & CLASSES


def test_aperiodic_classes_come_after_the_time_limit():
    before = reachable(State.RECORD, without=[State.TIME_OVER])
    assert not before & {State.CHAOTIC, State.QUASIPERIODIC}
    assert State.PERIODIC in before


@pytest.fixture
def seen(monkeypatch):
    """Pairs of states that points went through."""
    pairs = set()

    def watched(method):
        def function(self, points):
            before = self.state[points].tolist()
            after = method(self, points)
            pairs.update(zip(before, np.asarray(after).tolist(), strict=True))
            return after

        return function

    for name in {f"_{function}" for function, _ in TRANSITIONS.values()}:
        monkeypatch.setattr(Search, name, watched(getattr(Search, name)))
    return pairs


def check(pairs, *least):
    for before, after in pairs:
        assert after == before or after in TRANSITIONS[State(before)][1]
    assert pairs >= set(least)


def test_forced_oscillators_go_through_states_as_the_table_says(seen):
    rng = np.random.default_rng(3)
    omega, x_0 = rng.uniform(3.0, 30.0, 24), rng.normal(size=24) * 1e-3
    for label in LABELS:
        for rtol in (1e-9, 1e-3):
            law = gs.contact_law(label, 1.4e5, gs.Gap(0.0, 0.8e-3))
            gs.respond(paper_oscillator(), law, omega, x_0=x_0, rtol=rtol, atol=1e-3 * rtol)
    check(
        seen,
        (State.PERIOD_TEST, State.SHOOT),
        (State.SHOOT, State.ORBIT_FOUND),
        (State.BASIN_CHECK, State.PERIODIC),
        (State.BASIN_CHECK, State.CONFIRM),
        (State.CONFIRM, State.PERIODIC),
        (State.CONFIRM, State.UNCONFIRMED),
        (State.BASIN_CHECK, State.APPROACH),
        (State.TIME_OVER, State.LYAPUNOV),
        (State.CHAOS_TEST, State.CHAOTIC),
    )


def test_systems_go_through_states_as_the_table_says(seen):
    law = gs.systems.typical_section_law()
    for speed in (4.0, 8.0, 12.0, 16.0):
        gs.respond(gs.systems.typical_section(speed), law, q_0=[0.01, 0.0, 0.0], rtol=1e-4)
    check(
        seen,
        (State.STOPPED, State.EQUILIBRIUM),
        (State.BASIN_CHECK, State.CONFIRM),
        (State.CONFIRM, State.PERIODIC),
    )
