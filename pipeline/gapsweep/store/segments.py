"""Segment files of the cache: frames of slabs, written once under a new name, never changed.

A frame is a head, with lengths and two SHA-256, and a slab: one checksum is of the columns, the
other of everything before the columns. A scan of a file reads and checks the latter only. Damage
costs the frames that it touches: the scan continues at the next mark.
"""

import hashlib
import os
import struct
import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO, NamedTuple

from gapsweep.store.artefact import replacing
from gapsweep.store.index import Entry, words
from gapsweep.store.slab import MOST_COLUMNS, SLAB, Slab
from gapsweep.study.points import FIXED, KEY

FORMAT, SUFFIX = 5, ".seg"
_MARK = b"gapswp\x00" + bytes([FORMAT])
# Mark, SHA-256 of all bytes from there to the columns, serial number, number of points, bytes of
# text and of columns, seconds, SHA-256 of the columns. Keys, status, text and columns follow.
_HEAD = struct.Struct("<8s32sIIIId32s")
_SEALED = 40  # first byte that the first checksum covers
_POINT = KEY.itemsize + 1  # bytes of its key and its status
_MOST_TEXT = 2**24  # bytes of identity, host, versions and messages
_BLOCK = 2**20  # bytes read at a time in the search for a mark


class Frame(NamedTuple):
    """The place of a slab in a segment file, and the numbers in its head."""

    path: Path
    at: int
    columns_at: int
    end: int
    serial: int
    n_points: int
    seconds: float
    digest: bytes


def packed(slab: Slab, serial: int) -> bytes:
    """Bytes of a frame; if a point has several results, the highest serial number counts."""
    text = "\n".join((slab.identity, slab.host, slab.versions, slab.messages)).encode()
    columns = hashlib.sha256(slab.columns).digest()
    sizes = slab.n_points, len(text), len(slab.columns)
    head = _HEAD.pack(_MARK, b"", min(serial, 2**32 - 1), *sizes, slab.seconds, columns)
    sealed = head[_SEALED:] + slab.keys + slab.status + text
    return _MARK + hashlib.sha256(sealed).digest() + sealed + slab.columns


def digest_of(frame: bytes) -> bytes:
    """The checksum in the head of a packed frame, as `Frame.digest`."""
    return frame[len(_MARK) : _SEALED]


def write(folder: Path, frames: Iterable[bytes]) -> None:
    """Write frames to a new segment, atomically.

    Raises `StoreError` if the folder cannot be written, or its disk is full.
    """
    path = folder / f"{uuid.uuid4().hex}{SUFFIX}"
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.writelines(frames)


def scan(path: Path) -> tuple[list[tuple[Frame, Entry]], bool]:
    """Frames of a file with intact heads, and whether the file holds nothing else."""
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
            # If bytes are lost from the preceding frame, the next one begins before its end.
            if not is_checked and read(found[-1][0]) is None:
                at = found.pop()[0].at
            is_checked = True
            at = _next_mark(file, at + 1, size)
    return found, is_whole and bool(found)


def _head(path: Path, file: BinaryIO, at: int, size: int) -> tuple[Frame, Entry] | None:
    """The frame that begins at byte `at`; None if there is none, or its head is damaged."""
    file.seek(at)
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size or not head.startswith(_MARK):
        return None
    _, digest, serial, n, n_text, n_columns, seconds, _ = _HEAD.unpack(head)
    columns_at = at + _HEAD.size + _POINT * n + n_text
    is_possible = 0 < n <= SLAB and n_text <= _MOST_TEXT and n_columns <= MOST_COLUMNS
    if not is_possible or columns_at + n_columns > size:
        return None
    head += file.read(columns_at - at - _HEAD.size)
    if hashlib.sha256(head[_SEALED:]).digest() != digest:
        return None
    keys, status, text = _parts(head, n)
    if text.count(b"\n") < 3:
        return None
    is_swept = f'"start":"{FIXED}"'.encode() not in text.partition(b"\n")[0]
    frame = Frame(path, at, columns_at, columns_at + n_columns, serial, n, seconds, digest)
    return frame, (words(keys).copy(), status, is_swept, serial)


def _parts(head: bytes, n_points: int) -> tuple[bytes, bytes, bytes]:
    """Keys, statuses and text in the head of a frame, as bytes."""
    first, last = (_HEAD.size + size * n_points for size in (KEY.itemsize, _POINT))
    return head[_HEAD.size : first], head[first:last], head[last:]


def _next_mark(file: BinaryIO, at: int, size: int) -> int:
    """Position of the next mark from byte `at` on; the size of the file if there is none."""
    while at < size:
        file.seek(at)
        here = file.read(_BLOCK).find(_MARK)
        if here >= 0:
            return at + here
        at += _BLOCK - len(_MARK) + 1
    return size


def read(frame: Frame) -> Slab | None:
    """The slab of a frame, read from its file; None if a checksum is wrong."""
    with frame.path.open("rb") as file:
        file.seek(frame.at)
        head = file.read(frame.columns_at - frame.at)
        columns = file.read(frame.end - frame.columns_at)
    is_sound = hashlib.sha256(head[_SEALED:]).digest() == frame.digest
    if not is_sound or not head[: _HEAD.size].endswith(hashlib.sha256(columns).digest()):
        return None
    keys, status, text = _parts(head, frame.n_points)
    identity, host, versions, messages = text.decode(errors="replace").split("\n", 3)
    return Slab(identity, keys, status, columns, messages, frame.seconds, host, versions)
