"""Outcome of a step of all lanes, as masks of lanes."""

from typing import NamedTuple

CLOCK_SLACK = 1e-9  # of a period: a record_from meant as a whole period includes its section
MAX_HALVINGS = 3  # of a step in search of a crossing
SHORT_STEP = 1e-6  # rad of the fastest frequency: contact steps shorter than this count as chatter
# Why the derivative must be evaluated before the next Runge-Kutta step, in the row `is_fresh`: the
# last step was cut short, ended on a wall, or the motion begins.
AT_NEW_STATE, AT_WALL, AT_START = 0.5, 1.0, 2.0
# Why a lane cannot go on, in its row `n_short`.
STEP_UNDERFLOW, MODEL_INVALID, DIVERGED = -1.0, -2.0, -3.0


class StepOutcome(NamedTuple):
    """Masks of lanes after a step; bit i of each integer stands for lane i."""

    unclear: int  # the step is not committed, as it may have to end at a contact
    # `done`, `bad`: the point has reached its end; it cannot go on.
    done: int
    bad: int
    recording: int  # the step may contain an event to record
    # A gap may have passed a wall that is not located and come back within the step.
    miscounted: int
