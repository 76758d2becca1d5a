"""Code of the user's own, tried out where it can harm nobody.

A law is loaded and called at x = 0 before anything is computed. The client does both in its own
process, after a child process has survived them with the same snapshot.
"""

from collections.abc import Callable
from pathlib import Path

from gapsweep.errors import ModelError, StudyError
from gapsweep.execution.alone import Alone, CallError
from gapsweep.model.own_law import OwnLaw, checked
from gapsweep.status import Status
from gapsweep.study.study import Study
from gapsweep.study.system_tables import said

_LONGEST = 60.0  # s
# What a module imports and compiles counts here, and in no time limit of points.
_SHORTEST = 10.0  # s


def try_out_system(function: str, path: Path) -> None:
    """Load a study whose system a function of the user's makes, in a child process, and make all of
    its systems there.

    Parameters
    ----------
    function : str
        Its name.
    path : Path
        Of the study file.

    Raises
    ------
    StudyError
        If the function ends its process or hangs, at whatever values. What it raises the study
        raises, too.
    """
    with Alone(_LONGEST) as alone:
        at = ""
        try:
            for some in alone(_loads, path):
                at = f" at {said(some)}"
                alone(_makes, some)
        except CallError as lost:
            if lost.status in (Status.KILLED, Status.TIMED_OUT):
                raise StudyError([f"{path}: system{at}: {function}: {lost.message}"]) from None


# What a child process has loaded, for the calls that follow.
_studies: list[Study] = []


def _loads(path: Path) -> list[dict[str, float]]:
    """Load a study, and say at what values it has systems."""
    study = Study.load(path)
    _studies[:] = [study]
    return study.systems.swept(study.grid.axes, study.grid.requested) if study.systems else []


def _makes(some: dict[str, float]) -> None:
    systems = _studies[0].systems
    assert systems is not None, "it has been loaded for them"
    systems.at(some)


def try_out(study: Study, timeout: float, say: Callable[[str], None]) -> None:
    """Import all of a study's own laws, and call them, in a child process.

    Parameters
    ----------
    timeout : float
        Time [s] that a point may take: what a law may take here too, but 10 to 60 s.
    say : callable
        Told what is tried, and for how long.

    Raises
    ------
    StudyError
        If one of them ends the process, hangs or interrupts. What only cannot be used is left to
        whoever uses it: of a history that is the status.
    """
    limit = min(max(timeout, _SHORTEST), _LONGEST)
    with Alone(limit) as alone:
        for label in study.own_laws:
            try:
                own = study.own_law(label)
            except ModelError:
                continue
            for step, function in (("imported", _imports), ("called at x = 0", _calls)):
                say(f"the law {label!r} is {step}, for {limit:g} s at most")
                try:
                    alone(function, own)
                except CallError as lost:
                    if lost.status is Status.MODEL_INVALID:
                        break
                    why = lost.message
                    if lost.status is Status.TIMED_OUT and timeout < _LONGEST:
                        why += f"; --timeout gives it up to {_LONGEST:g} s"
                    raise StudyError(
                        [f"{study.source}: the law {label!r}, when {step}: {why}"]
                    ) from None


def _imports(own: OwnLaw) -> None:
    own.load()


def _calls(own: OwnLaw) -> None:
    checked(own)
