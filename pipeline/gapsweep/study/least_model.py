"""The simplest adequate model of a case, from its parameters only.

Nothing is integrated, so no result can influence the choice (docs/decisions/0010-advice.md, 0056):

- *The walls are never reached.* The linear model answers a force of magnitude f along a direction
  by at most L f along another, with L the integral of its impulse response's magnitude. As long as
  ``|a·q| <= g`` for the direction a of a cubic spring, its force is at most ``|α| g³``. Let g_0
  bound the linear motion, transient included. If ``g = g_0 + Σ L |α| g³`` has a solution with which
  no contact reaches a wall, the motion never leaves it: plain Duffing, whose motion is the same.
- *The cubic springs are negligible.* By the same bound they change the steady motion by at most
  ``Σ L |α| g³``, now with the linear steady amplitude as g_0. Below the error: linear.
- *A tolerance* of a tenth of the error is enough where that bound holds: then the steady motion is
  the only one, because the loop gain of the cubic springs is below one. If walls may be reached,
  there may be several, and the tolerance is the one that decides between them: errors of the
  transient must stay as small as those of an initial condition, for any error of the amplitude.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.simulate import AnyLaw, cases
from gapsweep.model.arrays import array
from gapsweep.model.oscillator import Oscillator, called_as, checked
from gapsweep.model.structure import general_form
from gapsweep.model.system import System, first_order
from gapsweep.model.table import ForceTable
from gapsweep.model.user_law import UserLaw
from gapsweep.study.points import OF_CONTACT, Points

Array = NDArray[np.float64]

DEFAULT_ERROR = 1e-3
SMALLEST_ERROR, LARGEST_ERROR = 1e-9, 0.1
# Solver tolerance: per allowed error, and largest one if it may decide between attractors.
_TOLERANCE, _CHOOSING_RTOL = 0.1, 1e-9
_STEPS, _CLOSE = 1000, 1e-13  # of the iteration for g, and the relative change at which it ends
_ROUNDING = 1e-12  # of the fastest rate: a smaller growth is that of an undamped motion


class Model(IntEnum):
    """Simplest adequate model of a case; the numbers are part of the schema."""

    EXACT = 0
    DUFFING = 1
    LINEAR = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """The simplest adequate model for one case and initial condition.

    Attributes
    ----------
    model : Model
    bound : tuple of float
        Upper bound of the displacement at every contact [m]; infinite if none is known.
    oscillator : Oscillator or System
        Model to simulate: without cubic springs if `model` is linear.
    law : ContactLaw or dict of str to ContactLaw
        Exact law to simulate, in place of a smooth one: with ``K_c = 0`` if the walls are never
        reached. Wall crossings are counted nevertheless.
    rtol : float
        Relative tolerance of the solver [-].
    """

    model: Model
    bound: tuple[float, ...]
    oscillator: Oscillator | System
    law: AnyLaw
    rtol: float


@called_as("gs.advise(oscillator, law, 9.0), in Hz")
def advise(
    oscillator: Oscillator | System,
    law: AnyLaw | None = None,
    omega: float | None = None,
    start: ArrayLike | None = (),
    *,
    error: float = DEFAULT_ERROR,
) -> Advice:
    """Return the simplest adequate model of a case.

    Parameters
    ----------
    oscillator : Oscillator or System
    law : ContactLaw or mapping of str to ContactLaw
        As in `gapsweep.simulate`. The distances of its walls decide; user laws and force tables may
        act between their walls, so that no bound is known.
    omega : float, optional
        Forcing frequency [Hz]; None for an unforced system.
    start : array_like, shape (n_states,), optional
        Initial coordinates [m], velocities [m/s] and first-order states at forcing phase zero; all
        zero by default, None if not known.
    error : float
        Allowed error of the steady amplitude, relative to the larger of the amplitude and half the
        narrowest gap; 1e-9 to 0.1.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> found = gs.advise(gs.systems.paper_oscillator(), law, 30.0)
    >>> found.model.name, found.law.K_c
    ('LINEAR', 0.0)
    """
    error = check_error(error)
    models, rest, _ = cases(oscillator, {} if law is None else law, omega, 0.0, 0.0, 0.0, 0.0)
    if len(models) > 1:
        raise ModelError(
            f"{len(models)} cases: advise judges one; call it for each, or use 'gapsweep advise' "
            "for a study"
        )
    (laws,) = models.laws
    if start is not None and np.size(start):
        rest = array("start", start, rest.shape[1:])[None]
    has_clearance = not any(isinstance(each, UserLaw | ForceTable) for each in laws)
    if has_clearance:
        laws = tuple(each.exact for each in laws)
    states = rest if has_clearance and start is not None else None
    walls = np.array([[(each.gap.j_1, each.gap.j_2) for each in laws]]).reshape(1, -1, 2)
    found = least(oscillator, walls, models.omega, states, error)
    model = Model(int(found.model[0]))
    if model is Model.LINEAR:
        oscillator = _without_cubics(oscillator)
    if model is not Model.EXACT:
        laws = tuple(replace(each, K_c=0.0) for each in laws)
    is_one = isinstance(oscillator, Oscillator)
    return Advice(
        model=model,
        bound=tuple(found.bound[0].tolist()),
        oscillator=oscillator,
        law=laws[0] if is_one else dict(zip(oscillator.contacts, laws, strict=True)),
        rtol=float(found.rtol[0]),
    )


def check_error(error: float) -> float:
    """Return `error` as a float, if it is within 1e-9..0.1.

    Raises `ModelError` if `error` is out of this range.
    """
    error = checked("error", error)
    if not SMALLEST_ERROR <= error <= LARGEST_ERROR:
        raise ModelError(f"error = {error:g}: must be in {SMALLEST_ERROR:g}..{LARGEST_ERROR:g}")
    return error


def _without_cubics(model: Oscillator | System) -> Oscillator | System:
    if isinstance(model, Oscillator):
        return replace(model, alpha=0.0)
    return replace(model, cubic=[replace(each, alpha=0.0) for each in model.cubic])


class Least(NamedTuple):
    """The simplest adequate models of n points: `Model`, bounds [m] and solver tolerances.

    Arrays of the shapes (n,), (n, n_contacts) and (n,).
    """

    model: NDArray[np.int8]
    bound: Array
    rtol: Array

    def put(self, rows: NDArray[np.intp], some: "Least") -> None:
        """Replace the numbers of some of the points."""
        for whole, part in ((self.model, some.model), (self.bound, some.bound)):
            whole[rows] = part
        self.rtol[rows] = some.rtol


def least_of(points: Points, error: float, *, is_exact: bool = True) -> Least:
    """Return the simplest adequate models of points, independent of their representation.

    Without `is_exact` the law of a contact may act between its walls, so that no bound is known.
    """
    kind, n = points.kind, len(points)
    walls, omega, rows, starts = np.split(
        points.numbers,
        np.cumsum([len(OF_CONTACT) * len(kind.contacts), 1, len(kind.structure.names)]),
        axis=1,
    )
    walls = walls.reshape(n, -1, len(OF_CONTACT))[..., 1:3]
    found = unknown(n, len(kind.contacts), error)
    several, which = np.unique(rows, axis=0, return_inverse=True)
    for number, row in enumerate(several if is_exact and not kind.is_sweep else ()):
        some = np.flatnonzero(which.reshape(-1) == number)
        here = least(kind.structure.system(row), walls[some], omega[some, 0], starts[some], error)
        found.put(some, here)
    return found


def without_what_has_no_effect(points: Points, found: Least) -> Array:
    """Return the numbers of points with the stiffnesses that `found` leaves out set to zero."""
    names, numbers = points.kind.numbers, points.numbers.copy()
    for zero, name in ((found.model != Model.EXACT, "K_c"), (found.model == Model.LINEAR, "alpha")):
        columns = [i for i, column in enumerate(names) if column.partition("[")[0] == name]
        numbers[np.ix_(zero, columns)] = 0.0
    return numbers


def unknown(n: int, n_contacts: int, error: float) -> Least:
    """Return the `Least` of n points of which nothing is known."""
    rtol = np.full(n, min(_TOLERANCE * error, _CHOOSING_RTOL))
    return Least(np.full(n, Model.EXACT, np.int8), np.full((n, n_contacts), math.inf), rtol)


def least(
    model: Oscillator | System, walls: Array, omega: Array, starts: Array | None, error: float
) -> Least:
    """Return the simplest adequate models of a model at n points.

    `walls`: shape (n, n_contacts, 2); distances of the lower and the upper wall of every contact
    [m].
    `omega`: shape (n,); forcing frequencies [Hz].
    `starts`: shape (n, n_states); initial states; None if not known.
    `error`: as in `advise`.
    """
    n, n_contacts = walls.shape[:2]
    found = unknown(n, n_contacts, error)
    try:
        system = general_form(model) if isinstance(model, Oscillator) else model
    except ModelError:  # its stiffness is beyond the numbers of a system
        return found
    with np.errstate(all="ignore"):  # undamped resonance, defective modes: no number, no bound
        linear = _Linear.of(system)
        if starts is None or linear is None:
            return found
        steady, swing, transient = linear.bounds(omega, starts)
        moved = linear.moved(steady)
        bound = steady + transient
        bound = (bound + linear.moved(bound))[:, :n_contacts]
        is_certain = (bound < walls.min(axis=2)).all(axis=1)
        walls = np.where(np.isfinite(walls), walls, 0.0)
        half = 0.5 * walls.sum(axis=2).min(axis=1, initial=math.inf) if n_contacts else 0.0
        scale = np.maximum(swing - moved, np.reshape(half, (-1, 1)))
        is_linear = is_certain & (moved <= error * scale)[:, : n_contacts + system.n].all(axis=1)
    found.model[is_certain] = np.where(is_linear, Model.LINEAR, Model.DUFFING)[is_certain]
    found.bound[is_certain] = bound[is_certain]
    found.rtol[is_certain] = _TOLERANCE * error
    return found


@dataclass(frozen=True, slots=True)
class _Linear:
    """Motions of a system without contacts and cubic springs, by its modes.

    Every displacement is one along a direction: those of the contacts, the coordinates, then those
    of the cubic springs, k in all.
    """

    system: System
    rates: NDArray[np.complex128]  # shape (n_states,); eigenvalues [1/s]
    # Shape (k, n_states); the displacement along each direction due to every mode.
    seen: NDArray[np.complex128]
    # `vectors`, `modes`: shape (n_states, n_states); eigenvectors, one a column, and their inverse:
    # the amplitudes of the modes in a state.
    vectors: NDArray[np.complex128]
    modes: NDArray[np.complex128]
    # Shape (k,); square of a displacement over twice the energy that it needs [m/N]; infinite if
    # the energy of free motions may grow.
    energy: Array
    # Shape (n_cubic, k); for every cubic spring, ``L |α|`` along all directions [1/m²].
    shares: Array

    @classmethod
    def of(cls, system: System) -> "_Linear | None":
        """Return the modes of a system; None if a free motion may grow or leave."""
        n, n_cubic = system.n, len(system.cubic)
        rates, vectors = np.linalg.eig(first_order(system))
        rates, vectors = rates.astype(complex), vectors.astype(complex)
        if not system.is_held or rates.real.max() > _ROUNDING * np.abs(rates).max():
            return None
        try:
            modes = np.linalg.inv(vectors)
        except np.linalg.LinAlgError:  # equal modes, as at critical damping
            return None
        along = np.vstack([system.directions, np.eye(n), *(each.along for each in system.cubic)])
        seen = along @ vectors[:n]
        # Rates of change of all modes due to a force along each cubic spring.
        driven = modes[:, n : 2 * n] @ np.linalg.solve(system.mass, along[len(along) - n_cubic :].T)
        shares = [
            abs(spring.alpha) * _gains(rates, seen * of) if spring.alpha else 0.0 * along[:, 0]
            for spring, of in zip(system.cubic, driven.T, strict=True)
        ]
        energy = np.full(len(along), math.inf)
        spring, damper = system.stiffness, system.damping
        is_elastic = np.array_equal(spring, spring.T) and np.linalg.eigvalsh(spring)[0] > 0.0
        loss = np.linalg.eigvalsh(damper + damper.T)[0]
        if is_elastic and not system.n_lags and loss >= -_ROUNDING * np.abs(damper).max():
            energy = np.einsum("ki,ik->k", along, np.linalg.solve(spring, along.T))
        return cls(
            system, rates, seen, vectors, modes, energy, np.reshape(shares, (n_cubic, len(along)))
        )

    def bounds(self, omega: Array, starts: Array) -> tuple[Array, Array, Array]:
        """Return bounds of displacements [m], each of the shape (n_points, k).

        First the largest steady one, then a lower bound of the steady amplitude, half of the
        distance from trough to peak, and last the largest transient one. A force by pieces moves
        the system by at most its peak times the integral of the impulse response's magnitude.
        """
        system, n = self.system, self.system.n
        left, steady = starts.astype(complex), np.zeros((len(starts), len(self.seen)))
        swings = [steady]
        for load in system.waves:  # from rest, whatever its course
            driven = self.modes[:, n : 2 * n] @ np.linalg.solve(system.mass, load.amplitude)
            steady = steady + _gains(self.rates, self.seen * driven)
        for k in sorted({load.k for load in system.harmonics}):
            turns = 2.0j * math.pi * k * omega
            load = sum(
                np.multiply.outer(
                    each.growth(abs(turns) / k if k else 0.0 * omega) * np.exp(1j * each.phase),
                    each.amplitude,
                )
                for each in system.harmonics
                if each.k == k
            )
            if not k:
                load = load.real.astype(complex)
            forced = load @ np.linalg.solve(system.mass, self.modes[:, n : 2 * n].T)
            forced = forced / (turns[:, None] - self.rates)
            left = left - (forced @ self.vectors.T).real
            size = np.abs(forced @ self.seen.T)
            steady = steady + size
            swings += [size] if k else []
        parts = np.abs((left @ self.modes.T)[:, None, :] * self.seen).sum(axis=2)
        q, v = left.real[:, :n], left.real[:, n : 2 * n]
        work = ((q @ system.stiffness) * q + (v @ system.mass) * v).sum(axis=1)
        transient = np.fmin(parts, np.sqrt(np.multiply.outer(work, self.energy)))
        # The mean of |cos| is 2/π, so that a harmonic has at most 4/π of the amplitude of a sum.
        share = 1.0 if len(swings) <= 2 else 0.25 * math.pi
        swing = np.max(swings, axis=0) * (0.0 if system.waves else share)
        return steady, swing, transient

    def moved(self, g_0: Array) -> Array:
        """Return a bound of the displacement by the cubic springs, infinite if there is none.

        `g_0` bounds the linear motion; both have the shape (n_points, k).
        """
        if not self.shares.any():
            return np.zeros_like(g_0)
        first = g_0.shape[1] - len(self.shares)
        g = g_0[:, first:]
        is_over = np.zeros(len(g), bool)
        for _ in range(_STEPS):
            before, g = g, g_0[:, first:] + g**3 @ self.shares[:, first:]
            is_over = ~np.any(np.abs(g - before) > _CLOSE * g, axis=1)
            if is_over.all():
                break
        known = np.where(is_over[:, None] & np.isfinite(g), g, math.inf)
        moved = known**3 @ self.shares
        return np.where(np.isnan(moved), math.inf, moved)


def _gains(rates: NDArray[np.complex128], parts: NDArray[np.complex128]) -> Array:
    """Return integrals of the magnitudes of impulse responses [m/N].

    Modes add up: a pair of complex ones by its exact integral, two real ones as a difference of one
    sign and a rest. `rates` has the shape (n_states,), `parts` of the responses (k, n_states).
    """
    gains = np.zeros(len(parts))
    for rate, part in zip(rates, parts.T, strict=True):
        if rate.imag > 0.0:
            gains += 2.0 * np.abs(part) * _decaying(abs(rate.real), rate.imag, np.angle(part))
    real = sorted(np.flatnonzero(rates.imag == 0.0), key=lambda i: rates[i].real)
    for i, j in zip(real[::2], real[1::2], strict=False):
        slow, fast = -1.0 / rates[j].real, -1.0 / rates[i].real
        one, other = np.abs(parts[:, j]), np.abs(parts[:, i])
        rest = np.abs(parts[:, i] + parts[:, j])
        gains += np.minimum(one * slow + other * fast, other * (slow - fast) + rest * slow)
    if len(real) % 2:
        gains += np.abs(parts[:, real[-1]]) / -rates[real[-1]].real
    return gains


def _decaying(decay: float, rate: float, phase: Array) -> Array:
    """Integral of ``exp(-decay t) |cos(rate t + phase)|`` over all times t > 0 [s]."""
    begin = np.mod(phase + 0.5 * math.pi, math.pi)  # phase of the sine at t = 0
    until = (math.pi - begin) / rate  # its first zero
    turning = complex(-decay, rate)
    first = (np.exp(1j * begin) * (np.exp(turning * until) - 1.0) / turning).imag
    rest = rate / (decay**2 + rate**2) / np.tanh(0.5 * math.pi * decay / rate)
    return np.asarray(first + np.exp(-decay * until) * rest)
