"""Where everything about the point in a lane is kept: names of rows, and loading a point there.

All state lives in two arrays, so the stepping loop can be left at any attempt (a full buffer) and
entered again, and its memory does not depend on the number of points or the length of a run.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from gapsweep.integrate.jit import entry, internal
from gapsweep.integrate.taylor.layout import Layout, known
from gapsweep.status import Status

from . import parameters

# Events that a step can hold of one coordinate or gap: so many extrema, and both walls passed
# between any two of them. (Its section points, which may be more, are not listed.)
MAX_TURNS = 8

# What the equation of motion needs, as the exact kernel has it.
EQUATION = (
    *("omega", "period", "stiffness", "damping", "lag_force", "of_speed", "of_place", "of_lag"),
    *("cubic", "along", "pull", "direction", "push", "multiple", "phase"),
    *("depth", "depth_multiple", "depth_phase"),
)


@dataclass(frozen=True)
class Rows(Layout):
    """First rows of what is kept of a point in the float block `lane`, shape (n_rows, WIDTH)."""

    derived: ClassVar[tuple[str, ...]] = (
        *Layout.derived,
        *("n_start", "n_rates", "n_columns", "gaps_from", "max_probes", "n_results"),
        "n_event_columns",
    )

    @classmethod
    def of(cls, at: Layout) -> "Rows":
        """The rows of a system's points."""
        return known(cls(**{each.name: getattr(at.bare, each.name) for each in fields(Layout)}))

    @cached_property
    def blocks(self) -> dict[str, int]:
        """Number of rows of every block."""
        n, m, k, s = self.n, self.m, self.contacts, self.n_states
        several = not self.is_plain
        equation = Layout.blocks.func(self)
        return {
            # Start of the next attempt: state, its derivative (of speeds, and of lags), clock with
            # the digits that its sum has lost.
            **{"q": n, "v": n, "z": m, "a": n, "w": m, "tau": 1, "tau_low": 1, "turns": 1, "h": 1},
            # Where the clock starts and ends, where recording starts, shortest and longest step.
            **dict.fromkeys(("phase_0", "end_turns", "end_tau", "record_turns"), 1),
            **{"h_min": 1, "h_max": 1},
            **{name: equation[name] for name in EQUATION},
            # A point of the table has all rows up to here. End of the last attempt, committed or
            # not, and its start and length.
            **{"q_1": n, "v_1": n, "z_1": m, "a_1": n, "w_1": m},
            **{"old_q": n, "old_v": n, "old_z": m, "old_a": n, "old_w": m},
            **{"old_tau": 1, "old_tau_low": 1, "old_turns": 1, "old_h": 1},
            # State to return to once the events of an accepted step are polished.
            "kept": self.n_start,
            # Gaps of several contacts, their speeds and accelerations, at both ends of it.
            **{"gap_0": 3 * k * several, "gap_1": 3 * k * several},
            # Control: `exact` is 0 for an ordinary attempt, 1 for a probe (never committed), 2 for
            # a landing (committed, but its length is not the controller's); `failed` is 1 right
            # after a rejection.
            **dict.fromkeys(("exact", "failed", "h_saved", "out_of_range"), 1),
            # `n_starts`: derivatives computed by themselves, at starts and on walls.
            **dict.fromkeys(("n_steps", "n_rejected", "n_attempts", "n_starts"), 1),
            "n_contacts": k,
            # Tangent columns, and their values before the last attempt.
            **{"tangent_state": s * s, "old_tangent": s * s},
            # Of the step whose events are being polished: its length, the whole turn whose section
            # point is recorded next, and when every contact has passed a wall last.
            **{"step_h": 1, "next_whole": 1, "passed_at": k},
            "reach": n,  # largest |q| at the start and at the ends of steps
            # Of a stage of a system: state, cosines of loads; of every contact its gap, its force
            # (or slope, or denominator) and by what its stiffness is multiplied; of every cubic
            # spring the cube, and three squares.
            **{"stage": s * several, "cosine": self.harmonics * several},
            **{"gap": k, "force": k, "rate": k * several},
            **{"cube": self.cubics * several, "bend": self.cubics * several},
        }

    @property
    def n_start(self) -> int:
        """Rows of the start of an attempt: state, derivative, the clock's three, length."""
        return self.n_states + self.n_rates + 4

    @property
    def n_rates(self) -> int:
        """Numbers of a stage that are kept: accelerations, and rates of first-order states."""
        return self.n + self.m

    @property
    def n_columns(self) -> int:
        """Rows that a point of the table fills; its laws' parameters follow."""
        return self.first["q_1"]

    @property
    def gaps_from(self) -> int:
        """Number of the first gap among what turns: coordinates, then a system's gaps."""
        return 0 if self.is_plain else self.n

    @property
    def max_probes(self) -> int:
        """As many as a step can hold."""
        return self.n_turning * MAX_TURNS + self.contacts * 2 * (MAX_TURNS + 1)

    @property
    def n_results(self) -> int:
        """Columns of the result table."""
        return R_STATE + self.n_states + self.n_states**2 + self.n

    @property
    def n_event_columns(self) -> int:
        """Columns of the event buffer."""
        return E_STATE + self.n_states


PLAIN = Rows.of(Layout())

# --- rows of the integer block `lane_int`, shape (N_INT_ROWS, WIDTH) ---
# LANDING: 1 while a step is being cut; LANDED: 1 when it has arrived and the contact mode flips.
# KIND, WHICH: of the event that is being probed.
MODE, POINT, N_PROBES, PROBE, TRIES, LANDING, LANDED, KIND, WHICH = range(9)
N_INT_ROWS = 9
# Modes of a lane.
IDLE, START, STEPPING, PROBING = range(4)

# --- columns of the result table; the state is followed by the tangent and the reach ---
(R_STATUS, R_LEFT, R_CONTACTS, R_STEPS, R_REJECTED, R_NFEV, R_STATE) = range(7)


class Settings(NamedTuple):
    """What all points of a run have in common.

    Attributes
    ----------
    rtol, atol : float
        Tolerances.
    bound : float
        Largest displacement of a motion that has not diverged [m].
    max_attempts : float
        Attempts after which a point is timed out.
    exponent : float
        Of the error in the choice of the next step.
    first_step : float
        Length of the first step [s]; 0: chosen from the derivative there.
    is_ode45 : bool
        Whether errors are measured and steps chosen as MATLAB's ode45 does.
    is_located, restarts : bool
        Whether steps end on walls; whether the step is then chosen as at a start.
    cuts_at_layers : bool
        Whether steps are cut at the edges of smoothing layers.
    has_range : bool
        Whether a law is a fit, which holds within a range.
    tangent : bool
        Whether the variational equation is integrated along.
    dense, contacts, section_only : bool
        Which events are recorded: every step; walls passed; section points alone.
    """

    rtol: float
    atol: float
    bound: float
    max_attempts: float
    exponent: float
    is_ode45: bool
    is_located: bool
    restarts: bool
    cuts_at_layers: bool
    has_range: bool
    first_step: float = 0.0
    tangent: bool = False
    dense: bool = False
    contacts: bool = False
    section_only: bool = False


class Run(NamedTuple):
    """All that the loop works on; it can stop at any attempt and go on when called again.

    Attributes
    ----------
    at : record
        `Rows.numbers`.
    lane, lane_int : array, shapes (n_rows, WIDTH) and (N_INT_ROWS, WIDTH)
        State of the points under way.
    q : array, shape (n_contacts, N_PARAMETERS, WIDTH)
        Parameters of their laws.
    k, k_tangent : array
        Derivatives of all stages, and of the tangents', as of `attempt`.
    probes : array, shape (3 * max_probes, WIDTH)
        Of every event of a step: theta, kind, and of which coordinate or gap.
    scratch : probing.Scratch
    events : array, shape (n_rows, n_event_columns)
        Buffer of records, which the caller drains.
    counters : int array
        `NEXT_POINT`, `N_EVENTS`.
    table, results : array, one row per point
    queue : int array
        The points that follow none in the order in which they are loaded.
    follows : bool array, shape (n_points + 1,)
        Which points begin where those before them end.
    settings : Settings
    """

    at: np.record
    lane: np.ndarray
    lane_int: np.ndarray
    q: np.ndarray
    k: np.ndarray
    k_tangent: np.ndarray
    probes: np.ndarray
    scratch: Any
    events: np.ndarray
    counters: np.ndarray
    table: np.ndarray
    queue: np.ndarray
    follows: np.ndarray
    results: np.ndarray
    settings: Settings


# --- columns of the event buffer, and kinds of records ---
# WHICH: of an extremum the coordinate or, after all coordinates, the gap, whose value stands where
# others have the state; of a contact which one.
(E_KIND, E_POINT, E_T, E_H, E_TAU, E_WHICH, E_STATE) = range(7)
# A probe says which wall it aims at; a record is a CONTACT at either.
EXTREMUM, SECTION, STEP, CONTACT, CONTACT_LOW = range(5)

# --- counters shared by all lanes ---
NEXT_POINT, N_EVENTS = range(2)

# What this engine can answer, as plain numbers for compiled code.
OK = int(Status.OK)
OUT_OF_FIT_RANGE = int(Status.OUT_OF_FIT_RANGE)
DIVERGED = int(Status.DIVERGED)
MODEL_INVALID = int(Status.MODEL_INVALID)
STEP_UNDERFLOW = int(Status.STEP_UNDERFLOW)
TIMED_OUT = int(Status.TIMED_OUT)


@internal
def ends(at, which):
    """Rows of place, speed and acceleration of a coordinate or a gap: at the start of the last
    attempt, then at its end.
    """
    if which < at.n:
        old, new = at.old_q + which, at.q_1 + which
        to_v, to_a = at.n, at.n_states
    else:
        old, new = at.gap_0 + which - at.n, at.gap_1 + which - at.n
        to_v, to_a = at.contacts, 2 * at.contacts
    return old, old + to_v, old + to_a, new, new + to_v, new + to_a


@internal
def elapsed(at, lane, i):
    """Seconds since the point's start, from its count of forcing turns."""
    return (lane[at.turns, i] + (lane[at.tau, i] - lane[at.phase_0, i])) * lane[at.period, i]


@internal
def remaining(at, lane, i):
    """Seconds to the point's end."""
    turns = lane[at.end_turns, i] - lane[at.turns, i]
    turns += lane[at.end_tau, i] - lane[at.tau, i] - lane[at.tau_low, i]
    return turns * lane[at.period, i]


@internal
def begin_start(at, lane, lane_int, i):
    """Next attempt of the lane: length zero, whose last stage is the derivative at the start."""
    for j in range(at.n_rates):
        lane[at.a + j, i] = 0.0
    lane[at.h, i] = 0.0
    lane[at.exact, i] = 1.0
    lane[at.failed, i] = 0.0
    lane[at.n_starts, i] += 1.0
    lane_int[MODE, i] = START


@internal
def load_point(run, point, i):
    """Put a point into a lane."""
    at, lane, lane_int, q, row = run.at, run.lane, run.lane_int, run.q, run.table[point]
    for j in range(at.n_rows):
        lane[j, i] = row[j] if j < at.n_columns else 0.0
    for j in range(at.n):
        lane[at.reach + j, i] = abs(row[at.q + j])
    for j in range(at.n_states):
        lane[at.tangent_state + j * (at.n_states + 1), i] = 1.0
    for contact in range(at.contacts):
        for j in range(parameters.N_PARAMETERS):
            q[contact, j, i] = row[at.n_columns + contact * parameters.N_PARAMETERS + j]
    for j in range(N_INT_ROWS):
        lane_int[j, i] = 0
    lane_int[POINT, i] = point
    begin_start(at, lane, lane_int, i)


@entry
def load_first_points(run):
    """Put the first points of the queue into the lanes, as many as there are of both."""
    n = min(run.lane.shape[1], len(run.queue))
    for i in range(n):
        load_point(run, run.queue[i], i)
    run.counters[NEXT_POINT] = n


@internal
def load_following(run, status, i):
    """Put the point that follows the one that has left a lane there; whether there is one.

    What follows a failure has failed.
    """
    at, results, point = run.at, run.results, run.lane_int[POINT, i] + 1
    if run.follows[point] and status == OK:
        for j in range(at.n_states):
            run.table[point, at.q + j] = run.lane[at.q + j, i]
        load_point(run, point, i)
        return True
    while run.follows[point]:
        row = run.table[point]
        turns = row[at.end_turns] + row[at.end_tau] - row[at.tau]
        results[point, R_STATUS] = results[point - 1, R_STATUS]
        results[point, R_LEFT] = turns * row[at.period]
        point += 1
    return False


@internal
def unload_point(run, status, n_new_stages, i):
    """Write the point's end state and counters; the lane is then free."""
    at, lane, lane_int = run.at, run.lane, run.lane_int
    row = run.results[lane_int[POINT, i]]
    left_range = lane[at.out_of_range, i] > 0.0 and (status in (OK, DIVERGED, STEP_UNDERFLOW))
    row[R_STATUS] = OUT_OF_FIT_RANGE if left_range else status
    row[R_LEFT] = remaining(at, lane, i)
    for contact in range(at.contacts):
        # Below zero: the start lies on a wall and has not left it.
        row[R_CONTACTS] += max(lane[at.n_contacts + contact, i], 0.0)
    row[R_STEPS], row[R_REJECTED] = lane[at.n_steps, i], lane[at.n_rejected, i]
    # Of the motion: probes look at what it has passed.
    n_tried = lane[at.n_steps, i] + lane[at.n_rejected, i]
    row[R_NFEV] = n_tried * n_new_stages + lane[at.n_starts, i]
    for j in range(at.n_states):
        row[R_STATE + j] = lane[at.q + j, i]
    first = R_STATE + at.n_states
    for j in range(at.n_states * at.n_states):
        row[first + j] = lane[at.tangent_state + j, i]
    first += at.n_states * at.n_states
    for j in range(at.n):
        row[first + j] = lane[at.reach + j, i]
    lane_int[MODE, i] = IDLE
    lane[at.h, i] = 0.0
    lane[at.exact, i] = 1.0
