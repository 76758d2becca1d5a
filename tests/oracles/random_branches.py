"""Random scenes for `gapsweep.branches`, and properties that every branch must have.

    python -m tests.oracles.random_branches 200 --seed 1 [--follow 1] [--steps 150]
    python -m tests.oracles.random_branches 1 --seed 1 --only 17
    python -m tests.oracles.random_branches --nearly

Prints a table of faults by kind, and each fault with the command that repeats it. The checks use no
code of `gapsweep.continuation`: orbits are integrated at rtol 1e-12, and a sample of
piecewise-linear orbits is propagated by matrix exponentials (`tests/oracles/piecewise_linear.py`).
"""

import argparse
import itertools
import math
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.optimize import root

import gapsweep as gs
from tests.oracles import piecewise_linear as exact
from tests.oracles.exact_orbits import kinds, multipliers, rows

TURN = 2.0 * math.pi
RTOL = 1e-12
CLOSES = 1e-8  # of an orbit's size: Newton's method ends at steps of 1e-10
# Of an orbit's size: a smaller distance after a part of the period is a return. Branches of doubled
# period have orbits down to 1e-8 from those of half the period where they begin in a kink.
PRIME = 1e-9
SAME = 1e-6  # of an orbit's size: nearer orbits at one parameter value are one
# Of a multiplier at a located point: 1e-4, and its slope along the branch times the distance within
# which an orbit closes: stiff walls have kinks in which a multiplier passes 100 within 1e-6 of the
# size. It is smooth in the arclength; only in the parameter it is a square root at a fold.
AT_ONE = 1e-4
ON_WALL = 1e-7  # of an orbit's size, of a turning point at a graze, and
GROWN = 1e-10  # for every unit of the monodromy matrix, which errors of the start grow by
BESIDE_GRAZE = 1e-8  # of the range: multipliers change at once there
APART = 1e-4  # of an orbit's size: of orbits that are sought on branches, to their neighbours
SYMMETRIC = 1e-5  # of an orbit's size: distance of the mirror image where symmetry breaks
HARD = 100.0  # walls so many times as stiff as the spring: multipliers jump at grazes
AT_HOPF = 1e-8  # of the parameter
SAMPLED = 12  # orbits of a branch that are sought on other branches
EXACT = 3  # orbits of a branch that are propagated by matrix exponentials

FAULTS = {
    "exception": "the call raises, other than 'no orbit'",
    "warning": "numpy's warnings",
    "not closed": f"orbit does not return within {CLOSES:g} after its period",
    "not closed, exact": "the same by matrix exponentials",
    "not prime": "orbit returns after a part of its period",
    "twice in a branch": "a branch holds an orbit twice",
    "closed loop overlaps": "a closed loop goes past its first orbit by a step",
    "on two branches": "two branches hold one orbit",
    "multiplier": "named point without its multiplier",
    "start": "a branch has no named point of its parent",
    "graze": f"no turning point within {ON_WALL:g} of a wall",
    "crossing without symmetry": "branch_point or symmetry_breaking of a machine without symmetry",
    "branch point": "branch_point of a symmetric machine",
    "asymmetric": "symmetry_breaking at an orbit that is not symmetric",
    "unexplained": "multipliers leave or enter the unit circle without a named point",
    "turn": "the parameter turns without a fold, or a fold does not turn it",
    "missed graze": "number of wall crossings changes without a graze",
    "multipliers": "stored multipliers are not those of the orbit",
    "stable": "stable differs from the multipliers",
    "equilibrium": "branch ends at, or passes, an equilibrium that is no Hopf point",
}


# --- Scenes -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scene:
    """Arguments of one call, and the facts about the machine that its checks use."""

    kind: str
    model: Any
    law: Any
    options: dict[str, Any]  # `along`, `between`, `at` and others
    is_symmetric: bool = False  # whether the mirror image of every motion is one
    ratio: float = 1.0  # stiffness of the hardest wall over that of the spring
    # Largest growth rate [1/s] of the equilibrium for a parameter value.
    equilibrium: Callable[[float], float] | None = None

    @property
    def along(self) -> str:
        return str(self.options["along"])

    def at(self, value: float) -> tuple[Any, Any, float | None]:
        """Model, contact law and forcing frequency at a parameter value."""
        model, law, along, omega = self.model, self.law, self.along, self.options.get("omega")
        if along == "omega":
            return model, law, value
        if along == "amplitude":
            return model, law, None
        if callable(model):
            return model(value), law, omega
        if along in ("K_c", "gap", "j_1", "j_2"):
            return model, _with(law, along, value), omega
        return replace(model, **{along: value}), law, omega

    def branches(self, **changes: Any) -> xr.Dataset:
        return gs.branches(self.model, self.law, **(self.options | changes))


def _with(law: Any, name: str, value: float) -> Any:
    if isinstance(law, dict):
        return {contact: _with(each, name, value) for contact, each in law.items()}
    if name == "K_c":
        return replace(law, K_c=value)
    gap = gs.Gap(value, value) if name == "gap" else replace(law.gap, **{name: value})
    return replace(law, gap=gap)


@dataclass
class Draw:
    """Random numbers of one scene."""

    rng: np.random.Generator

    def log(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(math.log(low), math.log(high))))

    def within(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def one(self, *choices: Any) -> Any:
        return choices[int(self.rng.integers(len(choices)))]

    def about(self, value: float, least: float, most: float) -> tuple[float, float]:
        """A window from a share of a value to a multiple of it."""
        return value * self.within(least, 0.5 * (1.0 + least)), value * self.within(
            0.5 * (1.0 + most), most
        )


def drawn(seed: int, number: int) -> Scene:
    """Scene `number` of a seed: its kind goes round, its numbers are random."""
    names = list(SCENES)
    draw = Draw(np.random.default_rng([seed, number]))
    kind = names[number % len(names)]
    scene = SCENES[kind](draw)
    follow = draw.one(0, 1, 1, 2)
    steps = {0: 250, 1: 150, 2: 80}[follow]
    options = {"follow": follow, "max_steps": steps} | scene.options
    return replace(scene, kind=kind, options=options)


def _machine(draw: Draw, walls: Callable[[float], gs.Gap], ratio: float, **laws: Any) -> Any:
    """An oscillator, its walls, stiffness of the spring and static deflection."""
    mass, omega_n, deflection = draw.log(0.1, 10.0), draw.log(0.5, 50.0), draw.log(1e-4, 3e-3)
    stiffness = mass * (TURN * omega_n) ** 2
    is_cubic = draw.within(0.0, 1.0) < 0.4
    oscillator = gs.Oscillator(
        mass=mass,
        omega_n=omega_n,
        zeta=draw.log(0.005, 0.1),
        alpha=stiffness / deflection**2 * draw.log(1e-2, 1.0) if is_cubic else 0.0,
        forcing=stiffness * deflection,
    )
    law = gs.Piecewise(stiffness * ratio, walls(deflection), **laws)
    return oscillator, law, stiffness, deflection


def _along(draw: Draw, oscillator: gs.Oscillator, law: Any, names: tuple[str, ...]) -> dict:
    """Parameter, its window and start, and the forcing frequency where it is another one."""
    omega = oscillator.omega_n * draw.log(0.35, 2.0)
    along = draw.one("omega", *names)
    value = {
        "omega": omega,
        "forcing": oscillator.forcing,
        "mass": oscillator.mass,
        "zeta": oscillator.zeta,
        "mean_load": oscillator.mean_load,
        "K_c": law.K_c,
        "gap": law.gap.j_2,
        "j_2": law.gap.j_2,
    }[along]
    shares = {"omega": (0.6, 1.5), "mass": (0.6, 1.6), "K_c": (0.2, 6.0)}
    low, high = draw.about(value, *shares.get(along, (0.3, 2.5)))
    options = {"along": along, "between": (low, high), "at": [value, draw.within(low, high)]}
    if along != "omega":
        options["omega"] = omega
    if draw.within(0.0, 1.0) < 0.6:
        x = law.gap.j_2 + law.gap.j_1 + oscillator.forcing / law.K_c
        starts = draw.rng.uniform(-1.0, 1.0, (3, 2)) * [2.0 * x, 2.0 * x * TURN * omega]
        options["starts"] = [[0.0, 0.0], *starts.tolist()]
    return options


def _asymmetric(draw: Draw) -> Scene:
    ratio = draw.log(2.0, 60.0)
    o, law, *_ = _machine(
        draw, lambda d: gs.Gap(d * draw.within(0.1, 1.0), d * draw.within(0.3, 2.0)), ratio
    )
    return Scene("", o, law, _along(draw, o, law, ("forcing", "K_c", "j_2", "mass")), ratio=ratio)


def _symmetric(draw: Draw) -> Scene:
    ratio = draw.log(2.0, 60.0)
    o, law, *_ = _machine(draw, lambda d: gs.Gap(*[d * draw.log(0.05, 2.0)] * 2), ratio)
    options = _along(draw, o, law, ("forcing", "K_c", "gap", "mass", "zeta"))
    return Scene("", o, law, options, is_symmetric=True, ratio=ratio)


def _nearly(draw: Draw) -> Scene:
    ratio, off = draw.log(2.0, 60.0), draw.one(1e-2, 1e-3, 1e-4, 1e-5)
    share = draw.log(0.05, 2.0)
    o, law, *_ = _machine(draw, lambda d: gs.Gap(*[d * share] * 2), ratio)
    if draw.one(True, False):
        law = replace(law, gap=gs.Gap(law.gap.j_1, law.gap.j_2 * (1.0 + off)))
        names = ("forcing", "K_c", "mass")
    else:
        o = replace(o, mean_load=off * o.forcing)
        names = ("forcing", "K_c", "gap", "mass")
    return Scene("", o, law, _along(draw, o, law, names), ratio=ratio)


def _hard(draw: Draw) -> Scene:
    ratio, is_even = draw.log(HARD, 500.0), draw.one(True, False, False)
    lower, upper = draw.within(0.0, 1.0), draw.log(0.05, 2.0)
    o, law, *_ = _machine(
        draw, lambda d: gs.Gap(d * (upper if is_even else lower), d * upper), ratio
    )
    options = _along(draw, o, law, ("forcing", "K_c", "j_2") if not is_even else ("forcing",))
    return Scene("", o, law, options | _short(draw, options), is_even, ratio)


def _short(draw: Draw, options: dict) -> dict:
    """A narrow window about the start."""
    at = float(np.ravel(options["at"])[0])
    between = draw.about(at, 0.85, 1.15)
    several = np.linspace(*between, 4)[1:].tolist()
    return {"between": between, "at": several, "max_steps": 150, "follow": 1}


def _one_sided(draw: Draw) -> Scene:
    ratio, j = draw.log(2.0, 100.0), draw.within(0.0, 1.5)
    o, law, *_ = _machine(draw, lambda d: gs.Gap(1e3 * d, d * j), ratio, K_ratio=0.0)
    law = replace(law, gap=gs.Gap(law.gap.j_2, law.gap.j_2))
    return Scene("", o, law, _along(draw, o, law, ("forcing", "K_c", "mass")), ratio=ratio)


def _unequal(draw: Draw) -> Scene:
    ratio, K_ratio = draw.log(2.0, 60.0), draw.log(0.1, 5.0)
    o, law, *_ = _machine(
        draw, lambda d: gs.Gap(*[d * draw.within(0.1, 1.5)] * 2), ratio, K_ratio=K_ratio
    )
    options = _along(draw, o, law, ("forcing", "gap", "mass", "K_c"))
    return Scene("", o, law, options, ratio=ratio * max(1.0, K_ratio))


def _smooth(draw: Draw) -> Scene:
    """Walls with a layer of a thirtieth to a third of the gap."""
    scene = draw.one(_asymmetric, _symmetric, _nearly)(draw)
    law, along = scene.law, scene.options["along"]
    smooth = gs.Tanh(law.K_c, law.gap, epsilon=draw.log(3.0, 30.0) / law.gap.j_2)
    if along in ("gap", "j_2"):  # the layer would fill narrow gaps
        scene = replace(scene, options=scene.options | {"between": draw.about(law.gap.j_2, 0.8, 2)})
    options = {"at": np.linspace(*scene.options["between"], 4)[1:].tolist()}
    return replace(scene, law=smooth, options=scene.options | options)


def _loaded(draw: Draw) -> Scene:
    ratio = draw.log(2.0, 60.0)
    o, law, stiffness, d = _machine(draw, lambda d: gs.Gap(*[d * draw.log(0.05, 2.0)] * 2), ratio)
    o = replace(o, mean_load=stiffness * d * draw.log(0.05, 1.0))
    names = ("forcing", "K_c", "gap", "mass", "mean_load")
    return Scene("", o, law, _along(draw, o, law, names), ratio=ratio)


def _chain(draw: Draw, n_contacts: int, **more: Any) -> tuple[Any, dict[str, Any], float]:
    """Two masses between springs of about 1 N/m, and walls at them."""
    masses, springs = draw.rng.uniform(0.7, 1.5, 2), draw.rng.uniform(0.6, 1.6, 3)
    stiffness = np.diag(springs[:2] + springs[1:]) - springs[1] * (1.0 - np.eye(2))
    share = draw.log(0.005, 0.1)
    names = ("one", "two")[:n_contacts]
    system = gs.System(
        mass=np.diag(masses),
        damping=share * stiffness,
        stiffness=stiffness,
        contacts={name: np.eye(2)[i].tolist() for i, name in enumerate(names)},
        forcing=[gs.Harmonic(amplitude=[0.0, 1.0])],
        **more,
    )
    ratio = draw.log(2.0, 30.0)
    laws = {
        name: gs.Piecewise(
            ratio * draw.within(0.5, 1.5), gs.Gap(draw.within(0.2, 1.0), draw.within(0.5, 2.0))
        )
        for name in names
    }
    return system, laws, 2.0 * ratio


def _two_coordinates(draw: Draw) -> Scene:
    system, laws, ratio = _chain(draw, 1)
    is_even = draw.one(True, False, False)
    law = laws["one"]
    if is_even:
        law = replace(law, gap=gs.Gap(law.gap.j_2, law.gap.j_2))
    omega = draw.log(0.5, 2.2) / TURN
    along = draw.one("omega", "K_c", "j_2" if not is_even else "gap")
    value = {"omega": omega, "K_c": law.K_c, "j_2": law.gap.j_2, "gap": law.gap.j_2}[along]
    low, high = draw.about(value, 0.7, 1.4)
    options = {"along": along, "between": (low, high), "at": [value, draw.within(low, high)]}
    options |= {"omega": omega} if along != "omega" else {}
    options["starts"] = [np.zeros(4).tolist(), *draw.rng.uniform(-2.0, 2.0, (3, 4)).tolist()]
    return Scene("", system, law, options, is_even, ratio)


def _several_contacts(draw: Draw) -> Scene:
    system, laws, ratio = _chain(draw, 2)
    omega = draw.log(0.5, 2.2) / TURN
    options = {"along": "omega", "between": draw.about(omega, 0.75, 1.35), "at": omega}
    options["starts"] = [np.zeros(4).tolist(), *draw.rng.uniform(-2.0, 2.0, (3, 4)).tolist()]
    return Scene("", system, laws, options, ratio=ratio)


def two_wells(load: float, damping: float, cubic: float) -> gs.System:
    return gs.System(
        mass=[[1.0]],
        damping=[[damping]],
        stiffness=[[-10.0]],
        cubic=[gs.Cubic(along=[1.0], alpha=cubic)],
        contacts={"stop": [1.0]},
        forcing=[gs.Harmonic(amplitude=[load])],
    )


def _own_parameter(draw: Draw) -> Scene:
    """A two-well oscillator with a stop, along its load."""
    damping, cubic = draw.within(0.4, 1.5), draw.log(30.0, 300.0)
    well = math.sqrt(10.0 / cubic)
    value = 0.5 * 10.0 * well

    def model(load: float) -> gs.System:
        return two_wells(load, damping, cubic)

    law = gs.Piecewise(draw.log(5.0, 200.0), gs.Gap(well * 2.0, well * draw.within(0.8, 1.4)))
    omega = draw.within(2.5, 5.0) / TURN
    options = {"along": "load", "between": draw.about(value * draw.log(0.1, 0.6), 0.5, 1.8)}
    options |= {"omega": omega, "starts": [[well, 0.0], [-well, 0.0]]}
    options["at"] = np.linspace(*options["between"], 3).tolist()
    return Scene("", model, law, options, ratio=law.K_c / 20.0)


def circulatory(
    feed: float, k: float, damping: float, cubic: tuple[float, float], load: float
) -> Any:
    """Two masses whose coupling feeds energy in: a Hopf point where it passes a limit."""
    forcing = [gs.Harmonic(amplitude=[load, 0.0], k=0)] if load else []
    return gs.System(
        mass=np.eye(2),
        stiffness=[[1.0, feed], [-feed, k]],
        damping=damping * np.eye(2),
        contacts={"stop": [1.0, 0.0]},
        cubic=[gs.Cubic(along=e, alpha=a) for e, a in zip(np.eye(2).tolist(), cubic, strict=True)],
        forcing=forcing,
    )


def growth(system: gs.System, law: gs.Piecewise) -> float:
    """Largest real part [1/s] of the eigenvalues about the equilibrium of `circulatory`."""
    load = sum((each.amplitude for each in system.forcing), np.zeros(2))

    def force(q: np.ndarray) -> np.ndarray:
        cubic = sum(each.alpha * each.along * (each.along @ q) ** 3 for each in system.cubic)
        return system.stiffness @ q + cubic + np.array([float(law.force(q[0])), 0.0]) - load

    q = root(force, np.linalg.solve(system.stiffness, load), tol=1e-14).x
    spring = law.K_c * (not -law.gap.j_1 < q[0] < law.gap.j_2)
    stiffness = system.stiffness + np.diag([spring, 0.0])
    for each in system.cubic:
        square = 3.0 * each.alpha * (each.along @ q) ** 2
        stiffness = stiffness + square * np.outer(each.along, each.along)
    matrix = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -system.damping]])
    return float(np.linalg.eigvals(matrix).real.max())


def _self_excited(draw: Draw) -> Scene:
    """Flutter of two masses with cubic springs, with a stop or without it."""
    k, damping = draw.within(1.1, 2.0), draw.log(0.01, 0.1)
    # Eigenvalues of the frequencies meet at |k - 1| / 2; damping delays the Hopf point a little.
    hopf = math.sqrt((0.5 * (k - 1.0)) ** 2 + damping**2 * 0.5 * (1.0 + k))
    cubic = (draw.within(0.5, 2.0), draw.within(0.5, 2.0))
    if draw.within(0.0, 1.0) < 0.3:  # as in the example whose Hopf point was called a fold
        cubic = (-cubic[0], cubic[1])
    is_even, has_stop = draw.one(True, False), draw.one(True, False)
    j = draw.within(0.1, 0.6), draw.within(0.1, 0.6)
    load = draw.one(0.0, 0.0, draw.within(0.01, 0.08))
    law = gs.Piecewise(draw.log(0.5, 20.0) * has_stop, gs.Gap(j[0], j[0] if is_even else j[1]))

    def model(feed: float) -> gs.System:
        return circulatory(feed, k, damping, cubic, load)

    at = hopf * draw.within(1.03, 1.3)
    options = {
        "along": "feed",
        "between": (hopf * draw.within(0.6, 0.95), at * draw.within(1.05, 1.4)),
    }
    options |= {"at": at, "starts": [[0.1, 0.1, 0.0, 0.0]]}
    return Scene(
        "",
        model,
        law,
        options,
        not load and (is_even or not has_stop),
        law.K_c,
        lambda value: growth(model(value), law),
    )


def _section(draw: Draw) -> Scene:
    """The typical section: lags, freeplay at the flap, some of it asymmetric."""
    is_even, freeplay = draw.one(True, False), gs.systems.FREEPLAY
    law = gs.systems.typical_section_law()
    if not is_even:
        law = replace(law, gap=gs.Gap(freeplay * draw.within(0.5, 0.98), freeplay))
    speed = draw.within(8.0, 13.0)
    options = {"along": "speed", "between": draw.about(speed, 0.9, 1.1), "at": speed}
    options |= {"starts": [[0.01, *np.zeros(7)]], "max_steps": 80}
    return Scene("", gs.systems.typical_section, law, options, is_even, 10.0)


def _free(draw: Draw) -> Scene:
    """Undamped free motions over their amplitude."""
    mass, omega_n, d = draw.log(0.1, 10.0), draw.log(0.5, 50.0), draw.log(1e-4, 3e-3)
    k = mass * (TURN * omega_n) ** 2
    cubic = draw.one(0.0, k / d**2 * draw.log(0.1, 1.0))
    o = gs.Oscillator(mass=mass, omega_n=omega_n, zeta=0.0, alpha=cubic, forcing=0.0)
    law = gs.Piecewise(k * draw.log(1.0, 60.0), gs.Gap(d * draw.within(0.3, 1.0), d))
    options = {"along": "amplitude", "between": (0.5 * d, 5.0 * d), "follow": 0}
    return Scene("", o, law, options, ratio=law.K_c / k)


SCENES: dict[str, Callable[[Draw], Scene]] = {
    "asymmetric walls": _asymmetric,
    "nearly symmetric": _nearly,
    "symmetric": _symmetric,
    "hard walls": _hard,
    "one wall": _one_sided,
    "unequal walls": _unequal,
    "mean load": _loaded,
    "smooth walls": _smooth,
    "two coordinates": _two_coordinates,
    "several contacts": _several_contacts,
    "own parameter": _own_parameter,
    "self-excited": _self_excited,
    "typical section": _section,
    "free": _free,
}


# --- Orbits by integration ----------------------------------------------------------------------


@dataclass
class Orbits:
    """The orbits of one branch, integrated over their periods.

    Attributes
    ----------
    name : ndarray of str
        Special points, "none" of ordinary orbits.
    value, period, multiple, state, unit : ndarray
        Parameter, period [s], forcing periods, initial state, size of states.
    points : list of ndarray
        States after 1, 2, ... parts of the period: forcing periods; of self-excited orbits halves
        and thirds are in `parts`.
    monodromy : ndarray
        In units of `unit`.
    extrema : list
        Displacements at turning points, by coordinate.
    """

    scene: Scene
    branch: xr.Dataset
    name: np.ndarray = field(init=False)
    value: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        branch, scene = self.branch, self.scene
        self.name = kinds(branch)
        self.value = branch[scene.along].values
        self.parent = int(branch["parent"])
        self.ends = [_flag(branch[name]) for name in ("begins", "ends")]
        self.period = branch["period"].values
        self.multiple = branch["period_multiple"].values
        self.state = branch["start_state"].values
        self.n = len(self.value)
        self.machines = [scene.at(value) for value in self.value.tolist()]
        self.is_forced = self.n > 0 and self.machines[0][2] is not None
        peaks = np.maximum(np.abs(branch["x_max"].values), np.abs(branch["x_min"].values))
        self.size = peaks.reshape(self.n, -1).max(axis=1)
        self.size = np.maximum(self.size, 1e-9 * self.size.max(initial=0.0))  # at a Hopf point
        rate = TURN * self.multiple / self.period if self.is_forced else TURN / self.period
        n_q = 1 if peaks.ndim == 1 else peaks.shape[1]
        self.unit = np.abs(self.state).max(axis=0) * np.ones_like(self.state)
        self.unit[:, :n_q] = self.size[:, None]
        self.unit[:, n_q : 2 * n_q] = (self.size * rate)[:, None]
        self.n_q = n_q
        self.points, self.monodromy, self.extrema = self.integrated(
            np.arange(self.n), self.state, self.period
        )
        self.growth = np.linalg.norm(self.monodromy, 2, axis=(1, 2))
        ends = np.array([each[-1] for each in self.points])
        self.returns = self.apart(ends, self.state, np.arange(self.n)) / np.maximum(1, self.growth)

    def apart(self, a: np.ndarray, b: np.ndarray, which: Any) -> np.ndarray:
        return np.abs((a - b) / self.unit[which]).max(axis=-1)

    def integrated(self, which: Any, states: np.ndarray, spans: np.ndarray) -> Any:
        """States at whole forcing periods (the end of unforced ones), tangents, turning points."""
        states = np.asarray(states, float)
        atol = max(RTOL * 1e-3 * float(self.size[which].min()), 1e-40)
        tight = {"rtol": RTOL, "atol": atol, "tangent": True}
        if self.is_forced:
            machines = [self.machines[i] for i in which]
            models, laws, omega = (list(each) for each in zip(*machines, strict=True))
            count = np.rint(spans * np.array(omega)).astype(int)
            run = gs.simulate(models, laws, omega, **tight, n_periods=count, **self.start(states))
            ends, points = self.end(run), list(run.section)
            for i, end in enumerate(ends):
                points[i] = np.vstack(
                    [np.reshape(points[i], (-1, states.shape[1]))[: count[i] - 1], end]
                )
            extrema = [_by_coordinate(each) for each in run.extrema]
            monodromy = np.array(run.monodromy)
        else:
            points, tangents, extrema = [], [], []
            for i, state, span in zip(which, states, spans, strict=True):
                model, law, _ = self.machines[i]
                if isinstance(model, gs.Oscillator):
                    model, law = _general(model), {"contact": law}
                run = gs.simulate(model, law, **tight, t_end=float(span), **_parts(model.n, state))
                end = np.concatenate([np.ravel(each) for each in (run.q_end, run.v_end, run.z_end)])
                points.append(end[None, :])
                tangents.append(run.monodromy)
                extrema.append(_by_coordinate(run.extrema))
            monodromy = np.array(tangents)
        unit = self.unit[which]
        return points, monodromy * unit[:, None, :] / unit[:, :, None], extrema

    def start(self, states: np.ndarray) -> dict[str, Any]:
        if isinstance(self.machines[0][0], gs.Oscillator):
            return {"x_0": states[:, 0], "v_0": states[:, 1]}
        return _parts(self.n_q, states)

    def end(self, run: Any) -> np.ndarray:
        if isinstance(self.machines[0][0], gs.Oscillator):
            return np.column_stack([run.x_end, run.v_end])
        return np.concatenate([run.q_end, run.v_end, run.z_end], axis=1)

    @property
    def multipliers(self) -> np.ndarray:
        """Eigenvalues of the integrated tangents; of unforced orbits without the one at 1."""
        mu = np.linalg.eigvals(self.monodromy)
        if self.is_forced:
            return mu
        along = np.abs(mu - 1.0).argmin(axis=1)
        return np.array([np.delete(each, i) for each, i in zip(mu, along, strict=True)])

    def near(self, i: int) -> np.ndarray:
        """Distance in the parameter from orbit i to all, as a part of the window."""
        low, high = self.branch.attrs["between"]
        return np.abs(self.value - self.value[i]) / (high - low)

    def orbit(self, i: int, value: float, share: float) -> Any:
        """The orbit at a parameter value between orbits i and i + 1, by Newton's method.

        Returns state and period, and the distance from the interpolated one as a part of the chord;
        None if there is none.
        """
        guess = self.state[i] + share * (self.state[i + 1] - self.state[i])
        period = self.period[i] + share * (self.period[i + 1] - self.period[i])
        chord = self.apart(self.state[i + 1], self.state[i], i) + 1e-6
        kept = self.machines[i]
        self.machines[i] = self.scene.at(value)
        if self.is_forced:
            period = self.multiple[i] / (self.machines[i][2] or math.nan)
        try:
            found = self._newton(i, guess, period)
        finally:
            self.machines[i] = kept
        if found is None:
            return None
        return *found, self.apart(found[0], guess, i) / chord

    def _newton(self, i: int, state: np.ndarray, period: float) -> Any:
        unit = self.unit[i]
        y, n = state / unit, len(state)
        rate = None
        for _ in range(8):
            points, (tangent,), _ = self.integrated([i], (y * unit)[None, :], np.array([period]))
            error, matrix = points[0][-1] / unit - y, tangent - np.eye(n)
            if not self.is_forced:
                short = np.array([1e-5 * period])
                (later, *_), *_ = self.integrated([i], points[0][-1:], short)
                speed = (later[-1] - points[0][-1]) / unit / short
                rate = speed if rate is None else rate
                matrix = np.block(
                    [[matrix, (speed * period)[:, None]], [rate[None, :], np.zeros((1, 1))]]
                )
                error = np.append(error, 0.0)
            try:
                step = -np.linalg.solve(matrix, error)
            except np.linalg.LinAlgError:
                return None
            y = y + step[:n]
            if not self.is_forced:
                period *= 1.0 + step[-1]
            if not np.isfinite(step).all() or np.abs(step).max() > 1.0:
                return None
            if np.abs(step).max() < 1e-9:
                return y * unit, period
        return None


def _flag(value: xr.DataArray) -> str:
    """Name of a flag."""
    flags = np.ravel(value.attrs["flag_values"]).tolist()
    return str(value.attrs["flag_meanings"].split()[flags.index(int(value))])


def _parts(n: int, states: np.ndarray) -> dict[str, Any]:
    return {
        "q_0": states[..., :n],
        "v_0": states[..., n : 2 * n],
        "z_0": states[..., 2 * n :] if states.shape[-1] > 2 * n else 0.0,
    }


def _by_coordinate(extrema: Any) -> list[np.ndarray]:
    return list(extrema.values()) if isinstance(extrema, dict) else [np.asarray(extrema)]


def _general(o: gs.Oscillator) -> gs.System:
    """A free oscillator as a system."""
    return gs.System(
        mass=[[o.mass]],
        stiffness=[[o.mass * (TURN * o.omega_n) ** 2]],
        damping=[[0.0]],
        cubic=[gs.Cubic(along=[1.0], alpha=o.alpha)] if o.alpha else [],
        contacts={"contact": [1.0]},
    )


# --- Checks -------------------------------------------------------------------------------------

Fault = tuple[str, str]


def faults(scene: Scene, ds: xr.Dataset) -> Iterator[Fault]:
    """Kind and description of everything that is wrong with the branches of a scene."""
    found = [Orbits(scene, rows(ds, number)) for number in ds["branch"].values]
    is_free = scene.along == "amplitude"
    for number, orbits in enumerate(found):
        for kind, text in itertools.chain(
            closed(orbits),
            [] if is_free else prime(orbits),
            [] if is_free else named(orbits),
            [] if is_free else explained(orbits),
            [] if is_free else turned(orbits),
            ends(orbits),
            started(orbits, found),
        ):
            yield kind, f"branch {number}, {text}"
    if not is_free:
        yield from once(found)


def closed(orbits: Orbits) -> Iterator[Fault]:
    for i in np.flatnonzero(~(orbits.returns <= CLOSES)):
        yield "not closed", f"{_row(orbits, i)}: {orbits.returns[i]:.1e}"
    for i in np.linspace(0, orbits.n - 1, min(EXACT, orbits.n)).astype(int):
        error = exact_return(orbits, i)
        if not error <= CLOSES:
            yield "not closed, exact", f"{_row(orbits, i)}: {error:.1e}"


def prime(orbits: Orbits) -> Iterator[Fault]:
    """Orbits that return after a part of their period, but at doublings."""
    if orbits.is_forced:
        for i in range(orbits.n):
            multiple = int(orbits.multiple[i])
            if len(orbits.points[i]) != multiple:
                yield "not prime", f"{_row(orbits, i)}: period is not {multiple} forcing periods"
                continue
            for part in (p for p in range(1, multiple) if multiple % p == 0):
                apart = orbits.apart(orbits.points[i][part - 1], orbits.state[i], i)
                if apart < PRIME and not _is_end(orbits, i):
                    yield "not prime", f"{_row(orbits, i)}: {part} of {multiple} ({apart:.1e})"
        return
    for part in (2, 3, 5):
        which = np.arange(orbits.n)
        points, *_ = orbits.integrated(which, orbits.state, orbits.period / part)
        for i in which:
            apart = orbits.apart(points[i][-1], orbits.state[i], i)
            if apart < PRIME and not _is_end(orbits, i) and orbits.name[i] != "hopf":
                yield "not prime", f"{_row(orbits, i)}: period / {part} ({apart:.1e})"


def _is_end(orbits: Orbits, i: int) -> bool:
    """Whether a branch of doubled period begins or ends here, or so near that orbits are alike."""
    ends = [k for k in (0, orbits.n - 1) if orbits.name[k] == "period_doubling"]
    return any(orbits.apart(orbits.state[i], orbits.state[k], i) < 1e3 * PRIME for k in ends)


def named(orbits: Orbits) -> Iterator[Fault]:
    """Multipliers and turning points of special points."""
    mu, stored = orbits.multipliers, multipliers(orbits.branch)
    at_graze = orbits.value[orbits.name == "grazing"]
    low, high = orbits.branch.attrs["between"]
    for i in range(orbits.n):
        name, where = str(orbits.name[i]), _row(orbits, i)
        is_beside = (np.abs(at_graze - orbits.value[i]) < BESIDE_GRAZE * (high - low)).any()
        if not is_beside and name == "none" and stored.shape[1]:
            # Products and sums of eigenvalues do not depend on their order.
            scale = max(1.0, float(np.abs(mu[i]).max()))
            apart = abs(np.sort_complex(mu[i]) - np.sort_complex(stored[i])).max() / scale
            if apart > 1e-3 + CLOSES * _slope(orbits, mu, i) / scale:
                yield "multipliers", f"{where}: {mu[i]} instead of {stored[i]}"
        ones = dict.fromkeys(("fold", "branch_point", "symmetry_breaking"), (1.0,)).get(name, ())
        if name == "period_doubling":  # of orbits of doubled period, 1 where they begin
            ones = (-1.0, 1.0) if _is_halved(orbits, i) else (-1.0,)
        apart = min((float(np.abs(mu[i] - one).min()) for one in ones), default=0.0)
        is_child = i == 0 and orbits.parent >= 0  # the parent's point is judged
        is_kink = is_beside and any(_changes_sides(orbits, i, one) for one in ones)
        allowed = AT_ONE + CLOSES * _slope(orbits, mu, i) if apart > AT_ONE else AT_ONE
        if apart > allowed and not is_child and not is_kink:
            yield "multiplier", f"{where}: nearest to {ones} is {apart:.1e} off"
        if name == "torus":
            pair = mu[i][np.abs(mu[i].imag) > 1e-6]
            if not len(pair) or np.abs(np.abs(pair) - 1.0).min() > AT_ONE:
                yield "multiplier", f"{where}: no complex pair on the unit circle, {mu[i]}"
        if (
            name == "grazing"
            and (apart := clearance(orbits, i)) > ON_WALL + GROWN * orbits.growth[i]
        ):
            yield "graze", f"{where}: nearest turning point {apart:.1e} off"
        if name in ("branch_point", "symmetry_breaking") and not orbits.scene.is_symmetric:
            yield (
                "crossing without symmetry",
                f"{where}, nearest multiplier {np.abs(mu[i] - 1).min():.1e} from 1",
            )
        elif name == "branch_point":
            yield "branch point", where
        elif name == "symmetry_breaking" and (apart := asymmetry(orbits, i)) > SYMMETRIC:
            yield "asymmetric", f"{where}: {apart:.1e} off"


def _is_halved(orbits: Orbits, i: int) -> bool:
    """Whether the orbit returns after half its period."""
    if not orbits.is_forced:
        points, *_ = orbits.integrated([i], orbits.state[[i]], orbits.period[[i]] / 2)
        return bool(orbits.apart(points[0][-1], orbits.state[i], i) < 1e-5)
    multiple = int(orbits.multiple[i])
    if multiple % 2:
        return False
    return bool(orbits.apart(orbits.points[i][multiple // 2 - 1], orbits.state[i], i) < 1e-5)


def _slope(orbits: Orbits, mu: np.ndarray, i: int) -> float:
    """Change of the multipliers from an orbit to its neighbours, over their distance."""
    slopes = [0.0]
    for k in (i - 1, i + 1):
        if 0 <= k < orbits.n and orbits.multiple[k] == orbits.multiple[i]:
            apart = max(orbits.apart(orbits.state[k], orbits.state[i], i), orbits.near(i)[k])
            change = np.abs(np.poly(mu[k]) - np.poly(mu[i])).max()  # whatever their order
            slopes.append(float(change) / max(float(apart), CLOSES))
    return max(slopes)


def _changes_sides(orbits: Orbits, i: int, one: float) -> bool:
    """Whether a real multiplier passes a number between the ordinary orbits before and after."""
    ordinary = np.flatnonzero(orbits.name == "none")
    before, after = ordinary[ordinary < i], ordinary[ordinary > i]
    if not len(before) or not len(after):
        return True
    real = [mu[np.abs(mu.imag) < 1e-9].real for mu in orbits.multipliers[[before[-1], after[0]]]]
    outside = [(one * each > 1.0).sum() for each in real]
    return bool(outside[0] != outside[1])


def asymmetry(orbits: Orbits, i: int) -> float:
    """Distance from an orbit to its mirror image, as a part of its size."""
    half = orbits.period[i] / 2
    if not orbits.is_forced:
        points, *_ = orbits.integrated([i], orbits.state[[i]], np.array([half]))
        return float(orbits.apart(points[0][-1], -orbits.state[i], i))
    model, law, omega = orbits.machines[i]
    parts = (
        {"x_0": orbits.state[i, 0], "v_0": orbits.state[i, 1]}
        if isinstance(model, gs.Oscillator)
        else _parts(orbits.n_q, orbits.state[i])
    )
    run = gs.simulate(
        model, law, omega, t_end=half, rtol=RTOL, atol=1e-3 * RTOL * orbits.size[i], **parts
    )
    ends = (
        (run.x_end, run.v_end)
        if isinstance(model, gs.Oscillator)
        else (run.q_end, run.v_end, run.z_end)
    )
    return float(
        orbits.apart(np.concatenate([np.ravel(each) for each in ends]), -orbits.state[i], i)
    )


def clearance(orbits: Orbits, i: int) -> float:
    """Distance of the nearest turning point of a gap from a wall, as a part of the orbit's size."""
    model, law, _ = orbits.machines[i]
    contacts = {"": np.ones(1)} if isinstance(model, gs.Oscillator) else model.contacts
    best = math.inf
    for name, along in contacts.items():
        own = law[name] if isinstance(law, dict) else law
        (coordinate,) = np.flatnonzero(along)  # contacts of drawn systems feel one coordinate
        x = np.append(orbits.extrema[i][coordinate], _peaks(orbits, i)[coordinate])
        walls = [own.gap.j_2] + ([-own.gap.j_1] if own.K_ratio else [])
        best = min(best, *(float(np.abs(x - wall).min()) for wall in walls))
    return best / float(orbits.size[i])


def _peaks(orbits: Orbits, i: int) -> np.ndarray:
    row = orbits.branch.isel(step=i)
    return np.column_stack([np.ravel(row["x_max"].values), np.ravel(row["x_min"].values)])


def explained(orbits: Orbits) -> Iterator[Fault]:
    """Changes between ordinary orbits that no special point between them explains."""
    mu, names = orbits.multipliers, orbits.name
    stable = orbits.branch["stable"].values
    n_contacts = orbits.branch["n_contacts"].values
    largest = np.abs(mu).max(axis=1, initial=0.0)
    ordinary = np.flatnonzero(names == "none")
    for i in ordinary:
        if abs(largest[i] - 1.0) > 1e-6 and (largest[i] < 1.0) != bool(stable[i]):
            yield "stable", f"{_row(orbits, i)}: {stable[i]}, largest multiplier {largest[i]:.9g}"
    outside = (np.abs(mu) > 1.0).sum(axis=1)
    # Where a multiplier is on the unit circle, rounding decides on which side.
    is_clear = np.abs(np.abs(mu) - 1.0).min(axis=1, initial=1.0) > 1e-7
    for a, b in itertools.pairwise(ordinary[is_clear[ordinary]].tolist()):
        here = set(names[a + 1 : b].tolist()) - {"none"}
        by_graze = "grazing" in here and orbits.scene.ratio >= HARD
        between = f"{_row(orbits, a)} to {b} {sorted(here)}"
        if outside[a] != outside[b] and not here - {"grazing"} and not by_graze:
            yield "unexplained", f"{between}: {outside[a]} to {outside[b]} multipliers outside"
        if n_contacts[a] != n_contacts[b] and not here & {"grazing", "unresolved"}:
            yield "missed graze", f"{between}: {n_contacts[a]} to {n_contacts[b]} crossings"


def turned(orbits: Orbits) -> Iterator[Fault]:
    """Folds at which the parameter goes on, and turns of the parameter that are no folds."""
    low, high = orbits.branch.attrs["between"]
    change = np.diff(orbits.value) / (high - low)
    names = orbits.name
    for i in range(1, orbits.n - 1):
        if min(abs(change[i - 1]), abs(change[i])) < 1e-10:
            continue  # rounding of the parameter decides
        is_turn, here = change[i - 1] * change[i] < 0.0, set(names[i - 1 : i + 2].tolist())
        if names[i] == "fold" and not is_turn:
            yield "turn", f"{_row(orbits, i)}: the parameter goes on"
        elif is_turn and not here - {"none", "grazing"}:
            by_graze = "grazing" in here and orbits.scene.ratio >= HARD
            if not by_graze:
                yield "turn", f"{_row(orbits, i)}: no fold"


def ends(orbits: Orbits) -> Iterator[Fault]:
    """Ends at equilibria are Hopf points, and no branch passes one."""
    if orbits.is_forced or orbits.scene.along == "amplitude" or not orbits.n:
        return
    amplitude = orbits.branch["amplitude"].values.reshape(orbits.n, -1).max(axis=1)
    is_small = amplitude < 1e-4 * amplitude.max()
    for i in np.flatnonzero(is_small[2:-2]) + 2:
        yield "equilibrium", f"{_row(orbits, i)}: amplitude {amplitude[i]:.1e} within the branch"
    growth_at = orbits.scene.equilibrium
    for reason, i in zip(orbits.ends, (0, -1), strict=True):
        if reason != "equilibrium":
            continue
        value = orbits.value[i]
        if amplitude[i] > 1e-2 * amplitude.max():
            yield "equilibrium", f"{_row(orbits, i)}: amplitude {amplitude[i]:.1e} at the end"
        if growth_at is not None:
            low, high = (growth_at(value * (1.0 + side * AT_HOPF)) for side in (-1.0, 1.0))
            if low * high > 0.0:
                yield (
                    "equilibrium",
                    f"{_row(orbits, i)}: no Hopf point, growth {low:.1e} to {high:.1e}",
                )


def started(orbits: Orbits, found: list[Orbits]) -> Iterator[Fault]:
    """The first orbit of a branch that leaves another one is a named point of that one."""
    if orbits.parent < 0 or not orbits.n:
        return
    parent = found[orbits.parent]
    points = np.isin(parent.name, ("period_doubling", "symmetry_breaking", "branch_point"))
    own = orbits.value[orbits.name != "none"]
    apart = np.abs(parent.value[points][:, None] / own - 1.0).min(initial=1.0)
    if apart > 1e-7:
        yield "start", f"{_row(orbits, 0)}: points are {apart:.1e} from those of its parent"


def once(found: list[Orbits]) -> Iterator[Fault]:
    """Orbits that two branches hold, or one branch twice."""
    for b, orbits in enumerate(found):
        regular = np.abs(orbits.multipliers - 1.0).min(axis=1, initial=1.0) > 2e-2
        regular &= orbits.name == "none"
        if orbits.n < 3:
            continue
        steps = orbits.apart(orbits.state[1:], orbits.state[:-1], slice(1, None))
        regular &= np.minimum(np.append(steps, 1.0), np.append(1.0, steps)) > APART
        for n in range(-2, 3):  # no special point nearby
            shifted = np.clip(np.arange(orbits.n) + n, 0, orbits.n - 1)
            regular &= np.isin(orbits.name[shifted], ("none", "grazing"))
        sample = np.flatnonzero(regular)
        sample = sample[np.linspace(0, len(sample) - 1, min(SAMPLED, len(sample))).astype(int)]
        for i in sample:
            for a, other in enumerate(found[: b + 1]):
                segments = on_branch(other, orbits, i, own=a == b)
                if segments:
                    text = f"{_row(orbits, i)} is on branch {a}, {_row(other, segments[0])}"
                    closes = "closed" in orbits.ends and orbits.value[0] == orbits.value[-1]
                    seam = {0, orbits.n - 2, orbits.n - 1}
                    if a == b and closes and i in seam and segments[0] in seam:
                        continue  # a closed branch ends at its first orbit
                    kind = "twice in a branch" if a == b else "on two branches"
                    if a == b and _is_past_start(orbits, i, segments[0]):
                        kind = "closed loop overlaps"
                    yield kind, f"branch {b}, {text}"
                    if a != b:
                        break


def _is_past_start(orbits: Orbits, i: int, k: int) -> bool:
    """Whether an orbit and its double lie at the first and the last step of a closed branch."""
    first, last = sorted((i, k))
    at_ends = last >= orbits.n - 5 and orbits.value[first] != orbits.value[last]
    return bool(at_ends and first <= 5 and "closed" in orbits.ends)


def on_branch(other: Orbits, orbits: Orbits, i: int, *, own: bool) -> list[int]:
    """Steps of a branch that hold orbit i of another one, or of the same."""
    value = orbits.value[i]
    points = orbits.points[i]
    found = []
    for k in range(other.n - 1):
        low, high = sorted(other.value[[k, k + 1]])
        if not low <= value <= high or low == high or (own and abs(k + 0.5 - i) < 3.0):
            continue
        share = (value - other.value[k]) / (other.value[k + 1] - other.value[k])
        if orbits.is_forced:
            if other.multiple[k] != orbits.multiple[i]:
                continue
            guess = other.state[k] + share * (other.state[k + 1] - other.state[k])
            nearest = orbits.apart(points, guess[None, :], i).min()
            if nearest > 0.1:
                continue
        elif not _is_alike(other, k, share, orbits, i, 5e-2):
            continue
        made = other.orbit(k, value, share)
        if made is None or made[2] > 0.3:
            continue
        if orbits.is_forced:
            is_same = orbits.apart(points, made[0][None, :], i).min() < SAME
        else:
            is_same = abs(made[1] / orbits.period[i] - 1.0) < SAME and _meets(orbits, i, made[0])
        if is_same:
            found.append(k)
    return found


def _is_alike(other: Orbits, k: int, share: float, orbits: Orbits, i: int, allowed: float) -> bool:
    """Whether period and peaks between two orbits are about those of another orbit."""
    period = other.period[k] + share * (other.period[k + 1] - other.period[k])
    mine = _peaks(orbits, i)
    theirs = _peaks(other, k) + share * (_peaks(other, k + 1) - _peaks(other, k))
    return bool(
        abs(period / orbits.period[i] - 1.0) < allowed
        and np.abs(mine - theirs).max() < allowed * orbits.size[i]
    )


def _meets(orbits: Orbits, i: int, state: np.ndarray) -> bool:
    """Whether a state lies on a self-excited orbit, apart from rounding."""
    model, law, _ = orbits.machines[i]
    run = gs.simulate(
        model, law, t_end=float(orbits.period[i]), rtol=RTOL, atol=1e-3 * RTOL * orbits.size[i],
        dense_output=True, **_parts(orbits.n_q, orbits.state[i]),
    )  # fmt: skip
    low, high = 0.0, float(orbits.period[i])
    for _ in range(9):
        t = np.linspace(low, high, 41)
        q, v = (np.asarray(each) for each in run.sample(t)[:2])
        there = np.concatenate([q, v], axis=-1) / orbits.unit[i, : 2 * orbits.n_q]
        apart = np.abs(there - (state / orbits.unit[i])[: 2 * orbits.n_q]).max(axis=-1)
        best, step = int(apart.argmin()), (high - low) / 40.0
        low, high = max(0.0, t[best] - step), min(float(orbits.period[i]), t[best] + step)
    return bool(apart.min() < 10.0 * SAME)


def settled(scene: Scene, ds: xr.Dataset, n: int, seed: int) -> tuple[int, int]:
    """Periodic attractors that random initial conditions lead to, and how many lie on a branch."""
    found = [Orbits(scene, rows(ds, number)) for number in ds["branch"].values]
    rng, (low, high) = np.random.default_rng(seed), ds.attrs["between"]
    n_periodic = n_held = 0
    for value in rng.uniform(low, high, n).tolist():
        model, law, omega = scene.at(value)
        start = rng.uniform(-2.0, 2.0, found[0].state.shape[1]) * found[0].unit[0]
        if isinstance(model, gs.Oscillator):
            response = gs.respond(model, law, omega, *start)
            state = np.array([response.x_end, response.v_end])
        else:
            response = gs.respond(model, law, omega, **_parts(model.n, start))
            ends = response.x_end, response.v_end, response.z_end
            state = np.concatenate([np.ravel(each) for each in ends])
        if not response.period_multiple or omega is None:
            continue
        n_periodic += 1
        row = ds.isel(branch=[0], step=[0]).copy(deep=True)
        row[scene.along][:] = value
        row["period"][:] = response.period_multiple / omega
        row["period_multiple"][:] = response.period_multiple
        row["start_state"][:] = state
        row["special"][:], row["n_orbits"][:] = 0, 1
        attractor = Orbits(scene, rows(row, 0))
        n_held += any(on_branch(each, attractor, 0, own=False) for each in found)
    return n_periodic, n_held


# --- The exact oracle ---------------------------------------------------------------------------


def exact_return(orbits: Orbits, i: int) -> float:
    """Distance after a period by matrix exponentials, over size and growth; 0 of cubic springs."""
    model, law, omega = orbits.machines[i]
    system = exact_machine(model, law)
    if system is None:
        return 0.0
    n, state = system.n, orbits.state[i]
    end = exact.motion(
        system, omega or 1.0, state[:n], state[n : 2 * n], state[2 * n :], float(orbits.period[i])
    ).state
    return float(orbits.apart(end, state, i)) / max(1.0, float(orbits.growth[i]))


def exact_machine(model: Any, law: Any) -> exact.System | None:
    """Piecewise-linear equations of a machine; None of cubic springs and smooth laws."""
    laws = law.values() if isinstance(law, dict) else [law]
    if not all(isinstance(each, gs.Piecewise) for each in laws):
        return None
    if isinstance(model, gs.Oscillator):
        if model.alpha:
            return None
        k = model.mass * (TURN * model.omega_n) ** 2
        c = 2.0 * model.zeta * math.sqrt(k * model.mass) + model.c
        matrices: dict[str, Any] = {"M": [[model.mass]], "C": [[c]], "K": [[k]]}
        contacts = {"": np.ones(1)}
        loads = [exact.Harmonic(np.array([model.forcing]))]
        loads += [exact.Harmonic(np.array([model.mean_load]), 0)] if model.mean_load else []
    else:
        if any(each.alpha for each in model.cubic):
            return None
        matrices = {"M": model.mass, "C": model.damping, "K": model.stiffness}
        if model.lags is not None:
            names = ("force", "of_speed", "of_place", "of_lags")
            matrices |= dict(zip("DEGH", (getattr(model.lags, n) for n in names), strict=True))
        contacts = dict(model.contacts)
        loads = [exact.Harmonic(np.array(h.amplitude), h.k, h.phase) for h in model.forcing]
    made = []
    for name, along in contacts.items():
        own = law[name] if isinstance(law, dict) else law
        lower = own.gap.j_1 if own.K_ratio else 1e3
        made.append(exact.Contact(along, own.K_c, lower, own.gap.j_2, own.K_ratio))
    return exact.System(
        **{name: np.array(value, float) for name, value in matrices.items()},
        contacts=tuple(made),
        harmonics=tuple(loads),
    )


def _row(orbits: Orbits, i: int) -> str:
    return f"step {i} ({orbits.name[i]}, {orbits.scene.along} = {orbits.value[i]:.9g})"


# --- Nearly symmetric machines ------------------------------------------------------------------

# Mass, natural frequency, damping ratio, cubic spring, forcing; K_c, gap; window and start.
# Between their ends, symmetric orbits of the symmetric machine break their symmetry.
BASES = {
    "duffing 0.4 mm": ((3.0, 5.0, 0.03, 7e8, 4.0), (1.4e4, 4e-4), (3.0, 6.0), 5.8),
    "duffing 0.8 mm": ((3.0, 5.0, 0.03, 7e8, 4.0), (1.4e5, 8e-4), (3.0, 6.0), 5.8),
    "linear": ((1.0, 1.0, 0.03, 0.0, 1.0), (400.0, 2e-2), (0.4, 1.6), 1.0),
    "duffing, soft walls": ((1.0, 0.2, 0.05, 5.0, 1.0), (1.0, 0.3), (0.06, 0.24), 0.135),
}


def nearly_symmetric() -> Iterator[tuple[str, Scene]]:
    """Four machines, walls or load asymmetric by 1e-2 to 1e-5: no branches cross."""
    for name, (numbers, (K_c, gap), between, at) in BASES.items():
        mass, omega_n, zeta, alpha, forcing = numbers
        for off, what in itertools.product((1e-2, 1e-3, 1e-4, 1e-5), ("walls", "load")):
            o = gs.Oscillator(
                mass=mass,
                omega_n=omega_n,
                zeta=zeta,
                alpha=alpha,
                forcing=forcing,
                mean_load=off * forcing if what == "load" else 0.0,
            )
            upper = gap * (1.0 + off) if what == "walls" else gap
            law = gs.Piecewise(K_c, gs.Gap(gap, upper))
            options = {"along": "omega", "between": between, "at": at, "max_steps": 300}
            ratio = K_c / (mass * (TURN * omega_n) ** 2)
            yield (
                f"{name}, {what} {off:g}",
                Scene("nearly symmetric", o, law, options, False, ratio),
            )


# --- Runs ---------------------------------------------------------------------------------------


@dataclass
class Result:
    scene: Scene
    found: list[Fault]
    note: str = ""
    n_orbits: int = 0
    n_branches: int = 0
    n_named: Counter[str] = field(default_factory=Counter)
    n_lost: int = 0
    seconds: float = 0.0
    checking: float = 0.0
    attractors: tuple[int, int] = (0, 0)


def examined(scene: Scene, n_attractors: int = 0, **changes: Any) -> Result:
    """One call and everything that is wrong with its answer."""
    scene = replace(scene, options=scene.options | changes)
    begin = time.process_time()
    result = Result(scene, [])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            ds = scene.branches()
        except gs.ModelError as error:
            result.note = f"refused: {error}"
            ds = None
        except Exception as error:  # any error of the code under test is a fault to report
            result.found.append(("exception", f"{type(error).__name__}: {error}"))
            ds = None
    result.seconds = time.process_time() - begin
    numeric = {str(each.message) for each in caught if issubclass(each.category, RuntimeWarning)}
    result.found += [("warning", text) for text in sorted(numeric)]
    if ds is None:
        return result
    if ds.sizes["branch"] and scene.along != "amplitude" and n_attractors:
        result.attractors = settled(scene, ds, n_attractors, 0)
    begin = time.process_time()
    result.n_branches, result.n_orbits = ds.sizes["branch"], int(ds["n_orbits"].sum())
    result.n_lost = int(ds.attrs["n_lost"])
    for number in ds["branch"].values:
        result.n_named.update(kinds(rows(ds, number)).tolist())
    del result.n_named["none"]
    if result.n_branches:
        try:
            result.found += faults(scene, ds)
        except (np.linalg.LinAlgError, RuntimeError, ValueError) as error:  # orbits that are none
            result.found.append(("exception", f"check: {type(error).__name__}: {error}"))
    else:
        result.note = "no branch"
    result.checking = time.process_time() - begin
    return result


def printed(results: Iterator[tuple[str, Result]]) -> list[Result]:
    """Print scenes with faults as they come, then the table."""
    done = []
    for name, result in results:
        done.append(result)
        counts = Counter(kind for kind, _ in result.found)
        said = ", ".join(f"{kind}: {n}" for kind, n in counts.items()) or result.note[:60] or "ok"
        print(
            f"{name:28s} {result.scene.kind:18s} {result.scene.along:9s} "
            f"{result.seconds:6.1f} s +{result.checking:5.1f} s {result.n_branches:3d} branches "
            f"{result.n_orbits:5d} orbits {result.n_lost:2d} lost  {said}",
            flush=True,
        )
        for kind, texts in itertools.groupby(sorted(result.found), key=lambda fault: fault[0]):
            several = [text for _, text in texts]
            for text in several[:3]:
                print(f"    {kind}: {text}")
            if len(several) > 3:
                print(f"    {kind}: and {len(several) - 3} more")
    table(done)
    return done


def table(done: list[Result]) -> None:
    named_points = sum((each.n_named for each in done), Counter())
    print(
        f"\n{len(done)} scenes, {sum(each.n_branches for each in done)} branches, "
        f"{sum(each.n_orbits for each in done)} orbits, "
        f"{sum(each.n_lost for each in done)} lost, "
        f"{sum(each.note.startswith('refused') for each in done)} refused, "
        f"{sum(each.note == 'no branch' for each in done)} without branch; "
        f"{sum(each.seconds for each in done):.0f} s, checks "
        f"{sum(each.checking for each in done):.0f} s"
    )
    print("special points:", dict(named_points))
    n_periodic, n_held = (sum(each.attractors[k] for each in done) for k in (0, 1))
    if n_periodic:
        print(f"{n_held} of {n_periodic} attractors of random initial conditions lie on a branch")
    print(f"{'fault':28s} {'faults':>7s} {'scenes':>7s}  explanation")
    for kind, text in FAULTS.items():
        n = sum(one == kind for each in done for one, _ in each.found)
        scenes = sum(any(one == kind for one, _ in each.found) for each in done)
        print(f"{kind:28s} {n:7d} {scenes:7d}  {text}")


def scenes(
    numbers: range, seed: int, changes: dict[str, Any], n_attractors: int = 0
) -> Iterator[tuple[str, Result]]:
    for number in numbers:
        scene = drawn(seed, number)
        own = {} if scene.along == "amplitude" else changes
        result = examined(scene, n_attractors, **own)
        yield f"--seed {seed} --only {number}", result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("n", type=int, nargs="?", default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first scene")
    parser.add_argument("--only", type=int, help="number of one scene")
    parser.add_argument("--follow", type=int, help="for all scenes, instead of 0, 1 or 2")
    parser.add_argument("--steps", type=int, help="max_steps of all scenes")
    parser.add_argument("--nearly", action="store_true", help="the 32 nearly symmetric runs")
    parser.add_argument(
        "--attractors", type=int, default=0, help="random initial conditions of a scene"
    )
    given = parser.parse_args()
    changes = {"follow": given.follow, "max_steps": given.steps}
    changes = {name: value for name, value in changes.items() if value is not None}
    numbers = range(given.first, given.first + given.n)
    if given.only is not None:
        numbers = range(given.only, given.only + 1)
        scene = drawn(given.seed, given.only)
        print(scene.model, scene.law, scene.options | changes, sep="\n")
    if len(numbers):
        printed(scenes(numbers, given.seed, changes, given.attractors))
    if given.nearly:
        printed((name, examined(scene, **changes)) for name, scene in nearly_symmetric())


if __name__ == "__main__":
    main()
