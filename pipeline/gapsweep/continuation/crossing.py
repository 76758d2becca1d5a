"""Crossings of two branches by Newton's method, with both tangents.

At a crossing the equations R(u) = 0 have derivatives J of rank one less than their number. With a
left null vector ψ it is a regular zero of [1]_ ::

    R(u) + β ψ = 0,    Jᵀ ψ = 0,    ψ · ψ = 1

also where a small asymmetry β keeps the branches apart. The residual β then tells both cases from
each other: orbits on either side do not. The tangents v solve ``v · Q v = 0`` with the
second derivatives Q of ``ψ · R`` on the two null vectors of J; two branches cross if Q is
indefinite.

.. [1] G. Moore, Numer. Funct. Anal. Optim. 2 (1980) 441-472.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation import thresholds as limit
from gapsweep.continuation.locate import Step
from gapsweep.continuation.orbits import Evaluation, Orbit, OrbitEquations, Reference

Array = NDArray[np.float64]


def crossing(equations: OrbitEquations, step: Step) -> Orbit | None:
    """The orbit of a step at which another branch crosses; None where no crossing is located.

    Its tangent is along the step, `Orbit.across` along the other branch.
    """
    a, b = step.before.branching, step.after.branching
    u = step.point(a / (a - b))
    size = float(np.clip(0.01 * step.size, 10.0 * limit.SMALLEST, limit.SECOND_DIFFERENCE))
    found = _solved(equations, u, step, size)
    if found is None:
        return None
    u, second, evaluation = found
    _, singular, rows = np.linalg.svd(evaluation.jacobian[0])
    if singular[-1] > limit.SINGULAR * singular[-2]:
        return None
    plane = rows[-2:]
    values, vectors = np.linalg.eigh(plane @ second @ plane.T)
    if not values[0] < 0.0 < values[1]:
        return None
    large, small = np.sqrt(values[1]) * vectors[:, 0], np.sqrt(-values[0]) * vectors[:, 1]
    tangents = np.array([large + small, large - small]) @ plane
    tangents /= np.sqrt((tangents**2).sum(axis=1))[:, None]
    along = tangents @ step.chord
    own = int(np.abs(along).argmax())
    tangent, across = np.sign(along[own]) * tangents[own], tangents[1 - own]
    (orbit,) = equations.orbits(
        u[None, :], tangent[None, :], step.reference, evaluation, np.zeros(1, np.intp)
    )
    return replace(orbit, across=across)


def _solved(
    equations: OrbitEquations, u: Array, step: Step, size: float
) -> tuple[Array, Array, Evaluation] | None:
    """Unknowns of the crossing of a step, second derivatives, and the equations there."""
    d, first, psi, beta, length = len(u), u, np.empty(0), 0.0, np.inf
    for k in range(limit.NEWTON_STEPS):
        evaluation, jacobians, moved = _derivatives(equations, u, step.reference, size)
        if evaluation is None:
            return None
        residual, jacobian = evaluation.residual[0], evaluation.jacobian[0]
        if not psi.size:
            psi = np.linalg.svd(jacobian)[0][:, -1]
            beta = -float(psi @ residual)
        second = (jacobians[:d] - jacobians[d:]).transpose(0, 2, 1) @ psi / moved[:, None]
        # Derivatives by the parameter are differences: theirs in turn are rounding.
        second[:-1, -1] = second[-1, :-1]
        matrix = np.zeros((2 * d, 2 * d))
        matrix[: d - 1, :d], matrix[: d - 1, d] = jacobian, psi
        matrix[: d - 1, d + 1 :] = beta * np.eye(d - 1)
        matrix[d - 1 : -1, :d], matrix[d - 1 : -1, d + 1 :] = second, jacobian.T
        matrix[-1, d + 1 :] = 2.0 * psi
        right = np.concatenate([residual + beta * psi, jacobian.T @ psi, [psi @ psi - 1.0]])
        try:
            change = -np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            return None
        u, beta, psi = u + change[:d], beta + float(change[d]), psi + change[d + 1 :]
        far = float(np.sqrt(((u - first) ** 2).sum()))
        if not far <= step.size:
            return None
        before, length = length, float(np.abs(change[:d]).max())
        is_last = k == limit.NEWTON_STEPS - 1 and length <= limit.NEARLY  # rounding is left
        if max(before, length) <= limit.CROSSING_STEP or is_last:  # two gain the last digits
            last = equations.evaluate(u[None, :], step.reference)
            scale = 1.0 + float(np.abs(last.jacobian[0, :, :-1]).max())
            closes = last.is_ok[0] and np.abs(last.residual[0]).max() <= limit.RESIDUAL * scale
            return (u, second, last) if closes else None
    return None


def _derivatives(
    equations: OrbitEquations, u: Array, reference: Reference, size: float
) -> tuple[Evaluation | None, Array, Array]:
    """Equations at unknowns; their derivatives a little to either side, and how far apart."""
    d = len(u)
    shifted = u + size * np.concatenate([np.zeros((1, d)), np.eye(d), -np.eye(d)])
    shifted[:, -1] = np.clip(shifted[:, -1], 0.0, 1.0)
    moved = np.diagonal(shifted[1 : d + 1] - shifted[d + 1 :])
    found = equations.evaluate(
        shifted, reference.take(np.zeros(2 * d + 1, int)), limit.CROSSING_DIFFERENCE
    )
    return (found if found.is_ok.all() else None), found.jacobian[1:], moved
