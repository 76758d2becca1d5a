"""How far motions of approximations are from the truth, beside what their tolerance asks.

    python benchmarks/step_errors.py [--scenes 1000] [--seed 1]

Random scenes of each law: stiffness 10^3.5 to 10^6.3 N/m, distances up to 1 mm, 2 to 30 Hz, random
starts, over 50 ms. Error of the end state over rtol times .5 mm times what the motion stretches
disturbances by (at least 1), against rtol 1e-13; attempted steps a motion, and the processor time.
Run it in two checkouts to compare.
"""

import argparse
import time

import numpy as np

import gapsweep as gs

LABELS = ("tanh-1e4", "tanh-1e5", "tanh-1e6", "arctan-1e4", "arctan-1e6", "logarctan-1e4", "poly-3")
SCALE, SECONDS, CONTACTS = 0.5e-3, 0.05, 10


def motions(label, n_scenes, rng):
    """Laws and starts of scenes, as arguments of `simulate`."""
    for _ in range(CONTACTS):
        K_c = 10.0 ** rng.uniform(3.5, 6.3)
        gap = gs.Gap(*rng.uniform(0.0, 1e-3, 2).tolist())
        n = n_scenes // CONTACTS
        start = rng.uniform(2.0, 30.0, n), rng.uniform(-8e-4, 8e-4, n), rng.uniform(-0.05, 0.05, n)
        yield gs.contact_law(label, K_c, gap), start


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    print("| law | rtol | attempts | µs | median | 99 % | largest |")
    print("|---|---|---|---|---|---|---|")
    for label in LABELS:
        scenes = list(motions(label, given.scenes, np.random.default_rng(given.seed)))
        truths = [
            gs.simulate(
                gs.systems.paper_oscillator(),
                law,
                *start,
                t_end=SECONDS,
                rtol=1e-13,
                atol=1e-16,
                tangent=True,
            )
            for law, start in scenes
        ]
        for rtol in (1e-3, 1e-4, 1e-6, 1e-9):
            errors, attempts, seconds = [], 0, 0.0
            for (law, start), truth in zip(scenes, truths, strict=True):
                begin = time.process_time()
                run = gs.simulate(
                    gs.systems.paper_oscillator(),
                    law,
                    *start,
                    t_end=SECONDS,
                    rtol=rtol,
                    atol=1e-3 * rtol,
                )
                seconds += time.process_time() - begin
                attempts += int((run.n_steps + run.n_rejected).sum())
                stretch = np.maximum(1.0, np.abs(truth.monodromy[:, 0, 0]))
                errors.append(np.abs(run.x_end - truth.x_end) / (SCALE * rtol * stretch))
            error = np.concatenate(errors)
            print(
                f"| {label} | {rtol:g} | {attempts / error.size:.1f} | "
                f"{1e6 * seconds / error.size:.1f} | {np.median(error):.2g} | "
                f"{np.quantile(error, 0.99):.3g} | {error.max():.3g} |"
            )


if __name__ == "__main__":
    main()
