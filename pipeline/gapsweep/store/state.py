"""State of a run, kept in its folder while it lasts and after it: `run.json`.

Another shell can read it at any time, also after the process was killed: a run that says it
is running, but whose process is gone or has been silent for long, is reported as dead.
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
# Longer than any pause between two tasks is worth a doubt, if the process cannot be seen.
_SILENT_SECONDS = 120.0


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunState:
    """Activity or outcome of a run."""

    state: str  # ``running``, ``finished``, ``interrupted``, ``failed`` or ``died``
    study: str  # name of the study
    cache: str  # absolute path of the cache
    points: int
    hits: int
    computed: int = 0
    failed: int = 0
    message: str = ""  # why it failed, else empty
    # Where it runs; the start time tells a process from a later one of the same number.
    host: str = field(default_factory=platform.node)
    pid: int = field(default_factory=lambda: psutil.Process().pid)
    process_started: float = field(default_factory=lambda: psutil.Process().create_time())
    started: str = field(default_factory=_now)  # UTC
    updated: str = field(default_factory=_now)  # UTC

    def write(self, folder: Path) -> None:
        """Store the state as of now."""
        text = json.dumps(asdict(replace(self, updated=_now())), indent=1) + "\n"
        try:
            with replacing(folder / STATE) as temporary:
                temporary.write_text(text, encoding="utf-8")
        except StoreError:  # on a full disk the file that is there still has room
            if not (folder / STATE).is_symlink():
                with suppress(OSError):
                    (folder / STATE).write_text(text, encoding="utf-8")
            raise

    @classmethod
    def read(cls, folder: Path) -> "RunState":
        """The state of the run in a folder, as it really is now.

        Raises
        ------
        StoreError
            If there is none, or it is damaged.
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
        """Whether a folder tells of another study, or of another run that goes on there."""
        try:
            there = RunState.read(folder)
        except StoreError:
            return False
        mine = (there.host, there.pid) == (self.host, self.pid)
        return there.study != self.study or (there.state == RUNNING and not mine)

    @property
    def is_alive(self) -> bool:
        """Whether the process that wrote the state still is there, as far as one can see."""
        if self.host == platform.node():
            try:
                process = psutil.Process(self.pid)
                zombie = process.status() == psutil.STATUS_ZOMBIE
                return not zombie and process.create_time() == self.process_started
            except psutil.Error:
                return False
        silent = datetime.now(UTC) - datetime.fromisoformat(self.updated)
        return silent.total_seconds() < _SILENT_SECONDS
