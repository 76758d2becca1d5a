"""The section on contacts that lose energy: loops of their force, and energies per period."""

import json
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from gapsweep.analysis.dimensions import REPRESENTATION, point_dims
from gapsweep.integrate.trajectory import Trajectory
from gapsweep.model.contact import OF_LABELS
from gapsweep.model.labels import Representation
from gapsweep.report import losses, marks
from gapsweep.report.continued import motions
from gapsweep.report.drawing import labels_of
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Figured, Part, Table
from gapsweep.report.scales import axis_label, named
from gapsweep.report.selection import places
from gapsweep.report.style import looks
from gapsweep.report.tables import number
from gapsweep.study.grid import CONTACT

_WIDTH = 9.5  # inches
_LOSSES, _MOST = ("damping", *OF_LABELS), 5  # number of values of such a parameter with a loop
_TITLE = "Energy lost in contacts"
_HEADER = ["Representation", "Response", "J per forcing period", "J per contact"]
_SHOWN = (
    "Shown: the response with the largest contact force of each representation, and of each value "
    "of its damping, chi or restitution; where the force is not stored (rigid walls, periodic "
    "stiffness), with the largest product of amplitude and frequency. with_losses() computes the "
    "energies of all."
)
_OF_LOOPS = (
    "The area of a loop is the energy lost. ds.gapsweep.force_loop() draws the loops of other "
    "responses."
)
_OF_IMPACTS = "Impacts on rigid walls have no loop: their force is infinite and takes no time."


class _Loop(NamedTuple):
    """A contact that loses energy in a response."""

    number: int  # of the contact
    name: str  # of the representation, with its damping, chi or restitution where that is swept
    response: xr.Dataset
    run: Trajectory

    @property
    def has_force(self) -> bool:
        """Whether the contact force is finite, not that of a rigid wall."""
        return not self.run.laws[self.number].losses.is_rigid

    def of_contact(self) -> xr.Dataset:
        """The response, reduced to this contact."""
        return self.response.isel({CONTACT: self.number}, missing_dims="ignore")


def sections(inputs: Inputs) -> Iterator[Part]:
    """Loops and energies, none of elastic contacts and of responses that need user code.

    The page runs no user code, since a folder of results may come from elsewhere.
    """
    responses = inputs.responses
    system = json.loads(responses.attrs["study_json"]).get("system") or {}
    is_shown = "omega" in responses.dims and "force_max" in responses  # forced, with contacts
    if not is_shown or ":" in (system.get("function") or ""):
        return
    labels = [label for label in labels_of(responses) if not (label.protocol or label.is_own)]
    found = [each for label in labels for each in _loops(responses, label)]
    if found:
        table = Table(_TITLE, _HEADER, list(map(_row, found)))
        loops = [one for one in found if one.has_force]
        words = [_SHOWN, *[_OF_LOOPS] * bool(loops), *[_OF_IMPACTS] * (len(loops) < len(found))]
        yield Part("contact-losses", _TITLE, [" ".join(words)], [table], _figures(loops))


def _loops(responses: xr.Dataset, label: Representation) -> Iterator[_Loop]:
    """Contacts that lose energy, in the largest responses of a law.

    There is a response for each of up to `_MOST` values of the parameter of losses that is swept.
    """
    of_law = responses.isel({REPRESENTATION: labels_of(responses).index(label)})
    dims = point_dims(of_law)
    force, amplitude = (
        each.load().max([dim for dim in each.dims if dim not in dims], skipna=False)
        for each in (of_law["force_max"], of_law["amplitude"])
    )
    # The force of impacts is infinite, that of periodic stiffness not computed: both are NaN.
    size = (amplitude * of_law["omega"]).where(force.isnull())
    size = size if size.notnull().any() else force
    swept = next((name for name in _LOSSES if name in dims and label.takes(name)), "")
    n = size.sizes.get(swept, 1)
    for k in np.unique(np.linspace(0, n - 1, _MOST).round().astype(int)).tolist():
        at = {swept: [k]} if swept else {}
        if not size.isel(at).notnull().any():
            continue
        one = of_law.isel(at).isel(size.isel(at).argmax(dims)).load()
        name = f"{label}, {named(one[swept])}" if swept else label
        for _, run in motions(one, (REPRESENTATION,), {}, losses.LOOP_PERIODS):
            for contact, law in enumerate(run.laws):
                if law.losses.lose_energy:
                    yield _Loop(contact, name, one, run)


def _row(one: _Loop) -> list[str]:
    lost = losses.energy_lost(one.run, one.number)
    n_contacts = 0.5 * losses.times_of(one.run)[one.number].size
    here = one.of_contact()
    names = [CONTACT, *(name for name in places(here) if name not in _LOSSES)]
    where = ", ".join(named(here[name]) for name in names if name in here.coords)
    per_contact = lost / n_contacts if n_contacts else np.nan
    return [one.name, where, number(lost / one.run.inputs["n_periods"]), number(per_contact)]


def _figures(found: list[_Loop]) -> Iterator[Figured]:
    """Loops of every contact, a line for each response."""
    for contact in sorted({one.number for one in found}):
        several = [one for one in found if one.number == contact]
        styles = looks(one.name for one in several)
        figure = Figure(figsize=(_WIDTH, 4.2))
        axes = figure.subplots()
        for one in several:
            here = one.of_contact()
            x_max = here.get("contact_x_max", here["x_max"])
            marks.put(axes, [losses.line(one.run, contact, one.name, styles[one.name], x_max)])
            axes.set_xlabel(axis_label(x_max, losses.words_of(x_max)))
            axes.set_ylabel(axis_label(here["force_max"], "contact force"))
        axes.legend(fontsize=8)
        of = f", {here[CONTACT].item()}" if CONTACT in here.coords else ""
        words = f"Contact force over displacement{of}"
        yield Figured(figure, f"{words}.", words)
