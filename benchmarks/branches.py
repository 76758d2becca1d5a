"""Cost and correctness of branches of periodic orbits.

    python benchmarks/branches.py [--scenes 200] [--trilinear 50] [--seed 3]

1. Orbits with multipliers per second of processor time at rtol 1e-9, of an isolated branch and of
   branches that are followed together.
2. Processor time of the frequency response of the hard contact 0/0.8 mm, 1 to 30 Hz.
3. Faults of random branches by kind (`tests/oracles/random_branches.py`), and of 32 nearly
   symmetric oscillators, whose branches do not cross.
4. Symmetric orbits between walls against the solution of four equations in closed form.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.oracles.exact_orbits import is_trilinear, kinds, rows, trilinear_cases, trilinear_error
from tests.oracles.random_branches import examined, nearly_symmetric, printed, scenes

import gapsweep as gs
from gapsweep.continuation.branches import Branches
from gapsweep.continuation.family import Family, Window
from gapsweep.continuation.follow import settled
from gapsweep.continuation.orbits import OrbitEquations
from gapsweep.integrate.problem import Solver

HARD = gs.Piecewise(1.4e6, gs.Gap(0.0, 0.8e-3))
SOFT = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.process_time()
    found = call()
    return time.process_time() - begin, found


def row(what: str, asked: str, measured: str) -> None:
    print(f"{what:58s} {asked:>16s}  {measured}", flush=True)


def rate(law: gs.Piecewise, at: float, n_starts: int) -> str:
    starts = np.random.default_rng(0).uniform(-2e-3, 2e-3, (n_starts, 2)) * [1.0, 50.0]
    given = {"at": at, "starts": starts, "rtol": 1e-9, "atol": 1e-13}

    def call() -> Any:
        return gs.branches(gs.systems.paper_oscillator(), law, "omega", (1.0, 30.0), **given)

    call()  # loads machine code
    seconds, ds = timed(call)
    n_orbits = int(ds["n_orbits"].sum())
    return f"{n_orbits / seconds:.0f} (of {n_orbits} on {ds.sizes['branch']} branches)"


def together(law: gs.Piecewise, n: int) -> str:
    """Orbits per second of a branch that is followed from n frequencies at the same time."""
    window = (Window.of("omega", (3.0, 30.0)),)
    family = Family(gs.systems.paper_oscillator(), law, None, ("omega",), {"omega": 9.0})
    equations = OrbitEquations(family, window, Solver.of(rtol=1e-9, atol=1e-13))
    found = Branches(equations=equations, max_steps=60)
    attractors = settled(equations, np.linspace(3.2, 29.0, n), np.zeros((n, 2)))
    starts, reference, _ = found._starts(attractors)
    seconds, halves = timed(lambda: found.continuation.follow(starts, reference))
    n_orbits = sum(len(half.orbits) - 1 for half in halves)
    return f"{n_orbits / seconds:.0f} (of {n_orbits} from {len(starts)} orbits)"


def response() -> str:
    seconds, ds = timed(
        lambda: gs.branches(gs.systems.paper_oscillator(), HARD, "omega", (1.0, 30.0))
    )
    n_orbits, n_lost = int(ds["n_orbits"].sum()), ds.attrs["n_lost"]
    of = f"{n_orbits} orbits on {ds.sizes['branch']} branches, {n_lost} points lost"
    return f"{seconds:.1f} s ({of})"


def random_scenes(n: int, seed: int) -> None:
    done = printed(scenes(range(n), seed, {}))
    n_orbits = sum(each.n_orbits for each in done)
    row(f"{n} random scenes, {n_orbits} orbits: faults", "0", str(sum(len(r.found) for r in done)))
    done = printed((name, examined(scene)) for name, scene in nearly_symmetric())
    row("32 nearly symmetric oscillators: faults", "0", str(sum(len(r.found) for r in done)))


def trilinear(n: int, seed: int) -> None:
    errors: list[float] = []
    for model, law, omega in trilinear_cases(2 * n, seed):
        if len(errors) == n:
            break
        if not gs.respond(model, law, omega).period_multiple:
            continue
        window = 0.98 * omega, 1.02 * omega
        ds = gs.branches(model, law, "omega", window, at=omega, max_steps=10)
        for number in ds["branch"].values:
            branch = rows(ds, number)
            steps = np.flatnonzero(is_trilinear(branch) & (kinds(branch) == "none"))
            if len(steps):
                errors.append(max(trilinear_error(model, law, branch, i) for i in steps))
    worst = f"{max(errors):.1e} (median {np.median(errors):.1e})"
    row(f"{len(errors)} trilinear orbits: largest error", "1e-8", worst)


def main(n_scenes: int, n_trilinear: int, seed: int) -> None:
    row("", "asked", "measured")
    row("orbits per second, isolated branch, soft contact", ">= 2000", rate(SOFT, 8.0, 1))
    row("orbits per second, branches together, hard contact", ">= 2000", rate(HARD, 12.0, 64))
    row("orbits per second, 64 in lanes, soft contact", ">= 2000", together(SOFT, 64))
    row("response of hard contact, 1 to 30 Hz, processor time", "<= 10 s", response())
    trilinear(n_trilinear, seed)
    random_scenes(n_scenes, seed)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--trilinear", type=int, default=50)
    parser.add_argument("--seed", type=int, default=3)
    given = parser.parse_args()
    main(given.scenes, given.trilinear, given.seed)
