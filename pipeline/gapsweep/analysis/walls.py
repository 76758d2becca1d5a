"""Whether any motion of a study comes near a wall."""

from collections.abc import Callable
from typing import Any

import numpy as np

# Walls so many times as far away as any motion leads: their distances must be of another unit.
_FAR = 10.0


def far_walls(values: Callable[[str], Any]) -> str:
    """That no motion comes near a wall, as where a gap is given in millimetres; else nothing.

    Parameters
    ----------
    values : callable
        From the name of a variable of ``responses.nc`` to its values.
    """
    x, walls = (
        np.abs(np.concatenate([np.ravel(values(name)) for name in names]))
        for names in (("x_min", "x_max"), ("j_1", "j_2"))
    )
    largest = np.max(x, initial=0.0, where=np.isfinite(x))
    if not (walls.size and 0.0 < _FAR * largest < walls.min()):
        return ""
    return (
        f"no motion comes near a wall: the largest displacement is {1e3 * largest:.3g} mm, the "
        f"nearest wall stands at {1e3 * walls.min():.3g} mm; gaps are in metres, as 4e-4"
    )
