"""Which large symmetric gaps leave a single nonlinear feature, near 2 Hz?

The paper shows frequency responses at a large gap whose width it does not state; it says that
only superharmonics near 2 Hz are left. This scans j = 0.5 to 3 mm at soft contact with the exact
law, from rest, and prints where the response is nonlinear (contacts in steady motion, and not a
period-1 motion with two extrema) for every gap, and the gaps for which that is a single range of
frequencies around 2 Hz. The primary resonance, where a motion may touch the walls, is told apart
by its shape: two extrema per period and no jump are counted as linear.

Run it with ``python benchmarks/large_gap.py [--step 0.1]``; a minute on one core.
"""

import argparse

import numpy as np

import gapsweep as gs
from gapsweep.integrate.problem import Solver
from gapsweep.response.respond import Question, respond_all
from gapsweep.response.result import Steady
from gapsweep.response.walk import Scene

K_C = 1.4e4
GAPS = np.arange(0.5e-3, 3.01e-3, 0.1e-3)
"""Scanned distances j of both walls from the origin [m]."""
FEATURE = (1.5, 2.5)
"""A feature near 2 Hz overlaps this range [Hz]."""
JUMP = 0.2
"""Relative change of amplitude between neighbouring frequencies that is a jump."""


def features(omega: np.ndarray, gap: float) -> tuple[list[tuple[float, float]], list[float]]:
    """Ranges of frequency [Hz] with extra extrema or periods above 1, and jumps of the amplitude."""
    law = gs.Piecewise(K_c=K_C, gap=gs.Gap(gap, gap))
    scenes = [
        Question(
            scene=Scene(
                oscillator=gs.Oscillator(),
                law=law,
                omega=float(w),
                solver=Solver.of("compiled", None, None),
            ),
            start=(0.0, 0.0),
            steady=Steady(),
        )
        for w in omega
    ]
    found = respond_all(scenes)
    plain = np.array([r.period_multiple == 1 and r.n_extrema <= 2 for r in found])
    amplitude = np.array([r.amplitude for r in found])
    change = np.abs(np.diff(amplitude)) / np.maximum(amplitude[1:], amplitude[:-1])
    jumps = [float(w) for w, c in zip(omega[1:], change, strict=True) if c > JUMP]
    return ranges(omega, ~plain), jumps


def ranges(omega: np.ndarray, inside: np.ndarray) -> list[tuple[float, float]]:
    """First and last frequency of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    return [(float(omega[a]), float(omega[b - 1])) for a, b in edges.reshape(-1, 2)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--step", type=float, default=0.1, help="of the frequency [Hz]")
    omega = np.arange(0.1, 30.0 + 1e-9, parser.parse_args().step)
    for gap in GAPS:
        found, jumps = features(omega, float(gap))
        listed = ", ".join(f"{a:.1f}-{b:.1f}" for a, b in found) or "none"
        print(
            f"j = {1e3 * gap:.1f} mm: nonlinear at {listed} Hz; jumps at "
            f"{', '.join(f'{w:.1f}' for w in jumps) or 'none'}",
            flush=True,
        )


if __name__ == "__main__":
    main()
