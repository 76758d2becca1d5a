"""Tables of systems whose smooth laws Taylor series integrate, for the stepping loop."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.lanes.law_rows import with_law_rows
from gapsweep.integrate.lanes.scene_table import SceneTable

Array = NDArray[np.float64]

_SHORTER = 1e-7  # shortest step over that of the exact law: thin layers need far shorter steps


def smooth_scenes(
    exact: SceneTable,
    laws: Sequence[tuple[int, Array, Array]],
    rows: Sequence[Array],
    pushes: Array,
) -> SceneTable:
    """Return the table of the same systems with smooth laws.

    Parameters
    ----------
    exact : SceneTable
        n systems with located contacts.
    laws : sequence of (int, ndarray, ndarray)
        Law of every contact: its place in `LAWS`, coefficients of a fit's numerator and
        denominator, `in_blocks`; empty for other laws.
    rows : sequence of ndarray, shape (n, N_PARAMETERS)
        Parameter rows of the law of every contact.
    pushes : ndarray, shape (n_contacts, n)
        Moduli of the contact forces per unit mass at rest.
    """
    sizes = tuple((number, top.size, bottom.size) for number, top, bottom in laws)
    at = replace(exact.at, is_located=False, laws=sizes).with_degree(exact.rtol)
    scenes = with_law_rows(exact, at, rows)
    coefficients = np.concatenate([values for _, *fit in laws for values in fit])
    scenes.table[:, at.fit : at.fit + at.blocks["fit"]] = coefficients
    table = scenes.table[:-1].T
    table[at.min_step] *= _SHORTER
    # Without it a motion from rest would have no scale, and no step.
    if at.is_plain:
        table[at.floor] += pushes[0] / (table[at.stiffness] + table[at.omega_rad] ** 2)
    else:
        compliances = table[at.compliance : at.compliance + at.contacts]
        speeds = np.sqrt(compliances) * pushes
        table[at.floor] += speeds.sum(axis=0) / np.sqrt(table[at.fastest])
    return scenes
