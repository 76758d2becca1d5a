"""Layout of the lane-major arrays that the stepping code shares.

``lanes`` has shape (N_ROWS, WIDTH): one row per quantity, one column per lane, so that a row is
one vector load. Clocks count forcing periods: a time is the pair (whole periods since the start
of the point's first period, fraction of a period in [0, 1)). The fraction *is* the forcing
phase, hence time and phase cannot drift apart however long the run.
"""

# Lanes that advance together. A multiple of every vector length in use (2, 4, 8 doubles); the
# compiler cuts the wide values into registers, whose independent chains hide each other's
# latency. At most 16: four masks of `WIDTH` bits are packed into one 64-bit answer.
WIDTH = 16
ALL_LANES = (1 << WIDTH) - 1  # as a mask

# state
X, V, TAU, CYCLE, MODE = range(5)
# tangent solutions: rows TANGENT + 0, 1 are the image of a unit displacement, + 2, 3 of a unit
# velocity
TANGENT = 5
# equation, per unit mass:
# x'' = PUSH cos(2 pi TAU) - DAMPING x' - STIFFNESS x - CUBIC x^3 - CONTACT (x - wall)
STIFFNESS, DAMPING, CUBIC, PUSH, CONTACT = range(9, 14)
LOWER, UPPER = 14, 15  # positions of the walls, -j_1 and j_2 [m]
OMEGA, OMEGA_RAD, PERIOD = 16, 17, 18
FLOOR = 19  # absolute part of the step's tolerance [m/s]
RATE = 20  # fastest angular frequency of the linear parts [rad/s]
END_CYCLE, END_TAU = 21, 22
# section points are recorded from this clock (whole periods + fraction) on, all events from another
RECORD_CLOCK = 23
# counters
N_STEPS, N_CONTACTS, N_SHORT = 24, 25, 26
# the last step: its length, wall it ended on (+1 upper, -1 lower, 0 none), and where it began
STEP, SIDE, TAU_0, CYCLE_0, MODE_0 = 27, 28, 29, 30, 31
TAU_START, T_START = 32, 33  # phase and time [s] of the point's own start
MIN_STEP = 34  # [s]: a shorter step, unless it ends on a wall or at the end, is an underflow
# what the recording of the last step found: when the step began [s], zero of the velocity, and
# state at the whole period within it
START_TIME, TURN_TIME, TURN_X, SECTION_TIME, SECTION_X, SECTION_V = range(35, 41)
EVENT_CLOCK = 41
REACH = 42  # largest |x| at the ends of steps [m]
N_ROWS = 43
