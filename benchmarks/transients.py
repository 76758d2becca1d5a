"""How long transient chaos lasts: motions of three scenes that are still chaotic, over time.

    python benchmarks/transients.py [--starts 64] [--periods 20000]

Scenes of which a response is periodic or chaotic by rounding alone, found by random search.
"""

import argparse

import numpy as np

import gapsweep as gs

SCENES = [  # zeta, alpha, forcing, K_c, gap, K_ratio, omega, x_0
    (0.0186468727, 7e8, 1.39941571, 74030.567, (0.0, 0.0), 0.0, 13.71873947, 9.2450668e-4),
    (0.0042781079, 0.0, 62.0381491, 800128.79, (1e-3, 4e-4), 1.0, 17.39691315, 6.8340421e-4),
    (0.0143574711, 7e8, 44.1966951, 248362.33, (4e-4, 4e-4), 3.0, 10.29355462, 6.8458574e-4),
]
STRETCH, LONGEST, SAME = 500, 32, 1e-8  # forcing periods, longest period looked for, m


def repeats(section):
    """Whether the last section points, shape (n, 2), repeat within some forcing periods."""
    x = section[-2 * LONGEST :, 0]
    return any(np.abs(x[n:] - x[:-n]).max() < SAME for n in range(1, LONGEST + 1))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=64)
    parser.add_argument("--periods", type=int, default=20000)
    arguments = parser.parse_args()
    for zeta, alpha, forcing, K_c, gap, K_ratio, omega, x_0 in SCENES:
        oscillator = gs.systems.paper_oscillator(zeta=zeta, alpha=alpha, forcing=forcing)
        law = gs.Piecewise(K_c, gs.Gap(*gap), K_ratio=K_ratio)
        x, v = x_0 + np.linspace(0.0, 1e-6, arguments.starts), np.zeros(arguments.starts)
        is_chaotic = np.ones(arguments.starts, bool)
        left = []
        for _ in range(arguments.periods // STRETCH):
            run = gs.simulate(oscillator, law, omega, x, v, t_end=STRETCH / omega)
            x, v = run.x_end, run.v_end
            is_chaotic &= [not repeats(section) for section in run.section]
            left.append(int(is_chaotic.sum()))
        shown = ", ".join(
            f"{n} after {(k + 1) * STRETCH}" for k, n in enumerate(left) if k % 5 == 4
        )
        print(f"zeta {zeta:.2g}, {K_c:.3g} N/m, {omega:.3g} Hz: still chaotic {shown}", flush=True)


if __name__ == "__main__":
    main()
