"""How the static error falls with the degree of a fit or the parameter of a smooth law.

All errors here are per unit contact stiffness [m]: the force of every built-in law is
proportional to `K_c`, and so are its errors; R² does not depend on `K_c` at all.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gapsweep.analysis.datasets.contact_errors import in_gap, largest_in_gap, static_error
from gapsweep.errors import ModelError
from gapsweep.model.fit import N_FIT_POINTS, goodness, unit_force
from gapsweep.model.labels import contact_law
from gapsweep.model.oscillator import Gap
from gapsweep.study.study import Study

from .cftool import UNITS
from .scenes import TANGENTS

Array = NDArray[np.float64]
Force = Callable[[Array], Array]

DEGREES = tuple(range(3, 46, 2))
RATIOS = ("3/2", "3/3", "3/5", "5/2", "5/3", "5/5", "7/2", "7/3", "7/5")
PARAMETERS = tuple(float(f"{10 ** (e / 2):.3g}") for e in range(4, 19))
CONSTRAINTS = {"none": 0, "no constant or linear term": 2}  # the lowest power of x
_LEAK = 0.1  # largest share of the forcing that a law may exert between the walls

_POLY, _RATPOLY = ("gap", "constraint", "degree"), ("gap", "ratio")
_SMOOTH = ("gap", "family", "parameter")
VARIABLES = {
    "poly_rmse": (_POLY, "m", "RMS force error of a polynomial"),
    "poly_r_squared": (_POLY, "1", "coefficient of determination of a polynomial"),
    "poly_in_gap_force": (_POLY, "m", "largest in-gap force of a polynomial"),
    "poly_outside_error": (_POLY, "m", "largest force error of a polynomial outside the gap"),
    "poly_condition": (("degree", "unit"), "1", "condition number of least squares in powers of x"),
    "poly_smallest_degree": (
        ("K_c", "gap"),
        "1",
        f"smallest degree with an in-gap force below {_LEAK:g} of the forcing, 0: none",
    ),
    "ratpoly_rmse": (_RATPOLY, "m", "RMS force error of a rational polynomial"),
    "ratpoly_r_squared": (_RATPOLY, "1", "coefficient of determination of a rational polynomial"),
    "ratpoly_in_gap_force": (_RATPOLY, "m", "largest in-gap force of a rational polynomial"),
    "smooth_rmse": (_SMOOTH, "m", "RMS force error of a smooth law"),
    "smooth_r_squared": (_SMOOTH, "1", "coefficient of determination of a smooth law"),
}


def polynomial(gap: Gap, degree: int, x_max: float, lowest: int = 0) -> Force:
    """Least-squares polynomial of the force per unit stiffness, without terms below x**lowest."""
    u = np.linspace(-1.0, 1.0, N_FIT_POINTS)
    columns = u[:, None] ** lowest * chebyshev.chebvander(u, degree - lowest)
    fit = np.linalg.lstsq(columns, unit_force(u * x_max, gap), rcond=None)[0]
    return lambda x: (x / x_max) ** lowest * chebyshev.chebval(x / x_max, fit)


def ladders(study: Study) -> xr.Dataset:
    """Static error against degree, ratio of degrees and convergence parameter.

    Parameters
    ----------
    study : Study
        Its gaps, stiffnesses, forcing and fit range are used; not its representations.

    Returns
    -------
    Dataset
        As in the table of this module; errors per unit contact stiffness.
    """
    gaps, K_c, x_max = study.grid.gaps, np.array(study.grid.K_c), study.spec.approximation.range
    values = _stacked([_errors(gap, x_max) for gap in gaps])
    scaled = [x_max * scale * np.linspace(-1.0, 1.0, N_FIT_POINTS) for scale in UNITS.values()]
    values["poly_condition"] = np.array(
        [[np.linalg.cond(np.vander(x, degree + 1)) for x in scaled] for degree in DEGREES]
    )
    leak = np.multiply.outer(K_c, values["poly_in_gap_force"][:, 0])
    enough = leak < _LEAK * abs(study.oscillator.forcing)
    first = np.array(DEGREES)[enough.argmax(axis=-1)]
    values["poly_smallest_degree"] = np.where(enough.any(axis=-1), first, 0)
    return xr.Dataset(
        {
            name: (dims, values[name], {"units": units, "long_name": long_name})
            for name, (dims, units, long_name) in VARIABLES.items()
        },
        {
            "K_c": ("K_c", K_c, {"units": "N m-1", "long_name": "contact stiffness"}),
            "gap": [gap.label for gap in gaps],
            "degree": list(DEGREES),
            "constraint": list(CONSTRAINTS),
            "ratio": list(RATIOS),
            "unit": list(UNITS),
            "family": list(TANGENTS),
            "parameter": ("parameter", list(PARAMETERS), {"units": "m-1"}),
        },
    )


def _errors(gap: Gap, x_max: float) -> dict[str, Array]:
    """All errors at one gap, by variable."""
    fits = [
        _stacked([_of_polynomial(polynomial(gap, n, x_max, low), gap, x_max) for n in DEGREES])
        for low in CONSTRAINTS.values()
    ]
    ratios = _stacked([_of_rational(f"ratpoly-{ratio}", gap, x_max) for ratio in RATIOS])
    smooth = np.array(
        [
            [static_error(contact_law(f"{family}-{p!r}", 1.0, gap), x_max)[:2] for p in PARAMETERS]
            for family in TANGENTS
        ]
    )
    tangents = {"smooth_rmse": smooth[..., 0], "smooth_r_squared": smooth[..., 1]}
    return {**_stacked(fits), **ratios, **tangents}


def _of_polynomial(force: Force, gap: Gap, x_max: float) -> dict[str, Any]:
    x = x_max * np.linspace(-1.0, 1.0, N_FIT_POINTS)
    exact, fit = unit_force(x, gap), force(x)
    rmse, r_squared = goodness(fit, exact)
    return {
        "poly_rmse": rmse,
        "poly_r_squared": r_squared,
        "poly_in_gap_force": np.max(np.abs(force(np.linspace(*in_gap(gap, x_max), 2001)))),
        "poly_outside_error": np.max(np.abs(fit - exact)[exact != 0.0], initial=0.0),
    }


def _of_rational(label: str, gap: Gap, x_max: float) -> dict[str, Any]:
    try:
        law = contact_law(label, 1.0, gap, x_max)
        found = (*static_error(law, x_max)[:2], largest_in_gap(law, x_max))
    except ModelError:  # the fit has a pole
        found = (np.nan,) * 3
    return dict(
        zip(("ratpoly_rmse", "ratpoly_r_squared", "ratpoly_in_gap_force"), found, strict=True)
    )


def _stacked(rows: list[dict[str, Any]]) -> dict[str, Array]:
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}
