"""The point cache: one SQLite file, one row per sweep point computed.

The cache is the truth; every NetCDF file can be rebuilt from it. Rows hold plain text and
numbers, never pickle. The key of a row is the SHA-256 of its `identity`, all that the result
depends on, the fingerprint of the code among it: rows of older code stay beside new ones. A
checksum covers the whole row; a row that fails it is never returned, only counted.
"""

import hashlib
import json
import math
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from enum import IntEnum
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import StoreError
from gapsweep.response.result import Response
from gapsweep.status import Status
from gapsweep.store.filesystem import is_on_network

SCHEMA_VERSION = 2
# In place of a status: nothing is stored, or what is stored fails its checksum.
MISSING, DAMAGED = -1, -2

_BATCH = 500  # keys per query; SQLite allows 999 parameters everywhere
_FIELDS = tuple(field.name for field in fields(Response))
_LISTS = {field.name for field in fields(Response) if field.default == ()}
_KINDS: dict[str, Any] = {f.name: tuple if f.name in _LISTS else f.type for f in fields(Response)}

_TABLE = """
CREATE TABLE results (
    key      BLOB PRIMARY KEY,  -- SHA-256 of identity
    identity TEXT NOT NULL,     -- all that the result depends on, canonical JSON
    response TEXT NOT NULL,     -- the result, JSON
    status   INTEGER NOT NULL,  -- as in the response, for quick counting
    cpu_time REAL,              -- as in the response; NULL if not measured
    host     TEXT NOT NULL,     -- machine that computed it
    created  TEXT NOT NULL,     -- UTC
    checksum BLOB NOT NULL      -- SHA-256 of key and all columns before
)
"""
_COLUMNS = "key, identity, response, status, cpu_time, host, created, checksum"
Record = tuple[bytes, str, str, int, float | None, str, str, bytes]


@dataclass(frozen=True, slots=True)
class Row:
    """A stored result, the identity its key was made of, and what computed it.

    Attributes
    ----------
    versions : str
        Of Python and the libraries, as text; empty in rows of older versions.
    """

    key: bytes
    identity: str
    response: Response
    host: str
    versions: str = ""


class DamagedCacheError(StoreError):
    """A cache file that SQLite cannot make sense of; a run salvages what is sound in it.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, path: Path, error: sqlite3.Error) -> None:
        super().__init__(
            f"{path}: {error}: if it is a cache, the next run saves its sound rows and sets the "
            "damaged file aside"
        )
        self.path = path


class Cache:
    """An open point cache; a context manager.

    Parameters
    ----------
    path : path-like
        The file; created, with its folder, if it does not exist.
    read_only : bool
        Whether it is left as it is, and may lie where nothing can be written.

    Attributes
    ----------
    on_network : bool
        Whether the file lies on a network file system. SQLite's write-ahead log needs memory
        shared by all processes, which only one machine has: there, a rollback journal is used.

    Raises
    ------
    DamagedCacheError
        If the file is damaged, or no SQLite file at all.
    StoreError
        If the file cannot be opened or is not a gapsweep cache that this version can read.
    """

    def __init__(self, path: str | Path, *, read_only: bool = False) -> None:
        self.path = Path(path)
        with self.errors():
            self.db = self._connected_to_read() if read_only else self._connected()
            try:
                if read_only and self._version()[0] == 1:  # must be brought up to date first
                    self.db.close()
                    self.db, read_only = self._connected(), False
                # Whatever bytes damage has left in a text: its checksum will tell.
                self.db.text_factory = lambda data: data.decode(errors="replace")
                if read_only:
                    self._check()
                else:
                    self._prepare()
                self.db.execute(f"SELECT {_COLUMNS} FROM results LIMIT 0")
            except BaseException:
                self.db.close()
                raise

    @property
    def on_network(self) -> bool:
        return is_on_network(self.path.parent)

    def _connected(self) -> sqlite3.Connection:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{self.path.parent}: cannot be created: {error.strerror}") from None
        return sqlite3.connect(self.path, timeout=60.0, isolation_level=None)

    def _connected_to_read(self) -> sqlite3.Connection:
        """A connection for reading, also where SQLite cannot put its log beside the file."""
        # Not "ro": such a connection leaves its log behind.
        db = self._at("mode=rw")
        try:
            db.execute("PRAGMA user_version").fetchone()
        except sqlite3.Error as error:
            db.close()
            log = self.path.with_name(f"{self.path.name}-wal")
            if _code(error) not in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY):
                raise
            if log.is_file() and log.stat().st_size:
                raise StoreError(
                    f"{self.path}: its log, {log.name}, cannot be read where nothing can be "
                    "written: copy both to a folder that can be written"
                ) from None
            # Nobody else can write there either.
            return self._at("mode=ro&immutable=1")
        return db

    def _at(self, mode: str) -> sqlite3.Connection:
        place = f"{self.path.absolute().as_uri()}?{mode}"
        return sqlite3.connect(place, uri=True, timeout=60.0, isolation_level=None)

    def _check(self) -> None:
        """Whether the cache can be read as it is."""
        version, n_tables = self._version()
        if version == 0 and n_tables == 0:  # a run that was killed before it made the table
            self.db.execute(_TABLE.replace("CREATE TABLE", "CREATE TEMP TABLE"))
        elif version != SCHEMA_VERSION:
            raise self._other_format(version)
        self.db.execute("PRAGMA query_only = ON")

    def _version(self) -> tuple[int, int]:
        """Format, and number of tables."""
        (version,) = self.db.execute("PRAGMA user_version").fetchone()
        (n_tables,) = self.db.execute("SELECT count(*) FROM sqlite_master").fetchone()
        return version, n_tables

    def _other_format(self, version: int) -> StoreError:
        return StoreError(
            f"{self.path}: a cache of format {version}, this gapsweep reads 1 to "
            f"{SCHEMA_VERSION}: choose another file with --cache"
        )

    def _prepare(self) -> None:
        mode = "DELETE" if self.on_network else "WAL"
        self.db.execute(f"PRAGMA journal_mode = {mode}")
        # A commit survives the death of the process; power loss may cost the last ones.
        self.db.execute(f"PRAGMA synchronous = {'FULL' if self.on_network else 'NORMAL'}")
        if self._version()[0] == SCHEMA_VERSION:
            return
        with self.transaction():
            # Another process may have come first.
            version, n_tables = self._version()
            if version == 0 and n_tables == 0:
                self.db.execute(_TABLE)
            elif version == 1:
                self._migrate()
            elif version != SCHEMA_VERSION:
                raise self._other_format(version)
            self.db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")

    def _migrate(self) -> None:
        """Take over the rows of format 1, which did not keep all of their identity."""
        self.db.execute("ALTER TABLE results RENAME TO old_results")
        self.db.execute(_TABLE)
        old = "SELECT key, point, response, checksum, status, cpu_time, host, created"
        for key, point, response, checksum, *others in self.db.execute(f"{old} FROM old_results"):
            if hashlib.sha256(f"{key}\n{response}".encode()).hexdigest() == checksum:
                self.insert([_record(bytes.fromhex(key), point, response, *others)])
        self.db.execute("DROP TABLE old_results")

    def __enter__(self) -> "Cache":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.db.close()

    @contextmanager
    def errors(self) -> Iterator[None]:
        """SQLite's errors as `StoreError`, with the remedy."""
        try:
            yield
        except sqlite3.Error as error:
            if _code(error) in _DAMAGED:
                raise DamagedCacheError(self.path, error) from None
            raise StoreError(f"{self.path}: {error}{_REMEDIES.get(_code(error), '')}") from None

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """All of the block is stored, or nothing."""
        # IMMEDIATE: a reader that becomes a writer later would defeat the busy timeout.
        self.db.execute("BEGIN IMMEDIATE")
        try:
            yield
            self.db.execute("COMMIT")
        except BaseException:
            # A full disk ends the transaction by itself.
            with suppress(sqlite3.OperationalError):
                self.db.execute("ROLLBACK")
            raise

    def status(self, keys: Sequence[bytes]) -> NDArray[np.int8]:
        """Stored status of each key; `MISSING` or `DAMAGED` where there is none to trust."""
        found = np.full(len(keys), MISSING, np.int8)
        for start in range(0, len(keys), _BATCH):
            some = keys[start : start + _BATCH]
            stored = {r[0]: _status(r) for r in self._records(some)}
            found[start : start + _BATCH] = [stored.get(key, MISSING) for key in some]
        return found

    def rows(self, keys: Sequence[bytes]) -> dict[bytes, Row]:
        """Stored results; damaged ones are left out, as if missing.

        Raises
        ------
        StoreError
            If a row is as it was written, but holds no result.
        """
        sound = [record for record in self._records(keys) if is_sound(record)]
        try:
            return {record[0]: _row(record) for record in sound}
        except ValueError as error:
            raise StoreError(
                f"{self.path}: a row was written by something else than a run ({error}): "
                "'gapsweep cache gc --apply' deletes it"
            ) from None

    def cpu_times(self, keys: Sequence[bytes]) -> dict[bytes, float]:
        """Processor time [s] of every key that is stored and has one."""
        return {r[0]: r[4] for r in self._records(keys) if r[4] is not None and is_sound(r)}

    def checksums(self, keys: Sequence[bytes]) -> dict[bytes, bytes]:
        """Checksums of the stored rows, sound or not: what an export was made of."""
        return {r[0]: r[7] for r in self._records(keys)}

    def commit(self, rows: Sequence[Row]) -> None:
        """Store results in one transaction; a failure never takes the place of a result."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        records = []
        for row in rows:
            response = row.response
            cpu_time = None if math.isnan(response.cpu_time) else response.cpu_time
            text = _encoded(response, row.versions)
            values = text, int(response.status), cpu_time, row.host, now
            records.append(_record(row.key, row.identity, *values))
        failed = [row.key for row in rows if row.response.status.failed]
        with self.errors(), self.transaction():
            # Another run may have come to an end with what this one gave up.
            stored = self._records(failed)
            kept = {r[0] for r in stored if is_sound(r) and not Status(r[3]).failed}
            self.insert(r for r in records if r[0] not in kept)

    def insert(self, records: Iterable[Record]) -> None:
        """Add or replace records as they are, within the caller's transaction."""
        self.db.executemany(
            "INSERT OR REPLACE INTO results VALUES (?, ?, ?, ?, ?, ?, ?, ?)", records
        )

    def records(self, order: str = "ASC") -> Iterator[Record]:
        """All records as stored, sound or not, oldest first or last (``"DESC"``)."""
        with self.errors():
            yield from self.db.execute(f"SELECT {_COLUMNS} FROM results ORDER BY rowid {order}")

    def _records(self, keys: Sequence[bytes]) -> Iterator[Record]:
        with self.errors():
            for start in range(0, len(keys), _BATCH):
                some = keys[start : start + _BATCH]
                marks = ",".join("?" * len(some))
                yield from self.db.execute(
                    f"SELECT {_COLUMNS} FROM results WHERE key IN ({marks})", some
                )


_REMEDIES = {
    sqlite3.SQLITE_FULL: ": make room and run again; everything stored so far is kept",
    sqlite3.SQLITE_READONLY: ": the cache must be writable; choose another with --cache",
    sqlite3.SQLITE_CANTOPEN: ": name a file in a folder that can be written with --cache",
    sqlite3.SQLITE_IOERR: ": the disk failed or is full; everything stored so far is kept",
}
# An error of SQL itself can only mean that the table is not what it was.
_DAMAGED = {
    sqlite3.SQLITE_CORRUPT,
    sqlite3.SQLITE_NOTADB,
    sqlite3.SQLITE_TOOBIG,
    sqlite3.SQLITE_ERROR,
}


def _code(error: sqlite3.Error) -> int:
    """SQLite's primary code of an error; 0 if it is none of SQLite's own."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def is_sound(record: Record) -> bool:
    """Whether a record is as it was written."""
    try:
        return _record(*record[:7]) == record
    except (TypeError, AttributeError, ValueError):  # a damaged file may hold any type anywhere
        return False


def holds_result(record: Record) -> bool:
    """Whether a run can have written a record: is it sound, and what it holds a response?"""
    try:
        return is_sound(record) and _row(record).response.status == record[3]
    except ValueError:
        return False


def _status(record: Record) -> int:
    whole = is_sound(record) and 0 <= record[3] <= max(Status)
    return record[3] if whole else DAMAGED


def identity_matches(record: Record) -> bool:
    """Whether a record's key is that of its identity; of format 1 too little is known."""
    key, identity, *_ = record
    return hashlib.sha256(identity.encode()).digest() == key or '"numerics"' not in identity


def _record(
    key: bytes,
    identity: str,
    response: str,
    status: int,
    cpu_time: float | None,
    host: str,
    created: str,
) -> Record:
    """A table row, its checksum added."""
    digest = hashlib.sha256(key)
    for column in (identity, response, str(status), repr(cpu_time), host, created):
        digest.update(b"\0")
        digest.update(column.encode())
    return key, identity, response, status, cpu_time, host, created, digest.digest()


def _row(record: Record) -> Row:
    key, identity, response, _, _, host, *_ = record
    found, versions = _decoded(response)
    return Row(key, identity, found, host, versions)


def _encoded(response: Response, versions: str = "") -> str:
    """JSON of a response, which has no NaN (null) and no infinities (text), and of versions."""
    values = {name: _plain(getattr(response, name)) for name in _FIELDS}
    return json.dumps(values | {"versions": versions}, separators=(",", ":"), allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else repr(value)
    return value


def _decoded(text: str) -> tuple[Response, str]:
    """The response in a row, and the versions that computed it.

    Raises
    ------
    ValueError
        If it is none, whatever else it may be.
    """
    try:
        stored = json.loads(text)
        versions = str(stored.pop("versions", ""))
        values = {name: _valued(name, value) for name, value in stored.items()}
        # What an older version did not know keeps its default.
        return Response(**values), versions
    except (TypeError, AttributeError, KeyError, RecursionError) as error:
        raise ValueError(f"{type(error).__name__}: {error}") from None


def _valued(name: str, value: Any) -> Any:
    """A value of a response from its JSON."""
    kind = _KINDS[name]
    if kind is float:
        value = math.nan if value is None else float(value)
    elif name in _LISTS:
        if not all(type(one) in (int, float) for one in value):
            raise TypeError(f"{name}: must be numbers")
        value = tuple(value)
    elif type(value) is not (str if kind is str else int):
        raise TypeError(f"{name} = {value!r:.40}")
    return kind(value) if issubclass(kind, IntEnum) else value
