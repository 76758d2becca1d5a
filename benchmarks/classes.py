"""Classes of steady responses of random systems against brute force.

Two coordinates, driven, with a stop; by circulatory springs some of them flutter, so that they run
round a torus where the drive does not lock them. Brute force knows nothing of tangents or shooting:
after a long transient a motion is periodic if its section repeats itself. If not, neighbours 1e-9
apart say what it is, two sets of them: those of a chaotic motion part, those of a quasi-periodic
one stay: on a torus they part in proportion to time. Where the two sets disagree, or part by what
either may do, brute force has no answer.

With --free nothing drives them: the section is passed at the maxima of the first coordinate, and
what has stopped moving is at rest.

    python benchmarks/classes.py [--scenes 300] [--seed 0] [--free]
"""

import argparse
import math
from collections import Counter

import numpy as np

import gapsweep as gs

TIGHT = {"rtol": 1e-12, "atol": 1e-15}
TRANSIENT, WINDOW, WATCHED = 3000, 256, 1000  # forcing periods
APART, N_NEIGHBOURS = 1e-9, 6
FREE = 1.7  # Hz, about as fast as they swing by themselves
PARTED, STAYED = 1e5, 1e4  # growths of distances within WATCHED periods


def random_scene(rng, *, free):
    """A system, its law and a forcing frequency [Hz], or None."""
    flutter = (1.0 if free else rng.choice([0.0, 1.0])) * rng.uniform(8.0, 30.0)
    loss = rng.uniform(0.2, 0.8)
    system = gs.System(
        mass=np.diag(rng.uniform(0.5, 2.0, 2)),
        damping=loss * np.eye(2),
        stiffness=[[rng.uniform(80, 120), flutter], [-flutter, rng.uniform(80, 120)]],
        cubic=[
            gs.Cubic(along=along, alpha=10 ** rng.uniform(3.5, 4.7)) for along in ([1, 0], [0, 1])
        ],
        contacts={"stop": rng.uniform(-1.0, 1.0, 2)},
        forcing=[
            # Free, a load that the stop may or may not bear.
            gs.Harmonic(
                amplitude=10 ** rng.uniform(-1.5, 0.3) * rng.uniform(-1, 1, 2), k=0 if free else 1
            )
        ],
    )
    law = gs.Piecewise(10 ** rng.uniform(2.5, 4.0), gs.Gap(*rng.uniform(2e-3, 2e-2, 2)))
    return system, law, None if free else rng.uniform(0.7, 3.0)


def run(system, law, omega, state, n_periods, **options):
    state = np.asarray(state)
    frequency = None if omega is None else np.full(state.shape[:-1], omega)
    return gs.simulate(
        system, law, frequency, q_0=state[..., :2], v_0=state[..., 2:],
        t_end=n_periods / (omega or FREE), **TIGHT, **options,
    )  # fmt: skip


def growth(system, law, omega, states, rng):
    """Median growth of the distance of neighbours."""
    away = rng.normal(size=states.shape)
    away *= APART / np.linalg.norm(away, axis=1, keepdims=True)
    both = run(system, law, omega, np.concatenate([states, states + away]), WATCHED)
    q, v = (part[: len(states)] - part[len(states) :] for part in (both.q_end, both.v_end))
    return float(np.median(np.linalg.norm(np.concatenate([q, v], axis=1), axis=1))) / APART


def brute_force(system, law, omega, state, rng):
    """The name of a class, or None where it has no answer."""
    settled = run(system, law, omega, state, TRANSIENT)
    if omega is None and np.abs(settled.v_end).max() < 1e-9:
        return "equilibrium"
    window = run(system, law, omega, np.concatenate([settled.q_end, settled.v_end]), WINDOW)
    section = np.asarray(window.section)
    reach = np.abs(section).max(axis=0)
    for n in range(1, 65):
        if (np.abs(section[n:] - section[:-n]) <= 1e-6 * reach).all():
            return "periodic" if n <= 32 else None
    some = np.linspace(0, len(section) - 1, 2 * N_NEIGHBOURS).astype(int)
    sets = section[some].reshape(2, -1, 4)
    factors = [growth(system, law, omega, each, rng) for each in sets]
    if min(factors) > PARTED:
        return "chaotic"
    if max(factors) < STAYED:
        # What shrinks is on its way to a period.
        return "quasiperiodic" if min(factors) > 1e-2 else None
    return None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--free", action="store_true")
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    pairs = Counter()
    for k in range(asked.scenes):
        system, law, omega = random_scene(rng, free=asked.free)
        found = gs.respond(system, law, omega, q_0=[1e-3, -1e-3])
        if found.response_class == gs.ResponseClass.FAILED:
            pairs["failed", "-"] += 1
            continue
        state = np.concatenate([found.x_end, found.v_end])
        truth = brute_force(system, law, omega, state, rng)
        name = found.response_class.name.lower()
        pairs[name, truth] += 1
        if truth is not None and truth != name:
            print(f"scene {k}: {name}, brute force {truth}; lyapunov {found.lyapunov:.3g} "
                  f"± {found.lyapunov_error:.2g}", flush=True)  # fmt: skip
    told = sum(n for (_, truth), n in pairs.items() if truth not in (None, "-"))
    right = sum(n for (name, truth), n in pairs.items() if name == truth)
    for (name, truth), n in sorted(pairs.items(), key=str):
        print(f"{n:5d}  {name:14s} brute force: {truth}")
    error = math.sqrt(max(right * (told - right), 0) / max(told, 1) ** 3)
    print(f"{right} of {told} as brute force: {right / max(told, 1):.1%} ± {error:.1%}")


if __name__ == "__main__":
    main()
