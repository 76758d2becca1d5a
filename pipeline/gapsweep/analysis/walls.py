"""Whether any motion of a study comes near a wall."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.model import own_law
from gapsweep.study.study import Study

# Walls so many times as far away as any motion leads: their distances must be of another unit.
_FAR = 10.0


def far_walls(values: Callable[[str], Any]) -> str:
    """That no motion comes near a wall, as where a gap is given in millimetres; else nothing.

    Parameters
    ----------
    values : callable
        From the name of a variable of ``responses.nc`` to its values.
    """
    largest = max(_largest(np.asarray(values(name))) for name in ("x_min", "x_max"))
    nearest = min(np.min(np.abs(values(name)), initial=np.inf) for name in ("j_1", "j_2"))
    if not 0.0 < _FAR * largest < nearest < np.inf:
        return ""
    return (
        f"no motion comes near a wall: the largest displacement is {1e3 * largest:.3g} mm, the "
        f"nearest wall stands at {1e3 * nearest:.3g} mm; gaps are in metres, as 4e-4"
    )


def wrong_tables(study: Study) -> Iterator[str]:
    """Warnings of force tables that end before any wall, or a thousand times beyond all walls."""
    walls = [wall for gap in study.grid.gaps for wall in (gap.j_1, gap.j_2) if wall]
    for label in study.own_laws if walls else ():
        with suppress(ModelError):  # of a law that cannot be used: reported where it is used
            ends = [abs(end) for end in getattr(own_law.named(label), "valid_range", ()) if end]
            if ends and (max(ends) < min(walls) or min(ends) > 1e3 * max(walls)):
                yield (
                    f"{label}: the force table reaches x = {max(ends):g}, the walls of the study "
                    f"are at {min(walls):g} to {max(walls):g}: give both in metres"
                )


def untouched(values: Callable[[str], Any], contacts: Sequence[str]) -> str:
    """That no steady motion of a system reaches a wall of some contact; else nothing.

    Parameters
    ----------
    values : callable
        From the name of a variable of ``responses.nc`` to its values, contacts along the last axis.
    contacts : sequence of str
        Their names, in this order.
    """
    if not contacts:
        return ""
    share = np.asarray(values("contact_share")).reshape(-1, len(contacts))
    known = np.isfinite(share)
    is_touched = share.max(axis=0, initial=0.0, where=known) > 0.0
    names = [name for name, is_one in zip(contacts, is_touched, strict=True) if not is_one]
    largest = max(_largest(np.asarray(values(name))) for name in ("x_min", "x_max"))
    if not names or not known.any() or not largest:
        return ""
    return (
        f"no steady motion reaches a wall of {', '.join(names)}: the largest coordinate is "
        f"{largest:.3g}; gaps are in the unit of the coordinates"
    )


def _largest(x: NDArray[np.float64]) -> float:
    """Largest modulus that is finite; without a copy, for there may be 10^7."""
    known = np.isfinite(x)
    return float(max(x.max(initial=0.0, where=known), -x.min(initial=0.0, where=known)))
