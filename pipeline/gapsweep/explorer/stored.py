"""Stored points of a run for the page: parameter sets, and the responses of each."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.explorer.page_results import STORED, Curve
from gapsweep.explorer.question import not_computed, of_study, refuse_systems
from gapsweep.model.labels import Representation
from gapsweep.model.oscillator import OSCILLATOR
from gapsweep.quantities import written
from gapsweep.report import branch_lines
from gapsweep.run_folder import BRANCHES, RESPONSES, is_of_run
from gapsweep.store import netcdf
from gapsweep.study.study import Study

_SHOWN = ("x_max", "section_x", "section_v", "response_class", "period_multiple")
_OF_A_POINT = ("representation", "omega", "initial_condition")


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
        refuse_systems(tables, folder)
        study = Study.from_dict(tables, source=str(folder))
        self.question, self.ranges = of_study(study)
        self.note = not_computed(study)
        self._places = dict(_scenes(self._dataset))
        self.scenes = {name: _numbers(self._scene(name)) for name in self._places}

    def _scene(self, name: str) -> xr.Dataset:
        return self._dataset.isel(self._places[name])

    def points(self, name: str) -> list[Curve]:
        """The stored responses of a parameter set, a curve per law, without failed responses.

        Their states are the first section points.
        """
        scene = self._scene(name)[list(_SHOWN)].isel(section_point=0)
        table = scene.to_dataframe().reset_index().dropna(subset=["x_max", "section_x"])
        return [
            Curve(
                Representation(label).law,
                STORED,
                *(rows[name].to_numpy() for name in ("omega", *_SHOWN)),
            )
            for label, rows in table.groupby("representation", sort=False)
        ]

    def branches(self, name: str) -> list[tuple[str, bool, NDArray[np.float64]]]:
        """Lines of the branches of a parameter set: label, stability, points [Hz, mm]."""
        found = branch_lines.of_scene(self._branches, self._scene(name), "omega", "x_max")
        if found is None:
            return []
        labels = np.broadcast_to(found["representation"].values, found.sizes["branch"]).tolist()
        drawn = branch_lines.lines(found, "omega", "x_max")
        return [(labels[number], is_stable, points) for number, is_stable, points in drawn]


def _scenes(dataset: xr.Dataset) -> Any:
    """Name and position of every computed parameter set."""
    dims = [dim for dim in dataset["x_max"].dims if dim not in _OF_A_POINT]
    is_there = dataset["x_max"].notnull().any(_OF_A_POINT).transpose(*dims)
    for place in np.argwhere(is_there.values).tolist():
        at = dict(zip(dims, place, strict=True))
        yield _named(dataset.isel(at), dims), at


def _named(scene: xr.Dataset, dims: list[Any]) -> str:
    def words(dim: str) -> str:
        value, units = scene[dim].item(), scene[dim].attrs.get("units", "1")
        return f"{dim} {value if isinstance(value, str) else f'{value:.12g}'} {written(units)}"

    return ", ".join(words(dim).strip() for dim in dims)


def _numbers(scene: xr.Dataset) -> dict[str, float]:
    names = ("K_c", "j_1", "j_2", "K_ratio", *OSCILLATOR)
    return {name: scene[name].item() for name in names if name in scene.coords}
