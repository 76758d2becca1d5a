"""Results of `simulate`: trajectories of oscillators and systems."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.motions import Counts, Events, Motions
from gapsweep.model.arrays import numbers
from gapsweep.model.system import System
from gapsweep.status import Status
from gapsweep.variables import (
    COORDINATE,
    COUNTS,
    LAG,
    STATUS_FLAGS,
    Variable,
    as_html,
    dataset,
    members,
    objects,
    to_dataframe,
)

Array = NDArray[np.float64]
VARIABLES = {
    "status": Variable("i1", "1", "outcome of the motion", Status.NOT_REQUESTED, STATUS_FLAGS),
    "t_end": Variable("f8", "s", "time at the end"),
    "x_end": Variable("f8", "m", "displacement at the end", dims=(COORDINATE,)),
    "v_end": Variable("f8", "m s-1", "velocity at the end", dims=(COORDINATE,)),
    "z_end": Variable("f8", "", "first-order state at the end", dims=(LAG,)),
    **COUNTS,
    "atol": Variable("f8", "m", "absolute tolerance of the integration"),
    "t": Variable("f8", "s", "time"),
    "x": Variable("f8", "m", "displacement", dims=("t", COORDINATE)),
    "v": Variable("f8", "m s-1", "velocity", dims=("t", COORDINATE)),
    "z": Variable("f8", "", "first-order state", dims=("t", LAG)),
}
_CLOCK_ROUNDING = 1e-9  # relative to the time since `t_0`
_PER_STEP = 16  # samples of a history: a Taylor step may be as long as a fifth of a period


def _of_motions(column: Callable[[Motions], NDArray[Any]]) -> Any:
    """Return an attribute that is a column of the motions, computed at first use."""
    return cached_property(lambda run: run._shaped(column(run._motions)))


class Trajectory:
    """A simulated motion, or an array of motions: end state, history, events and counts.

    Attributes are plain values for one motion, arrays of the common shape for several motions, and
    arrays of arrays for ragged lists (`extrema`, `section`, ...).

    Events are computed at first use, by a second integration with bitwise equal steps. With
    ``dense_output=True`` the integration itself runs at first use. A pickle contains the end state
    and the events computed so far; dense output is recomputed.

    Attributes
    ----------
    t_end, x_end, v_end : float
        Time [s], displacement [m] and velocity [m/s] at the end of the motion; `t_end` is earlier
        than requested if `status` is not ok.
    t, x, v : ndarray
        History, with ``dense_output=True``, at evenly spaced times from `t_0` to `t_end`, 16 per
        step of the solver. Several motions share the times, up to the earliest `t_end`; times are
        the last axis of `x` and `v`.
    t_0 : float
        Start of the motion [s].
    n_contacts, n_steps, n_rejected, nfev : int
        Wall crossings (in and out, each counted once), accepted and rejected steps, and
        right-hand-side evaluations (expansions of a Taylor method), without the search for extrema.
    status : Status
        Outcome of the motion.
    inputs : mapping of str to object
        Arguments of the call by name, defaults included; frequencies and initial states have the
        common shape. ``gs.simulate(**run.inputs)`` repeats the call.
    atol : float
        Absolute tolerance [m] of the integration.
    laws : tuple of ContactLaw
        Contact laws, one per contact; an array of tuples for several motions.
    monodromy : ndarray, shape (2, 2), or None
        Derivative of the end state with respect to the initial state, with ``tangent=True``.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> machine = gs.systems.paper_oscillator()
    >>> run = gs.simulate(machine, law, omega=9.0, t_end=2.0, dense_output=True)
    >>> x, v = run.sample([0.5, 1.0, 1.5])
    >>> x.shape, run.section.shape
    ((3,), (18, 2))
    """

    def __init__(
        self,
        inputs: Mapping[str, Any],
        laws: Any,
        atol: Any,
        solve: Callable[[float, bool], Motions],
    ) -> None:
        self.inputs, self.laws, self.atol, self.shape = inputs, laws, atol, np.shape(atol)
        self.t_0: float = inputs["t_0"]
        self._solve, self._has_dense_output = solve, inputs["dense_output"]
        self._dense: tuple[float, Motions] | None = None
        if not self._has_dense_output:
            _ = self._motions

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling: values, without the engine's records."""
        none: Any = None
        motions = replace(self._motions, events=none, sampler=none)
        return vars(self) | {"_dense": None, "_motions": motions}

    @cached_property
    def _motions(self) -> Motions:
        return self._dense[1] if self._dense else self._solve(math.inf, False)

    @property
    def _n(self) -> int:
        return math.prod(self.shape)

    t_end = _of_motions(lambda motions: motions.t)
    x_end = _of_motions(lambda motions: motions.state[:, 0])
    v_end = _of_motions(lambda motions: motions.state[:, 1])
    t = property(lambda run: run._history[0])
    x = property(lambda run: run._history[1])
    v = property(lambda run: run._history[2])
    n_contacts = _of_motions(lambda motions: motions.n_contacts)
    n_steps = _of_motions(lambda motions: motions.n_steps)
    n_rejected = _of_motions(lambda motions: motions.n_rejected)
    nfev = _of_motions(lambda motions: motions.nfev)

    @cached_property
    def status(self) -> Any:
        found = self._motions.status
        return members(Status, found.reshape(self.shape))

    @cached_property
    def monodromy(self) -> Array | None:
        found = self._motions.monodromy
        return None if found is None else found.reshape(*self.shape, *found.shape[1:])

    def to_dataset(self) -> Any:
        """Return an `xarray.Dataset` of the history over `t`, or without history of the end state.

        Other dimensions are `omega` and `initial_condition` if every frequency has every initial
        state, otherwise `point`.
        """
        if not self._has_dense_output:
            return self._ends()
        t, *states = self._history
        of_time = {
            name: np.reshape(each, (self._n, len(t), -1))
            for name, each in zip("xvz", states, strict=False)
            if each.size
        }
        status = {"status": self._motions.status, "atol": np.ravel(self.atol)}
        found = dataset(self.inputs, self.shape, VARIABLES, status | of_time)
        return found.assign_coords(t=("t", t, VARIABLES["t"].attributes))

    def _ends(self) -> Any:
        """Return end states, status and counts of the motions as an `xarray.Dataset`."""
        motions, n = self._motions, objects(self.inputs["oscillator"]).flat[0].n
        ends = np.split(motions.state, [n, 2 * n], axis=1)
        arrays = {
            "status": motions.status,
            "t_end": motions.t,
            **{f"{name}_end": end for name, end in zip("xvz", ends, strict=True) if end.size},
            **{name: getattr(motions, name) for name in COUNTS},
            "atol": np.ravel(self.atol),
        }
        return dataset(self.inputs, self.shape, VARIABLES, arrays)

    def to_dataframe(self) -> Any:
        """Return the values of `to_dataset` as a `pandas.DataFrame`, a row per motion or time."""
        return to_dataframe(self.to_dataset(), *(["t"] if self._has_dense_output else []))

    def _repr_html_(self) -> str:
        return as_html(self._ends())

    def __repr__(self) -> str:
        what = f"{self._n} motions" if self.shape else f"ends {self.status.label}"
        return f"<gapsweep.{type(self).__name__}: {what}, {np.sum(self.n_steps)} steps>"

    @property
    def extrema(self) -> Array:
        """Displacements [m] of all zero-velocity points in ``(t_0, t_end]``."""
        return self._of_coordinate(self._events.extrema)

    @property
    def t_extrema(self) -> Array:
        """Times [s] of `extrema`."""
        return self._of_coordinate(self._events.t_extrema)

    @property
    def t_contacts(self) -> Array:
        """Times [s] at which the displacement crossed a wall, in or out.

        They ascend, except where a hold on a rigid wall ends before the last of its summed flights
        would have ended.
        """
        return self._ragged(self._events.t_contacts, self._events.n_contacts)

    @property
    def section(self) -> Array:
        """Poincaré section, shape (n_points, n_states): states at whole forcing periods.

        The section of an unforced system is at the maxima of its first coordinate.
        """
        return self._ragged(self._events.section, self._events.n_section)

    @property
    def t_section(self) -> Array:
        """Times [s] of `section`."""
        return self._ragged(self._events.t_section, self._events.n_section)

    def sample(self, t: ArrayLike) -> tuple[Array, ...]:
        """Return displacement [m] and velocity [m/s] at times `t` [s] of the motion.

        Parameters
        ----------
        t : array_like
            Times within ``t_0..t_end`` [s]. The result has the shape of the motions, then of `t`.

        Raises
        ------
        ModelError
            If the run has no dense output, or a time is outside the motion.
        """
        t = numbers("t", t, "a time or times [s]")
        first = float(np.min(t, initial=math.inf))
        is_inside = self.t_0 <= first < math.inf
        # A little earlier: rounding of the clock may put the end behind the last step.
        earlier = first - _CLOCK_ROUNDING * (first - self.t_0)
        motions = self._dense_from(earlier if is_inside else math.inf)
        end = float(np.min(motions.t))
        if not end > self.t_0:
            raise ModelError("no history: a motion failed in its first step")
        inside = (t >= self.t_0) & (t <= end)
        if not np.all(inside):
            outside = float(t[~inside].flat[0])
            raise ModelError(f"t = {outside:g} s: must be within {self.t_0:g}..{end:g} s")
        states = motions.sampler(t.ravel())
        return self._as_sampled(np.moveaxis(states, 0, -1).reshape(*self.shape, *t.shape, -1))

    def absolute(self, t: ArrayLike) -> Array:
        """Return absolute displacements [m] at times `t` [s]: those of the base added to `sample`.

        Parameters and errors are those of `sample`; an oscillator without a moving base has the
        same absolute and relative displacements.
        """
        times = numbers("t", t, "a time or times [s]")
        models = np.broadcast_to(objects(self.inputs["oscillator"]), self.shape).flat
        omega = np.broadcast_to(self.inputs["omega"], self.shape).flat
        moved = [model.base(f, times) for model, f in zip(models, omega, strict=True)]
        found: Array = self.sample(t)[0] + np.reshape(moved, (*self.shape, *times.shape))
        return found

    def _as_sampled(self, states: Array) -> tuple[Array, ...]:
        """Split states along the last axis into the arrays that `sample` returns."""
        return states[..., 0], states[..., 1]

    def _dense_from(self, t: float) -> Motions:
        """Return dense output from `t` on; cached, and recomputed only for earlier times."""
        if not self._has_dense_output:
            raise ModelError("no history: simulate with dense_output=True")
        if self._dense is None or self._dense[0] > t:
            self._dense = t, self._solve(t, True)
        return self._dense[1]

    @cached_property
    def _history(self) -> tuple[Array, ...]:
        """Times of the history, and the arrays that `sample` returns for them."""
        motions = self._dense_from(self.t_0)
        t = np.linspace(self.t_0, motions.t.min(), 1 + _PER_STEP * int(motions.n_steps.max()))
        return t, *self.sample(t)

    @cached_property
    def _events(self) -> Events:
        return self._solve(self.t_0, False).events()

    def _shaped(self, values: NDArray[Any]) -> Any:
        return values.reshape(self.shape) if self.shape else values[0].item()

    def _of_coordinate(self, values: Array) -> Array:
        """Select the values of the coordinate's extrema, without those of the contact's gap."""
        its, n = self._events.extrema_of == 0, self._events.n_extrema
        motions = np.repeat(np.arange(len(n)), n)
        return self._ragged(values[its], np.bincount(motions[its], minlength=len(n)))

    def _ragged(self, values: Array, counts: Counts) -> Array:
        if not self.shape:
            return values
        ragged = np.empty(self._n, dtype=object)
        ends = np.cumsum(counts)
        ragged[:] = [values[end - n : end] for n, end in zip(counts, ends, strict=True)]
        return ragged.reshape(self.shape)


class SystemTrajectory(Trajectory):
    """A simulated motion of a `System`, or an array of motions, as a `Trajectory`.

    Attributes
    ----------
    q_end, v_end : ndarray, shape (..., n)
        Coordinates [m] and velocities [m/s] at the end of the motion.
    z_end : ndarray, shape (..., m)
        First-order states at the end.
    q, v, z : ndarray, shape (..., n_times, n) or (..., n_times, m)
        History at the times `t`, with ``dense_output=True``.
    monodromy : ndarray, shape (..., 2 n + m, 2 n + m), or None
        Derivative of the end state (q, v, z) with respect to the initial state, with
        ``tangent=True``.

    Examples
    --------
    >>> import gapsweep as gs
    >>> system, law = gs.systems.two_masses(), gs.systems.two_masses_law()
    >>> run = gs.simulate(system, law, 0.6, t_end=20.0)
    >>> run.q_end.shape, sorted(run.extrema) == sorted(system.coordinates)
    ((2,), True)
    """

    @property
    def system(self) -> System:
        """The system; the first one of a sequence."""
        system: System = objects(self.inputs["oscillator"]).flat[0]
        return system

    q_end = property(lambda run: run._end[0])
    v_end = property(lambda run: run._end[1])
    z_end = property(lambda run: run._end[2])
    q = property(lambda run: run._history[1])
    z = property(lambda run: run._history[3])

    @cached_property
    def _end(self) -> tuple[Array, ...]:
        return self._as_sampled(self._motions.state.reshape(*self.shape, -1))

    def _as_sampled(self, states: Array) -> tuple[Array, ...]:
        n = self.system.n
        return states[..., :n], states[..., n : 2 * n], states[..., 2 * n :]

    @property
    def extrema(self) -> Any:
        """Values [m] of each coordinate where its velocity is zero in ``(t_0, t_end]``, by name."""
        return self._by_name(self.system.coordinates, "extrema", "extrema_of", "n_extrema")

    @property
    def t_extrema(self) -> Any:
        """Times [s] of `extrema`."""
        return self._by_name(self.system.coordinates, "t_extrema", "extrema_of", "n_extrema")

    @property
    def t_contacts(self) -> Any:
        """Times [s] at which every contact crossed a wall, in or out, by its name."""
        return self._by_name(self.system.contacts, "t_contacts", "contacts_of", "n_contacts")

    def _by_name(self, names: Iterable[str], values: str, owners: str, counts: str) -> Any:
        """Return recorded values as a dict by name; for an array of motions an array of dicts."""
        ends = np.cumsum(getattr(self._events, counts))
        parts = []
        for first, last in zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True):
            of = getattr(self._events, owners)[first:last]
            found = getattr(self._events, values)[first:last]
            parts.append({name: found[of == i] for i, name in enumerate(names)})
        if not self.shape:
            return parts[0]
        ragged = np.empty(self._n, dtype=object)
        ragged[:] = parts
        return ragged.reshape(self.shape)
