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
VELOCITY_SCALE = (
    19  # [s]: in the gap, |v| * VELOCITY_SCALE is the displacement a velocity swings to
)
FLOOR = 20  # absolute part of the step's tolerance [m]
RATE = 21  # fastest angular frequency of the linear parts [rad/s]
END_CYCLE, END_TAU = 22, 23
RECORD_CLOCK = 24  # recording is on from this clock (whole periods + fraction) on
# counters
N_STEPS, N_CONTACTS, N_SHORT = 25, 26, 27
# the last step: its length, wall it ended on (+1 upper, -1 lower, 0 none), and where it began
STEP, SIDE, TAU_0, CYCLE_0, MODE_0 = 28, 29, 30, 31, 32
TAU_START, T_START = 33, 34  # phase and time [s] of the point's own start
CONTACT_SCALE = 35  # [s]: as VELOCITY_SCALE, for the depth that a velocity reaches in contact
MIN_STEP = 36  # [s]: a shorter step, unless it ends on a wall or at the end, is an underflow
# what the recording of the last step found: when the step began [s], zero of the velocity, and
# state at the whole period within it
START_TIME, TURN_TIME, TURN_X, SECTION_TIME, SECTION_X, SECTION_V = range(37, 43)
N_ROWS = 43
