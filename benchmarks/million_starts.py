"""Basins of a million starts, as a study and through `gapsweep.basins`, on two workers.

    python benchmarks/million_starts.py FOLDER [N]

Starts are a grid of N x N, 1000 by default, over displacements and velocities of one scene with
several attractors. Both ways must agree start by start; `basins.png` in FOLDER shows them. Three
minutes and 2 GB for a million.
"""

import resource
import sys
import time
from pathlib import Path

import numpy as np

import gapsweep as gs
from gapsweep.execution.cluster import cluster
from gapsweep.study.points import canonical

OMEGA, K_C, GAP = 6.5, 1.4e5, (0.4e-3, 0.4e-3)
BOX_X, BOX_V = (-6e-3, 6e-3), (-0.4, 0.4)


def study(n: int) -> gs.Study:
    starts = {"grid": [n, n], "x": list(BOX_X), "v": list(BOX_V)}
    sweep = {
        "representation": "piecewise",
        "K_c": K_C,
        "gap": list(GAP),
        "omega": OMEGA,
        "initial_condition": starts,
    }
    return gs.Study.from_dict(
        {
            "study": {"name": "starts"},
            "solver": {"rtol": 1e-9},
            "oscillator": {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0, "alpha": 7e8},
            "sweep": [sweep],
        }
    )


def peak_mb() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main(folder: Path, n: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with cluster(2) as client:
        begin = time.time()
        stored = gs.run(study(n), client, out=folder / "out", cache=folder / "cache")
        print(f"study: {time.time() - begin:.0f} s, client {peak_mb():.0f} MB")
        begin = time.time()
        x, v = (np.array([canonical(value) for value in axis]) for axis in axes(n))
        law = gs.Piecewise(K_C, gs.Gap(*GAP))
        found = gs.basins(
            gs.systems.paper_oscillator(), law, OMEGA, x=x, v=v, rtol=1e-9, client=client
        )
        print(f"basins: {time.time() - begin:.0f} s, client {peak_mb():.0f} MB")
    with stored:
        ids = stored["attractor"].values.reshape(n, n)
        stored.gapsweep.map("attractor", x="x_0", y="v_0").figure.savefig(folder / "basins.png")
    differing = int(np.sum(ids != found["attractor"].values))
    shares = ", ".join(f"{share:.4f}" for share in found["basin_share"].values)
    print(
        f"{found.sizes['attractor_number']} attractors, shares {shares}; {differing} starts differ"
    )


def axes(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.linspace(*BOX_X, n), np.linspace(*BOX_V, n)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if sys.argv[2:] else 1000)
