"""Coefficients of the two explicit Runge-Kutta methods, in the form that the stepping loop uses.

Both end with a stage at the new point ("first same as last"). For x' = v, v' = f the position sums
are eliminated: with K_j the accelerations,

    X_i = x + c_i h v + h^2 sum_j abar_ij K_j,   V_i = v + h sum_j a_ij K_j,   abar = a @ a,

which is the same method with half the storage, and whose X_i does not wait for K_{i-1}. Within the
step the motion is a polynomial whose coefficients are sums of the K_j as well (`Tableau.dense`).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853 as _DOP853
from scipy.integrate import RK45 as _RK45

Array = NDArray[np.float64]

E5, E3, OTHER_E5 = 0, 1, 2
DEGREE = 8  # of the polynomials between steps


class Tableau(NamedTuple):
    """A Runge-Kutta pair for the compiled loop."""

    # Stages of a step; the stages after them only serve the polynomials between steps.
    n_stages: int
    # `a`, `abar`: shape (n_all, n_all); weights of the stage velocities and of the stage
    # displacements (`a @ a`) [-].
    a: Array
    abar: Array
    c: Array  # shape (n_all,); nodes [-]
    # `e`, `ebar`: shape (3, n_stages); weights of the error estimates of v and x, in the rows `E5`,
    # `E3` and `OTHER_E5`; the last two are zero for a pair with one estimate.
    e: Array
    ebar: Array
    # `dense`, `dense_bar`: shape (n_all, DEGREE + 1); coefficients, by powers of the part of the
    # step, of the weights of ``h K_j`` in a rate's integral within the step, and of ``h^2 K_j`` in
    # x.
    dense: Array
    dense_bar: Array
    exponent: float  # step factors grow as error ** -exponent: one over (order of the estimate + 1)
    order: int  # order of the advancing formula


def _rows(*parts: Array) -> Array:
    """Join the rows of all stages in one matrix; shorter rows are padded with zeros."""
    rows = [row for part in parts for row in np.atleast_2d(part)]
    return np.array([np.pad(row, (0, len(rows) - len(row))) for row in rows])


def _product(a: Array, b: Array) -> Array:
    """Matrix product whose sums are rounded once: those of BLAS depend on the processor."""
    return np.array([[math.fsum(row * column) for column in b.T] for row in a])


def _tableau(
    a: Array, n_stages: int, estimates: list[Array], dense: Array, exponent: float, order: int
) -> Tableau:
    e = np.zeros((3, n_stages))
    e[: len(estimates)] = estimates
    # x is the integral of v within the step. Its difference from x at the end, of the size of the
    # step's error, is spread over the step so that x, v and acceleration at both ends are kept.
    dense[:, 1] = np.eye(len(a))[0]  # it is, but for rounding
    dense_bar = np.zeros_like(dense)
    dense_bar[:, 1:] = dense[:, :-1] / np.arange(1, DEGREE + 1)
    abar = _product(a, a)
    missed = abar[n_stages - 1] - dense_bar.sum(axis=1)
    dense_bar[:, 3:6] += np.outer(missed, [10.0, -15.0, 6.0])
    ebar = _product(e, a[:n_stages, :n_stages])
    c = np.array([math.fsum(row) for row in a])
    return Tableau(n_stages, a, abar, c, e, ebar, dense, dense_bar, exponent, order)


def _dense_8() -> Array:
    """Weights of all stages in the interpolant of order 7 that belongs to DOP853 (section II.6)."""
    weights = np.zeros((7, len(_A_8)))
    weights[0] = _A_8[12]
    weights[1, 0] = 1.0
    weights[1] -= weights[0]
    weights[2] = 2.0 * weights[0]
    weights[2, [0, 12]] -= 1.0
    weights[3:] = _DOP853.D
    total = np.zeros((len(_A_8), DEGREE + 1))
    for i, row in enumerate(weights[::-1]):  # s (.. + s (w_4 + (1 - s) (w_5 + s w_6)))
        total[:, 0] += row
        times_s = np.roll(total, 1, axis=1)
        total = times_s if i % 2 == 0 else total - times_s
    return total


# Dormand & Prince, J. Comput. Appl. Math. 6 (1980) 19-26: the pair of ode45, with its interpolant.
_A_5 = _rows(_RK45.A, _RK45.B)
_DENSE_5 = np.pad(_RK45.P, ((0, 0), (1, DEGREE - _RK45.P.shape[1])))

# Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I (2nd ed.), section II.5:
# order 8 with estimates of order 5 and 3, combined as e5^2 / sqrt(e5^2 + 0.01 e3^2).
_A_8 = _rows(_DOP853.A, _DOP853.B, _DOP853.A_EXTRA)
# Among combinations of stages that vanish up to order 5, the one whose errors of order 6 are as
# large as those of the first estimate and orthogonal to them, as sums over the 20 rooted trees:
# nearly half of the difference of the two derivatives at the end of a step.
_OTHER_E5 = np.zeros(13)
_OTHER_E5[[0, *range(5, 13)]] = [
    -0.0039411232413551152,
    -0.047182942829604208,
    0.065576635211826396,
    -0.038657288205519292,
    -0.072708459906989351,
    0.096427420121502772,
    -0.0016768011031598717,
    -0.49807590786217684,
    0.50023846781547551,
]

DP5 = _tableau(_A_5, 7, [_RK45.E], _DENSE_5, exponent=1 / 5, order=5)
DOP853 = _tableau(
    _A_8, 13, [_DOP853.E5, _DOP853.E3, _OTHER_E5], _dense_8(), exponent=1 / 8, order=8
)
