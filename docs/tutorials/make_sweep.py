"""Write measured_sweep.csv: a simulated measurement of the tutorial "Identify a gap from a sweep".

A machine of 3 kg on a spring of 5 Hz (damping ratio .03, 2 N) between walls at 0.4 mm of 14,000 N/m
is swept up and down over 56 frequencies. Normal noise of 0.01 mm (seed 1) is added.
"""

from pathlib import Path

import numpy as np

import gapsweep as gs

MACHINE = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.03, forcing=2.0)
LAW = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
NOISE, SEED = 0.01e-3, 1


def main() -> None:
    """Simulate both sweeps, each point from the end state of the one before."""
    random = np.random.default_rng(SEED)
    lines = ["frequency [Hz], amplitude [mm], sweep"]
    frequencies = np.linspace(4.0, 15.0, 56)
    for direction, order in (("up", frequencies), ("down", frequencies[::-1])):
        x = v = 0.0
        for omega in order:
            found = gs.respond(MACHINE, LAW, omega=omega, x_0=x, v_0=v)
            x, v = found.x_end, found.v_end
            amplitude = found.amplitude + NOISE * random.normal()
            lines.append(f"{omega:.2f}, {1e3 * amplitude:.4f}, {direction}")
    (Path(__file__).parent / "measured_sweep.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
