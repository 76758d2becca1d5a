"""`gapsweep.special_curve`: special points of branches continued in a second parameter.

The equations of the orbit get one more unknown, the second parameter, and one more equation g = 0,
with the multiplier μ nearest to where it must be, or the turning point x of a contact's gap::

    fold  g = μ - 1        period doubling  g = μ + 1
    torus g = |μ| - 1      graze            g = x - wall, over the size of the orbit

Derivatives of g are central differences.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.continuation.arclength import Continuation, reversed_orbit
from gapsweep.continuation.branches import Branches
from gapsweep.continuation.dataset import dataset, special_points
from gapsweep.continuation.family import AMPLITUDE, Family, Window
from gapsweep.continuation.orbits import Evaluation, Orbit, OrbitEquations, Reference
from gapsweep.continuation.recognise import Branch
from gapsweep.continuation.seed import Attractor, started
from gapsweep.continuation.special import Graze, Special, nearest_graze
from gapsweep.continuation.thresholds import CLOSES, CONDITION_DIFFERENCE, DIFFERENCE, STANDS_STILL
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Model, Solver
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.oscillator import called_as, whole
from gapsweep.variables import POINT

Array = NDArray[np.float64]

_TARGETS = {Special.FOLD: 1.0, Special.PERIOD_DOUBLING: -1.0}


class CurveEquations(OrbitEquations):
    """Equations of orbits with two parameters that are special points: `condition` is their g."""

    def __init__(
        self,
        family: Family,
        windows: tuple[Window, ...],
        solver: Solver,
        condition: Callable[[Orbit], float],
    ) -> None:
        super().__init__(family, windows, solver)
        self._condition = condition

    def evaluate(
        self, unknowns: Array, reference: Reference, difference: float = DIFFERENCE
    ) -> Evaluation:
        m, d = unknowns.shape
        shifts = CONDITION_DIFFERENCE * np.concatenate([np.zeros((1, d)), np.eye(d), -np.eye(d)])
        moved = unknowns[None, :, :] + shifts[:, None, :]
        first = d - self.n_parameters
        moved[:, :, first:] = np.clip(moved[:, :, first:], 0.0, 1.0)
        apart = np.einsum("imi->im", moved[1 : d + 1] - moved[d + 1 :])
        every = moved.reshape(-1, d)
        lanes = np.tile(np.arange(m), len(shifts))
        whole = super().evaluate(every, reference.take(lanes), difference)
        # Those of the motions with the parameters as they are; an unknown tangent does no harm.
        orbits = super().orbits(
            every, np.zeros_like(every), reference.take(lanes), whole, np.arange(len(every))
        )
        values = np.array([self._condition(orbit) for orbit in orbits]).reshape(-1, m)
        with np.errstate(all="ignore"):  # of motions that failed, and beyond a window's end
            slope = (values[1 : d + 1] - values[d + 1 :]) / apart
        return Evaluation(
            residual=np.concatenate([whole.residual[:m], values[0][:, None]], axis=1),
            jacobian=np.concatenate([whole.jacobian[:m], slope.T[:, None, :]], axis=1),
            is_ok=whole.is_ok.reshape(-1, m).all(axis=0) & np.isfinite(slope).all(axis=0),
            motions=whole.motions,
            rate=whole.rate,
        )


@called_as("gs.special_curve(branches, 0, 'forcing', between=(3.0, 5.0))")
def special_curve(
    branches: xr.Dataset,
    point: int,
    second: str,
    between: tuple[float, float],
    *,
    oscillator: Model | Callable[..., Model] | None = None,
    law: AnyLaw | None = None,
    max_steps: int = 500,
) -> xr.Dataset:
    """Return the curve of a special point of a branch over two parameters.

    Parameters
    ----------
    branches : Dataset
        Result of `gapsweep.branches`, or a file with branches, as ``branches.nc`` of a study.
    point : int
        Number of the special point, as of `ds.gapsweep.special_points()`. Folds, period doublings,
        torus bifurcations and grazes have curves.
    second : str
        Second parameter, named as `along` of `gapsweep.branches`.
    between : tuple of float
        Range of the second parameter, ascending. The first parameter keeps its range.
    oscillator, law
        Those of the branches, as in `gapsweep.branches`; required for branches from a file.
    max_steps : int
        Largest number of points on either side, 2 to 100000.

    Returns
    -------
    Dataset
        Both parameters and the variables of `branches` over `step`, a closed curve once.
        ``special`` marks the cusps of a curve of folds; ``stable`` is 1 where all multipliers are
        within the unit circle but those that the bifurcation has on it.

    Raises
    ------
    ModelError
        If an argument is out of range.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> machine = gs.systems.paper_oscillator()
    >>> br = gs.branches(machine, law, along="omega", between=(9.0, 16.0), at=12.0)
    >>> curve = gs.special_curve(br, 0, "forcing", (3.0, 5.0))
    >>> curve["omega"].dims
    ('step',)
    """
    if not (isinstance(branches, xr.Dataset) and "special" in branches):
        raise ModelError(f"branches = {branches!r:.80}: must be a result of gs.branches(...)")
    row, kind = _row(branches, point)
    family, name = branches.encoding.get("family"), str(branches.attrs["along"])
    if name == AMPLITUDE:
        raise ModelError("branches: free motions along 'amplitude' have no curves")
    value = float(row[name])
    if oscillator is not None and law is not None:
        omega = branches.attrs.get("forcing_frequency", row.coords.get("omega"))
        omega = None if name == "omega" or omega is None else float(omega)
        family = Family(oscillator, law, omega, (name,), {name: value})
    if not isinstance(family, Family):
        raise ModelError(
            "oscillator, law: missing; a file does not hold them: "
            f"gs.special_curve(branches, {point}, {second!r}, {between!r}, oscillator=..., law=...)"
        )
    first = Window.of(name, branches.attrs["between"])
    windows = first, Window.of(second, between)
    fixed = family.value_of(second, {first.name: value})
    if not windows[1].low <= fixed <= windows[1].high:
        raise ModelError(
            f"between = {between!r}: must contain the value {second} = {fixed:g} of the branch"
        )
    values = {**family.values, first.name: value, second: fixed}
    omega = None if "omega" in (first.name, second) else family.omega
    curves = Family(family.model, family.law, omega, (first.name, second), values)
    solver = Solver.of("compiled", branches.attrs["rtol"], branches.attrs.get("atol"))
    plain = OrbitEquations(curves, windows, solver)
    start, reference = _start(plain, row, np.array([[value, fixed]]))
    equations = CurveEquations(curves, windows, solver, _condition(plain, start, kind, reference))
    max_steps = whole("max_steps", max_steps, 2, 100_000)
    continuation = Continuation(equations, max_steps)
    along = np.zeros((1, len(start.unknowns)))
    along[0, -1] = 1.0
    found, _ = continuation.corrector.orbits(
        start.unknowns[None, :], along, reference, np.array([0.1])
    )
    if found[0] is None:
        raise ModelError(f"point = {point}: Newton's method finds no curve through it")
    halves = continuation.follow(
        [found[0], reversed_orbit(found[0])], reference.take(np.zeros(2, int))
    )
    found_all = Branches(equations=equations, max_steps=max_steps)
    forward, backward = found_all.with_special_points(halves)
    orbits = [*map(reversed_orbit, backward[:0:-1]), *forward]
    if halves[0].end == "closed":
        orbits = [*forward[:-1], forward[0]]
    # Where the curve has a corner, as at a graze, the parameters do not stand still.
    orbits = [o for o in orbits if not o.special or np.abs(o.tangent[-2:]).max() <= STANDS_STILL]
    ends = halves[1].end, halves[0].end
    found_all.found = [Branch(orbits=orbits, ends=ends, reference=reference)]
    made = dataset(found_all).isel(branch=0, drop=True)
    return made.assign_attrs(curve=kind.name.lower(), second=second)


def _row(branches: xr.Dataset, point: int) -> tuple[xr.Dataset, Special]:
    """The orbit of a special point, and its kind."""
    points = special_points(branches)
    if not points.sizes[POINT]:
        raise ModelError("branches: have no special points")
    row = points.isel({POINT: whole("point", point, 0, points.sizes[POINT] - 1)})
    kind = Special(int(row["special"]))
    if kind not in (*_TARGETS, Special.TORUS, Special.GRAZING):
        raise ModelError(
            f"point = {point}: is a {kind.name.lower()}; must be a fold, a period doubling, "
            "a torus bifurcation or a graze"
        )
    return row, kind


def _start(equations: OrbitEquations, row: xr.Dataset, values: Array) -> tuple[Orbit, Reference]:
    """The orbit of a row of branches, with both parameters."""
    orbit = Attractor(
        value=np.nan,
        section=row["start_state"].values[None, :],
        period=float(row["period"]),
        multiple=int(row["period_multiple"]),
    )
    unknowns, reference = started(equations, [orbit], values)
    found = equations.evaluate(unknowns, reference)
    if not found.is_ok[0] or np.abs(found.residual).max() > CLOSES:
        raise ModelError("oscillator, law: must be those of the branches; the orbit does not close")
    tangent = np.zeros_like(unknowns)
    (first,) = equations.orbits(unknowns, tangent, reference, found, np.zeros(1, np.intp))
    return first, reference


def _condition(
    equations: OrbitEquations, start: Orbit, kind: Special, reference: Reference
) -> Callable[[Orbit], float]:
    """g of a special point of a kind, as a function of orbits near the curve."""
    if kind == Special.GRAZING:
        graze: Graze = nearest_graze(equations, start)
        size = float(reference.size[0, 0])
        return lambda orbit: graze(orbit) / size
    if kind == Special.TORUS:
        return _torus
    target = _TARGETS[kind]

    def nearest(orbit: Orbit) -> float:
        apart = orbit.multipliers - target
        return float(apart[np.argmin(np.abs(apart))].real)

    return nearest


def _torus(orbit: Orbit) -> float:
    """Modulus of the complex multiplier that is nearest to the unit circle, less 1."""
    moduli = np.abs(orbit.multipliers[np.abs(orbit.multipliers.imag) > 0.0]) - 1.0
    return float(moduli[np.argmin(np.abs(moduli))]) if len(moduli) else np.nan
