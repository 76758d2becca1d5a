"""The paper's machine, a small study and labels of contact laws that many tests go through."""

from typing import Any

from gapsweep.model.laws import LAWS

PAPER = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0, "alpha": 7e8}
TOML = "{ mass = 3.0, omega_n = 5.0, zeta = 0.03, forcing = 4.0, alpha = 7e8 }"

# One law of every family, and both exact ones.
LABELS = tuple(example for law in LAWS for example in law.examples)


def small_study() -> dict[str, Any]:
    """Tables of a study of three representations at three frequencies, with fast settings."""
    return {
        "study": {"name": "small"},
        "oscillator": PAPER,
        "sweep": [
            {
                "representation": ["piecewise", "tanh-1e4", "poly-13"],
                "K_c": [1.4e4],
                "gap": [[0.4e-3, 0.4e-3]],
                "omega": [7.0, 12.0, 20.0],
            }
        ],
        "steady": {"settle_tol": 1e-2, "n_periods": 16, "max_period_multiple": 8},
    }
