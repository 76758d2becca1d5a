"""Files of a run: written atomically, with checksums that reveal later damage.

A file is written under a temporary name in its own folder, flushed to disk and only then
renamed into place. Its SHA-256 is recorded in ``SHA256SUMS`` of the folder, in the form that
``sha256sum --check`` reads; while a file is replaced, both checksums are recorded.
"""

import errno
import hashlib
import os
import platform
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from io import BufferedReader
from pathlib import Path
from uuid import uuid4

import psutil

from gapsweep.errors import GapsweepError, StoreError, described
from gapsweep.store.filesystem import fcntl

SUMS = "SHA256SUMS"
_LONGEST = 2**26  # bytes of a text; those of the largest runs are a tenth of it
_SMALL = 1e6  # bytes, read in a millisecond
_SOON = 100e6  # bytes, read in a quarter of a second at worst, or a second from a slow disk


@contextmanager
def replacing(path: Path, is_ours: Callable[[Path], bool] | None = None) -> Iterator[Path]:
    """A temporary path that takes the place of `path` when the block ends without error.

    Raises `StoreError` if the folder or file cannot be written, or `is_ours` forbids the
    replacement.

    `is_ours`: returns whether an existing file may be replaced; None allows it.
    """
    if is_ours is not None and path.exists() and not is_ours(path):
        raise StoreError(
            f"{path}: not written by gapsweep; move the file, or choose another folder with --out"
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        name = f".{path.name}.{platform.node()}.{os.getpid()}.{uuid4().hex}"
        temporary = path.with_name(name)
        temporary.touch(exist_ok=False)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        yield temporary
        _flush(temporary)
        temporary.replace(path)
        _flush(path.parent)
    except GapsweepError:
        raise
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files in a folder that killed processes of this machine have left."""
    ours = r"\..+" + re.escape(f".{platform.node()}.") + r"(\d+)\.\w+"
    for there in folder.iterdir():
        owner = re.fullmatch(ours, there.name)
        if owner and not psutil.pid_exists(int(owner[1])):
            there.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    is_folder = path.is_dir()
    if is_folder and fcntl is None:  # Windows opens no folders
        return
    descriptor = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def recording(path: Path, is_ours: Callable[[Path], bool]) -> Iterator[Path]:
    """Replace a file as `replacing` does, and record its SHA-256 in ``SHA256SUMS``."""
    known = digests(path)
    with replacing(path, is_ours) as temporary:
        remove_leftovers(path.parent)
        yield temporary
        new = sha256(temporary)
        # Record both digests first: a kill may happen before or after the replacement.
        _record(path, [*known, new])
    _record(path, [new])


def is_intact(path: Path) -> bool | None:
    """Whether the SHA-256 of a file is the recorded one; None if none is recorded.

    False for a pipe or device, and for a file that cannot be read.
    """
    known = digests(path)
    if not known and (path.is_file() or not path.exists()):
        return None
    try:
        return sha256(path) in known
    except OSError:  # it cannot be read, or is a pipe
        return False


def checked(folder: Path, most: float = _SOON) -> tuple[list[str], list[str]]:
    """Paths in a run's folder of files with a wrong checksum, and of files that were not read.

    `most`: bytes to read in total, the smallest files first.
    """
    places = [folder, *(sums.parent for sums in folder.glob(f"report/**/{SUMS}"))]
    files = {place / name for place in places for _, name in _sums(place)}
    sizes = {path: path.stat().st_size if path.is_file() else 0 for path in files}
    changed, unread = [], []
    for path in sorted(files, key=lambda path: (sizes[path], path)):
        most -= sizes[path]
        if most < 0:
            unread.append(str(path.relative_to(folder)))
        elif not is_intact(path):
            changed.append(str(path.relative_to(folder)))
    return sorted(changed), sorted(unread)


def is_recorded(path: Path) -> bool:
    """Whether ``SHA256SUMS`` has an entry for a file, which gapsweep then may replace."""
    return bool(digests(path))


def text_of(path: Path) -> str:
    """Text of a file from any source; OSError if it is larger than 64 MB."""
    with _opened(path) as file:
        found = file.read(_LONGEST + 1)
    if len(found) > _LONGEST:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return found.decode(errors="replace")


def _opened(path: Path) -> BufferedReader:
    """Open a file for reading; OSError for a pipe or a device, which may never end."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return path.open("rb")


def sha256(path: Path) -> str:
    """SHA-256 of a file in hex; a large file is read only if it has changed."""
    with _opened(path) as file:
        about = os.fstat(file.fileno())
        if about.st_size < _SMALL:
            return hashlib.file_digest(file, "sha256").hexdigest()
    return _sha256_of_large(path, about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns)


@lru_cache(maxsize=64)
def _sha256_of_large(path: Path, *_: int) -> str:
    with _opened(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digests(path: Path) -> list[str]:
    """SHA-256 digests recorded for a file; two while it is being replaced."""
    return [digest for digest, name in _sums(path.parent) if name == path.name]


def _sums(folder: Path) -> list[tuple[str, str]]:
    try:
        lines = text_of(folder / SUMS).splitlines()
    except FileNotFoundError:  # nothing is recorded
        return []
    except OSError as error:
        raise StoreError(f"{folder / SUMS}: {error.strerror}; remove it") from None
    pairs = (line.partition("  ") for line in lines)
    return [(digest, name) for digest, _, name in pairs if name]  # a truncated line has no name


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Turn any error of the block into a `StoreError`: files of other versions hold anything."""
    try:
        yield
    except GapsweepError:
        raise
    except Exception as error:
        raise StoreError(
            f"{folder}: files are not in the format of this version "
            f"({described(error)}); 'gapsweep run' rewrites them"
        ) from error


def remove(folder: Path, names: Collection[str]) -> None:
    """Remove files of a folder and their checksums; StoreError if one cannot be removed."""
    if names:
        _write_sums(folder, [pair for pair in _sums(folder) if pair[1] not in names])
    for name in names:
        try:
            (folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise StoreError(f"{folder / name}: cannot be removed: {error.strerror}") from None


def _record(path: Path, known: list[str]) -> None:
    others = [pair for pair in _sums(path.parent) if pair[1] != path.name]
    _write_sums(path.parent, [*others, *((digest, path.name) for digest in known)])


def _write_sums(folder: Path, sums: Iterable[tuple[str, str]]) -> None:
    lines = sorted(sums, key=lambda pair: pair[1])
    with replacing(folder / SUMS) as temporary:
        text = "".join(f"{digest}  {name}\n" for digest, name in lines)
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold the exclusive lock of a folder during the block; wait while another run holds it.

    The operating system releases it when the process ends. Where folders cannot be locked (some
    network file systems) there is no lock; each file is still replaced atomically.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if fcntl is None:  # folders cannot be opened there either
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                warnings.warn(f"{folder}: waiting for another run in this folder", stacklevel=4)
                fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
