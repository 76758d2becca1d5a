"""What steady responses cost beside the bare motion.

    python benchmarks/responses.py [--points 4096] [--rounds 3]

Processor time of one call of `respond_all` per simulated second, over what `gs.simulate` takes for
the same starts over 10 s without recording; of it in the engine; mean simulated time of a response.
Medians of the rounds, in which both alternate. Exact law and tanh-1e4, at rtol 1e-6 and 1e-9; all
three stiffnesses, both gaps, 0.1 to 30 Hz, from rest, chaotic points included.
"""

import argparse
import time

import numpy as np

import gapsweep as gs
from gapsweep.integrate.problem import Solver
from gapsweep.model.labels import contact_law
from gapsweep.response.respond import respond_all
from gapsweep.response.scene import Scene

OSCILLATOR, SECONDS = gs.systems.paper_oscillator(), 10.0
CONTACTS = [
    (K_c, gap) for K_c in (1.4e3, 1.4e4, 1.4e6) for gap in (gs.Gap(0.4e-3, 0.4e-3), gs.Gap(0, 8e-4))
]


def processor_time(call):
    begin = time.process_time()
    result = call()
    return time.process_time() - begin, result


def measured(label, rtol, n_points, rounds):
    solver, steady = Solver.of(rtol=rtol, atol=1e-3 * rtol), gs.Steady()
    laws = [contact_law(label, *contact) for contact in CONTACTS]
    omega = np.linspace(0.1, 30.0, n_points // len(laws))
    scenes = [
        Scene(oscillator=OSCILLATOR, law=law, omega=each, solver=solver)
        for law in laws
        for each in omega.tolist()
    ]

    def simulate():
        tolerances = {"rtol": solver.rtol, "atol": solver.atol}
        for law in laws:
            gs.simulate(OSCILLATOR, law, omega, t_end=SECONDS, **tolerances)

    respond_all(scenes[:: max(1, n_points // 64)], (0.0, 0.0), steady)  # compile, warm up
    simulate()
    found = []
    for _ in range(rounds):
        steady_time, responses = processor_time(lambda: respond_all(scenes, (0.0, 0.0), steady))
        motion_time, _ = processor_time(simulate)
        simulated = responses.columns["t_simulated"].sum()
        engine = responses.columns["cpu_time"].sum()
        motion = motion_time / (SECONDS * len(scenes))
        found.append((steady_time / simulated, engine / simulated, motion))
    respond, engine, motion = np.median(found, axis=0)
    ratio = np.median([each[0] / each[2] for each in found])
    return 1e6 * respond, 1e6 * engine, 1e6 * motion, ratio, simulated / len(scenes)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    print("| law | rtol | response, µs/s | of it engine | motion, µs/s | ratio | mean time, s |")
    print("|---|---|---|---|---|---|---|")
    for label in ("piecewise", "tanh-1e4"):
        for rtol in (1e-6, 1e-9):
            *costs, ratio, mean = measured(label, rtol, arguments.points, arguments.rounds)
            shown = " | ".join(f"{cost:.1f}" for cost in costs)
            print(f"| {label} | {rtol:g} | {shown} | {ratio:.2f} | {mean:.1f} |")


if __name__ == "__main__":
    main()
