"""The sections of a study's own module, as stored in ``sections.json``."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gapsweep.report.parts import Part, Table

ANSWER = "own-answer"  # anchor of the part that is the head of the report


def sections(sections: Sequence[Mapping[str, Any]]) -> Iterator[Part]:
    """The stored parts of a study, except its answer."""
    return (part for part in _stored(sections) if part.anchor != ANSWER)


def answer_of(sections: Sequence[Mapping[str, Any]] | None) -> Part:
    """The part with a study's answer; an empty one if it has none."""
    found = (part for part in _stored(sections or ()) if part.anchor == ANSWER)
    return next(found, Part(ANSWER, "Answer", []))


def _stored(sections: Sequence[Mapping[str, Any]]) -> Iterator[Part]:
    for part in sections:
        tables = [Table(**table) for table in part["tables"]]
        yield Part(part["anchor"], part["title"], part["sentences"], tables, part["figures"])
