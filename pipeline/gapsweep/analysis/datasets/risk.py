"""Probabilities of events, quantiles and Sobol indices of responses with uncertain numbers.

`risk_of` works on responses with a dimension `sample`: those of a study with ``[uncertain]``, for
``risk.nc``, and those that `risk` computes from a model and distributions.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaincinv, ndtri, stdtrit

from gapsweep.analysis.dimensions import REPRESENTATION, of_study
from gapsweep.continuation.family import AMPLITUDE, Family
from gapsweep.design.chance import Chance
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import DEFAULT_ENGINE, Model, Models, Solver
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.arrays import numbers
from gapsweep.model.contact import ContactLaw
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.model.oscillator import Oscillator, called_as, checked
from gapsweep.model.structure import structure_of
from gapsweep.quantities import without_units
from gapsweep.response.respond import check_steady, respond_models
from gapsweep.response.result import RESPONSE, ResponseClass, Steady
from gapsweep.status import Status
from gapsweep.study.points import columns_of
from gapsweep.study.samples import MIXED, SAMPLE, Distribution, Samples, drawn
from gapsweep.study.uncertain import EventTable, UncertainTable, outside
from gapsweep.variables import CONTACT, COORDINATE, INPUTS, LAG, START, Variable

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

EVENT, QUANTITY, LEVEL, NUMBER, UNITS = "event", "quantity", "level", "number", "quantity_units"
LEVELS = (0.025, 0.05, 0.25, 0.5, 0.75, 0.95, 0.975)  # of quantiles
_PART = 4096  # responses computed in one call
_AT_ONCE = 2**22  # values of a variable in memory
_CELLS = (..., None, None, None)
STATE = re.compile(r"[xqvz]_0(\[\d+\])?")  # names of initial states
_FAR = 2.5  # median over twice the standard deviation, of a distribution that is no deviation
_OUTER = 0.975  # share up to the upper end of a 95 % interval
# Variables of `risk.nc`, over the dimensions of a sweep point without `sample`, and `dims`.
RISK = {
    "probability": Variable("f8", "1", "probability of the event", dims=(EVENT,)),
    "low": Variable("f8", "1", "lower end of the probability's 95 % interval", dims=(EVENT,)),
    "high": Variable("f8", "1", "upper end of the probability's 95 % interval", dims=(EVENT,)),
    "n_undecided": Variable(
        "f8",
        "1",
        "samples that failed or are unresolved: no event in low, one in high",
        dims=(EVENT,),
    ),
    "quantile": Variable("f8", "", "quantile of the quantity", dims=(QUANTITY, LEVEL)),
    "quantile_low": Variable(
        "f8", "", "lower end of the quantile's 95 % interval", dims=(QUANTITY, LEVEL)
    ),
    "quantile_high": Variable(
        "f8", "", "upper end of the quantile's 95 % interval", dims=(QUANTITY, LEVEL)
    ),
}
_OF_NUMBERS = {
    "first_order": "first Sobol index: share of the variance by the number, no interactions",
    "first_order_error": "half-width of the 95 % interval of the first index",
    "total": "total Sobol index: share of the variance with the number's interactions",
    "total_error": "half-width of the 95 % interval of the total index",
}
_PREFIXES = (("", EVENT), ("quantity_", QUANTITY))
# Those of a study or call that asks for Sobol indices: of events, and of quantities.
INDICES = {
    f"{prefix}{name}": Variable("f8", "1", text, dims=(dim, NUMBER))
    for prefix, dim in _PREFIXES
    for name, text in _OF_NUMBERS.items()
} | {
    f"{prefix}n_left_out": Variable(
        "f8", "1", "Sobol points left out of the indices: a sample is undecided", dims=(dim,)
    )
    for prefix, dim in _PREFIXES
}
AXES = {
    EVENT: Variable("str", "1", "event"),
    QUANTITY: Variable("str", "1", "quantity of the responses"),
    LEVEL: Variable("f8", "1", "share of the samples below the quantile"),
    NUMBER: Variable("str", "1", "uncertain number"),
}


def risk_of(responses: xr.Dataset, table: UncertainTable) -> xr.Dataset:
    """Return probabilities, quantiles and Sobol indices.

    `responses`: with all samples of a study or call, and coordinates `matrix` and `repeat` over
    `sample`.
    `table`: events, quantities and uncertain numbers.
    Result: variables `RISK` and, with ``indices``, `INDICES`.
    """
    dims = [str(dim) for dim in responses["status"].dims if dim != SAMPLE]
    repeats, matrices = (int(responses[name].max()) + 1 for name in ("repeat", "matrix"))
    design = repeats, matrices, responses.sizes[SAMPLE] // (repeats * matrices)
    axes = dict(zip(AXES, _axes(table), strict=True))
    described = RISK | (INDICES if table.indices else {})
    sizes = {dim: responses.sizes[dim] for dim in dims} | {n: len(x) for n, x in axes.items()}
    found = {
        name: np.full([sizes[dim] for dim in (*dims, *one.dims)], np.nan)
        for name, one in described.items()
    }
    for at, here in _pieces(responses, dims):
        read = _Reader(here, design)
        asked = (read("status") != Status.NOT_REQUESTED).all(axis=(-3, -2, -1))
        for name, values in _measures(read, table).items():
            within = (...,) + (None,) * (values.ndim - asked.ndim)
            found[name][at] = np.where(asked[within], values, np.nan)
    data = {
        name: ((*dims, *one.dims), found[name], one.attributes) for name, one in described.items()
    }
    inherited = {
        name: coordinate
        for name, coordinate in responses.coords.items()
        if {*coordinate.dims} <= {*dims}
    }
    own: dict[str, Any] = {name: (name, axes[name], one.attributes) for name, one in AXES.items()}
    of = [responses[name.partition("[")[0]].attrs.get("units", "") for name in axes[QUANTITY]]
    own[UNITS] = (QUANTITY, np.array(of, str), {"long_name": "unit of the quantity"})
    made = xr.Dataset(data, inherited | own, of_study(responses))
    return made.assign_attrs(n_samples=repeats * min(matrices, MIXED) * design[-1], repeats=repeats)


def _axes(table: UncertainTable) -> tuple[list[Any], ...]:
    """Values of the coordinates of `risk.nc`, in the order of `AXES`."""
    names = [event.name for event in table.event]
    return names, [*table.all_quantities], [*LEVELS], [*table.names]


def _pieces(
    responses: xr.Dataset, dims: Sequence[str]
) -> Iterator[tuple[tuple[Any, ...], xr.Dataset]]:
    """Yield parts of responses with all samples, and their places along all other dimensions."""
    *outer, inner, last = (responses.sizes[dim] for dim in dims)
    step = max(1, _AT_ONCE // (responses.sizes[SAMPLE] * last))
    for place in np.ndindex(*outer):
        for first in range(0, inner, step):
            at = (*place, slice(first, first + step))
            chosen = dict(zip(dims, at, strict=False))
            yield at, responses.isel(chosen).transpose(*dims[len(place) :], SAMPLE, ...)


class _Reader:
    """Variables of responses as arrays (cells, cells, repeats, matrices, rows)."""

    def __init__(self, responses: xr.Dataset, design: tuple[int, int, int]) -> None:
        self._responses, self._design = responses, design
        self._kept: dict[str, NDArray[Any]] = {}

    def __call__(self, name: str) -> NDArray[Any]:
        """Return a variable, of systems one entry of it as ``x_max[h]``."""
        if name not in self._kept:
            base, _, part = name.rstrip("]").partition("[")
            values = self._responses[base]
            for dim in {COORDINATE, CONTACT, LAG} & {*values.dims} if part else ():
                values = values.sel({dim: part})
            self._kept[name] = values.values.reshape(*values.shape[:2], *self._design)
        return self._kept[name]


def _measures(read: _Reader, table: UncertainTable) -> dict[str, Array]:
    """Return the values of all variables in a part of the responses."""
    found: dict[str, list[Array]] = {}
    failed = read("response_class") == ResponseClass.FAILED
    vague = failed | (read("response_class") == ResponseClass.UNRESOLVED)
    for event in table.event:
        happens, unknown = _happens(event, read, failed, vague)
        measures = _probability(happens, unknown)
        if table.indices:
            measures |= _indices(happens.astype(float), unknown)
        for name, value in measures.items():
            found.setdefault(name, []).append(value)
    for quantity in table.all_quantities:
        values = read(quantity).astype(float)
        unknown = vague | np.isnan(values)
        measures = _quantiles(values, unknown)
        if table.indices:
            indices = _indices(values, unknown)
            measures |= {f"quantity_{name}": value for name, value in indices.items()}
        for name, value in measures.items():
            found.setdefault(name, []).append(value)
    return {name: np.stack(several, axis=2) for name, several in found.items()}


def _happens(event: EventTable, read: _Reader, failed: Bools, vague: Bools) -> tuple[Bools, Bools]:
    """Return in which samples an event happens, and in which this is not known."""
    if event.quantity is None:
        number = ResponseClass[str(event.response_class).upper()]
        is_open = number in (ResponseClass.FAILED, ResponseClass.UNRESOLVED)
        unknown = failed & (number != ResponseClass.FAILED) if is_open else vague
        return read("response_class") == number, unknown
    values = read(event.quantity)
    happens = np.ones(values.shape, bool)
    if event.above is not None:
        happens &= values > event.above
    if event.below is not None:
        happens &= values < event.below
    return happens, vague | np.isnan(values)


def _probability(happens: Bools, unknown: Bools) -> dict[str, Array]:
    """Return the probability of an event, its interval, and the number of undecided samples."""
    some, is_open = happens[..., :MIXED, :], unknown[..., :MIXED, :]
    n_known = (~is_open).sum(axis=(-3, -2, -1))
    n_surely = (some & ~is_open).sum(axis=(-3, -2, -1))
    return {
        "probability": n_surely / np.where(n_known, n_known, np.nan),
        "low": _end(some & ~is_open, -1),
        "high": _end(some | is_open, 1),
        "n_undecided": is_open.sum(axis=(-3, -2, -1)).astype(float),
    }


def _end(happens: Bools, sign: int) -> Array:
    """Return the lower (-1) or upper (1) end of the 95 % interval of a probability.

    Student's interval of the shares of the repeats; if all are equal, the one of Clopper & Pearson
    (1934) for independent samples.
    """
    repeats, n = happens.shape[-3], int(np.prod(happens.shape[-3:]))
    shares, count = happens.mean(axis=(-2, -1)), happens.sum(axis=(-3, -2, -1))
    spread = shares.std(axis=-1, ddof=1)
    end = shares.mean(axis=-1) + sign * stdtrit(repeats - 1, _OUTER) * spread / np.sqrt(repeats)
    a, b = (count + 1, n - count) if sign > 0 else (count, n - count + 1)
    share = _OUTER if sign > 0 else 1.0 - _OUTER
    exact = betaincinv(np.maximum(a, 1), np.maximum(b, 1), share)
    exact = np.where((a == 0) | (b == 0), float(sign > 0), exact)
    return np.asarray(np.clip(np.where(spread > 0.0, end, exact), 0.0, 1.0))


def _quantiles(values: Array, unknown: Bools) -> dict[str, Array]:
    """Return the quantiles of a quantity at `LEVELS`, and their intervals.

    The ends of an interval are quantiles at levels of which the binomial standard deviation differs
    by 1.96: they hold for any distribution. Undecided samples count as -inf in the lower end, as
    +inf in the upper.
    """
    cells = values.shape[:2]
    flat = values[..., :MIXED, :].reshape(*cells, -1)
    is_open = unknown[..., :MIXED, :].reshape(*cells, -1)
    n, levels = flat.shape[-1], np.array(LEVELS)
    half = ndtri(_OUTER) * np.sqrt(levels * (1.0 - levels) / n)
    n_known = (~is_open).sum(axis=-1, keepdims=True)
    low, high = (np.sort(np.where(is_open, end, flat)) for end in (-np.inf, np.inf))
    return {  # the known values are the first ones of `high`
        "quantile": np.where(n_known, _at_share(high, levels, n_known), np.nan),
        "quantile_low": _at_share(low, levels - half, n),
        "quantile_high": _at_share(high, levels + half, n),
    }


def _at_share(ordered: Array, levels: Array, n: Any) -> Array:
    """Return the values of ordered ones up to which shares of the first n lie."""
    places = np.clip(np.ceil(levels * n).astype(int) - 1, 0, np.maximum(n, 1) - 1)
    places = np.broadcast_to(places, (*ordered.shape[:-1], len(levels)))
    return np.take_along_axis(ordered, places, axis=-1)


def _indices(values: Array, unknown: Bools) -> dict[str, Array]:
    """Return first and total Sobol indices with the half-widths of their 95 % intervals.

    First indices by the estimator of Saltelli et al. (2010), total ones by that of Jansen (1999).
    Rows with an undecided sample are left out.
    """
    known = ~unknown.any(axis=-2, keepdims=True)
    n_known = known.sum(axis=-1).astype(float)  # (cells, repeats, 1)
    n_all = n_known.sum(axis=-2)
    matrices, repeats = values.shape[-2], values.shape[-3]
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.where(known, values, 0.0)
        f = np.where(
            known, f - (f.sum(axis=(-3, -2, -1)) / (n_all[..., 0] * matrices))[_CELLS], 0.0
        )
        a, b, mixed = f[..., :1, :], f[..., 1:MIXED, :], f[..., MIXED:, :]
        of_ab = f[..., :MIXED, :]
        mean = of_ab.sum(axis=(-3, -2, -1)) / (2.0 * n_all[..., 0])
        variance = (of_ab**2).sum(axis=(-3, -2, -1)) / (2.0 * n_all[..., 0]) - mean**2
        variance = np.where(variance > 0.0, variance, np.nan)[..., None]
        found = {"n_left_out": (~known).sum(axis=(-3, -2, -1)).astype(float)}
        for name, sums in (
            ("first_order", (b * (mixed - a)).sum(axis=-1)),
            ("total", 0.5 * ((a - mixed) ** 2).sum(axis=-1)),
        ):
            each = sums / n_known / variance[..., None]
            half = stdtrit(repeats - 1, _OUTER) * each.std(axis=-2, ddof=1) / np.sqrt(repeats)
            found |= {name: sums.sum(axis=-2) / n_all / variance, f"{name}_error": half}
    return found


def safety(risk: xr.Dataset, along: str, event: str, limit: float) -> xr.Dataset:
    """Return the largest probability of an event over frequencies and starts, and its judgement.

    Parameters
    ----------
    risk : Dataset
        As `risk_of` returns it.
    along : str
        Designed parameter.
    limit : float
        Probability that the event may have.

    Returns
    -------
    Dataset
        `probability`, `low` and `high` over `along` and the other dimensions of a case, and
        `safe`: 1 if the whole interval is within the limit, -1 if it is above, 0 if undecided.
    """
    shown = risk[["probability", "low", "high"]].sel({EVENT: event}, drop=True)
    worst = shown.max([dim for dim in ("omega", START) if dim in shown.dims and dim != along])
    is_safe, is_not = worst["high"] <= limit, worst["low"] > limit
    return worst.assign(safe=is_safe.astype("i1") - is_not.astype("i1"))


def risk(
    oscillator: Model | Callable[..., Model],
    law: AnyLaw | None,
    uncertain: Mapping[str, Distribution],
    omega: ArrayLike | None = None,
    x_0: float = 0.0,
    v_0: ArrayLike = 0.0,
    *,
    q_0: ArrayLike = 0.0,
    z_0: ArrayLike = 0.0,
    events: Mapping[str, Mapping[str, Any]] | None = None,
    quantities: Sequence[str] = (),
    samples: int = 1024,
    repeats: int = 8,
    seed: int = 1,
    indices: bool = False,
    correlation: ArrayLike | None = None,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    steady: Steady | None = None,
) -> xr.Dataset:
    """Return the risk of a model with uncertain numbers; `gapsweep.risk` has the description."""
    steady, solver = Steady() if steady is None else steady, Solver.of(engine, rtol, atol)
    check_steady(steady)
    settings: dict[str, Any] = {"samples": samples, "repeats": repeats, "seed": seed}
    listed = list(quantities) if isinstance(quantities, tuple) else quantities
    settings |= {"indices": indices, "quantities": listed}
    if correlation is not None:
        settings["correlation"] = np.asarray(correlation).tolist()
    table = UncertainTable.of_call(_checked(uncertain), events or {}, settings)
    found = drawn(uncertain, samples, repeats, seed, indices=indices, correlation=table.correlation)
    rates: list[float] = [0.0]
    if omega is not None:
        given = np.ravel(numbers("omega", omega, "frequencies in Hz")).tolist()
        rates = [checked("omega", rate, low=0.0, strict=True) for rate in given]
        if not rates:
            raise ModelError("omega = []: must be at least one frequency, as omega=9.0, in Hz")
    first = None if omega is None else rates[0]
    of_model = [name for name in uncertain if not STATE.fullmatch(name)]
    at_first = {name: float(found.numbers[name][0]) for name in of_model}
    family = Family(oscillator, {} if law is None else law, first, tuple(of_model), at_first)
    model = family.example
    structure = structure_of(model)
    problems = [
        outside(name, "distribution", of, None, 0.0, structure.in_metres)
        for name, of in uncertain.items()
    ]
    problems = [*filter(None, problems), *table.wrong_quantities(structure, model.parts)]
    if problems:
        raise ModelError("; ".join(problems))
    names = columns_of(structure)[-structure.n_states :]
    start = np.tile(_state(model, x_0, v_0, q_0, z_0), (len(found), 1))
    for name in uncertain.keys() - {*of_model}:
        if name not in names:
            raise ModelError(f"{name}: must be an initial state: {', '.join(names)}")
        start[:, names.index(name)] = found.numbers[name]
    warn_of(doubts([model], [family.laws_at(family.values)], np.array(rates), start[:1]))
    bases = {one.partition("[")[0] for one in table.all_quantities}
    wanted = ["status", "response_class", *sorted(bases)]
    values = _columns(family, found, start, rates, (solver, steady), wanted)
    of = _dataset(values, found, rates, model)
    made = risk_of(of, table).isel({START: 0} if first else {START: 0, "omega": 0}, drop=True)
    if isinstance(law, ContactLaw):  # plots have the style of its family
        return made.assign_coords({REPRESENTATION: law.family})
    return made


@called_as("gs.probability({'quantity': 'amplitude', 'above': 5e-4}, 0.01, "
           "{'forcing': scipy.stats.norm(2.0, 0.1)})")  # fmt: skip
def probability(
    event: Mapping[str, Any],
    at_most: float,
    uncertain: Mapping[str, Distribution],
    *,
    samples: int = 128,
    repeats: int = 8,
    seed: int = 1,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
    q_0: ArrayLike = 0.0,
    z_0: ArrayLike = 0.0,
) -> Chance:
    """Return the demand that an event has at most some probability, for `gapsweep.choose`.

    Parameters
    ----------
    event : mapping
        As in `gapsweep.risk`: ``{"quantity": "amplitude", "above": 1e-3}``, or
        ``{"response_class": "chaotic"}``.
    at_most : float
        Largest probability, between 0 and 1.
    uncertain : mapping of str to distribution
        As in `gapsweep.risk`; that of the parameter which is chosen is of the deviation from its
        value, as ``{"gap": scipy.stats.norm(0.0, 2e-5)}``; so are those of ``"j_1"`` and ``"j_2"``
        if ``"gap"`` is chosen.
    samples, repeats, seed : int
        As in `gapsweep.risk`. All values of the parameter have the same samples.
    x_0, v_0, q_0, z_0 : float or array_like
        Initial state where it is certain, as in `gapsweep.respond`.

    Raises
    ------
    ModelError
        If an argument is invalid.

    Examples
    --------
    >>> import gapsweep as gs, scipy.stats
    >>> event = {"quantity": "amplitude", "above": 1e-3}
    >>> gs.probability(event, 0.01, {"forcing": scipy.stats.norm(2.0, 0.1)})
    <gapsweep.Chance: P(amplitude above 0.001) at most 0.01>
    """
    limit = checked("at_most", without_units("at_most", at_most, "1"), low=0.0, strict=True)
    if not limit < 1.0:
        raise ModelError(f"at_most = {limit:g}: must be < 1")
    settings = {"samples": samples, "repeats": repeats, "seed": seed}
    initial = {"x_0": x_0, "v_0": v_0, "q_0": q_0, "z_0": z_0}
    table = UncertainTable.of_call(_checked(uncertain), {"event": event}, settings)
    (one,) = table.event
    ends = {"above": one.above, "below": one.below}
    words = " and ".join(f"{name} {end:g}" for name, end in ends.items() if end is not None)
    words = f"{one.quantity} {words}" if one.quantity else str(one.response_class)

    def of(model: Any, laws: Any, omega: Any, name: str, value: float) -> Array:
        """Probabilities and their intervals, over the frequencies, at a value of the parameter."""
        if "gap" in uncertain and name in ("j_1", "j_2"):
            raise ModelError("uncertain: 'gap' sets both walls; write 'j_1' or 'j_2'")
        walls = {"gap", "j_1", "j_2"} if name == "gap" else {name}
        here = {n: _shifted(n, one, value) if n in walls else one for n, one in uncertain.items()}
        about: dict[str, Any] = {"events": {"event": event}, **settings, **initial}
        found = risk(model, laws, here, omega, **about)
        return np.array([np.ravel(found[each].values) for each in ("probability", "low", "high")])

    return Chance(f"P({words}) at most {limit:g}", limit, of)


@dataclass(frozen=True, slots=True)
class _Shifted:
    """A distribution of deviations from a value."""

    of: Distribution
    value: float

    def ppf(self, q: Any) -> Any:
        return self.value + self.of.ppf(q)

    def cdf(self, x: Any) -> Any:
        return self.of.cdf(x - self.value)


def _shifted(name: str, of: Distribution, value: float) -> _Shifted:
    """Return a distribution around a value; a ModelError for one that is of no deviation."""
    low, middle, high = (float(of.ppf(share)) for share in (0.16, 0.5, 0.84))
    if abs(middle) > _FAR * (high - low):
        raise ModelError(
            f"uncertain: {name} has the median {middle:g}: must be the deviation from the chosen "
            f"{name}, as scipy.stats.norm(0, {0.5 * (high - low):.3g})"
        )
    return _Shifted(of, value)


def _checked(uncertain: Any) -> Mapping[str, Distribution]:
    """Return distributions by name; a ModelError for anything else."""
    given = uncertain if isinstance(uncertain, Mapping) else {"uncertain": uncertain}
    if "omega" in given:
        raise ModelError("omega: cannot be uncertain; pass several frequencies, as omega=[8.8, 9]")
    if AMPLITUDE in given:
        raise ModelError("amplitude: cannot be uncertain, it is a result; name a parameter")
    for name, one in given.items():
        if not (hasattr(one, "ppf") and hasattr(one, "cdf")):
            example = "{'gap': scipy.stats.norm(4e-4, 2e-5)}"
            raise ModelError(f"{name} = {one!r:.80}: must be a distribution, as {example}")
        with np.errstate(all="ignore"):
            middle = one.ppf(0.5)
        if not np.isfinite(middle):
            raise ModelError(f"{name}: the distribution has no median; its scale must be > 0")
    return given


def _state(model: Any, x_0: ArrayLike, v_0: ArrayLike, q_0: ArrayLike, z_0: ArrayLike) -> Array:
    """Return the nominal initial state of a model, shape (n_states,)."""
    is_oscillator, found = isinstance(model, Oscillator), []
    displacement = ("x_0", x_0) if is_oscillator else ("q_0", q_0)
    parts = [(*displacement, model.n), ("v_0", v_0, model.n), ("z_0", z_0, model.n_lags)]
    for name, value, size in parts:
        given = np.ravel(numbers(name, value, "finite numbers"))
        if given.size not in (1, size) or not np.isfinite(given).all():
            raise ModelError(f"{name} = {value!r:.80}: must be {size} finite numbers")
        found.append(np.broadcast_to(given, max(size, given.size))[:size])
    return np.concatenate(found)


def _columns(
    family: Family,
    samples: Samples,
    start: Array,
    rates: list[float],
    settings: tuple[Solver, Steady],
    wanted: list[str],
) -> dict[str, NDArray[Any]]:
    """Return columns of the responses of all samples at all frequencies, shape (omega, n, ...).

    Only the models of one part of the samples are in memory at a time.
    """
    solver, steady = settings
    found: list[list[Mapping[str, NDArray[Any]]]] = [[] for _ in rates]
    for first in range(0, len(samples), _PART):
        some = samples.take(slice(first, first + _PART))
        columns = [some.numbers[name].tolist() for name in family.names]
        every = zip(*columns, strict=True) if columns else [()] * len(some)
        rows = [dict(zip(family.names, row, strict=True)) for row in every]
        models, laws = [family.model_at(row) for row in rows], [family.laws_at(row) for row in rows]
        for parts, rate in zip(found, rates, strict=True):
            of = Models.of(models, laws, np.full(len(some), rate))
            answer = respond_models(of, solver, start[first : first + _PART], steady)
            parts.append({name: answer.columns[name] for name in wanted})
    return {
        name: np.stack([np.concatenate([part[name] for part in parts]) for parts in found])
        for name in wanted
    }


def _dataset(
    columns: dict[str, NDArray[Any]],
    samples: Samples,
    rates: list[float],
    model: Any,
) -> xr.Dataset:
    """Return the responses of a call as a dataset of a study."""
    data = {}
    for name, values in columns.items():
        within = [dim for dim in RESPONSE[name].dims if dim in model.parts][: values.ndim - 2]
        about = RESPONSE[name].in_units(model.part_units)
        data[name] = (("omega", SAMPLE, START, *within), values[:, :, None], about.attributes)
    coords: dict[str, Any] = {name: [*labels] for name, labels in model.parts.items()}
    coords |= {name: (SAMPLE, getattr(samples, name)) for name in ("matrix", "repeat")}
    coords["omega"] = ("omega", rates, INPUTS["omega"].attributes)
    return xr.Dataset(data, coords)
