"""The problem that all contenders solve: scenes from rest, and how an error is measured.

`truth.json` holds the end states, made by an 80-bit Taylor method at tolerance 1e-19 and
confirmed by scipy's DOP853 with restarts and by a 40-digit decimal Taylor method.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import gapsweep as gs

OSCILLATOR = gs.systems.paper_oscillator()
TRUTH = json.loads((Path(__file__).parent / "truth.json").read_text())
N_GRID = 65


@dataclass(frozen=True)
class Scene:
    """One contact stiffness, gap and frequency; the motion starts at rest."""

    name: str
    K_c: float
    j_1: float
    j_2: float
    omega: float
    t_end: float = 20.0

    @property
    def gap(self):
        return gs.Gap(self.j_1, self.j_2)

    @property
    def grid(self):
        """Output times [s]: the last forcing period."""
        return np.linspace(self.t_end - 1.0 / self.omega, self.t_end, N_GRID)

    def frequencies(self, n):
        """The scene's frequency and its near neighbours, one per lane [Hz]."""
        return self.omega * (1.0 + 1e-4 * np.arange(n))

    def error(self, form, x, v):
        """End error of the scene itself, relative to its amplitude."""
        truth = TRUTH[form][self.name]
        distance = max(abs(x - truth["x_T"]), abs(v - truth["v_T"]) / OSCILLATOR.omega_n_rad)
        return distance / truth["amplitude"]


SOFT, HARD, VERY_SOFT = 1.4e4, 1.4e6, 1.4e3
CORE = (
    Scene("soft_asym_f6", SOFT, 0.0, 0.8e-3, 6.0),
    Scene("hard_sym_f12", HARD, 0.4e-3, 0.4e-3, 12.0),
    Scene("vsoft_sym_f1", VERY_SOFT, 0.4e-3, 0.4e-3, 1.0),
)
PERIODIC = (
    *CORE,
    Scene("soft_sym_f2", SOFT, 0.4e-3, 0.4e-3, 2.0),
    Scene("soft_sym_f10", SOFT, 0.4e-3, 0.4e-3, 10.0),
    Scene("soft_asym_f20", SOFT, 0.0, 0.8e-3, 20.0),
    Scene("hard_sym_f9", HARD, 0.4e-3, 0.4e-3, 9.0),
    Scene("hard_asym_f12", HARD, 0.0, 0.8e-3, 12.0),
    Scene("vsoft_asym_f30", VERY_SOFT, 0.0, 0.8e-3, 30.0),
)
# soft and hard, symmetric and asymmetric
CORNERS = (
    Scene("soft_sym_f10", SOFT, 0.4e-3, 0.4e-3, 10.0),
    Scene("soft_asym_f6", SOFT, 0.0, 0.8e-3, 6.0),
    Scene("hard_sym_f12", HARD, 0.4e-3, 0.4e-3, 12.0),
    Scene("hard_asym_f12", HARD, 0.0, 0.8e-3, 12.0),
)
