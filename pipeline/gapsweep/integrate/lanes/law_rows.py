"""Rows of a contact law's numbers, and copies of its formulas for another kind of number."""

import builtins
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from inspect import signature
from types import BuiltinFunctionType, CellType, FunctionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.problem import low_bounce
from gapsweep.model.contact import ContactLaw

from . import parameters
from .parameters import N_PARAMETERS, OWN, STIFFNESS
from .row_layout import RowLayout, known
from .scene_table import SceneTable

Array = NDArray[np.float64]

# Rows of the arguments that are numbers of every law.
_ROWS = {
    "stiffness": STIFFNESS,
    "low": parameters.WALL_LOW,
    "high": parameters.WALL_HIGH,
    "ratio": parameters.RATIO,
    "layer": parameters.LAYER,
    "saturation": parameters.SATURATION,
    "fit_range": parameters.RANGE,
}

_LOW_FLIGHT = 1e-13  # of the largest displacement: height of flights from rigid walls, see `low`

# Arguments that are series of a fit: fields of the compiled law.
SERIES = ("numerator", "denominator")


def rows_of_law(law: type[ContactLaw]) -> dict[str, int]:
    """Return the rows of the arguments of a law's formulas: own numbers from row `OWN` on."""
    several = filter(None, law.formulas)
    names = dict.fromkeys(name for each in several for name in arguments(each))
    own = [name for name in names if name not in _ROWS and name not in SERIES]
    free = parameters.LAYER - OWN
    assert len(own) <= free, f"{law.family}: {own}: a law has at most {free} own numbers"
    return _ROWS | {name: OWN + i for i, name in enumerate(own)}


@cache
def arguments(formula: Callable[..., Any]) -> tuple[str, ...]:
    """Names of a formula's arguments after the displacement."""
    return tuple(signature(formula).parameters)[1:]


def with_callees(function: Any, done: dict[Any, Any], compiled: Callable[..., Any]) -> Any:
    """Compile a function, and the plain Python functions that it calls by name.

    Parameters
    ----------
    function : callable
        Returned as it is if it is neither in `done` nor a plain function.
    done : dict
        Compiled functions by function, which take their place; new ones are added.
    compiled : callable
        Compiles one function, as ``numba.njit``.
    """
    if isinstance(function, BuiltinFunctionType):
        return done.get(function, function)
    if not isinstance(function, FunctionType):
        return function
    if function not in done:
        names, code = {**vars(builtins), **function.__globals__}, function.__code__
        cells = [CellType(cell.cell_contents) for cell in function.__closure__ or ()]
        defaults = function.__defaults__
        copy = FunctionType(code, names, function.__name__, defaults, tuple(cells))
        done[function] = compiled(copy)  # before its callees: it may call itself
        for name in names.keys() & {*code.co_names}:
            names[name] = with_callees(names[name], done, compiled)
        for cell in cells:
            cell.cell_contents = with_callees(cell.cell_contents, done, compiled)
    return done[function]


def with_law_rows(exact: SceneTable, at: RowLayout, laws: Sequence[Array]) -> SceneTable:
    """Return a table of the same systems with a law at every contact.

    Parameters
    ----------
    exact : SceneTable
        n systems, for located contacts.
    at : RowLayout
        It has all blocks of the layout of `exact`.
    laws : sequence of ndarray, shape (n, N_PARAMETERS)
        Parameter rows of the law of every contact.
    """
    found = _moved(exact, at)
    for i, rows in enumerate(laws):
        first = found.at.law + i * N_PARAMETERS
        found.table[:-1, first : first + N_PARAMETERS] = rows
        found.table[-1, first : first + N_PARAMETERS] = rows[0]
        found.table[-1, first + STIFFNESS] = 0.0  # the idle point stays at rest
    return found


def with_losses(
    elastic: SceneTable,
    damping: Array,
    never_pulls: NDArray[np.bool_],
    chi: Array,
    is_rigid: NDArray[np.bool_],
    impacts: tuple[Array, Array],
    preload: Array,
    *,
    is_damped: bool,
    rtol: float,
) -> SceneTable:
    """Return a table of the same systems with contacts that lose energy.

    Parameters
    ----------
    elastic : SceneTable
        n systems, for located contacts.
    damping : ndarray, shape (n, n_contacts)
        Damping of both walls, of an oscillator per unit mass.
    never_pulls : ndarray of bool, shape (n, n_contacts)
        Contacts with the mode `contact_modes.SLACK`.
    chi : ndarray, shape (n, n_contacts)
        `Losses.chi` [s/m].
    is_rigid : ndarray of bool, shape (n, n_contacts)
        Contacts with rigid walls.
    impacts : tuple of ndarray, shape (n, n_contacts)
        Restitution, and `Losses.of_impact`.
    preload : ndarray, shape (n, n_contacts)
        Preload, of an oscillator per unit mass.
    is_damped : bool
        Whether forces of contacts are not those of elastic springs.
    rtol : float
        Relative tolerance.
    """
    has_slack, has_chi = bool(never_pulls.any()), bool(chi.any())
    has_preload = bool(preload.any())
    has_impacts = has_preload or bool(is_rigid.any())
    at = replace(
        elastic.at,
        is_damped=is_damped,
        has_slack=has_slack,
        has_chi=has_chi,
        has_impacts=has_impacts,
        has_preload=has_preload,
    )
    found = _moved(elastic, at)
    at, table = found.at, found.table[:-1]
    if is_damped:
        table[:, at.contact_damping : at.contact_damping + at.contacts] = damping
    if has_impacts:
        table[:, at.rate] = np.maximum(table[:, at.rate], table[:, at.omega_rad])
        low = np.where(preload > 0.0, low_bounce(rtol), _LOW_FLIGHT * is_rigid)
        for first, values in zip(
            (at.rigid, at.restitution, at.of_impact, at.low),
            (is_rigid, *impacts, low),
            strict=True,
        ):
            table[:, first : first + at.contacts] = values
    if has_preload:
        table[:, at.preload : at.preload + at.contacts] = preload
        for side, wall, rest, stiffness in (
            (-1.0, at.lower, at.lower_rest, at.lower_stiffness),
            (1.0, at.upper, at.upper_rest, at.upper_stiffness),
        ):
            k = table[:, stiffness : stiffness + at.contacts]
            shift = np.divide(preload, k, out=np.zeros_like(k), where=k > 0.0)
            place = table[:, wall : wall + at.contacts] - side * shift
            table[:, rest : rest + at.contacts] = place
    if has_chi:
        table[:, at.chi : at.chi + at.contacts] = chi
    if has_slack:
        of_slack = np.where(never_pulls, damping, 0.0)
        table[:, at.slack_damping : at.slack_damping + at.contacts] = of_slack
    return found


def _moved(table: SceneTable, at: RowLayout) -> SceneTable:
    """Copy a table into a layout that has all of its blocks."""
    at = known(at)
    rows = np.zeros((len(table.table), at.n_rows))
    rows[:, _places(table.at, at)] = table.table
    return replace(table, at=at, table=rows)


@cache
def _places(old: RowLayout, new: RowLayout) -> NDArray[np.intp]:
    """Return the number in a layout of every row of another one."""
    return np.concatenate([new.first[name] + np.arange(n) for name, n in old.blocks.items()])
