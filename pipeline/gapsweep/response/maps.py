"""The map over whole forcing periods, linearised: Newton steps and Floquet multipliers.

Of many motions at once, because arithmetic on one small matrix costs numpy more than the kernel
needs for its motion. No result depends on the others.
"""

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motion import VANISHED

Array = NDArray[np.float64]


def newton_steps(monodromy: Array, moved: Array) -> Array:
    """Steps from initial states towards fixed points of their maps; infinite where none is near.

    Parameters
    ----------
    monodromy : ndarray, shape (n, n_states, n_states)
        Derivatives of the ends by the starts, as section points.
    moved : ndarray, shape (n, n_states)
        Ends minus starts, as section points [m].

    Returns
    -------
    ndarray, shape (n, n_states)
    """
    matrices = np.eye(moved.shape[1]) - monodromy
    try:
        return np.asarray(np.linalg.solve(matrices, moved[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        return np.array(list(map(_solution, matrices, moved)))


def _solution(matrix: Array, right: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        return np.full(len(right), np.inf)


def floquet_multipliers(monodromy: Array, determinant: Array) -> NDArray[np.complex128]:
    """Eigenvalues of monodromy matrices, largest modulus first; NaN where the tangent overflowed.

    Two follow from the trace and from the determinant, which damping fixes: computed from the
    matrix it is lost in rounding where the two shrink differently, and with it the smaller one.
    Of more than two those are lost that rounding of the largest hides. What shrank to nothing is
    zero.

    Parameters
    ----------
    monodromy : ndarray, shape (n, n_states, n_states)
    determinant : ndarray, shape (n,)
        What the determinants are without error, >= 0.

    Returns
    -------
    ndarray of complex, shape (n, n_states)
    """
    is_finite = np.asarray(np.isfinite(monodromy).all(axis=(1, 2)))
    if monodromy.shape[1] == 2:
        found = _pairs(monodromy, determinant)
    else:
        found = np.linalg.eigvals(np.where(is_finite[:, None, None], monodromy, 0.0)).astype(
            complex
        )
        order = np.argsort(-np.abs(found), axis=1, kind="stable")
        found = np.take_along_axis(found, order, axis=1)
    found[np.abs(found) < VANISHED] = 0.0
    found[~is_finite] = complex(np.nan, np.nan)
    return found


def _pairs(monodromy: Array, determinant: Array) -> NDArray[np.complex128]:
    """Eigenvalues of 2 x 2 matrices, the larger first."""
    with np.errstate(all="ignore"):  # of tangents that overflowed or shrank to nothing
        half = 0.5 * np.trace(monodromy, axis1=1, axis2=2)
        # Where the trace is zero the two are imaginary.
        ratio = np.where(half == 0.0, np.inf, determinant / half / half)
        larger = half * (1.0 + np.sqrt(1.0 - ratio))
        smaller = np.where(larger == 0.0, 0.0, determinant / larger)
        height = np.sqrt((np.sqrt(determinant) - half) * (np.sqrt(determinant) + half))
    is_real = ratio <= 1.0
    found = np.empty((len(half), 2), complex)
    found.real = np.where(is_real, (larger, smaller), half).T
    found.imag = np.where(is_real, 0.0, (height, -height)).T
    return found
