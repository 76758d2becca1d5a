"""Derivatives of quantities of periodic orbits by parameters.

A periodic response is a state y that a whole period maps onto itself, ``φ(T; y, p) = y``. Its
derivative by a parameter follows from the monodromy matrix M and the parameter column, both of
which the engine integrates with the motion [1]_::

    dy/dp = (I - M)⁻¹ ∂φ/∂p

An extremum X of the displacement changes by ``dX/dp = x_p + x_y dy/dp``: the velocity is zero
there, so that the change of its time does not count. A contact begins and ends where the gap passes
a wall, at times that change by ``(dwall/dp - dx/dp) / v``. So does an impact on a rigid wall; an
extremum there has a velocity before the impact, and its time counts.

References
----------
.. [1] P. Müller, "Calculation of Lyapunov exponents for dynamic systems with discontinuities",
   Chaos, Solitons & Fractals 5 (1995) 1671-1681.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.compiled import prepared
from gapsweep.integrate.motions import Motions
from gapsweep.integrate.problem import Laws, Models, Problems, Shifts, Solver
from gapsweep.model.oscillator import Oscillator
from gapsweep.model.parameters import Parameter
from gapsweep.response.equilibrium import Rates
from gapsweep.status import Status

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]
Mask = NDArray[np.bool_]

# Relative shift of a parameter, and the multiples of it with their weights: central differences
# of fourth order, or one-sided ones of third order at the end of a parameter's range. Only rows of
# the equation are differenced, which are rational functions of the parameters; errors are 1e-12.
_SHIFT = 5e-4
_CENTRAL = (-2.0, -1.0, 1.0, 2.0), (1.0 / 12, -8.0 / 12, 8.0 / 12, -1.0 / 12)
_ONE_SIDED = (0.0, 1.0, 2.0, 3.0), (-11.0 / 6, 3.0, -1.5, 1.0 / 3)
_FROM_ZERO = 1e-3  # shift of a parameter that is zero
_NEWTON_STEPS = 8
# Newton steps below these shares of the orbit's size, and of the rounding errors of a period as the
# step amplifies them, end the search; so does a step that is no shorter than half of the one before
# it, if it is below the third share.
_CLOSED, _ROUNDING, _NEARLY = 1e-14, 16 * np.finfo(float).eps, 1e-8

_STILL = 1e-9  # speed at a turning point, as a share of the largest speed
# Shares of a period: motions to impacts end as much earlier; impacts are as close by then.
_BEFORE, _CLOSE_BY = 16 * np.finfo(float).eps, 1e-6


@dataclass(frozen=True, slots=True)
class Cases:
    """Parameter sets, and the parameters by which quantities are differentiated."""

    models: Sequence[Any]
    laws: Sequence[Laws]
    omega: Array  # shape (n,); frequency [Hz] of each set; 0 for unforced systems
    parameters: tuple[Parameter, ...]

    def __len__(self) -> int:
        return len(self.omega)

    def take(self, rows: Numbers) -> Cases:
        """Return some of the parameter sets."""
        models, laws = ([each[i] for i in rows.tolist()] for each in (self.models, self.laws))
        return Cases(models, laws, self.omega[rows], self.parameters)

    def shifted(self) -> tuple[Models, Shifts]:
        """Return rows of models, then of those with shifted parameters, as `Shifts` describe."""
        n, n_shifts = len(self), len(_CENTRAL[0])
        pairs: dict[tuple[int, int], int] = {}
        ids = zip(map(id, self.models), map(id, self.laws), strict=True)
        which = np.array([pairs.setdefault(pair, len(pairs)) for pair in ids])
        firsts = [int(np.flatnonzero(which == k)[0]) for k in range(len(pairs))]
        systems, laws = ([each[first] for first in firsts] for each in (self.models, self.laws))
        rows, omega, weights = [which], [self.omega], []
        for parameter in self.parameters:
            numbers, own = np.empty((n_shifts, len(pairs)), np.intp), np.empty((n_shifts, n))
            if parameter.name == "omega":
                steps, factors = (np.array(each)[:, None] for each in _CENTRAL)
                omega.append(np.ravel(self.omega * (1.0 + _SHIFT * steps)))
                own[:] = factors / (_SHIFT * self.omega)
            else:
                omega.append(np.tile(self.omega, n_shifts))
            for k, first in enumerate(firsts):
                model, law, rate = self.models[first], self.laws[first], float(self.omega[first])
                size = max(map(abs, parameter.values(model, law, rate)))
                if parameter.name == "omega":
                    shifted: list[Any] = [(model, law)] * n_shifts
                else:
                    step = _SHIFT * size or _FROM_ZERO
                    shifted, factor = _shifted(parameter, model, law, rate, step)
                    own[:, which == k] = factor[:, None]
                numbers[:, k] = len(systems) + np.arange(n_shifts)
                systems += [each[0] for each in shifted]
                laws += [each[1] for each in shifted]
            rows.append(numbers[:, which].ravel())
            weights.append(own)
        of = np.concatenate(rows)
        models = Models(systems=systems, laws=laws, system=of, law=of, omega=np.concatenate(omega))
        names = tuple(parameter.name for parameter in self.parameters)
        return models, Shifts(names=names, weights=np.array(weights))


def _shifted(
    parameter: Parameter, model: Any, laws: Laws, omega: float, step: float
) -> tuple[list[Any], Array]:
    """Models and laws with shifted parameters, and their weights in the derivative."""
    for (multiples, factors), by in ((_CENTRAL, step), (_ONE_SIDED, step), (_ONE_SIDED, -step)):
        try:
            found = [parameter.shifted(model, laws, omega, m * by)[:2] for m in multiples]
        except ModelError:  # beyond the end of the parameter's range
            continue
        return found, np.array(factors) / by
    raise ModelError(f"parameter {parameter.name!r}: has no range to differentiate it in")


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitGradients:
    """Quantities of n periodic orbits, and their derivatives by parameters."""

    names: tuple[str, ...]  # the quantities
    value: Array  # shape (n, n_quantities)
    # Shape (n, n_quantities, n_parameters); NaN where the quantity is, or has no derivative.
    gradient: Array
    state: Array  # shape (n, n_states); initial state of each orbit
    state_gradient: Array  # shape (n, n_states, n_parameters)
    monodromy: Array  # shape (n, n_states, n_states)
    is_ok: NDArray[np.bool_]  # shape (n,); whether Newton's method has found the orbit


class Orbits:
    """Newton's method for orbits, and the motions from which their quantities follow.

    Parameters
    ----------
    cases : Cases
        n parameter sets of one kind (`Models.by_kind`).
    states : ndarray, shape (n, n_states)
        States near the orbits: at forcing phase zero, or at a maximum of the first coordinate.
    multiples : ndarray of int, shape (n,)
        Forcing periods of each orbit.
    solver : Solver
    period : ndarray, shape (n,), optional
        Periods [s] of unforced orbits, near which they are.
    """

    def __init__(
        self,
        cases: Cases,
        states: Array,
        multiples: NDArray[np.int64],
        solver: Solver,
        period: Array | None = None,
    ) -> None:
        self.models = Models.of(cases.models, cases.laws, cases.omega)
        self.is_system = not isinstance(cases.models[0], Oscillator)
        self.shifted, self.shifts = cases.shifted()
        self._integrate = prepared(self.shifted, solver, self.shifts)
        self.is_forced = bool(cases.omega[0] > 0.0)
        self.y, self.n = states.copy(), self.models.systems[0].n
        self.period = np.array(period) if period is not None else multiples / cases.omega
        if self.is_forced:
            self.period = multiples / cases.omega

    def run(self, which: Numbers, t_end: Array, *, records: bool) -> Motions:
        """Motions of some orbits from their initial states, with tangent and columns."""
        return self._integrate(
            Problems(
                which=which,
                start=self.y[which],
                t_0=np.zeros(len(which)),
                t_end=t_end,
                record_from=np.full(len(which), 0.0 if records else np.inf),
                tangent=True,
                contacts=records,
                contact_time=records,
            )
        )

    def solved(self, found: Motions, right: Array) -> tuple[Array, Array]:
        """Solutions of the orbits' linear equations for right sides, shape (n, n_states, k).

        Returns
        -------
        change : ndarray, shape (n, n_states, k)
            Changes of the initial state.
        longer : ndarray, shape (n, k)
            Change of the period [s]; that of the forcing is fixed.
        """
        assert found.monodromy is not None
        n_states = self.y.shape[1]
        matrix = np.eye(n_states) - found.monodromy
        if not self.is_forced:
            rate = Rates(self.models)(np.arange(len(self.y)), found.state.T).T
            row = np.zeros((len(matrix), 1, n_states + 1))
            row[:, 0, self.n] = 1.0  # the speed of the first coordinate stays zero
            matrix = np.concatenate([matrix, -rate[:, :, None]], axis=2)
            matrix = np.concatenate([matrix, row], axis=1)
            right = np.concatenate([right, np.zeros_like(right[:, :1])], axis=1)
        parts = np.concatenate([matrix, right], axis=2)
        is_finite = np.asarray(np.isfinite(parts).all(axis=(1, 2)))
        with np.errstate(all="ignore"):
            matrix = np.where(is_finite[:, None, None], matrix, np.eye(matrix.shape[1]))
            try:
                found_all = np.linalg.solve(matrix, right)
            except np.linalg.LinAlgError:  # an orbit on a fold
                found_all = np.linalg.pinv(matrix) @ right
        found_all[~is_finite] = np.nan
        longer = np.zeros_like(found_all[:, 0]) if self.is_forced else found_all[:, n_states]
        return np.asarray(found_all[:, :n_states]), np.asarray(longer)

    def closed(self) -> tuple[Motions, Mask]:
        """Motions over a period after Newton's method, and whether each orbit closes."""
        rows, last = np.arange(len(self.y)), np.full(len(self.y), np.inf)
        for left in range(_NEWTON_STEPS, -1, -1):
            found = self.run(rows, self.period, records=True)
            missed = (found.state - self.y)[:, :, None]
            errors = np.eye(self.y.shape[1]) * np.abs(self.y)[:, None, :]
            step, longer = self.solved(found, np.concatenate([missed, errors], axis=2))
            size = np.abs(self.y).max(axis=1)
            length = np.abs(step[:, :, 0]).max(axis=1) / size
            rounding = _ROUNDING * np.abs(step[:, :, 1:]).sum(axis=2).max(axis=1) / size
            is_best = (length <= rounding) | (length > 0.5 * last)
            is_alive = (found.status == Status.OK) & np.isfinite(length)
            is_ok = is_alive & ((length <= _CLOSED) | (is_best & (length <= _NEARLY)))
            moves = is_alive & ~is_ok
            if not (left and moves.any()):
                break
            self.y[moves] += step[moves, :, 0]
            self.period[moves] += longer[moves, 0]
            last = np.where(moves, length, last)
        return found, is_ok

    def gradients(self) -> OrbitGradients:
        """Quantities of the orbits and their derivatives."""
        found, is_ok = self.closed()
        assert found.columns is not None and found.monodromy is not None  # noqa: PT018
        change, longer = self.solved(found, found.columns)
        reading = _Reading(self, found, change, longer)
        quantities = reading.quantities()
        values, slopes = zip(*quantities.values(), strict=True)
        value, gradient = np.stack(values, axis=1), np.stack(slopes, axis=1)
        value[~is_ok], gradient[~is_ok] = np.nan, np.nan
        return OrbitGradients(
            names=tuple(quantities),
            value=value,
            gradient=gradient,
            state=self.y,
            state_gradient=reading.state_gradient,
            monodromy=found.monodromy,
            is_ok=is_ok,
        )


class _Reading:
    """Quantities of orbits, from motions that end at their extrema and at walls."""

    def __init__(self, orbits: Orbits, found: Motions, change: Array, longer: Array) -> None:
        self.orbits, self.found, self.longer = orbits, found, longer
        self.events, self.model = found.events(), orbits.models.systems[0]
        n, contacts = self.model.n, len(self.model.contacts)
        self.directions = np.array(self.model.directions, float).reshape(contacts, n)
        # An oscillator in its general form has extrema of its gap, too.
        has_gaps = not isinstance(self.model, Oscillator)
        self.first_gap = n if has_gaps else 0
        self.walls = _Walls(orbits.shifted, orbits.shifts)
        self.is_rigid = np.array([law.losses.is_rigid for law in orbits.models.laws[0]], bool)
        self._turns = self._turning_points()
        turned = _extremes(*self._turns, self.first_gap + contacts if has_gaps else n)
        grazed = self._nearest()
        passed = np.repeat(np.arange(len(orbits.y)), self.events.n_contacts)
        is_elastic = ~self.is_rigid[self.events.contacts_of]
        self._passed_of = self.events.contacts_of[is_elastic]
        passed = passed[is_elastic]
        which = np.concatenate([turned[0], grazed[0], passed])
        times = np.concatenate([turned[1], grazed[1], self.events.t_contacts[is_elastic]])
        if self.is_rigid.any():
            times[: len(turned[0])] -= _BEFORE * orbits.period[turned[0]]
        ends = orbits.run(which, np.maximum(times, 0.0), records=False)
        assert ends.columns is not None and ends.monodromy is not None  # noqa: PT018
        moved = ends.columns + ends.monodromy @ change[which]
        first, last = len(turned[0]), len(which) - len(passed)
        self._turned = *turned, ends.state[:first], moved[:first]
        self._grazed = grazed[0], grazed[2], ends.state[first:last], moved[first:last]
        self._passed = passed, ends.state[last:], moved[last:]
        # A column by the frequency is that of the speed over the phase.
        self.state_gradient = change.copy()
        rates = orbits.shifts.derivatives(orbits.shifted.omega)
        if rates.any():
            speed = orbits.y[:, n : 2 * n] / orbits.models.omega[:, None]
            self.state_gradient[:, n : 2 * n] += speed[:, :, None] * rates.T[:, None, :]

    def quantities(self) -> dict[str, tuple[Array, Array]]:
        """Values, shape (n,), and derivatives, shape (n, n_parameters), by quantity."""
        low, high = self._extreme_values()
        found: dict[str, tuple[Array, Array]] = {}
        names = [f"[{x}]" if self.orbits.is_system else "" for x in self.model.coordinates]
        for i, label in enumerate(names):
            found[f"x_max{label}"], found[f"x_min{label}"] = high(i), low(i)
            (top, d_top), (bottom, d_bottom) = high(i), low(i)
            found[f"amplitude{label}"] = 0.5 * (top - bottom), 0.5 * (d_top - d_bottom)
        for k, contact in enumerate(self.model.contacts):
            label = f"[{contact}]" if self.orbits.is_system else ""
            ends = low(self.first_gap + k), high(self.first_gap + k)
            if self.orbits.is_system:
                found[f"contact_x_max{label}"], found[f"contact_x_min{label}"] = ends[::-1]
            found[f"force_max{label}"] = self._largest_force(k, ends)
            found[f"contact_share{label}"] = self._share(k)
        if self.model.contacts:
            found["graze"] = self._graze()
        y, dy, n = self.orbits.y, self.state_gradient, self.model.n
        for i, label in enumerate(names):
            found[f"x_end{label}"] = y[:, i], dy[:, i]
            found[f"v_end{label}"] = y[:, n + i], dy[:, n + i]
        if not self.orbits.is_forced:
            found["period"] = self.orbits.period, self.longer
        return found

    def _extreme_values(self) -> Any:
        """Functions of a quantity's number that return its least and its largest values."""
        which, _, of, side, states, moved = self._turned
        n, n_rows, n_parameters = self.model.n, len(self.orbits.y), moved.shape[2]
        along = np.concatenate([np.eye(n), self.directions])[of]
        shape = n_rows, self.first_gap + len(self.directions) + n, 2
        value, slope = np.full(shape, np.nan), np.full((*shape, n_parameters), np.nan)
        value[which, of, side] = (along * states[:, :n]).sum(axis=1)
        slope[which, of, side] = np.einsum("ki,kip->kp", along, moved[:, :n])
        if self.is_rigid.any():
            speed = (along * states[:, n : 2 * n]).sum(axis=1)
            left, later = self._next_impacts(which, states, moved)
            value[which, of, side] += speed * left
            slope[which, of, side] += speed[:, None] * later
        return (
            lambda i: (value[:, i, 0], slope[:, i, 0]),
            lambda i: (value[:, i, 1], slope[:, i, 1]),
        )

    def _next_impacts(self, which: Numbers, states: Array, moved: Array) -> tuple[Array, Array]:
        """Times [s] from the ends of motions to impacts close by, and their derivatives.

        Shapes (n_motions,) and (n_motions, n_parameters); 0 without such an impact. The time of a
        slow impact has rounding errors: it may be before the end.
        """
        n, b = self.model.n, self.directions[self.is_rigid]
        place, moving = (x[which][:, self.is_rigid] for x in (self.walls.place, self.walls.moving))
        gap, speed = (states[:, n * k : n * (k + 1)] @ b.T for k in range(2))
        off = place - gap[:, :, None]
        side = np.abs(off).argmin(axis=2)
        left = np.take_along_axis(off, side[:, :, None], axis=2)[:, :, 0]
        with np.errstate(all="ignore"):
            left = left / speed
        is_next = np.abs(left) <= _CLOSE_BY * self.orbits.period[which, None]
        first = np.where(is_next, np.abs(left), np.inf).argmin(axis=1)
        rows = np.arange(len(which))
        missed = moving[rows, first, side[rows, first]]
        missed = missed - np.einsum("ki,kip->kp", b[first], moved[:, :n])
        left, is_impact = left[rows, first], is_next[rows, first]
        speeds = np.where(is_impact, speed[rows, first], np.inf)
        return np.where(is_impact, left, 0.0), missed / speeds[:, None]

    def _share(self, contact: int) -> tuple[Array, Array]:
        """Share of a period beyond the walls of a contact, and its derivatives.

        Impacts take no time. Holds have no derivative: their force is zero at their end.
        """
        assert self.found.contact_time is not None
        period, n = self.orbits.period, self.model.n
        share = self.found.contact_time[:, contact] / period
        if self.is_rigid[contact]:
            slope = np.where(share == 0.0, 0.0, np.nan)[:, None]
            return share, np.broadcast_to(slope, self.longer.shape)
        which, states, moved = (each[self._passed_of == contact] for each in self._passed)
        b = self.directions[contact]
        gap, speed = states[:, :n] @ b, states[:, n : 2 * n] @ b
        side, wall = self.walls.nearest(contact, which, gap)
        with np.errstate(divide="ignore", invalid="ignore"):
            later = (wall - np.einsum("i,kip->kp", b, moved[:, :n])) / speed[:, None]
        begins = np.where(speed * side > 0.0, -1.0, 1.0)  # the contact begins there
        time = np.zeros((len(period), later.shape[1]))
        np.add.at(time, which, begins[:, None] * later)
        low, high = self.walls.place[:, contact].T
        start = self.orbits.y[:, :n] @ b
        time += np.where((start < low) | (start > high), 1.0, 0.0)[:, None] * self.longer
        time[low == high] = np.nan
        share, time = (
            np.where(low > high, 1.0, share),
            np.where((low > high)[:, None], self.longer, time),
        )
        if any(laws[contact].losses.never_pulls for laws in self.orbits.models.laws):
            time[:] = np.nan  # it ends where its force is zero, at no wall
        return share, (time - share[:, None] * self.longer) / period[:, None]

    def _largest_force(
        self, contact: int, ends: tuple[tuple[Array, Array], tuple[Array, Array]]
    ) -> tuple[Array, Array]:
        """Largest force of a contact [N]; without derivatives if the contact is damped.

        Impacts have none.
        """
        if self.is_rigid[contact]:
            return np.full_like(ends[0][0], np.nan), np.full_like(ends[0][1], np.nan)
        if self.found.contact_force is None:
            return self.walls.largest_force(contact, *ends)
        return self.found.contact_force[:, contact], np.full_like(ends[0][1], np.nan)

    def _turning_points(self) -> tuple[Numbers, Array, Array, Numbers]:
        """Orbits, times [s], values [m] and numbers of the quantities of all turning points."""
        events, y, n = self.events, self.orbits.y, self.model.n
        which = np.repeat(np.arange(len(y)), events.n_extrema)
        found = which, events.t_extrema, events.extrema, events.extrema_of
        if self.orbits.is_forced:
            return found
        # An unforced orbit starts at a maximum, which is no event.
        along = np.concatenate([np.eye(n), self.directions])
        speed = np.abs(y[:, n : 2 * n] @ along.T)
        rows, of = np.nonzero(speed <= _STILL * np.abs(y[:, n : 2 * n]).max(axis=1)[:, None])
        begins = rows, np.zeros(len(rows)), (y[:, :n] @ along.T)[rows, of], of
        which, t, value, of = (np.concatenate(pair) for pair in zip(found, begins, strict=True))
        return which, t, value, of

    def _nearest(self) -> tuple[Numbers, Array, Numbers]:
        """Orbits, times [s] and contacts of the turning points nearest to walls."""
        which, t, value, of = self._turns
        contact = of - self.first_gap
        its = np.flatnonzero((contact >= 0) & (len(self.directions) > 0))
        which, t, contact = which[its], t[its], contact[its]
        off, side = self.walls.beyond(contact, which, value[its])
        # On rigid walls they are impacts, and away from them no graze follows.
        off[self.is_rigid[contact] & ((off == 0.0) | (self._heading()[its] != side))] = np.inf
        off = np.abs(off)
        order = np.lexsort((off, which))
        places = order[np.diff(which[order], prepend=-1) != 0]
        places = places[np.isfinite(off[places])]
        return which[places], t[places], contact[places]

    def _heading(self) -> Numbers:
        """1 of turning points that are maxima, 0 of minima, else -1."""
        which, t, value, of = self._turns
        order = np.lexsort((t, of, which))
        key = (which * (of.max(initial=0) + 1) + of)[order]
        first, last = (np.searchsorted(key, key, side=side) for side in ("left", "right"))
        place, found = np.arange(len(key)) - first, np.full(len(key), -1)
        here = value[order]
        before, after = (here[first + (place + by) % (last - first)] for by in (-1, 1))
        found[order[(here > before) & (here > after)]] = 1
        found[order[(here < before) & (here < after)]] = 0
        return found

    def _graze(self) -> tuple[Array, Array]:
        """Distances of these turning points beyond the walls [m], and their derivatives."""
        which, contact, states, moved = self._grazed
        n, n_rows = self.model.n, len(self.orbits.y)
        along = self.directions[contact]
        gap = (along * states[:, :n]).sum(axis=1)
        d_gap = np.einsum("ki,kip->kp", along, moved[:, :n])
        value, slope = np.full(n_rows, np.nan), np.full((n_rows, moved.shape[2]), np.nan)
        value[which], side = self.walls.beyond(contact, which, gap)
        sign = 2.0 * side - 1.0
        slope[which] = sign[:, None] * (d_gap - self.walls.moving[which, contact, side])
        return value, slope


def _extremes(
    motion: Numbers, t: Array, value: Array, of: Numbers, n: int
) -> tuple[Numbers, Array, Numbers, Numbers]:
    """Smallest and largest extremum of n quantities of every motion.

    Returns
    -------
    which, t, of, side : ndarray
        Motions, times [s], quantities, and 0 for the smallest or 1 for the largest.
    """
    key = motion * n + of
    order = np.lexsort((value, key))
    is_first = np.diff(key[order], prepend=-1) != 0
    is_last = np.diff(key[order], append=-1) != 0
    places = np.concatenate([order[is_first], order[is_last]])
    side = np.repeat([0, 1], [is_first.sum(), is_last.sum()])
    return motion[places], t[places], of[places], side


class _Walls:
    """Stiffnesses [N/m] and places [m] of the lower and the upper walls, and their derivatives."""

    def __init__(self, models: Models, shifts: Shifts) -> None:
        numbers = _numbers_of(models).reshape(len(models), -1, 2, 2)
        self.stiffness, self.place = numbers[: shifts.n].transpose(2, 0, 1, 3)
        with np.errstate(invalid="ignore", over="ignore"):  # no wall is at infinity
            found = shifts.derivatives(numbers).transpose(3, 1, 2, 4, 0)
        self.stiffening, self.moving = np.where(np.isfinite(found), found, 0.0)

    def nearest(self, contact: int, which: Numbers, gap: Array) -> tuple[Array, Array]:
        """Sides (-1, +1) of the walls nearest to gaps, and derivatives of their places."""
        off = np.abs(self.place[which, contact] - gap[:, None])
        side = (off[:, 1] <= off[:, 0]).astype(int)
        return 2.0 * side - 1.0, self.moving[which, contact, side]

    def beyond(self, contact: Numbers, which: Numbers, gap: Array) -> tuple[Array, Numbers]:
        """Distances of gaps beyond the nearest wall with a spring [m], and its side, 0 or 1."""
        beyond = (gap[:, None] - self.place[which, contact]) * (-1.0, 1.0)
        felt = np.where(self.stiffness[which, contact] > 0.0, beyond, -np.inf)
        side = np.abs(felt).argmin(axis=1)
        return np.asarray(felt[np.arange(len(gap)), side]), side

    def largest_force(
        self, contact: int, low: tuple[Array, Array], high: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Largest force between two gaps [N], and its derivatives."""
        forces, slopes = [np.zeros(len(low[0]))], [np.zeros_like(low[1])]
        for side, (gap, moved) in enumerate((low, high)):
            sign = 2.0 * side - 1.0
            stiffness, depth = (
                self.stiffness[:, contact, side],
                sign * (gap - self.place[:, contact, side]),
            )
            deeper = sign * (moved - self.moving[:, contact, side])
            slope = stiffness[:, None] * deeper
            slope += self.stiffening[:, contact, side] * depth[:, None]
            forces.append(np.where(depth > 0.0, stiffness * depth, 0.0))
            slopes.append(np.where((depth > 0.0)[:, None], slope, 0.0))
        largest = np.argmax(forces, axis=0)
        rows = np.arange(len(largest))
        return np.array(forces)[largest, rows], np.array(slopes)[largest, rows]


def _numbers_of(models: Models) -> Array:
    """Stiffnesses of lower and upper walls, and their places; shape (n, n_contacts, 4)."""
    return models.of_laws(lambda law: (*law.stiffnesses, *law.walls))
