"""Every error that gapsweep raises on purpose.

::

    GapsweepError
    ├── ModelError      a parameter, contact law or fit that cannot be used
    ├── StudyError      a study file that cannot be run; carries one line per problem
    ├── StoreError      a cache or NetCDF file that cannot be read or written
    ├── DatasetError    a dataset that does not hold what a plot needs
    └── ClusterError    a Dask cluster that cannot be reached or was lost

Each message names the value, the allowed range and the remedy. A sweep point that
fails numerically raises nothing: its `Status` is part of the result.
"""

import signal
from collections.abc import Sequence

# Ctrl-C, the end of a batch job and that of a terminal: what a run stops at, to be resumed later.
STOPPING = signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)
_LONGEST = 300  # characters of an error that is somebody else's


class GapsweepError(Exception):
    """Base of all errors that a user can cause and mend."""


class ModelError(GapsweepError, ValueError):
    """A parameter, contact law or fit that cannot be used."""


class StudyError(GapsweepError, ValueError):
    """A study that cannot be run.

    Parameters
    ----------
    problems : sequence of str
        One line per problem, all of them at once.
    """

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


class StoreError(GapsweepError, OSError):
    """A cache or NetCDF file that cannot be read or written."""


class DatasetError(GapsweepError, ValueError):
    """A dataset that does not hold what a plot needs, or holds more than fits into one."""


class ClusterError(GapsweepError, RuntimeError):
    """A Dask cluster that cannot be reached or was lost."""


def described(error: BaseException) -> str:
    """Kind and first line of an error, whatever the user's code has raised."""
    name = type(error).__name__
    try:
        first = str(error).splitlines()[:1]
    except BaseException:  # its own __str__ may raise anything, SystemExit too
        first = []
    return f"{name}: {first[0][:_LONGEST]}" if first and first[0] else name
