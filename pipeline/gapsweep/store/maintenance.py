"""Looking after a cache: what is in it, is it sound, what can go, and saving it elsewhere."""

import json
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gapsweep.errors import StoreError
from gapsweep.status import Status
from gapsweep.store.artefact import replacing
from gapsweep.store.cache import SCHEMA_VERSION, Cache, DamagedCacheError
from gapsweep.store.salvage import sound_slabs
from gapsweep.store.slab import Slab, Stored, stored
from gapsweep.study.points import KEY, Points


@dataclass(frozen=True, slots=True)
class Verdict:
    """What `verify` found.

    Attributes
    ----------
    n_points : int
        Points in the rows that could be read.
    damaged : tuple of str
        Keys, in hex, of points in rows that are not as they were written.
    faults : tuple of str
        What SQLite says about the file itself; empty if it is sound.
    """

    n_points: int
    damaged: tuple[str, ...]
    faults: tuple[str, ...]

    @property
    def is_sound(self) -> bool:
        return not self.damaged and not self.faults


def info(cache: Cache, numerics: str) -> dict[str, Any]:
    """Size and contents of a cache; `numerics` is the fingerprint that counts as current."""
    by_code: Counter[str] = Counter()
    by_status: Counter[str] = Counter()
    n_slabs = 0
    for _, slab in cache.slabs():
        n_slabs += 1
        by_code[numerics_of(slab)] += slab.n_points
        by_status.update(map(_status_label, slab.status if slab.is_sound else [-1] * slab.n_points))
    return {
        "file": str(cache.path.absolute()),
        "format": SCHEMA_VERSION,
        "bytes": cache.path.stat().st_size,
        "network": cache.on_network,
        "rows": n_slabs,
        "points": by_code.total(),
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
    n_points, damaged = 0, []
    for slab in readable(cache):
        n_points += slab.n_points
        damaged += _damaged(slab)
    return Verdict(n_points, tuple(damaged), tuple(f for f in faults if f != "ok"))


def _damaged(slab: Slab) -> list[str]:
    """Keys, in hex, of the points of a row that no run can have written as they are."""
    keys = slab.keys if isinstance(slab.keys, bytes) else b""
    size = KEY.itemsize
    of_all = [keys[at : at + size].hex() for at in range(0, len(keys), size)] or ["?"]
    contents = contents_of(slab)
    if contents is None:
        return of_all
    try:
        points = Points(slab.kind, contents.numbers)
    except ValueError:
        return of_all
    is_right = points.keys_after(slab.identity, contents.previous) == contents.keys
    return [key for key, is_one in zip(of_all, is_right.tolist(), strict=True) if not is_one]


def contents_of(slab: Slab) -> Stored | None:
    """What a sound row holds; None if it is damaged, or no run has written it."""
    try:
        return stored(slab) if slab.is_sound else None
    except ValueError:
        return None


def removable(cache: Cache, numerics: str) -> set[int]:
    """Numbers of the rows that no study can ask for any more: of other code, or damaged."""
    return {
        number for number, slab in cache.slabs() if numerics_of(slab) != numerics or _damaged(slab)
    }


def remove(cache: Cache, numbers: Collection[int]) -> None:
    """Delete rows and give their room back."""
    with cache.errors():
        with cache.transaction():
            cache.delete(numbers)
        cache.db.execute("VACUUM")


def export(source: Path, target: Path) -> int:
    """Copy all sound rows of a cache, however damaged, to a new one; how many points they hold.

    Raises
    ------
    StoreError
        If there is a file already, it cannot be written, or nothing is left of the cache.
    """
    if target.exists():
        raise StoreError(f"{target}: exists already; name a new file")
    for log in (target.with_name(f"{target.name}{end}") for end in ("-wal", "-journal")):
        if log.exists():  # SQLite would play it back over the copy
            raise StoreError(f"{log}: the log of a cache that has gone: remove it")
    with replacing(target) as temporary, Cache(temporary) as copy, copy.errors():
        try:
            with Cache(source, read_only=True) as cache, copy.transaction():
                copy.insert(slab for _, slab in cache.slabs() if slab.is_sound)
        except DamagedCacheError:
            if not (found := sound_slabs(source)):
                raise
            with copy.transaction():
                copy.insert(found.values())
        return sum(slab.n_points for _, slab in copy.slabs())


def readable(cache: Cache) -> Iterator[Slab]:
    """Every row that can still be read, from both ends of the table if it is damaged."""
    seen: set[int] = set()
    for order in ("ASC", "DESC"):
        try:
            for number, slab in cache.slabs(order):
                if number not in seen:
                    seen.add(number)
                    yield slab
        except StoreError:
            continue
        return


def numerics_of(slab: Slab) -> str:
    """Fingerprint of the code that computed a row; empty if the row does not say."""
    return str(_identity(slab).get("numerics", ""))


def _identity(slab: Slab) -> dict[str, Any]:
    """What a row says of all its points; nothing if a run cannot have written it."""
    try:
        whole = json.loads(slab.identity)
    except (ValueError, TypeError, RecursionError):
        return {}
    return whole if isinstance(whole, dict) else {}


def _status_label(status: int) -> str:
    try:
        return Status(status).label
    except ValueError:
        return "damaged"
