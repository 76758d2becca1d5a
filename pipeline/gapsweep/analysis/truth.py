"""Motions of benchmark scenes, and what they are measured against.

Every law is solved tightly by two engines that share no line of their stepping: the compiled one
(Taylor series or DOP853 in lanes) and scipy's DOP853, restarted at every contact of the exact law.
A method is measured against the one that is not its own; how far the two are apart says what
can be measured at all.
"""

import math
from dataclasses import asdict, dataclass, replace

import numpy as np

from gapsweep.analysis.arrays import Array
from gapsweep.analysis.scenes import Scene, law_or_none
from gapsweep.integrate.problem import SMALLEST_RTOL, Solver
from gapsweep.integrate.simulate import simulate
from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.status import Status

TIGHT = {
    engine: Solver(engine=engine, rtol=SMALLEST_RTOL, atol=1e-3 * SMALLEST_RTOL)
    for engine in ("compiled", "scipy")
}
_OTHER = {"compiled": "scipy", "scipy": "compiled"}
# Disturbances that have grown more than this leave a motion no meaning: three Lyapunov times.
LARGEST_GROWTH = math.exp(3.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """What is kept of one motion.

    Attributes
    ----------
    status : Status
    section : ndarray, shape (n, 2)
        ``(x, v)`` at the ends of the forcing periods that it lasted [m], [m/s].
    t_contacts : ndarray
        Times of its wall crossings since its start [s].
    reach : float
        Largest displacement [m], of both signs.
    n_contacts, n_steps, n_rejected, nfev : int
    """

    status: Status
    section: Array
    t_contacts: Array
    reach: float
    n_contacts: int = 0
    n_steps: int = 0
    n_rejected: int = 0
    nfev: int = 0


NONE = Motion(
    status=Status.MODEL_INVALID, section=np.empty((0, 2)), t_contacts=np.empty(0), reach=math.nan
)


def motion(scene: Scene, law: ContactLaw | None, solver: Solver, later: int = 0) -> Motion:
    """A scene's motion, started a whole number of forcing periods later if asked.

    A fit that has been left is `out_of_fit_range`, as it is in a sweep, but for one at a pole.
    """
    if law is None:
        return NONE
    t_0, t_end = later / scene.omega, (later + scene.n_periods) / scene.omega
    run = simulate(
        scene.oscillator,
        law,
        scene.omega,
        scene.x_0,
        scene.v_0,
        t_0=t_0,
        t_end=t_end,
        **asdict(solver),
    )
    section = run.section
    if run.status is Status.OK:
        # The last period end is the end, however t_end was rounded.
        section = np.vstack([section[: scene.n_periods - 1], (run.x_end, run.v_end)])
    places = [scene.x_0, run.x_end, *run.extrema, *section[:, 0]]
    at_pole = run.status is Status.MODEL_INVALID
    low, high = law.valid_range
    is_inside = low <= np.min(places) and np.max(places) <= high  # NaN is not
    left = (math.isfinite(low) or math.isfinite(high)) and not is_inside
    return Motion(
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
    """What a difference of states is divided by: a length [m] and a speed [m/s]."""

    length: float
    speed: float


def gap_scale(scene: Scene, reach: float) -> Scale:
    """The width of the gap and that times the forcing's angular frequency; see docs/bench.md."""
    length = scene.gap.j_1 + scene.gap.j_2 or reach
    return Scale(length=length, speed=2.0 * math.pi * scene.omega * length)


def reach_scale(scene: Scene, run: Motion) -> Scale:
    """The size of the motion itself, also where the gap is nothing and the forcing slow."""
    omega_rad = max(2.0 * math.pi * scene.omega, scene.oscillator.omega_n_rad)
    # Stiff contact turns the mass round faster than either frequency.
    seen = np.max(np.abs([scene.v_0, *run.section[:, 1]]))
    return Scale(length=run.reach, speed=max(omega_rad * run.reach, float(seen)))


def distance(one: Motion, other: Motion, scale: Scale) -> float:
    """Largest difference of two motions at period ends [-]; NaN unless both went all the way."""
    if one.status is not Status.OK or other.status is not Status.OK:
        return math.nan
    apart = np.abs(one.section - other.section) / (scale.length, scale.speed)
    return float(np.max(apart))


def event_time_distance(one: Motion, other: Motion) -> float:
    """Largest difference of contact times [s]; NaN if the contacts are not as many."""
    if one.t_contacts.size != other.t_contacts.size or not one.t_contacts.size:
        return math.nan
    return float(np.max(np.abs(one.t_contacts - other.t_contacts)))


@dataclass(frozen=True, slots=True)
class Truth:
    """Two independent tight solutions of one law; `distance` relates them [-]."""

    compiled: Motion
    scipy: Motion

    def for_engine(self, engine: str) -> Motion:
        """The solution that an engine is measured against: the other engine's."""
        found: Motion = getattr(self, _OTHER[engine])
        return found

    @property
    def reach(self) -> float:
        return self.compiled.reach

    def distance(self, scale: Scale) -> float:
        return distance(self.compiled, self.scipy, scale)


def truth(scene: Scene, representation: str) -> Truth:
    """Both tight solutions of a law in a scene."""
    law = law_or_none(scene, representation)
    return Truth(motion(scene, law, TIGHT["compiled"]), motion(scene, law, TIGHT["scipy"]))


def _looser(solver: Solver) -> list[Solver]:
    """Ten and a hundred times looser: once could agree by chance."""
    return [replace(solver, rtol=f * solver.rtol, atol=f * solver.atol) for f in (10.0, 100.0)]


def settled(scene: Scene, representation: str, found: Truth, scale: Scale, promise: float) -> Truth:
    """The truth that is left if only one of two solutions that disagree agrees with itself.

    Steps of a plain solver may pass over a thin layer, or not: scipy's do near grazing. Such a
    solution changes with its tolerance; what does not is then the truth for all. Two that both
    agree with themselves contradict each other, and nothing is settled.

    Parameters
    ----------
    promise : float
        Distance [-] that the references may have.
    """
    if not found.distance(scale) > promise:
        return found
    law = law_or_none(scene, representation)
    is_steady = [
        all(
            distance(motion(scene, law, solver), getattr(found, name), scale) <= promise
            for solver in _looser(TIGHT[name])
        )
        for name in ("compiled", "scipy")
    ]
    if is_steady == [True, False]:
        return Truth(found.compiled, found.compiled)
    return Truth(found.scipy, found.scipy) if is_steady == [False, True] else found


def growth(scene: Scene, law: ContactLaw, section: Array) -> Array:
    """Largest factor by which a disturbance of the start has grown, per period end.

    Parameters
    ----------
    section : ndarray, shape (n, 2)
        The motion's period ends, from which every period starts in a lane of its own.

    Returns
    -------
    ndarray, shape (n,)
        The largest so far, 1 or more; in states scaled by the forcing's angular frequency, or
        the oscillator's if that is higher.
    """
    starts = np.vstack([[scene.x_0, scene.v_0], section[:-1]])
    omega = np.full(len(starts), scene.omega)
    located = isinstance(law, Piecewise)
    run = simulate(
        scene.oscillator,
        Piecewise(scene.K_c, scene.gap) if located else law,
        omega,
        starts[:, 0],
        starts[:, 1],
        t_end=1.0 / scene.omega,
        rtol=1e-9,
        atol=1e-12,
        tangent=True,
    )
    omega_rad = max(2.0 * math.pi * scene.omega, scene.oscillator.omega_n_rad)
    scaled = run.monodromy * np.array([[1.0, omega_rad], [1.0 / omega_rad, 1.0]])
    whole, found = np.eye(2), [1.0]
    for one in scaled:
        whole = one @ whole
        found.append(float(np.linalg.norm(whole, 2)) if np.all(np.isfinite(whole)) else math.inf)
    return np.maximum.accumulate(np.array(found))[1:]
