"""Branches of a study's scenes on Dask: one task per scene.

A scene is computed in the worker. If its worker dies, or its contact law or system is user code, it
is computed in an isolated process; what happens to that process is the status of the scene.
"""

import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from distributed import Client, Future, as_completed, get_worker
from distributed.scheduler import KilledWorker

from gapsweep.continuation.branches import Attractor, Branches
from gapsweep.continuation.call import DEFAULT_ATOL, DEFAULT_RTOL
from gapsweep.continuation.dataset import dataset
from gapsweep.continuation.family import Family, Window
from gapsweep.continuation.orbits import OrbitEquations
from gapsweep.errors import ClusterError
from gapsweep.execution.cluster import check_workers
from gapsweep.execution.execute import is_gone
from gapsweep.execution.isolated import CallError, Isolated, failure
from gapsweep.integrate.problem import Model, Solver
from gapsweep.model.contact import ContactLaw
from gapsweep.model.labels import contact_law
from gapsweep.model.oscillator import Gap
from gapsweep.status import Status
from gapsweep.study.parametric_model import AlongParameter
from gapsweep.study.points import OF_CONTACT, Points
from gapsweep.study.spec import BranchesTable
from gapsweep.user_code.package_digest import continuation_fingerprint

_MAX_ATTEMPTS = 5  # of a scene whose workers die


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What the branches of one scene depend on.

    Attributes
    ----------
    model : Oscillator, System, or callable
        As of a `Family`.
    point : Points
        One sweep point of the scene, whose walls and laws are those of the scene.
    omega : float, optional
        Forcing frequency [Hz], where it is not the parameter.
    window : Window
    table : BranchesTable
    attractors : tuple of Attractor
    """

    model: Model | AlongParameter
    point: Points
    omega: float | None
    window: Window
    table: BranchesTable
    attractors: tuple[Attractor, ...]

    @property
    def is_own(self) -> bool:
        """Whether it runs user code."""
        made = self.model.make.own if isinstance(self.model, AlongParameter) else None
        return self.point.kind.own is not None or made is not None

    @property
    def key(self) -> str:
        """Content key: SHA-256 of all that the branches depend on, the code included."""
        model: Any = self.model
        if isinstance(model, AlongParameter):
            own = model.make.own
            table = model.make.table.model_dump()
            model = [table, own and own.key, sorted(model.values.items()), model.name]
        else:
            model = asdict(model)
        kind = self.point.kind
        whole = {
            "code": continuation_fingerprint(),
            "kind": replace(kind, start="fixed", start_jitter=0.0).identity,
            "numbers": self.point.numbers[0, : -kind.n_states].tolist(),
            "model": model,
            "omega": self.omega,
            "window": asdict(self.window),
            "table": self.table.model_dump(),
            "attractors": [asdict(each) for each in self.attractors],
        }
        text = json.dumps(whole, sort_keys=True, default=np.ndarray.tolist)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def laws(self) -> tuple[ContactLaw, ...]:
        """The laws of all contacts.

        Raises
        ------
        ModelError
            If one cannot be built.
        """
        kind, n = self.point.kind, len(self.point.kind.contacts)
        walls = self.point.numbers[0, : n * len(OF_CONTACT)].reshape(n, -1).tolist()
        laws = []
        for label, (K_c, j_1, j_2, K_ratio) in zip(kind.contacts, walls, strict=True):
            gap = Gap(j_1, j_2)
            if ":" in label and kind.own is not None:
                laws.append(kind.own.law(K_c, gap, K_ratio))
            else:
                laws.append(contact_law(label, K_c, gap, kind.fit_range, K_ratio=K_ratio))
        return tuple(laws)


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Branches of a scene as a Dataset, or why there are none."""

    status: Status
    message: str = ""
    branches: Any = None


def follow(scene: Scene) -> Any:
    """Dataset of the branches of a scene, as of `gapsweep.branches`; attractors in their order.

    Raises
    ------
    ModelError
        If the model or a law cannot be built.
    """
    window, table = scene.window, scene.table
    values: Mapping[str, float] = {window.name: window.low}
    model = scene.model
    contacts = (model(**values) if isinstance(model, AlongParameter) else model).contacts
    laws = dict(zip(contacts, scene.laws, strict=True))
    family = Family(model, laws, scene.omega, (window.name,), values)
    solver = Solver.of("compiled", table.rtol or DEFAULT_RTOL, table.atol or DEFAULT_ATOL)
    found = Branches(equations=OrbitEquations(family, (window,), solver), max_steps=table.max_steps)
    found.add([replace(each) for each in scene.attractors])
    for _ in range(table.follow):
        found.follow()
    made = dataset(found)
    made.encoding.clear()  # the family, which need not be picklable
    return made


def _task(scene: Scene) -> Followed:
    """Body of a Dask task."""
    try:
        return Followed(Status.OK, branches=follow(scene))
    except Exception as error:  # the task boundary: of any type, it is the scene's own result
        return Followed(*failure(error))


def _isolated_task(scene: Scene, timeout: float) -> Followed:
    """Body of a Dask task whose scene cannot harm the worker."""
    with Isolated(timeout, get_worker().memory_manager.memory_limit) as isolated:
        try:
            return Followed(Status.OK, branches=isolated(follow, scene))
        except CallError as lost:
            return Followed(lost.status, lost.message)


def followed(
    scenes: Sequence[Scene], client: Client, timeout: float, waiting: Callable[[], None]
) -> Iterator[tuple[int, Followed]]:
    """Branches of scenes as they arrive, each with the number of its scene.

    Parameters
    ----------
    timeout : float
        Time [s] that a scene may take in an isolated process.
    waiting : callable
        Called until there is a worker.

    Raises
    ------
    ClusterError
        If all workers run other code, or the cluster is lost.
    """
    check_workers(client, waiting)
    left = deque((number, int(scene.is_own)) for number, scene in enumerate(scenes))
    in_flight: dict[Future, tuple[int, int]] = {}
    completed = as_completed(loop=client.loop)
    try:
        while left or in_flight:
            # One for each thread: a worker that dies takes no other scene with it.
            while left and len(in_flight) < max(sum(client.nthreads().values()), 1):
                number, attempts = left.popleft()
                body: tuple[Any, ...] = (_isolated_task, scenes[number], timeout)
                future = client.submit(*(body if attempts else (_task, scenes[number])), pure=False)
                in_flight[future] = number, attempts
                completed.add(future)
            future = next(completed)
            number, attempts = in_flight.pop(future)
            try:
                if not is_gone(future):
                    yield number, future.result()
                    continue
            except KilledWorker:
                pass
            except ClusterError:
                raise
            except Exception as error:  # a task's own, of any type, becomes the scene's failure
                yield number, Followed(*failure(error))
                continue
            if attempts < _MAX_ATTEMPTS:
                left.append((number, attempts + 1))
            else:
                yield number, Followed(Status.KILLED, "its worker process died")
    finally:
        with suppress(Exception):  # Dask may raise anything if the cluster has gone already
            client.cancel(list(in_flight))
