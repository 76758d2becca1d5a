"""Failures are attributed to their cause, and never replace a result."""

import os
import time

import numpy as np
import pytest
from tests.builders.cache import commit, points, stored
from tests.builders.runs import run, started

import gapsweep as gs
from gapsweep.execution import task
from gapsweep.execution.cluster import cluster
from gapsweep.execution.isolated import Isolated
from gapsweep.execution.task import response_of
from gapsweep.integrate.problem import Solver
from gapsweep.integrate.stepping import batch
from gapsweep.model.labels import Representation
from gapsweep.model.own_law import OwnLaw
from gapsweep.store.cache import Cache
from gapsweep.study.points import Kind

pytestmark = pytest.mark.extended

LAWS = "tests.misbehaving.forces"
OPTIONS = ("--out", "out", "--cache", "out-cache", "--workers", "1")


def break_numba(n_times: float = float("inf")) -> None:
    """Have numba fail, as it does on a bug of its own or where it lacks memory."""
    from numba.core.errors import LoweringError

    whole, failures = batch.run, []

    def run(*arguments, **options):
        if len(failures) < n_times:
            failures.append(1)
            raise LoweringError("out of registers\nand so on")
        return whole(*arguments, **options)

    batch.run = run


@pytest.fixture
def one_point(tables):
    tables["sweep"][0] |= {"representation": ["tanh-1e4"], "omega": [12.0]}
    return tables


def responses(tables, folder):
    study = gs.Study.from_dict(tables)
    with Cache(folder / "out-cache") as cache:
        return list(stored(study, cache).values())


def test_only_a_users_law_can_be_one_that_numba_does_not_compile(client, one_point, tmp_path):
    labels = ["tanh-1e4", f"{LAWS}:undefined"]
    with cluster(workers=1) as own:
        own.wait_for_workers(1)
        own.run(break_numba)
        one_point["sweep"][0]["representation"] = labels
        run(one_point, own, tmp_path)
    ours, compiles = responses(one_point, tmp_path)
    assert ours.status == gs.Status.ERROR
    assert ours.message == "LoweringError: out of registers"
    assert compiles.status == gs.Status.ERROR
    one_point["sweep"][0]["representation"] = [*labels, f"{LAWS}:leaving"]
    with pytest.raises(gs.StudyError, match=f"{LAWS}:leaving: its process ended with exit code 7"):
        run(one_point, client, tmp_path)
    one_point["sweep"][0]["representation"] = labels[:1]
    ds = run(one_point, client, tmp_path, retry_failed=True)
    assert ds["status"].item() == gs.Status.OK


def test_what_fails_before_the_clock_starts_is_no_secret(one_point, tmp_path):
    # It would be done again within the first point's time.
    with cluster(workers=1) as own:
        own.wait_for_workers(1)
        own.run(break_numba, 1)
        assert run(one_point, own, tmp_path)["status"].item() == gs.Status.ERROR


def load_slowly() -> None:
    """Have machine code take its time when it is first called."""
    whole, calls = task.Ensemble.call, []

    def call(*arguments, **options):
        if not calls:
            calls.append(time.sleep(2.0))
        return whole(*arguments, **options)

    task.Ensemble.call = call


def test_no_point_is_timed_out_for_its_machine_code(one_point, tmp_path):
    with cluster(workers=1) as own:
        own.wait_for_workers(1)
        own.run(load_slowly)
        before = own.run(os.getpid)
        assert run(one_point, own, tmp_path, timeout=1.0)["status"].item() == gs.Status.OK
        assert own.run(os.getpid) == before, "the worker was given up"


def test_no_point_alone_is_timed_out_for_what_it_loads(tmp_path):
    (tmp_path / "slow_to_load.py").write_text("import time\ntime.sleep(7)\ndef law(x): return x\n")
    own, solver = OwnLaw.of("slow_to_load:law", [tmp_path]), Solver.of("scipy", 1e-3)
    law = Representation(own.label)
    given = {"representation": law, "law_code": own.key, "own": own}
    settings = {"contacts": (law,), "solver": solver, "steady": gs.Steady(t_max=1.0)}
    kind = Kind(**given, **settings)
    with Isolated(5.0) as isolated:  # an orbit of rtol 1e-3 is confirmed at 1e-9
        response = response_of(isolated, points(1.0, kind=kind), np.zeros(2)).row(0)
    assert response.status < gs.Status.TIMED_OUT


STUDY = """
oscillator = { mass = 3.0, omega_n = 5.0, zeta = 0.03, forcing = 4.0, alpha = 7e8 }
[study]
name = "late"
[solver]
engine = "scipy"
[[sweep]]
representation = ["tests.misbehaving.forces:hanging"]
K_c = [1.4e4]
gap = [[0.4e-3, 0.4e-3]]
omega = [12.0]
"""


def test_a_late_failure_does_not_replace_what_another_run_has_found(tmp_path):
    (tmp_path / "s.toml").write_text(STUDY)
    study = gs.Study.load(tmp_path / "s.toml")
    answer = gs.Response(status=gs.Status.OK, x_max=1e-3)
    gives_up = started(
        tmp_path, "run", "s.toml", *OPTIONS, "--timeout", "2", stdout=None, stderr=None
    )
    while not (tmp_path / "out" / "run.json").exists():
        assert gives_up.poll() is None
        time.sleep(0.05)
    with Cache(tmp_path / "out-cache") as cache:  # as on another machine, where no lock is seen
        commit(cache, study, lambda at: answer, "another")
        assert gives_up.wait() == 0, "its own failure was its result"
        (found,) = stored(study, cache).values()
        assert str(found) == str(answer)
