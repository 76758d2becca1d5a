"""Functions that do to their process, and to its pipe, what nobody should."""

import atexit
import os
import sys
import tempfile
import time
from multiprocessing.connection import Connection


def closing() -> None:
    """Close every file, the pipe too, and stay."""
    os.closerange(3, 100)
    time.sleep(1e6)


def speaking(number: int) -> int:
    """Send a message of its own before the answer."""
    Connection(os.dup(int(sys.argv[1]))).send("not asked for")
    return number


def writing(data: bytes) -> None:
    """Write bytes where the answer is expected."""
    os.write(int(sys.argv[1]), data)


def same(number: int) -> int:
    return number


def unpicklable() -> object:
    return lambda: 0


class Unreadable:
    """Can be sent, and not be read."""

    def __reduce__(self) -> tuple[object, ...]:
        return int, ("no number",)


def unreadable() -> Unreadable:
    return Unreadable()


class MuteError(Exception):
    """Says nothing, not even when it is asked to."""

    def __str__(self) -> str:
        raise SystemExit("no words")


def mute(x: float = 0.0) -> float:
    raise MuteError


def keeping() -> str:
    """A folder that is removed when the process ends by itself."""
    _kept.append(tempfile.TemporaryDirectory())
    return _kept[-1].name


_kept: list[tempfile.TemporaryDirectory[str]] = []


def staying() -> str:
    """Keep the process from ending."""
    atexit.register(time.sleep, 1e6)
    return "here"


def working(seconds: float) -> float:
    """Half at work and half held up, as on a busy machine, for so long [s]."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pause = time.monotonic() + 0.02
        while time.monotonic() < pause:
            pass
        time.sleep(0.02)
    return seconds


def forking() -> int:
    """Number of a process that stays behind."""
    pid = os.fork()
    if not pid:
        time.sleep(600.0)
        os._exit(0)
    return pid
