"""Selection along one axis: which of the values that it holds are wanted.

One rule of equality for studies, datasets and claims: numbers are one if they are after rounding to
12 significant digits, representations if their canonical labels are, gaps if their distances are.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.model.labels import canonical_representation
from gapsweep.study.points import canonical

_MANY, _ENDS = 8, 3  # values in a message, and of more those at either end


def positions(
    name: str, held: ArrayLike, wanted: Any, of: str = "this dataset"
) -> NDArray[np.int64]:
    """Places of the wanted values on an axis.

    Parameters
    ----------
    name : str
        Of the axis; ``representation`` and ``gap`` hold labels that have more than one spelling.
    held : array_like, shape (n,)
        Its values: numbers or texts.
    wanted : object
        A value, a sequence of values, or of numbers a slice that includes both ends.
    of : str
        Whose axis it is, for messages.

    Returns
    -------
    ndarray of int
        Ascending, each once: all places that hold a wanted value, at least one.

    Raises
    ------
    ValueError
        If a wanted value is not there; one line that names it and what there is.
    """
    axis = np.atleast_1d(np.asarray(held))
    if isinstance(wanted, slice):
        return _within(name, axis, wanted, of)
    places: dict[Any, list[int]] = {}
    for i, value in enumerate(axis.tolist()):
        places.setdefault(_key(name, axis, value), []).append(i)
    found: list[int] = []
    for value in wanted if is_several(wanted) else [wanted]:
        at = places.get(_key(name, axis, value))
        if at is None:
            said = repr(value.item() if hasattr(value, "item") else value)
            raise ValueError(
                f"{name} = {said}: not in {of}, which has {listed(axis)}{_nearest(axis, value)}"
            )
        found += at
    if not found:
        raise ValueError(f"{name} = []: empty; name at least one value")
    return np.unique(np.array(found, dtype=np.int64))


def is_several(wanted: Any) -> bool:
    """Whether a selection names any number of values, not one."""
    if isinstance(wanted, str):
        return False
    return isinstance(wanted, slice | Sequence) or getattr(wanted, "ndim", 0) > 0


def is_numeric(axis: ArrayLike) -> bool:
    """Whether an axis holds numbers, which have ranges; labels have none."""
    return np.asarray(axis).dtype.kind in "iuf"


def _within(name: str, axis: NDArray[Any], wanted: slice, of: str) -> NDArray[np.int64]:
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
    values = np.array([canonical(value) for value in axis.tolist()])
    found = np.flatnonzero((values >= low) & (values <= high))
    if not found.size:
        raise ValueError(
            f"{name} = {low:g} to {high:g}: no values in this range; {of} has {listed(axis)}"
        )
    return found


def _key(name: str, axis: NDArray[Any], value: Any) -> Any:
    """A key that is equal for equal values; None for values that the axis cannot hold."""
    try:
        if is_numeric(axis):
            return canonical(value)
        text = str(value)
        if name == "representation":
            return canonical_representation(text)
        if name == "gap":
            return tuple(canonical(float(distance)) for distance in text.split("/"))
    except (TypeError, ValueError, OverflowError):
        return None if is_numeric(axis) else text
    return text


def _nearest(axis: NDArray[Any], wanted: Any) -> str:
    """The value next to a number that is not there, with all digits that it has."""
    key = _key("", axis, wanted)
    if axis.dtype.kind != "f" or not isinstance(key, float) or not np.isfinite(key):
        return ""
    return f"; the nearest is {axis[np.argmin(np.abs(axis - key))]:.12g}"


def listed(held: ArrayLike) -> str:
    """Values as text, of many the first and last ones."""
    axis = np.atleast_1d(np.asarray(held))
    if axis.size > _MANY:
        return f"{', '.join(as_words(axis[:_ENDS]))}, ..., {', '.join(as_words(axis[-_ENDS:]))}"
    return ", ".join(as_words(axis))


def as_words(held: ArrayLike) -> list[str]:
    """Values as they are printed."""
    values = np.asarray(held).tolist()
    return [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
