"""The labelled grid of a study: its axes, and a mask of the cells that are sweep points."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.model.labels import Representation
from gapsweep.model.oscillator import Gap
from gapsweep.model.structure import AnyStructure
from gapsweep.study.points import FIXED, SWEEPS
from gapsweep.study.samples import DRAWN, SAMPLE, Samples
from gapsweep.variables import CONTACT as CONTACT
from gapsweep.variables import COORDINATE as COORDINATE
from gapsweep.variables import LAG as LAG
from gapsweep.variables import METRES, Units, canonical_values, part_units
from gapsweep.variables import START as START

Axes = Mapping[str, Sequence[Any]]
# Part of a study's grid: the positions wanted along each dimension, ascending.
Selection = tuple[NDArray[np.intp], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Starts(Sequence[tuple[str, tuple[float, ...]]]):
    """n initial conditions: fixed states, and sweeps, whose first point starts at rest."""

    KINDS: ClassVar[tuple[str, ...]] = (FIXED, *SWEEPS)

    kind: NDArray[np.int8]  # shape (n,); position in `KINDS`
    # Shape (n, n_states); displacements [m], velocities [m/s] and first-order states; zero for a
    # sweep.
    states: NDArray[np.float64]
    number: NDArray[np.int32]  # shape (n,); number of each initial condition in its study

    @classmethod
    def fixed(cls, states: ArrayLike) -> "Starts":
        """Return fixed initial states, shape (n, n_states), rounded to canonical values."""
        found = canonical_values(states)
        return cls(np.zeros(len(found), np.int8), found, np.arange(len(found), dtype=np.int32))

    @classmethod
    def sweep(cls, kind: str, n_states: int) -> "Starts":
        """Return the initial condition of a sweep, ``"sweep_up"`` or ``"sweep_down"``."""
        number = np.array([cls.KINDS.index(kind)], np.int8)
        return cls(number, np.zeros((1, n_states)), np.zeros(1, np.int32))

    @classmethod
    def union(cls, several: Iterable["Starts"]) -> "Starts":
        """Join several sets of initial conditions, each once, in order of first appearance."""
        columns = zip(*((s.kind, s.states, s.number) for s in several), strict=True)
        whole = cls(*map(np.concatenate, columns))
        _, first = np.unique(whole._rows, return_index=True)
        number = np.arange(len(first), dtype=np.int32)
        return replace(whole.take(np.sort(first)), number=number)

    @property
    def _rows(self) -> NDArray[np.void]:
        """Each initial condition as one sortable value, equal only for equal initial conditions."""
        rows = np.column_stack([self.kind, self.states])
        return rows.view(f"V{rows.itemsize * rows.shape[1]}").ravel()

    @property
    def is_fixed(self) -> NDArray[np.bool_]:
        return np.asarray(self.kind == 0)

    def places(self, some: "Starts") -> NDArray[np.intp]:
        """Return the positions of some of these initial conditions."""
        rows = self._rows
        order = np.argsort(rows)
        return order[np.searchsorted(rows[order], some._rows)]

    def take(self, numbers: Any) -> "Starts":
        columns = (self.kind, self.states, self.number)
        return Starts(*(column[numbers] for column in columns))

    def __len__(self) -> int:
        return len(self.kind)

    def __getitem__(self, number: Any) -> Any:
        """Kind and state of an initial condition."""
        return self.KINDS[self.kind[number]], tuple(self.states[number].tolist())


@dataclass(frozen=True)
class Grid:
    """Coordinates of the dataset, and a mask of the cells that are sweep points."""

    # By dimension, in the dataset's order: representations; stiffnesses [N/m]; gaps, or distances
    # of both walls [m]; frequencies [Hz]; other swept parameters; `Samples`, if numbers are
    # uncertain; `Starts`. Numbers ascend, others come in order of first appearance.
    axes: Axes
    requested: NDArray[np.bool_]
    structure: AnyStructure  # structure of the models of all points
    # Dimensions within a point, those with several entries: names of coordinates, contacts, lags.
    parts: Mapping[str, tuple[str, ...]]
    units: Units = field(default_factory=lambda: METRES)  # units of all coordinates and contacts

    @property
    def dims(self) -> tuple[str, ...]:
        return tuple(self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.requested.shape

    @property
    def representations(self) -> tuple[Representation, ...]:
        return tuple(self.axes["representation"])

    @property
    def K_c(self) -> tuple[float, ...]:
        return tuple(self.axes["K_c"])

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """All gaps; if both walls have separate axes, all combinations."""
        if "gap" in self.axes:
            return tuple(self.axes["gap"])
        return tuple(Gap(j_1, j_2) for j_1 in self.axes["j_1"] for j_2 in self.axes["j_2"])

    @property
    def omega(self) -> tuple[float, ...]:
        return tuple(self.axes["omega"])

    @property
    def scene_dims(self) -> tuple[str, ...]:
        """Dimensions of a case: all except representation, omega and initial condition."""
        return tuple(d for d in self.dims if d not in ("representation", "omega", START))

    @property
    def starts(self) -> Starts:
        return starts_of(self.axes)

    def labels(self, name: str) -> Sequence[Any]:
        """Return the values of an axis as in the coordinate of the dataset."""
        axis = self.axes[name]
        if name == "gap":
            return [self.label(gap) for gap in axis]
        return axis.number.tolist() if isinstance(axis, Starts | Samples) else axis

    def label(self, gap: Gap) -> str:
        """Return wall distances as text: in mm, or in the unit of contacts that is no length."""
        return gap.label if self.in_metres else f"{gap.j_1:.12g}/{gap.j_2:.12g}"

    @property
    def in_metres(self) -> bool:
        """Whether the displacements of all contacts are lengths."""
        return {*self.units[CONTACT]} <= {"m"}

    def coordinates(self) -> dict[str, NDArray[Any]]:
        """Return the values of all coordinates of the dataset; states of sweeps are NaN."""
        found = {name: np.array(self.labels(name)) for name in self.dims}
        if "gap" in found:
            walls = np.array([(gap.j_1, gap.j_2) for gap in self.axes["gap"]])
            found["j_1"], found["j_2"] = walls.T
        starts = self.starts
        states = np.where(starts.is_fixed[:, None], starts.states, np.nan)
        n, m = self.structure.n, self.structure.m
        for name, size, first in (("x_0", n, 0), ("v_0", n, n), ("z_0", m, 2 * n)):
            if size:
                found[name] = states[:, first] if size == 1 else states[:, first : first + size]
        found |= {name: np.array(names) for name, names in self.parts.items()}
        found |= {name: np.array(some) for name, some in part_units(self.units).items()}
        if isinstance(samples := self.axes.get(SAMPLE), Samples):
            found |= {f"{DRAWN}{name}": drawn for name, drawn in samples.numbers.items()}
            found |= {name: getattr(samples, name) for name in ("matrix", "repeat")}
        return found | {"start": np.array(Starts.KINDS)[starts.kind]}

    def cut(self, selection: Selection) -> "Grid":
        """Return the selected part as a grid."""
        axes = {
            name: axis.take(some)
            if isinstance(axis, Starts | Samples)
            else tuple(axis[i] for i in some)
            for (name, axis), some in zip(self.axes.items(), selection, strict=True)
        }
        return Grid(
            axes, self.requested[np.ix_(*selection)], self.structure, self.parts, self.units
        )

    @property
    def n_omega(self) -> int:
        """Number of frequencies; 1 for unforced systems."""
        return len(self.axes.get("omega", "-"))

    def cells(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the flat positions in the grid of numbers in the order of computation.

        Neighbouring frequencies follow each other, those of a sweep in its direction.
        """
        chain, at = np.divmod(numbers, self.n_omega)
        before, after = np.divmod(chain, self._n_after)
        return (before * self.n_omega + self._along(chain, at)) * self._n_after + after

    def numbers(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the numbers in the order of computation of flat positions in the grid."""
        rest, after = np.divmod(cells, self._n_after)
        before, at = np.divmod(rest, self.n_omega)
        chain = before * self._n_after + after
        return chain * self.n_omega + self._along(chain, at)

    def order(self, wanted: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which numbers in the order of computation must be computed for wanted points.

        A sweep includes all points up to the last one wanted.

        Parameters
        ----------
        wanted : ndarray of bool, of the grid's shape

        Returns
        -------
        ndarray of bool, shape (number of cells,)
        """
        chosen, is_swept = self._arranged(wanted & self.requested), self.starts.kind > 0
        if is_swept.any():
            leads = np.logical_or.accumulate(chosen[:, is_swept, ::-1], axis=-1)[..., ::-1]
            chosen[:, is_swept] = leads & self._arranged(self.requested)[:, is_swept]
        return chosen.ravel()

    @cached_property
    def _n_after(self) -> int:
        """Number of cells of the dimensions after the frequency."""
        if "omega" not in self.dims:
            return 1
        return math.prod(self.shape[self.dims.index("omega") + 1 :])

    @cached_property
    def _is_down(self) -> NDArray[np.bool_]:
        return np.asarray(self.starts.kind == Starts.KINDS.index("sweep_down"))

    def _along(self, chain: NDArray[np.int64], at: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return positions along frequencies for positions in the order of computation."""
        if not self._is_down.any():
            return at
        return np.where(self._is_down[chain % len(self.starts)], self.n_omega - 1 - at, at)

    def _arranged(self, values: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return values over the grid in the order of computation, shape (n, starts, omega)."""
        if "omega" in self.dims:
            values = np.moveaxis(values, self.dims.index("omega"), -1)
        found = np.array(values).reshape(-1, len(self.starts), self.n_omega)
        found[:, self._is_down] = found[:, self._is_down, ::-1]
        return found


def starts_of(axes: Axes) -> Starts:
    """Return the initial conditions among the axes."""
    found = axes[START]
    assert isinstance(found, Starts)
    return found
