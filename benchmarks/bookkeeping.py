"""What a sweep point costs beside its integration.

    python benchmarks/bookkeeping.py [--points 512] [--rounds 5]

Per representation: the wall time of one call of `respond_all`, the processor time of the
integration in it, and their ratio; medians of the rounds. K_c = 14 kN/m, walls at 0.4 mm,
1 to 30 Hz, from rest, default settings.
"""

import argparse
import time

import numpy as np

import gapsweep as gs
from gapsweep.integrate.problem import Solver
from gapsweep.model.labels import contact_law
from gapsweep.response.ensemble import Scene
from gapsweep.response.respond import Question, respond_all

REPRESENTATIONS = (
    "piecewise",
    "piecewise-noevents",
    "poly-13",
    "ratpoly-5/3",
    "tanh-1e4",
    "arctan-1e4",
    "logarctan-1e4",
)


def questions(representation, n_points):
    law = contact_law(representation, 1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    oscillator, solver, steady = gs.Oscillator(), Solver.of(), gs.Steady()
    return [
        Question(
            scene=Scene(oscillator=oscillator, law=law, omega=omega, solver=solver),
            start=(0.0, 0.0),
            steady=steady,
        )
        for omega in np.linspace(1.0, 30.0, n_points).tolist()
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=512)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    print("| representation | wall, ms | integration, ms | ratio | µs per point beside it |")
    print("|---|---|---|---|---|")
    for representation in REPRESENTATIONS:
        batch = questions(representation, arguments.points)
        respond_all(batch)  # compile, warm up
        rounds = []
        for _ in range(arguments.rounds):
            begin = time.perf_counter()
            responses = respond_all(batch)
            wall = time.perf_counter() - begin
            rounds.append((wall, float(responses.columns["cpu_time"].sum())))
        wall, integration = np.median(rounds, axis=0)
        ratio = np.median([wall / integration for wall, integration in rounds])
        beside = 1e6 * (wall - integration) / len(batch)
        print(
            f"| {representation} | {1e3 * wall:.1f} | {1e3 * integration:.1f} | "
            f"{ratio:.2f} | {beside:.0f} |"
        )


if __name__ == "__main__":
    main()
