"""Labels of laws that many tests go through: one of every family, and both exact ones."""

LABELS = (
    "piecewise",
    "piecewise-noevents",
    "poly-13",
    "ratpoly-5/3",
    "tanh-1e4",
    "arctan-1e4",
    "logarctan-1e4",
)
