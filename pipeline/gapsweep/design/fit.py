"""`gapsweep.fit`: parameters of a model from measured sweeps, by least squares.

Sweeps are simulated as they were measured: each point starts where the one before ended, so that a
measured point belongs to the branch that the direction of its sweep reaches. Between the measured
and the computed frequency of a jump, measurement and model are on different branches: residuals
there are limited, and have no derivative.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2, qmc

from gapsweep.continuation.family import Window
from gapsweep.design.demands import quantity
from gapsweep.design.machine import Machine
from gapsweep.design.measured import Sweep, noise_of, ranges, sweeps
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Model
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.oscillator import Oscillator, called_as
from gapsweep.quantities import UNITS, written
from gapsweep.response.result import Responses
from gapsweep.status import Status

Array = NDArray[np.float64]

CANDIDATES = 128  # points of the ranges at which sweeps are simulated first
STARTS, APART = 3, 0.15  # best of them that are improved; their distance, as a share of the ranges
# Largest residual of a point: first as a share of the largest measured value, then in standard
# deviations, of which 1.4826 medians are one.
ON_BRANCH, OUTSIDE, MEDIAN = 0.2, 6.0, 1.4826
ROUNDS, SETTLED = 4, 1e-4  # of least squares, with new sweeps each; a shorter move ends them
DIFFERENCE = 1e-4  # of one-sided differences, as a share of a range
AGREE = 0.1  # largest change of a slope between both sides, as a share of it
ALIKE = 0.02  # minima closer than this share of the ranges are the same
COVERS = 2.0  # standard errors on either side of an interval
CLOSE_TO_1 = 0.99  # correlation of parameters that the sweeps do not distinguish
BY_CHANCE = 0.999  # probability of smaller residuals, beyond which the model does not explain them


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Fit:
    """Parameters fitted to measured sweeps, as returned by `fit`.

    Attributes
    ----------
    values, errors : dict of str to float
        Fitted parameters and their standard errors, in the unit of each; the error is infinite
        where the sweeps do not determine a parameter.
    covariance, correlation : ndarray, shape (p, p)
        Covariance and correlation of the parameters, in the order of `values`.
    noise : ndarray, shape (n,)
        Standard deviation of each measured value: as given, or estimated from the residuals.
    quantity : str
        Measured quantity, as ``"amplitude"``.
    omega, measured, computed, residual : ndarray, shape (n,)
        Frequencies [Hz], measured and computed values, and their difference (measured minus
        computed), sweep after sweep in the order of the measurement.
    direction : ndarray of str, shape (n,)
        ``"up"`` or ``"down"``.
    is_on_branch : ndarray of bool, shape (n,)
        Whether measurement and model are on the same branch; the other points do not count.
    minima : tuple of dict
        Values of all minima that were found, the best one first, with their misfit: the mean square
        of the residuals in units of the noise.
    notes : tuple of str
        Doubts, a sentence each.
    oscillator, law
        The model and its contact laws with the fitted values.

    Examples
    --------
    >>> import gapsweep as gs
    >>> machine = gs.Oscillator(mass=1.0, omega_n=1.0, zeta=0.05, forcing=1.0)
    >>> table = {"frequency [Hz]": [0.5, 0.6, 0.7], "amplitude [mm]": [33.7, 39.4, 49.2]}
    >>> found = gs.fit(table, machine, gs.Piecewise(0.0, gs.Gap(1.0, 1.0)), free={"mass": (0.5, 2)})
    >>> round(found.values["mass"], 2)
    1.0
    """

    values: dict[str, float]
    errors: dict[str, float]
    covariance: Array
    correlation: Array
    noise: Array
    quantity: str
    omega: Array
    measured: Array
    computed: Array
    residual: Array
    direction: NDArray[np.str_]
    is_on_branch: NDArray[np.bool_]
    minima: tuple[dict[str, float], ...]
    notes: tuple[str, ...]
    oscillator: Any = field(compare=False)
    law: Any = field(compare=False)

    @property
    def units(self) -> dict[str, str]:
        """Units of the parameters; empty text for those of a System."""
        known = UNITS if isinstance(self.oscillator, Oscillator) else {}
        return {name: known.get(name, "") for name in self.values}

    def plot(self) -> Any:
        """Return the figure of `gapsweep.plot`: measured points over branches, and residuals."""
        from gapsweep import plot

        return plot(self)

    def __repr__(self) -> str:
        lines = [f"<gapsweep.Fit of {self.quantity} at {len(self.omega)} points>"]
        for name, value in self.values.items():
            unit = written(self.units[name])
            lines.append(f"  {name} = {value:.6g} ± {self.errors[name]:.2g} {unit}".rstrip())
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])


class _Points:
    """Measured points, and the responses of a machine to them."""

    def __init__(
        self, machine: Machine, windows: tuple[Window, ...], name: str, found: list[Sweep]
    ) -> None:
        self.machine, self.windows, self.quantity, self.sweeps = machine, windows, name, found
        self.omega = np.concatenate([each.omega for each in found])
        self.values = np.concatenate([each.values for each in found])
        self.direction = np.concatenate([[each.direction] * len(each.omega) for each in found])

    def parameters(self, places: Array) -> Array:
        """Parameter values at places 0 to 1 in their ranges, shape (m, p)."""
        return np.stack([w.value(places[:, k]) for k, w in enumerate(self.windows)], axis=1)

    def of(self, found: Responses) -> Array:
        """Return the measured quantity of responses; NaN for a failure."""
        values = quantity(self.quantity, found, self.machine.family.example)
        is_ok = found.columns["status"] == Status.OK
        return np.where(is_ok, values.max(axis=1), np.nan)

    def swept(self, places: Array) -> tuple[Array, Array]:
        """Return computed values and end states of the sweeps at m places.

        Returns
        -------
        values : ndarray, shape (m, n)
        states : ndarray, shape (m, n, n_states)
        """
        m = len(places)
        orders = [each.omega for each in self.sweeps]
        found = self.machine.sweeps(self.parameters(places), orders)
        values = [self.of(each).reshape(-1, m).T for each in found]
        states = [each.ends.reshape(-1, m, self.machine.n_states) for each in found]
        return np.concatenate(values, axis=1), np.concatenate(states).transpose(1, 0, 2)

    def with_derivatives(self, place: Array, states: Array) -> tuple[Array, Array, Array]:
        """Return values from states near the responses, their derivatives and end states.

        Returns
        -------
        values : ndarray, shape (n,)
        derivatives : ndarray, shape (n, p)
            By places. Zero where the differences on both sides do not agree: a branch ends there
            or turns at a fold, or the response is not periodic.
        states : ndarray, shape (n, n_states)
        """
        p, n = len(place), len(self.omega)
        places = place + DIFFERENCE * np.concatenate([np.zeros((1, p)), np.eye(p), -np.eye(p)])
        rows = np.repeat(self.parameters(places), n, axis=0)
        found = self.machine.respond(
            rows, np.tile(self.omega, len(places)), np.tile(states, (len(places), 1))
        )
        values = self.of(found).reshape(len(places), n)
        above, below = (values[1 : p + 1] - values[0]).T, (values[0] - values[p + 1 :]).T
        slopes = 0.5 * (above + below) / DIFFERENCE
        change, size = np.abs(above - below).max(axis=1), 0.5 * np.abs(above + below).max(axis=1)
        slopes[~(change <= AGREE * size)] = 0.0  # NaN agrees with nothing
        ends = np.where(found.has_end[:n, None], found.ends[:n], states)
        return values[0], slopes, ends


@dataclass(slots=True)
class _Residuals:
    """Residuals over the noise, limited, with derivatives; remembers the states of the best ones.

    A point off its branch has the limit as its residual, and no derivative.
    """

    points: _Points
    noise: Array
    limit: Array  # in units of the noise
    states: Array
    _least: float = np.inf
    _last: tuple[Array, Array, Array] | None = None

    def at(self, place: Array) -> tuple[Array, Array]:
        """Return residuals and derivatives at a place."""
        if self._last is None or not np.array_equal(self._last[0], place):
            values, slopes, states = self.points.with_derivatives(place, self.states)
            residual, is_on = limited(values, self.points.values, self.noise, self.limit)
            jacobian = np.where(is_on[:, None], slopes / self.noise[:, None], 0.0)
            cost = float((residual**2).sum())
            if cost < self._least:
                self._least, self.states = cost, states
            self._last = place.copy(), residual, jacobian
        return self._last[1], self._last[2]

    def solved(self, place: Array) -> Array:
        """Return the place of the minimum that a search from a place finds."""
        ends = DIFFERENCE, 1.0 - DIFFERENCE
        found = least_squares(
            lambda at: self.at(at)[0],
            np.clip(place, *ends),
            lambda at: self.at(at)[1],
            bounds=ends,
            xtol=1e-9,
            ftol=1e-10,
            gtol=1e-10,
            max_nfev=60,
        )
        return np.asarray(found.x)


def limited(
    values: Array, measured: Array, noise: Array | float, limit: Array | float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return residuals over the noise within ± a limit, and which ones are smaller."""
    with np.errstate(invalid="ignore"):
        residual = (values - measured) / noise
    residual = np.where(np.isnan(residual), limit, residual)
    return np.clip(residual, -limit, limit), np.abs(residual) < limit


@called_as("gs.fit('sweep.csv', oscillator, law, free={'gap': (1e-4, 1e-3)}, noise=5e-6)")
def fit(
    measured: Any,
    oscillator: Model | Callable[..., Model],
    law: AnyLaw | None = None,
    *,
    free: Mapping[str, Sequence[float]],
    noise: float | None = None,
    rtol: float | None = None,
) -> Fit:
    """Return parameters of a model that fit measured sweeps best.

    Parameters
    ----------
    measured : str, path, mapping, pandas.DataFrame or xarray.Dataset
        Sweeps: frequencies, values of one quantity of responses, and the directions of the sweeps.
        A CSV file has units in its header, as ``frequency [Hz], amplitude [mm], sweep``; see the
        tutorial *Identify a gap from a sweep*. A sweep starts from rest at its first frequency.
    oscillator : Oscillator, System, or callable
        Model, or a function that returns it for keywords.
    law : ContactLaw or mapping of str to ContactLaw
        As in `gapsweep.simulate`; None of a System without contacts.
    free : mapping of str to tuple of float
        Ranges of the parameters that are fitted, ascending: fields of the oscillator or the law,
        ``"gap"`` for both walls alike, or keywords of the function. A range that spans a decade is
        searched by its logarithm.
    noise : float, optional
        Standard deviation of the measured values, in the SI unit of the quantity or a quantity of
        pint, ``> 0``; None: that of the column ``noise`` of the table, which may differ from point
        to point, or without it an estimate from the residuals.
    rtol : float, optional
        As in `gapsweep.respond`.

    Returns
    -------
    Fit
        Values, standard errors, covariance, residuals of every point, and doubts in words.

    Raises
    ------
    ModelError
        If an argument is out of range, or the sweeps have too few points.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> machine = gs.systems.paper_oscillator()
    >>> omega = [7.0, 7.5, 8.0, 8.5]
    >>> amplitude = gs.respond(machine, law, omega=omega).amplitude
    >>> table = {"frequency [Hz]": omega, "amplitude [m]": amplitude}
    >>> found = gs.fit(table, machine, law, free={"gap": (2e-4, 8e-4)}, noise=1e-6)
    >>> abs(found.values["gap"] - 0.4e-3) < 1e-6
    True
    """
    name, found = sweeps(measured)
    windows = ranges(free, sum(len(each.omega) for each in found))
    scale = max(float(np.abs(each.values).max()) for each in found)
    if not scale > 0.0:
        raise ModelError("measured: all values are 0")
    given = noise_of(noise, name, found)
    ends = {window.name: (window.low, window.high) for window in windows}
    omega = np.concatenate([each.omega for each in found])
    machine = Machine.of(oscillator, law, ends, omega, rtol)
    points = _Points(machine, windows, name, found)
    sigma = np.full(len(omega), 0.01 * scale) if given is None else given
    places = [_minimum(points, start, sigma, scale) for start in _starts(points, scale)]
    return _result(points, places, given, sigma, scale)


def _starts(points: _Points, scale: float) -> list[Array]:
    """Places of the best candidates, at a distance from each other."""
    p = len(points.windows)
    places = qmc.Sobol(p, seed=0).random(CANDIDATES)
    values, _ = points.swept(places)
    residual, _ = limited(values, points.values, scale, ON_BRANCH)
    chosen: list[Array] = []
    for place in places[np.argsort((residual**2).sum(axis=1), kind="stable")]:
        if all(np.abs(place - other).max() > APART for other in chosen):
            chosen.append(place)
        if len(chosen) == STARTS:
            break
    return chosen


def _minimum(points: _Points, place: Array, sigma: Array, scale: float) -> Array:
    """Place of the minimum that a search from a place finds."""
    limit = ON_BRANCH * scale / sigma
    values, states = points.swept(place[None, :])
    for _ in range(ROUNDS):
        moved = _Residuals(points, sigma, limit, states[0]).solved(place)
        is_close = np.abs(moved - place).max() < SETTLED
        place = moved
        if is_close:
            break
        values, states = points.swept(place[None, :])
        limit = _outside(values[0], points.values, sigma, scale)
    return place


def _outside(values: Array, measured: Array, sigma: Array, scale: float) -> Array:
    """Limit of each residual, in units of sigma: some deviations of most points."""
    with np.errstate(invalid="ignore"):
        residual = np.abs(values - measured) / sigma
    typical = MEDIAN * float(np.median(np.nan_to_num(residual, nan=np.inf)))
    return np.minimum(OUTSIDE * max(typical, 1.0), ON_BRANCH * scale / sigma)


def _result(
    points: _Points, places: list[Array], given: Array | None, sigma: Array, scale: float
) -> Fit:
    """Fit at the best of some minima."""
    swept, all_states = points.swept(np.stack(places))
    several = []
    for place, values, states in zip(places, swept, all_states, strict=True):
        limit = _outside(values, points.values, sigma, scale)
        residual, is_on = limited(values, points.values, sigma, limit)
        # All minima are compared with the same limit, that of points off their branch.
        cost = float(
            (limited(values, points.values, sigma, ON_BRANCH * scale / sigma)[0] ** 2).mean()
        )
        several.append((cost, place, values, states, residual, is_on))
    several.sort(key=lambda each: each[0])
    _, place, values, states, residual, is_on = several[0]
    p = len(points.windows)
    _, slopes, _ = points.with_derivatives(place, states)
    freedom = max(int(is_on.sum()) - p, 1)
    squares = float((residual[is_on] ** 2).sum())
    noise = given
    if noise is None:
        noise = sigma * (squares / freedom) ** 0.5
    covariance = _covariance(slopes[is_on] / noise[is_on, None])
    step = 1e-6
    lower, upper = points.parameters(np.stack([place - step, place + step]))
    by_place = (upper - lower) / (2.0 * step)
    in_places = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(in_places, in_places)
    named = dict(
        zip(points.machine.family.names, points.parameters(place[None, :])[0].tolist(), strict=True)
    )
    errors = np.abs(by_place) * in_places
    family = points.machine.family
    laws = dict(zip(family.example.contacts, family.laws_at(named), strict=True))
    minima = _distinct(points, several, np.isfinite(in_places))
    notes = _notes(points, place, in_places, correlation, minima)
    n_off = int((~is_on).sum())
    if n_off:
        remedy = "; check the units of the table, and the ranges" if 2 * n_off > len(is_on) else ""
        notes.append(
            f"{n_off} of {len(is_on)} points are not on the branch of the model, and do not count"
            f"{remedy}."
        )
    if given is not None and squares > chi2.ppf(BY_CHANCE, freedom):
        notes.append(
            "The model does not explain the measurements, or their noise is larger: residuals are "
            f"{(squares / freedom) ** 0.5:.3g} times the noise. The standard errors do not hold."
        )
    return Fit(
        values=named,
        errors=dict(zip(named, errors.tolist(), strict=True)),
        covariance=covariance * np.outer(by_place, by_place),
        correlation=correlation,
        noise=noise,
        quantity=points.quantity,
        omega=points.omega,
        measured=points.values,
        computed=values,
        residual=points.values - values,
        direction=points.direction,
        is_on_branch=is_on,
        minima=minima,
        notes=tuple(notes),
        oscillator=family.model_at(named),
        law=laws if len(laws) > 1 else next(iter(laws.values()), None),
    )


def _covariance(slopes: Array) -> Array:
    """Covariance of places from slopes of residuals over the noise.

    Infinite for places that the points do not determine.
    """
    p = slopes.shape[1]
    _, sizes, rows = np.linalg.svd(slopes, full_matrices=True)
    sizes = np.concatenate([sizes, np.zeros(p - len(sizes))])
    is_known = sizes > 1e-6  # a place known to 1e6 ranges is unknown
    part = rows[is_known] / sizes[is_known, None]
    covariance: Array = part.T @ part
    lost = np.flatnonzero((np.abs(rows[~is_known]) > 1e-6).any(axis=0))
    covariance[lost, lost] = np.inf
    return covariance


def _distinct(
    points: _Points, several: list[Any], is_known: NDArray[np.bool_]
) -> tuple[dict[str, float], ...]:
    """Minima that differ in a parameter that is known, with their misfit."""
    kept: list[Any] = []
    for each in several:
        if all(np.abs(each[1] - other[1])[is_known].max(initial=0.0) > ALIKE for other in kept):
            kept.append(each)
    names = points.machine.family.names
    return tuple(
        dict(zip(names, points.parameters(place[None, :])[0].tolist(), strict=True))
        | {"misfit": cost}
        for cost, place, *_ in kept
    )


def _notes(
    points: _Points,
    place: Array,
    errors: Array,
    correlation: Array,
    minima: tuple[dict[str, float], ...],
) -> list[str]:
    """Sentences on parameters that are not determined, correlated, or at an end of their range."""
    notes, names = [], points.machine.family.names
    for name, at, error, window in zip(names, place, errors, points.windows, strict=True):
        if at - COVERS * error <= 0.0 and at + COVERS * error >= 1.0:
            notes.append(
                f"{name} cannot be identified: its interval covers the whole range "
                f"{window.low:g}..{window.high:g}."
            )
        elif min(at, 1.0 - at) < 1e-3:
            notes.append(
                f"{name} is at an end of its range {window.low:g}..{window.high:g}; widen it."
            )
    for i in range(len(names)):
        for j in range(i):
            if abs(correlation[i, j]) > CLOSE_TO_1:
                notes.append(
                    f"{names[j]} and {names[i]} cannot be distinguished: their correlation is "
                    f"{correlation[i, j]:.4f}."
                )
    best = max(minima[0]["misfit"], 1e-300)
    for other in minima[1:]:
        values = ", ".join(f"{name} = {other[name]:.4g}" for name in names)
        ratio = f"{other['misfit'] / best:.3g} times the mean square"
        notes.append(f"Another minimum: {values}, with {ratio}.")
    return notes
