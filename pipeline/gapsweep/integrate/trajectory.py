"""The result of one simulation."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PPoly

from gapsweep.errors import ModelError
from gapsweep.status import Status

Array = NDArray[np.float64]


def _empty() -> Array:
    return np.empty(0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """A simulated motion: its end, its events, its cost.

    Attributes
    ----------
    t, x, v : float
        Time [s], displacement [m] and velocity [m/s] where the run ended: at ``t_end``, or
        earlier if `status` is not ok.
    t_0 : float
        Start [s].
    extrema, t_extrema : ndarray, shape (n,)
        Displacements [m] and times [s] of all zero-velocity points in ``(t_0, t]``.
    t_contacts : ndarray, shape (n_contacts,)
        Times [s] at which the displacement crossed a wall, in or out.
    section : ndarray, shape (n, 2)
        Stroboscopic section: ``(x, v)`` at every whole forcing period in ``(t_0, t]``.
    n_contacts, n_steps, n_rejected, nfev : int
        Wall crossings, accepted and rejected steps, right-hand sides evaluated.
    status : Status
        How the run ended.
    motion : PPoly or None
        Piecewise polynomial of ``(x, v)`` over ``t - t_0``, if asked for.
    """

    t_0: float
    t: float
    x: float
    v: float
    extrema: Array = field(default_factory=_empty)
    t_extrema: Array = field(default_factory=_empty)
    t_contacts: Array = field(default_factory=_empty)
    section: Array = field(default_factory=lambda: np.empty((0, 2)))
    n_contacts: int = 0
    n_steps: int = 0
    n_rejected: int = 0
    nfev: int = 0
    status: Status = Status.OK
    motion: PPoly | None = None

    def sample(self, t: ArrayLike) -> tuple[Array, Array]:
        """Displacement [m] and velocity [m/s] at times `t` [s] within the run.

        Raises
        ------
        ModelError
            If the run kept no dense output, or a time lies outside it.
        """
        if self.motion is None:
            raise ModelError("no dense output was kept: simulate with dense_output=True")
        t = np.asarray(t, dtype=float)
        inside = (t >= self.t_0) & (t <= self.t)
        if not np.all(inside):
            outside = float(t[~inside].flat[0])
            raise ModelError(f"t = {outside:g} s: must be within {self.t_0:g}..{self.t:g} s")
        y = self.motion(t - self.t_0)
        return y[..., 0], y[..., 1]


class Trajectories:
    """Many trajectories; every attribute of `Trajectory` as an array over the points.

    Scalars become plain arrays, ragged lists (`extrema`, `t_extrema`, `t_contacts`,
    `section`) arrays of arrays. Indexing gives the single trajectories, in C order.
    """

    def __init__(self, runs: list[Trajectory], shape: tuple[int, ...]) -> None:
        self._runs = runs
        self.shape = shape

    def __len__(self) -> int:
        return len(self._runs)

    def __getitem__(self, index: int) -> Trajectory:
        return self._runs[index]

    def __getattr__(self, name: str) -> NDArray[np.generic]:
        if name.startswith("_") or name not in Trajectory.__slots__:
            raise AttributeError(name)
        values = [getattr(run, name) for run in self._runs]
        if not isinstance(values[0], np.ndarray | PPoly):
            return np.array(values).reshape(self.shape)
        ragged = np.empty(len(values), dtype=object)
        ragged[:] = values
        return ragged.reshape(self.shape)

    def sample(self, t: ArrayLike) -> tuple[Array, Array]:
        """Displacements [m] and velocities [m/s], shape of the points + shape of `t` [s]."""
        samples = np.array([run.sample(t) for run in self._runs])
        x, v = np.moveaxis(samples, 1, 0)
        return x.reshape(self.shape + x.shape[1:]), v.reshape(self.shape + v.shape[1:])
