"""Bands of the bifurcation diagram, as pixels (A8)."""

import numpy as np

from gapsweep.analysis.arrays import Array, Bools, Ints
from gapsweep.analysis.slab import Slab

# Pixels across the gap.
FINENESS = 100
# What is farther out than a hundred gap widths is in the last pixel.
_FARTHEST = 100 * FINENESS


def band_metrics(ours: Slab, theirs: Slab, width: float, *, symmetric: bool) -> dict[str, Array]:
    """Jaccard index of the pixels that steady extrema occupy, at every frequency.

    Pixels are G/100 high, with one centred at zero; those of all starts that have a response
    in both are put together, with their mirror images if the gap is symmetric.
    """
    both = ours.exists & theirs.exists
    pixels = [_pixels(slab.extrema, both, width, symmetric=symmetric) for slab in (ours, theirs)]
    reach = max((int(np.abs(height).max(initial=0)) for _, height in pixels), default=0) + 1
    pictures = [_picture(of, len(ours.omega), reach) for of in pixels]
    wide = [picture | _moved(picture, 1) | _moved(picture, -1) for picture in pictures]
    n_both = sum(picture.sum(axis=1) for picture in pictures)
    indices = {}
    for name, (a, b) in (("band_jaccard", pictures), ("band_jaccard_tolerant", wide)):
        hits = 0.5 * ((pictures[0] & b).sum(axis=1) + (pictures[1] & a).sum(axis=1))
        with np.errstate(invalid="ignore"):
            indices[name] = np.asarray(hits / (n_both - hits))
    return indices


def _pixels(extrema: Array, both: Bools, width: float, *, symmetric: bool) -> tuple[Ints, Ints]:
    """Frequency and height of all occupied pixels, some of them several times."""
    w, s = np.nonzero(both)
    cells = extrema[w, s]
    i, e = np.nonzero(np.isfinite(cells))
    height = np.clip(np.rint(cells[i, e] / (width / FINENESS)), -_FARTHEST, _FARTHEST)
    w, heights = w[i], height.astype(np.int64)
    if symmetric:
        w, heights = np.tile(w, 2), np.concatenate([heights, -heights])
    return w, heights


def _picture(pixels: tuple[Ints, Ints], size: int, reach: int) -> Bools:
    picture = np.zeros((size, 2 * reach + 1), dtype=bool)
    picture[pixels[0], pixels[1] + reach] = True
    return picture


def _moved(picture: Bools, by: int) -> Bools:
    # The outermost pixels are empty, so nothing comes in at the other end.
    return np.roll(picture, by, axis=1)
