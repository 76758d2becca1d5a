"""Maintenance of a cache: statistics, verification and removal of unused results."""

import json
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gapsweep.status import Status
from gapsweep.store.cache import Cache
from gapsweep.store.segments import FORMAT
from gapsweep.store.slab import Slab, Stored, stored
from gapsweep.study.points import KEY, Points

_ABANDONED = 86_400.0  # age [s] of a temporary file without a writer


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of a verification: number of points in intact slabs, and damaged segments."""

    n_points: int
    damaged: tuple[Path, ...]

    @property
    def is_sound(self) -> bool:
        return not self.damaged


def info(cache: Cache, numerics: str) -> dict[str, Any]:
    """Size and contents of a cache by code version and status; `numerics`: current version."""
    by_code: Counter[str] = Counter()
    by_status: Counter[int] = Counter()
    sizes: dict[Path, int] = {}
    for frame, slab in cache.slabs():
        with suppress(FileNotFoundError):  # another process has merged it
            sizes[frame.path] = frame.path.stat().st_size
        by_code[_numerics_of(slab)] += slab.n_points
        by_status.update(slab.status)
    return {
        "folder": str(cache.path.absolute()),
        "format": FORMAT,
        "bytes": sum(sizes.values()),
        "segments": len(sizes),
        "points": by_code.total(),
        "current": by_code[numerics],
        "of_other_code": by_code.total() - by_code[numerics],
        "status": {s.label: by_status[s] for s in Status if by_status[s]},
        "numerics": dict(by_code.most_common()),
    }


def verify(cache: Cache) -> Verdict:
    """Check the checksum of every slab and the key of every point."""
    sound = {frame: _is_of_run(slab) for frame, slab in cache.slabs()}
    damaged = cache.damaged | {frame.path for frame, is_sound in sound.items() if not is_sound}
    n_points = sum(frame.n_points for frame, is_sound in sound.items() if is_sound)
    return Verdict(n_points, tuple(sorted(damaged)))


def clean(cache: Cache, numerics: str, *, apply: bool) -> tuple[int, int]:
    """Remove damaged slabs and slabs of other code or of no run, and merge small segments.

    Result: numbers of points and of damaged segments that are removed, or would be with `apply`.
    """
    gone = {
        frame: frame.n_points
        for frame, slab in cache.slabs()
        if _numerics_of(slab) != numerics or not _is_of_run(slab)
    }
    n_damaged = len(cache.damaged)
    if apply:
        paths = {frame.path for frame in gone} | cache.damaged
        cache.rewrite(paths, {frame.digest for frame in gone})
        cache.merge()
        for path in cache.path.glob(".*.seg.*"):  # temporary files of killed writers
            if path.stat().st_mtime < time.time() - _ABANDONED:
                path.unlink(missing_ok=True)
    return sum(gone.values()), n_damaged


def contents_of(slab: Slab) -> Stored | None:
    """The contents of a slab; None if no run has written it."""
    try:
        return stored(slab)
    except ValueError:
        return None


def _is_of_run(slab: Slab) -> bool:
    """Whether a run can have written a slab: its keys are the content keys of its points.

    Not checked are points of sweeps that did not start from the preceding point, as its motion has
    no end state: the slab holds where they started instead. Each has a message.
    """
    try:
        previous, numbers, responses = stored(slab)
        keys = Points(slab.kind, numbers).keys_after(slab.identity, previous)
        unlike = np.flatnonzero(keys != np.frombuffer(slab.keys, KEY)).tolist()
        return not unlike or (slab.kind.is_sweep and responses.messages.keys() >= {*unlike})
    except ValueError:
        return False


def _numerics_of(slab: Slab) -> str:
    """Fingerprint of the code that computed a slab; empty if the slab does not record it."""
    try:
        whole = json.loads(slab.identity)
    except (ValueError, RecursionError):
        return ""
    return str(whole.get("numerics", "")) if isinstance(whole, dict) else ""
