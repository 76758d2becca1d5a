"""`gapsweep.special_curve`: special points of branches continued in a second parameter.

The equations of the orbit get one more unknown, the second parameter, and one more equation g = 0,
with the multipliers μ, or the turning point x of a contact's gap::

    fold  g = prod(1 - μ_i)              period doubling  g = prod(1 + μ_i)
    torus g = prod(1 - μ_i μ_j), i < j   graze            g = x - wall, over the size of the orbit

These are smooth also where two multipliers meet. Derivatives of g are central differences.
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
from gapsweep.continuation.recognise import Branch, holders
from gapsweep.continuation.seed import Attractor, started
from gapsweep.continuation.special import (
    GRAZES,
    RESONANCES,
    Special,
    characteristic,
    doubling,
    nearest_graze,
    torus,
)
from gapsweep.continuation.thresholds import (
    CLOSES,
    CONDITION_DIFFERENCE,
    DIFFERENCE,
    STANDS_STILL,
    UNLIKE,
)
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Model, Solver
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.oscillator import called_as, whole
from gapsweep.variables import POINT

Array = NDArray[np.float64]

_POINT = "point (a number of branches.gapsweep.special_points())"
# Kinds of special points that have curves.
KINDS = Special.FOLD, Special.PERIOD_DOUBLING, Special.TORUS, *GRAZES


class CurveEquations(OrbitEquations):
    """Equations of orbits with two parameters that are special points: `condition` is their g."""

    def __init__(
        self,
        family: Family,
        windows: tuple[Window, ...],
        solver: Solver,
        kind: Special,
        condition: Callable[[Orbit], float],
    ) -> None:
        super().__init__(family, windows, solver)
        self.kind, self._condition = kind, condition

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
        # Orbits at the parameters as they are; an unknown tangent does no harm.
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
        Model and law of the branches, as in `gapsweep.branches`; required for branches from a file.
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
    points, kind, family, name = special_point_of(branches, point, oscillator, law)
    if kind not in KINDS:
        raise ModelError(
            f"point = {point}: is a {kind.name.lower()}; must be a fold, a period doubling, "
            "a torus bifurcation or a graze"
        )
    windows = Window.of(name, branches.attrs["between"]), Window.of(second, between)
    solver = Solver.of("compiled", branches.attrs["rtol"], branches.attrs.get("atol"))
    max_steps = whole("max_steps", max_steps, 2, 100_000)
    return dataset(curves(family, windows, solver, points, max_steps)).isel(branch=0, drop=True)


def special_point_of(
    branches: xr.Dataset,
    point: int,
    oscillator: Model | Callable[..., Model] | None,
    law: AnyLaw | None,
) -> tuple[xr.Dataset, Special, Family, str]:
    """Return a special point of branches, its kind, their family and the name of their parameter.

    Raises
    ------
    ModelError
        If there is no such point, or the branches are from a file and the model is missing.
    """
    if not (isinstance(branches, xr.Dataset) and "special" in branches):
        raise ModelError(f"branches = {branches!r:.80}: must be a result of gs.branches(...)")
    points = special_points(branches)
    if not points.sizes[POINT]:
        raise ModelError("branches: have no special points")
    points = points.isel({POINT: [whole(_POINT, point, 0, points.sizes[POINT] - 1)]})
    kind = Special(int(points["special"].item()))
    family, name = branches.encoding.get("family"), str(branches.attrs["along"])
    if name == AMPLITUDE:
        raise ModelError("branches: free motions along 'amplitude' have no parameter")
    if oscillator is not None and law is not None:
        omega = branches.attrs.get("forcing_frequency", points.coords.get("omega"))
        omega = None if name == "omega" or omega is None else float(omega)
        family = Family(oscillator, law, omega, (name,), {name: points[name].item()})
    if not isinstance(family, Family):
        raise ModelError(
            "oscillator, law: missing; a file does not hold them: write oscillator=..., law=..."
        )
    return points, kind, family, name


def curves(
    family: Family,
    windows: tuple[Window, Window],
    solver: Solver,
    points: xr.Dataset,
    max_steps: int,
) -> Branches:
    """The curves of special points over two parameters, each once; a `ModelError` without any."""
    first, second = windows
    values = {first.name: float(points[first.name][0])}
    values[second.name] = fixed = family.value_of(second.name, values)
    if not second.low <= fixed <= second.high:
        raise ModelError(
            f"between = {(second.low, second.high)}: must contain the value "
            f"{second.name} = {fixed:g} of the branch"
        )
    for end in (second.low, second.high):  # an invalid value ends here, not within a curve
        family.model_at({**values, second.name: end})
        family.laws_at({**values, second.name: end})
    omega = None if "omega" in values else family.omega
    both = Family(family.model, family.law, omega, (*values,), {**family.values, **values})
    equations = OrbitEquations(both, windows, solver)
    found = Branches(equations=equations, max_steps=max_steps)
    several: list[Branches] = []
    why = ""
    for i in range(points.sizes[POINT]):
        row = points.isel({POINT: i})
        try:
            start, reference = _start(equations, row, np.array([[row[first.name].item(), fixed]]))
            kind = Special(int(row["special"]))
            kind = Special.GRAZING if kind in GRAZES else kind  # the kind may change on the curve
            section = start.identity.section * reference.size[0]
            here = [(equations.place(start), section, start.period_multiple)]
            alike = [each for each in several if each.found[0].kind == kind]
            if all(holders(each.equations, here, each.found)[0] < 0 for each in alike):
                several.append(_curve(equations, kind, start, reference, max_steps))
        except ModelError as error:
            found.n_lost, why = found.n_lost + 1, str(error)
    if not several:
        raise ModelError(why)
    found.found = [curve for each in several for curve in each.found]
    found.n_lost += sum(each.n_lost for each in several)
    return found


def _start(equations: OrbitEquations, row: xr.Dataset, values: Array) -> tuple[Orbit, Reference]:
    """The orbit of a row of branches, with both parameters."""
    orbit = Attractor(
        value=np.nan,
        section=row["start_state"].values[None, :],
        period=float(row["period"]),
        multiple=int(row["period_multiple"]),
    )
    while True:
        unknowns, reference = started(equations, [orbit], values)
        found = equations.evaluate(unknowns, reference)
        if not found.is_ok[0] or np.abs(found.residual).max() > CLOSES:
            said = "must be those of the branches; the orbit does not close"
            raise ModelError(f"oscillator, law: {said}")
        tangent = np.zeros_like(unknowns)
        (start,) = equations.orbits(unknowns, tangent, reference, found, np.zeros(1, np.intp))
        if row["special"] != Special.PERIOD_DOUBLING or start.identity.halves > UNLIKE:
            return start, reference
        # On a branch of twice the period, the orbit that doubles is half of it.
        orbit.multiple, orbit.period = orbit.multiple // 2, 0.5 * orbit.period


def _curve(
    plain: OrbitEquations, kind: Special, start: Orbit, reference: Reference, max_steps: int
) -> Branches:
    """The curve through a special point."""
    condition = _condition(plain, start, kind, reference)
    equations = CurveEquations(plain.family, plain.windows, plain.solver, kind, condition)
    continuation = Continuation(equations, max_steps)
    along = np.zeros((1, len(start.unknowns)))
    along[0, -1] = 1.0
    (first,), _ = continuation.corrector.orbits(
        start.unknowns[None, :], along, reference, np.array([0.1])
    )
    if first is None:
        raise ModelError("point: Newton's method finds no curve through it")
    found = Branches(equations=equations, max_steps=max_steps)
    halves = continuation.follow([first, reversed_orbit(first)], reference.take(np.zeros(2, int)))
    sides, ends = found.with_special_points(halves), [half.end for half in halves]
    for k, side in enumerate(sides):
        cuts = [i for i, orbit in enumerate(side) if orbit.special in RESONANCES]
        if kind == Special.TORUS and cuts:  # behind it both multipliers are real
            sides[k], ends[k] = side[: cuts[0] + 1], "resonance"
    orbits = [*map(reversed_orbit, sides[1][:0:-1]), *sides[0]]
    if ends[0] == "closed":
        orbits = [*sides[0][:-1], sides[0][0]]
    # Where the curve has a corner, as at a graze, the parameters do not stand still.
    orbits = [
        orbit
        for orbit in orbits
        if orbit.special != Special.CUSP or np.abs(orbit.tangent[-2:]).max() <= STANDS_STILL
    ]
    found.found = [Branch(orbits=orbits, ends=(ends[1], ends[0]), reference=reference, kind=kind)]
    return found


def _condition(
    equations: OrbitEquations, start: Orbit, kind: Special, reference: Reference
) -> Callable[[Orbit], float]:
    """g of a special point of a kind, as a function of orbits near the curve."""
    if kind == Special.GRAZING:
        graze = nearest_graze(equations, start)
        size = float(reference.size[0, 0])
        return lambda orbit: graze(orbit) / size
    if kind == Special.FOLD:
        return lambda orbit: characteristic(orbit, 1.0)
    return doubling if kind == Special.PERIOD_DOUBLING else torus
