"""Steady responses against brute force: agreement, and simulated time saved.

    python benchmarks/steady.py [--points 300] [--seed 1] [--rtol 1e-12]

Random points of the exact law at all three stiffnesses, both gaps, 1 to 30 Hz, random starts.
Brute force: 200 s of transient at rtol 1e-12, then 64 periods of the section; periodic if they
repeat to 1e-7 of the amplitude. Every disagreement is listed, and brute force is also compared
with itself at half the tolerance: transient chaos lets rounding choose between coexisting
attractors, so two perfect methods disagree too. The responses are found at `--rtol`, by default
that of brute force, so that tolerance does not choose the basin. Prints also how much simulated
time the early stop and the shooting save on periodic points against a fixed 24.4 s transient
plus 64 periods, and whether the attractor is the one that brute force ends on.
"""

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.oracles.section_points import complex_points, orbit_distance, parts

import gapsweep as gs
from gapsweep.response.section import period_multiple

OSCILLATOR = gs.systems.paper_oscillator()
GAPS = (gs.Gap(0.4e-3, 0.4e-3), gs.Gap(0.0, 0.8e-3))
STIFFNESSES = (1.4e3, 1.4e4, 1.4e6)
FIXED_TRANSIENT, N_SECTION = 24.4, 64


def random_points(n, seed):
    rng = np.random.default_rng(seed)
    for i in range(n):
        yield (
            gs.Piecewise(STIFFNESSES[i % 3], GAPS[(i // 3) % 2]),
            round(float(rng.uniform(1.0, 30.0)), 2),
            float(rng.uniform(-1e-3, 1e-3)),
            float(rng.uniform(-0.05, 0.05)),
        )


def brute_force(law, omega, x_0, v_0, rtol=1e-12):
    """(period multiple or 0, scaled section) after 200 s at a tight tolerance."""
    tight = {"rtol": rtol, "atol": 1e-3 * rtol}
    n = math.ceil(200.0 * omega)
    settled = gs.simulate(OSCILLATOR, law, omega, x_0, v_0, t_end=n / omega, **tight)
    window = gs.simulate(
        OSCILLATOR, law, omega, settled.x_end, settled.v_end, t_end=N_SECTION / omega, **tight
    )
    section = complex_points(window.section, omega)
    reach = np.abs(section.view(float)).max()
    return period_multiple(parts(section), 1e-7 * reach, 32), section


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rtol", type=float, default=1e-12)
    arguments = parser.parse_args()
    tolerances = {"rtol": arguments.rtol, "atol": 1e-3 * arguments.rtol}
    agreed = same_attractor = n_periodic = floor = agreed_where_sure = 0
    saved, seconds = [], 0.0
    for law, omega, x_0, v_0 in random_points(arguments.points, arguments.seed):
        begin = time.process_time()
        response = gs.respond(OSCILLATOR, law, omega, x_0, v_0, **tolerances)
        seconds += time.process_time() - begin
        n, section = brute_force(law, omega, x_0, v_0)
        agrees = response.period_multiple == n and (n > 0) == (response.response_class == 0)
        agreed += agrees
        sure = brute_force(law, omega, x_0, v_0, rtol=5e-13)[0] == n
        floor += sure
        agreed_where_sure += agrees and sure
        if response.period_multiple:
            saved.append((FIXED_TRANSIENT + N_SECTION / omega) / response.t_simulated)
        if agrees and n:
            n_periodic += 1
            own = complex_points(response.section, omega)
            distance = orbit_distance(own, section[:n])
            same_attractor += distance < 1e-4 * np.abs(section.view(float)).max()
        if not agrees:
            print(
                f"disagrees: K_c {law.K_c:g}, gap {law.gap.label}, {omega} Hz, start {x_0:.4g} m "
                f"{v_0:.4g} m/s: here {response.response_class.name.lower()} "
                f"{response.period_multiple}, |multiplier| {response.multiplier_abs:.4f}, exponent "
                f"{response.lyapunov:.2f} +- {response.lyapunov_error:.2f} after "
                f"{response.t_settled:.0f} s; brute force {n}"
                + ("" if sure else ", another at half the tolerance")
            )
    print(f"brute force agrees with itself at half the tolerance on {floor} points")
    print(f"class and period agree on {agreed_where_sure} of those {floor}")
    share = agreed / arguments.points
    print(f"class and period agree on {agreed} of {arguments.points} points ({share:.1%})")
    print(f"same orbit as brute force on {same_attractor} of {n_periodic} periodic points")
    print(
        f"simulated time saved on {len(saved)} periodic points: {np.mean(saved):.1f}-fold on "
        f"average, median {np.median(saved):.1f}, total "
        f"{len(saved) / np.sum(1 / np.array(saved)):.1f}; "
        f"{1e3 * seconds / arguments.points:.1f} ms of processor time per point, one by one"
    )


if __name__ == "__main__":
    main()
