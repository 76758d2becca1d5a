"""Record of a run's state in its folder, for other shells, during the run."""

import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from gapsweep.errors import StoreError
from gapsweep.execution.plan import Plan
from gapsweep.execution.progress import OnProgress, Progress
from gapsweep.store.state import FAILED, FINISHED, INTERRUPTED, RUNNING, RunState
from gapsweep.study.study import Study

_STATE_SECONDS = 5.0


class Recorder:
    """Observer of a run that keeps `run.json` up to date and passes the progress on."""

    def __init__(
        self,
        folder: Path,
        study: Study,
        cache: Path,
        planned: Plan,
        on_progress: OnProgress | None,
    ) -> None:
        self.folder, self.on_progress = folder, on_progress
        self.state = RunState(
            state=RUNNING,
            study=study.name,
            cache=str(cache.absolute()),
            points=planned.n_points,
            hits=planned.n_hits,
            failed=planned.progress.n_failed,
        )
        self.written = -np.inf

    def __enter__(self) -> "Recorder":
        return self

    def __call__(self, progress: Progress) -> None:
        if not progress.stage:  # counts change only while points are computed
            n_computed, n_failed = progress.n_computed, progress.n_failed
            self.state = replace(self.state, computed=n_computed, failed=n_failed)
        is_begun = not progress.stage or self.written > -np.inf
        if is_begun and time.monotonic() - self.written > _STATE_SECONDS:
            self.write()
        if self.on_progress is not None:
            self.on_progress(progress)

    def write(self) -> None:
        """Write the present state to `run.json`."""
        self._store(self.state)
        self.written = time.monotonic()

    def _store(self, state: RunState) -> None:
        """Write a state, unless another run in the same folder is still running."""
        if not state.is_hidden_in(self.folder):
            state.write(self.folder)

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None:
            self._store(replace(self.state, state=FINISHED))
        elif self.written > -np.inf:
            state = INTERRUPTED if isinstance(error, KeyboardInterrupt) else FAILED
            # The disk may be full: the error reports that already.
            with suppress(StoreError):
                self._store(replace(self.state, state=state, message=str(error)))
