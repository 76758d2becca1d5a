"""Motions of benchmark scenarios, and the independent solutions that runs are compared with.

Every law is solved with tight tolerances by two engines without common stepping code: the compiled
one (Taylor series or DOP853 in lanes) and scipy's DOP853, restarted at every contact of the exact
law. A method is compared with the solution of the other engine. The distance of the two solutions
is the smallest error that can be measured.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np

from gapsweep.analysis.bench.scenarios import Scenario, law_or_none
from gapsweep.analysis.dimensions import Array
from gapsweep.integrate.problem import SMALLEST_RTOL, Solver
from gapsweep.integrate.simulate import simulate
from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.status import Status

TIGHT = {
    engine: Solver(engine=engine, rtol=SMALLEST_RTOL, atol=1e-3 * SMALLEST_RTOL)
    for engine in ("compiled", "scipy")
}
_OTHER = {"compiled": "scipy", "scipy": "compiled"}
# Largest growth of a disturbance at which motions are still compared: three Lyapunov times.
LARGEST_GROWTH = math.exp(3.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioRun:
    """The motion of a scenario: states at period ends, contact times and counts."""

    status: Status
    # Shape (n, 2): ``(x, v)`` at the ends of the forcing periods that were computed [m], [m/s].
    section: Array
    t_contacts: Array  # times of wall crossings since the initial time [s]
    reach: float  # largest displacement [m], of both signs
    n_contacts: int = 0
    n_steps: int = 0
    n_rejected: int = 0
    nfev: int = 0


NONE = ScenarioRun(
    status=Status.MODEL_INVALID, section=np.empty((0, 2)), t_contacts=np.empty(0), reach=math.nan
)


def motion(
    scenario: Scenario, law: ContactLaw | None, solver: Solver, later: int = 0
) -> ScenarioRun:
    """The motion of a scenario, with its initial time `later` forcing periods after zero.

    If it leaves the range of a fit, its status is `out_of_fit_range`, as in a sweep; at a pole it
    is `model_invalid`.
    """
    if law is None:
        return NONE
    t_0, t_end = later / scenario.omega, (later + scenario.n_periods) / scenario.omega
    run = simulate(
        scenario.oscillator,
        law,
        scenario.omega,
        scenario.x_0,
        scenario.v_0,
        t_0=t_0,
        t_end=t_end,
        **asdict(solver),
    )
    section = run.section
    if run.status is Status.OK:
        # The last period end is the end of the motion, regardless of rounding of t_end.
        section = np.vstack([section[: scenario.n_periods - 1], (run.x_end, run.v_end)])
    places = [scenario.x_0, run.x_end, *run.extrema, *section[:, 0]]
    at_pole = run.status is Status.MODEL_INVALID
    low, high = law.valid_range
    is_inside = low <= np.min(places) and np.max(places) <= high  # NaN is not
    left = (math.isfinite(low) or math.isfinite(high)) and not is_inside
    return ScenarioRun(
        status=Status.OUT_OF_FIT_RANGE if left and not at_pole else run.status,
        section=section,
        t_contacts=run.t_contacts - t_0,
        reach=float(np.max(np.abs(places))),
        n_contacts=int(run.n_contacts),
        n_steps=int(run.n_steps),
        n_rejected=int(run.n_rejected),
        nfev=int(run.nfev),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """Scale of differences of states: a length [m] and a speed [m/s]."""

    length: float
    speed: float


def gap_scale(scenario: Scenario, reach: float) -> Scale:
    """Scale of the gap: its width, and its width times the angular forcing frequency."""
    length = scenario.gap.j_1 + scenario.gap.j_2 or reach
    return Scale(length=length, speed=2.0 * math.pi * scenario.omega * length)


def reach_scale(scenario: Scenario, run: ScenarioRun) -> Scale:
    """Scale of a motion: its largest displacement and speed, valid without a gap or forcing."""
    omega_rad = max(2.0 * math.pi * scenario.omega, scenario.oscillator.omega_n_rad)
    # Stiff contact reverses the mass faster than either frequency.
    fastest = np.max(np.abs([scenario.v_0, *run.section[:, 1]]))
    return Scale(length=run.reach, speed=max(omega_rad * run.reach, float(fastest)))


def distance(one: ScenarioRun, other: ScenarioRun, scale: Scale) -> float:
    """Largest scaled difference of two motions at period ends [-]; NaN unless both are ok."""
    if one.status is not Status.OK or other.status is not Status.OK:
        return math.nan
    apart = np.abs(one.section - other.section) / (scale.length, scale.speed)
    return float(np.max(apart))


def event_time_distance(one: ScenarioRun, other: ScenarioRun) -> float:
    """Largest difference of contact times [s]; NaN if the numbers of contacts differ or are 0."""
    if one.t_contacts.size != other.t_contacts.size or not one.t_contacts.size:
        return math.nan
    return float(np.max(np.abs(one.t_contacts - other.t_contacts)))


@dataclass(frozen=True, slots=True)
class References:
    """Two independent solutions of one law with tight tolerances."""

    compiled: ScenarioRun
    scipy: ScenarioRun

    def for_engine(self, engine: str) -> ScenarioRun:
        """The solution that runs of an engine are compared with: that of the other engine."""
        found: ScenarioRun = getattr(self, _OTHER[engine])
        return found

    def distance(self, scale: Scale) -> float:
        return distance(self.compiled, self.scipy, scale)


def references(scenario: Scenario, representation: str) -> References:
    """Both reference solutions of a law in a scenario."""
    law = law_or_none(scenario, representation)
    return References(*(motion(scenario, law, TIGHT[name]) for name in ("compiled", "scipy")))


def settled(
    scenario: Scenario, representation: str, found: References, scale: Scale, promise: float
) -> References:
    """The references; if they disagree, the one that converges is returned for both engines.

    Steps without event location may pass over a thin layer, as scipy's do near grazing; such a
    solution changes with its tolerance. If both solutions converge, they contradict each other,
    and both are kept.

    `promise`: largest distance [-] at which references agree.
    """
    if not found.distance(scale) > promise:
        return found
    law = law_or_none(scenario, representation)
    is_steady = []
    for name, tight in TIGHT.items():
        # With one looser tolerance, agreement could be chance.
        looser = [motion(scenario, law, tight.with_rtol(f * tight.rtol)) for f in (10.0, 100.0)]
        apart = [distance(run, getattr(found, name), scale) for run in looser]
        is_steady.append(all(each <= promise for each in apart))
    if is_steady == [True, False]:
        return References(found.compiled, found.compiled)
    return References(found.scipy, found.scipy) if is_steady == [False, True] else found


def growth(scenario: Scenario, law: ContactLaw, section: Array) -> Array:
    """Largest growth factor of a disturbance of the initial state, at every period end.

    `section`: shape (n, 2); states at the motion's period ends, from which each period is
    integrated in its lane. Result: shape (n,); the largest factor so far, ``>= 1``; velocities are
    divided by the angular frequency of the forcing, or of the oscillator if that is higher.
    """
    starts = np.vstack([[scenario.x_0, scenario.v_0], section[:-1]])
    omega = np.full(len(starts), scenario.omega)
    located = isinstance(law, Piecewise)
    run = simulate(
        scenario.oscillator,
        Piecewise(scenario.K_c, scenario.gap) if located else law,
        omega,
        starts[:, 0],
        starts[:, 1],
        t_end=1.0 / scenario.omega,
        rtol=1e-9,
        atol=1e-12,
        tangent=True,
    )
    omega_rad = max(2.0 * math.pi * scenario.omega, scenario.oscillator.omega_n_rad)
    scaled = run.monodromy * np.array([[1.0, omega_rad], [1.0 / omega_rad, 1.0]])
    whole, found = np.eye(2), [1.0]
    for one in scaled:
        whole = one @ whole
        found.append(float(np.linalg.norm(whole, 2)) if np.all(np.isfinite(whole)) else math.inf)
    return np.maximum.accumulate(np.array(found))[1:]
