"""Whether responses at loose tolerances are orbits of the machine.

    python benchmarks/loose_tolerances.py [--cases 400] [--seed 1]

Random oscillators: exact law with located and unlocated contacts, tanh, arctan; gaps, stiffnesses
and initial states at random. Periodic responses at rtol 1e-3, 1e-4 and 1e-6 whose period or largest
multiplier differs from that at 1e-9 are disputed: Newton's method with the scipy engine at 1e-10
computes their orbits. `wrong`: the orbit is absent, unstable or has a shorter period. Prints counts
and the processor time of the responses.
"""

import argparse
import math
import time

import numpy as np

import gapsweep as gs

PERIODIC = gs.ResponseClass.PERIODIC
LAWS = ("exact", "tanh", "arctan", "exact", "unlocated")


def case(kind, rng):
    """Arguments of `respond`: of the size d, in metres."""

    def log(low, high):
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    omega_n, mass, d = log(2.0, 25.0), log(0.2, 5.0), log(2e-4, 5e-3)
    k = mass * (2.0 * math.pi * omega_n) ** 2
    alpha = rng.choice([0.0, 1.0]) * k / d**2 * log(0.01, 2.0)
    model = gs.Oscillator(
        zeta=log(0.01, 0.1), omega_n=omega_n, mass=mass, alpha=alpha, forcing=k * d
    )
    walls = d * rng.uniform(0.0, 1.2, 2)
    gaps = gs.Gap(walls[0], walls[0]), gs.Gap(*walls), gs.Gap(0.0, walls[1]), gs.Gap(0.0, 0.0)
    gap, K_c, omega = (
        gaps[rng.choice(4, p=(0.3, 0.45, 0.15, 0.1))],
        k * log(2.0, 1e3),
        log(0.3, 3.0),
    )
    sides, sharpness = {"K_ratio": rng.choice([1.0, rng.uniform(0.2, 2.0)])}, log(10.0, 1e3) / d
    if kind in ("tanh", "arctan"):
        law = getattr(gs, kind.title())(K_c, gap, sharpness, **sides)
    else:
        law = gs.Piecewise(K_c, gap, located=kind == "exact", **sides)
    x_0, v_0 = d * rng.normal(), d * 2.0 * math.pi * omega * omega_n * rng.normal()
    return model, law, omega * omega_n, x_0, v_0


def is_right(case, state, n):
    """Whether a stable orbit of prime period n is near a state."""
    model, law, omega = case[:3]
    law = law.exact if isinstance(law, gs.Piecewise) else law
    unit, y = np.array([1.0, 2.0 * math.pi * omega]), np.array(state)
    for _ in range(12):
        run = gs.simulate(
            model, law, omega, *y, n_periods=n, tangent=True, engine="scipy", rtol=1e-10
        )
        size = np.abs(run.extrema).max()
        step = np.linalg.solve(np.eye(2) - run.monodromy, np.array([run.x_end, run.v_end]) - y)
        if np.abs(step / unit).max() < 1e-6 * size:
            break
        y += step
    else:
        return False
    again = np.abs((run.section[:-1] - y) / unit).max(axis=1)
    is_near = np.abs((y - state) / unit).max() < 0.25 * size
    return (
        is_near
        and np.abs(np.linalg.eigvals(run.monodromy)).max() < 1.0
        and (again > 1e-5 * size).all()
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    settings = parser.parse_args()
    rng = np.random.default_rng(settings.seed)
    cases = [case(LAWS[i % len(LAWS)], rng) for i in range(settings.cases)]
    columns = [list(column) for column in zip(*cases, strict=True)]
    truth = gs.respond(*columns, rtol=1e-9)
    print("rtol     periodic  disputed  wrong  unresolved  chaotic  seconds")
    for rtol in (1e-3, 1e-4, 1e-6):
        gs.respond(*columns, rtol=rtol)  # compiles
        begin = time.process_time()
        found = gs.respond(*columns, rtol=rtol)
        seconds = time.process_time() - begin
        is_periodic = found.response_class == PERIODIC
        alike = (found.period_multiple == truth.period_multiple) & is_periodic
        alike[alike] = np.abs(found.multiplier_abs - truth.multiplier_abs)[alike] < 1e-4
        disputed = np.flatnonzero(is_periodic & ~alike).tolist()
        ends = np.stack([found.x_end, found.v_end], axis=1)
        wrong = [
            k for k in disputed if not is_right(cases[k], ends[k], int(found.period_multiple[k]))
        ]
        others = [(found.status == gs.Status.UNRESOLVED).sum(),
                  (found.response_class == gs.ResponseClass.CHAOTIC).sum()]  # fmt: skip
        print(f"{rtol:<9g}{is_periodic.sum():8}{len(disputed):10}{len(wrong):7}", end="")
        print(f"{others[0]:12}{others[1]:9}{seconds:9.2f}  {wrong or ''}")


if __name__ == "__main__":
    main()
