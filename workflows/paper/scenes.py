"""Words of the paper: its stiffnesses, gaps and grades of laws, by the names that datasets have."""

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

# Initial conditions [m, m/s]: Table 1 states rest, the figures agree with +0.4 mm (docs/claims.md).
REST, RELEASED = "rest", "+0.4 mm"
STARTS = {REST: (0.0, 0.0), RELEASED: (4e-4, 0.0)}


def width(case: Case) -> float:
    """Width of a gap [m]."""
    return 1e-3 * sum(float(j) for j in case[1].split("/"))
