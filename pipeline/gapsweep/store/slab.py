"""Results of up to 128 points of one kind, in the form in which they are stored.

Columns and lists of numbers are concatenated and compressed together: values that are equal,
missing, or both in a column and in a list take almost no space.
"""

import json
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.structure import read_structure
from gapsweep.response.result import LISTS, Responses, columns_of
from gapsweep.status import Status
from gapsweep.study.points import KEY, Kind

# Points in a slab: few, so that damage loses little and reading one point reads little.
SLAB = 128
_MOST_BYTES = 2**24  # bytes of a point: 65,536 extrema of 16 coordinates, kinds, the section
MOST_COLUMNS = SLAB * _MOST_BYTES  # bytes of the columns of a slab
_LEVEL = 1  # level of compression: higher levels take longer and save little


@dataclass(frozen=True, slots=True)
class Slab:
    """Stored results of up to 128 points of one kind."""

    identity: str  # identity of the points' `Kind`, as JSON
    keys: bytes  # their content keys, 32 bytes each
    status: bytes  # their `Status`, a byte each
    columns: bytes  # the points' numbers and their responses
    messages: str  # JSON: messages by number of the point
    seconds: float  # CPU time of all points together, as far as it was measured
    host: str  # machine that computed them
    versions: str  # versions of Python and the libraries on that machine

    @property
    def kind(self) -> Kind:
        """The kind of its points; see `Kind.of`."""
        return Kind.of(self.identity)

    @property
    def n_points(self) -> int:
        return len(self.status)

    @property
    def n_failed(self) -> int:
        return sum(status > Status.OUT_OF_FIT_RANGE for status in self.status)


class Stored(NamedTuple):
    """Contents of a slab: keys of the preceding points (or zero), numbers, responses."""

    previous: NDArray[np.void]
    numbers: NDArray[np.float64]
    responses: Responses


def slabs(
    identity: str,
    numbers: NDArray[np.float64],
    keys: NDArray[np.void],
    previous: NDArray[np.void],
    responses: Responses,
    host: str,
    versions: str,
) -> Iterator[Slab]:
    """Slabs of up to 128 points each with these responses; arguments as in `Slab` and `Stored`."""
    for first in range(0, len(numbers), SLAB):
        rows = np.arange(first, min(first + SLAB, len(numbers)))
        part = responses.take(rows)
        yield Slab(
            identity,
            keys[rows].tobytes(),
            part.columns["status"].astype("i1").tobytes(),
            _packed(previous[rows], numbers[rows], part),
            json.dumps({str(row): text for row, text in part.messages.items()}),
            float(np.nansum(part.columns["cpu_time"])),
            host,
            versions,
        )


def stored(slab: Slab) -> Stored:
    """Decode the contents of a slab.

    Raises `ValueError` if the slab is not in the form in which a run writes it.
    """
    try:
        n, at, unpacking = slab.n_points, 0, zlib.decompressobj()
        # Limits the memory for data that no run has written.
        data = unpacking.decompress(slab.columns, _MOST_BYTES * n)
        if not unpacking.eof or unpacking.unused_data:
            raise ValueError("its columns differ in length")

        def column(dtype: str, size: int) -> NDArray[Any]:
            nonlocal at
            found = np.frombuffer(data, f"<{dtype}", size, at)
            at += found.nbytes
            return found

        previous = np.frombuffer(column("i1", KEY.itemsize * n), KEY)
        identity = json.loads(slab.identity)
        names, structure = identity["numbers"], read_structure(identity["kind"]["structure"])
        numbers = np.stack([column("f8", n) for _ in names], axis=1)
        columns = {
            name: column(dtype, n * math.prod(shape)).reshape(n, *shape)
            for name, (dtype, shape) in columns_of(structure).items()
        }
        counts = {name: column("i4", n).astype(np.int64) for name in LISTS}
        if min(count.min() for count in counts.values()) < 0:
            raise ValueError("a list has a negative length")
        lists = {
            name: (column(LISTS[name], int(counts[name].sum())), counts[name]) for name in LISTS
        }
        status = columns["status"]
        is_known = bool(np.all((status >= 0) & (status <= max(Status))))
        if at != len(data) or status.tobytes() != slab.status or not is_known:
            raise ValueError("its columns differ in length")
        messages = {int(row): str(text) for row, text in json.loads(slab.messages).items()}
        return Stored(previous, numbers, Responses(columns, lists, messages))
    except (zlib.error, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{type(error).__name__}: {error}") from None


def _packed(
    previous: NDArray[np.void], numbers: NDArray[np.float64], responses: Responses
) -> bytes:
    parts: list[NDArray[Any]] = [previous, numbers.T.astype("<f8")]
    parts += [column.astype(f"<{column.dtype.str[1:]}") for column in responses.columns.values()]
    parts += [responses.lists[name][1].astype("<i4") for name in LISTS]
    parts += [responses.lists[name][0].astype(f"<{LISTS[name]}") for name in LISTS]
    return zlib.compress(b"".join(part.tobytes() for part in parts), _LEVEL)
