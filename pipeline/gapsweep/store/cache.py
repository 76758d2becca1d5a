"""The point cache: one SQLite file, a row for every slab of sweep points computed.

The cache is the truth; every NetCDF file can be rebuilt from it. Rows hold numbers and text, never
pickle. Every point has a key of its own, made of all that its result depends on, the fingerprint
of the code among it: results of older code stay beside new ones. A checksum covers the whole row;
a row that fails it is never returned, only counted. A row is never changed: what was computed again
stands in a later one, and the number of one that was deleted is not given to another.
"""

import sqlite3
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import StoreError
from gapsweep.model.structure import AnyStructure, OscillatorStructure
from gapsweep.response.result import Responses
from gapsweep.store.filesystem import is_on_network
from gapsweep.store.index import DAMAGED, Index
from gapsweep.store.slab import Slab, Stored, stored
from gapsweep.study.points import FIXED, KEY

SCHEMA_VERSION = 4

_OSCILLATOR = OscillatorStructure()
_TABLE = f"""
CREATE TABLE slabs (  -- format {SCHEMA_VERSION}
    id       INTEGER PRIMARY KEY AUTOINCREMENT,  -- no number is used twice, whatever is deleted
    identity TEXT NOT NULL,  -- of what the points have in common, canonical JSON
    keys     BLOB NOT NULL,  -- content keys of the points, 32 bytes each
    status   BLOB NOT NULL,  -- their status, one byte each
    columns  BLOB NOT NULL,  -- their numbers and responses, compressed
    messages TEXT NOT NULL,  -- JSON, by number of the point
    seconds  REAL NOT NULL,  -- processor time of all
    host     TEXT NOT NULL,  -- machine that computed them
    versions TEXT NOT NULL,  -- of Python and the libraries
    created  TEXT NOT NULL,  -- UTC
    checksum BLOB NOT NULL   -- SHA-256 of all columns before
)
"""
_COLUMNS = ", ".join(field.name for field in fields(Slab))
_ROWS = 16_384  # whose keys are read at a time: a million
_PATIENCE = 60.0  # s, that another process may keep the file to itself
_KEPT = 64  # decoded slabs: neighbouring points are read together


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Stored results of some of the keys that were asked for.

    Attributes
    ----------
    at : ndarray of int, shape (n,)
        Numbers of these keys, ascending.
    responses : Responses
    host : ndarray of str, shape (n,)
        Machine that computed each.
    versions : frozenset of str
        Of Python and the libraries, as text.
    """

    at: NDArray[np.intp]
    responses: Responses
    host: NDArray[np.str_]
    versions: frozenset[str]


class DamagedCacheError(StoreError):
    """A cache file that SQLite cannot make sense of; a run salvages what is sound in it.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, path: Path, error: sqlite3.Error) -> None:
        super().__init__(
            f"{path}: {error}: the next run sets it aside and saves the sound rows that it finds; "
            "if there are none, move it away or choose another file with --cache"
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
        self._index = Index()
        self._damaged: set[int] = set()  # rows that were met so far
        self._slab = lru_cache(maxsize=_KEPT)(self._read_slab)
        with self.errors():
            self._check_log()
            self.db = self._connected_to_read() if read_only else self._connected()
            try:
                # Whatever bytes damage has left in a text: its checksum will tell.
                self.db.text_factory = lambda data: data.decode(errors="replace")
                if read_only:
                    self._check()
                else:
                    self._prepare()
                self.db.execute(f"SELECT {_COLUMNS} FROM slabs LIMIT 0")
            except BaseException:
                self.db.close()
                raise

    @property
    def on_network(self) -> bool:
        return is_on_network(self.path.parent)

    def _check_log(self) -> None:
        """Refuse a file that is empty beside a log that is not: SQLite would remove the log."""
        file = self.path.resolve()
        log = file.with_name(f"{file.name}-wal")
        if all(map(Path.is_file, (file, log))) and not file.stat().st_size and log.stat().st_size:
            raise DamagedCacheError(
                self.path, sqlite3.DatabaseError("it is empty, but its log is not")
            )

    def _connected(self) -> sqlite3.Connection:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            remedy = _REMEDIES[sqlite3.SQLITE_CANTOPEN]
            raise StoreError(
                f"{self.path.parent}: cannot be created: {error.strerror}{remedy}"
            ) from None
        return sqlite3.connect(self.path, timeout=_PATIENCE, isolation_level=None)

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
        return sqlite3.connect(place, uri=True, timeout=_PATIENCE, isolation_level=None)

    def _check(self) -> None:
        """Whether the cache can be read as it is."""
        if self._is_new():  # a run was killed before it made the table, or somebody cut the file
            warnings.warn(f"{self.path}: empty, no point is stored in it", stacklevel=1)
            self.db.execute(_TABLE.replace("CREATE TABLE", "CREATE TEMP TABLE"))
        self.db.execute("PRAGMA query_only = ON")

    def _is_new(self) -> bool:
        """Whether there is nothing in the file yet.

        Raises
        ------
        StoreError
            If there is something else than a cache of this format.
        """
        # In one statement: another process may make the table between two.
        both = "SELECT user_version, (SELECT min(sql) FROM sqlite_master) FROM pragma_user_version"
        ((version, table),) = self.db.execute(both).fetchall()  # which ends the reading
        if version == 0 and table is None:
            return True
        # Of two places that say the format, one may be damaged.
        if version != SCHEMA_VERSION and table != _TABLE.strip():
            raise StoreError(
                f"{self.path}: a cache of format {version}, this gapsweep reads format "
                f"{SCHEMA_VERSION}: move it away, or choose another file with --cache"
            )
        return False

    def _prepare(self) -> None:
        is_new = self._is_new()
        self._set_journal("DELETE" if self.on_network else "WAL")
        # A commit survives the death of the process; power loss may cost the last ones.
        self.db.execute(f"PRAGMA synchronous = {'FULL' if self.on_network else 'NORMAL'}")
        if is_new:
            with self.transaction():
                if self._is_new():  # another process may have come first
                    self.db.execute(_TABLE)
                    self.db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")

    def _set_journal(self, mode: str) -> None:
        """Wait for others, as SQLite does not where it changes from one way to the other."""
        deadline = time.monotonic() + _PATIENCE
        while True:
            try:
                self.db.execute(f"PRAGMA journal_mode = {mode}").fetchall()
                return
            except sqlite3.OperationalError as error:
                if _code(error) != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                    raise
                time.sleep(0.01)

    def __enter__(self) -> "Cache":
        return self

    def __exit__(self, *_: object) -> None:
        self.db.close()
        del self._slab  # it holds us: index and slabs would stay until the garbage collector runs

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

    def status(self, keys: NDArray[np.void]) -> NDArray[np.int8]:
        """Stored status of each key; `MISSING` or `DAMAGED` where there is none to trust."""
        index = self._refreshed()
        held = index.find(keys)
        slabs = np.unique(held.slab[held.slab >= 0]).tolist()
        damaged = [slab for slab in slabs if self._sound_row(index.ids[slab]) is None]
        held.status[np.isin(held.slab, damaged)] = DAMAGED
        return held.status

    def find(self, keys: NDArray[np.void], structure: AnyStructure = _OSCILLATOR) -> Found:
        """Stored results, of oscillators or of systems; damaged ones are left out, as if missing.

        Raises
        ------
        StoreError
            If a row is as it was written, but holds no result.
        """
        index = self._refreshed()
        held = index.find(keys)
        at, parts, hosts, versions = [], [], [], set()
        for number, asked in _grouped(held.slab):
            found = self._slab(index.ids[number])
            if found is not None:
                at.append(asked)
                parts.append(found[1].responses.take(held.row[asked]))
                hosts.append(np.full(len(asked), found[0].host))
                versions.add(found[0].versions)
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
        """The slab that holds one key, its contents, and the key's number in it."""
        index = self._refreshed()
        held = index.find(key)
        found = self._slab(index.ids[held.slab[0]]) if held.slab[0] >= 0 else None
        return None if found is None else (*found, int(held.row[0]))

    def origins(self, keys: NDArray[np.void]) -> tuple[NDArray[np.void], NDArray[np.bool_]]:
        """Keys of what results started from (or zero), and which of them have an end (or true)."""
        index = self._refreshed()
        held, origins = index.find(keys), np.zeros(len(keys), KEY)
        has_end = np.ones(len(keys), bool)
        for number, asked in _grouped(held.slab):
            found = self._slab(index.ids[number])
            if found is not None:
                rows = held.row[asked]
                origins[asked] = found[1].previous[rows]
                has_end[asked] = found[1].responses.has_end[rows]
        return origins, has_end

    def seconds(self, keys: NDArray[np.void]) -> NDArray[np.float64]:
        """Processor time [s] of each key's result, as its slab's mean; NaN if it is not stored."""
        index = self._refreshed()
        # Damage leaves any type anywhere.
        mean = "CASE typeof(seconds) WHEN 'real' THEN seconds / length(status) END"
        found = self._by_row(mean)
        # The last one for what is not there.
        seconds = np.array([*map(found.get, index.ids), None], float)
        return np.asarray(seconds[index.find(keys).slab])

    def checksums(self, keys: NDArray[np.void]) -> Iterator[bytes]:
        """What an export of these keys is made of: checksums of rows, and which are whose."""
        index = self._refreshed()
        held, found = index.find(keys), self._by_row("checksum")
        for number, asked in _grouped(held.slab):
            checksum = found.get(index.ids[number])
            yield checksum if isinstance(checksum, bytes) else b""
            yield asked.tobytes() + held.row[asked].tobytes()

    def commit(self, slabs: Sequence[Slab]) -> None:
        """Store slabs in one transaction."""
        with self.errors(), self.transaction():
            self.insert(slabs)

    def delete_damaged(self) -> None:
        """Delete the damaged rows that were met, once their points are computed again."""
        if self._damaged:
            with self.errors(), self.transaction():
                self.delete(self._damaged)
            self._damaged.clear()

    def delete(self, numbers: Iterable[int]) -> None:
        """Delete rows, within the caller's transaction."""
        self.db.executemany("DELETE FROM slabs WHERE id = ?", [(n,) for n in numbers])

    def insert(self, slabs: Iterable[Slab]) -> None:
        """Add slabs as they are, within the caller's transaction."""
        marks = ", ".join("?" * len(fields(Slab)))
        insert = f"INSERT INTO slabs ({_COLUMNS}) VALUES ({marks})"
        self.db.executemany(insert, map(_values, slabs))

    def slabs(self, order: str = "ASC") -> Iterator[tuple[int, Slab]]:
        """All rows as stored, sound or not, oldest first or last (``"DESC"``), by their number."""
        with self.errors():
            rows = self.db.execute(f"SELECT id, {_COLUMNS} FROM slabs ORDER BY id {order}")
            for number, *values in rows:
                yield number, Slab(*values)

    def _refreshed(self) -> Index:
        """The index, with what has been added meanwhile, also by others."""
        with self.errors():
            # What stands behind the columns of a row is read through all of these: not here.
            rows = self.db.execute(
                "SELECT id, keys, status, instr(identity, ?) = 0 FROM slabs "
                "WHERE id > ? ORDER BY id",
                (f'"start":"{FIXED}"', self._index.last),
            )
            while part := rows.fetchmany(_ROWS):
                self._index.add(part)
        return self._index

    def _by_row(self, expression: str) -> dict[int, Any]:
        """Something of every row, by its number."""
        with self.errors():
            return dict(self.db.execute(f"SELECT id, {expression} FROM slabs"))

    def _sound_row(self, number: int) -> Slab | None:
        """A row; None if it is damaged or gone."""
        with self.errors():
            row = self.db.execute(
                f"SELECT {_COLUMNS} FROM slabs WHERE id = ?", (number,)
            ).fetchone()
        if row is None:
            return None
        slab = Slab(*row)
        if not slab.is_sound:
            self._damaged.add(number)
            return None
        return slab

    def _read_slab(self, number: int) -> tuple[Slab, Stored] | None:
        """A row and its contents; None if it is damaged or gone."""
        slab = self._sound_row(number)
        if slab is None:
            return None
        try:
            return slab, stored(slab)
        except ValueError as error:
            raise StoreError(
                f"{self.path}: a row was written by something else than a run ({error}): "
                "'gapsweep cache gc --apply' deletes it"
            ) from None


def _values(slab: Slab) -> tuple[Any, ...]:
    return tuple(getattr(slab, field.name) for field in fields(Slab))


def _grouped(numbers: NDArray[np.integer]) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Where each number that is not negative stands."""
    order = np.argsort(numbers, kind="stable")
    order = order[np.searchsorted(numbers[order], 0) :]
    if order.size:
        ends = np.flatnonzero(np.diff(numbers[order])) + 1
        for rows in np.split(order, ends):
            yield int(numbers[rows[0]]), rows


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
