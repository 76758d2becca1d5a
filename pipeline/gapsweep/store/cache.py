"""The point cache: one SQLite file, one row per sweep point computed.

The cache is the truth; every NetCDF file can be rebuilt from it. Rows hold plain text and
numbers (never pickle) and a checksum; they are never changed in place by a newer code
version, because the key holds the fingerprint of the code.
"""

import hashlib
import json
import math
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any

from gapsweep.errors import StoreError
from gapsweep.response.respond import Response, ResponseClass
from gapsweep.status import Status

SCHEMA_VERSION = 1
_BATCH = 500  # keys per query; SQLite allows 999 parameters everywhere

_LISTS = {field.name for field in fields(Response) if field.default == ()}

_TABLE = """
CREATE TABLE results (
    key      TEXT PRIMARY KEY,  -- content key of the point
    point    TEXT NOT NULL,     -- what the key was made of, JSON
    response TEXT NOT NULL,     -- the result, JSON
    checksum TEXT NOT NULL,     -- SHA-256 of key and response
    status   INTEGER NOT NULL,
    cpu_time REAL,
    host     TEXT NOT NULL,
    created  TEXT NOT NULL      -- UTC
)
"""


@dataclass(frozen=True, slots=True)
class Row:
    """A stored result: its key, its response and the machine that computed it."""

    key: str
    response: Response
    host: str


class Cache:
    """An open point cache; a context manager.

    Parameters
    ----------
    path : path-like
        The file; created, with its folder, if it does not exist.

    Raises
    ------
    StoreError
        If the file cannot be opened or is not a gapsweep cache of this version.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{self.path.parent}: cannot be created: {error.strerror}") from None
        with self._errors():
            self._db = sqlite3.connect(self.path, timeout=60.0, isolation_level=None)
            self._db.execute("PRAGMA journal_mode = WAL")
            # A commit survives the death of the process; power loss may cost the last ones.
            self._db.execute("PRAGMA synchronous = NORMAL")
            self._prepare()

    def _prepare(self) -> None:
        with self._transaction():
            (version,) = self._db.execute("PRAGMA user_version").fetchone()
            (n_tables,) = self._db.execute("SELECT count(*) FROM sqlite_master").fetchone()
            if version == 0 and n_tables == 0:
                self._db.execute(_TABLE)
                self._db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
            elif version != SCHEMA_VERSION:
                raise StoreError(
                    f"{self.path}: a cache of format {version}, this gapsweep writes "
                    f"{SCHEMA_VERSION}: choose another file with --cache"
                )

    def __enter__(self) -> "Cache":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._db.close()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: {error}") from None

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        # IMMEDIATE: a reader that becomes a writer later would defeat the busy timeout.
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            self._db.execute("ROLLBACK")
            raise
        self._db.execute("COMMIT")

    def statuses(self, keys: Iterable[str]) -> dict[str, Status]:
        """Status of every key that is stored undamaged; the others are to be computed again."""
        rows = self._select("key, response, checksum, status", keys)
        return {key: Status(s) for key, text, check, s in rows if _checksum(key, text) == check}

    def cpu_times(self, keys: Iterable[str]) -> dict[str, float]:
        """Processor time [s] of every key that is stored and has one."""
        return {key: t for key, t in self._select("key, cpu_time", keys) if t is not None}

    def rows(self, keys: Iterable[str]) -> dict[str, Row]:
        """Stored results; a row that fails its checksum is left out, as if missing."""
        found = {}
        for key, text, checksum, host in self._select("key, response, checksum, host", keys):
            if _checksum(key, text) == checksum:
                found[key] = Row(key, _decoded(text), host)
        return found

    def commit(self, rows: Sequence[tuple[Row, dict[str, Any]]]) -> None:
        """Store results with the fields their keys were made of, in one transaction."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        records = []
        for row, point in rows:
            text = _encoded(row.response)
            cpu_time = row.response.cpu_time
            records.append(
                (
                    row.key,
                    json.dumps(point, sort_keys=True),
                    text,
                    _checksum(row.key, text),
                    int(row.response.status),
                    None if math.isnan(cpu_time) else cpu_time,
                    row.host,
                    now,
                )
            )
        with self._errors(), self._transaction():
            self._db.executemany(
                "INSERT OR REPLACE INTO results VALUES (?, ?, ?, ?, ?, ?, ?, ?)", records
            )

    def _select(self, columns: str, keys: Iterable[str]) -> Iterator[tuple[Any, ...]]:
        with self._errors():
            for some in _batches(keys):
                marks = ",".join("?" * len(some))
                yield from self._db.execute(
                    f"SELECT {columns} FROM results WHERE key IN ({marks})", some
                )


def _batches(keys: Iterable[str]) -> Iterator[tuple[str, ...]]:
    iterator = iter(keys)
    while some := tuple(islice(iterator, _BATCH)):
        yield some


def _checksum(key: str, text: str) -> str:
    return hashlib.sha256(f"{key}\n{text}".encode()).hexdigest()


def _encoded(response: Response) -> str:
    """JSON of a response; NaN as null, because JSON has none. Floats round-trip exactly."""
    values = asdict(response)
    for name, value in values.items():
        if isinstance(value, float) and not math.isfinite(value):
            values[name] = None
    return json.dumps(values, separators=(",", ":"), allow_nan=False)


def _decoded(text: str) -> Response:
    values: dict[str, Any] = {k: math.nan if v is None else v for k, v in json.loads(text).items()}
    # What an older version did not know keeps its default.
    for name in _LISTS & values.keys():
        values[name] = tuple(values[name])
    values["status"] = Status(values["status"])
    values["response_class"] = ResponseClass(values["response_class"])
    return Response(**values)
