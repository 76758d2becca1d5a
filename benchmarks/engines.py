"""What the compiled engine costs, beside rivals, side by side in one process.

    python benchmarks/engines.py [--cpu 0] [--rounds 5] [--scenes core|periodic]

Prints, in microseconds per simulated second and sweep point at matched end error:

1. the exact law beside heyoka (SIMD batches with events) and Boost.odeint;
2. smooth laws beside the same rivals;
3. the exact law beside the smooth laws in the four corners soft/hard x symmetric/asymmetric;
4. the exact law beside the reference engine at the paper's tolerances.

Settings of all contenders are run in turn, round by round; the minimum of the rounds counts,
of each contender the cheapest tolerance that meets the target. Rivals that are not installed
are left out and said so.
"""

import argparse
import math
import os
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "peers"))

import gapsweep_peer
from gapsweep_peer import Gapsweep
from scenes import CORE, CORNERS, OSCILLATOR, PERIODIC

import gapsweep as gs

TARGETS = (1e-3, 1e-6, 1e-9)


def rivals(form):
    """(contender, tolerances) of the installed rivals."""
    found = []
    try:
        import heyoka
        import heyoka_peer
    except ImportError:
        print("heyoka is not installed: left out\n")
    else:
        width = heyoka.recommended_simd_size()
        found += [(heyoka_peer.Heyoka(form, n), heyoka_peer.TOLERANCES) for n in (width, 4 * width)]
    try:
        import odeint_peer

        found.append((odeint_peer.Odeint(form), odeint_peer.TOLERANCES))
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"Boost.odeint cannot be built ({type(error).__name__}): left out\n")
    return found


def ours(form, *widths, **options):
    return [(Gapsweep(form, n, **options), gapsweep_peer.TOLERANCES) for n in widths]


def measured(contenders, form, scenes, rounds):
    """``{(contender, scene, tolerance): (microseconds, error)}``, minima over the rounds."""
    best = {}
    for _ in range(rounds):
        for contender, tolerances in contenders:
            for tolerance in tolerances:
                for scene in scenes:
                    key = contender.name, scene.name, tolerance
                    if key not in best:
                        contender.run(scene, tolerance)  # compile, warm up
                    begin = time.process_time()
                    x, v = contender.run(scene, tolerance)
                    seconds = time.process_time() - begin
                    cost = 1e6 * seconds / contender.width / scene.t_end
                    error = scene.error(form, x[0], v[0])
                    best[key] = min(cost, best.get(key, (math.inf,))[0]), error
    return best


def cheapest(best, name, scene, target):
    """Cost of a contender's cheapest setting that meets a target; NaN if none does."""
    costs = [
        cost for (n, s, _), (cost, error) in best.items()
        if n == name and s == scene.name and error <= target
    ]  # fmt: skip
    return min(costs, default=math.nan)


def geometric_mean(values):
    return math.exp(sum(map(math.log, values)) / len(values))


def print_table(title, best, scenes, ratio=None):
    """Costs at the targets; `ratio` names a numerator and denominator by their prefixes."""
    names = list(dict.fromkeys(name for name, _, _ in best))
    print(f"## {title}\n")
    print("| scene | end error | " + " | ".join(names) + (" | ratio |" if ratio else " |"))
    print("|---" * (len(names) + 2 + bool(ratio)) + "|")
    for target in TARGETS:
        rows = []
        for scene in scenes:
            row = [cheapest(best, name, scene, target) for name in names]
            rows.append(row + ([quotient(row, names, ratio)] if ratio else []))
            print_row(scene.name, target, rows[-1])
        means = [geometric_mean(column) for column in zip(*rows, strict=True)]
        print_row("**geometric mean**", target, means)
    print()


def quotient(row, names, ratio):
    """Cheapest rival over our cheapest."""
    rival, own = (
        min((c for c, n in zip(row, names, strict=True) if n.startswith(p) and c == c))
        for p in ratio
    )
    return rival / own


def print_row(name, target, costs):
    cells = (f"{c:.2f}" if c == c else "-" for c in costs)
    print(f"| {name} | {target:.0e} | " + " | ".join(cells) + " |")


def against_reference(rounds):
    """Processor time of the reference engine over ours, at equal or smaller error."""
    print("## Exact law: reference engine at rtol 1e-4, atol 1e-7 over ours\n")
    print("| scene | scipy ms | scipy error | ours ms | our error | ratio |")
    print("|---|---|---|---|---|---|")
    ratios = []
    for scene in CORNERS:
        law = gs.Piecewise(scene.K_c, scene.gap)
        scipy_ms, scipy_error = scipy_cost(law, scene, rounds)
        best = measured(ours("piecewise", 64), "piecewise", [scene], rounds)
        cost, error = min((c, e) for c, e in best.values() if e <= scipy_error)
        ratios.append(scipy_ms / (1e-3 * cost * scene.t_end))
        print(f"| {scene.name} | {scipy_ms:.0f} | {scipy_error:.1e} | "
              f"{1e-3 * cost * scene.t_end:.3f} | {error:.1e} | {ratios[-1]:.0f} |")  # fmt: skip
    print(f"\nmedian ratio {sorted(ratios)[1]:.0f} to {sorted(ratios)[2]:.0f}\n")


def scipy_cost(law, scene, rounds):
    times = []
    for _ in range(min(rounds, 3)):
        begin = time.process_time()
        run = gs.simulate(
            OSCILLATOR, law, scene.omega, t_end=scene.t_end, engine="scipy", rtol=1e-4, atol=1e-7
        )
        times.append(time.process_time() - begin)
    return 1e3 * min(times), scene.error("piecewise", run.x_end, run.v_end)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cpu", type=int, help="pin to this core")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scenes", choices=["core", "periodic"], default="core")
    arguments = parser.parse_args()
    if arguments.cpu is not None:
        os.sched_setaffinity(0, {arguments.cpu})
    scenes = CORE if arguments.scenes == "core" else PERIODIC
    rounds = arguments.rounds

    contenders = ours("piecewise", 64) + ours("piecewise", 16, 64, sampled=True)
    best = measured(contenders + rivals("piecewise"), "piecewise", scenes, rounds)
    print_table("Exact law, contacts located", best, scenes, ("heyoka", "gapsweep"))
    for form in ("tanh:1e4", "tanh:1e6"):
        # Plain Taylor steps jump over the thin layer: heyoka would be wrong, not slow.
        peers = rivals(form) if form == "tanh:1e4" else rivals(form)[-1:]
        best = measured(ours(form, 64) + peers, form, scenes, rounds)
        print_table(f"Smooth law {form}", best, scenes)
    corners = {}
    for form in ("piecewise", "tanh:1e4", "tanh:1e6"):
        for (_, scene, rtol), value in measured(ours(form, 64), form, CORNERS, rounds).items():
            corners[form, scene, rtol] = value
    print_table("Exact law beside smooth laws, 64 points", corners, CORNERS)
    against_reference(rounds)


if __name__ == "__main__":
    main()
