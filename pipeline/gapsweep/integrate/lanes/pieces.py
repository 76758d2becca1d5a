"""Loads by pieces: the present polynomial of a point, replaced where a step ends at a knot.

Pieces of all systems are rows of one array: the end of a piece, in periods or in seconds, and
coefficients for every coordinate. The end of the present piece is the end of the motion
to all code that takes steps.
"""

import math

from gapsweep.integrate.jit import internal
from gapsweep.integrate.vectors import fma


@internal
def set_first_piece(at, point, pieces):
    """Begin with the piece in which a motion starts; its clocks are set."""
    point[at.last_cycle], point[at.last_tau] = point[at.end_cycle], point[at.end_tau]
    t = point[at.t_start] if point[at.is_record] > 0.0 else point[at.tau]
    row, last = int(point[at.first_piece]), int(point[at.no_piece]) - 1
    while row < last:
        middle = (row + last) // 2
        if pieces[middle, 0] <= t:
            row = middle + 1
        else:
            last = middle
    _set_piece(at, point, pieces, row)


@internal
def enter_next_piece(at, point, pieces):
    """Begin with the next piece at the end of the present one; False at the end of the motion."""
    if point[at.end_cycle] == point[at.last_cycle] and point[at.end_tau] == point[at.last_tau]:
        return False
    row = int(point[at.this_piece]) + 1
    _set_piece(at, point, pieces, row if row < point[at.no_piece] else int(point[at.first_piece]))
    return True


@internal
def _set_piece(at, point, pieces, row):
    """Set polynomial and end of a piece."""
    point[at.this_piece], end, rate = row, pieces[row, 0], point[at.omega]
    cycle, tau = point[at.cycle], end
    if point[at.is_record] > 0.0:
        turns = point[at.tau_start] + (end - point[at.t_start]) * point[at.omega]
        cycle = math.floor(turns) if math.isfinite(turns) else turns
        tau, rate = turns - cycle if math.isfinite(turns) else 0.0, 1.0
    elif end == 1.0:
        cycle, tau = cycle + 1.0, 0.0
    is_last = cycle > point[at.last_cycle] or (
        cycle == point[at.last_cycle] and tau >= point[at.last_tau]
    )
    if cycle == math.inf:  # after a record
        cycle, tau = point[at.last_cycle], point[at.last_tau]
    point[at.knot_cycle], point[at.knot_tau] = cycle, tau
    point[at.end_cycle] = point[at.last_cycle] if is_last else cycle
    point[at.end_tau] = point[at.last_tau] if is_last else tau
    for i in range(at.n):
        scale = 1.0
        for k in range(at.pieces):
            number = i * at.pieces + k
            point[at.piece + number] = pieces[row, 1 + number] * scale
            scale *= rate


def piece_series(lanes):
    """Emit the Taylor coefficients of the present piece, for each coordinate."""
    n, n_terms = lanes.layout.n, lanes.layout.pieces
    turns = (lanes["tau"] - lanes["knot_tau"]) + lanes["tau_low"]
    since = ((lanes["cycle"] - lanes["knot_cycle"]) + turns) * lanes["period"]
    found = []
    for i in range(n):
        terms = lanes.rows("piece")[i * n_terms : (i + 1) * n_terms]
        for low in range(n_terms - 1):  # Taylor shift by synthetic division
            for k in range(n_terms - 2, low - 1, -1):
                terms[k] = fma(terms[k + 1], since, terms[k])
        found.append(terms)
    return found
