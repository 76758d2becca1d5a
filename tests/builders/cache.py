"""Results in a cache, without computing any."""

import numpy as np

from gapsweep.execution.plan import plan
from gapsweep.execution.task import Tile, respond_to
from gapsweep.integrate.problem import Solver
from gapsweep.model.labels import EXACT
from gapsweep.response.result import Responses, Steady
from gapsweep.store.cache import Cache
from gapsweep.store.slab import slabs
from gapsweep.study.points import KEY, Kind, Points

KIND = Kind(representation=EXACT, contacts=(EXACT,), solver=Solver.of(), steady=Steady())


def points(*names, kind=KIND):
    """Points that differ in their stiffness: one for each name, which is any number."""
    numbers = np.ones((len(names), len(kind.numbers)))
    numbers[:, 0] = names
    return Points(kind, numbers)


def keys(*names, kind=KIND):
    return points(*names, kind=kind).keys()


def made(names, responses, *, kind=KIND, host="machine"):
    """Rows of a cache that hold these responses of points of these names."""
    table = points(*names, kind=kind)
    nothing = np.zeros(len(table), KEY)
    return list(
        slabs(
            *(table.kind.identity, table.numbers, table.keys(), nothing),
            *(Responses.of(responses), host, "Python 3"),
        )
    )


def commit(cache, study, answer, host="here"):
    """Store what a function answers for every point of a study.

    Parameters
    ----------
    answer : callable
        From the point's place on every axis, by name, to a Response; None: is not stored.
    """
    planned, grid = plan(study), study.grid
    for rows, table in study.points(planned.cells):
        at = np.transpose(np.unravel_index(planned.cells[rows], grid.shape)).tolist()
        answers = [answer(dict(zip(grid.dims, place, strict=True))) for place in at]
        kept = [i for i, one in enumerate(answers) if one is not None]
        here = rows[kept]
        responses = Responses.of([answers[i] for i in kept], study.structure)
        previous = planned.previous(here)
        for row, has_ended in enumerate(np.isfinite(responses.ends).all(axis=1)[:-1]):
            if not has_ended and previous[row + 1] == planned.keys[here[row]]:
                previous[row + 1] = previous[row]  # it started from where that did
        cache.commit(
            list(
                slabs(
                    *(table.kind.identity, table.numbers[kept], planned.keys[here], previous),
                    *(responses, host, ""),
                )
            )
        )


def all_keys(study):
    """Content keys by place on the axes."""
    planned = plan(study)
    places = np.transpose(np.unravel_index(planned.cells, study.grid.shape))
    return dict(zip(map(tuple, places.tolist()), planned.keys.tolist(), strict=True))


def point(study, *place):
    """The table with the one point at a place."""
    cell = np.ravel_multi_index(place, study.grid.shape)
    ((_, table),) = study.points(np.array([cell]))
    return table


def rows(cache, keys):
    """Stored responses by key."""
    found = cache.find(keys)
    asked = [keys[i].tobytes() for i in found.at.tolist()]
    return dict(zip(asked, found.responses.rows(), strict=True))


def stored(study, cache):
    """Stored responses of all points of a study, by place."""
    planned = plan(study)
    by_key = rows(cache, planned.keys)
    places = np.transpose(np.unravel_index(planned.cells, study.grid.shape)).tolist()
    keys = planned.keys.tolist()
    return {tuple(p): by_key[k] for p, k in zip(places, keys, strict=True) if k in by_key}


def n_stored(path):
    """Points of a cache, which need not be there yet."""
    if not path.exists():
        return 0
    with Cache(path, read_only=True) as cache:
        return cache.n_points


def messages(study, cache):
    """Stored message of each point of a study, by place."""
    return {place: one.message for place, one in stored(study, cache).items()}


def tile_rows(study, representation=0):
    """Responses of all points of a sweep, computed here in one tile."""
    planned = plan(study)
    rows = np.flatnonzero(planned.representation(np.arange(planned.n_points)) == representation)
    ((_, table),) = study.points(planned.cells[rows])
    nothing = np.zeros(len(rows), KEY)
    tile = Tile(table, "", nothing, nothing, np.array([len(rows)]), np.zeros((1, 2)), nothing[:1])
    return respond_to(tile).rows()


def damaged_row(path):
    """Flip a bit in the columns of a slab of a cache, and of its copies; its number of points."""
    with Cache(path, read_only=True) as cache:
        held = list(cache.slabs())
    _, last = held[-1]
    for frame, slab in held:
        if slab.keys == last.keys:  # two tasks may have computed the same points
            data = bytearray(frame.path.read_bytes())
            data[frame.end - 1] ^= 1
            frame.path.write_bytes(data)
    return last.n_points
