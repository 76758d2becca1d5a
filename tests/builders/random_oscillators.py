"""Random scenes of every time scale, and what must hold in all of them.

Shared by the tests, on seeded samples, and by `benchmarks/trust.py`, on as many as wanted.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad

import gapsweep as gs
from gapsweep.integrate.problem import Solver
from gapsweep.response.respond import respond_all
from gapsweep.response.result import Response, ResponseClass
from gapsweep.response.scene import Scene

FAR = gs.Gap(1e3, 1e3)  # m: walls that nothing reaches


@dataclass(frozen=True)
class Case:
    """An oscillator between walls, forced at a frequency [Hz], at rest."""

    kind: str
    oscillator: gs.Oscillator
    law: gs.Piecewise
    omega: float

    def scene(self, solver: Solver) -> Scene:
        return Scene(oscillator=self.oscillator, law=self.law, omega=self.omega, solver=solver)

    def slowed(self, clock: float) -> "Case":
        """The case of a motion with the same displacements that is `clock` times slower."""
        o, square = self.oscillator, clock * clock
        slow = replace(
            o, omega_n=o.omega_n / clock, alpha=o.alpha / square, forcing=o.forcing / square
        )
        law = replace(self.law, K_c=self.law.K_c / square)
        return Case(self.kind, slow, law, self.omega / clock)


def solver_at(rtol: float) -> Solver:
    return Solver.of("compiled", rtol, 1e-3 * rtol)


def responses(cases: list[Case], rtol: float, x_0: ArrayLike = 0.0) -> list[Response]:
    starts = np.zeros((len(cases), 2))
    starts[:, 0] = x_0
    return respond_all([case.scene(solver_at(rtol)) for case in cases], starts, gs.Steady()).rows()


def random_cases(n: int, seed: int) -> Iterator[Case]:
    """Linear and Duffing oscillators, with walls, and with walls but no gap.

    Natural frequency .1 to 100 Hz, damping ratio .003 to .3, forced at 1/50 to 5 of it; lengths
    and forces scaled by the static deflection of .1 to 3 mm.
    """
    rng = np.random.default_rng(seed)

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    for _ in range(n):
        kind = str(rng.choice(["linear", "duffing", "no gap", "walls"]))
        omega_n, mass, deflection = log(0.1, 100.0), log(0.01, 10.0), log(1e-4, 3e-3)
        stiffness = mass * (2.0 * math.pi * omega_n) ** 2
        oscillator = gs.Oscillator(
            zeta=log(0.003, 0.3),
            omega_n=omega_n,
            mass=mass,
            alpha=0.0 if kind == "linear" else stiffness / deflection**2 * log(1e-3, 10.0),
            forcing=stiffness * deflection,
        )
        lower = 0.0 if rng.random() < 0.5 else deflection * rng.uniform(0.05, 1.5)
        gap = {
            "linear": FAR,
            "duffing": FAR,
            "no gap": gs.Gap(0.0, 0.0),
            "walls": gs.Gap(lower, deflection * rng.uniform(0.05, 1.5)),
        }[kind]
        law = gs.Piecewise(stiffness * log(1.0, 3000.0), gap)
        yield Case(kind, oscillator, law, omega_n * log(1.0 / 50.0, 5.0))


def determinant_error(case: Case, response: Response, rtol: float) -> float:
    """Error of the determinant of the tangent over a response's period, known from damping.

    Relative to the determinant, or to a thousandth of the tangent's square, from which rounding
    shows. Both are logarithms added up over single forcing periods, so that strong damping cancels
    nothing.
    """
    o, period = case.oscillator, 1.0 / case.omega
    x, v, worst = response.x_end, response.v_end, 0.0
    exact = math.exp(-2.0 * o.decay_rate * period)
    for _ in range(response.period_multiple):
        run = gs.simulate(
            o, case.law, case.omega, x, v, t_end=period, rtol=rtol, atol=1e-3 * rtol, tangent=True
        )
        unit = np.array([1.0, o.omega_n_rad])
        tangent = run.monodromy * unit[None, :] / unit[:, None]
        allowed = max(exact, 1e-3 * float(np.square(tangent).sum()))
        missed = abs(float(np.linalg.det(tangent)) - exact)
        worst += missed / allowed if allowed > 0.0 else 0.0
        x, v = run.x_end, run.v_end
    return worst


def is_settled_by_force(case: Case, response: Response) -> bool:
    """Whether a long run of DOP853 repeats itself: an oracle for what is not periodic here."""
    periods = math.ceil(max(60.0 / case.oscillator.decay_rate * case.omega, 64))
    law = gs.Tanh(case.law.K_c, case.law.gap, 1e9)
    tight = {"rtol": 1e-11, "atol": 1e-15}
    run = gs.simulate(
        case.oscillator,
        law,
        case.omega,
        response.x_end,
        response.v_end,
        t_end=periods / case.omega,
        **tight,
    )
    window = gs.simulate(
        case.oscillator, law, case.omega, run.x_end, run.v_end, t_end=64 / case.omega
    )
    x = window.section[:, 0]
    reach = np.abs(x).max()
    return any(np.abs(x[n:] - x[:-n]).max() < 1e-6 * reach for n in range(1, 33))


def energy_error(oscillator: gs.Oscillator, x_0: float, rtol: float) -> float:
    """Relative change of the energy of a free, undamped swing over 50 of its cycles."""
    stiffness, cubic = oscillator.omega_n_rad**2, oscillator.alpha / oscillator.mass

    def pace(phase: float) -> float:
        rising = 0.5 * (1.0 + math.sin(phase) ** 2)
        return 1.0 / math.sqrt(stiffness + cubic * x_0**2 * rising)

    def energy(x: float, v: float) -> float:
        return 0.5 * v * v + 0.5 * stiffness * x * x + 0.25 * cubic * x**4

    cycle = 4.0 * quad(pace, 0.0, 0.5 * math.pi)[0]
    law = gs.Piecewise(1.0, FAR)
    run = gs.simulate(
        oscillator, law, 1.0, x_0, t_end=50.0 * cycle, rtol=rtol, atol=1e-3 * rtol * x_0
    )
    return abs(energy(run.x_end, run.v_end) / energy(x_0, 0.0) - 1.0)


def is_periodic(response: Response) -> bool:
    return response.response_class is ResponseClass.PERIODIC


def rattled(
    solver: Solver, law: gs.model.contact.ContactLaw, frequencies: np.ndarray
) -> list[Response]:
    """Responses of the default oscillator from rest."""
    scenes = [
        Scene(oscillator=gs.systems.paper_oscillator(), law=law, omega=float(omega), solver=solver)
        for omega in frequencies
    ]
    return respond_all(scenes, (0.0, 0.0), gs.Steady()).rows()


def is_taken_for_chaos(found: Response, exact: Response, omega: float, gap: gs.Gap) -> bool:
    """Whether a motion is not called periodic though it lies on the exact law's periodic one."""
    if is_periodic(found) or not is_periodic(exact):
        return False
    if abs(found.amplitude / exact.amplitude - 1.0) > 0.01:
        return False
    points, orbit = (
        np.reshape(r.section, (-1, 2)) @ np.array([1.0, 1j / (2.0 * math.pi * omega)])
        for r in (found, exact)
    )
    distance = np.abs(points[:, None] - orbit[None, :]).min(axis=1).max()
    return bool(distance <= max(20.0 * found.noise, 0.02 * gap.width))
