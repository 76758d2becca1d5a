"""What the user's code prints while a command runs it: no part of what the command says."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

# What stdout was, then a mark for every block whose code prints aside.
_aside: list[int] = []
_printing = threading.Lock()


@contextmanager
def printing_aside() -> Iterator[None]:
    """What this process prints in this block is no part of what a command says: it goes to stderr.

    The file is another one, not the object: a module may hold `sys.stdout`, and its key with it.
    """
    with _printing:
        if not _aside:  # of threads that print aside at a time the first redirects ...
            _aside.append(_redirected())
        _aside.append(-1)
    try:
        yield
    finally:
        with _printing:
            _aside.pop()
            if len(_aside) == 1:  # ... and the last one takes it back
                _restore(_aside.pop())


def _redirected() -> int:
    """Let stdout be stderr; a copy of what it was, or -1 if one is closed or there is none."""
    with suppress(OSError, AttributeError):
        sys.stdout.flush()
        said = os.dup(1)
        os.dup2(2, 1)
        return said
    return -1


def _restore(said: int) -> None:
    if said >= 0:
        with suppress(OSError, AttributeError):
            sys.stdout.flush()
        os.dup2(said, 1)
        os.close(said)
