"""The function `gradient`: derivatives of steady quantities by parameters."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import DEFAULT_ENGINE, TIME_LIMIT, Models, Solver, within
from gapsweep.integrate.simulate import AnyLaw, AnyModel, Several, cases, inputs_of
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.model.oscillator import Oscillator, called_as, is_number
from gapsweep.model.parameters import Parameter
from gapsweep.model.system import System
from gapsweep.response.orbit_gradients import Cases, Orbits
from gapsweep.response.respond import check_steady, respond_models
from gapsweep.response.result import ResponseClass, Responses, Steady
from gapsweep.variables import Variable, dataset, objects

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

QUANTITY, PARAMETER = "quantity", "parameter"
_RTOL = 1e-12  # of the orbits that are differentiated, unless that of the call is smaller
_STEADY = Steady()
VARIABLES = {
    "gradient": Variable(
        "f8", "", "derivative of a quantity with respect to a parameter", dims=(QUANTITY, PARAMETER)
    ),
    "value": Variable("f8", "", "value of a quantity", dims=(QUANTITY,)),
}


@called_as('gs.gradient(oscillator, law, ["gap", "K_c"], omega=9.0), in Hz')
def gradient(
    oscillator: Several[AnyModel] | Callable[..., AnyModel],
    law: Several[AnyLaw],
    parameters: str | Sequence[str],
    omega: ArrayLike | None = None,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
    *,
    q_0: ArrayLike = 0.0,
    z_0: ArrayLike = 0.0,
    values: Mapping[str, float] | None = None,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    steady: Steady | None = None,
    time_limit: float = TIME_LIMIT,
) -> xr.Dataset:
    """Return derivatives of the quantities of periodic responses with respect to parameters.

    The parameter columns of the motion are integrated with it through its contacts; no derivative
    is a difference of two motions. Contacts must be located (`gapsweep.Piecewise`,
    `gapsweep.HuntCrossley`, `gapsweep.Rigid`).

    Parameters
    ----------
    oscillator, law, omega, x_0, v_0, q_0, z_0, engine, rtol, atol, steady, time_limit
        As in `gapsweep.respond`. `oscillator` may also be a function that returns a model.
    parameters : str or sequence of str
        ``"omega"`` [Hz]; a number of the oscillator; ``"K_c"`` or another number of the contact
        law, ``"j_1"``, ``"j_2"``, or ``"gap"`` for both walls; of one contact of a system
        ``"K_c[NAME]"``; ``"forcing"`` of a system, as a factor of all its loads; an argument of the
        function.
    values : mapping of str to float, optional
        Arguments of the function.

    Returns
    -------
    Dataset
        ``gradient`` over `quantity` and `parameter` and ``value`` over `quantity`, in SI units per
        SI unit of the parameter (Hz of frequencies), with the dimensions of
        ``respond(...).to_dataset()`` first. Quantities are ``x_max``, ``x_min``, ``amplitude``,
        ``force_max``, ``contact_share``, the last section point (``x_end``, ``v_end``) and, if
        unforced, ``period``; those of a system have names as ``x_max[q_1]``. ``graze`` is the
        distance [m] beyond the wall of the turning point nearest to a wall, negative before it:
        derivatives hold up to the graze, and on its other side they differ. NaN for responses that
        are not periodic; derivatives also where impacts of several contacts accumulate at one time.

    Raises
    ------
    ModelError
        If an argument is out of range, if no response is periodic, or if the contacts are not
        located.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> found = gs.gradient(gs.systems.paper_oscillator(), law, ["gap", "K_c"], omega=9.0)
    >>> found["gradient"].sel(quantity="x_max", parameter="gap").item() > 0.0
    True
    """
    known = parameters_of(parameters, oscillator, values or {})
    if engine != DEFAULT_ENGINE:
        raise ModelError(f"engine = {engine!r}: gradients need engine = {DEFAULT_ENGINE!r}")
    model: Any = oscillator
    if known[0].function is not None:
        model = known[0].function(**known[0].arguments)
        for name in (values or {}).keys() - known[0].arguments.keys():
            has = ", ".join(known[0].arguments)
            raise ModelError(f"values: {name!r}: no argument of the function, which has {has}")
    elif values is not None:
        raise ModelError(f"values = {values!r}: are arguments of a function as oscillator")
    solver, steady = Solver.of(engine, rtol, atol), _STEADY if steady is None else steady
    check_steady(steady)
    models, start, shape = cases(model, law, omega, x_0, v_0, q_0, z_0)
    several = np.broadcast_to(objects(model), shape).ravel().tolist()
    every = Cases(several, [models.laws[k] for k in models.law.tolist()], models.omega, known)
    warn_of(doubts(objects(model).ravel().tolist(), models.laws, models.omega, start))
    with within(time_limit):
        found = respond_models(models, solver, start, steady)
        arrays, labels = _gradients(every, found, solver)
    inputs = inputs_of(model, law, models, start, shape) | {
        "engine": solver.engine, "rtol": solver.rtol, "atol": solver.atol
    }  # fmt: skip
    return dataset(
        inputs,
        shape,
        VARIABLES,
        arrays,
        {QUANTITY: labels, PARAMETER: [each.name for each in known]},
    )


def parameters_of(
    names: str | Sequence[str], model: Any, values: Mapping[str, float]
) -> tuple[Parameter, ...]:
    """Return the parameters of these names, of a model or a function with argument values.

    Raises
    ------
    ModelError
        If `names` are no names.
    """
    names = (names,) if isinstance(names, str) else names
    is_list = isinstance(names, Collection) and len(names) > 0
    if not (is_list and all(isinstance(name, str) for name in names)):
        raise ModelError(f'parameters = {names!r}: must be names, as ["gap", "K_c"]')
    if len({*names}) < len(names):
        raise ModelError(f"parameters = {names!r}: must be different names")
    if isinstance(model, Oscillator | System) or not callable(model):
        return tuple(map(Parameter, names))
    if not isinstance(values, Mapping):
        raise ModelError(f"values = {values!r:.80}: must be by name, as {{'speed': 12.0}}")
    given = {}
    for name, one in inspect.signature(model).parameters.items():
        if one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD):
            continue
        given[name] = values.get(name, one.default)
        if given[name] is one.empty:
            raise ModelError(f"{name}: has no default; write values={{{name!r}: 1.0}}")
        if name in names and not is_number(given[name]):
            raise ModelError(f"{name} = {given[name]!r:.80}: must be a number")
    return tuple(Parameter(name, model, given) for name in names)


def _gradients(
    every: Cases, found: Responses, solver: Solver
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Arrays of the dataset for all rows, and names of the quantities."""
    columns = found.columns
    periodic = np.flatnonzero(columns["response_class"] == ResponseClass.PERIODIC)
    if not periodic.size:
        said = found.row(0)
        why = f": {said.message}" if said.message else ""
        raise ModelError(
            f"oscillator, law, omega: the response is {said.response_class.name.lower()}, "
            f"gradients need a periodic one{why}"
        )
    period = columns.get("period", np.full(len(every), np.nan))  # a column of unforced systems
    here = every.take(periodic)
    multiples = columns["period_multiple"][periodic].astype(np.int64)
    part, labels = derivatives(here, found.ends[periodic], multiples, period[periodic], solver)
    arrays = {}
    for name, values in part.items():
        arrays[name] = np.full((len(every), *values.shape[1:]), np.nan)
        arrays[name][periodic] = values
    return arrays, labels


def derivatives(
    every: Cases, states: Array, multiples: NDArray[np.int64], period: Array, solver: Solver
) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return values and derivatives of periodic orbits, and names of the quantities.

    Parameters
    ----------
    every : Cases
    states : ndarray, shape (n, n_states)
        States near the orbits, as for `Orbits`.
    multiples : ndarray of int, shape (n,)
        Forcing periods of each orbit.
    period : ndarray, shape (n,)
        Periods [s] of unforced orbits.
    solver : Solver

    Returns
    -------
    arrays : dict of str to ndarray
        ``value``, shape (n, n_quantities), and ``gradient``, shape (n, n_quantities,
        n_parameters); NaN of orbits that Newton's method does not find.
    names : tuple of str

    Raises
    ------
    ModelError
        If a parameter or a law has no derivatives.
    """
    tight = solver.with_rtol(min(_RTOL, solver.rtol))
    arrays: dict[str, Array] = {}
    names: tuple[str, ...] = ()
    for rows, _ in Models.of(every.models, every.laws, every.omega).by_kind():
        about = every.take(rows), states[rows], multiples[rows], tight, period[rows]
        part = Orbits(*about).gradients()
        names = part.names
        for name in VARIABLES:
            values = getattr(part, name)
            whole = arrays.setdefault(name, np.full((len(every), *values.shape[1:]), np.nan))
            whole[rows] = values
    return arrays, names
