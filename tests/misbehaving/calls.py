"""Functions that do to their process what nobody should."""

import atexit
import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace


def same(number: int) -> int:
    return number


def noisy(number: int) -> int:
    """Write into standard output and error, and read standard input."""
    os.write(1, b"\0" * 10**6)
    print("noise", sys.stdin.read(), file=sys.stderr, flush=True)
    return number


def hungry() -> int:
    """Ask for more memory than the process may have."""
    return len(bytearray(10**12))


def closing() -> None:
    """Close every file, the connection too, and stay."""
    os.closerange(0, 100)
    time.sleep(1e6)


def unpicklable() -> object:
    return lambda: (yield)


class Unreadable:
    """Can be sent, and not be read."""

    def __reduce__(self) -> tuple[object, ...]:
        return int, ("no number",)


class MuteError(Exception):
    """Says nothing, not even when it is asked to."""

    def __str__(self) -> str:
        raise SystemExit("no words")


def mute(x: float = 0.0) -> float:
    raise MuteError


def raising(error: BaseException) -> None:
    raise error


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


def dying_with_a_child() -> None:
    """End by a signal while a forked child lives on."""
    if not os.fork():
        time.sleep(60.0)
        os._exit(0)
    os.kill(os.getpid(), signal.SIGKILL)


def killing_once(mark: Path) -> str:
    """End the process of the first call, and of all calls if the mark has no folder."""
    if not mark.exists():
        if mark.parent.exists():
            mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return mark.name


def busy(_: object) -> None:
    """Take longer than any test."""
    time.sleep(1e6)


class Deadly:
    """A scene of branches that ends the process in which they are followed."""

    system, point = None, SimpleNamespace(kind=SimpleNamespace(own=None))

    @property
    def window(self) -> object:
        os._exit(7)
