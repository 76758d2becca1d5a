"""Selection of values along one axis of a study or a dataset.

One rule of equality for studies, datasets and claims: numbers are equal if they are after rounding
to 12 significant digits, representations if their canonical labels are, gaps if their distances
are.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.model.labels import Representation
from gapsweep.quantities import without_units
from gapsweep.variables import canonical, canonical_values

_MANY, _ENDS = 8, 3  # most values in a message; of more values, the number at either end


def positions(
    name: str, held: ArrayLike, wanted: Any, of: str = "this dataset"
) -> NDArray[np.int64]:
    """Return the positions of the wanted values on an axis.

    Raises `ValueError` if the axis lacks a wanted value; one line with that value and the values of
    the axis.

    `name`: name of the axis; ``representation`` and ``gap`` have labels with more than one
    spelling.
    `held`: shape (n,); values of the axis: numbers or texts.
    `wanted`: a value, a sequence of values, or for numbers a slice that includes both ends.
    `of`: owner of the axis, for messages.
    Result: all positions with a wanted value, ascending, each once; at least one.
    """
    axis = np.atleast_1d(np.asarray(held))
    if is_numeric(axis):  # a label may look like a quantity, as "+0.4 mm"
        wanted = without_units(name, wanted)
    if isinstance(wanted, slice):
        return _within(name, axis, wanted, of)
    places: dict[Any, list[int]] = {}
    for i, value in enumerate(axis.tolist()):
        places.setdefault(_key(name, axis, value), []).append(i)
    found: list[int] = []
    for value in wanted if is_several(wanted) else [wanted]:
        at = places.get(_key(name, axis, value))
        if at is None:
            shown = repr(value.item() if hasattr(value, "item") else value)
            raise ValueError(
                f"{name} = {shown}: not in {of}, which has {listed(axis)}{_nearest(axis, value)}"
            )
        found += at
    if not found:
        raise ValueError(f"{name} = []: empty; name at least one value")
    return np.unique(np.array(found, dtype=np.int64))


def numbers_of_sweeps(wanted: Any, kinds: Sequence[str]) -> Any:
    """Return selected initial conditions with numbers for the names of sweeps.

    `wanted`: numbers, or ``"sweep_up"`` and ``"sweep_down"``, or a sequence of both.
    `kinds`: ``fixed`` or the name of the sweep, for each initial condition.
    """
    if is_several(wanted) and not isinstance(wanted, slice):
        return [numbers_of_sweeps(each, kinds) for each in wanted]
    is_name = isinstance(wanted, str) and [*kinds].count(wanted) == 1
    return [*kinds].index(wanted) if is_name else wanted


def is_several(wanted: Any) -> bool:
    """Whether a selection is a slice or a sequence of values, not a single value."""
    if isinstance(wanted, str):
        return False
    return isinstance(wanted, slice | Sequence) or getattr(wanted, "ndim", 0) > 0


def is_numeric(axis: ArrayLike) -> bool:
    """Whether an axis holds numbers, which have ranges; labels have none."""
    return np.asarray(axis).dtype.kind in "iuf"


def _within(name: str, axis: NDArray[Any], wanted: slice, of: str) -> NDArray[np.int64]:
    wanted = slice(*without_units(name, [wanted.start, wanted.stop, wanted.step]))
    if wanted.step is not None:
        raise ValueError(f"{name} = {wanted}: must be a slice without a step")
    if wanted == slice(None):
        return np.arange(axis.size)
    if not is_numeric(axis):
        raise ValueError(f"{name} = {wanted}: must be a label or a list of labels")
    try:
        low = -np.inf if wanted.start is None else canonical(wanted.start)
        high = np.inf if wanted.stop is None else canonical(wanted.stop)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} = {wanted}: the ends must be numbers") from None
    values = canonical_values(axis)
    found = np.flatnonzero((values >= low) & (values <= high))
    if not found.size:
        raise ValueError(
            f"{name} = {low:g} to {high:g}: no values in this range; {of} has {listed(axis)}"
        )
    return found


def _key(name: str, axis: NDArray[Any], value: Any) -> Any:
    """Return a key that is equal for equal values; None for values that the axis cannot have."""
    try:
        if is_numeric(axis):
            return canonical(value)
        text = str(value)
        if name == "representation":
            return Representation.parsed(text)
        if name == "gap":
            return tuple(canonical(float(distance)) for distance in text.split("/"))
    except (TypeError, ValueError, OverflowError):
        return None if is_numeric(axis) else text
    return text


def _nearest(axis: NDArray[Any], wanted: Any) -> str:
    """Return the words "the nearest is ..." with the axis value nearest to a missing number."""
    key = _key("", axis, wanted)
    if axis.dtype.kind != "f" or not isinstance(key, float) or not np.isfinite(key):
        return ""
    return f"; the nearest is {axis[np.argmin(np.abs(axis - key))]:.12g}"


def listed(held: ArrayLike) -> str:
    """Return values as text; if there are many, the first and last ones."""
    axis = np.atleast_1d(np.asarray(held))
    if axis.size > _MANY:
        return f"{', '.join(as_words(axis[:_ENDS]))}, ..., {', '.join(as_words(axis[-_ENDS:]))}"
    return ", ".join(as_words(axis))


def as_words(held: ArrayLike) -> list[str]:
    """Return values as they are printed."""
    values = np.asarray(held).tolist()
    return [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
