"""Derivatives of steady quantities through impacts on rigid walls.

Exact flows have no tangent and no jump (`tests/oracles/exact_impacts.py`). Chatter, which these do
not have, is compared with differences of responses.
"""

import math
from dataclasses import dataclass
from functools import partial
from inspect import signature
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.oracles.exact_impacts import Event, Machine, Orbit, Wall

import gapsweep as gs
from gapsweep.continuation.family import Family, Window
from gapsweep.continuation.follow import solver_of
from gapsweep.continuation.orbits import OrbitEquations
from gapsweep.continuation.seed import Attractor, seeds

HZ = 2.0 * math.pi
ALONG = {"s": np.array([1.0, -1.0]), "e": np.array([0.0, 1.0])}
CENTRAL = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0
TIGHT = {"rtol": 1e-13, "steady": gs.Steady(settle_tol=1e-11)}


def impact_oscillator(forcing=0.2, c=0.1, mass=1.0, **numbers):
    rate = 1.0 / HZ / math.sqrt(mass)
    return gs.Oscillator(mass=mass, omega_n=rate, zeta=0.0, c=c, forcing=forcing, **numbers)


def stop(place=1.0, e=0.8):
    return gs.Rigid(gs.Gap(None, place), restitution=e)


def by_parameter(found, quantity):
    part = found["gradient"].sel(quantity=quantity)
    return dict(zip(found["parameter"].values.tolist(), part.values.T, strict=True))


@dataclass
class Case:
    """A drawn machine: one or two masses, with rigid walls, or a rigid and an elastic wall."""

    kind: str
    values: dict[str, float]
    fixed: dict[str, Any]

    @classmethod
    def drawn(cls, seed: int) -> "Case":
        rng = np.random.default_rng(seed)
        kind = ("plain", "general", "two rigid", "two rigid", "rigid and elastic")[seed % 5]
        names = ("m", "k", "c", "F", "omega", "j_1", "j_2", "e", "j_3", "j_4", "e_2", "K_c")
        low = (0.5, 0.5, 0.05, 0.5, 0.4, 0.1, 0.1, 0.3, 0.1, 0.1, 0.3, 3.0)
        high = (2.0, 3.0, 0.3, 1.5, 2.0, 0.6, 0.6, 0.95, 0.6, 0.6, 0.95, 30.0)
        values = dict(zip(names, rng.uniform(low, high).tolist(), strict=True))
        values["omega"] /= HZ
        left_out = {"plain": names[8:], "general": names[8:], "two rigid": ("K_c",)}
        for name in left_out.get(kind, ("e_2",)):
            del values[name]
        fixed = {
            "m_2": rng.uniform(0.5, 2.0), "coupled": 0.1 * rng.random(), "k_2": 2.0 * rng.random(),
            "k_3": rng.uniform(0.5, 3.0), "F_2": rng.uniform(-0.4, 0.4),
            "F_0": 0.0 if kind == "plain" else rng.uniform(-0.2, 0.2),
        }  # fmt: skip
        return cls(kind, values, fixed)

    @property
    def n(self) -> int:
        return 1 if self.kind in ("plain", "general") else 2

    def matrices(self, m: Any, k: Any, c: Any) -> tuple[Any, Any, Any]:
        if self.n == 1:
            return np.array([[m]]), np.array([[c]]), np.array([[k]])
        own = self.fixed
        mass = np.array([[m, own["coupled"]], [own["coupled"], own["m_2"]]])
        stiffness = np.array(
            [[k + own["k_2"], -own["k_2"]], [-own["k_2"], own["k_2"] + own["k_3"]]]
        )
        return mass, c * (0.5 * stiffness + 0.1 * mass), stiffness

    def machine(self, parameters: Any) -> Machine:
        p = dict(zip(self.values, parameters, strict=True))
        matrices = self.matrices(p["m"], p["k"], p["c"])
        second = [self.fixed["F_2"]] * (self.n - 1)
        b = ALONG["s"] if self.n == 2 else np.ones(1)
        walls = [Wall(b, -p["j_1"], p["j_2"], p["e"])]
        if self.n == 2:
            walls.append(Wall(ALONG["e"], -p["j_3"], p["j_4"], p.get("e_2"), p.get("K_c", 0.0)))
        loads = np.array([p["F"], *second]), np.array([self.fixed["F_0"]] + [0.0] * (self.n - 1))
        return Machine(*matrices, *loads, p["omega"] * HZ, walls)

    def model(self, m: float, k: float, c: float, F: float) -> Any:
        if self.n == 1:
            rate, load = math.sqrt(k / m) / HZ, self.fixed["F_0"]
            return gs.Oscillator(mass=m, omega_n=rate, zeta=0.0, c=c, forcing=F, mean_load=load)
        mass, damping, stiffness = self.matrices(m, k, c)
        loads = [
            gs.Harmonic(amplitude=[F, self.fixed["F_2"]]),
            gs.Harmonic(amplitude=[self.fixed["F_0"], 0.0], k=0),
        ]
        return gs.System(
            mass=mass, damping=damping, stiffness=stiffness, contacts=ALONG, forcing=loads
        )

    def laws(self, **p: float) -> Any:
        first = gs.Rigid(gs.Gap(p["j_1"], p["j_2"]), restitution=p["e"])
        if self.n == 1:
            return first
        gap = gs.Gap(p["j_3"], p["j_4"])
        elastic = "K_c" in p
        second = gs.Piecewise(p["K_c"], gap) if elastic else gs.Rigid(gap, restitution=p["e_2"])
        return {"s": first, "e": second}

    def names(self) -> list[str]:
        public = {"e": "restitution", "j_3": "j_1", "j_4": "j_2", "e_2": "restitution"}
        found = [public.get(name, name) for name in self.values]
        if self.n == 2:
            found[5:8] = [f"{name}[s]" for name in found[5:8]]
            found[8:] = [f"{name}[e]" for name in found[8:]]
        return found

    def arguments(self) -> tuple[Any, Any]:
        p = self.values
        return self.model(p["m"], p["k"], p["c"], p["F"]), self.laws(**p)

    def gradient(self) -> Any:
        values = {name: self.values[name] for name in ("m", "k", "c", "F")}
        laws, omega = self.laws(**self.values), self.values["omega"]
        return gs.gradient(self.model, laws, self.names(), omega=omega, values=values)

    def orbit(self) -> Orbit | None:
        """The orbit by exact flows; None without impacts, with holds, or of a long period."""
        model, laws = self.arguments()
        start = ("x_0", "v_0") if self.n == 1 else ("q_0", "v_0")
        end = gs.respond(model, laws, omega=self.values["omega"])  # as `gradient` does
        multiple = int(end.period_multiple)
        if end.response_class != gs.ResponseClass.PERIODIC or multiple > 6:
            return None
        run = gs.simulate(
            model, laws, self.values["omega"], n_periods=multiple, rtol=1e-12, dense_output=True,
            **dict(zip(start, (end.x_end, end.v_end), strict=True)),
        )  # fmt: skip
        state = np.append(end.x_end, end.v_end)
        machine, events = self.machine(list(self.values.values())), []
        times = [run.t_contacts] if self.n == 1 else [run.t_contacts[name] for name in ALONG]
        modes = [0] * len(times)
        for number, (wall, several) in enumerate(zip(machine.walls, times, strict=True)):
            if wall.e is None:
                gap = wall.b @ state[: self.n]
                modes[number] = int(gap > wall.high) - int(gap < wall.low)
            elif len(several) % 2 or (several[::2] != several[1::2]).any():
                return None
            for t in several if wall.e is None else several[::2]:
                gap = wall.b @ np.ravel(run.sample(t)[0])
                side = 1 if abs(gap - wall.high) < abs(gap - wall.low) else -1
                events.append((float(t), Event(number, side, wall.e is not None)))
        if not any(event.is_impact for _, event in events) or len(events) > 40:
            return None
        events.sort()
        every = list(self.values.values())
        return Orbit(self.machine, every, state, events, tuple(modes), multiple)


def compared(seeds):
    """Largest error of values and derivatives in drawn cases, and the number of these."""
    worst, n = 0.0, 0
    for case in map(Case.drawn, seeds):
        orbit = case.orbit()
        if orbit is None:
            continue
        found, n = case.gradient(), n + 1
        for i, name in enumerate([""] if case.n == 1 else ["[q_1]", "[q_2]"]):
            for quantity, sign in (("x_max", 1.0), ("x_min", -1.0)):
                value, expected = orbit.largest(sign * np.eye(case.n)[i])
                here = found.sel(quantity=quantity + name)
                errors = np.abs(sign * here["gradient"].values - expected)
                worst = max(worst, abs(sign * here["value"].item() - value))
                worst = max(worst, errors.max() / max(np.abs(expected).max(), 1.0))
            expected = orbit.state_gradient[:, i]
            got = found["gradient"].sel(quantity=f"x_end{name}").values
            worst = max(worst, np.abs(got - expected).max() / max(np.abs(expected).max(), 1.0))
    return worst, n


def test_derivatives_through_impacts_are_those_of_exact_flows():
    worst, n = compared((1, 2, 5, 6, 24))
    assert n == 5
    assert worst < 1e-11


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_branches_with_impacts_have_the_direction_of_exact_flows(seed):
    """Differences of motions are off by 1e-7 and more."""
    case = Case.drawn(seed)
    orbit, laws = case.orbit(), case.laws(**case.values)
    own = {name: case.values[name] for name in ("m", "k", "c", "F")}
    for number, (name, value) in enumerate(case.values.items()):
        if name not in (*own, "omega") and case.n == 2:  # a number of both laws
            continue
        along = "restitution" if name == "e" else name
        others = {each: x for each, x in own.items() if each != name}
        omega = None if name == "omega" else case.values["omega"]
        model = partial(case.model, **others) if name in own else case.model(**own)
        family = Family(model, laws, omega, (along,), {along: value})
        windows = (Window(along, 0.8 * value, 1.25 * value),)
        equations = OrbitEquations(family, windows, solver_of(family, 1e-13, None))
        start = Attractor(
            value=value, section=orbit.state[None, :], period=math.nan, multiple=orbit.multiple
        )
        ((found, reference, _),) = seeds(equations, [start])
        direction = found.tangent[:-1] * reference.size[0] / (0.45 * value * found.tangent[-1])
        expected = orbit.state_gradient[number]
        assert_allclose(direction, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_a_branch_goes_on_where_two_masses_chatter_at_one_time():
    def machine(load):
        loads = [gs.Harmonic(amplitude=[load, load]), gs.Harmonic(amplitude=[load / 5] * 2, k=2)]
        contacts = {"a": [1.0, 0.0], "b": [0.0, 1.0]}
        unit = np.eye(2)
        return gs.System(
            mass=unit, damping=0.1 * unit, stiffness=unit, contacts=contacts, forcing=loads
        )

    law = gs.Rigid(gs.Gap(None, 0.1), restitution=0.3)
    br = gs.branches(machine, law, "load", (0.8, 1.3), at=1.0, omega=0.05)
    load, lowest = br["load"].values[0], br["x_min"].values[0]
    assert_allclose(load[[0, -1]], [0.8, 1.3])
    assert_allclose(lowest[:, 0], lowest[:, 1], rtol=1e-9)
    assert len(load) < 200


@pytest.mark.slow
def test_derivatives_through_impacts_in_100_drawn_cases():
    worst, n = compared(range(170))
    assert n >= 100
    assert worst < 2e-11


def test_extrema_are_on_the_walls_and_impacts_have_no_force():
    names = ["forcing", "j_2", "restitution", "omega"]
    found = gs.gradient(impact_oscillator(), stop(), names, omega=[1.0 / HZ, 1.02 / HZ])
    by = by_parameter(found, "x_max")
    assert_allclose([by[name] for name in names], [[0.0] * 2, [1.0] * 2, [0.0] * 2, [0.0] * 2])
    assert (found["value"].sel(quantity="x_max") == 1.0).all()
    assert (found["value"].sel(quantity="contact_share") == 0.0).all()
    assert (found["gradient"].sel(quantity="contact_share") == 0.0).all()
    assert np.isnan(found["value"].sel(quantity="force_max")).all()
    assert np.isnan(found["gradient"].sel(quantity="force_max")).all()
    # every turning point that heads for the wall ends on it
    assert np.isnan(found["value"].sel(quantity="graze")).all()


@pytest.mark.parametrize("mean_load", [0.0, 0.02])  # a classic oscillator, and the general form
def test_gradients_with_impacts_keep_the_identities_of_dimensions(mean_load):
    """Lengths, forces and times; the restitution has no dimension."""
    model, omega = impact_oscillator(0.3, mean_load=mean_load), np.linspace(0.7, 1.3, 7) / HZ
    names = ["mass", "c", "omega_n", "forcing", "omega", "j_1", "j_2", "restitution"]
    names += ["mean_load"] * (mean_load > 0.0)
    law = gs.Rigid(gs.Gap(1.4, 0.6), restitution=0.7)
    found = gs.gradient(model, law, names, omega=omega)
    is_periodic = np.isfinite(found["gradient"].sel(quantity="x_min").values[:, 0])
    assert is_periodic.sum() >= 5
    for quantity in ("x_min", "x_end", "amplitude"):
        by, x = by_parameter(found, quantity), found["value"].sel(quantity=quantity).values
        by_k = by["omega_n"] / (2.0 * HZ)  # at unit mass and rate
        by_m = by["mass"] - by_k
        damped, forced = 0.1 * by["c"], 0.3 * by["forcing"]
        forced = forced + mean_load * by.get("mean_load", 0.0)
        residuals = [
            1.4 * by["j_1"] + 0.6 * by["j_2"] + forced - x,
            by_m + damped + by_k + forced,
            damped + 2.0 * by_k + omega * by["omega"] + 2.0 * forced,
        ]
        assert np.abs(np.array(residuals) / x)[:, is_periodic].max() < 1e-10


def slow_oscillator(mass=1.3, c=0.1, F=1.5, load=0.01):
    return impact_oscillator(F, c, mass, mean_load=load)


def slow_stop(place=1.0, e=0.4):
    return stop(place, e)


def slow_masses(m=0.8, k=1.1, F=1.3):
    return gs.System(
        mass=[[m, 0.15], [0.15, 1.2]],
        stiffness=[[k + 0.5, -0.5], [-0.5, 1.5]],
        damping=[[0.2, -0.05], [-0.05, 0.15]],
        contacts=ALONG,
        forcing=[gs.Harmonic(amplitude=[0.4, F])],
    )


def stops_of_masses(j=0.35, e=0.6, e_2=0.4):
    first = gs.Rigid(gs.Gap(0.6, 0.7), restitution=e)
    return {"s": first, "e": gs.Rigid(gs.Gap(None, j), restitution=e_2)}


def caught_masses(m=1.35, k=2.02, F=0.515):
    """A rigid wall holds the masses until one of them leaves a preload, which is at once."""
    return gs.System(
        mass=[[m, 0.1], [0.1, 0.88]],
        stiffness=[[k + 0.17, -0.17], [-0.17, 2.18]],
        damping=[[0.0645, -0.0039], [-0.0039, 0.0617]],
        contacts={name: ALONG[name] for name in ("e", "s")},
        forcing=[gs.Harmonic(amplitude=[F, 0.266])],
    )


def stop_and_detent(j=0.314, preload=0.3):
    detent = gs.Piecewise(19.0, gs.Gap(None, j), preload=preload)
    return {"s": stop(0.284, 0.0), "e": detent}


@pytest.mark.parametrize(
    ("model", "laws", "omega", "names"),
    [
        (slow_oscillator, slow_stop, 0.2, {"place": "j_2", "e": "restitution"}),
        pytest.param(
            slow_masses, stops_of_masses, 0.3,
            {"j": "j_2[e]", "e": "restitution[s]", "e_2": "restitution[e]"},
            marks=pytest.mark.extended,
        ),
        (caught_masses, stop_and_detent, 1.085, {"j": "j_2[e]", "preload": "preload[e]"}),
    ],
)  # fmt: skip
def test_derivatives_through_chatter_and_holds_are_those_of_differences(model, laws, omega, names):
    places = {"omega": omega / HZ}
    for function in (model, laws):
        places |= {name: one.default for name, one in signature(function).parameters.items()}

    def numbers(**moved):
        p = places | moved
        one, law = (f(**{name: p[name] for name in signature(f).parameters}) for f in (model, laws))
        end = gs.respond(one, law, omega=p["omega"], **TIGHT)
        assert np.max(end.contact_share) > 0.0  # a hold
        return np.concatenate([np.ravel(x) for x in (end.x_min, end.x_max, end.x_end, end.v_end)])

    found = gs.gradient(model, laws(), [names.get(x, x) for x in places], omega=places["omega"])
    labels = [""] if model is slow_oscillator else ["[q_1]", "[q_2]"]
    quantities = [f"{x}{y}" for x in ("x_min", "x_max", "x_end", "v_end") for y in labels]
    for name, place in places.items():
        step = 2e-4 * place
        ends = [numbers(**{name: place + k * step}) for k in (-2, -1, 1, 2)]
        got = found["gradient"].sel(quantity=quantities, parameter=names.get(name, name)).values
        expected = CENTRAL @ np.array(ends) / step
        assert_allclose(got, expected, rtol=2e-8, atol=2e-8, err_msg=name)
    share = [name for name in found["quantity"].values if name.startswith("contact_share")][-1]
    assert np.isnan(found["gradient"].sel(quantity=share)).all()


def test_impacts_of_two_contacts_that_accumulate_together_have_no_derivatives():
    """Of impacts with smaller and smaller speeds, rounding errors of times grow beyond bounds."""
    model = gs.System(
        mass=np.diag([1.0, 0.5]), stiffness=np.eye(2), damping=0.1 * np.eye(2), contacts=ALONG,
        forcing=[gs.Harmonic(amplitude=[1.455, 0.905]), gs.Harmonic(amplitude=[-0.483, 0.0], k=0)],
    )  # fmt: skip
    laws = {
        "s": gs.Rigid(gs.Gap(0.2, 0.25), restitution=0.0),
        "e": gs.Rigid(gs.Gap(0.2, 0.2), restitution=0.3),
    }
    found = gs.gradient(model, laws, "forcing", omega=0.425 / HZ)
    assert np.isnan(found["gradient"]).all()
    assert np.isfinite(found["value"].sel(quantity="amplitude[q_1]"))


def test_the_distance_from_a_graze_is_that_of_turning_points_towards_the_wall():
    """At resonance the free motion has the amplitude F / (c omega)."""
    law, names = gs.Rigid(gs.Gap(2.0, 1.0), restitution=0.8), ["forcing", "j_2", "restitution"]
    free = gs.gradient(impact_oscillator(0.09), law, names, omega=1.0 / HZ)
    assert free["value"].sel(quantity="graze").item() == pytest.approx(-0.1, rel=1e-9)
    assert_allclose(free["gradient"].sel(quantity="graze"), [10.0, -1.0, 0.0], atol=1e-9)
    impacts = gs.gradient(impact_oscillator(0.2), law, names, omega=1.0 / HZ)
    x_min = impacts["value"].sel(quantity="x_min").item()
    graze = impacts["value"].sel(quantity="graze").item()
    assert graze == pytest.approx(-2.0 - x_min, rel=1e-9)  # before the other wall


def test_folds_and_grazes_move_with_the_restitution():
    """Forces scale with lengths; the free amplitude F / (c omega) at a graze is the distance."""
    branch = gs.branches(
        impact_oscillator(0.03), stop(), "forcing", (0.02, 0.3), at=0.2, omega=1.0 / HZ
    )
    graze, fold = (
        gs.special_gradient(branch, number, ["j_2", "c", "restitution"]) for number in range(2)
    )
    assert [each.attrs["special"] for each in (graze, fold)] == ["grazing", "fold"]
    assert graze["value"].item() == pytest.approx(0.1, rel=1e-10)
    assert_allclose(graze["gradient"], [0.1, 1.0, 0.0], rtol=1e-8, atol=1e-12)
    by_place, _, by_restitution = fold["gradient"].values.tolist()
    assert by_place == pytest.approx(fold["value"].item(), rel=1e-9)
    places = []
    for e in (0.8 + 1e-3, 0.8 - 1e-3):
        nearby = gs.branches(
            impact_oscillator(0.03), stop(e=e), "forcing", (0.02, 0.3), at=0.2, omega=1.0 / HZ
        )
        (number,) = np.flatnonzero(nearby.gapsweep.special_points()["kind"] == "fold")
        places.append(gs.special_gradient(nearby, int(number), "j_2")["value"].item())
    assert by_restitution == pytest.approx((places[0] - places[1]) / 2e-3, rel=1e-4)


@pytest.mark.extended
def test_a_measured_sweep_has_the_place_and_the_restitution_of_a_stop():
    omega = np.linspace(0.8, 2.4, 40) / HZ
    state, measured = (0.0, 0.0), []
    for each in omega:  # as the sweep was measured
        end = gs.respond(impact_oscillator(), stop(0.5, 0.7), each, *state)
        state = end.x_end, end.v_end
        measured.append(end.amplitude)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(omega))
    table = {"frequency [Hz]": omega, "amplitude [m]": measured + noise, "sweep": ["up"] * 40}
    free = {"j_2": (0.3, 0.8), "restitution": (0.4, 0.95)}
    found = gs.fit(table, impact_oscillator(), stop(0.6, 0.6), free=free, noise=1e-4)
    assert found.is_on_branch.all()
    for name, value in (("j_2", 0.5), ("restitution", 0.7)):
        assert abs(found.values[name] - value) < 3.0 * found.errors[name]
        assert found.errors[name] < 1e-3
