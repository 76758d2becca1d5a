"""Attractors continued along an axis: which attractors at neighbouring values are one."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.dimensions import Array
from gapsweep.study.grid import COORDINATE
from gapsweep.study.schema import ATTRACTOR
from gapsweep.variables import Variable

# An attractor continues as one of which peak and trough differ by at most this share of the larger
# modulus of both. Coexisting motions in the gap and with contact differ by more.
_SAME = 0.5
TRACK = Variable("i4", "1", "number of the attractor along {}, -1: none", -1)


def with_tracks(attractors: xr.Dataset, along: str) -> xr.Dataset:
    """Return attractors with `track`: the number of each attractor along an axis, from 0 on.

    Attractors of a case are numbered by their peaks, so that a number may stand for another
    attractor at the next value of a parameter. A track follows an attractor from value to value:
    pairs at neighbouring values are joined, the nearest first, if peaks and troughs differ by at
    most half of the larger modulus. Every other attractor begins a track.

    `attractors`: ``attractors.nc``, or some of it.
    `along`: a dimension with ordered values.
    """
    of_one = (along, ATTRACTOR, *({COORDINATE} & {*attractors["x_max"].dims}))
    ends = [attractors[name].transpose(..., *of_one) for name in ("x_max", "x_min")]
    others = [dim for dim in ends[0].dims if dim not in of_one]
    extremes = np.stack([each.values for each in ends], axis=-1)
    if len(of_one) == 2:
        extremes = extremes[..., None, :]
    found = np.full(extremes.shape[:-2], TRACK.missing, TRACK.dtype)
    for case in np.ndindex(found.shape[:-2]):
        found[case] = _tracks(extremes[case])
    about = TRACK.attributes | {"long_name": TRACK.long_name.format(along)}
    return attractors.assign(track=((*others, along, ATTRACTOR), found, about))


def _tracks(extremes: Array) -> NDArray[np.int32]:
    """Return the numbers of the tracks of one case, shape (n_values, n_attractors).

    `extremes`: shape (n_values, n_attractors, n_coordinates, 2); peaks and troughs; NaN without an
    attractor.
    """
    found, n = np.full(extremes.shape[:2], -1, np.int32), 0
    for value, here in enumerate(extremes):
        if value:
            for before, after in _pairs(extremes[value - 1], here):
                found[value, after] = found[value - 1, before]
        begin = np.isfinite(here).all(axis=(1, 2)) & (found[value] < 0)
        found[value, begin] = n + np.arange(begin.sum())
        n += int(begin.sum())
    return found


def _pairs(before: Array, after: Array) -> list[tuple[int, int]]:
    """Return pairs of attractors at neighbouring values that are one, the nearest first."""
    sizes = [np.abs(each).max(axis=-1) for each in (before, after)]
    reach = np.maximum(sizes[0][:, None], sizes[1])
    apart = np.abs(before[:, None] - after).max(axis=-1)
    # A coordinate that does not move in either motion is the same in both.
    share = np.divide(apart, reach, out=np.zeros_like(apart), where=reach != 0.0).max(axis=-1)
    share, pairs = np.where(share <= _SAME, share, np.inf), list[tuple[int, int]]()
    while share.size and np.isfinite(share.min()):
        i, j = np.unravel_index(share.argmin(), share.shape)
        pairs.append((int(i), int(j)))
        share[i], share[:, j] = np.inf, np.inf
    return pairs
