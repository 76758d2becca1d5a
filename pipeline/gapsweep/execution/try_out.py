"""Laws of the user's own, tried out where they can harm nobody.

Keys hold the code of a law, which is known once it has been imported, and then it is asked for its
force at x = 0. The client does both in its own process, after a child process has survived them.
"""

from gapsweep.errors import StudyError
from gapsweep.execution.alone import Alone, CallError
from gapsweep.model import own_law
from gapsweep.status import Status
from gapsweep.study.points import law_code
from gapsweep.study.study import Study

_SECONDS = 60.0
_STEPS = (("imported", own_law.code), ("called at x = 0", law_code))


def try_out(study: Study) -> None:
    """Import all of a study's own laws, and call them, in a child process.

    Raises
    ------
    StudyError
        If one of them ends the process, hangs or interrupts. What only cannot be used is left to
        whoever uses it: of a history that is the status.
    """
    with Alone(_SECONDS) as alone:
        for label in study.own_laws:
            for step, function in _STEPS:
                try:
                    alone(function, label)
                except CallError as lost:
                    if lost.status is Status.MODEL_INVALID:
                        break
                    raise StudyError(
                        [f"{study.source}: the law {label!r}, when {step}: {lost.message}"]
                    ) from None
