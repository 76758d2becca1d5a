"""Progress of a run."""

from collections.abc import Callable
from dataclasses import dataclass, replace

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
    seconds_left: float | None = None  # of computing points; None while it cannot be known
    stage: str = ""

    @property
    def n_done(self) -> int:
        return self.n_hits + self.n_computed + self.n_shared


def tell(on_progress: OnProgress | None, progress: Progress, stage: str) -> None:
    """Say what begins now, with the counts so far."""
    if on_progress is not None:
        on_progress(replace(progress, stage=stage))
