"""Where everything about the point in a lane is kept: names of rows, and loading a point into a
lane.

All state lives in two arrays, so the stepping loop can be left at any attempt (a full buffer) and
entered again, and its memory does not depend on the number of points or the length of a run.
"""

import math

import numpy as np

from gapsweep.integrate.jit import entry

from . import laws

# --- rows of the float block `lane`, shape (N_ROWS, WIDTH) ---
# Start of the next attempt.
X, V, A, TAU, TURNS, H = range(6)
# End of the last attempt (committed or not), and the start and length of that attempt.
X1, V1, A1, OLD_X, OLD_V, OLD_A, OLD_TAU, OLD_TURNS, OLD_H = range(6, 15)
# State to return to once the events of an accepted step are polished.
KEPT_X, KEPT_V, KEPT_A, KEPT_TAU, KEPT_TURNS, KEPT_H = range(15, 21)
# The point: constants of the equation, its clock, where it ends and where recording starts.
FREQUENCY, PERIOD, FORCING, STIFFNESS, DAMPING, CUBIC = range(21, 27)
PHASE_0, END_TURNS, END_TAU, RECORD_TURNS, H_MAX = range(27, 32)
# Control: EXACT is 0 for an ordinary attempt, 1 for a probe (never committed), 2 for a landing
# (committed, but its length is not the controller's); FAILED is 1 right after a rejection.
EXACT, FAILED, H_SAVED, OUT_OF_RANGE = range(32, 36)
N_STEPS, N_REJECTED, N_ATTEMPTS, N_CONTACTS = range(36, 40)
# Tangent columns (dx, dv), and their values before the last attempt.
TANGENT, OLD_TANGENT = 40, 44
STEP_H = 48  # length of the step whose events are being polished
H_MIN = 49  # shortest step that makes progress
NEXT_WHOLE = 50  # the whole turn whose section point is recorded next
PASSED_AT = 51  # time within that step of the last wall passing
REACH = 52  # largest |x| at the start and at the ends of steps
N_ROWS = 53

# --- rows of the integer block `lane_int`, shape (N_INT_ROWS, WIDTH) ---
# LANDING: 1 while a step is being cut; LANDED: 1 when it has arrived and the contact mode must
# flip.
# KIND: of the event that is being probed.
MODE, POINT, N_PROBES, PROBE, TRIES, LANDING, LANDED, KIND = range(8)
N_INT_ROWS = 8
# --- rows of the probe block, shape (2 * MAX_PROBES, WIDTH): theta, then kind ---
# As many as a step can hold: MAX_TURNS extrema, and both walls passed between any two of them. (Its
# section points, which may be more, are not listed.)
MAX_TURNS = 8
MAX_PROBES = MAX_TURNS + 2 * (MAX_TURNS + 1)

# Modes of a lane.
IDLE, START, STEPPING, PROBING = range(4)

# --- columns of the point table, shape (n_points, N_COLUMNS) ---
P_X, P_V, P_FREQUENCY, P_PHASE, P_END_TURNS, P_END_TAU, P_RECORD, P_FORCING = range(8)
P_STIFFNESS, P_DAMPING, P_CUBIC, P_LAW = range(8, 12)
N_COLUMNS = P_LAW + laws.N_PARAMETERS

# --- columns of the result table ---
(R_STATUS, R_X, R_V, R_LEFT, R_CONTACTS, R_STEPS, R_REJECTED, R_NFEV) = range(8)
R_TANGENT = 8
R_REACH = 12
N_RESULTS = 13

# --- settings vector ---
(
    S_RTOL,
    S_ATOL,
    S_BOUND,
    S_MAX_ATTEMPTS,
    S_ODE45,
    S_STOP_AT_LAYER,
    S_TANGENT,
    S_DENSE,
    S_EXPONENT,
    S_FIRST_STEP,
    S_CONTACTS,
    S_SECTION_ONLY,
) = range(12)
N_SETTINGS = 12

# --- columns of the event buffer, and kinds of records ---
(E_KIND, E_POINT, E_T, E_X, E_V, E_H, E_TAU) = range(7)
N_EVENT_COLUMNS = 7
# A probe says which wall it aims at; a record is a CONTACT at either.
EXTREMUM, SECTION, STEP, CONTACT, CONTACT_LOW = range(5)

# --- counters shared by all lanes ---
NEXT_POINT, N_EVENTS = range(2)

# Codes of DESIGN.md section 5 that this engine can give.
OK, OUT_OF_FIT_RANGE, DIVERGED, MODEL_INVALID, STEP_UNDERFLOW, CHATTER, TIMED_OUT = (
    0,
    3,
    4,
    5,
    6,
    7,
    8,
)

_CLOCK_ROUNDING = 4.0 * np.finfo(float).eps


def aligned(rows, width):
    """A zeroed float64 array whose rows of one vector start on cache lines."""
    raw = np.zeros(rows * width + 8)
    skip = (-raw.__array_interface__["data"][0] // 8) % 8
    return raw[skip : skip + rows * width].reshape(rows, width)


@entry
def elapsed(lane, i):
    """Seconds since the point's start, from its count of forcing turns."""
    return (lane[TURNS, i] + (lane[TAU, i] - lane[PHASE_0, i])) * lane[PERIOD, i]


@entry
def remaining(lane, i):
    """Seconds to the point's end."""
    return ((lane[END_TURNS, i] - lane[TURNS, i]) + (lane[END_TAU, i] - lane[TAU, i])) * lane[
        PERIOD, i
    ]


@entry
def begin_start(lane, lane_int, i):
    """Next attempt of the lane: length zero, whose last stage is the acceleration at the start."""
    lane[A, i] = 0.0
    lane[H, i] = 0.0
    lane[EXACT, i] = 1.0
    lane[FAILED, i] = 0.0
    lane_int[MODE, i] = START


@entry
def load_point(lane, lane_int, q, table, point, i):
    """Put a point into a lane."""
    lane[:, i] = 0.0
    row = table[point]
    lane[X, i], lane[V, i] = row[P_X], row[P_V]
    lane[REACH, i] = abs(row[P_X])
    lane[TAU, i] = lane[PHASE_0, i] = row[P_PHASE]
    lane[FREQUENCY, i], lane[PERIOD, i] = row[P_FREQUENCY], 1.0 / row[P_FREQUENCY]
    lane[END_TURNS, i], lane[END_TAU, i] = row[P_END_TURNS], row[P_END_TAU]
    lane[RECORD_TURNS, i] = row[P_RECORD]
    fastest = max(row[P_FREQUENCY], math.sqrt(row[P_STIFFNESS]))
    # A clock that starts at a phase cannot tell shorter steps from none.
    lane[H_MIN, i] = max(1e-17 / fastest, _CLOCK_ROUNDING * row[P_PHASE] * lane[PERIOD, i])
    lane[FORCING, i], lane[STIFFNESS, i] = row[P_FORCING], row[P_STIFFNESS]
    lane[DAMPING, i], lane[CUBIC, i] = row[P_DAMPING], row[P_CUBIC]
    lane[TANGENT, i] = lane[TANGENT + 3, i] = 1.0
    for k in range(laws.N_PARAMETERS):
        q[k, i] = row[P_LAW + k]
    lane_int[:, i] = 0
    lane_int[POINT, i] = point
    begin_start(lane, lane_int, i)


@entry
def load_first_points(lane, lane_int, q, table, queue):
    """Put the first of a queue of points into the lanes, as many as there are of both."""
    n = min(lane.shape[1], len(queue))
    for i in range(n):
        load_point(lane, lane_int, q, table, queue[i], i)
    return n


@entry
def unload_point(lane, lane_int, results, status, n_new_stages, i):
    """Write the point's end state and counters; the lane is then free."""
    row = results[lane_int[POINT, i]]
    left_range = lane[OUT_OF_RANGE, i] > 0.0 and (status in (OK, DIVERGED, STEP_UNDERFLOW))
    row[R_STATUS] = OUT_OF_FIT_RANGE if left_range else status
    row[R_X], row[R_V], row[R_LEFT] = lane[X, i], lane[V, i], remaining(lane, i)
    # Below zero: the start lies on a wall and has not left it.
    row[R_CONTACTS], row[R_STEPS] = max(lane[N_CONTACTS, i], 0.0), lane[N_STEPS, i]
    row[R_REJECTED], row[R_NFEV] = lane[N_REJECTED, i], lane[N_ATTEMPTS, i] * n_new_stages
    row[R_REACH] = lane[REACH, i]
    for k in range(4):
        row[R_TANGENT + k] = lane[TANGENT + k, i]
    lane_int[MODE, i] = IDLE
    lane[H, i] = 0.0
    lane[EXACT, i] = 1.0
