"""How the static error falls with the degree of a fit or the parameter of a smooth law.

All errors here are per unit contact stiffness [m]: the force of every built-in law is
proportional to `K_c`, and so are its errors; R² does not depend on `K_c` at all.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gapsweep.analysis.force_error import in_gap, largest_in_gap, static_error
from gapsweep.analysis.thresholds import tanh_threshold
from gapsweep.errors import ModelError
from gapsweep.model.contact import Arctan, LogArctan, Tanh
from gapsweep.model.fit import N_FIT_POINTS, goodness, unit_force
from gapsweep.model.fitted import RationalPolynomial
from gapsweep.model.oscillator import Gap
from gapsweep.study.schema import COORDINATES, Variable
from gapsweep.study.study import Study

Array = NDArray[np.float64]
Values = dict[str, NDArray[Any]]

DEGREES = tuple(range(3, 46, 2))
RATIOS = ((3, 2), (3, 3), (3, 5), (5, 2), (5, 3), (5, 5), (7, 2), (7, 3), (7, 5))
SmoothLaw = Tanh | Arctan | LogArctan
FAMILIES: dict[str, type[Tanh] | type[Arctan] | type[LogArctan]] = {
    "tanh": Tanh, "arctan": Arctan, "logarctan": LogArctan
}  # fmt: skip
PARAMETERS = tuple(float(f"{10 ** (e / 2):.3g}") for e in range(4, 19))
BASES = ("monomial in m", "Chebyshev")
CONSTRAINTS = ("none", "no constant or linear term")

_N_IN_GAP = 2001
# Largest share of the forcing that a law may exert between the walls.
_LEAK = 0.1

LADDER: dict[str, tuple[tuple[str, ...], Variable]] = {
    name: (dims, Variable(dtype, units, long_name))
    for name, dims, dtype, units, long_name in (
        ("poly_rmse", ("gap", "constraint", "degree"), "f8", "m",
         "RMS force error of a polynomial per unit contact stiffness"),
        ("poly_r_squared", ("gap", "constraint", "degree"), "f8", "1",
         "coefficient of determination of a polynomial"),
        ("poly_in_gap_force", ("gap", "constraint", "degree"), "f8", "m",
         "largest in-gap force of a polynomial per unit contact stiffness"),
        ("poly_outside_error", ("gap", "constraint", "degree"), "f8", "m",
         "largest force error of a polynomial outside the gap per unit contact stiffness"),
        ("poly_condition", ("basis", "degree"), "f8", "1",
         "condition number of the least-squares matrix"),
        ("poly_smallest_degree", ("K_c", "gap"), "i4", "1",
         f"smallest degree with an in-gap force below {_LEAK:g} of the forcing, 0: none"),
        ("ratpoly_rmse", ("gap", "ratio"), "f8", "m",
         "RMS force error of a rational polynomial per unit contact stiffness"),
        ("ratpoly_r_squared", ("gap", "ratio"), "f8", "1",
         "coefficient of determination of a rational polynomial"),
        ("ratpoly_in_gap_force", ("gap", "ratio"), "f8", "m",
         "largest in-gap force of a rational polynomial per unit contact stiffness"),
        ("ratpoly_force_at_zero", ("gap", "ratio"), "f8", "m",
         "force of a rational polynomial at x = 0 per unit contact stiffness"),
        ("smooth_rmse", ("family", "gap", "parameter"), "f8", "m",
         "RMS force error of a smooth law per unit contact stiffness"),
        ("smooth_r_squared", ("family", "gap", "parameter"), "f8", "1",
         "coefficient of determination of a smooth law"),
        ("tanh_threshold", ("K_c", "gap"), "f8", "m-1",
         "convergence parameter above which tanh has no false well, by search"),
    )
}  # fmt: skip


def smallest_degree(
    in_gap_force: Array, degrees: Sequence[int], forcing: float
) -> NDArray[np.intp]:
    """First of the degrees (last axis) whose force [N] is below `_LEAK` of the forcing, or 0."""
    enough = in_gap_force < _LEAK * abs(forcing)
    return np.where(enough.any(axis=-1), np.array(degrees)[enough.argmax(axis=-1)], 0)


def ladders(study: Study) -> xr.Dataset:
    """Static error against degree, ratio of degrees and convergence parameter.

    Parameters
    ----------
    study : Study
        Its gaps, stiffnesses, oscillator and fit range are used; not its representations.

    Returns
    -------
    Dataset
        As in the table of this module; errors per unit contact stiffness.
    """
    grid, x_max, oscillator = study.grid, study.spec.fit.range, study.oscillator
    values: Values = _stacked([polynomial_ladder(gap, x_max) for gap in grid.gaps])
    values |= _stacked([rational_ladder(gap, x_max) for gap in grid.gaps])
    values |= _stacked([smooth_ladder(gap, x_max) for gap in grid.gaps], axis=1)
    values["poly_condition"] = condition_numbers(x_max)
    leak = np.multiply.outer(grid.K_c, values["poly_in_gap_force"][:, 0])
    values["poly_smallest_degree"] = smallest_degree(leak, DEGREES, oscillator.forcing)
    scenes = [(K_c, gap) for K_c in grid.K_c for gap in grid.gaps]
    found = [tanh_threshold(oscillator, *scene, x_max) for scene in scenes]
    values["tanh_threshold"] = np.reshape(found, leak.shape[:2])
    variables = {
        name: (dims, values[name].astype(v.dtype), _attributes(v))
        for name, (dims, v) in LADDER.items()
    }
    coords = {n: (n, axis, _attributes(v)) for n, (axis, v) in _axes(study).items()}
    return xr.Dataset(variables, coords)


def _axes(study: Study) -> dict[str, tuple[list[Any], Variable]]:
    ratios = [f"{n}/{m}" for n, m in RATIOS]
    return {
        "K_c": (list(study.grid.K_c), COORDINATES["K_c"][1]),
        "gap": ([gap.label for gap in study.grid.gaps], COORDINATES["gap"][1]),
        "degree": (list(DEGREES), Variable("i4", "1", "polynomial degree")),
        "constraint": (list(CONSTRAINTS), Variable("str", "1", "terms left out of the fit")),
        "basis": (list(BASES), Variable("str", "1", "basis of the least-squares fit")),
        "ratio": (ratios, Variable("str", "1", "degrees of numerator and denominator")),
        "family": (list(FAMILIES), Variable("str", "1", "smooth contact law")),
        "parameter": (list(PARAMETERS), Variable("f8", "m-1", "convergence parameter")),
    }


def polynomial_ladder(gap: Gap, x_max: float) -> Values:
    """Least-squares polynomials of all `DEGREES`, free and constrained; (constraint, degree)."""
    return _stacked([_polynomial_rungs(gap, x_max, lowest) for lowest in (0, 2)])


def _polynomial_rungs(gap: Gap, x_max: float, lowest: int) -> Values:
    u = np.linspace(-1.0, 1.0, N_FIT_POINTS)
    at = np.linspace(*in_gap(gap, x_max), _N_IN_GAP) / x_max
    exact = unit_force(u * x_max, gap)
    fits, forces = _nested_fits(u, exact, at, lowest)
    rmse, r_squared = np.transpose([goodness(fit, exact) for fit in fits.T])
    errors = np.abs(fits - exact[:, None])[exact != 0.0]
    return {
        "poly_rmse": rmse,
        "poly_r_squared": r_squared,
        "poly_in_gap_force": np.max(np.abs(forces), axis=0),
        "poly_outside_error": np.max(errors, axis=0, initial=0.0),
    }


def _nested_fits(u: Array, exact: Array, at: Array, lowest: int) -> tuple[Array, Array]:
    """Fits without the terms below ``x**lowest``, at the fit points and at others.

    One orthogonal factorisation serves all degrees: each fit is the one before it plus its
    projection on the next columns.
    """
    degree = DEGREES[-1] - lowest
    q, r = np.linalg.qr(u[:, None] ** lowest * chebyshev.chebvander(u, degree))
    elsewhere = at[:, None] ** lowest * chebyshev.chebvander(at, degree) @ np.linalg.inv(r)
    c = q.T @ exact
    last = np.array(DEGREES) - lowest
    return np.cumsum(q * c, axis=1)[:, last], np.cumsum(elsewhere * c, axis=1)[:, last]


def condition_numbers(x_max: float) -> Array:
    """Condition of the least-squares matrix by basis and degree, without saturation.

    The triangular factor of the Chebyshev basis and the exact change of basis give that of the
    monomials; norms of a factor and of its inverse then hold far beyond 1/eps.
    """
    n = DEGREES[-1] + 1
    basis = chebyshev.chebvander(np.linspace(-1.0, 1.0, N_FIT_POINTS), n - 1)
    triangle = np.linalg.qr(basis, mode="r")
    to_cheb, to_mono = np.zeros((n, n)), np.zeros((n, n))
    for k, unit in enumerate(np.eye(n)):
        to_cheb[: k + 1, k] = chebyshev.poly2cheb(unit[: k + 1])
        to_mono[: k + 1, k] = chebyshev.cheb2poly(unit[: k + 1])
    inverse, powers = np.linalg.inv(triangle), x_max ** np.arange(n)
    factors: list[tuple[Any, Any]] = [
        (triangle @ to_cheb * powers, to_mono @ inverse / powers[:, None]),
        (triangle, inverse),
    ]
    sizes = [degree + 1 for degree in DEGREES]
    # The inverse of a leading block of a triangle is the leading block of its inverse.
    return np.array(
        [
            [np.linalg.norm(r[:k, :k], 2) * np.linalg.norm(s[:k, :k], 2) for k in sizes]
            for r, s in factors
        ]
    )


def rational_ladder(gap: Gap, x_max: float) -> Values:
    """Rational fits of all `RATIOS`; (ratio,)."""
    return _stacked([_rational_rung(gap, n, m, x_max) for n, m in RATIOS])


def _rational_rung(gap: Gap, n: int, m: int, x_max: float) -> Values:
    try:
        law = RationalPolynomial(1.0, gap, n, m, x_max)
        found = (*static_error(law, x_max), largest_in_gap(law, x_max), float(law.force(0.0)))
    except ModelError:
        found = (np.nan,) * 4
    names = ("rmse", "r_squared", "in_gap_force", "force_at_zero")
    return {f"ratpoly_{name}": np.array(v) for name, v in zip(names, found, strict=True)}


def smooth_ladder(gap: Gap, x_max: float) -> Values:
    """Smooth laws at all `PARAMETERS`; (family, parameter)."""
    rungs = [
        _stacked([_smooth_rung(family(1.0, gap, value), x_max) for value in PARAMETERS])
        for family in FAMILIES.values()
    ]
    return _stacked(rungs)


def _smooth_rung(law: SmoothLaw, x_max: float) -> Values:
    rmse, r_squared = static_error(law, x_max)
    return {"smooth_rmse": np.array(rmse), "smooth_r_squared": np.array(r_squared)}


def _stacked(rows: list[Values], axis: int = 0) -> Values:
    return {name: np.stack([row[name] for row in rows], axis=axis) for name in rows[0]}


def _attributes(variable: Variable) -> dict[str, str]:
    return {"units": variable.units, "long_name": variable.long_name}
