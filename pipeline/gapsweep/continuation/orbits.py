"""Periodic orbits as zeros of equations: residuals, derivatives, and what the orbits are.

Unknowns of an orbit are its initial state y, its period T where it is not forced, and the
parameters p::

    φ(T, y, p) - y = 0                        one equation for each component of the state
    f · (y - y_ref) = 0                       not forced: it starts near y_ref

φ is the motion's end and f the derivative of y_ref by time. Both are divided by the size of the
state. Derivatives of φ by y are the monodromy matrix, by T the motion's rate. By the parameters
they are central differences of two motions; of contacts at which the force or the velocity jumps
they are parameter columns, since such motions may have other contacts than the orbit. All orbits
of a call are integrated together.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.continuation.family import Family, Window
from gapsweep.continuation.identity import Identity
from gapsweep.continuation.thresholds import DIFFERENCE, ONE_TURN, SHIFT
from gapsweep.errors import ModelError
from gapsweep.integrate import compiled
from gapsweep.integrate.motions import Motions, merged
from gapsweep.integrate.problem import Models, Problems, Shifts, Solver
from gapsweep.integrate.simulate import prepared
from gapsweep.model.oscillator import Oscillator
from gapsweep.response.equilibrium import Rates
from gapsweep.response.shooting import floquet_multipliers
from gapsweep.status import Status

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]


@dataclass(slots=True, kw_only=True)
class Reference:
    """Scales and reference states of n branches, fixed while Newton's method corrects an orbit."""

    size: Array  # shape (n, n_states); sizes of the components of the state
    duration: Array  # shape (n,); scale of periods [s]; 1 where the forcing sets them
    multiple: NDArray[np.int64]  # shape (n,); forcing periods in one response period
    # Shape (n, n_states); state near which an unforced orbit starts, and its derivative by time.
    y: Array
    rate: Array

    def take(self, lanes: Any) -> "Reference":
        """The references of some branches."""
        return Reference(**{name: getattr(self, name)[lanes] for name in self.__slots__})

    @classmethod
    def joined(cls, parts: "Sequence[Reference]") -> "Reference":
        """The references of several groups of branches, in one."""
        names = cls.__slots__
        return cls(**{name: np.concatenate([getattr(x, name) for x in parts]) for name in names})


@dataclass(slots=True, kw_only=True)
class Orbit:
    """One periodic orbit."""

    unknowns: Array  # scaled unknowns, shape (d,)
    tangent: Array  # direction of the branch there, shape (d,)
    parameters: tuple[float, ...]
    period: float  # response period [s]
    state: Array  # shape (n_states,); where it starts: at forcing phase zero
    # Floquet multipliers, largest modulus first; without the one along an unforced orbit.
    multipliers: NDArray[np.complex128]
    x_max: Array  # shape (n,); of every coordinate [m]
    x_min: Array
    # Maxima and minima of the gap at every contact [m], in descending order.
    turning: list[tuple[Array, Array]]
    n_contacts: int  # wall crossings in a period, in and out
    branching: float  # determinant of the equations and the tangent: zero where branches cross
    period_multiple: int
    identity: Identity
    monodromy: Array  # shape (n_states, n_states)
    # Kind of a special point, as of `gapsweep.continuation.special.Special`; 0: none.
    special: int = 0
    # Shape (d,); direction of the branch that crosses there, where it is known.
    across: Array | None = None

    @property
    def amplitude(self) -> float:
        """Half the range of the first coordinate [m]."""
        return 0.5 * float(self.x_max[0] - self.x_min[0])


@dataclass(slots=True, kw_only=True)
class Evaluation:
    """Equations at m sets of unknowns, and whether the motions of each did not fail."""

    residual: Array  # shape (m, d - 1)
    jacobian: Array  # shape (m, d - 1, d)
    is_ok: NDArray[np.bool_]
    motions: Motions
    rate: Array


class OrbitEquations:
    """The equations of the orbits of a family, for windows of its parameters."""

    kind = 0  # of special points, as of `gapsweep.continuation.special.Special`; 0: any orbits

    def __init__(self, family: Family, windows: tuple[Window, ...], solver: Solver) -> None:
        self.family, self.windows, self.solver = family, windows, solver
        model = family.example
        self.n, self.n_states = model.n, model.n_states
        self.first_gap = 0 if isinstance(model, Oscillator) else model.n
        self.n_contacts = len(model.contacts)
        # at the upper ends of the ranges, since a damping may be 0 at the lower one
        laws = family.laws_at({**family.values, **{one.name: one.high for one in windows}})
        self.may_hold = [law.losses.may_hold for law in laws]
        self.never_pulls = [law.losses.never_pulls for law in laws]
        self.has_jump = [bool(law.losses) for law in laws]
        self.has_period = not family.is_forced
        # The amplitude of free motions is a result, no parameter of their equations.
        self.n_parameters = 0 if family.is_conservative else len(windows)
        self._may_have_columns = self.n_parameters > 0 and any(self.has_jump)
        self.n_unknowns = self.n_states + self.has_period + self.n_parameters

    def unknowns(self, state: Array, period: Array, values: Array, reference: Reference) -> Array:
        """Scaled unknowns, shape (m, d), of m states, periods and rows of parameter values."""
        parts = [state / reference.size]
        if self.has_period:
            parts.append((period / reference.duration)[:, None])
        for k in range(self.n_parameters):
            parts.append(np.asarray(self.windows[k].place(values[:, k]))[:, None])
        return np.concatenate(parts, axis=1)

    def places(self, unknowns: Array) -> Array:
        """Places of the parameters in their windows, shape (m, number of parameters)."""
        return unknowns[..., self.n_states + self.has_period :]

    def parameters(self, unknowns: Array) -> tuple[float, ...]:
        """The parameters of one orbit."""
        places = self.places(unknowns)
        return tuple(float(w.value(s)) for w, s in zip(self.windows, places, strict=False))

    def place(self, orbit: Orbit) -> float:
        """Position of an orbit in the last window: 0 to 1 inside."""
        is_free = self.family.is_conservative
        return float(self.windows[-1].place(orbit.amplitude if is_free else orbit.parameters[-1]))

    def evaluate(
        self, unknowns: Array, reference: Reference, difference: float = DIFFERENCE
    ) -> Evaluation:
        """Residuals and their derivatives; `difference` is the share of a range for differences."""
        m, n = len(unknowns), self.n_states
        y = unknowns[:, :n] * reference.size
        places, period = self.places(unknowns), None
        if self.has_period:
            period = unknowns[:, n] * reference.duration
            period = np.where(period > 0.0, period, 1e-9)
        given = y, period, places, reference.multiple
        by_columns = self._by_columns(*given) if self._may_have_columns else None
        found, models, by_place = by_columns or self._by_differences(*given, difference)
        ends, size = found.state[:m], reference.size
        assert found.monodromy is not None
        with np.errstate(all="ignore"):  # of motions that failed
            residual = [(ends - y) / size]
            by_state = found.monodromy[:m] - np.eye(n)
            columns = [by_state * (size[:, None, :] / size[:, :, None])]
            rate = np.zeros((m, n))
            if self.has_period:
                rate = Rates(models)(np.arange(m), ends.T).T
                columns.append((rate / size * reference.duration[:, None])[:, :, None])
            columns.append(by_place / size[:, :, None])
            jacobian = np.concatenate(columns, axis=2)
            if self.has_period:
                normal = reference.rate / size
                normal = normal / np.sqrt((normal**2).sum(axis=1))[:, None]
                residual.append(((y - reference.y) / size * normal).sum(axis=1)[:, None])
                row = np.zeros((m, 1, jacobian.shape[2]))
                row[:, 0, :n] = normal
                jacobian = np.concatenate([jacobian, row], axis=1)
            of_all = np.concatenate(residual, axis=1)
            is_ok = (found.status.reshape(-1, m) == Status.OK).all(axis=0)
            is_ok &= np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(of_all).all(axis=1)
        return Evaluation(residual=of_all, jacobian=jacobian, is_ok=is_ok, motions=found, rate=rate)

    def _by_differences(
        self,
        y: Array,
        period: Array | None,
        places: Array,
        multiple: NDArray[np.int64],
        difference: float,
    ) -> tuple[Motions, Models, Array]:
        """Motions over one period, then those at places that differ; and derivatives by places.

        The models are those of the motions. Derivatives of ends have the shape (m, n_states, number
        of parameters).
        """
        every, apart = _shifted(places, difference)
        models, count = self.family.models(self.windows, every), len(every) // len(places)
        if period is None:
            t_end = np.tile(multiple, count) / models.omega
        else:
            t_end = np.tile(period, count)
        start, record_from = np.tile(y, (count, 1)), np.zeros(len(every))
        found = integrated(models, self.solver, start, t_end, record_from, tangent=True)
        ends = found.state.reshape(count, *y.shape)
        with np.errstate(all="ignore"):  # of motions that failed
            change = (ends[1::2] - ends[2::2]) / apart[:, :, None]
        return found, models, change.transpose(1, 2, 0)

    def _by_columns(
        self, y: Array, period: Array | None, places: Array, multiple: NDArray[np.int64]
    ) -> tuple[Motions, Models, Array] | None:
        """Motions over one period, their models first, and derivatives by places as above.

        None where the engine has no parameter columns: of laws that are not located, of parameters
        that change the direction of a contact, a phase, a load by pieces or the kind of a contact,
        and where impacts of several contacts accumulate at one time.
        """
        m, speeds = len(y), slice(self.n, 2 * self.n)
        every, apart = _shifted(places, SHIFT)
        weights = np.array([[1.0], [-1.0]]) / np.where(apart > 0.0, apart, 1.0)[:, None, :]
        shifts = Shifts(names=tuple(window.name for window in self.windows), weights=weights)
        models = self.family.models(self.windows, every)
        try:
            integrate = compiled.prepared(models, self.solver, shifts)
        except ModelError:
            return None
        t_end = multiple / models.omega[:m] if period is None else period
        found = integrate(_problems(y, t_end, np.zeros(m), tangent=True))
        by_place = found.columns
        assert found.monodromy is not None
        assert by_place is not None
        is_known = np.isfinite(by_place).all(axis=(1, 2)) | (found.status != Status.OK)
        if not is_known.all():
            return None
        # Outside the range nothing changes with a place, and differences are not finite.
        by_place[(np.abs(places - 0.5) >= 0.5 + DIFFERENCE).any(axis=1)] = np.nan
        if "omega" in shifts.names:
            # Columns hold the speed over the phase at the beginning, and are of it at the end.
            share = (shifts.derivatives(models.omega) / models.omega[:m]).T[:, None, :]
            with np.errstate(all="ignore"):  # of motions that failed
                begun = found.monodromy[:, :, speeds] @ y[:, speeds, None]
                by_place = by_place - begun * share
                by_place[:, speeds] += found.state[:, speeds, None] * share
        return found, models, by_place

    def orbits(
        self,
        unknowns: Array,
        tangents: Array,
        reference: Reference,
        found: Evaluation,
        rows: Numbers,
    ) -> list[Orbit]:
        """The orbits whose equations some rows of an evaluation hold; all else is of these rows."""
        motions, n = found.motions, self.n_states
        assert motions.monodromy is not None
        monodromy = motions.monodromy[rows]
        size = reference.size
        multipliers = self.multipliers(
            monodromy,
            unknowns,
            reference,
            found.rate[rows],
            motions.t[rows],
            motions.contact_loss[rows],
        )
        equations = np.concatenate([found.jacobian[rows], tangents[:, None, :]], axis=1)
        branching = np.zeros(len(rows))
        if equations.shape[1] == equations.shape[2]:  # neither surplus, as of free motions, nor few
            sign, log = np.linalg.slogdet(equations)
            branching = sign * np.exp(np.clip(log, -600.0, 600.0))
        events = motions.events()
        ends, strobes = np.cumsum(events.n_extrema), np.cumsum(events.n_section)
        orbits = []
        for k, row in enumerate(rows.tolist()):
            span = slice(ends[row] - events.n_extrema[row], ends[row])
            values, of = events.extrema[span], events.extrema_of[span]
            state = unknowns[k, :n] * size[k]
            points = slice(strobes[row] - events.n_section[row], strobes[row])
            section = self._section(
                state, events.section[points], events.t_section[points] / motions.t[row]
            )
            q = [np.append(values[of == i], state[i]) for i in range(self.n)]
            gaps = [values[of == self.first_gap + j] for j in range(self.n_contacts)]
            orbits.append(
                Orbit(
                    unknowns=unknowns[k].copy(),
                    tangent=tangents[k].copy(),
                    parameters=self.parameters(unknowns[k]),
                    period=float(motions.t[row]),
                    state=state,
                    multipliers=multipliers[k],
                    x_max=np.array([each.max() for each in q]),
                    x_min=np.array([each.min() for each in q]),
                    turning=[_turning(each) for each in gaps],
                    n_contacts=int(motions.n_contacts[row]),
                    branching=float(branching[k]),
                    period_multiple=int(reference.multiple[k]),
                    identity=Identity(section / size[k], _asymmetry(q, size[k])),
                    monodromy=monodromy[k].copy(),
                )
            )
        return orbits

    def multipliers(
        self,
        monodromy: Array,
        unknowns: Array,
        reference: Reference,
        rate: Array,
        period: Array,
        contact_loss: Array,
    ) -> NDArray[np.complex128]:
        """Floquet multipliers of orbits; without the one along an unforced orbit."""
        size = reference.size
        scaled = monodromy * (size[:, None, :] / size[:, :, None])
        determinant = np.zeros(len(size))
        if self.has_period:  # on a section across the motion, which its multiplier 1 leaves
            along = rate / size
            normal = along / (along**2).sum(axis=1)[:, None]
            across = np.einsum("mi,mij->mj", normal, scaled)
            scaled = scaled - along[:, :, None] * across[:, None, :]
        else:
            models = self.family.models(self.windows, self.places(unknowns))
            decay = self.n_states * models.of_systems(lambda system: system.decay_rate)
            determinant = np.exp(-decay * period - contact_loss)
        return floquet_multipliers(scaled, determinant)[:, : self.n_states - self.has_period]

    def _section(self, state: Array, section: Array, phase: Array) -> Array:
        """Section points of an orbit, each once; at least its initial state.

        A maximum at the initial state of an unforced orbit may be found at its end too.
        """
        if not len(section):
            return state[None, :]
        is_twice = self.has_period and len(section) > 1 and phase[-1] - phase[0] > ONE_TURN
        return section[:-1] if is_twice else section

    def models_at(self, orbit: Orbit) -> Any:
        """The model of one orbit."""
        return self.family.models(self.windows, self.places(orbit.unknowns[None, :]))

    def reference_at(self, reference: Reference, orbit: Orbit) -> Reference:
        """Sizes of one branch, and the phase of one of its orbits."""
        found = reference.take(np.zeros(1, int))
        if self.has_period:
            found.y = orbit.state[None, :]
            found.rate = self.rates(found.y, orbit.unknowns[None, :])
        return found

    def orbit(self, unknowns: Array, tangent: Array, reference: Reference) -> Orbit | None:
        """The orbit of unknowns as they are; None if its motion fails."""
        found = self.evaluate(unknowns[None, :], reference)
        if not found.is_ok[0]:
            return None
        rows = np.zeros(1, np.intp)
        return self.orbits(unknowns[None, :], tangent[None, :], reference, found, rows)[0]

    def rates(self, states: Array, unknowns: Array) -> Array:
        """Derivatives of states by time, shape (m, n_states)."""
        models = self.family.models(self.windows, self.places(unknowns))
        return np.asarray(Rates(models)(np.arange(len(states)), states.T)).T


def _shifted(places: Array, share: float) -> tuple[Array, Array]:
    """Places, then those with every parameter a little larger and smaller, and how far apart."""
    every, apart = [places], np.empty(places.T.shape)
    for k, one in enumerate(places.T):
        for sign in (1.0, -1.0):
            other = places.copy()
            other[:, k] = np.clip(one + sign * share, 0.0, 1.0)
            every.append(other)
        apart[k] = every[-2][:, k] - every[-1][:, k]
    return np.concatenate(every), apart


def integrated(
    models: Models,
    solver: Solver,
    states: Array,
    t_end: Array,
    record_from: Array,
    *,
    tangent: bool,
) -> Motions:
    """Motions from states for some time [s]; laws of several kinds are integrated one by one.

    A smooth law changes its kind along a parameter where its layers at the walls become thin.
    """
    groups = models.by_kind()
    parts = [
        prepared(some, solver)(
            _problems(states[rows], t_end[rows], record_from[rows], tangent=tangent)
        )
        for rows, some in groups
    ]
    return merged(parts, [rows for rows, _ in groups])


def _problems(states: Array, t_end: Array, record_from: Array, *, tangent: bool) -> Problems:
    """One problem for each row of models."""
    return Problems(
        which=np.arange(len(states)),
        start=np.ascontiguousarray(states),
        t_0=np.zeros(len(states)),
        t_end=t_end,
        record_from=record_from,
        tangent=tangent,
    )


def motions(
    models: Any, solver: Solver, states: Array, t_end: ArrayLike, record_from: float
) -> Motions:
    """Motions from states over some time [s], recorded from a time on."""
    n = len(states)
    ends, begin = np.broadcast_to(np.asarray(t_end, float), n), np.full(n, record_from)
    return integrated(models, solver, states, ends, begin, tangent=False)


def _asymmetry(q: list[Array], size: Array) -> float:
    """Largest sum of the extreme values of a coordinate, as a share of its size."""
    return max(
        abs(float(each.max() + each.min())) / float(of) for each, of in zip(q, size, strict=False)
    )


def _turning(values: Array) -> tuple[Array, Array]:
    """Maxima and minima, each in descending order, of turning points in order of time."""
    is_maximum = values > np.roll(values, -1)
    return -np.sort(-values[is_maximum]), -np.sort(-values[~is_maximum])


def swing(states: Sequence[Array] | Array) -> float:
    """Largest modulus of a component, at least the smallest float."""
    return float(max(np.abs(np.asarray(states)).max(), math.ulp(0.0)))
