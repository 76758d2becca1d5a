"""Tables of studies, and labels of contact laws, that several files of tests use."""

import json
from copy import deepcopy
from typing import Any

from gapsweep.model.laws import LAWS

PAPER = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0, "alpha": 7e8}
TOML = "{ mass = 3.0, omega_n = 5.0, zeta = 0.03, forcing = 4.0, alpha = 7e8 }"

# One law of every family, and both exact ones.
LABELS = tuple(example for law in LAWS for example in law.examples)

# Two masses between walls, forced, and the wing section of `gapsweep.systems` at several speeds.
TWO_MASSES = {
    "study": {"name": "masses"},
    "system": {
        "mass": [[1.0, 0.0], [0.0, 2.0]],
        "stiffness": [[30.0, -10.0], [-10.0, 20.0]],
        "damping": [[0.3, -0.1], [-0.1, 0.2]],
        "contacts": {"stop": [1.0, 0.0], "between": [1.0, -1.0]},
        "forcing": [{"amplitude": [1.0, 0.0]}],
    },
    "contact": {"between": {"K_c": 50.0, "gap": [0.5, 0.4], "K_ratio": 2.0}},
    "sweep": [
        {
            "representation": "piecewise",
            "K_c": [10.0, 100.0],
            "gap": [0.1, 0.2],
            "omega": [0.3, 0.5],
            "initial_condition": [[0.1, 0.2, 0.3, 0.4], [0.0, 0.0, 0.0, 0.0]],
        }
    ],
}
SECTION = {
    "study": {"name": "section"},
    "system": {"function": "typical_section"},
    "parameters": {"speed": 12.0, "density": 1.2},
    "sweep": [
        {"representation": "piecewise", "K_c": 3.9, "gap": [0.03, 0.03], "speed": [8.0, 10.0]}
    ],
}


def study_text(representation, omega, *, name="tiny", sweep="", more=""):
    """A study file of the paper's machine at one contact, with fast settings.

    Parameters
    ----------
    representation : str or list of str
    omega, sweep, more : str
        TOML of the frequencies [Hz], further lines of the sweep, and further tables.
    """
    return f"""
oscillator = {TOML}
[study]
name = "{name}"
[[sweep]]
representation = {json.dumps(representation)}
K_c = [1.4e4]
gap = [[0.4e-3, 0.4e-3]]
omega = {omega}
{sweep}
{more}
[steady]
settle_tol = 1e-2
n_periods = 16
max_period_multiple = 8
"""


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


def changed(tables, **changes):
    """Tables with keys, as ``sweep__0__omega``, set to values; None takes them away."""
    found = deepcopy(tables)
    for path, value in changes.items():
        *parents, last = (int(key) if key.isdigit() else key for key in path.split("__"))
        table = found
        for key in parents:
            table = table.setdefault(key, {}) if isinstance(table, dict) else table[key]
        if value is None:
            del table[last]
        else:
            table[last] = value
    return found
