"""Stored points of a run for the page: parameter sets, and the responses of each."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.explorer.first_question import not_computed, of_study, refuse_code
from gapsweep.explorer.page_results import STORED, Curve, peak
from gapsweep.explorer.question import Question
from gapsweep.model.labels import Representation
from gapsweep.quantities import written
from gapsweep.report import branch_lines
from gapsweep.run_folder import BRANCHES, RESPONSES, is_of_run
from gapsweep.store import netcdf
from gapsweep.study.grid import CONTACT, COORDINATE
from gapsweep.study.study import Study

_STATE, _WITHIN = ("section_x", "section_v", "section_z"), ("omega", "initial_condition")
_SHOWN = ("x_max", "contact_x_max", *_STATE, "response_class", "period_multiple")
_OF_A_POINT = ("representation", *_WITHIN)


class StoredRun:
    """A run whose points the page shows.

    Attributes
    ----------
    question : Question
        The initial question of the page.
    ranges : dict of str to (float, float)
        Ranges of the swept parameters.
    note : str
        Note that user laws are not computed; empty if the study has none.
    scenes : dict of str to dict of str to float
        Parameters of every parameter set in SI units, by name of the set.
    """

    def __init__(self, folder: Path) -> None:
        self._dataset = netcdf.read(folder / RESPONSES)
        path = folder / BRANCHES
        self._branches = netcdf.read(path) if path.exists() and is_of_run(path) else None
        tables = json.loads(self._dataset.attrs["study_json"])
        refuse_code(tables, folder)
        study = Study.from_dict(tables, source=str(folder))
        self.question, self.ranges = of_study(study)
        self.note = not_computed(study)
        self._places = dict(_scenes(self._dataset))
        names = [name for name in self.question.machine.names if name != "omega"]
        every = {name: self._scene(name) for name in self._places}
        self.scenes = {
            name: {n: scene[n].item() for n in names if n in scene.coords}
            for name, scene in every.items()
        }

    def _scene(self, name: str) -> xr.Dataset:
        return self._dataset.isel(self._places[name])

    def points(self, name: str, question: Question) -> list[Curve]:
        """The stored responses of a parameter set, a curve per law, without failed responses.

        Peaks are those of the displacement that the question shows, states the first section
        points.
        """
        scene = self._scene(name)
        if CONTACT in scene.dims:  # sorted in the study that the file holds
            scene = scene.sel({CONTACT: [*question.model.contacts]})
        names = [each for each in _SHOWN if each in scene]
        ordered = scene[names].isel(section_point=0).transpose("representation", *_WITHIN, ...)
        omega = np.repeat(scene["omega"].values, scene.sizes["initial_condition"])
        found = []
        for number, label in enumerate(scene["representation"].values.tolist()):
            rows = {n: ordered[n].values[number].reshape(omega.size, -1) for n in names}
            end = np.hstack([rows[each] for each in _STATE if each in rows])
            peaks = peak(question, rows)
            known = np.isfinite(peaks) & np.isfinite(end).all(axis=1)
            kinds = (rows[each][known, 0] for each in ("response_class", "period_multiple"))
            law = Representation(label).law
            found.append(Curve(law, STORED, omega[known], peaks[known], end[known], *kinds))
        return found

    def branches(
        self, name: str, question: Question
    ) -> list[tuple[str, bool, NDArray[np.float64]]]:
        """Lines of the branches of a parameter set: label, stability, points in shown units.

        They are those of a coordinate that the question shows.
        """
        if question.shown not in question.model.coordinates:
            return []
        scene = self._scene(name)
        if COORDINATE in scene.dims:
            scene = scene.sel({COORDINATE: question.shown})
        found = branch_lines.of_scene(self._branches, scene, "omega", "x_max")
        if found is None:
            return []
        labels = np.broadcast_to(found["representation"].values, found.sizes["branch"]).tolist()
        drawn = branch_lines.lines(found, "omega", "x_max")
        return [(labels[number], is_stable, points) for number, is_stable, points in drawn]


def _scenes(dataset: xr.Dataset) -> Any:
    """Name and position of every computed parameter set."""
    parts = [dim for dim in dataset["x_max"].dims if dim == COORDINATE]
    dims = [dim for dim in dataset["x_max"].dims if dim not in (*_OF_A_POINT, *parts)]
    is_there = dataset["x_max"].notnull().any([*_OF_A_POINT, *parts]).transpose(*dims)
    for place in np.argwhere(is_there.values).tolist():
        at = dict(zip(dims, place, strict=True))
        yield _named(dataset.isel(at), dims), at


def _named(scene: xr.Dataset, dims: list[Any]) -> str:
    def words(dim: str) -> str:
        value, units = scene[dim].item(), scene[dim].attrs.get("units", "1")
        return f"{dim} {value if isinstance(value, str) else f'{value:.12g}'} {written(units)}"

    return ", ".join(words(dim).strip() for dim in dims)
