"""Words of the paper: its stiffnesses, gaps and grades of laws, by the names that datasets have."""

import math

EXACT = "piecewise"
NO_EVENTS = "piecewise-noevents"
TANGENTS = ("tanh", "arctan", "logarctan")
WEAK = ("poly-13", "ratpoly-5/3", *(f"{family}-1e4" for family in TANGENTS))
STRONG = ("poly-21", "ratpoly-5/5", *(f"{family}-1e6" for family in TANGENTS))

VERY_SOFT, SOFT, HARD = 1.4e3, 1.4e4, 1.4e6  # contact stiffness [N/m]
SYMMETRIC, ASYMMETRIC, LARGE = "0.4/0.4", "0/0.8", "1.5/1.5"  # gaps [mm]
# Between these ends the words on Fig. 6a can be true: docs/decisions/0008-claims.md.
LARGE_ENDS = ("1.1/1.1", "1.8/1.8")

Case = tuple[float, str]  # contact stiffness [N/m] and gap [mm]
SOFT_SYMMETRIC, SOFT_ASYMMETRIC = (SOFT, SYMMETRIC), (SOFT, ASYMMETRIC)
HARD_SYMMETRIC, HARD_ASYMMETRIC = (HARD, SYMMETRIC), (HARD, ASYMMETRIC)
VERY_SOFT_SYMMETRIC, SOFT_LARGE = (VERY_SOFT, SYMMETRIC), (SOFT, LARGE)
SPRING = 3.0 * (2.0 * math.pi * 5.0) ** 2  # N/m, the oscillator's

# The paper's Table 2, in seconds: the exact law, then the laws of the grade.
TABLE_2 = {
    "weak": dict(zip((EXACT, *WEAK), (48.69, 18.57, 26.49, 7.66, 7.41, 7.29), strict=True)),
    "strong": dict(zip((EXACT, *STRONG), (117.7, 65.69, 132.9, 18.57, 18.08, 18.49), strict=True)),
}
TABLE_CASES = {"weak": SOFT_SYMMETRIC, "strong": HARD_SYMMETRIC}

# Initial conditions [m, m/s]: Table 1 states rest, the figures agree with +0.4 mm (the page
# docs/explanation/claims.md).
REST, RELEASED = "rest", "+0.4 mm"
STARTS = {REST: (0.0, 0.0), RELEASED: (4e-4, 0.0)}


def width(case: Case) -> float:
    """Width of a gap [m]."""
    return 1e-3 * sum(float(j) for j in case[1].split("/"))
