"""What every point of a search waits for, and what was found of it."""

import numpy as np
from numpy.typing import NDArray

SURE = 3.0  # standard errors, beyond which an exponent is not zero


class Phase:
    """Numbers of what a point waits for: motion up to `LAST`, then motion with its tangent."""

    LOOK = 0  # a pause, then the next part of a recorded window
    APPROACH = 1  # time to come near to an orbit that shooting found
    PAUSE = 2  # a last pause, after which there is no time for another look
    LAST = 3  # the last window, recorded with all events
    SHOOT = 4  # an orbit that the window contracts to
    REPEAT = 5  # the orbit of a settled motion that repeats itself, as it is
    RATTLE = 6  # the orbit that a motion is rattled about, as it is
    GROW = 7  # the growth of a disturbance
    TELL = 8  # what it is, with all others that have no period
    ENDED = 9


class Found:
    """What motions turned out to be, n of them; one that is nothing is unresolved, or failed.

    Attributes
    ----------
    is_periodic, is_chaotic, is_quasiperiodic, is_at_rest : ndarray of bool, shape (n,)
    is_astray : ndarray of bool, shape (n,)
        Never came back to the section.
    is_hidden : ndarray of bool, shape (n,)
        A contact moves too little beside the rest.
    is_locked : ndarray of bool, shape (n,)
        Repeats itself, after more periods than are looked for.
    is_growing : ndarray of bool, shape (n,)
        Goes farther than it ever was, with nothing that forces it.
    lyapunov, lyapunov_error : ndarray, shape (n,)
        Largest Lyapunov exponent [1/s] and its standard error, where it was measured.
    offset : ndarray, shape (n,)
        Distances [m] of motions at rest from where they will be in the end.
    """

    def __init__(self, n: int) -> None:
        self.is_periodic, self.is_chaotic = np.zeros(n, bool), np.zeros(n, bool)
        self.is_quasiperiodic, self.is_at_rest = np.zeros(n, bool), np.zeros(n, bool)
        self.is_astray, self.is_hidden = np.zeros(n, bool), np.zeros(n, bool)
        self.is_locked, self.is_growing = np.zeros(n, bool), np.zeros(n, bool)
        self.lyapunov, self.lyapunov_error = np.full(n, np.nan), np.full(n, np.nan)
        self.offset = np.full(n, np.nan)

    def hide(self, points: NDArray[np.intp]) -> None:
        """Take back what was found of points where a contact moves too little."""
        self.is_hidden[points] = True
        for found in (self.is_periodic, self.is_chaotic, self.is_quasiperiodic):
            found[points] = False
