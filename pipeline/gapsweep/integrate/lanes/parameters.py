"""Rows of the parameter block of a contact, shape (N_PARAMETERS, WIDTH), and their meaning."""

# Rows of the parameter block.
STIFFNESS = 0  # K_c / m of the upper wall [1/s^2]; 1 / m for a fit or a user's law
WALL_LOW, WALL_HIGH = 1, 2  # -j_1 and j_2 [m]
OWN = 3  # numbers of one law only, up to the next row: arguments of its formulas, or of a user law
CENTRE = 4  # tables: centre of the range [m]
# Located contact: stiffness and wall of the present mode.
ACTIVE_STIFFNESS, ACTIVE_WALL = 3, 4
# A user's function of displacement and velocity: interval of the gap that the mode allows [m].
ACTIVE_LOW, ACTIVE_HIGH = 8, 9
LAYER = 7  # half-width of the smoothing layer around each wall [m]; 0: none
RANGE = 8  # fits and tables: half of the range in which they hold [m]; 0: no range
SATURATION = 9  # tanh: distance from a wall beyond which the law is exactly piecewise [m]
RATIO = 10  # stiffness of the lower wall over that of the upper
N_PARAMETERS = 11
