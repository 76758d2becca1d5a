"""Blocks of a study, ``[[sweep]]``: their axes, and the grid of all blocks."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.oscillator import Gap
from gapsweep.study.axes import values
from gapsweep.study.grid import Axes, Starts, starts_of
from gapsweep.study.points import canonical
from gapsweep.study.samples import Samples
from gapsweep.study.spec import SweepTable


def expanded(block: SweepTable, swept: Mapping[str, float]) -> dict[str, Any]:
    """Return a block's axes except initial conditions, with canonical values without repeats.

    `swept` are default values of the further parameters that some block sweeps.
    """
    axes: dict[str, Any] = {"representation": block.representation}
    if block.K_c is not None:
        axes["K_c"] = values(block.K_c)
    if block.gap is not None:
        axes["gap"] = [Gap(canonical(j_1), canonical(j_2)) for j_1, j_2 in block.gap]
    for name in ("j_1", "j_2", "omega"):
        if (axis := getattr(block, name)) is not None:
            axes[name] = values(axis)
    for name, default in swept.items():
        axis = block.parameters.get(name)
        axes[name] = [default] if axis is None else values(axis)
    for name, axis in axes.items():
        is_number = name not in ("representation", "gap")
        axes[name] = tuple(dict.fromkeys(map(canonical, axis) if is_number else axis))
    return axes


def union(blocks: Sequence[Axes]) -> Axes:
    """Return the joint axes of all blocks: numbers ascending, others in order of appearance."""
    found: dict[str, Sequence[Any]] = {}
    for name, first in blocks[0].items():
        if isinstance(first, Starts):
            found[name] = Starts.union(starts_of(block) for block in blocks)
            continue
        if isinstance(first, Samples):  # the same in all blocks
            found[name] = first
            continue
        several = dict.fromkeys(value for block in blocks for value in block[name])
        is_number = isinstance(first[0], float)
        found[name] = tuple(sorted(several) if is_number else several)
    return found


def requested_of(blocks: Sequence[Axes], axes: Axes) -> NDArray[np.bool_]:
    """Whether some block contains each cell of the grid over the joint axes."""
    shape = [len(axis) for axis in axes.values()]
    if any(all(len(block[name]) == len(axis) for name, axis in axes.items()) for block in blocks):
        return np.broadcast_to(np.True_, shape)  # a single value, for grids of 1e8 cells
    requested = np.zeros(shape, dtype=bool)
    for block in blocks:
        at = [_places(axis, block[name]) for name, axis in axes.items()]
        requested[np.ix_(*at)] = True
    return requested


def _places(axis: Sequence[Any], some: Sequence[Any]) -> Sequence[int] | NDArray[np.intp]:
    """Return the positions of values on an axis that contains them."""
    if isinstance(axis, Starts) and isinstance(some, Starts):
        return axis.places(some)
    if isinstance(axis, Samples):
        return np.arange(len(axis))
    places = {value: i for i, value in enumerate(axis)}
    return [places[value] for value in some]
