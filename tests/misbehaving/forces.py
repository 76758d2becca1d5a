"""Contact forces that misbehave, for studies that must survive them."""

import math
import os
import signal
import time

REACH = 1e-4  # m; all of them behave until the motion has left this range


def raising(x: float) -> float:
    if abs(x) > REACH:
        raise ArithmeticError("no force here")
    return 0.0


def killing(x: float) -> float:
    if abs(x) > REACH:
        os.kill(os.getpid(), signal.SIGKILL)
    return 0.0


def leaving(x: float) -> float:
    if abs(x) > REACH:
        os._exit(7)
    return 0.0


def hanging(x: float) -> float:
    if abs(x) > REACH:
        time.sleep(1e6)
    return 0.0


def undefined(x: float) -> float:
    return math.nan if abs(x) > REACH else 0.0


def counted(x: float) -> float:
    """No force; leaves a mark whenever a point starts, which only is exactly at zero."""
    if x == 0.0:
        log = os.open(os.environ["COUNTED_LAW_LOG"], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.write(log, b".")
        os.close(log)
    return 0.0


def exiting(x: float) -> float:
    if abs(x) > REACH:
        raise SystemExit("bye")
    return 0.0


class Stopped(BaseException):
    """Not an Exception, so that what only looks for those lets it through."""


def stopping(x: float) -> float:
    if abs(x) > REACH:
        raise Stopped("enough")
    return 0.0


def innocent(x: float) -> float:
    return 1e3 * x


def spinning(x: float) -> float:
    """Hangs at work, compiled or not."""
    while abs(x) > REACH:
        pass
    return 0.0
