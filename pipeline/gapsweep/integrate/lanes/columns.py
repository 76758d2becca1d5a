"""Parameter columns of a table of models: derivatives of its rows by parameters."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .row_layout import SOURCES, RowLayout, known
from .scene_table import SceneTable

Array = NDArray[np.float64]

# Powers of the angular frequency by which the blocks of `SOURCES` are divided in the equation
# over the phase of the forcing.
_POWERS = {
    **dict.fromkeys(("stiffness", "lag_force", "pull", "cubic", "push"), 2.0),
    **dict.fromkeys(("damping", "of_place", "of_lag"), 1.0),
}
# Powers for contacts: of a plain oscillator per unit mass, of others times a row of `pull`.
_OF_PLAIN = {"lower_stiffness": 2.0, "upper_stiffness": 2.0, "contact_damping": 1.0}
_OF_OTHERS = {"contact_damping": -1.0}
# Blocks that have no derivative in a column: a parameter that changes them is refused.
FIXED = ("direction", "along", "multiple", "phase", "depth", "depth_multiple", "depth_phase")


def with_columns(
    table: SceneTable, shifted: SceneTable, weights: Array, by_omega: NDArray[np.bool_]
) -> tuple[SceneTable, NDArray[np.bool_]]:
    """Return a table with parameter columns, and whether the equation follows each parameter.

    Parameters
    ----------
    table : SceneTable
        n models.
    shifted : SceneTable
        The models with shifted parameters: for every parameter, shift and model, in this order.
    weights : ndarray, shape (n_columns, n_shifts, n)
        Weights of the shifted values in the derivative by each parameter.
    by_omega : ndarray of bool, shape (n_columns,)
        Whether the parameter is the frequency of the clock [Hz]. A derivative by it holds the
        phase, so that the column is that of the equation over the phase.

    Returns
    -------
    table : SceneTable
    is_covered : ndarray of bool, shape (n_columns,)
        False for a parameter that changes a block in `FIXED`, or loads by pieces.
    """
    at, (n_columns, _, n) = table.at, weights.shape
    rows = shifted.table[:-1].reshape(*weights.shape, -1)
    places = np.concatenate([_rows(at, name) for name in SOURCES])
    with np.errstate(invalid="ignore"):  # walls at infinity
        changes = np.einsum("csp,cspr->pcr", weights, rows[..., places])
    changes[~np.isfinite(changes)] = 0.0
    of_blocks = _POWERS | (_OF_PLAIN if at.is_plain else _OF_OTHERS)
    powers = np.concatenate([np.full(at.blocks[x], of_blocks.get(x, 0.0)) for x in SOURCES])
    models, omega = table.table[:-1], table.table[:-1, at.omega]
    scaled = np.where(powers, models[:, places], 0.0) * powers / omega[:, None]
    changes[:, by_omega] -= scaled[:, None, :]
    fixed = np.concatenate([_rows(at, name) for name in FIXED])
    is_covered = (rows[..., fixed] == models[None, None, :, fixed]).all(axis=(1, 2, 3))
    if at.pieces:
        is_covered &= ~by_omega & [_has_pieces_of(table, shifted, each) for each in rows]
    wider = known(replace(at, columns=n_columns))
    found = np.zeros((len(table.table), wider.n_rows))
    found[:, : at.n_rows] = table.table
    columns = found[:-1, at.n_rows :].reshape(n, n_columns, -1)
    columns[..., at.n_states :] = changes
    return replace(table, at=wider, table=found), is_covered


def _rows(at: RowLayout, name: str) -> NDArray[np.intp]:
    """Numbers of the rows of a block."""
    return np.arange(at.first[name], at.first[name] + at.blocks[name])


def _has_pieces_of(table: SceneTable, shifted: SceneTable, rows: Array) -> bool:
    """Whether shifted models, shape (n_shifts, n, n_rows), have the loads by pieces of a table."""
    span = [table.at.first_piece, table.at.no_piece]
    for number, model in enumerate(table.table[:-1, span].astype(int)):
        for first, last in np.unique(rows[:, number, span].astype(int), axis=0):
            if not np.array_equal(table.pieces[slice(*model)], shifted.pieces[first:last]):
                return False
    return True
