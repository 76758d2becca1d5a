"""Shared fixtures: Hypothesis profiles, a real two-worker cluster, tiny studies."""

import json
import os
from collections.abc import Callable, Iterator
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import pytest
from distributed import Client
from hypothesis import settings

from gapsweep.execution.cluster import cluster
from tests.builders.runs import on_a_cluster
from tests.builders.studies import small_study

settings.register_profile("quick", max_examples=25, deadline=None)
settings.register_profile("thorough", max_examples=500, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files whose tests wait for other processes, in turn with files that compute themselves."""
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    waiting = [path for path in files if path.parent.name in ("cluster", "faults")]
    computing = [path for path in files if path not in waiting]
    in_turn = chain.from_iterable(zip_longest(waiting, computing))
    items[:] = [item for path in in_turn if path for item in files[path]]


GOLDEN = Path(__file__).parents[1] / "data" / "golden"


def golden(name: str) -> list[dict[str, Any]]:
    """A table of high-precision end states; see data/golden/README.md."""
    return json.loads((GOLDEN / name).read_text())


@pytest.fixture(scope="session")
def client() -> Iterator[Client]:
    """Two worker processes of one thread each, shared by the whole test run."""
    with cluster(workers=2) as client:
        yield client


@pytest.fixture(scope="session")
def run_command(client: Client) -> Callable[..., Any]:
    """``gapsweep`` in this process, on the shared cluster: see `tests.builders.runs`."""
    return on_a_cluster(client)


@pytest.fixture
def tables() -> dict[str, Any]:
    """See `tests.builders.studies.small_study`."""
    return small_study()
