"""Thresholds of the search for steady responses, with their reasons.

Distances are shares of a motion's reach: of the largest displacement in its recording window, as a
section point. Times are in periods: forcing periods, or returns to a Poincare section.
"""

# --- time -----------------------------------------------------------------------------------------

# A window follows each time that damping has left this share of a disturbance.
TRANSIENT_SHARE = 0.25
# The first window is short: five points show a contraction to period one.
FIRST_WINDOW = 5
# With a solver that scatters section points, a window is tested after each of so many parts.
WINDOW_PARTS = 4
# No motion is integrated for more periods, whatever its damping.
MOST_PERIODS = 1e7
# A motion that contracts more slowly than damping (preloaded against a wall) is integrated for at
# most so many more periods, with so many windows.
MOST_EXTENSION, EXTENSION_WINDOWS = 1e5, 8

# --- sections -------------------------------------------------------------------------------------

# Multiple of the predicted scatter within which two points are the same.
DEVIATIONS = 4.0
# A section that repeats itself to this share is periodic, or about an orbit that it leaves slowly.
ALIKE = 1e-3
# Shooting is worth a try when section points repeat within this share.
CLOSE = 0.1
# Points in which a motion that is near a repeat must not have moved away.
CONTRACTION_POINTS = 16
# Multiple of the best: repeats, means and closures that differ by less differ by chance.
AS_GOOD = 5.0
# A solver that does not locate kinks scatters so many times the predicted noise.
KINK_SCATTER = 10.0

# --- orbits ---------------------------------------------------------------------------------------

# Newton may move this share; farther away it converges to any orbit.
NEWTON_RANGE = 0.2
NEWTON_STEPS = 6
# Share of the reach to which an orbit is computed, unless the solver's noise is larger.
NEWTON_GOAL = 1e-10
# A map that stretches by more is near no orbit that attracts: most shots of chaotic motions.
STRETCHED = 2.0
# Steps that shorten by no more than this are the solver's noise, if they are as short as this share
# of the range.
SHORTENED, SHORT_STEP = 0.5, 0.05
# Points of an orbit that are nearer than this share are one point, twice.
SAME_POINT = 1e-6
# A part of an orbit closes so much better than the parts are alike; no better than rounding, as a
# share of the largest component, lets it.
PART_CLOSES, ROUNDING = 0.1, 1e-10
# Least contraction of an orbit, so that noise does not pass for one about an equilibrium.
LEAST_CONTRACTION = 1e-3
# A multiplier this close to the unit circle belongs to a bifurcation.
STABLE = 1.0 - 1e-6
# Distance from one to which the multipliers of undamped orbits are computed.
ON_CIRCLE = 1e-6
# Basin check: the motion must come within this share of the orbit, and closer by this factor.
NEAR, CLOSER = 1e-2, 0.5
# If a window shrinks disturbances by less, a single point near the orbit proves nothing: a torus
# may pass the orbit as near, again and again.
SLOW = 0.5
# A response with an amplitude below so many times its expected numerical noise is unresolved.
NOISY = 10.0
# A motion with an amplitude below this share of its largest amplitude is at rest.
REST = 1e-8

# --- exponents ------------------------------------------------------------------------------------

# Standard errors beyond which an exponent is not zero. With ten batches, random errors
# exceed three once in 130 times, six once in ten thousand.
SURE, BEYOND_DOUBT = 3.0, 6.0
# Decay times in a batch: the results of successive batches are then independent.
BATCH = 2.82
# The first measurement lasts at least this share of the time that was spent on windows.
EXPONENT_SHARE = 0.25
# An undecided measurement is doubled up to so many times its first length, for a third of its
# error, and to so many periods, in which chaos outgrows the linear growth on a torus.
LONGEST_EXPONENT, EXPONENT_PERIODS = 8, 8192

# --- tori and growth ------------------------------------------------------------------------------

# A repeating section of more than two states must still repeat so many periods later: a torus that
# comes near itself within the noise has moved on by then.
PERSISTENCE = 1 << 10
# A motion that exceeds its largest displacement by this factor, twice, grows without bound.
FARTHER = 1.1


def _halves(shortest: int, longest: int) -> dict[int, float]:
    """Allowed difference of means by window length n: n**-0.5 is chaos, a torus has less."""
    return {n: n**-1.25 for n in (shortest << k for k in range((longest // shortest).bit_length()))}


# Windows of a torus test in periods, each twice the one before, and allowed difference of the means
# of their halves as a share of the scatter: if the exponent is zero (only a drift has to be
# excluded), if it is undecided after a long measurement, and if it was not measured long.
ZERO_WINDOWS = {1 << k: 1e-3 for k in range(12, 17)}
LONG_WINDOWS, SHORT_WINDOWS = _halves(1 << 13, 1 << 16), _halves(1 << 10, 1 << 13)
