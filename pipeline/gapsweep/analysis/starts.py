"""Start by start: how far two steady responses are apart (A4, A6, A7, A9, A13), and costs (A14)."""

import numpy as np

from gapsweep.analysis.arrays import Array, Bools, Ints
from gapsweep.analysis.classes import NONE as NO_CLASS
from gapsweep.analysis.distances import hausdorff_in_plane, hausdorff_on_line, wasserstein
from gapsweep.analysis.slab import Slab
from gapsweep.response.attractors import NONE

# Of a chaotic section: one outlier rules the full Hausdorff distance.
PARTIAL = 0.95
# A Lyapunov exponent has a sign if it is this many standard errors from zero.
_SURE = 3.0


def start_metrics(
    ours: Slab, theirs: Slab, half_gap: float, *, symmetric: bool
) -> dict[str, Array]:
    """Metrics of every sweep point, shape (n_omega, n_starts); NaN where nothing is compared."""
    both = ours.exists & theirs.exists
    w, s = np.nonzero(both)
    asked = (ours.class_number != NO_CLASS) & (theirs.class_number != NO_CLASS)
    values = {
        "amplitude_error": np.abs(ours.amplitude - theirs.amplitude)[w, s]
        / np.maximum(theirs.amplitude[w, s], half_gap),
        **_extrema_metrics(ours.extrema[w, s], theirs.extrema[w, s], symmetric=symmetric),
        **_section_metrics(ours, theirs, (w, s), symmetric=symmetric),
    }
    tables = {name: np.full(both.shape, np.nan) for name in values}
    for name, cells in values.items():
        tables[name][w, s] = cells
    same = ours.class_number == theirs.class_number
    tables["class_agreement"] = np.where(asked, same, np.nan)
    return tables | _exponent_metrics(ours, theirs, both)


def _extrema_metrics(ours: Array, theirs: Array, *, symmetric: bool) -> dict[str, Array]:
    metrics = {"extrema_distance": hausdorff_on_line, "extrema_w1": wasserstein}
    values = {name: distance(ours, theirs) for name, distance in metrics.items()}
    if symmetric:
        for name, distance in metrics.items():
            values[name] = np.fmin(values[name], distance(ours, -theirs))
    return values


def _section_metrics(
    ours: Slab, theirs: Slab, at: tuple[Ints, Ints], *, symmetric: bool
) -> dict[str, Array]:
    """Distances of sections; for symmetric gaps to the nearer of response and mirror image.

    The section of an image is half a forcing period away and in no file, but where some start
    ends on the image it is that attractor's section.
    """
    periodic = (ours.periodic & theirs.periodic)[at]
    p, q = ours.section[at], theirs.section[at]
    rows = np.arange(len(periodic))
    compared = [(rows, p, q)]
    if symmetric:
        for slab in (ours, theirs):
            have, image = _images(slab, at)
            pair = (image, q[have]) if slab is ours else (p[have], image)
            compared.append((rows[have], *pair))
    values = {name: np.full(len(rows), np.nan) for name in ("section_w1", "section_distance")}
    for some, a, b in compared:
        distance = np.full(len(some), np.nan)
        for share, chosen in ((1.0, periodic[some]), (PARTIAL, ~periodic[some])):
            distance[chosen] = hausdorff_in_plane(a[chosen], b[chosen], share)
        found = {"section_w1": wasserstein(a[..., 0], b[..., 0]), "section_distance": distance}
        for name, new in found.items():
            values[name][some] = np.fmin(values[name][some], new)
    return values


def _images(slab: Slab, at: tuple[Ints, Ints]) -> tuple[Bools, Array]:
    """Which responses have a mirror image among the attractors found, and its section."""
    w, own = at[0], slab.attractor[at]
    image = np.where(own == NONE, NONE, slab.found.mirror_of[w, own])
    have = (image != NONE) & (image != own)
    return have, slab.found.section[w[have], image[have]]


def _exponent_metrics(ours: Slab, theirs: Slab, both: Bools) -> dict[str, Array]:
    known = both & ~np.isnan(ours.lyapunov) & ~np.isnan(theirs.lyapunov)
    finite = known & np.isfinite(ours.lyapunov) & np.isfinite(theirs.lyapunov)
    with np.errstate(invalid="ignore"):
        difference = ours.lyapunov - theirs.lyapunov
        error = np.hypot(ours.lyapunov_error, theirs.lyapunov_error)
        signs = [
            np.sign(slab.lyapunov) * (np.abs(slab.lyapunov) > _SURE * slab.lyapunov_error)
            for slab in (ours, theirs)
        ]
    return {
        "lyapunov_difference": np.where(finite, difference, np.nan),
        "lyapunov_difference_error": np.where(finite, error, np.nan),
        "lyapunov_sign_agreement": np.where(known, signs[0] == signs[1], np.nan),
    }


def cost_sums(ours: Slab, theirs: Slab) -> dict[str, Array]:
    """Numerators and denominators of cost ratios, shape (n_omega, n_starts, 2 or 4).

    Four for a ratio of ratios: ours and the exact law's. Zero where a response is missing, and
    for times where they come from different machines, or from sweeps if there are fixed starts.
    """
    both = ours.exists & theirs.exists
    # The points of a sweep wait for each other: their time is that of calls with few motions.
    timed = both & (ours.host == theirs.host) & (ours.host != NONE)
    timed &= ours.fixed | ~ours.fixed.any()
    own, exact = ours.costs, theirs.costs
    periods, their_periods = (
        slab.costs["t_simulated"] * slab.omega[:, None] for slab in (ours, theirs)
    )
    tried = own["n_steps"] + own["n_rejected"]
    ratios = {
        "cpu_time_per_period": (own["cpu_time"], periods, timed),
        "cpu_time_per_period_ratio": (
            *(own["cpu_time"], periods, exact["cpu_time"], their_periods),
            timed,
        ),
        "nfev_per_period": (own["nfev"], periods, both),
        "n_contacts_per_period": (own["n_contacts"], periods, both),
        "rejected_share": (own["n_rejected"], tried, both),
    }
    return {
        name: np.where(where[..., None], np.stack(sums, axis=-1), 0.0)
        for name, (*sums, where) in ratios.items()
    }
