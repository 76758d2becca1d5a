"""Least-squares fits of the contact force: polynomial and rational polynomial.

Everything here is per unit stiffness of the upper wall. The exact force is proportional to `K_c`
and so is every least-squares fit of it, therefore one fit serves all stiffnesses and its
R² does not depend on `K_c`. It does depend on `K_ratio`, the stiffness of the lower wall over that.

Both fits use Chebyshev polynomials of ``u = x / fit_range``, which keep the normal
equations well conditioned at every degree allowed (the monomial basis does not).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.model.oscillator import Gap, whole

Array = NDArray[np.float64]

N_FIT_POINTS = 8001
MAX_DEGREE = 60
MAX_RATIONAL_DEGREE = 20

# Ten parameters need no more points than this, and the quoted errors of rational fits
# (0.130 N for 5/3, soft symmetric) belong to it: docs/decisions/0002-fits.md.
N_RATIONAL_POINTS = 401
_N_STARTS = 48
_SEED = 20260
_SAME_RMSE = 1.0 + 1e-6
# Half-ranges: a pole this little beyond an end counts as inside, as the law is evaluated at it.
_OUTSIDE = 1e-6


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted force per unit contact stiffness, ``N(u) / D(u)`` with ``u = x/fit_range``.

    Attributes
    ----------
    numerator, denominator : tuple of float
        Chebyshev coefficients, lowest degree first [m] and [-].
    rmse : float
        Root-mean-square error over the fit points [m]; times `K_c` in newtons.
    r_squared : float
        Coefficient of determination over the fit points [-].
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    rmse: float
    r_squared: float


def unit_force(x: Array, gap: Gap, K_ratio: float = 1.0) -> Array:
    """Exact contact force per unit stiffness [m]: zero in the gap, linear outside."""
    # x - clip(x) rather than two masked branches: rounding leaves exactly 0.0 inside
    # the gap, so a free step and a contact step agree bit for bit at the wall.
    depth = x - np.clip(x, -gap.j_1, gap.j_2)
    return np.where(depth < 0.0, K_ratio * depth, depth)


def goodness(approximation: NDArray[np.floating], exact: Array) -> tuple[float, float]:
    """Root-mean-square error and coefficient of determination of sampled forces."""
    residual = float(np.sum((approximation - exact) ** 2))
    total = float(np.sum((exact - np.mean(exact)) ** 2))
    rmse = float(np.sqrt(residual / exact.size))
    # A gap wider than the range leaves nothing to explain: any exact zero is a perfect fit.
    return rmse, 1.0 - residual / total if total > 0.0 else float(residual == 0.0)


@lru_cache(maxsize=256)
def polynomial_fit(gap: Gap, degree: int, fit_range: float, K_ratio: float = 1.0) -> Fit:
    """Return the unweighted least-squares polynomial over 8001 uniform points of ``±fit_range``."""
    whole("polynomial degree", degree, 1, MAX_DEGREE)
    u = np.linspace(-1.0, 1.0, N_FIT_POINTS)
    exact = unit_force(u * fit_range, gap, K_ratio)
    degrees = np.arange(degree + 1)
    used = degrees[degrees % 2 == 1] if _is_odd(gap, K_ratio) else degrees
    numerator = np.zeros(degree + 1)
    columns = chebyshev.chebvander(u, degree)[:, used]
    numerator[used] = np.linalg.lstsq(columns, exact, rcond=None)[0]
    rmse, r_squared = goodness(chebyshev.chebval(u, numerator), exact)
    return Fit(tuple(numerator.tolist()), (1.0,), rmse, r_squared)


@lru_cache(maxsize=256)
def rational_fit(
    gap: Gap, numerator: int, denominator: int, fit_range: float, K_ratio: float = 1.0
) -> Fit:
    """Return the best pole-free rational polynomial over 401 uniform points of ``±fit_range``.

    The numerator is linear and therefore eliminated (variable projection, Golub & Pereyra 1973);
    the denominator is searched from deterministic starts. The problem has many local optima, about
    half of them with a pole inside the range: those are discarded. Raises `ModelError` if every
    optimum found has a pole inside the range; the message names it.
    """
    for name, degree in (("numerator", numerator), ("denominator", denominator)):
        whole(f"{name} degree", degree, 1, MAX_RATIONAL_DEGREE)
    name = f"ratpoly-{numerator}/{denominator} for gap {gap.label} mm"
    name += f", K_ratio = {K_ratio:g}" if K_ratio != 1.0 else ""
    candidates = rational_candidates(gap, numerator, denominator, fit_range, K_ratio)
    if _is_odd(gap, K_ratio):
        # The symmetric form first: it wins a tie and is then odd to the last bit.
        odd = rational_candidates(gap, numerator, denominator, fit_range, odd=True)
        candidates = odd + candidates
    return best_pole_free(candidates, fit_range, name)


def _mirrored(fit: Fit, scale: float) -> Fit:
    """Return the fit of ``-scale f(-x)``."""
    top, bottom = (np.array(each) for each in (fit.numerator, fit.denominator))
    top[::2] *= -1.0
    bottom[1::2] *= -1.0
    numerator = tuple((scale * top).tolist())
    return Fit(numerator, tuple(bottom.tolist()), scale * fit.rmse, fit.r_squared)


def best_pole_free(candidates: Sequence[Fit], fit_range: float, name: str) -> Fit:
    """Return the candidate with the smallest error that has no pole in the range.

    If errors are equal within rounding, the earlier candidate is returned.
    """
    pole_free = [
        c for c in candidates if np.isfinite(c.rmse) and not poles(c.denominator, fit_range)
    ]
    if not pole_free:
        best = min(candidates, key=lambda c: np.nan_to_num(c.rmse, nan=np.inf))
        where = ", ".join(f"{1e3 * p:.4g}" for p in poles(best.denominator, fit_range))
        raise ModelError(
            f"{name}: the best fit on ±{1e3 * fit_range:g} mm has a pole at x = {where} mm; "
            "choose other degrees"
        )
    lowest = min(c.rmse for c in pole_free)
    return next(c for c in pole_free if c.rmse <= lowest * _SAME_RMSE)


def poles(denominator: tuple[float, ...], fit_range: float) -> list[float]:
    """Real roots of the denominator in ``±fit_range`` or just outside it [m], ascending."""
    # Vanishing leading coefficients would put spurious roots at infinity.
    roots = chebyshev.chebroots(chebyshev.chebtrim(np.asarray(denominator), tol=1e-14))
    real = roots.real[np.abs(roots.imag) < 1e-7]
    return [float(r) * fit_range for r in np.sort(real) if abs(r) <= 1.0 + _OUTSIDE]


def _is_odd(gap: Gap, K_ratio: float) -> bool:
    """Whether the force is odd in x: walls of equal stiffness and distance."""
    return gap.is_symmetric and K_ratio == 1.0


@lru_cache(maxsize=256)
def rational_candidates(
    gap: Gap,
    numerator: int,
    denominator: int,
    fit_range: float,
    K_ratio: float = 1.0,
    *,
    odd: bool = False,
) -> tuple[Fit, ...]:
    """Local optima of the rational fit, one per initial denominator, also those with poles.

    `odd`: use only the terms of an odd function: odd ones in the numerator, even ones below.
    """
    if K_ratio and (gap.j_1, K_ratio) > (gap.j_2, 1.0):
        # Optima are found to 1e-8 only: mirror images have the coefficients of one search.
        image = Gap(gap.j_2, gap.j_1), numerator, denominator, fit_range, 1.0 / K_ratio
        return tuple(_mirrored(fit, K_ratio) for fit in rational_candidates(*image, odd=odd))
    top, bottom = np.arange(numerator + 1), np.arange(1, denominator + 1)
    if odd:
        top, bottom = top[top % 2 == 1], bottom[bottom % 2 == 0]
    problem = _Projection(gap, K_ratio, numerator, denominator, fit_range, top, bottom)
    return tuple(problem.fit(problem.minimise(d)) for d in problem.starts())


class _Projection:
    """Least-squares problem of a rational fit as a function of the denominator only."""

    def __init__(
        self,
        gap: Gap,
        K_ratio: float,
        n: int,
        m: int,
        fit_range: float,
        top: NDArray[np.intp],
        bottom: NDArray[np.intp],
    ) -> None:
        self.n, self.m, self.fit_range = n, m, fit_range
        self.top, self.bottom = top, bottom
        self.u = np.linspace(-1.0, 1.0, N_RATIONAL_POINTS)
        self.exact = unit_force(self.u * fit_range, gap, K_ratio) / fit_range
        self.numerator_basis = chebyshev.chebvander(self.u, n)[:, top]
        self.denominator_basis = chebyshev.chebvander(self.u, m)[:, bottom]

    def starts(self) -> list[Array]:
        """Initial denominators of the search: the constant one, then pole-free ones (seeded)."""
        rng = np.random.default_rng(_SEED)
        found = [np.zeros(self.bottom.size)]
        while len(found) < (_N_STARTS if self.bottom.size else 1):
            d = rng.uniform(-1.0, 1.0, self.bottom.size) * rng.uniform()
            if not self.has_pole(d):
                found.append(d)
        return found

    def has_pole(self, d: Array) -> bool:
        return bool(np.min(1.0 + self.denominator_basis @ d) <= 0.0)

    def denominator(self, d: Array) -> Array:
        values = 1.0 + self.denominator_basis @ d
        # A grid point may fall on a root while the search passes over it.
        return np.where(np.abs(values) < 1e-12, 1e-12, values)

    def columns(self, d: Array) -> Array:
        return np.asarray(self.numerator_basis / self.denominator(d)[:, None])

    def residual(self, d: Array) -> Array:
        orthonormal = np.linalg.qr(self.columns(d))[0]
        return np.asarray(self.exact - orthonormal @ (orthonormal.T @ self.exact))

    def jacobian(self, d: Array) -> Array:
        """Derivative of `residual`, shape (N_RATIONAL_POINTS, n); Golub & Pereyra's formula."""
        orthonormal = np.linalg.qr(self.columns(d))[0]
        fitted = orthonormal @ (orthonormal.T @ self.exact)
        by_column = self.denominator_basis / self.denominator(d)[:, None]
        moved, turned = by_column * fitted[:, None], by_column * (self.exact - fitted)[:, None]
        return np.asarray(moved + orthonormal @ (orthonormal.T @ (turned - moved)))

    def minimise(self, d: Array) -> Array:
        if not d.size:
            return d
        from scipy.optimize import least_squares  # slow to import, and most laws need no fit

        given: dict[str, Any] = {"xtol": 1e-12, "ftol": 1e-13, "gtol": 1e-14}
        return np.asarray(least_squares(self.residual, d, self.jacobian, method="lm", **given).x)

    def fit(self, d: Array) -> Fit:
        numerator, denominator = np.zeros(self.n + 1), np.zeros(self.m + 1)
        solution = np.linalg.lstsq(self.columns(d), self.exact, rcond=None)[0]
        numerator[self.top] = solution * self.fit_range
        denominator[0] = 1.0
        denominator[self.bottom] = d
        with np.errstate(all="ignore"):  # for fits with a pole, which are discarded later
            values = chebyshev.chebval(self.u, numerator) / chebyshev.chebval(self.u, denominator)
            rmse, r_squared = goodness(values, self.exact * self.fit_range)
        return Fit(tuple(numerator.tolist()), tuple(denominator.tolist()), rmse, r_squared)
