"""Rows of the parameter block of a contact, shape (N_PARAMETERS, WIDTH), and their meaning."""

# Rows of the parameter block.
STIFFNESS = 0  # K_c / m of the upper wall [1/s^2]; 1 / m for a fit or a user's law
WALL_LOW, WALL_HIGH = 1, 2  # -j_1 and j_2 [m]
SHARPNESS = 3  # epsilon or gamma [1/m]
CENTRE, HALF_GAP, DECAY = 4, 5, 6  # tanh: of the gap [m, m, -]; tables: centre of the range
OFFSET = 4  # log-arctan: A_c [m]
# Located contact: stiffness and wall of the present mode.
ACTIVE_STIFFNESS, ACTIVE_WALL = 3, 4
OWN = 3  # a user's law: its named numbers, up to the next row
LAYER = 7  # half-width of the smoothing layer around each wall [m]; 0: none
RANGE = 8  # fits and tables: half of the range in which they hold [m]; 0: no range
SATURATION = 9  # tanh: distance from a wall beyond which the law is exactly piecewise [m]
RATIO = 10  # stiffness of the lower wall over that of the upper
N_PARAMETERS = 11

# |epsilon (x - j)| from which tanh is +-1 in double precision, so the force exactly piecewise.
TANH_SATURATION = 19.0625
# arctan only decays like 1/z and never saturates: nothing may be skipped. Within 4 units of the
# wall it turns by 84 %; outside that the remaining curvature is on the scale of the distance
# itself, which the error estimate sees.
ARCTAN_LAYER = 4.0
