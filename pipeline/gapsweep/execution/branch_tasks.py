"""Branches of a study's parameter sets on Dask: one task for each set.

A task runs in the worker. If its worker dies, or its contact law or system is user code, it runs in
an isolated process; the failure of that process is the status of the parameter set.
"""

import hashlib
import json
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from distributed import Client, as_completed, get_worker
from distributed.scheduler import KilledWorker

from gapsweep.continuation.branches import Branches
from gapsweep.continuation.curves import curves
from gapsweep.continuation.dataset import dataset
from gapsweep.continuation.family import Family, Window
from gapsweep.continuation.follow import solver_of
from gapsweep.continuation.orbits import OrbitEquations
from gapsweep.continuation.seed import Attractor
from gapsweep.execution.cluster import check_workers
from gapsweep.execution.execute import is_gone
from gapsweep.execution.isolated import CallError, Isolated, failure
from gapsweep.model.contact import ContactLaw
from gapsweep.status import Status
from gapsweep.study.parametric_model import AlongParameter
from gapsweep.study.points import FIXED, OF_CONTACT, Points
from gapsweep.study.software import software
from gapsweep.study.spec import BranchesTable


@dataclass(frozen=True, slots=True, kw_only=True)
class BranchScene:
    """All inputs of the branches of one parameter set."""

    point: Points  # a sweep point with the model, laws and frequency of the set
    # The system as a function of the parameters, if one of them is a parameter of a system.
    system: AlongParameter | None
    window: Window
    table: BranchesTable
    attractors: tuple[Attractor, ...]
    points: Any = None  # Dataset of special points whose curves are sought; None: the branches are

    @property
    def key(self) -> str:
        """Content key: SHA-256 of all inputs of the branches, including the code."""
        kind, is_branches = self.point.kind, self.points is None
        whole = {
            "software": dict(software()),
            "kind": replace(kind, start=FIXED, start_jitter=0.0).identity,
            "numbers": self.point.numbers[0, : -kind.n_states].tolist(),
            "system": self.system and self.system.identity,
            "window": asdict(self.window),
            "table": self.table.model_dump(exclude={"second", "range"} if is_branches else None),
            "points": None if is_branches else self.points.drop_attrs().to_dict(),
            "attractors": [asdict(each) for each in self.attractors],
        }
        text = json.dumps(whole, sort_keys=True, default=np.ndarray.tolist)
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Branches of a parameter set as a Dataset, or the status and message of the failure."""

    status: Status
    message: str = ""
    branches: Any = None


def model_of(
    point: Points, system: AlongParameter | None
) -> tuple[Any, dict[str, ContactLaw], float | None]:
    """Return the model of a sweep point, its laws by contact, and its frequency if it is forced.

    `point`: a table of one row.
    `system`: a function of parameters that is returned in place of the point's model.
    """
    kind = point.kind
    n = len(kind.contacts) * len(OF_CONTACT)
    walls, omega, numbers = np.split(point.numbers[0, : -kind.n_states], [n, n + 1])
    example = system() if system else kind.structure.system(numbers)
    (several,) = kind.laws(walls[None])
    laws = dict(zip(example.contacts, several, strict=True))
    return system or example, laws, float(omega[0]) or None


def follow(scene: BranchScene) -> Any:
    """Dataset of the branches or curves of a parameter set, as from `gapsweep.branches`.

    The attractors are in the order of the argument. Raises `ModelError` if the model or a law
    cannot be built.
    """
    window, table = scene.window, scene.table
    values: Mapping[str, float] = {window.name: window.low}
    model, laws, omega = model_of(scene.point, scene.system)
    omega = None if window.name == "omega" else omega
    family = Family(model, laws, omega, (window.name,), values)
    solver = solver_of(family, table.rtol, table.atol)
    if scene.points is not None:
        windows = window, Window.of(table.second or "", table.range)
        found = curves(family, windows, solver, scene.points, table.max_steps)
    else:
        equations = OrbitEquations(family, (window,), solver)
        found = Branches(equations=equations, max_steps=table.max_steps)
        found.add([replace(each) for each in scene.attractors])
        for _ in range(table.follow):
            found.follow()
    made = dataset(found)
    made.encoding.clear()  # removes the family, which may not be picklable
    return made


def _task(scene: BranchScene, timeout: float | None) -> Followed:
    """Body of a Dask task: branches of one parameter set; isolated if there is a time limit [s]."""
    try:
        if timeout is None:
            return Followed(Status.OK, branches=follow(scene))
        with Isolated(timeout, get_worker().memory_manager.memory_limit) as isolated:
            return Followed(Status.OK, branches=isolated(follow, scene))
    except CallError as lost:
        return Followed(lost.status, lost.message)
    except Exception as error:  # the task boundary: any error is a result
        return Followed(*failure(error))


def followed(
    scenes: Sequence[BranchScene],
    client: Client,
    timeout: float,
    waiting: Callable[[], None],
    meanwhile: Iterable[bool],
) -> Generator[tuple[int, Followed], None, None]:
    """Branches of parameter sets in the order of completion, each with its position in `scenes`.

    Raises `ClusterError` if all workers run other code, or the cluster is lost. A caller that
    leaves before the end closes the generator, which cancels its tasks.

    `timeout`: CPU time limit [s] of a parameter set in an isolated process.
    `waiting`: called until there is a worker.
    `meanwhile`: other work of this process, a step each while no result has arrived.
    """
    check_workers(client, waiting)
    left = [(i, bool(each.point.kind.own or each.system)) for i, each in enumerate(scenes)][::-1]
    in_flight: dict[Any, tuple[int, bool]] = {}
    completed, steps = as_completed(loop=client.loop), iter(meanwhile)
    try:
        while left or in_flight:
            # One task for each thread: a worker that dies loses no other task.
            while left and len(in_flight) < max(sum(client.nthreads().values()), 1):
                number, alone = left.pop()
                limit = timeout if alone else None
                future = client.submit(_task, scenes[number], limit, pure=False)
                in_flight[future] = number, alone
                completed.add(future)
            while not completed.has_ready() and next(steps, False):
                pass
            future = next(completed)
            number, alone = in_flight.pop(future)
            one = Followed(Status.KILLED, "its worker process died")
            with suppress(KilledWorker):
                one = one if is_gone(future) else future.result()
            if one.status == Status.KILLED and not alone:
                left.append((number, True))
            else:
                yield number, one
    finally:
        with suppress(Exception):  # Dask may raise any error if the cluster has ended
            client.cancel(list(in_flight))
