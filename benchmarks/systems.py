"""How far random systems are off their exact motion, and whether any is silently wrong.

    python benchmarks/systems.py [--systems 300] [--seed 0]

Random piecewise-linear systems (`tests/builders/random_systems.py`) of 2 to 6 coordinates with
1 to 3 contacts, constant loads and lags or without, against closed forms by matrix exponentials:

1. At the tightest tolerance: end states, numbers of crossings, and for up to four coordinates
   monodromy matrices; what is off by more than 1e-9 times its sensitivity is listed.
2. At all tolerances: error over rtol, of motions whose sensitivity leaves the end state a meaning.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.builders.random_systems import random_case

SIZES = ((2, 1), (3, 2), (4, 3), (6, 3))  # coordinates, contacts
LOOSER = (1e-3, 1e-6, 1e-9)
MEANINGFUL = 1e-2  # largest error to be expected of an end state that is counted
WITH_TANGENT = 4  # coordinates: of more, the tangent takes a minute to compile


def main(n_systems, seed):
    ratios, misses, worst = {rtol: [] for rtol in LOOSER}, [], {}
    clock, exact_cost, n_chaotic = time.perf_counter(), 0.0, 0
    for number in range(n_systems):
        size = SIZES[number * len(SIZES) // n_systems]
        case = random_case([seed, number], *size)
        begun = time.perf_counter()
        sensitivity = max(1.0, case.truth.sensitivity)
        exact_cost += time.perf_counter() - begun
        run = case.run(tangent=size[0] <= WITH_TANGENT)
        if case.allowed < MEANINGFUL:
            if wrong := case.wrong(run):
                misses.append((number, size, wrong))
            share = max(case.errors(run)) / case.allowed
            worst[size] = max(worst.get(size, (0.0, 0)), (share, number))
        else:
            n_chaotic += 1
        for rtol in LOOSER:
            if rtol * sensitivity < MEANINGFUL:
                loose = case.run(rtol=rtol, atol=1e-3 * rtol)
                ratios[rtol].append(max(case.errors(loose)) / (rtol * sensitivity))
    print(f"{n_systems} systems, {n_chaotic} of them too chaotic for any end state")
    for number, size, wrong in misses:
        print(f"  MISS: system {number} {size}: {wrong}")
    for size, (share, number) in worst.items():
        print(f"  {size}: the worst, system {number}, takes {share:.1e} of what is allowed")
    print("error / (rtol * sensitivity)   count   median      90 %     worst")
    for rtol, found in ratios.items():
        if found:
            middle, high, largest = np.quantile(found, (0.5, 0.9, 1.0))
            print(f"  rtol {rtol:g} {len(found):23d} {middle:8.1e}  {high:8.1e}  {largest:8.1e}")
    print(f"{time.perf_counter() - clock:.0f} s, {exact_cost:.0f} s of it the exact motions")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--systems", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    main(arguments.systems, arguments.seed)
