"""Looking after a cache: what is in it, whether it is sound, and what can go."""

import json
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gapsweep.status import Status
from gapsweep.store.cache import Cache
from gapsweep.store.segments import FORMAT
from gapsweep.store.slab import Slab, Stored, stored
from gapsweep.study.points import Points


@dataclass(frozen=True, slots=True)
class Verdict:
    """What `verify` found.

    Attributes
    ----------
    n_points : int
        Points in sound slabs.
    damaged : tuple of Path
        Segments in which something is not as a run has written it.
    """

    n_points: int
    damaged: tuple[Path, ...]

    @property
    def is_sound(self) -> bool:
        return not self.damaged


def info(cache: Cache, numerics: str) -> dict[str, Any]:
    """Size and contents of a cache; `numerics` is the fingerprint that counts as current."""
    by_code: Counter[str] = Counter()
    by_status: Counter[str] = Counter()
    segments: set[Path] = set()
    for frame, slab in cache.slabs():
        segments.add(frame.path)
        by_code[numerics_of(slab)] += slab.n_points
        by_status.update(Status(status).label for status in slab.status if status in set(Status))
    return {
        "folder": str(cache.path.absolute()),
        "format": FORMAT,
        "bytes": sum(path.stat().st_size for path in segments),
        "segments": len(segments),
        "points": by_code.total(),
        "current": by_code[numerics],
        "of_other_code": by_code.total() - by_code[numerics],
        "status": dict(sorted(by_status.items())),
        "numerics": dict(by_code.most_common()),
    }


def verify(cache: Cache) -> Verdict:
    """Check the checksum of every slab and the key of every point."""
    n_points, damaged = 0, set()
    for frame, slab in cache.slabs():
        if is_of_run(slab):
            n_points += slab.n_points
        else:
            damaged.add(frame.path)
    return Verdict(n_points, tuple(sorted(damaged | cache.damaged)))


def is_of_run(slab: Slab) -> bool:
    """Whether a run can have written a slab: its results stand under the keys of their points."""
    contents = contents_of(slab)
    if contents is None:
        return False
    try:
        points = Points(slab.kind, contents.numbers)
        return bool((points.keys_after(slab.identity, contents.previous) == contents.keys).all())
    except ValueError:
        return False


def contents_of(slab: Slab) -> Stored | None:
    """The contents of a slab; None if no run has written it."""
    try:
        return stored(slab)
    except ValueError:
        return None


def removable(cache: Cache, numerics: str) -> dict[bytes, int]:
    """Points of each slab, by its checksum, that no study can ask for: of other code, or no run."""
    return {
        frame.digest: frame.n_points
        for frame, slab in cache.slabs()
        if numerics_of(slab) != numerics or not is_of_run(slab)
    }


def remove(cache: Cache, digests: Collection[bytes]) -> None:
    """Remove slabs by their checksums, and what is damaged, and merge small segments."""
    paths = {frame.path for frame, _ in cache.slabs() if frame.digest in digests}
    cache.rewrite(paths | cache.damaged, lambda frame: frame.digest not in digests)
    cache.merge()


def numerics_of(slab: Slab) -> str:
    """Fingerprint of the code that computed a slab; empty if the slab does not say."""
    try:
        whole = json.loads(slab.identity)
    except (ValueError, RecursionError):
        return ""
    return str(whole.get("numerics", "")) if isinstance(whole, dict) else ""
