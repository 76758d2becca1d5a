"""Progress of a run, as its observer gets it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

DEFAULT_TIMEOUT = 600.0  # s that one point may take

OnProgress = Callable[["Progress"], None]


@dataclass(slots=True)
class Progress:
    """Counts of a run, given to the observer after every task and at the beginning of stages.

    `stage` names the step before or after the points; it is empty while points are computed.
    """

    n_points: int
    n_hits: int
    n_computed: int = 0
    n_failed: int = 0
    n_shared: int = 0  # computed meanwhile by another run on the same cache
    seconds_left: float | None = None  # for the remaining points; None while unknown
    stage: str = ""

    @property
    def n_done(self) -> int:
        return self.n_hits + self.n_computed + self.n_shared


def tell(on_progress: OnProgress | None, progress: Progress, stage: str) -> None:
    """Call the observer, if any, with the name of the stage that begins and the counts."""
    if on_progress is not None:
        on_progress(replace(progress, stage=stage))
