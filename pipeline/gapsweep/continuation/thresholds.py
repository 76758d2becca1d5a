"""Thresholds of continuation, with their reasons; all in one place.

Lengths are in scaled unknowns: the size of the state is 1, and so is the range of a parameter.
"""

# --- equations ------------------------------------------------------------------------------------

# Share of a range, for derivatives by a parameter: contacts keep their order within it.
DIFFERENCE = 1e-9
# The same for derivatives of the equation of motion, which are smooth functions of the parameter.
SHIFT = 1e-5
# The same for a crossing, where rounding over it must not move the root; and steps in all unknowns
# for second derivatives there, which Newton's method needs only roughly.
CROSSING_DIFFERENCE, SECOND_DIFFERENCE = 1e-7, 1e-5
# Orbits that a user's tolerances blur by less are the same; also halves of one orbit.
ALIKE = 1e-6
# Orbits whose halves differ by more are not alike; between, rounding near a crossing decides.
UNLIKE = 1e-5
# Orbits of unforced systems start away from turning points, which come and go, by this share of
# their period.
OFF_TURNING = 0.137
# Section points that are farther apart, in periods, are one point: no oscillation is so fast.
ONE_TURN = 0.999

# --- Newton's method ------------------------------------------------------------------------------

# A step that is shorter closes an orbit: a tenth of the digits of the engine is left.
CLOSED = 1e-10
# Steps that no longer shrink close it at this share of the way that Newton's method may go.
NEARLY, SHRINKS = 1e-7, 0.3
# On short steps an orbit is computed to this share of the step, at least to rounding.
NEAR, ROUNDING = 0.01, 1e-13
# Quadratic convergence needs fewer iterations; steps that grow so much do not converge.
NEWTON_STEPS, WIDER = 10, 2.0

# --- steps ----------------------------------------------------------------------------------------

# First and longest steps: most branches take 50 to 500 orbits. Shorter steps than the shortest one
# are lost in rounding.
FIRST, SMALLEST, LARGEST = 1e-3, 1e-9, 0.03
# Steps grow where Newton's method is fast and the tangent turns little [rad].
GROWS, FEW_STEPS, SLIGHT_TURN = 2.0, 4, 0.1
# A tangent that turns by more [rad] may be that of another branch.
TURN = 0.3
# An orbit farther than this share of a step from the prediction may be on another branch.
ASIDE = 0.5
# Multipliers that change more in a step may pass the unit circle twice; well inside the circle
# nothing happens, and on steps shorter than FAST a graze makes them jump.
CHANGE, INNER, FAST = 0.4, 0.7, 1e-4
# An orbit on the way out is at the end of a range within rounding, and where steps are too small.
EDGE, NEAR_EDGE = 1e-12, 1e-6
# Distances at which the branch is searched behind a kink, and how far from there it may be.
BEHIND, ASTRAY = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3), 3.0
# Steps stop so near a kink that two which end closer to each other have met the same one.
SAME_KINK = 1e-5
# An orbit so near the chord of a step, as a share of it, lies between its ends: a tangent that
# turns by TURN leaves the chord by a twenty-fifth.
ON_CHORD = 0.1
# A closed branch has at least so many orbits.
SHORTEST_LOOP = 6
# A cycle that swings by less is near its Hopf point.
SMALL_CYCLE = 0.02
# The point is located to this share of the range, not below the rounding of the differences; its
# pair of eigenvalues has less growth than this share of its frequency. Derivatives are differences
# over this share of the size.
HOPF_LOCATED, HOPF_RATE, EQUILIBRIUM_DIFFERENCE = 1e-11, 1e-9, 1e-5

# --- special points -------------------------------------------------------------------------------

# Roots along a step are located to this share of it, and a value at its end is zero.
LOCATED = 1e-13
# A component of the tangent along a family at one parameter value is rounding.
VERTICAL = 1e-7
# A multiplier so near the value that names a point is at it: near a double multiplier, rounding of
# 1e-10 makes this.
AT_VALUE = 1e-5
# Two multipliers that meet differ by the root of their rounding, which may be 1e-8.
AT_DOUBLE = 1e-4
# A turning point this near to a wall, as a share of the largest one, is on it.
ON_WALL = 1e-7
# Without its graze, an orbit passes the wall at this part of that distance.
CLEAR_OF_WALL = 1e-3
# A turning point nearer to a rigid wall, as a share of the largest one, is an impact.
IMPACT = 1e-12
# Next to a graze of a rigid wall or a preload a multiplier is larger than the reciprocal of this.
STRONG = 0.1
# Distance from such a wall at which differences by the parameter do not pass it.
BEFORE_SHARP = 1e-6
# First steps past the graze, the longest one that works: depths have the order of their squares,
# and differences by the parameter must not undo them.
PAST_SHARP = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
# Part of the period before a graze in which the acceleration hardly changes.
EARLIER = 1e-5
# Orbits without the impact are sought so many distances of the graze around it.
ASIDE_SHARP = 100.0
# Largest residual of an orbit at a crossing, for one unit of the derivatives, and singular value
# that is zero, as a share of the next one.
RESIDUAL, SINGULAR = 1e-9, 1e-5
# Newton's method for a crossing ends at shorter steps.
CROSSING_STEP = 1e-9
# Grazes that are nearer are one: symmetric orbits touch both walls at once.
AT_ONCE = 1e-9
# Distance of a point from a graze, where the multipliers jump.
BESIDE_GRAZE = 1e-6
# Imaginary parts of real multipliers.
REAL = 1e-9
# A branch that leaves another one has at least so many orbits.
SHORTEST = 4

# --- attractors -----------------------------------------------------------------------------------

# Values of the parameter at which attractors are sought: the time of each counts.
VALUES = 8
# Settled motions that differ by less are one attractor: their tolerances are the default ones.
SETTLED_ALIKE = 1e-4
# A motion that comes back so near closes; Newton's method needs no more.
COMES_BACK = 1e-3
# Initial displacements beyond the walls, in distances of the walls; of unforced systems, whose
# equilibrium leads nowhere, also so many of the largest distance, or metres without walls.
BEYOND_WALLS, DISPLACED = 2.0, (1e-3, 0.03, 1.0, 30.0)

# --- curves of special points ---------------------------------------------------------------------

# Change of the scaled unknowns for derivatives of the condition: multipliers have errors of 1e-10.
CONDITION_DIFFERENCE = 1e-7
# Largest component of a cusp's tangent along the parameters: at a corner they do not stand still.
STANDS_STILL = 1e-4
# Residual of an orbit of the branches' model: that of another model is larger.
CLOSES = 1e-6

# --- recognition ----------------------------------------------------------------------------------

# Orbits along a branch that are compared with known branches: one may be near a fold, where
# Newton's method at a given parameter fails.
COMPARED = 5
# Newton's method for the orbit of a known branch goes no farther than this share of its step, so
# that it does not converge to the orbit that is to be recognised.
ASIDE_KNOWN = 0.5
