"""Looking after a cache: what is in it, is it sound, what can go, and saving it elsewhere."""

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gapsweep.errors import StoreError
from gapsweep.status import Status
from gapsweep.store.cache import (
    SCHEMA_VERSION,
    Cache,
    DamagedCacheError,
    Record,
    holds_result,
    identity_matches,
    is_sound,
)
from gapsweep.store.salvage import sound_records

_BATCH = 500


@dataclass(frozen=True, slots=True)
class Verdict:
    """What `verify` found.

    Attributes
    ----------
    n_rows : int
        Rows that could be read.
    damaged : tuple of str
        Keys, in hex, of rows that are not as they were written.
    faults : tuple of str
        What SQLite says about the file itself; empty if it is sound.
    """

    n_rows: int
    damaged: tuple[str, ...]
    faults: tuple[str, ...]

    @property
    def is_sound(self) -> bool:
        return not self.damaged and not self.faults


def info(cache: Cache, numerics: str) -> dict[str, Any]:
    """Size and contents of a cache; `numerics` is the fingerprint that counts as current."""
    by_code: Counter[str] = Counter()
    by_status: Counter[str] = Counter()
    for record in cache.records():
        by_code[numerics_of(record)] += 1
        by_status[_status_label(record)] += 1
    return {
        "file": str(cache.path.absolute()),
        "format": SCHEMA_VERSION,
        "bytes": cache.path.stat().st_size,
        "network": cache.on_network,
        "rows": by_code.total(),
        "current": by_code[numerics],
        "of_other_code": by_code.total() - by_code[numerics],
        "status": dict(sorted(by_status.items())),
        "numerics": dict(by_code.most_common()),
    }


def verify(cache: Cache) -> Verdict:
    """Check the file's structure and every row's checksum and key."""
    try:
        with cache.errors():
            faults = [text for (text,) in cache.db.execute("PRAGMA integrity_check")]
    except StoreError as error:  # too damaged to be checked
        faults = [str(error)]
    n_rows, damaged = 0, []
    for record in readable(cache):
        n_rows += 1
        if not (holds_result(record) and identity_matches(record)):
            damaged.append(_hex(record[0]))
    return Verdict(n_rows, tuple(damaged), tuple(f for f in faults if f != "ok"))


def removable(cache: Cache, numerics: str) -> list[bytes]:
    """Keys of the rows that no study can ask for any more: of other code, or damaged."""
    return [
        record[0]
        for record in cache.records()
        if numerics_of(record) != numerics or not holds_result(record)
    ]


def remove(cache: Cache, keys: list[bytes]) -> None:
    """Delete rows and give their room back."""
    with cache.errors():
        with cache.transaction():
            cache.db.executemany("DELETE FROM results WHERE key = ?", [(key,) for key in keys])
        cache.db.execute("VACUUM")


def export(source: Path, target: Path) -> int:
    """Copy all sound rows of a cache, however damaged, to a new one; how many there were.

    Raises
    ------
    StoreError
        If there is a file already, or it cannot be written.
    """
    if target.exists():
        raise StoreError(f"{target}: exists already; name a new file")
    with Cache(target) as copy, copy.errors():
        try:
            with Cache(source, read_only=True) as cache, copy.transaction():
                copy.insert(record for record in cache.records() if is_sound(record))
        except DamagedCacheError:
            with copy.transaction():
                copy.insert(sound_records(source).values())
        (n_rows,) = copy.db.execute("SELECT count(*) FROM results").fetchone()
    return int(n_rows)


def readable(cache: Cache) -> Iterator[Record]:
    """Every record that can still be read, from both ends of the table if it is damaged."""
    seen: set[Any] = set()
    for order in ("ASC", "DESC"):
        try:
            for record in cache.records(order):
                if record[0] not in seen:
                    seen.add(record[0])
                    yield record
        except StoreError:
            continue
        return


def numerics_of(record: Record) -> str:
    """Fingerprint of the code that computed a row; empty if the row does not say."""
    return str(_identity(record).get("numerics", ""))


def representation_of(record: Record) -> str:
    """The law of a row; empty if the row does not say."""
    point = _identity(record).get("point")
    return str(point.get("representation", "")) if isinstance(point, dict) else ""


def _identity(record: Record) -> dict[str, Any]:
    """A row's identity; nothing if a run cannot have written it."""
    try:
        whole = json.loads(record[1])
    except (ValueError, TypeError, RecursionError):
        return {}
    return whole if isinstance(whole, dict) else {}


def _status_label(record: Record) -> str:
    try:
        return Status(record[3]).label
    except ValueError:
        return "damaged"


def _hex(key: Any) -> str:
    return key.hex() if isinstance(key, bytes) else repr(key)
