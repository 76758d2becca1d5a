"""Metrics of every sweep point: amplitude error and class (A4, A9), and costs (A14)."""

import numpy as np

from gapsweep.analysis.agreement.law_tables import NONE as NO_CLASS
from gapsweep.analysis.agreement.law_tables import LawTable
from gapsweep.analysis.dimensions import Array
from gapsweep.response.attractors import NONE


def start_metrics(ours: LawTable, theirs: LawTable, half_gap: float) -> dict[str, Array]:
    """Metrics of every sweep point, shape (n_omega, n_starts); NaN where nothing is compared."""
    both = ours.exists & theirs.exists
    asked = (ours.class_number != NO_CLASS) & (theirs.class_number != NO_CLASS)
    error = np.abs(ours.amplitude - theirs.amplitude) / np.maximum(theirs.amplitude, half_gap)
    same = ours.class_number == theirs.class_number
    return {
        "amplitude_error": np.where(both, error, np.nan),
        "class_agreement": np.where(asked, same, np.nan),
    }


def cost_sums(ours: LawTable, theirs: LawTable) -> dict[str, Array]:
    """Numerators and denominators of cost ratios, shape (n_omega, n_starts, 2 or 4).

    Four for a ratio of ratios: ours and the exact law's. Zero where a response is missing, and
    for times where they come from different machines, or from sweeps if there are fixed starts.
    """
    both = ours.exists & theirs.exists
    # The points of a sweep wait for each other: their time is that of calls with few motions.
    timed = both & (ours.host == theirs.host) & (ours.host != NONE)
    timed &= ours.fixed | ~ours.fixed.any()
    periods, their_periods = (table.t_simulated * table.omega[:, None] for table in (ours, theirs))
    times = [ours.cpu_time, periods, theirs.cpu_time, their_periods]
    contacts = [ours.n_contacts, periods]
    return {
        "cpu_time_per_period_ratio": np.where(timed[..., None], np.stack(times, axis=-1), 0.0),
        "n_contacts_per_period": np.where(both[..., None], np.stack(contacts, axis=-1), 0.0),
    }
