"""States of the points of a search, and what is known of their motions."""

from enum import IntEnum, auto

import numpy as np
from numpy.typing import NDArray


class State(IntEnum):
    """What a point waits for, or its class.

    First motions to integrate, then decisions in the order in which they follow each other, then
    classes: those after `EQUILIBRIUM` are unresolved or failed, each for a reason.
    """

    RECORD = 0
    APPROACH = auto()
    LAST_TRANSIENT = auto()
    SHOOT = auto()
    SHOOT_REPEAT = auto()
    SHOOT_NOISY = auto()
    CONFIRM = auto()
    LYAPUNOV = auto()
    LAST_WINDOW = auto()
    TORUS_TEST = auto()
    APPROACHED = auto()
    PERIOD_TEST = auto()
    ORBIT_FOUND = auto()
    NO_ORBIT = auto()
    BASIN_CHECK = auto()
    NO_REPEAT = auto()
    REPEAT_TEST = auto()
    NEXT_WINDOW = auto()
    TIME_OVER = auto()
    EXPONENT_TEST = auto()
    SIGN_TEST = auto()
    CHAOS_TEST = auto()
    STOPPED = auto()
    PERIODIC = auto()
    CHAOTIC = auto()
    QUASIPERIODIC = auto()
    EQUILIBRIUM = auto()
    UNSTABLE_REST = auto()
    NO_RETURN = auto()  # never came back to its Poincare section
    UNRESOLVED = auto()
    LOCKED = auto()  # repeats itself, after more periods than are looked for
    GROWING = auto()  # goes farther than it ever was, with no forcing
    UNCONFIRMED = auto()  # an orbit of the solver, at tighter tolerances unstable or gone
    NOISY = auto()  # swings by little more than solver errors
    HIDDEN = auto()  # a contact moves too little to be told from errors of the rest
    FAILED = auto()


class Classification:
    """States of n points, and numbers that belong to some of them.

    Attributes
    ----------
    state : ndarray of int, shape (n,)
        `State` values.
    lyapunov, lyapunov_error : ndarray, shape (n,)
        Largest Lyapunov exponent [1/s] and its standard error, where it was measured.
    offset : ndarray, shape (n,)
        Distances [m] of motions at rest from their equilibria.
    """

    def __init__(self, n: int) -> None:
        self.state = np.full(n, int(State.RECORD))
        self.lyapunov, self.lyapunov_error, self.offset = np.full((3, n), np.nan)

    @property
    def is_periodic(self) -> NDArray[np.bool_]:
        """Which points have a periodic orbit."""
        return np.asarray(self.state == int(State.PERIODIC))

    @property
    def has_orbit(self) -> NDArray[np.bool_]:
        """Which points have a periodic orbit, confirmed or not."""
        return np.asarray(self.is_periodic | (self.state == int(State.UNCONFIRMED)))

    @property
    def is_classified(self) -> NDArray[np.bool_]:
        """Which points have a class of steady response."""
        return (self.state >= int(State.PERIODIC)) & (self.state <= int(State.EQUILIBRIUM))

    @property
    def has_stopped(self) -> NDArray[np.bool_]:
        """Which points have come to rest, or never come back to their section."""
        return (self.state >= int(State.EQUILIBRIUM)) & (self.state <= int(State.NO_RETURN))
