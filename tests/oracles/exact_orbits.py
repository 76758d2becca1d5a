"""Periodic orbits and their bifurcations by exact propagation, independent of gapsweep's code.

Shared by `tests/physics/test_branches_of_orbits.py`, `benchmarks/branches.py` and
`tests/oracles/random_branches.py`.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from scipy.optimize import brentq, root

import gapsweep as gs
from tests.builders.random_oscillators import random_cases
from tests.oracles import piecewise_linear as exact

KINDS = ("fold", "period_doubling", "torus", "branch_point", "grazing", "symmetry_breaking")
TURN = 2.0 * math.pi
_DIFFERENCE = 1e-6  # of the parameter, for central differences
_CLOSED = 1e-11  # relative Newton step of an orbit


def exact_system(model: gs.Oscillator | gs.System, law: gs.Piecewise) -> exact.System:
    """The equations of a model whose contacts share one contact law."""
    if isinstance(model, gs.Oscillator):
        m, k = model.mass, model.mass * (TURN * model.omega_n) ** 2
        c = 2.0 * model.zeta * math.sqrt(k * m) + model.c
        matrices, directions = {"M": [[m]], "C": [[c]], "K": [[k]]}, [np.ones(1)]
        loads = [exact.Harmonic(np.array([model.forcing]))]
        assert model.alpha == 0.0
    else:
        matrices = {"M": model.mass, "C": model.damping, "K": model.stiffness}
        if model.lags is not None:
            names = ("force", "of_speed", "of_place", "of_lags")
            matrices |= dict(zip("DEGH", (getattr(model.lags, n) for n in names), strict=True))
        directions = [*model.contacts.values()]
        loads = [exact.Harmonic(np.array(h.amplitude), h.k, h.phase) for h in model.forcing]
    lower = law.gap.j_1 if law.K_ratio else 1e3  # crossings of a wall without a spring are none
    contacts = [exact.Contact(b, law.K_c, lower, law.gap.j_2, law.K_ratio) for b in directions]
    return exact.System(
        **{name: np.array(value, float) for name, value in matrices.items()},
        contacts=tuple(contacts),
        harmonics=tuple(loads),
    )


@dataclass(frozen=True)
class Point:
    """A periodic orbit of the exact motion."""

    unknowns: np.ndarray  # state, parameter, and the period [s] where nothing forces the system
    monodromy: np.ndarray
    n_crossings: int
    clearance: float  # smallest distance of a turning point of a gap from a wall [m]

    @property
    def multipliers(self) -> np.ndarray:
        return np.linalg.eigvals(self.monodromy)


@dataclass(frozen=True)
class Exact:
    """Orbits of a piecewise-linear family, one parameter value at a time.

    Parameters
    ----------
    system : callable
        Returns the equations and the forcing frequency [Hz] for a parameter value.
    multiple : int
        Forcing periods in one response period; 0: nothing forces the system.
    is_halved : bool
        Whether orbits are symmetric: after half a period the state has the other sign. Symmetry
        breaks where a multiplier of that half is -1, which is called a period doubling here.
    """

    system: Callable[[float], tuple[exact.System, float]]
    multiple: int
    is_halved: bool = False

    def motion(self, unknowns: np.ndarray) -> exact.Motion:
        free = int(self.multiple == 0)
        end = len(unknowns) - 1 - free
        system, omega = self.system(unknowns[end])
        period = unknowns[-1] if free else self.multiple / omega
        state, n = unknowns[:end], system.n
        period *= 0.5 if self.is_halved else 1.0
        end = exact.motion(system, omega, state[:n], state[n : 2 * n], state[2 * n :], period)
        if not self.is_halved:
            return end
        return replace(end, q=-end.q, v=-end.v, z=-end.z, monodromy=-end.monodromy)

    def orbit(self, guess: np.ndarray, normals: np.ndarray) -> Point:
        """The orbit on the planes through a guess with some normals, by Newton's method.

        Derivatives by the parameter and the period are those of the guess.
        """
        z, n = guess.copy(), len(guess) - 1 - (self.multiple == 0)
        scale = np.maximum(np.abs(guess), 1e-3 * np.abs(guess[:n]).max())
        jacobian = np.zeros((len(z), len(z)))
        jacobian[n:] = normals
        for k in range(n, len(z)):
            step = np.zeros(len(z))
            step[k] = _DIFFERENCE * abs(z[k])
            change = self.motion(z + step).state - self.motion(z - step).state
            jacobian[:n, k] = change / (2.0 * step[k])
        for _ in range(30):
            found = self.motion(z)
            jacobian[:n, :n] = found.monodromy - np.eye(n)
            right = np.concatenate([found.state - z[:n], normals @ (z - guess)])
            step = -np.linalg.solve(jacobian * scale, right) * scale
            z = z + step
            if np.abs(step / scale).max() <= _CLOSED:
                return Point(z, found.monodromy, found.n_crossings, found.clearance)
        raise RuntimeError(f"no orbit near {guess}: last step {np.abs(step / scale).max():.1e}")

    def crossing(self, before: np.ndarray, after: np.ndarray, kind: str) -> Point:
        """The special point between two orbits of a branch, on planes across their chord."""
        size = np.maximum(np.abs(before), np.abs(after)) ** 2 + 1e-300
        normals = ((after - before) / size)[None, :]
        if not self.multiple:  # of a cycle: where its phase is that of the chord
            rate = (self.shortly_after(before) - before[:-2]) / size[:-2]
            normals = np.vstack([normals, np.append(rate, [0.0, 0.0])])
        normals /= np.sqrt((normals**2).sum(axis=1))[:, None]

        def orbit(s: float) -> Point:
            return self.orbit(before + s * (after - before), normals)

        n_crossings = orbit(0.0).n_crossings

        def value(s: float) -> float:
            point = orbit(s)
            if kind == "grazing":  # how near the turning point is, on which side of the wall
                sign = 1.0 if point.n_crossings == n_crossings else -1.0
                return sign * min(point.clearance, abs(before[0]))
            if kind == "fold" and not self.multiple:
                return _fold_of_cycles(point.monodromy)
            return _TESTS[kind](point.monodromy)

        return orbit(brentq(value, 0.0, 1.0, xtol=1e-11))

    def shortly_after(self, unknowns: np.ndarray) -> np.ndarray:
        """State after a small part of the period."""
        return (
            replace(self, is_halved=False)
            .motion(unknowns * [*np.ones(len(unknowns) - 1), 1e-4])
            .state
        )


def _fold(monodromy: np.ndarray) -> float:
    return float(np.linalg.det(monodromy - np.eye(len(monodromy))))


def _fold_of_cycles(monodromy: np.ndarray) -> float:
    """Product of 1 - μ of all multipliers but the one along the cycle."""
    return float(np.polyval(np.polyder(np.poly(monodromy)), 1.0))


def _doubling(monodromy: np.ndarray) -> float:
    return float(np.linalg.det(monodromy + np.eye(len(monodromy))))


def _torus(monodromy: np.ndarray) -> float:
    mu = np.linalg.eigvals(monodromy)
    i, j = np.triu_indices(len(mu), 1)
    return float(np.prod(1.0 - mu[i] * mu[j]).real)


_TESTS = {"fold": _fold, "period_doubling": _doubling, "torus": _torus}


# --- Branches as gapsweep returns them ----------------------------------------------------------


def kinds(branch: xr.Dataset) -> np.ndarray:
    """Names of the special points of a branch's orbits; "none" of an ordinary orbit."""
    names = np.array(branch["special"].attrs["flag_meanings"].split())
    return names[branch["special"].values]


def rows(ds: xr.Dataset, branch: int) -> xr.Dataset:
    """The orbits of one branch."""
    return ds.isel(branch=branch, step=slice(0, int(ds["n_orbits"][branch])))


def special_points(branch: xr.Dataset) -> list[tuple[str, int]]:
    """Kinds and steps of the special points of a branch, in its order."""
    found = kinds(branch)
    return [(str(found[i]), int(i)) for i in np.flatnonzero(found != "none")]


def multipliers(branch: xr.Dataset) -> np.ndarray:
    return branch["multiplier_real"].values + 1j * branch["multiplier_imag"].values


def unknowns(branch: xr.Dataset, step: int) -> np.ndarray:
    """State and parameter of an orbit, and its period where nothing forces it."""
    row = branch.isel(step=step)
    found = [*row["start_state"].values, float(row[branch.attrs["along"]])]
    is_forced = branch.attrs["along"] == "omega" or "forcing_frequency" in branch.attrs
    return np.array(found if is_forced else [*found, float(row["period"])])


def located(branch: xr.Dataset, step: int, orbits: Exact) -> Point:
    """The special point at a step of a branch, from the orbits before and after it."""
    kind, along = str(kinds(branch)[step]), branch.attrs["along"]
    # A fold or a graze may stand within rounding of its neighbours: orbits that are farther away.
    point = branch[along].values[step]
    first, last = step - 1, step + 1
    while abs(branch[along].values[first] / point - 1.0) < 1e-12:
        first -= 1
    return orbits.crossing(unknowns(branch, first), unknowns(branch, last), kind)


# --- Symmetric orbits between two walls in closed form ------------------------------------------


def trilinear(
    model: gs.Oscillator, law: gs.Piecewise, omega: float, guess: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """A symmetric orbit that touches each of two equal walls once a period.

    It enters the upper wall at forcing phase φ with velocity v and leaves it after a time τ with
    velocity w; half a period after the entry it enters the lower wall with velocity -v. The four
    equations hold exponentials of both linear motions, and nothing is integrated.

    Parameters
    ----------
    guess : ndarray, shape (4,)
        φ [rad], v [m/s], τ [s], w [m/s].

    Returns
    -------
    ndarray, shape (2,)
        State at forcing phase zero.
    float
        Largest displacement [m].
    ndarray, shape (4,)
        The solution.
    """
    m, j, w = model.mass, law.gap.j_2, TURN * omega
    k = m * (TURN * model.omega_n) ** 2
    c = 2.0 * model.zeta * math.sqrt(k * m) + model.c
    decay = c / (2.0 * m)

    def motion(t, phase, x, v, stiffness, offset):
        """State at time t from (x, v) at a forcing phase, on a spring with equilibrium `offset`."""
        response = model.forcing / (stiffness - m * w**2 + 1j * c * w)
        rate = np.sqrt(complex(stiffness / m - decay**2))
        forced = [response * np.exp(1j * angle) for angle in (phase, phase + w * t)]
        a, b = x - offset - forced[0].real, v - (1j * w * forced[0]).real
        roots = -decay + 1j * rate, -decay - 1j * rate
        parts = (b - roots[1] * a) / (2j * rate), (roots[0] * a - b) / (2j * rate)
        free = [part * np.exp(r * t) for part, r in zip(parts, roots, strict=True)]
        speeds = [r * each for r, each in zip(roots, free, strict=True)]
        return np.array(
            [
                offset + sum(free).real + forced[1].real,
                sum(speeds).real + (1j * w * forced[1]).real,
            ]
        )

    def in_wall(t, phase, v):
        return motion(t, phase, j, v, k + law.K_c, law.K_c * j / (k + law.K_c))

    def equations(u):
        phase, v, t, v_out = u * scale
        (x_1, v_1), (x_2, v_2) = (
            in_wall(t, phase, v),
            motion(math.pi / w - t, phase + w * t, j, v_out, k, 0.0),
        )
        return [x_1 / j - 1.0, (v_1 - v_out) / (w * j), x_2 / j + 1.0, (v_2 + v) / (w * j)]

    scale = np.array([1.0, w * j, 1.0 / w, w * j])
    found = root(equations, guess / scale, tol=1e-14)
    phase, v, t, v_out = found.x * scale
    assert np.abs(found.fun).max() < 1e-12, found.message
    # From the entry on to forcing phase 0 or π, whose states differ by their signs.
    left, sign = -phase / w, 1.0
    while left < 0.0:
        left, sign = left + math.pi / w, -sign
    while left > math.pi / w:
        left, sign = left - math.pi / w, -sign
    state = (
        in_wall(left, phase, v) if left <= t else motion(left - t, phase + w * t, j, v_out, k, 0.0)
    )
    top = brentq(lambda time: in_wall(time, phase, v)[1], 0.0, t, xtol=1e-15)
    return sign * state, float(in_wall(top, phase, v)[0]), found.x * scale


def trilinear_guess(model: gs.Oscillator, law: gs.Piecewise, omega: float, state) -> np.ndarray:
    """Guess of `trilinear` from a state at forcing phase zero, by exact propagation."""
    system = exact_system(model, law)
    found = exact.motion(system, omega, state[:1], state[1:], (), 2.0 / omega)
    crossings = found.crossings
    entry = next(i for i, each in enumerate(crossings) if each.is_entry and each.wall > 0)
    t, after = crossings[entry].t, crossings[entry + 1].t
    v, w = (
        float(exact.motion(system, omega, state[:1], state[1:], (), time).v[0])
        for time in (t, after)
    )
    return np.array([TURN * omega * t, v, after - t, w])


def trilinear_cases(n: int, seed: int) -> Iterator[tuple[gs.Oscillator, gs.Piecewise, float]]:
    """Oscillators between equal walls that symmetric orbits touch, and forcing frequencies."""
    rng = np.random.default_rng(seed)

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    for _ in range(n):
        model = gs.systems.paper_oscillator(
            zeta=log(0.01, 0.2), omega_n=log(0.5, 20.0), mass=log(0.1, 10.0), alpha=0.0
        )
        stiffness = model.mass * (TURN * model.omega_n) ** 2
        j = log(1e-4, 1e-2)
        model = gs.Oscillator(
            zeta=model.zeta,
            omega_n=model.omega_n,
            mass=model.mass,
            alpha=0.0,
            forcing=stiffness * j * log(1.0, 3.0),
        )
        yield (
            model,
            gs.Piecewise(stiffness * log(0.5, 100.0), gs.Gap(j, j)),
            model.omega_n * log(0.9, 1.6),
        )


def is_trilinear(branch: xr.Dataset) -> np.ndarray:
    """Mask of a branch's symmetric orbits that touch each wall once in a forcing period."""
    x_max, x_min = branch["x_max"].values, branch["x_min"].values
    is_once = (branch["n_contacts"].values == 4) & (branch["period_multiple"].values == 1)
    return is_once & (np.abs(x_max + x_min) < 1e-7 * x_max)


def trilinear_error(
    model: gs.Oscillator, law: gs.Piecewise, branch: xr.Dataset, step: int
) -> float:
    """Relative error of an orbit's start state and largest displacement."""
    state, omega = branch["start_state"].values[step], float(branch["omega"][step])
    truth, x_max, _ = trilinear(model, law, omega, trilinear_guess(model, law, omega, state))
    size = x_max * np.array([1.0, TURN * omega])
    errors = np.append((state - truth) / size, branch["x_max"].values[step] / x_max - 1.0)
    return float(np.abs(errors).max())


# --- Invariants ---------------------------------------------------------------------------------


def drawn_branches(n: int, seed: int, max_steps: int) -> Iterator[tuple[object, xr.Dataset]]:
    """Branches of random oscillators between walls about their forcing frequency."""
    for case in random_cases(n, seed):
        window = 0.7 * case.omega, 1.5 * case.omega
        about = {"between": window, "at": case.omega, "max_steps": max_steps}
        if gs.respond(case.oscillator, case.law, case.omega).period_multiple:
            yield case, gs.branches(case.oscillator, case.law, **about)


def unexplained(branch: xr.Dataset) -> list[str]:
    """Changes between orbits of a branch that no special point between them explains.

    A jump to another branch, or a special point that was missed, changes how many multipliers
    leave the unit circle at 1, at -1 or as a pair, or how often walls are crossed.
    """
    names, mu = kinds(branch), multipliers(branch)
    n_contacts = branch["n_contacts"].values
    value = branch[branch.attrs["along"]].values
    at_minus_one = np.abs(mu + 1.0).min(axis=1) < np.abs(mu - 1.0).min(axis=1)
    is_real = np.abs(mu.imag) < 1e-9
    above = (is_real & (mu.real > 1.0)).sum(axis=1)
    below = (is_real & (mu.real < -1.0)).sum(axis=1)
    outside = (np.abs(mu) > 1.0).sum(axis=1)
    found, ordinary = [], np.flatnonzero(names == "none")
    for a, b in itertools.pairwise(ordinary.tolist()):
        here = slice(a + 1, b)
        is_flip = (names[here] == "period_doubling") & at_minus_one[here]
        is_unit = np.isin(names[here], ("fold", "branch_point", "symmetry_breaking"))
        # Where branches of half the period cross, a multiplier of the double period is 1.
        is_unit |= (names[here] == "period_doubling") & ~is_flip
        changes = {
            "multipliers above 1": (above[b] - above[a] - is_unit.sum()) % 2,
            "multipliers below -1": (below[b] - below[a] - is_flip.sum()) % 2,
            "unstable multipliers": outside[a] != outside[b] and not set(names[here]) - {"grazing"},
            "wall crossings": n_contacts[a] != n_contacts[b] and "grazing" not in names[here],
        }
        where = f"{value[a]:.9g} to {value[b]:.9g}, {names[here].tolist()}"
        found += [f"{what}: {where}" for what, is_wrong in changes.items() if is_wrong]
    return found


def largest_step(branch: xr.Dataset) -> float:
    """Largest change of parameter or state from one orbit to the next, as a part of its range."""
    along = branch[branch.attrs["along"]].values
    low, high = branch.attrs["between"]
    state = branch["start_state"].values
    steps = [np.abs(np.diff(along)).max() / (high - low)]
    if "omega" in (branch.attrs["along"],) or "forcing_frequency" in branch.attrs:
        steps.append((np.abs(np.diff(state, axis=0)) / np.abs(state).max(axis=0)).max())
    return float(max(steps))


def return_error(model: gs.Oscillator, law: gs.Piecewise, branch: xr.Dataset, step: int) -> float:
    """Distance of an orbit's state from itself after one period, relative to its size.

    Divided by the norm of its monodromy matrix: errors of the start state grow by that.
    """
    row = branch.isel(step=step)
    omega, state = float(row["omega"]), row["start_state"].values
    run = gs.simulate(
        model, law, omega, *state, t_end=float(row["period"]), rtol=1e-12, atol=1e-16, tangent=True
    )
    unit = float(row["x_max"]) * np.array([1.0, TURN * omega])
    growth = np.linalg.norm(run.monodromy * unit[None, :] / unit[:, None], 2)
    return float((np.abs([run.x_end, run.v_end] - state) / unit).max() / max(1.0, growth))
