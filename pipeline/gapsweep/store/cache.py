"""The point cache: a folder of segment files, with a slab of results in every frame.

All NetCDF files can be rebuilt from the cache. Every point has a content key, a hash of all that
its result depends on, including the fingerprint of the code. Any number of processes and hosts
may write at once, without locks: a file is never changed, and removed only when its intact frames
are in another one. Two results of one point are harmless. A frame that fails its checksum is
never returned; gapsweep recomputes its points.
"""

import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import StoreError
from gapsweep.model.structure import AnyStructure, OscillatorStructure
from gapsweep.response.result import Responses
from gapsweep.store.index import MISSING, Held, Index
from gapsweep.store.segments import SUFFIX, Frame, digest_of, packed, read, scan, write
from gapsweep.store.slab import Slab, Stored, stored
from gapsweep.study.points import KEY

_OSCILLATOR = OscillatorStructure()
_LARGE = 4e6  # bytes of a segment that is left as it is
_OFTEN = 32  # commits until small segments are merged
_KEPT = 64  # decoded slabs: neighbouring points are read together


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The results that are stored at some places."""

    at: NDArray[np.intp]  # shape (n,); positions of their places in the request, ascending
    responses: Responses
    host: NDArray[np.str_]  # shape (n,); machine that computed each
    versions: frozenset[str]  # versions of Python and the libraries, as text


_Contents = tuple[Slab, Stored, NDArray[np.intp], NDArray[np.uint8]]


class Cache:
    """The point cache in a folder; the end of a ``with`` block releases its index from memory.

    Parameters
    ----------
    path : path-like
        The folder; created if it does not exist.
    read_only : bool
        Whether to open without creating the folder.

    Attributes
    ----------
    damaged : set of Path
        Segments in which damage has been found so far.

    Raises
    ------
    StoreError
        If the folder cannot be created or read, or is a file.
    """

    def __init__(self, path: str | Path, *, read_only: bool = False) -> None:
        self.path = Path(path)
        if self.path.exists() and not self.path.is_dir():
            raise StoreError(
                f"{self.path}: must be a folder, is a file (of an earlier version?); "
                "choose a folder with --cache"
            )
        with _store_errors(self.path):
            if not read_only:
                self.path.mkdir(parents=True, exist_ok=True)
        self.damaged: set[Path] = set()
        self._index = Index()
        self._frames: list[Frame] = []  # index: number of the slab
        self._numbers: dict[bytes, int] = {}
        self._scanned: dict[Path, bool] = {}  # scanned segments, and whether they have frames
        self._newest = 0  # largest serial number of a frame
        self._n_commits = 0
        self._contents = lru_cache(maxsize=_KEPT)(self._decoded)
        self._refresh()

    def __enter__(self) -> "Cache":
        return self

    def __exit__(self, *_: object) -> None:
        del self._contents  # a reference cycle, which would keep the index in memory

    @property
    def n_points(self) -> int:
        """Number of stored results; a point computed twice counts twice."""
        self._refresh()
        return sum(frame.n_points for frame in self._frames)

    def recorded(self, keys: NDArray[np.void]) -> Held:
        """Slab, row and status of each key, as of `held`, without a check of the results."""
        self._refresh()
        return self._index.find(keys)

    def held(self, keys: NDArray[np.void]) -> Held:
        """Slab, row and status of each key; -1 and `MISSING` without a result or a sound one."""
        held = self.recorded(keys)
        slabs = np.unique(held["slab"][held["slab"] >= 0]).tolist()
        lost = [number for number in slabs if self._read(number) is None]
        held[np.isin(held["slab"], lost)] = np.array((-1, 0, MISSING, -1), held.dtype)
        return held

    def is_in(self, places: Held, digests: Collection[bytes]) -> NDArray[np.bool_]:
        """Mask of places, as of `held`, in frames with some of these checksums."""
        slabs, rows = np.unique(places["slab"], return_inverse=True)
        is_there = [n >= 0 and self._frames[n].digest in digests for n in slabs.tolist()]
        return np.array(is_there, bool)[rows]

    def found(self, places: NDArray[np.void], structure: AnyStructure = _OSCILLATOR) -> Found:
        """Stored results at places, as of `held`, of one structure.

        Damaged results are left out, as if missing. Raises `StoreError` if a frame is as it was
        written, but holds no result.
        """
        at, parts, hosts, versions = [], [], [], set()
        for slab, contents, asked, rows in self._contents_of(places):
            at.append(asked)
            parts.append(contents.responses.take(rows))
            hosts.append(np.full(len(asked), slab.host))
            versions.add(slab.versions)
        if not at:
            nothing = Responses.of((), structure)
            return Found(np.empty(0, np.intp), nothing, np.empty(0, str), frozenset())
        order = np.argsort(np.concatenate(at), kind="stable")
        return Found(
            np.concatenate(at)[order],
            Responses.concatenated(parts).take(order),
            np.concatenate(hosts)[order],
            frozenset(versions),
        )

    def place(self, key: NDArray[np.void]) -> tuple[Slab, Stored, int] | None:
        """The slab that holds a key, its contents, and the key's row in it; None if not stored."""
        for slab, contents, _, rows in self._places(key):
            return slab, contents, int(rows[0])
        return None

    def origins(self, keys: NDArray[np.void]) -> tuple[NDArray[np.void], NDArray[np.bool_]]:
        """Keys of the points from whose end each result started, and whether it has an end state.

        Zero and True for keys that are not stored.
        """
        origins, has_end = np.zeros(len(keys), KEY), np.ones(len(keys), bool)
        for _, contents, asked, rows in self._places(keys):
            origins[asked] = contents.previous[rows]
            has_end[asked] = contents.responses.has_end[rows]
        return origins, has_end

    def seconds(self, places: NDArray[np.void]) -> NDArray[np.float64]:
        """CPU time [s] of the result at each place, the mean of its slab; NaN without a result."""
        # The last entry is for keys that are not stored.
        seconds = np.array([*(frame.seconds / frame.n_points for frame in self._frames), np.nan])
        return np.asarray(seconds[places["slab"]])

    def checksums(self, places: NDArray[np.void]) -> Iterator[bytes]:
        """Bytes that identify the results at places: checksums of slabs, then positions."""
        # In an order that the numbers of slabs, which follow the names of files, do not change.
        for number, asked in sorted(_grouped(places["slab"]), key=lambda found: found[1][0]):
            yield self._frames[number].digest
            yield asked.tobytes() + places["row"][asked].tobytes()

    def commit(self, slabs: Sequence[Slab]) -> list[bytes]:
        """Write slabs to a new segment, all or none, and return the checksums of their frames.

        Small segments are merged now and then.
        """
        self._refresh()
        frames = [packed(slab, self._newest + 1) for slab in slabs]
        with _store_errors(self.path):
            write(self.path, frames)
        self._n_commits += 1
        if self._n_commits % _OFTEN == 0:
            self.merge()
        return list(map(digest_of, frames))

    def merge(self) -> None:
        """Merge the intact frames of small and of damaged segments into one segment."""
        self._refresh()
        # A segment without a readable frame may be of another version.
        paths = {path for path, is_ours in self._scanned.items() if is_ours}
        try:
            small = {path for path in paths if path.stat().st_size < _LARGE}
            if len(small) > 1 or paths & self.damaged:
                self.rewrite(small | paths & self.damaged)
        except OSError as error:
            if all(path.exists() for path in paths):  # otherwise another process merges them
                warnings.warn(f"{self.path}: small files were not merged: {error}", stacklevel=1)

    def rewrite(self, paths: Collection[Path], removed: Collection[bytes] = ()) -> None:
        """Copy the intact frames of segments into a new one, and then remove these segments.

        `removed`: checksums of frames that are left out.
        """
        frames = self._sound(paths, removed)
        if (first := next(frames, None)) is not None:
            write(self.path, chain([first], frames))
        for path in paths:
            path.unlink(missing_ok=True)
        self.damaged.difference_update(paths)

    def _sound(self, paths: Collection[Path], removed: Collection[bytes]) -> Iterator[bytes]:
        done = set(removed)
        frames: list[Frame] = []
        for path in paths:
            with suppress(FileNotFoundError):  # another process has merged it
                frames += [frame for frame, _ in scan(path)[0]]
        for frame in frames:
            if frame.digest not in done and (slab := read(frame)) is not None:
                done.add(frame.digest)
                yield packed(slab, frame.serial)

    def slabs(self) -> Iterator[tuple[Frame, Slab]]:
        """All intact slabs, each with its frame."""
        self._refresh()
        for number in range(len(self._frames)):
            slab = self._read(number)
            if slab is not None:
                yield self._frames[number], slab

    def _refresh(self) -> None:
        """Add segments that this or another process has written meanwhile to the index."""
        with _store_errors(self.path):
            here = {path for path in self.path.iterdir() if path.suffix == SUFFIX}
            self._scanned = {path: found for path, found in self._scanned.items() if path in here}
            entries = []
            for path in sorted(here - self._scanned.keys()):
                try:
                    found, is_whole = scan(path) if path.is_file() else ([], True)
                except FileNotFoundError:  # merged by another process
                    continue
                self._scanned[path] = bool(found)
                if not is_whole:
                    self._warn(path)
                for frame, entry in found:
                    self._newest = max(self._newest, frame.serial)
                    number = self._numbers.setdefault(frame.digest, len(self._frames))
                    if number < len(self._frames):  # known already, or moved to this file
                        self._frames[number] = frame
                    else:
                        self._frames.append(frame)
                        entries.append(entry)
            self._index.add(entries)

    def _warn(self, path: Path) -> None:
        if path not in self.damaged:
            self.damaged.add(path)
            warnings.warn(
                f"{path}: damaged, or of another version; the next run recomputes its points, "
                "and 'gapsweep cache gc --apply' removes the damage",
                stacklevel=1,  # once for all who read
            )

    def _read(self, number: int) -> Slab | None:
        """The slab of a number in the index; None if it is damaged or removed."""
        # A listing made while others merge may show neither the old file nor the new one: a slab
        # counts as removed when three listings do not show it.
        n_missed = 0
        while n_missed < 3:
            frame = self._frames[number]
            with _store_errors(self.path), suppress(FileNotFoundError):
                slab = read(frame)
                if slab is None:
                    self._warn(frame.path)
                return slab
            self._scanned.clear()  # merged by another process: the slab is in another file
            self._refresh()
            n_missed += self._frames[number] is frame
        return None

    def _decoded(self, number: int) -> tuple[Slab, Stored] | None:
        """The slab of a number in the index, and its contents; None if damaged or removed."""
        slab = self._read(number)
        try:
            return None if slab is None else (slab, stored(slab))
        except ValueError as error:
            raise StoreError(
                f"{self._frames[number].path}: not written by a run ({error}); "
                "'gapsweep cache gc --apply' removes it"
            ) from None

    def _places(self, keys: NDArray[np.void]) -> Iterator[_Contents]:
        """Yield the contents of the slabs that hold these keys, as `_contents_of`."""
        yield from self._contents_of(self.recorded(keys))

    def _contents_of(self, places: NDArray[np.void]) -> Iterator[_Contents]:
        """Slabs of places, with contents, positions of these places, and their rows in it."""
        for number, asked in _grouped(places["slab"]):
            found = self._contents(number)
            if found is not None:
                yield *found, asked, places["row"][asked]


@contextmanager
def _store_errors(path: Path) -> Iterator[None]:
    """Turn OSErrors of the block into a `StoreError` that names the remedy."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"{error.filename or path}: {error.strerror or error}; check the folder and its disk "
            "space and run again, or choose another folder with --cache; stored points are kept"
        ) from None


def _grouped(numbers: NDArray[np.integer]) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Each different number that is ``>= 0``, with the positions at which it occurs."""
    order = np.argsort(numbers, kind="stable")
    order = order[np.searchsorted(numbers[order], 0) :]
    if order.size:
        ends = np.flatnonzero(np.diff(numbers[order])) + 1
        for rows in np.split(order, ends):
            yield int(numbers[rows[0]]), rows
