"""The sections of a study's own module, as stored in ``sections.json``."""

from collections.abc import Iterator

from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Part, Table

ANSWER = "own-answer"  # anchor of the part that is the head of the report


def sections(inputs: Inputs) -> Iterator[Part]:
    """The stored parts of a study, except its answer."""
    return (part for part in _stored(inputs) if part.anchor != ANSWER)


def answer_of(inputs: Inputs) -> Part:
    """The part with a study's answer; an empty one if it has none."""
    found = (part for part in _stored(inputs) if part.anchor == ANSWER)
    return next(found, Part(ANSWER, "Answer", []))


def _stored(inputs: Inputs) -> Iterator[Part]:
    for part in inputs.sections or ():
        tables = [Table(**table) for table in part["tables"]]
        yield Part(part["anchor"], part["title"], part["sentences"], tables, part["figures"])
