"""Random piecewise-linear systems as gapsweep takes them, beside their exact motion.

Shared by the tests, on seeded samples, and by `benchmarks/systems.py`, on as many as wanted.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

import gapsweep as gs
from tests.oracles import piecewise_linear as exact

# Kernels are compiled for so many: first-order states that a system lacks have no effect.
LAGS = 2
RTOL, ATOL = 1e-12, 1e-15
TOLERANCE = 1e-9
# Of a gap's extreme to a wall, in units of the largest coordinate's error: nearer ones may touch
# or not.
CLEAR = 1e3


@dataclass(frozen=True)
class Case:
    """A system for the oracle, and where its motion begins and ends."""

    system: exact.System
    omega: float
    q_0: Any
    v_0: Any
    z_0: Any
    t_end: float

    @cached_property
    def truth(self) -> exact.Motion:
        start = self.q_0, self.v_0, self.z_0[: self.system.n_lags]
        return exact.motion(self.system, self.omega, *start, self.t_end)

    @property
    def allowed(self) -> float:
        """Error of the end state beside its own size, that rounding and steps may come to."""
        return TOLERANCE * max(1.0, float(np.linalg.norm(self.truth.monodromy, 2)))

    def run(self, **options: Any) -> gs.SystemTrajectory:
        system, laws = as_gapsweep(self.system)
        given = {"q_0": self.q_0, "v_0": self.v_0, "z_0": self.z_0, "t_end": self.t_end}
        tolerances = {"rtol": RTOL, "atol": ATOL}
        return gs.simulate(system, laws, self.omega, **{**given, **tolerances, **options})

    def errors(self, run: gs.SystemTrajectory) -> tuple[float, float]:
        """Errors of final coordinates and velocities, relative to the largest of each."""
        truth = self.truth
        return relative(run.q_end, truth.q), relative(run.v_end, truth.v)

    def wrong(self, run: gs.SystemTrajectory) -> str:
        """First deviation of a run beyond the tolerances above, in words; empty without any."""
        if run.status != gs.Status.OK:
            return str(run.status.label)
        truth = self.truth
        errors = self.errors(run)
        if max(errors) > self.allowed:
            return f"end off by {max(errors):.1e}, may be {self.allowed:.1e}"
        unsure = CLEAR * RTOL * truth.sensitivity * float(np.abs(truth.q).max())
        if run.n_contacts != truth.n_crossings and truth.clearance > unsure:
            return f"{run.n_contacts} crossings instead of {truth.n_crossings}"
        if run.monodromy is not None:
            n = len(truth.monodromy)
            error = relative(run.monodromy[:n, :n], truth.monodromy)
            if error > self.allowed:
                return f"monodromy off by {error:.1e}, may be {self.allowed:.1e}"
        return ""


def relative(found: Any, truth: Any) -> float:
    return float(np.abs(found - truth).max() / np.abs(truth).max())


def as_gapsweep(system: exact.System) -> tuple[gs.System, dict[str, gs.Piecewise]]:
    """System and laws for gapsweep, padded to `LAGS` first-order states."""
    n, m = system.n, system.n_lags
    loads = [gs.Harmonic(amplitude=h.p, k=h.k, phase=h.phase) for h in system.harmonics]
    force, of_speed, of_place, of_lags = system.lags()
    more = LAGS - m
    decays = -np.eye(LAGS)
    decays[:m, :m] = of_lags
    lags = gs.Lags(
        np.hstack([force, np.zeros((n, more))]),
        np.vstack([of_speed, np.zeros((more, n))]),
        np.vstack([of_place, np.zeros((more, n))]),
        decays,
    )
    names = {f"contact {i}": contact for i, contact in enumerate(system.contacts)}
    given = gs.System(
        mass=system.M,
        damping=system.C,
        stiffness=system.K,
        contacts={name: contact.b for name, contact in names.items()},
        forcing=loads,
        lags=lags,
    )
    laws = {
        name: gs.Piecewise(c.K_c, gs.Gap(c.j_1, c.j_2), K_ratio=c.K_ratio)
        for name, c in names.items()
    }
    return given, laws


def random_case(
    seed: list[int], n: int, n_contacts: int, periods: tuple[float, float] = (0.5, 3.0)
) -> Case:
    """A system with constant loads and lags or without them; stable, and it may be chaotic."""
    rng = np.random.default_rng(seed)
    has_load, has_lags = rng.random(2) < 0.5
    system, omega = exact.random_system(
        rng, n, n_contacts, constant_load=bool(has_load), lags=bool(has_lags)
    )
    q_0, v_0, z_0, t_end = exact.random_start(rng, system, omega, periods)
    return Case(system, omega, q_0, v_0, np.append(z_0, np.zeros(LAGS - len(z_0))), t_end)
