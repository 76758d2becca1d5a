"""State of a run in its folder, during the run and after it: `run.json`.

Another shell can read it at any time, also after the process was killed: a run with state running
is reported as dead if its process has ended, or on another machine was silent for two minutes.
"""

import json
import platform
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import psutil

from gapsweep.errors import StoreError
from gapsweep.store.artefact import replacing, text_of

STATE = "run.json"
RUNNING, FINISHED, INTERRUPTED, FAILED, DIED = (
    "running",
    "finished",
    "interrupted",
    "failed",
    "died",
)
NO_FOLDER = "must be the folder of a run, as data/runs/quick, not a file"
# Longer pauses between updates mean that the process of another machine has died.
_SILENT_SECONDS = 120.0


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunState:
    """State of a run: running or its outcome, counts of points, and its process."""

    state: str  # ``running``, ``finished``, ``interrupted``, ``failed`` or ``died``
    study: str  # name of the study
    cache: str  # absolute path of the cache
    points: int
    hits: int
    computed: int = 0
    failed: int = 0
    message: str = ""  # reason of a failure, else empty
    # Machine and process; the creation time distinguishes processes with the same number.
    host: str = field(default_factory=platform.node)
    pid: int = field(default_factory=lambda: psutil.Process().pid)
    process_started: float = field(default_factory=lambda: psutil.Process().create_time())
    started: str = field(default_factory=_now)  # UTC
    updated: str = field(default_factory=_now)  # UTC

    def write(self, folder: Path) -> None:
        """Write the state to ``run.json`` of a folder, with the present time."""
        text = json.dumps(asdict(replace(self, updated=_now())), indent=1) + "\n"
        try:
            with replacing(folder / STATE) as temporary:
                temporary.write_text(text, encoding="utf-8")
        except StoreError:  # on a full disk the existing file can still be overwritten
            if not (folder / STATE).is_symlink():
                with suppress(OSError):
                    (folder / STATE).write_text(text, encoding="utf-8")
            raise

    @classmethod
    def read(cls, folder: Path) -> "RunState":
        """Read the state of the run in a folder; `died` if it is running, but its process is not.

        Raises `StoreError` if there is no state, or it is damaged.
        """
        path = folder / STATE
        try:
            values: dict[str, Any] = json.loads(text_of(path))
            found = cls(**values)
            if not all(type(getattr(found, one.name)) is one.type for one in fields(cls)):
                raise TypeError
            is_dead = found.state == RUNNING and not found.is_alive
        except FileNotFoundError:
            raise StoreError(f"{path}: no such file; 'gapsweep run' writes it") from None
        except NotADirectoryError:
            raise StoreError(f"{folder}: {NO_FOLDER}") from None
        except OSError as error:
            raise StoreError(f"{path}: cannot be read: {error.strerror}") from None
        except (ValueError, TypeError, RecursionError):
            raise StoreError(f"{path}: not the state of a run; run the study again") from None
        if is_dead:
            return replace(found, state=DIED, message="its process ended; run again to resume")
        return found

    def is_hidden_in(self, folder: Path) -> bool:
        """Whether the state in a folder is of another study, or of another run still running."""
        try:
            there = RunState.read(folder)
        except StoreError:
            return False
        mine = (there.host, there.pid) == (self.host, self.pid)
        return there.study != self.study or (there.state == RUNNING and not mine)

    @property
    def is_alive(self) -> bool:
        """Whether the process of the run exists; on another machine, whether it wrote recently."""
        if self.host == platform.node():
            try:
                process = psutil.Process(self.pid)
                zombie = process.status() == psutil.STATUS_ZOMBIE
                return not zombie and process.create_time() == self.process_started
            except psutil.Error:
                return False
        silent = datetime.now(UTC) - datetime.fromisoformat(self.updated)
        return silent.total_seconds() < _SILENT_SECONDS
