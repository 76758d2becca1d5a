"""The sections of the report in their order.

A section is a function of the files of a run, as the ``sections`` of a study's own module: it gives
parts with sentences, tables and figures.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Part
from gapsweep.report.sections import (
    answer,
    benchmarks,
    claim_list,
    contact_losses,
    derivatives,
    findings,
    fitted,
    force_errors,
    model,
    overview,
    own,
    parameter_sets,
    provenance,
    uncertainty,
)

RESULTS = "Results"


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the report."""

    # From the files of a run to its parts, made one by one; none if it has nothing to show.
    parts: Callable[[Inputs], Iterable[Part]]
    # Title of the sections that it stands among; these have their own pages if they have many
    # figures. Empty for a section of the first page.
    group: str = ""
    template: str = "_part.html"  # file that draws a part of it
    script: str = ""  # name of the script of its template; empty if it has none


def results(inputs: Inputs) -> Iterator[Part]:
    """Sections on the parameter sets, or one section in their place if there are too many sets.

    Studies of uncertain numbers have none, since every sample is a parameter set.
    """
    if inputs.risk is not None:
        return
    is_one = overview.is_wide(inputs.responses)
    yield from overview.sections(inputs) if is_one else parameter_sets.sections(inputs)


SECTIONS = (
    Section(answer.sections, template="_answer.html", script="answer"),
    Section(fitted.sections),
    Section(uncertainty.sections),
    Section(findings.sections, template="_findings.html"),
    Section(model.sections, template="_pairs.html"),
    Section(own.sections, RESULTS, "_own.html"),
    Section(benchmarks.work_precision, RESULTS),
    Section(benchmarks.stability, RESULTS),
    Section(results, RESULTS),
    Section(derivatives.sections),
    Section(force_errors.sections),
    Section(contact_losses.sections),
    Section(claim_list.sections, template="_claims.html", script="claims"),
    Section(provenance.sections, template="_provenance.html"),
)
