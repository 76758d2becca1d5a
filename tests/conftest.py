"""Shared fixtures: Hypothesis profiles, a real two-worker cluster, tiny studies."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import Client
from hypothesis import settings

from gapsweep.execution.cluster import cluster
from tests.commands import on_a_cluster

settings.register_profile("quick", max_examples=25, deadline=None)
settings.register_profile("thorough", max_examples=500, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))

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
    """``gapsweep`` in this process, on the shared cluster: see `tests.commands`."""
    return on_a_cluster(client)


@pytest.fixture
def tables() -> dict[str, Any]:
    """A small study: three representations at three frequencies, fast settings."""
    return {
        "study": {"name": "small"},
        "sweep": [
            {
                "representation": ["piecewise", "tanh-1e4", "poly-13"],
                "K_c": [1.4e4],
                "gap": [[0.4e-3, 0.4e-3]],
                "omega": [7.0, 12.0, 20.0],
            }
        ],
        "steady": {"settle_tol": 1e-2, "n_periods": 16, "max_period_multiple": 8},
    }
