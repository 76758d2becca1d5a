"""Compiled loops of the search: numpy needs longer for a few points than the engine for motions.

Every function treats each point for itself, so that no result depends on the other points.
"""

import math

import numpy as np

from gapsweep.integrate.jit import entry, internal
from gapsweep.integrate.motions import VANISHED
from gapsweep.response.thresholds import (
    AS_GOOD,
    CONTRACTION_POINTS,
    LEAST_CONTRACTION,
    NEWTON_STEPS,
    SHORT_STEP,
    SHORTENED,
    STRETCHED,
)

# Largest relative error of a tangent's determinant. Below the second share of the tangent's size,
# to the power of the number of states, a determinant is rounding.
_UNSOUND, _ROUNDING = 1e-2, 1e-3


@internal
def _norm(vector):
    """Euclidean norm; the sum has the order of `section.norm`."""
    total = vector[0] * vector[0]
    for i in range(1, len(vector)):
        total += vector[i] * vector[i]
    return math.sqrt(total)


@entry
def multiplier_pairs(monodromy, determinant):
    """Return the eigenvalues of 2 x 2 matrices from their traces and determinants.

    Parameters
    ----------
    monodromy : array, shape (n, 2, 2)
    determinant : array, shape (n,)
        Exact determinants, >= 0.

    Returns
    -------
    ndarray of complex, shape (n, 2)
        The larger modulus first; zero below the smallest normal numbers, NaN where the matrix is
        not finite.
    """
    found = np.empty((len(monodromy), 2), np.complex128)
    for k in range(len(monodromy)):
        if not np.isfinite(monodromy[k]).all():
            found[k] = complex(np.nan, np.nan)
            continue
        exact, half = determinant[k], 0.5 * (monodromy[k, 0, 0] + monodromy[k, 1, 1])
        # Where the trace is zero the two are imaginary.
        ratio = np.inf if half == 0.0 else exact / half / half
        if ratio <= 1.0:
            larger = half * (1.0 + math.sqrt(1.0 - ratio))
            smaller = 0.0 if larger == 0.0 else exact / larger
            found[k, 0], found[k, 1] = complex(larger, 0.0), complex(smaller, 0.0)
        else:
            root = np.sqrt(exact)
            height = np.sqrt((root - half) * (root + half))
            found[k, 0], found[k, 1] = complex(half, height), complex(half, 0.0 - height)
        for i in range(2):
            if abs(found[k, i]) < VANISHED:
                found[k, i] = 0.0
    return found


@entry
def determinants_agree(tangents, exact):
    """Whether determinants of tangents are those that damping determines, up to rounding.

    Directions shrink so differently that a determinant has a rounding error of the size of the
    tangent to the power of the number of states.

    Parameters
    ----------
    tangents : array, shape (n, n_states, n_states)
    exact : array, shape (n,)

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    found = np.zeros(len(tangents), np.bool_)
    for k in range(len(tangents)):
        square = 0.0
        for each in tangents[k].flat:
            square += each * each
        rounding = _ROUNDING * square ** (0.5 * tangents.shape[1])
        missed = abs(_determinant(tangents[k].copy()) - exact[k])
        found[k] = missed <= _UNSOUND * max(exact[k], rounding)
    return found


@internal
def _determinant(a):
    """Determinant of a matrix by elimination with row pivots; the matrix is overwritten."""
    n, found = len(a), 1.0
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            if abs(a[i, k]) > abs(a[p, k]):
                p = i
        if a[p, k] == 0.0:
            return 0.0
        if p != k:
            found = -found
            for j in range(n):
                a[k, j], a[p, j] = a[p, j], a[k, j]
        found *= a[k, k]
        for i in range(k + 1, n):
            share = a[i, k] / a[k, k]
            for j in range(k + 1, n):
                a[i, j] -= share * a[k, j]
    return found


@entry
def judge_steps(points, missed, steps, modulus, is_ok, is_sound, swing, shots):
    """Judge Newton steps of points: found, lost or neither; `shots` then has the next state.

    Parameters
    ----------
    points : int array, shape (m,)
    missed, steps : array, shape (m, n_states)
        Ends of motions minus initial states, and Newton steps, as section points [m].
    modulus : array, shape (m,)
        Largest moduli of multipliers.
    is_ok, is_sound : bool array, shape (m,)
        Whether a motion did not fail; whether its tangent has the determinant it must have.
    swing : array, shape (m,)
        As in `Call`.
    shots : tuple of array
        Columns of `NewtonShooting` with a row per point: moved, tries, last_step, apart, goal,
        noise, furthest.

    Returns
    -------
    is_found, goes_on : ndarray of bool, shape (m,)
    """
    moved, tries, last_step, last_apart, goals, noises, ranges = shots
    m, n_states = missed.shape
    is_found, goes_on = np.zeros(m, np.bool_), np.zeros(m, np.bool_)
    place = np.empty(n_states)
    for k in range(m):
        p = points[k]
        goal, noise, furthest = goals[p], noises[p], ranges[p]
        length, apart = _norm(steps[k]), _norm(missed[k])
        # Ends that meet are not enough: with weak contraction the orbit is much farther away.
        is_near = apart <= max(goal, noise)
        shortens = length < SHORTENED * last_step[p] or apart < SHORTENED * last_apart[p]
        is_at_best = is_near and not shortens and length <= SHORT_STEP * furthest
        found = is_ok[k] and (length <= goal or is_at_best) and is_sound[k]
        # Near an equilibrium, Newton's orbits shrink until they close within the noise.
        contraction = 1.0 - modulus[k]
        if contraction < LEAST_CONTRACTION:
            contraction = LEAST_CONTRACTION
        # an orbit taken as it is, with an infinite goal, does not move
        is_rest = swing[k] <= noise / contraction and math.isfinite(goal)
        is_found[k] = found and not is_rest
        tries[p] += 1
        last_step[p], last_apart[p] = length, apart
        for i in range(n_states):
            place[i] = moved[i, p] + steps[k, i]
        if (
            is_ok[k]
            and not is_found[k]
            and not is_rest
            and modulus[k] <= STRETCHED
            and _norm(place) <= furthest
            and tries[p] < NEWTON_STEPS
        ):
            goes_on[k] = True
            for i in range(n_states):
                moved[i, p] = place[i]
    return is_found, goes_on


@entry
def contracting_multiples(sections, lengths, points, closeness, same, largest):
    """Smallest n for which each section contracts to a repeat as well as for any n; 0 if none.

    Each of the last four points must be within `closeness` of the one n periods before, and either
    all within `same`, or the later two of them nearer than the farthest of those within `closeness`
    among up to `CONTRACTION_POINTS` points. After a doubled period, half of it may stay within
    `closeness` for ever: the whole one repeats much better.

    Parameters
    ----------
    sections : array, shape (n_states, n, longest)
        Section points [m].
    lengths : int array, shape (n,)
        Number of section points in each row.
    points : int array, shape (m,)
        Numbers of the rows.
    closeness : array, shape (m,)
        Distance [m] from which shooting is worth a try.
    same : array, shape (m,)
        Distance [m] within which the solver's noise decides which points are nearer.
    largest : int
        Largest n tried; n + 4 points are needed for n.

    Returns
    -------
    ndarray of int, shape (m,)
    """
    found, farthest = np.zeros(len(points), np.int64), np.empty(max(largest, 0))
    for k in range(len(points)):
        length = lengths[points[k]]
        n_tried, best = min(largest, length - 4), np.inf
        for n in range(1, n_tried + 1):
            farthest[n - 1] = _contraction(sections, points[k], length, n, closeness[k], same[k])
            best = min(best, farthest[n - 1])
        for n in range(1, n_tried + 1):
            if farthest[n - 1] <= AS_GOOD * best and best < np.inf:
                found[k] = n
                break
    return found


@internal
def _contraction(sections, p, length, n, closeness, same):
    """Distance of the last four points from those n periods before; infinite if they do not
    contract.
    """
    for j in range(4):
        i = length - 1 - j
        for c in range(len(sections)):
            if not abs(sections[c, p, i] - sections[c, p, i - n]) < closeness:
                return np.inf
    late = early = -1.0  # largest of the last two distances, and of those before
    farthest = 0.0
    for j in range(min(CONTRACTION_POINTS, length - n)):
        i, square = length - 1 - j, 0.0
        for c in range(len(sections)):
            moved = sections[c, p, i] - sections[c, p, i - n]
            square += moved * moved
        distance = math.sqrt(square)
        if not distance < closeness:
            # Points farther away belong to the approach, and the motion may leave again.
            if j < 4:
                return np.inf
            continue
        if j < 4:
            farthest = max(farthest, distance)
        if j < 2:
            late = max(late, distance)
        else:
            early = max(early, distance)
    return farthest if late <= early or farthest <= same else np.inf


@entry
def largest_parts(orbits, lengths, points, tolerance):
    """Largest proper divisor of an orbit's length after which the closed orbit repeats, else n.

    Parameters
    ----------
    orbits : array, shape (n_states, n, longest)
        Section points [m] of whole periods.
    lengths : int array, shape (n,)
        Number of section points in each row.
    points : int array, shape (m,)
        Numbers of the rows.
    tolerance : array, shape (m,)
        Largest distance [m] of two points, in any component, that count as the same.

    Returns
    -------
    ndarray of int, shape (m,)
    """
    found = lengths[points]
    for k in range(len(points)):
        for part in range(found[k] // 2, 0, -1):
            if found[k] % part == 0 and _repeats(orbits, points[k], found[k], part, tolerance[k]):
                found[k] = part
                break
    return found


@internal
def _repeats(orbits, p, n, part, tolerance):
    """Whether a closed orbit of n points is the same after `part` of them."""
    for c in range(len(orbits)):
        for i in range(n):
            before = i - part if i >= part else i - part + n
            if not abs(orbits[c, p, i] - orbits[c, p, before]) < tolerance:
                return False
    return True


@entry
def read_extrema(x, counts, is_closed, place, kinds):
    """Return the kinds of zero-velocity displacements, and the largest and smallest of each row.

    A point between the displacements of its neighbours is an inflection.

    Parameters
    ----------
    x : array
        Displacements [m], row by row in the order of time.
    counts : int array, shape (n,)
        Number of displacements of each row.
    is_closed : bool array, shape (n,)
        Rows whose first point follows the last one.
    place : array, shape (n,)
        Present displacements: those of rows without a point.
    kinds : tuple of int
        Numbers of a maximum, a minimum and an inflection.

    Returns
    -------
    kind : ndarray of int, shape (len(x),)
    largest, smallest : ndarray, shape (n,)
    """
    maximum, minimum, inflection = kinds
    kind, largest, smallest = np.full(len(x), inflection), place.copy(), place.copy()
    first = 0
    for row in range(len(counts)):
        last = first + counts[row] - 1
        for i in range(first, last + 1):
            before = x[i - 1] if i > first else x[last if is_closed[row] else min(first + 1, last)]
            after = x[i + 1] if i < last else x[first if is_closed[row] else max(last - 1, first)]
            if x[i] > before and x[i] > after:
                kind[i] = maximum
            elif x[i] < before and x[i] < after:
                kind[i] = minimum
            largest[row] = max(largest[row], x[i]) if i > first else x[i]
            smallest[row] = min(smallest[row], x[i]) if i > first else x[i]
        first = last + 1
    return kind, largest, smallest
