"""The exception classes of gapsweep.

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
from unicodedata import category

# Signals of Ctrl-C, of the end of a batch job and of a terminal: a run stops and can be resumed.
STOPPING = signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)
_LONGEST = 300  # characters of an error that other code has raised
_UNSEEN = "Cc", "Cf"  # Unicode categories: control characters, and those that reorder a text
_MOST = 100  # problems of a study that are listed


class GapsweepError(Exception):
    """Base class of gapsweep's errors; the message names the cause and a remedy."""


class ModelError(GapsweepError, ValueError):
    """A parameter, contact law or fit is invalid."""


class StudyError(GapsweepError, ValueError):
    """A study is invalid.

    Parameters
    ----------
    *problems : str
        Problems of the study, a line each; the first 100 are kept.
    """

    def __init__(self, *problems: str) -> None:
        more = [f"and {len(problems) - _MOST} more problems"] if len(problems) > _MOST else []
        self.problems = (*problems[:_MOST], *more)
        super().__init__("\n".join(self.problems))


class StoreError(GapsweepError, OSError):
    """A cache or NetCDF file cannot be read or written."""


class DatasetError(GapsweepError, ValueError):
    """A dataset lacks what a plot needs, or has more than a plot can show."""


class ClusterError(GapsweepError, RuntimeError):
    """A Dask cluster cannot be reached or was lost."""


def printable(text: str) -> str:
    """The text without invisible characters, except tabs and line ends."""
    return "".join(each for each in text if each in "\t\n" or category(each) not in _UNSEEN)


def shown(value: object) -> str:
    """The value in a message: one line, and an array by its shape."""
    shape = getattr(value, "shape", ())
    return f"array of shape {shape}" if shape else " ".join(f"{value!r:.200}".split())


def described(error: BaseException) -> str:
    """Class name and first line of the message of an error, safe for errors of user code."""
    name = type(error).__name__
    try:
        first = str(error).splitlines()[:1]
    except BaseException:  # __str__ of user code may raise any error
        first = []
    return f"{name}: {first[0][:_LONGEST]}" if first and first[0] else name
