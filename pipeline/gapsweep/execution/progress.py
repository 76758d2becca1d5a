"""What a run tells while it goes on."""

from collections.abc import Callable
from dataclasses import dataclass

DEFAULT_TIMEOUT = 600.0  # s that one point may take

OnProgress = Callable[["Progress"], None]


@dataclass(slots=True)
class Progress:
    """Counts of a run so far; handed to the observer after every task, and as stages begin.

    `stage` names what is done before or after the points; it is empty while they are computed.
    """

    n_points: int
    n_hits: int
    n_computed: int = 0
    n_failed: int = 0
    n_shared: int = 0  # computed meanwhile by another run on the same cache
    stage: str = ""

    @property
    def n_done(self) -> int:
        return self.n_hits + self.n_computed + self.n_shared
