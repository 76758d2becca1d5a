"""States of the points of a search, and their exponents."""

from enum import IntEnum, auto

import numpy as np
from numpy.typing import NDArray


class State(IntEnum):
    """State of a point in the search: the next action for it, or its class.

    First integrations, then decisions in the order in which they follow each other, then classes:
    those after `EQUILIBRIUM` are unresolved or failed, each for a different reason.
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
    NO_RETURN = auto()  # never returned to its Poincaré section
    UNRESOLVED = auto()
    LOCKED = auto()  # repeats after more periods than max_period_multiple
    GROWING = auto()  # the displacement grew until the end
    UNCONFIRMED = auto()  # an orbit that at tighter tolerances is unstable or does not exist
    NOISY = auto()  # the amplitude is little larger than solver errors
    HIDDEN = auto()  # a contact moves less than solver errors of the other coordinates
    FAILED = auto()


class Classification:
    """States of n points, with Lyapunov exponents and distances from equilibria of some.

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
        """Whether points have a periodic orbit, shape (n,)."""
        return np.asarray(self.state == int(State.PERIODIC))

    @property
    def has_orbit(self) -> NDArray[np.bool_]:
        """Whether points have a periodic orbit, confirmed or not, shape (n,)."""
        return np.asarray(self.is_periodic | (self.state == int(State.UNCONFIRMED)))

    @property
    def is_classified(self) -> NDArray[np.bool_]:
        """Whether points have a class of steady response, shape (n,)."""
        return (self.state >= int(State.PERIODIC)) & (self.state <= int(State.EQUILIBRIUM))

    @property
    def has_stopped(self) -> NDArray[np.bool_]:
        """Whether points have come to rest, or never return to their section, shape (n,)."""
        return (self.state >= int(State.EQUILIBRIUM)) & (self.state <= int(State.NO_RETURN))
