"""Segment files of the cache: frames of slabs, written once under a new name, never changed.

A frame is a slab behind its lengths and two SHA-256: one of the columns, one of all that stands
before the columns. A scan of a file reads and checks the latter only. Damage costs the frames that
it touches: the search for the next mark goes on behind it.
"""

import hashlib
import os
import struct
import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO, NamedTuple

from gapsweep.errors import StoreError
from gapsweep.store.index import Entry
from gapsweep.store.slab import MOST_COLUMNS, SLAB, Slab
from gapsweep.study.points import FIXED, KEY

FORMAT = 5
SUFFIX, TEMPORARY = ".seg", ".tmp"
_MARK = b"gapswp\x00" + bytes([FORMAT])
# Mark, serial number, number of points, bytes of text and columns, seconds, SHA-256 of the columns.
_HEAD = struct.Struct("<8sIIIId32s")
_DIGEST = hashlib.sha256().digest_size
_MOST_TEXT = 2**24  # bytes of identity, host, versions and messages
_BLOCK = 2**20  # bytes in which a mark is looked for at a time
_LAST_SERIAL = 2**32 - 1


class Frame(NamedTuple):
    """Where a slab stands in which file, and what its head says of it."""

    path: Path
    at: int
    columns_at: int
    end: int
    serial: int
    n_points: int
    seconds: float
    digest: bytes


def packed(slab: Slab, serial: int) -> bytes:
    """A frame; of several results of one point the one of the highest serial number counts."""
    text = "\n".join((slab.identity, slab.host, slab.versions, slab.messages)).encode()
    columns = hashlib.sha256(slab.columns).digest()
    sizes = slab.n_points, len(text), len(slab.columns)
    head = _HEAD.pack(_MARK, min(serial, _LAST_SERIAL), *sizes, slab.seconds, columns)
    body = slab.keys + slab.status + text
    return head + hashlib.sha256(head + body).digest() + body + slab.columns


def write(folder: Path, frames: Iterable[bytes]) -> None:
    """Write frames, if there are any, to a new segment, which appears whole or not at all.

    Raises
    ------
    StoreError
        If the folder cannot be written, or has no room.
    """
    path = folder / f"{uuid.uuid4().hex}{SUFFIX}"
    temporary = path.with_suffix(TEMPORARY)
    try:
        with temporary.open("xb") as file:
            file.writelines(frames)
            file.flush()
            os.fsync(file.fileno())
            size = file.tell()
        if size:
            temporary.replace(path)
            _flush(folder)
    except FileNotFoundError:
        raise
    except OSError as error:
        why = error.strerror or error
        raise StoreError(
            f"{folder}: cannot be written: {why}: make room, or choose another folder with "
            "--cache, and run again; everything stored so far is kept"
        ) from None
    finally:
        temporary.unlink(missing_ok=True)


def _flush(folder: Path) -> None:
    if os.name == "posix":  # others cannot open folders
        descriptor = os.open(folder, os.O_RDONLY)
        os.fsync(descriptor)
        os.close(descriptor)


def scan(path: Path) -> tuple[list[tuple[Frame, Entry]], bool]:
    """Frames of a file whose heads are sound, and whether the file holds them and nothing else."""
    found: list[tuple[Frame, Entry]] = []
    at, is_whole, is_checked = 0, True, True
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        while at < size:
            one = _head(path, file, at, size)
            if one is not None:
                found.append(one)
                at, is_checked = one[0].end, False
                continue
            is_whole = False
            # If bytes have gone from the frame in front, the next one begins before its end.
            if not is_checked and read(found[-1][0]) is None:
                at = found.pop()[0].at
            is_checked = True
            at = _next_mark(file, at + 1, size)
    return found, is_whole and bool(found)


def _head(path: Path, file: BinaryIO, at: int, size: int) -> tuple[Frame, Entry] | None:
    """The frame that begins at a place; None if there is none, or its head is damaged."""
    file.seek(at)
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size or not head.startswith(_MARK):
        return None
    _, serial, n_points, n_text, n_columns, seconds, _ = _HEAD.unpack(head)
    n_keys = KEY.itemsize * n_points
    columns_at = at + _HEAD.size + _DIGEST + n_keys + n_points + n_text
    is_possible = 0 < n_points <= SLAB and n_text <= _MOST_TEXT and n_columns <= MOST_COLUMNS
    if not is_possible or columns_at + n_columns > size:
        return None
    digest, body = file.read(_DIGEST), file.read(n_keys + n_points + n_text)
    if hashlib.sha256(head + body).digest() != digest:
        return None
    keys, status = body[:n_keys], body[n_keys : n_keys + n_points]
    identity = body[n_keys + n_points :].partition(b"\n")[0]
    is_swept = f'"start":"{FIXED}"'.encode() not in identity
    end = columns_at + n_columns
    frame = Frame(path, at, columns_at, end, serial, n_points, seconds, digest)
    return frame, Entry(keys, status, is_swept, serial)


def _next_mark(file: BinaryIO, at: int, size: int) -> int:
    """Where the next mark stands; the size of the file if there is none."""
    while at < size:
        file.seek(at)
        here = file.read(_BLOCK).find(_MARK)
        if here >= 0:
            return at + here
        at += _BLOCK - len(_MARK) + 1
    return size


def read(frame: Frame) -> bytes | None:
    """A frame as it was written; None if it is not."""
    with frame.path.open("rb") as file:
        file.seek(frame.at)
        data = file.read(frame.end - frame.at)
    body = frame.columns_at - frame.at
    head, digest, text = data[: _HEAD.size], data[_HEAD.size :][:_DIGEST], data[:body]
    is_sound = digest == frame.digest == hashlib.sha256(
        head + text[_HEAD.size + _DIGEST :]
    ).digest() and head.endswith(hashlib.sha256(data[body:]).digest())
    return data if is_sound else None


def slab_of(frame: Frame, data: bytes) -> Slab | None:
    """The slab of a frame that has been read; None if its text is none that `packed` makes."""
    n, body = frame.n_points, data[_HEAD.size + _DIGEST : frame.columns_at - frame.at]
    n_keys = KEY.itemsize * n
    texts = body[n_keys + n :].decode(errors="replace").split("\n", 3)
    if len(texts) < 4:
        return None
    identity, host, versions, messages = texts
    keys, status, columns = (
        body[:n_keys],
        body[n_keys : n_keys + n],
        data[frame.columns_at - frame.at :],
    )
    return Slab(identity, keys, status, columns, messages, frame.seconds, host, versions)
