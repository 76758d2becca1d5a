"""Rows of a damaged cache, found without the help of SQLite, whose trees may be torn.

A row is a record in one page, its end in a chain of overflow pages if it is long. Records are
looked for wherever the pages hold what could be the head of one, also in pages that no tree
leads to any more; the checksum of every row tells what is one. File format: sqlite.org/fileformat2.
"""

import mmap
import os
import re
import struct
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from gapsweep.errors import StoreError
from gapsweep.store.artefact import alone_in
from gapsweep.store.cache import Cache, DamagedCacheError
from gapsweep.store.slab import Slab

Buffer = mmap.mmap | bytes
Given = ParamSpec("Given")
Result = TypeVar("Result")

_PAGE = 4096  # SQLite's own choice, where the file does not say
_WAL_HEAD, _FRAME_HEAD = 32, 24
_TABLE = b"CREATE TABLE slabs"
# Length of the head, then the type of each column; the checksum is a blob of 32 bytes.
_NUMBER = rb"[\x00-\x09]"
_LONG = rb"[\x80-\xff]{0,3}[\x00-\x7f]"  # a text or blob, by its length
_HEAD = re.compile(rb"(?=[\x0c-\x29]\x00" + 5 * _LONG + _NUMBER + 3 * _LONG + rb"\x4c)", re.DOTALL)
_INTEGER_BYTES = (0, 1, 2, 3, 4, 6, 8)
_REAL, _ZERO, _ONE = 7, 8, 9
_COLUMNS = 11  # of which the first, its number, stands elsewhere


def salvage(path: Path) -> str | None:
    """Set a damaged cache aside and put its sound rows in its place.

    Returns
    -------
    str or None
        What was done, in a line; None if another process has done it meanwhile.

    Raises
    ------
    StoreError
        If the file cannot be told to be a cache of ours; it is left alone then.
    """
    path = path.resolve()  # its log lies beside the file, not beside a link to it
    with alone_in(path.parent):
        if _is_whole(path):
            return None
        fresh = path.with_name(f".{path.name}.salvaged")
        # With what one that was killed before the end had saved.
        saved = sound_slabs(path) | sound_slabs(fresh)
        slabs = dict(sorted(saved.items(), key=lambda item: item[1].created))
        if not slabs and _TABLE not in path.read_bytes():
            raise StoreError(
                f"{path}: file is not a database, or no row of a cache is left in it: move it "
                "away or choose another file with --cache"
            )
        begun = path.with_name(f".{path.name}.salvaging")
        begun.unlink(missing_ok=True)
        with Cache(begun) as cache, cache.errors(), cache.transaction():
            cache.insert(slabs.values())
        begun.replace(fresh)
        aside = _unused(path)
        # Its log first: beside another file it would be taken for that one's.
        log = path.with_name(f"{path.name}-wal")
        if log.exists() and log.stat().st_size:
            log.rename(aside.with_name(f"{aside.name}-wal"))
        for useless in (log, path.with_name(f"{path.name}-shm")):
            useless.unlink(missing_ok=True)
        try:
            os.link(path, aside)  # so that at no moment there is no cache
        except OSError:  # the file system has no links
            path.rename(aside)
        fresh.replace(path)
    n_points = sum(slab.n_points for slab in slabs.values())
    return f"{path}: damaged; {n_points} sound results saved, the damaged file is now {aside}"


def salvaging(work: Callable[Given, Result]) -> Callable[Given, Result]:
    """The function, going on after a damaged cache that stopped it has been salvaged."""

    @wraps(work)
    def salvaged(*arguments: Given.args, **named: Given.kwargs) -> Result:
        try:
            return work(*arguments, **named)
        except DamagedCacheError as error:
            done = salvage(error.path)
        if done is not None:
            warnings.warn(done, stacklevel=2)
        return work(*arguments, **named)

    return salvaged


def _is_whole(path: Path) -> bool:
    try:
        with Cache(path, read_only=True) as cache, cache.errors():
            return cache.db.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    except DamagedCacheError:
        return False


def _unused(path: Path) -> Path:
    names = (f"{path.name}.damaged{n or ''}" for n in range(1_000_000))
    return next(p for p in map(path.with_name, names) if not p.exists())


def sound_slabs(path: Path) -> dict[bytes, Slab]:
    """All rows that can be found in a cache file and its write-ahead log, by checksum."""
    found: dict[bytes, Slab] = {}
    path = path.resolve()
    with ExitStack() as files:
        main = _mapped(path, files)
        log = _mapped(path.with_name(f"{path.name}-wal"), files)
        for size in {_page_size(main), _PAGE}:
            found |= {slab.checksum: slab for slab in _Pages(main, log, size).slabs()}
    return dict(sorted(found.items(), key=lambda item: item[1].created))


def _mapped(path: Path, files: ExitStack) -> Buffer:
    if not path.is_file() or not path.stat().st_size:
        return b""
    file = files.enter_context(path.open("rb"))
    return files.enter_context(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def _page_size(main: Buffer) -> int:
    stated = int.from_bytes(main[16:18], "big")
    size = 65536 if stated == 1 else stated
    return size if size in (2**n for n in range(9, 17)) else _PAGE


class _Pages:
    """The pages of a cache file, and the later ones in its log."""

    def __init__(self, main: Buffer, log: Buffer, size: int) -> None:
        self.main, self.log, self.size = main, log, size
        stride = _FRAME_HEAD + size
        heads = range(_WAL_HEAD, len(log) - stride + 1, stride)
        self.logged = {
            int.from_bytes(log[at : at + 4], "big"): log[at + _FRAME_HEAD : at + stride]
            for at in heads
        }

    def slabs(self) -> Iterator[Slab]:
        """All sound rows."""
        for buffer in (self.main, self.log):
            for match in _HEAD.finditer(buffer):
                # A page of the log may have been written anew; the older one is in the file still.
                for logged in (self.logged, {}) if self.logged else ({},):
                    slab = self._slab(buffer, match.start(), logged)
                    if slab is not None:
                        yield slab
                        break

    def _slab(self, buffer: Buffer, at: int, logged: dict[int, bytes]) -> Slab | None:
        types = _types(buffer[at : at + buffer[at]])
        if len(types) != _COLUMNS:
            return None
        sizes = [_size(kind) for kind in types]
        payload = self._payload(buffer, at, buffer[at] + sum(sizes), logged)
        if payload is None:
            return None
        values: list[Any] = []
        start = buffer[at]
        for kind, size in zip(types, sizes, strict=True):
            values.append(_value(kind, payload[start : start + size]))
            start += size
        slab = Slab(*values[1:])
        return slab if slab.is_sound else None

    def _payload(
        self, buffer: Buffer, at: int, length: int, logged: dict[int, bytes]
    ) -> bytes | None:
        """So many bytes from a place on, along the chain of overflow pages; None if it is torn."""
        room = self.size - 4
        local = length
        if length > self.size - 35:
            least = (self.size - 12) * 32 // 255 - 23
            local = least + (length - least) % room
            local = local if local <= self.size - 35 else least
        parts = [buffer[at : at + local]]
        following = buffer[at + local : at + local + 4]
        for _ in range(-(-(length - local) // room)):
            number = int.from_bytes(following, "big")
            page = logged.get(number) or self.main[(number - 1) * self.size : number * self.size]
            if len(page) < self.size:
                return None
            following = page[:4]
            parts.append(page[4:])
        whole = b"".join(parts)[:length]
        return whole if len(whole) == length else None


def _types(head: bytes) -> list[int]:
    """Types of the columns in the head of a record, each a number of seven-bit digits."""
    types, value = [], 0
    for byte in head[1:]:
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            types.append(value)
            value = 0
    return types


def _size(kind: int) -> int:
    if kind >= 12:
        return (kind - 12) // 2
    return 8 if kind == _REAL else _INTEGER_BYTES[kind] if kind < _REAL else 0


def _value(kind: int, data: bytes) -> Any:
    if kind >= 12:
        return data.decode(errors="replace") if kind % 2 else data
    if kind == _REAL:
        return struct.unpack(">d", data)[0]
    if kind in (_ZERO, _ONE):
        return float(kind - _ZERO)
    # A real number that is whole is stored as an integer.
    return float(int.from_bytes(data, "big", signed=True)) if kind else None
