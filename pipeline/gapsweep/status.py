"""Outcome of a sweep point, as stored in datasets."""

from enum import IntEnum

# Displacement [m] beyond which a motion counts as diverged. Finite, so that divergence is detected
# early.
DIVERGED_AT = 1e3


class Status(IntEnum):
    """Status of a simulation or a sweep point; datasets store its number.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.Status.DIVERGED.label, gs.Status.DIVERGED.failed
    ('diverged', True)
    """

    OK = 0
    NOT_REQUESTED = 1
    UNRESOLVED = 2
    OUT_OF_FIT_RANGE = 3
    DIVERGED = 4
    MODEL_INVALID = 5
    STEP_UNDERFLOW = 6
    CHATTER = 7
    TIMED_OUT = 8
    KILLED = 9
    ERROR = 10
    INTERRUPTED = 11

    @property
    def label(self) -> str:
        """Name in lower case, as in the dataset's ``flag_meanings``."""
        return self.name.lower()

    @property
    def failed(self) -> bool:
        """Whether the point has no result; ``unresolved`` and ``out_of_fit_range`` have one."""
        return self > Status.OUT_OF_FIT_RANGE
