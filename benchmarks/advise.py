"""Whether the advised model is adequate and how much it costs: on scenes that built no rule.

    python benchmarks/advise.py --scenes 2000 --seed 6 --error 1e-3 --rounds 0
    python benchmarks/advise.py --scenes 300 --seed 6

Seeds 1 to 5 were used to find the rules (docs/decisions/0010-advice.md). A scene is judged where
the exact law agrees with itself (start moved by 1e-9 m) within the error asked for; all others are
counted apart. Without rounds only the advised models are run, and no cost is told. Else the cost of
a model in a scene is the processor time of sixteen copies of it that advance together, smallest of
several rounds, interleaved. Polynomials are left out: each fit is compiled for itself, and none of
degree 60 or less meets 1e-2 in a scene whose walls are reached and stiff.
"""

import argparse
import time

import numpy as np
from scipy.stats import binomtest

import gapsweep as gs
from gapsweep.integrate.problem import Solver
from gapsweep.response.respond import respond_all
from gapsweep.response.result import Steady
from gapsweep.response.scene import Scene
from gapsweep.study.least_model import Model, advise

REFERENCE_RTOL = 1e-11
COPIES = 16
MODELS = (
    "exact", "duffing", "linear", "piecewise-noevents",
    *(f"{family}-1e{n}" for family in ("tanh", "arctan", "logarctan") for n in (4, 5, 6, 7)),
)  # fmt: skip
CHEAP, DEAR = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-9), (1e-4, 1e-6)


def random_scenes(n, seed):
    """Oscillators, stiffnesses, gaps, frequencies and starts, over two decades where it matters."""
    rng = np.random.default_rng(seed)

    def log(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    scenes = []
    for _ in range(n):
        oscillator = gs.Oscillator(
            zeta=log(0.01, 0.1),
            omega_n=rng.uniform(3.0, 8.0),
            mass=rng.uniform(1.0, 5.0),
            alpha=log(7e7, 2e9),
            forcing=log(0.5, 10.0),
        )
        j = rng.uniform(0.0, 1.2e-3)
        gap = (j, j) if rng.random() < 0.5 else (rng.uniform(0, 0.6e-3), rng.uniform(0, 1.2e-3))
        K_c, omega = log(1e3, 2e6), rng.uniform(0.5, 30.0)
        start = (0.0, 0.0)
        if rng.random() > 0.6:
            start = (rng.uniform(-2e-3, 2e-3), rng.uniform(-0.05, 0.05))
        scenes.append((oscillator, K_c, gs.Gap(*gap), omega, start))
    return scenes


def questions(scenes, model, rtol, moved=0.0):
    """The scenes with one model: a `Model` by name, or a label."""
    solver = Solver.of("compiled", rtol, 1e-3 * rtol)
    asked, starts = [], []
    for oscillator, K_c, gap, omega, (x, v) in scenes:
        if model == "linear":
            oscillator = gs.systems.paper_oscillator(**{**_fields(oscillator), "alpha": 0.0})
        if model in ("linear", "duffing"):
            K_c = 0.0
        label = "piecewise" if model in ("exact", "linear", "duffing") else model
        law = gs.contact_law(label, K_c, gap)
        asked.append(Scene(oscillator=oscillator, law=law, omega=omega, solver=solver))
        starts.append((x + moved, v))
    return asked, starts


def _fields(oscillator):
    return {name: getattr(oscillator, name) for name in ("zeta", "omega_n", "mass", "forcing")}


def amplitudes(asked):
    """Steady amplitudes [m], and whether a wall was reached."""
    columns = respond_all(*asked, Steady()).columns
    return np.array([columns[name] for name in ("amplitude", "n_contacts")])


def cost(scene, start):
    """Processor time [s] of one scene among fifteen like it."""
    began = time.process_time()
    respond_all([scene] * COPIES, start, Steady())
    return (time.process_time() - began) / COPIES


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=500)
    parser.add_argument("--seed", type=int, default=6)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--error", type=float, default=1e-3)
    settings = parser.parse_args()
    scenes, limit = random_scenes(settings.scenes, settings.seed), settings.error
    exact, contacts = amplitudes(questions(scenes, "exact", REFERENCE_RTOL))
    moved, _ = amplitudes(questions(scenes, "exact", REFERENCE_RTOL, 1e-9))
    scale = np.maximum(exact, [0.5 * gap.width for _, _, gap, _, _ in scenes])
    judged = np.abs(moved - exact) <= limit * scale

    began = time.perf_counter()
    advice = [
        advise(oscillator, gs.Piecewise(K_c, gap), omega, start, error=limit)
        for oscillator, K_c, gap, omega, start in scenes
    ]
    print(f"advice: {1e6 * (time.perf_counter() - began) / len(scenes):.0f} us per scene")
    models = np.array([Model(one.model).name.lower() for one in advice])
    advised = [(str(m), one.rtol) for m, one in zip(models, advice, strict=True)]
    candidates = sorted(set(advised))
    if settings.rounds:
        candidates += [
            (model, rtol)
            for model in MODELS
            for rtol in (CHEAP if model in ("exact", "duffing", "linear") else DEAR)
            if (model, rtol) not in candidates
        ]
    asked = {one: questions(scenes, *one) for one in candidates}
    errors = {one: np.abs(amplitudes(q)[0] - exact) / scale for one, q in asked.items()}
    costs = {one: np.full(len(scenes), np.inf) for one in candidates}
    for _ in range(settings.rounds):
        for i in np.flatnonzero(judged):
            for one in (one for one in candidates if errors[one][i] <= limit):
                costs[one][i] = min(costs[one][i], cost(*(each[i] for each in asked[one])))
    table = np.array([costs[one] for one in candidates])
    cheapest = np.array(["{}, rtol {:g}".format(*one) for one in candidates])[table.argmin(axis=0)]
    error = np.array([errors[one][i] for i, one in enumerate(advised)])
    met = judged & (error <= limit)
    own = np.array([costs[one][i] for i, one in enumerate(advised)])

    print(f"{len(scenes)} scenes, {judged.sum()} judged; in the others exact differs from exact")
    for name in ("exact", "duffing", "linear"):
        print(f"advised {name}: {np.sum(models == name)}")
    print(f"walls reached though said not to be: {np.sum((models != 'exact') & (contacts > 0))}")
    share = binomtest(int(met.sum()), int(judged.sum()))
    low, high = share.proportion_ci(method="wilson")
    print(
        f"error {limit:g} met: {met.sum()} of {judged.sum()}, {100 * share.statistic:.2f} %, "
        f"95 % interval {100 * low:.2f} to {100 * high:.2f} %"
    )
    if settings.rounds:
        ratio = own[met] / table.min(axis=0)[met]
        print(
            f"cost over that of the cheapest adequate: median {np.median(ratio):.2f}, "
            f"p90 {np.quantile(ratio, 0.9):.2f}"
        )
    priced = cheapest[judged & np.isfinite(table.min(axis=0))]
    names, counts = np.unique(priced, return_counts=True)
    for count, name in sorted(zip(counts, names, strict=True), reverse=True):
        print(f"  cheapest adequate: {name}: {count}")
    for i in np.flatnonzero(judged & ~met):
        oscillator, K_c, gap, omega, start = scenes[i]
        print(
            f"missed: error {error[i]:.2g}, {models[i]}, K_c {K_c:.3g}, gap {gap.label}, "
            f"{omega:.2f} Hz, start {start}, {oscillator}"
        )


if __name__ == "__main__":
    main()
