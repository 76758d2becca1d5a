"""Stored results computed a second time, to see whether they still come out the same."""

import random
from collections.abc import Collection
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import StoreError
from gapsweep.execution.alone import Alone, CallError, response_of
from gapsweep.execution.progress import DEFAULT_TIMEOUT
from gapsweep.execution.sweeps import start_of
from gapsweep.response.result import Response
from gapsweep.status import Status
from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import contents_of, numerics_of, representation_of
from gapsweep.study.fingerprint import numerics_fingerprint
from gapsweep.study.points import KEY, OURS, Kind, Points, law_code

_LOST = (Status.KILLED, Status.TIMED_OUT)


def recomputed_otherwise(
    cache: Cache, sample: int, own_laws: Collection[str] = ()
) -> tuple[list[tuple[str, list[str]]], int]:
    """Compute random points of the present code again; those that came out otherwise.

    Not those that hung or died, which machine and time limit decide. A row is data: the code that
    it names is not run, unless `own_laws` names it too.

    Returns
    -------
    differing : list of (str, list of str)
        Key in hex, and the names of the values that differ; `cpu_time` always may.
    n_skipped : int
        Points of laws that are not in `own_laws`.
    """
    now = numerics_fingerprint()
    keys, n_skipped = [np.empty(0, KEY)], 0
    for _, slab in cache.slabs():
        contents = contents_of(slab) if numerics_of(slab) == now else None
        if contents is not None:
            law = representation_of(slab)
            if ":" not in law or law in own_laws:
                is_lost = np.isin(contents.responses.columns["status"], _LOST)
                keys.append(np.frombuffer(slab.keys, KEY)[~is_lost])
            else:
                n_skipped += slab.n_points
    ours = np.unique(np.concatenate(keys))
    chosen = random.sample(range(len(ours)), min(sample, len(ours)))
    with Alone(DEFAULT_TIMEOUT) as alone:
        compared = [(ours[i].tobytes().hex(), differences(cache, ours[[i]], alone)) for i in chosen]
    return [pair for pair in compared if pair[1]], n_skipped


def differences(cache: Cache, key: NDArray[np.void], alone: Alone) -> list[str]:
    """Names of the values of a stored result that come out otherwise now; `cpu_time` may."""
    place = cache.place(key)
    if place is None:
        return []  # it has gone meanwhile
    slab, contents, row = place
    try:
        kind = slab.kind
    except ValueError:
        return ["identity"]  # whoever wrote this, it was not a run
    if not _is_current(kind, alone):
        return []
    try:
        state, _ = start_of(cache, contents.previous[[row]], kind.n_states)
    except StoreError:  # nobody knows where it started
        return []
    again = response_of(alone, Points(kind, contents.numbers[[row]]), state)
    now, stored = again.row(0), contents.responses.row(row)
    names = [field.name for field in fields(Response) if field.name not in ("cpu_time", "message")]
    pairs = {name: (getattr(now, name), getattr(stored, name)) for name in names}
    return [name for name, (a, b) in pairs.items() if not np.array_equal(a, b, equal_nan=True)]


def _is_current(kind: Kind, alone: Alone) -> bool:
    """Whether the user's own law of a point, if it has one, is still the one that computed it."""
    if kind.law_code == OURS:
        return True
    try:
        return kind.law_code == alone(law_code, kind.representation)
    except CallError:  # it has gone, or does to its process what it did not when it was stored
        return False
