"""Which large symmetric gaps leave a single nonlinear feature, near 2 Hz?

The paper shows frequency responses at a large gap whose width is not in the text we have, and says
that nothing but superharmonics near 2 Hz is nonlinear there. This scans j = 0.5 to 3 mm at soft
contact with the exact law, from rest, and prints where a response has more than two extrema or a
period above 1, and at which frequencies below the primary resonance it touches a wall. A gap fits
if

* above 1 Hz there is one such range, and it reaches 2 Hz (below 1 Hz the superharmonics of higher
  order are too small to be seen in a figure);
* walls are touched in it: otherwise all laws are the plain Duffing oscillator there.

``python benchmarks/large_gap.py``: a minute on one core. Result: docs/decisions/0008-claims.md.
"""

import numpy as np

import gapsweep as gs
from gapsweep.integrate.problem import Solver
from gapsweep.response.respond import respond_all
from gapsweep.response.result import Steady
from gapsweep.response.scene import Scene

K_C = 1.4e4
GAPS = np.round(np.arange(0.5, 3.01, 0.1), 1)
"""Scanned distances j of both walls from the origin [mm]."""
OMEGA = np.arange(0.1, 30.0 + 1e-9, 0.1)
LOWEST, FEATURE, PRIMARY = 1.0, 2.0, 5.0
"""Frequencies [Hz]: what is below the first is left out; a feature reaches the second."""


def scan(gap: float) -> tuple[list[tuple[float, float]], list[float]]:
    """Nonlinear ranges and the frequencies of contact below the primary resonance [Hz]."""
    law = gs.Piecewise(K_c=K_C, gap=gs.Gap(1e-3 * gap, 1e-3 * gap))
    solver = Solver.of("compiled", None, None)
    scenes = [
        Scene(oscillator=gs.systems.paper_oscillator(), law=law, omega=w, solver=solver)
        for w in OMEGA.tolist()
    ]
    found = respond_all(scenes, (0.0, 0.0), Steady()).rows()
    nonlinear = np.array([r.period_multiple != 1 or r.n_extrema > 2 for r in found])
    touching = np.array([max(r.x_max, -r.x_min) > 1e-3 * gap for r in found])
    low = (OMEGA >= LOWEST) & (OMEGA < PRIMARY)
    return ranges(nonlinear & (OMEGA >= LOWEST)), OMEGA[touching & low].tolist()


def ranges(inside: np.ndarray) -> list[tuple[float, float]]:
    """First and last frequency of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    return [(float(OMEGA[a]), float(OMEGA[b - 1])) for a, b in edges.reshape(-1, 2)]


def main() -> None:
    fitting = []
    for gap in GAPS.tolist():
        found, contacts = scan(gap)
        fits = len(found) == 1 and found[0][0] <= FEATURE <= found[0][1]
        fits = fits and any(found[0][0] <= w <= found[0][1] for w in contacts)
        fitting += [gap] if fits else []
        listed = ", ".join(f"{a:.1f}-{b:.1f}" for a, b in found)
        touched = f"{min(contacts):.1f}-{max(contacts):.1f} Hz" if contacts else "nowhere"
        print(f"j = {gap:.1f} mm: nonlinear at {listed} Hz; contact below {PRIMARY:g} Hz: {touched}"
              f"{'; fits' if fits else ''}", flush=True)  # fmt: skip
    print(f"fitting: {min(fitting)} to {max(fitting)} mm" if fitting else "none fits")


if __name__ == "__main__":
    main()
