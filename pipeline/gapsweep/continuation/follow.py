"""`gapsweep.branches`: periodic orbits continued along a parameter."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from gapsweep.continuation import thresholds as limit
from gapsweep.continuation.branches import Branches
from gapsweep.continuation.dataset import dataset
from gapsweep.continuation.family import Family, Window
from gapsweep.continuation.identity import Identity
from gapsweep.continuation.orbits import OrbitEquations, motions
from gapsweep.continuation.seed import Attractor, started
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Model, Models, Solver
from gapsweep.integrate.simulate import AnyLaw, simulate
from gapsweep.model.arrays import numbers
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.model.oscillator import called_as, checked, whole
from gapsweep.quantities import without_units
from gapsweep.response.respond import respond_models
from gapsweep.response.result import Response, ResponseClass, Steady

Array = NDArray[np.float64]

DEFAULT_RTOL = 1e-11


@called_as("gs.branches(oscillator, law, along='omega', between=(6.0, 12.0)), in Hz")
def branches(
    oscillator: Model | Callable[..., Model],
    law: AnyLaw | None = None,
    along: str = "omega",
    between: tuple[float, float] = (1.0, 30.0),
    at: ArrayLike | None = None,
    start: Response | ArrayLike | None = None,
    *,
    omega: float | None = None,
    starts: ArrayLike | None = None,
    follow: int = 0,
    max_steps: int = 1000,
    rtol: float = DEFAULT_RTOL,
    atol: float | None = None,
) -> xr.Dataset:
    """Return branches of stable and unstable periodic orbits over a parameter.

    Parameters
    ----------
    oscillator : Oscillator, System, or callable
        Model, or a function that returns it for keywords, as ``gs.systems.typical_section``.
    law : ContactLaw or mapping of str to ContactLaw
        As in `gapsweep.simulate`; none of a System without contacts.
    along : str
        Parameter: ``"omega"`` [Hz]; ``"amplitude"`` [m] of the first coordinate in undamped free
        motions; a field of the oscillator (``"forcing"``) or the law (``"K_c"``, ``"epsilon"``,
        ``"j_1"``, ``"j_2"``, or ``"gap"`` for both walls); or a keyword of the function.
    between : tuple of float
        Range of the parameter, ascending.
    at : float or array_like, optional
        Parameter values at which branches start, within `between`; by default the value of a
        `Response`, or eight values.
    start : Response or array_like, optional
        First orbit: a periodic response, or an initial state (displacements, velocities,
        first-order states) near an orbit. By default the attractors of motions from `starts`; free
        motions are released from rest, with the first coordinate at each value of `at`.
    omega : float, optional
        Forcing frequency [Hz], if it is not the parameter.
    starts : array_like, shape (n, n_states), optional
        Initial states of motions that lead to attractors; by default rest, and the first coordinate
        displaced beyond either wall, of unforced systems by several amplitudes too.
    follow : int
        Generations of branches that bifurcate at period doublings, border flips and symmetry
        breaking, 0 to 10.
    max_steps : int
        Largest number of orbits on either side of the first orbit, 2 to 100000.
    rtol, atol : float
        Tolerances of the compiled engine [-], [m]; default of `atol` as in `gapsweep.simulate`, at
        the low end of `between`.

    Returns
    -------
    Dataset
        Dimensions `branch` and `step`; see the page *Branches* of the documentation.

    Raises
    ------
    ModelError
        If an argument is out of range, or no periodic orbit is found.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> br = gs.branches(gs.systems.paper_oscillator(), law, along="omega", between=(6.0, 12.0))
    >>> br["special"].attrs["flag_meanings"].split()[:2]
    ['none', 'fold']
    """
    window, follow = Window.of(along, between), whole("follow", follow, 0, 10)
    places = None if at is None else _inside(window, at)
    values = {along: places[0] if places else window.low}
    if omega is not None:
        if along == "omega":
            raise ModelError(f"omega = {omega!r}: leave it out, it is the parameter")
        omega = checked("omega", omega, low=0.0, strict=True)
    family = Family(oscillator, {} if law is None else law, omega, (along,), values)
    solver = solver_of(family, rtol, atol)
    ends = [{along: x} for x in (window.low, window.high)]
    models, laws = zip(*((family.model_at(end), family.laws_at(end)) for end in ends), strict=True)
    frequencies = (window.low, window.high) if along == "omega" else omega or 0.0
    warn_of(doubts(models, laws, frequencies, np.zeros((1, family.example.n_states))))
    equations = OrbitEquations(family, (window,), solver)
    found = Branches(equations=equations, max_steps=whole("max_steps", max_steps, 2, 100_000))
    if start is None and not family.is_conservative:
        at_values = np.asarray(
            places or window.value((np.arange(limit.VALUES) + 0.5) / limit.VALUES)
        )
        states = _states(equations, starts)
        every = np.repeat(at_values, len(states)), np.tile(states, (len(at_values), 1))
        found.add(settled(equations, *every))
        tried = f"states {states.tolist()} at {along} = {at_values.tolist()}"
    else:
        found.add(_attractors(equations, places, start, starts))
        tried = "free motions" if start is None else "the orbit given as start"
    if not found.found:
        name = "starts" if start is None else "start"
        raise ModelError(
            f"{name}: Newton's method finds no periodic orbit near it at {along} = "
            f"{found.attractors[0].value:g}; use a steady response, as start=gs.respond(...)"
        )
    for _ in range(follow):
        found.follow()
    tried += "; other initial conditions may lead to further branches"
    return dataset(found).assign_attrs(initial_conditions=tried)


def solver_of(family: Family, rtol: float | None, atol: float | None) -> Solver:
    """Solver of branches: one absolute tolerance for all of their orbits."""
    solver, size = Solver.of("compiled", rtol or DEFAULT_RTOL, atol), family.values.get("amplitude")
    laws, start = (
        [family.laws_at(family.values)],
        np.eye(1, family.example.n_states) * (size or 0.0),
    )
    models = Models.of([family.example], laws, np.array([family.omega or 0.0]), start)
    return replace(solver, atol=float(models.absolute(solver)[0]))


def _attractors(
    equations: OrbitEquations,
    at: list[float] | None,
    start: Response | ArrayLike | None,
    starts: ArrayLike | None,
) -> list[Attractor]:
    """Orbits that are known, or those of free motions."""
    window, n_states = equations.windows[0], equations.n_states
    is_free = equations.family.is_conservative
    if starts is not None:
        why = "start and starts: give one of them only"
        free = "starts: not for free motions; give their amplitudes as at"
        raise ModelError(why if start is not None else free)
    if start is not None and at is not None and (is_free or len(at) > 1):
        allowed = "left out" if is_free else f"one value of {window.name}"
        raise ModelError(f"at = {at!r}: must be {allowed}, since start is one orbit")
    if isinstance(start, Response):
        if np.ndim(start.period_multiple):
            raise ModelError("start: must be one response, as from gs.respond at one omega")
        if start.response_class != ResponseClass.PERIODIC:
            raise ModelError("start: must be a periodic response")
        is_alike = np.size(start.amplitude) == equations.n and not np.size(start.section) % n_states
        if not is_alike or np.isfinite(start.period) != equations.has_period:
            forced = "not forced" if equations.has_period else "forced"
            raise ModelError(
                f"start: must be a response of this model: {n_states} states, {forced}"
            )
        if equations.family.is_forced:
            own, is_parameter = float(start.inputs["omega"]), window.name == "omega"
            called = at[0] if at and is_parameter else equations.family.omega
            if called is not None and not math.isclose(own, called, rel_tol=1e-9):
                name = "at" if is_parameter else "omega"
                raise ModelError(f"{name} = {called:g}: must be omega = {own:g} of the response")
            at = _inside(window, own) if is_parameter else at
        at = _inside(window, np.ravel(start.amplitude)[0].item(), "amplitude") if is_free else at
        if at is None:
            raise ModelError(f"at: missing; give the value of {window.name} of the response")
        return [_attractor(start, at[0], n_states)]
    if start is not None:
        state = _numbers("start", start)
        if len(state) != n_states:
            raise ModelError(f"start = {start!r}: must be a state of {n_states} numbers")
        if is_free:
            return [_free(equations, state)]
        if equations.has_period:
            raise ModelError("start: an unforced system needs a gapsweep.Response")
        if at is None:
            raise ModelError(f"at: missing; give the value of {window.name} of the orbit start")
        multiple = _periods(equations, at[0], state)
        return [Attractor(value=at[0], section=state[None, :], period=np.nan, multiple=multiple)]
    values = at or [float(window.value(0.5))]
    return [_free(equations, value * np.eye(n_states)[0]) for value in values]


def settled(equations: OrbitEquations, values: Array, states: Array) -> list[Attractor]:
    """Periodic attractors that motions settle on, each once.

    Raises
    ------
    ModelError
        If there are none.
    """
    window = equations.windows[0]
    models = equations.family.models((window,), np.asarray(window.place(values))[:, None])
    answers = respond_models(models, Solver.of(), states, Steady()).rows()
    every: list[Attractor] = []
    kinds: Counter[str] = Counter()
    for value, answer in zip(values.tolist(), answers, strict=True):
        kind = answer.response_class
        if kind == ResponseClass.PERIODIC and np.max(answer.amplitude) <= answer.noise:
            kind = ResponseClass.EQUILIBRIUM  # as where the forcing is 0
        kinds[kind.name.lower()] += 1
        if kind == ResponseClass.PERIODIC:
            every.append(_attractor(answer, value, equations.n_states))
    if not every:
        n_of = ", ".join(f"{n} {name}" for name, n in kinds.items())
        raise ModelError(
            f"starts: no motion settles on a periodic orbit ({n_of}); change starts, the values of "
            f"{window.name} as at, or give an initial state near an orbit as start"
        )
    size = started(equations, every, np.array([[each.value] for each in every]))[1].size
    found: dict[tuple[float, int], list[tuple[Identity, Attractor]]] = {}
    for each, of in zip(every, size, strict=True):
        known = found.setdefault((each.value, each.multiple), [])
        identity = Identity(each.section / of, 0.0)
        if not any(identity.is_same(other, limit.SETTLED_ALIKE) for other, _ in known):
            known.append((identity, each))
    return [each for known in found.values() for _, each in known]


def _attractor(response: Response, value: float, n_states: int) -> Attractor:
    section = np.reshape(np.asarray(response.section, float), (-1, n_states))
    multiple = int(response.period_multiple)
    period = float(response.period) if response.period else np.nan
    x_max = np.ravel(response.x_max)[0].item()
    return Attractor(value=value, section=section, period=period, multiple=multiple, x_max=x_max)


def _periods(equations: OrbitEquations, value: float, state: Array) -> int:
    """Forcing periods until a motion first returns near its initial state; 1 if it does not."""
    windows = equations.windows
    models = equations.family.models(windows, np.asarray(windows[0].place([[value]])))
    t_end = Steady().max_period_multiple / models.omega
    section = motions(models, equations.solver, state[None, :], t_end, 0.0).events().section
    if not len(section):
        raise ModelError(f"start = {state.tolist()}: no motion from there; start between the walls")
    apart = np.abs(section - state).max(axis=1) / np.abs(state).max(initial=1e-300)
    return 1 + int(np.argmax(apart <= limit.COMES_BACK))


def _free(equations: OrbitEquations, state: Array) -> Attractor:
    """A free motion from rest, up to the next maximum of its first coordinate."""
    model, laws = equations.family.example, equations.family.laws_at({})
    law = dict(zip(model.contacts, laws, strict=True))
    if not state[0]:
        raise ModelError("start: the first coordinate is the amplitude and must not be 0")
    n, slowest = model.n, model.slowest or model.fastest
    if not slowest:
        raise ModelError("start: this System has no natural frequency; give a Response")
    run = simulate(
        model, law, q_0=state[:n], v_0=state[n : 2 * n], t_end=20.0 / slowest,
        rtol=DEFAULT_RTOL,
    )  # fmt: skip
    if not len(run.t_section):
        raise ModelError("start: the motion does not return; give another amplitude")
    turns = [state[0], *run.extrema[model.coordinates[0]]]
    (amplitude,) = _inside(equations.windows[0], 0.5 * float(np.ptp(turns)), "amplitude")
    period = float(run.t_section[0])
    return Attractor(
        value=amplitude, section=state[None, :], period=period, multiple=1, x_max=max(turns)
    )


def _inside(window: Window, at: ArrayLike, name: str = "at") -> list[float]:
    values: list[float] = _numbers(name, without_units(window.name, at)).tolist()
    if not values or not all(window.low <= value <= window.high for value in values):
        raise ModelError(
            f"{name} = {at!r}: must lie within between = ({window.low:g}, {window.high:g})"
        )
    return values


def _numbers(name: str, value: ArrayLike) -> Array:
    """A flat array of finite numbers."""
    found = np.ravel(numbers(name, value, "numbers"))
    if not np.isfinite(found).all():
        raise ModelError(f"{name} = {value!r}: must be numbers")
    return found


def _states(equations: OrbitEquations, starts: ArrayLike | None) -> Array:
    n = equations.n_states
    if starts is not None:
        states = _numbers("starts", starts)
        if not len(states) or len(states) % n:
            raise ModelError(f"starts: must be states of {n} numbers")
        return states.reshape(-1, n)
    laws = equations.family.laws_at(equations.family.values)
    walls = [wall for law in laws for wall in (-law.gap.j_1, law.gap.j_2) if wall]
    walls = [wall for wall in walls if math.isfinite(wall)]
    displaced = [0.0, *(limit.BEYOND_WALLS * wall for wall in walls)]
    if equations.has_period:
        displaced += [max(map(abs, walls), default=1.0) * part for part in limit.DISPLACED]
    return np.unique(np.outer(displaced, np.eye(n)[0]) + 0.0, axis=0)  # no -0.0
