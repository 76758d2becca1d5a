"""Metrics of every sweep point: amplitude error and class (A4, A9), and costs (A14)."""

import numpy as np

from gapsweep.analysis.agreement.law_tables import NONE as NO_CLASS
from gapsweep.analysis.agreement.law_tables import LawTable
from gapsweep.analysis.dimensions import Array
from gapsweep.response.attractors import NONE


def start_metrics(ours: LawTable, theirs: LawTable, half_gap: float) -> dict[str, Array]:
    """Amplitude error and class agreement of every sweep point, shape (n_omega, n_starts).

    NaN for points without both responses.
    """
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

    Four for a ratio of ratios: of the law and of the exact law. Zero without both responses; times
    are also zero on different machines, and for sweeps if there are fixed initial conditions.
    """
    both = ours.exists & theirs.exists
    # The points of a sweep are computed one by one, in calls with few motions.
    timed = both & (ours.host == theirs.host) & (ours.host != NONE)
    timed &= ours.fixed | ~ours.fixed.any()
    periods, their_periods = (table.t_simulated * table.omega[:, None] for table in (ours, theirs))
    times = [ours.cpu_time, periods, theirs.cpu_time, their_periods]
    contacts = [ours.contacts_per_period, np.ones(both.shape)]
    return {
        "cpu_time_per_period_ratio": np.where(timed[..., None], np.stack(times, axis=-1), 0.0),
        "contacts_per_period": np.where(both[..., None], np.stack(contacts, axis=-1), 0.0),
    }
