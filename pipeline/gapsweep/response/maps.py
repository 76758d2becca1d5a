"""The map over whole forcing periods, linearised: Newton steps and Floquet multipliers.

Of many motions at once, because arithmetic on one 2 x 2 matrix costs numpy more than the kernel
needs for its motion. No result depends on the others.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_IDENTITY = np.eye(2)


def newton_steps(monodromy: Array, moved: Array) -> Array:
    """Steps from initial states towards fixed points of their maps; infinite where none is near.

    Parameters
    ----------
    monodromy : ndarray, shape (n, 2, 2)
        Derivatives of the ends by the starts, as section points.
    moved : ndarray, shape (n, 2)
        Ends minus starts, as section points [m].

    Returns
    -------
    ndarray, shape (n, 2)
    """
    matrices = _IDENTITY - monodromy
    try:
        return np.asarray(np.linalg.solve(matrices, moved[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        return np.array(list(map(_solution, matrices, moved)))


def _solution(matrix: Array, right: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        return np.full(2, np.inf)


def floquet_multipliers(monodromy: Array) -> NDArray[np.complex128]:
    """Eigenvalues of monodromy matrices, largest modulus first; NaN where the tangent overflowed.

    Parameters
    ----------
    monodromy : ndarray, shape (n, 2, 2)

    Returns
    -------
    ndarray of complex, shape (n, 2)
    """
    if not np.isfinite(monodromy).all():
        is_finite = np.isfinite(monodromy).all(axis=(1, 2))
        found = np.full((len(monodromy), 2), complex(np.nan, np.nan))
        found[is_finite] = floquet_multipliers(monodromy[is_finite])
        return found
    found = np.linalg.eigvals(monodromy).astype(complex)
    modulus = np.abs(found)
    is_smaller_first = modulus[:, 0] < modulus[:, 1]
    found[is_smaller_first] = found[is_smaller_first, ::-1]
    return found
