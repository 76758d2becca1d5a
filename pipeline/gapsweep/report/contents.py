"""The sections of the report in their order, each with the files that it needs.

A section is a function of files of a run, as the ``sections`` of a study's own module: it gives
parts with sentences, tables and figures.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import xarray as xr

from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Part
from gapsweep.report.sections import (
    answer,
    benchmarks,
    claim_list,
    findings,
    force_errors,
    model,
    overview,
    own,
    parameter_sets,
    provenance,
)
from gapsweep.report.sections.overview import is_wide

RESULTS = "Results"


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the report.

    Attributes
    ----------
    make : callable
        Returns its parts, none if it has nothing to show; its arguments are the inputs by name.
    needs : tuple of str
        Names of inputs without which the report does not have it.
    uses : tuple of str
        Names of inputs that it takes if the run has them, else None.
    applies : callable
        Whether responses have such a section.
    group : str
        Title of the sections that it stands among; these have their own pages if they have many
        figures. Empty for a section of the first page.
    template : str
        File that draws a part of it.
    script : str
        Name of the script of its template; empty if it has none.
    """

    make: Callable[..., Iterable[Part]]
    needs: tuple[str, ...] = ("responses",)
    uses: tuple[str, ...] = ()
    applies: Callable[[xr.Dataset], bool] = lambda responses: True
    group: str = ""
    template: str = "_part.html"
    script: str = ""

    def parts(self, inputs: Inputs) -> Iterator[Part]:
        """Its parts for the files of a run, made one by one."""
        found = {name: getattr(inputs, name) for name in (*self.needs, *self.uses)}
        if all(found[name] is not None for name in self.needs) and self.applies(inputs.responses):
            yield from self.make(**found)


_OF_POINTS = ("responses", "timing"), ("agreement", "attractors", "branches", "curves")
SECTIONS = (
    Section(
        answer.sections, uses=("agreement", "static", "claims", "sections"), template="_answer.html"
    ),
    Section(
        findings.sections,
        uses=("agreement", "attractors", "advice", "claims"),
        template="_findings.html",
    ),
    Section(model.sections, template="_pairs.html"),
    Section(own.sections, ("sections",), group=RESULTS, template="_own.html"),
    Section(benchmarks.work_precision, ("work_precision",), group=RESULTS),
    Section(benchmarks.stability, ("stability",), group=RESULTS),
    Section(overview.sections, *_OF_POINTS, is_wide, RESULTS),
    Section(
        parameter_sets.sections, *_OF_POINTS, lambda responses: not is_wide(responses), RESULTS
    ),
    Section(force_errors.sections, ("static",)),
    Section(claim_list.sections, ("claims",), template="_claims.html", script="claims"),
    Section(provenance.sections, template="_provenance.html"),
)
