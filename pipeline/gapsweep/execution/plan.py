"""What a run has to do: decided here, without doing any of it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from gapsweep.status import Status
from gapsweep.study.study import Index, Study


@dataclass(frozen=True, slots=True)
class Chain:
    """Sweep points that follow each other, with their keys; mostly just one.

    Attributes
    ----------
    indices : tuple of (int, int, int, int, int)
        Positions in the study's grid, in order of computation.
    keys : tuple of str
    n_done : int
        How many of the first ones need no computation.
    """

    indices: tuple[Index, ...]
    keys: tuple[str, ...]
    n_done: int

    @property
    def n_missing(self) -> int:
        return len(self.keys) - self.n_done

    def after(self, n: int) -> "Chain":
        """The same chain when `n` more of its points are done."""
        return replace(self, n_done=min(self.n_done + n, len(self.keys)))


@dataclass(frozen=True, slots=True)
class Plan:
    """Every chain of a study and how much of it the cache holds.

    Attributes
    ----------
    chains : tuple of Chain
        In the order of the dataset.
    statuses : mapping of str to Status
        Stored status by key.
    """

    chains: tuple[Chain, ...]
    statuses: Mapping[str, Status]

    @property
    def n_points(self) -> int:
        return sum(len(chain.keys) for chain in self.chains)

    @property
    def n_missing(self) -> int:
        return sum(chain.n_missing for chain in self.chains)

    @property
    def n_hits(self) -> int:
        return self.n_points - self.n_missing

    @property
    def n_failed(self) -> int:
        """Stored points without a result."""
        return sum(status.failed for status in self.statuses.values())

    @property
    def missing(self) -> Iterator[Chain]:
        return (chain for chain in self.chains if chain.n_missing)


def plan(
    study: Study, stored: Callable[[list[str]], Mapping[str, Status]], *, retry_failed: bool = False
) -> Plan:
    """Compare a study with the cache.

    Parameters
    ----------
    study : Study
    stored : callable
        Status of those of the given keys that are stored.
    retry_failed : bool
        Whether stored failures count as missing.
    """
    chains = [(indices, tuple(study.keys(indices))) for indices in study.chains()]
    statuses = stored([key for _, keys in chains for key in keys])

    def done(key: str) -> bool:
        status = statuses.get(key)
        return status is not None and not (retry_failed and status.failed)

    def n_done(keys: tuple[str, ...]) -> int:
        # What follows a missing point of a sweep starts elsewhere: its key says so too.
        return next((i for i, key in enumerate(keys) if not done(key)), len(keys))

    return Plan(tuple(Chain(i, keys, n_done(keys)) for i, keys in chains), statuses)
