"""Whether any number is silently wrong: determinants, energies, clocks and rattling solvers.

    python benchmarks/trust.py [--scenes 2000] [--clocks 150] [--seed 7]

Random oscillators (`tests/builders/random_oscillators.py`) and properties of every method on them:

1. The tangent over a periodic response shrinks areas by exp(-2 zeta omega_n n T); a linear
   oscillator has one period-1 response; what is called anything else is listed, with what a long
   run of another method says.
2. Free undamped swings keep their energy.
3. A clock 2^k times slower changes no bit, any other neither class nor amplitude, except where the
   exact law does not agree with itself from forty starts within 2e-8 of the static deflection:
   transient chaos that one start in twelve leaves needs as many to be seen.
4. Solvers that pass kinks unlocated do not take their own rattling for chaos.
"""

import argparse
import itertools
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.builders import random_oscillators as rs

import gapsweep as gs
from gapsweep.integrate.problem import Solver

DETERMINANT = {1e-4: 1e-2, 1e-9: 1e-6}


def upper_limit(misses, n):
    """Upper end of the 95 % interval of a share (Wilson)."""
    share, z = misses / n, 1.96
    centre = share + z * z / (2 * n)
    half = z * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return (centre + half) / (1 + z * z / n)


def determinants(cases):
    print(f"## Determinants, {len(cases)} scenes\n")
    for rtol, allowed in DETERMINANT.items():
        began = time.process_time()
        found = rs.responses(cases, rtol)
        seconds = time.process_time() - began
        classes = Counter(
            (c.kind, r.response_class.name.lower()) for c, r in zip(cases, found, strict=True)
        )
        errors = [
            rs.determinant_error(c, r, rtol)
            for c, r in zip(cases, found, strict=True)
            if rs.is_periodic(r)
        ]
        unresolved = sum(r.response_class.name == "UNRESOLVED" for r in found)
        print(f"rtol {rtol:g}: {seconds:.1f} s of processor time; {dict(sorted(classes.items()))}")
        print(
            f"  determinant: largest error {max(errors):.2g} (allowed {allowed:g}), median "
            f"{np.median(errors):.2g}, {sum(e > allowed for e in errors)} above"
        )
        print(
            f"  unresolved: {unresolved}, {100 * unresolved / len(cases):.2f} %, 95 % interval to "
            f"{100 * upper_limit(unresolved, len(cases)):.2f} %"
        )
        for i, (case, r) in enumerate(zip(cases, found, strict=True)):
            wrong = case.kind == "linear" and r.period_multiple != 1
            if not wrong and (rs.is_periodic(r) or case.kind != "linear"):
                wrong = r.response_class.name == "UNRESOLVED" or (
                    r.response_class.name == "CHAOTIC" and rs.is_settled_by_force(case, r)
                )
            if wrong or not np.isfinite(r.x_max):
                o = case.oscillator
                print(
                    f"  look: {i} {case.kind} {r.response_class.name} exponent {r.lyapunov:.3g} +- "
                    f"{r.lyapunov_error:.2g}, zeta {o.zeta:.4g}, omega/omega_n "
                    f"{case.omega / o.omega_n:.4g}, settles by force: "
                    f"{rs.is_settled_by_force(case, r)}"
                )
    print()


def energies():
    print("## Energy of free swings over 50 cycles\n")
    grid = list(itertools.product((0.0, 1e2, 1e4, 1e6, 1e8, 1e10), (0.1, 1.0, 5.0, 100.0),
                                  (1e-3, 1.0, 3.0), (1e-4, 1e-3, 1e-2)))  # fmt: skip
    for rtol in (1e-3, 1e-6, 1e-9, 1e-12):
        errors = [
            rs.energy_error(
                gs.Oscillator(zeta=0.0, omega_n=f, mass=m, alpha=a, forcing=0.0), x, rtol
            )
            for a, f, m, x in grid
        ]
        print(
            f"rtol {rtol:g}: {len(grid)} swings, largest error {max(errors) / rtol:.1f} rtol "
            f"(allowed 100), median {np.median(errors) / rtol:.2f}"
        )
    print()


def clocks(cases):
    print(f"## Clocks, {len(cases)} scenes\n")
    found = rs.responses(cases, 1e-9)
    same = np.ones(len(cases), bool)
    for k in (*range(-20, 0), *range(1, 21)):
        moved = rs.responses(cases, 1e-9, [1e-9 * k * _deflection(c) for c in cases])
        same &= [_is_same(*pair) for pair in zip(found, moved, strict=True)]
    for clock in (2.0**-7, 0.5, 8.0, 2.0**7):
        slow = rs.responses([c.slowed(clock) for c in cases], 1e-9)
        equal = [_scaled(a, 1.0) == _scaled(b, clock) for a, b in zip(found, slow, strict=True)]
        print(f"clock {clock:g}: {sum(equal)} of {len(cases)} bit-equal")
    for clock in (0.01, 0.3, 7.0, 100.0):
        slow = rs.responses([c.slowed(clock) for c in cases], 1e-9)
        agree = np.array([_is_same(*pair) for pair in zip(found, slow, strict=True)])
        print(
            f"clock {clock:g}: {np.sum(agree & same)} of {np.sum(same)} agree where exact agrees "
            f"with exact, {np.sum(agree & ~same)} of the other {np.sum(~same)}"
        )
        for i in np.flatnonzero(same & ~agree):
            a, b = found[i], slow[i]
            print(
                f"  look: {i} {cases[i].kind} {a.response_class.name} {a.period_multiple} "
                f"{a.amplitude:.6g} exponent {a.lyapunov:.3g}, slowed "
                f"{b.response_class.name} {b.period_multiple} {b.amplitude:.6g}"
            )
    print()


def _deflection(case):
    o = case.oscillator
    return o.forcing / (o.mass * o.omega_n_rad**2)


def _scaled(r, clock):
    return r.x_max, r.x_min, r.extrema, r.x_end, r.v_end * clock, r.response_class, r.n_steps


def _is_same(a, b):
    if a.response_class is not b.response_class or a.period_multiple != b.period_multiple:
        return False
    # The window of a chaotic motion is a sample.
    return not rs.is_periodic(a) or abs(a.amplitude - b.amplitude) <= 1e-6 * a.amplitude


def rattling():
    print("## Hard contact, gap 0/0.8 mm, from rest: solver noise against chaos\n")
    frequencies, gap, K_c = np.linspace(0.1, 30.1, 301), gs.Gap(0.0, 0.8e-3), 1.4e6
    exact = rs.rattled(Solver.of(), gs.Piecewise(K_c, gap), frequencies)
    chaotic = {i for i, r in enumerate(exact) if r.response_class.name == "CHAOTIC"}
    paper = Solver.of("compiled", 1e-4, 1e-7, "ode45", True)
    noevents = gs.Piecewise(K_c, gap, located=False)
    for name, law, solver in (
        ("piecewise", gs.Piecewise(K_c, gap), Solver.of()),
        ("piecewise@paper", gs.Piecewise(K_c, gap), paper),
        ("piecewise-noevents@paper", noevents, paper),
        ("piecewise-noevents, 1e-4", noevents, Solver.of("compiled", 1e-4, 1e-7)),
        ("piecewise-noevents, 1e-6", noevents, Solver.of("compiled", 1e-6, 1e-9)),
        ("tanh-1e9@paper", gs.Tanh(K_c, gap, 1e9), paper),
        ("tanh-1e6@paper", gs.Tanh(K_c, gap, 1e6), paper),
    ):
        found = rs.rattled(solver, law, frequencies)
        classes = Counter(r.response_class.name.lower() for r in found)
        taken = [
            float(f)
            for f, r, e in zip(frequencies, found, exact, strict=True)
            if rs.is_taken_for_chaos(r, e, float(f), gap)
        ]
        kept = sum(found[i].response_class.name == "CHAOTIC" for i in chaotic)
        print(
            f"{name}: {dict(classes)}; rattling taken for chaos or unresolved: {taken}; chaotic at "
            f"{kept} of the exact law's {len(chaotic)} chaotic frequencies"
        )
    print()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--clocks", type=int, default=150)
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    energies()
    rattling()
    clocks(list(rs.random_cases(arguments.clocks, arguments.seed + 1)))
    determinants(list(rs.random_cases(arguments.scenes, arguments.seed)))


if __name__ == "__main__":
    main()
