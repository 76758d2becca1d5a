"""What a run tells while it goes on."""

import time

import pytest

from gapsweep.console import _sentence
from gapsweep.execution.progress import Progress


@pytest.mark.parametrize(
    ("computed", "since", "said"),
    [
        (0, 5.0, "2/10 points, 0.0/s, 2 from the cache, 0 failed, unknown left"),
        (4, 2.0, "6/10 points, 2.0/s, 2 from the cache, 0 failed, 0:00:02 left"),
        (8, 4.0, "10/10 points, 2.0/s, 2 from the cache, 0 failed, 0:00:00 left"),
    ],
)
def test_progress_does_not_guess(computed, since, said):
    assert _sentence(Progress(10, 2, computed, started=time.monotonic() - since)) == said


def test_nothing_to_compute_leaves_nothing():
    assert _sentence(Progress(3, 3)).endswith("3 from the cache, 0 failed, 0:00:00 left")
