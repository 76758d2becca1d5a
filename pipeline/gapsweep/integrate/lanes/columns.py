"""Parameter columns of a table of models: derivatives of its rows by parameters."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.problem import Shifts

from .row_layout import SOURCES, RowLayout, known
from .scene_table import SceneTable

Array = NDArray[np.float64]

# Powers of the angular frequency by which the blocks of `SOURCES` are divided in the equation
# over the phase of the forcing.
_POWERS = {
    **dict.fromkeys(("stiffness", "lag_force", "pull", "cubic", "push"), 2.0),
    **dict.fromkeys(("damping", "of_place", "of_lag"), 1.0),
    "chi": -1.0,  # times a stiffness
}
# Powers for contacts: of a plain oscillator per unit mass, of others times a row of `pull`.
_OF_PLAIN = {"lower_stiffness": 2.0, "upper_stiffness": 2.0, "contact_damping": 1.0}
_OF_OTHERS = {"contact_damping": -1.0}
# Blocks that have no derivative in a column: a parameter that changes them is refused.
FIXED = ("direction", "along", "multiple", "phase", "depth", "depth_multiple", "depth_phase")


@dataclass(frozen=True, slots=True)
class _Places:
    """Numbers of rows of a layout: the frequency, `SOURCES` and `FIXED`; and of stiffnesses."""

    every: NDArray[np.intp]
    powers: Array  # of `SOURCES`
    walls: NDArray[np.intp]


def with_columns(table: SceneTable, shifts: Shifts) -> tuple[SceneTable, NDArray[np.bool_]]:
    """Return a table of the first n models with columns, and whether these follow each parameter.

    The frequency of the clock is differentiated at fixed phase: the column of a parameter that
    changes it is that of the equation over the phase.

    Parameters
    ----------
    table : SceneTable
        Rows that `shifts` describes.

    Returns
    -------
    table : SceneTable
    is_covered : ndarray of bool, shape (n_columns,)
        False for a parameter that changes a block in `FIXED`, or loads by pieces.
    """
    at, n, (n_columns, *_) = table.at, shifts.n, shifts.weights.shape
    places, rows = _places(at), table.table[:-1]
    with np.errstate(invalid="ignore"):  # walls at infinity
        found = shifts.derivatives(rows[:, places.every]).swapaxes(0, 1)
    found[~np.isfinite(found)] = 0.0
    rates, changes, fixed = np.split(found, [1, 1 + len(places.powers)], axis=2)
    models = rows[:n]
    # the clock of an unforced model may run at any rate
    by_omega = np.asarray(rates.any(axis=(0, 2))) & (not at.is_free)
    if by_omega.any():
        sources = models[:, places.every[1 : 1 + len(places.powers)]]
        scaled = np.where(places.powers, sources, 0.0) * places.powers / models[:, at.omega, None]
        changes[:, by_omega] -= rates[:, by_omega] * scaled[:, None, :]
    is_covered = np.asarray((fixed == 0.0).all(axis=(0, 2)))
    if at.pieces:
        others = rows[n:].reshape(n_columns, -1, n, at.n_rows)
        is_covered &= ~by_omega & [_has_pieces_of(table, models, each) for each in others]
    wider = known(replace(at, columns=n_columns))
    new = np.zeros((n + 1, wider.n_rows))
    new[:n, : at.n_rows], new[n, : at.n_rows] = models, table.table[-1]
    columns = new[:n, at.n_rows :].reshape(n, n_columns, -1)
    columns[..., at.n_states :] = changes
    return replace(table, at=wider, table=new), is_covered


def has_same_walls(table: SceneTable, n: int) -> bool:
    """Whether shifted models have walls with stiffness where the first n models have them."""
    felt = table.table[:-1, _places(table.at).walls] > 0.0
    return bool((felt.reshape(len(felt) // n, *felt[:n].shape) == felt[:n]).all())


@cache
def _places(at: RowLayout) -> _Places:
    every = np.concatenate([_rows(at, name) for name in ("omega", *SOURCES, *FIXED)])
    walls = np.concatenate([_rows(at, name) for name in ("lower_stiffness", "upper_stiffness")])
    of_blocks = _POWERS | (_OF_PLAIN if at.is_plain else _OF_OTHERS)
    powers = np.concatenate([np.full(at.blocks[x], of_blocks.get(x, 0.0)) for x in SOURCES])
    return _Places(every, powers, walls)


def _rows(at: RowLayout, name: str) -> NDArray[np.intp]:
    """Numbers of the rows of a block."""
    return np.arange(at.first[name], at.first[name] + at.blocks[name])


def _has_pieces_of(table: SceneTable, models: Array, rows: Array) -> bool:
    """Whether shifted models, shape (n_shifts, n, n_rows), have the loads by pieces of models."""
    span = [table.at.first_piece, table.at.no_piece]
    for number, model in enumerate(models[:, span].astype(int)):
        for first, last in np.unique(rows[:, number, span].astype(int), axis=0):
            if not np.array_equal(table.pieces[slice(*model)], table.pieces[first:last]):
                return False
    return True
