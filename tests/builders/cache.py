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

    `answer`: from the point's place on every axis, by name, to a Response; None: is not stored.
    """
    grid = study.grid
    for block in plan(study).blocks():
        for rows, table in study.points(block.cells):
            at = np.transpose(np.unravel_index(block.cells[rows], grid.shape)).tolist()
            answers = [answer(dict(zip(grid.dims, place, strict=True))) for place in at]
            kept = [i for i, one in enumerate(answers) if one is not None]
            here = rows[kept]
            responses = Responses.of([answers[i] for i in kept], study.structure)
            previous = block.previous(here)
            for row, has_ended in enumerate(np.isfinite(responses.ends).all(axis=1)[:-1]):
                if not has_ended and previous[row + 1] == block.keys[here[row]]:
                    previous[row + 1] = previous[row]  # it started from where that did
            about = table.kind.identity, table.numbers[kept], block.keys[here], previous
            cache.commit(list(slabs(*about, responses, host, "")))


def cells_and_keys(study):
    """Flat positions in the grid and content keys of all points, in the order of computation."""
    columns = zip(*((block.cells, block.keys) for block in plan(study).blocks()), strict=True)
    return tuple(map(np.concatenate, columns))


def all_keys(study):
    """Content keys by place on the axes."""
    cells, keys = cells_and_keys(study)
    places = np.transpose(np.unravel_index(cells, study.grid.shape))
    return dict(zip(map(tuple, places.tolist()), keys.tolist(), strict=True))


def point(study, *place):
    """The table with the one point at a place."""
    cell = np.ravel_multi_index(place, study.grid.shape)
    ((_, table),) = study.points(np.array([cell]))
    return table


def rows(cache, keys):
    """Stored responses by key."""
    found = cache.found(cache.recorded(keys))
    asked = [keys[i].tobytes() for i in found.at.tolist()]
    return dict(zip(asked, found.responses.rows(), strict=True))


def stored(study, cache):
    """Stored responses of all points of a study, by place."""
    keys = all_keys(study)
    by_key = rows(cache, np.frombuffer(b"".join(keys.values()), KEY))
    return {place: by_key[key] for place, key in keys.items() if key in by_key}


def n_stored(path):
    """Points of a cache, which need not be there yet."""
    if not path.exists():
        return 0
    with Cache(path, read_only=True) as cache:
        return cache.n_points


def messages(study, cache):
    """Stored message of each point of a study, by place."""
    return {place: one.message for place, one in stored(study, cache).items()}


def sweep_tiles(study, representation=0):
    """Tiles of a study's sweeps by one representation, one for each direction."""
    block = plan(study).block(representation)
    tiles = []
    for rows, table in block.tables:
        firsts = np.flatnonzero(~block.follows[rows])
        about = table.kind.identity, block.keys[rows], block.previous(rows)
        starts = np.zeros((len(firsts), table.kind.n_states)), np.zeros(len(firsts), KEY)
        tiles.append(Tile(table, *about, np.diff(firsts, append=len(rows)), *starts))
    return tiles


def tile_rows(study, representation=0):
    """Responses of all points of a sweep, computed here in one tile."""
    (tile,) = sweep_tiles(study, representation)
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
