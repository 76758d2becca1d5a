"""What can be said of one contact law from its force alone.

Two samplings, because they answer differently (docs/decisions/0006-static-part.md):
`static_error` on 8001 uniform points is the definition that published errors follow; the
resolved errors here are integrals over the range, which no smoothing layer slips through.
"""

import numpy as np

from gapsweep.model.contact import ContactLaw
from gapsweep.model.equilibria import panels, search_points, sign_changes
from gapsweep.model.oscillator import Gap


def in_gap(gap: Gap, x_max: float) -> tuple[float, float]:
    """The part of the gap that lies in ``±x_max`` [m]."""
    return -min(gap.j_1, x_max), min(gap.j_2, x_max)


def largest_in_gap(law: ContactLaw, x_max: float) -> float:
    """Largest magnitude of the force between the walls [N]; zero for the exact law."""
    low, high = in_gap(law.gap, x_max)
    points = search_points(law, x_max)
    points = points[(points >= low) & (points <= high)]
    peaks, _ = sign_changes(law.derivative, points)
    return float(np.max(np.abs(law.force(np.append(points, peaks)))))


def resolved_rmse(law: ContactLaw, x_max: float) -> tuple[float, float, float]:
    """RMS force error [N] over ``±x_max``, over the gap and over the rest, as integrals.

    NaN for a part that does not exist.
    """
    nodes, weights = panels(search_points(law, x_max))
    error = law.force(nodes) - law.exact.force(nodes)
    low, high = in_gap(law.gap, x_max)
    # No panel straddles a wall: the walls are search points.
    inside = (nodes[:, 2] > low) & (nodes[:, 2] < high)
    squares, lengths = (error**2 * weights).sum(axis=1), weights.sum(axis=1)
    parts = (np.ones_like(inside), inside, ~inside)
    whole, within, rest = (
        float(np.sqrt(squares[part].sum() / lengths[part].sum())) if part.any() else np.nan
        for part in parts
    )
    return whole, within, rest
