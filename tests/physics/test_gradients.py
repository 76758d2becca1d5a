"""Derivatives of steady quantities: exact flows, identities of dimensions, and differences.

The numbers of `test_derivatives_of_a_response`, of the graze and of the fold come from exact flows
of the piecewise linear oscillator with 30 digits, differentiated by differences, and from
variational equations integrated by DOP853; both agree to 1e-11.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gapsweep as gs

HZ = 2.0 * math.pi
LAW = gs.Piecewise(2.0, gs.Gap(0.1745, 0.1745))


def machine(forcing=0.03, **numbers):
    return gs.Oscillator(mass=1.0, omega_n=1.0 / HZ, zeta=0.0, c=0.05, forcing=forcing, **numbers)


def of(found, quantity):
    """Derivatives of one quantity, by parameter."""
    part = found["gradient"].sel(quantity=quantity)
    return dict(zip(found["parameter"].values.tolist(), part.values.T, strict=True))


def test_derivatives_of_a_response():
    names = ["mass", "c", "omega_n", "forcing", "omega", "gap", "K_c"]
    found = gs.gradient(machine(), LAW, names, omega=1.3 / HZ, x_0=0.22, v_0=0.34)
    x_max = found["value"].sel(quantity="x_max").item()
    assert x_max == pytest.approx(0.3439540565413045, abs=1e-14)
    by = of(found, "x_max")
    by_spring = by["omega_n"] / (2.0 * HZ)  # k = m (2 pi omega_n)^2, at unit mass and rate
    assert_allclose(
        [by["mass"] - by_spring, by["c"], by_spring, by["forcing"], by["omega"] / HZ, by["gap"]],
        [
            *(0.461312104750353, -0.389199776430564, -0.275890041920084, 1.20556331871704),
            *(0.694741708214753, 1.76382324916787),
        ],
        rtol=0,
        atol=1e-11,
    )
    assert by["K_c"] == pytest.approx(-0.101064486785126, abs=1e-11)


def test_the_side_of_a_graze_counts():
    graze = 0.01892540793813967  # forcing [N] at which the motion touches the wall
    law = gs.Piecewise(2000.0, gs.Gap(10.0, 0.1745), K_ratio=0.0)
    model, omega = machine(graze * (1.0 + 1e-6)), 0.95 / HZ
    found = gs.gradient(model, law, "forcing", omega=omega, rtol=1e-13)
    assert of(found, "x_min")["forcing"] == pytest.approx(-1.131257804, abs=2e-9)
    beyond = found["value"].sel(quantity="graze").item()
    assert 0.0 < beyond < 1e-7
    free = gs.gradient(machine(graze * (1.0 - 1e-6)), law, "forcing", omega=omega)
    assert free["value"].sel(quantity="graze").item() == pytest.approx(-0.1745e-6, rel=1e-6)
    assert of(free, "x_min")["forcing"] == pytest.approx(-0.1745 / graze, rel=1e-9)


@pytest.mark.parametrize(
    ("pulls", "x_max", "derivatives"),
    [
        (
            True,
            0.1808062719684468,
            [
                *(0.06482514250587, -0.02342116007001, -0.07290717976166, 0.4325884337687),
                *(0.1350946061898, 0.9617685900022, -0.0001792603312902, -0.000116125939974),
            ],
        ),
        (
            False,
            0.1806356044368126,
            [
                *(0.06414550572019, -0.02268819796644, -0.0720810935183, 0.4271992420521),
                *(0.1333886472027, 0.9617170611762, -0.0001654296432795, -0.000364488916286),
            ],
        ),
    ],
)
def test_derivatives_with_contact_damping(pulls, x_max, derivatives):
    law = gs.Piecewise(20.0, gs.Gap(10.0, 0.1745), K_ratio=0.0, damping=1.2, pulls=pulls)
    names = ["mass", "c", "omega_n", "forcing", "omega", "j_2", "K_c", "damping"]
    found = gs.gradient(machine(), law, names, omega=0.95 / HZ)
    assert found["value"].sel(quantity="x_max").item() == pytest.approx(x_max, abs=1e-13)
    by = of(found, "x_max")
    by_spring = by.pop("omega_n") / (2.0 * HZ)
    by["omega"] /= HZ
    mass, c, *others = by.values()
    got = [mass - by_spring, c, by_spring, *others]
    assert_allclose(got, derivatives, rtol=0, atol=1e-11)


@pytest.mark.parametrize("mean_load", [0.0, 0.004])  # a classic oscillator, and the general form
def test_derivatives_with_hunt_crossley(mean_load):
    names = ["mass", "c", "omega_n", "forcing", "omega", "j_1", "j_2", "K_c", "K_ratio", "chi"]
    law = gs.HuntCrossley(20.0, gs.Gap(0.16, 0.1745), K_ratio=0.7, chi=1.5)
    model, omega = machine(mean_load=mean_load), 0.95 / HZ
    found = gs.gradient(model, law, names, omega=omega)
    by = found["gradient"].sel(quantity=["x_max", "x_min", "contact_share"])
    for name in names:
        holder = next((x for x in (model, law) if hasattr(x, name)), law.gap)
        place = omega if name == "omega" else getattr(holder, name)
        ends = []
        for step in (-2e-4, -1e-4, 1e-4, 2e-4):
            value = place * (1.0 + step)
            here = holder if name == "omega" else replace(holder, **{name: value})
            end = gs.respond(
                here if holder is model else model,
                here if holder is law else replace(law, gap=here) if holder is law.gap else law,
                omega=value if name == "omega" else omega,
                rtol=1e-13,
                steady=gs.Steady(settle_tol=1e-11),
            )
            ends.append([end.x_max, end.x_min, end.contact_share])
        weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12e-4 * place)
        difference = weights @ np.array(ends)
        error = np.abs(by.sel(parameter=name).values - difference).max()
        assert error < 1e-8 * np.abs(difference).max() + 1e-9 / abs(place), name


@pytest.mark.extended
@pytest.mark.parametrize("is_wave", [True, False])
def test_derivatives_of_responses_in_two_periods_at_one_wall(is_wave):
    """A damped wall that presses under a square wave, and a wall without a gap."""
    if is_wave:
        force = gs.Switched([0.0, 0.4], [-0.03, 0.02])
        model, law = machine(force), gs.Piecewise(5.0, gs.Gap(None, -0.004), damping=0.3)
        omega, names = 0.9 / HZ, ["j_2", "K_c", "damping", "c"]
    else:
        model, law = machine(0.3), gs.Piecewise(20.0, gs.Gap(None, 0.0))
        omega, names = 3.0 / HZ, ["j_2", "K_c", "c"]
    quantities, options = ["x_max", "x_min", "amplitude"], {"rtol": 1e-13}
    options |= {"steady": gs.Steady(settle_tol=1e-11)}
    at = gs.respond(model, law, omega=omega, **options)
    assert (at.period_multiple, at.n_contacts > 0) == (2, True)
    found = gs.gradient(model, law, names, omega=omega)["gradient"].sel(quantity=quantities)
    for name in names:
        place = law.gap.j_2 if name == "j_2" else getattr(model if name == "c" else law, name)
        step, ends = 1e-3 * (place or 0.01), []
        for k in (-2, -1, 1, 2):
            value = place + k * step
            there = replace(model, c=value) if name == "c" else model
            wall = (
                law
                if name == "c"
                else replace(
                    law, **{name: value} if name != "j_2" else {"gap": gs.Gap(None, value)}
                )
            )
            end = gs.respond(there, wall, omega=omega, x_0=at.x_end, v_0=at.v_end, **options)
            ends.append([end.x_max, end.x_min, end.amplitude])
        difference = np.array([1.0, -8.0, 8.0, -1.0]) @ np.array(ends) / (12.0 * step)
        assert_allclose(found.sel(parameter=name), difference, rtol=1e-6, atol=1e-8, err_msg=name)


def _drawn(n, seed):
    rng = np.random.default_rng(seed)
    m, k, force = 10 ** rng.uniform((-0.5, -0.5, -1.0), (0.5, 0.5, 1.0), (n, 3)).T
    c = 2.0 * 10 ** rng.uniform(-2.0, -1.0, n) * np.sqrt(k * m)
    stiffness, gap = k * 10 ** rng.uniform(-0.5, 2.0, n), force / k * rng.uniform(0.3, 3.0, n)
    rate, ratio = np.sqrt(k / m) * rng.uniform(0.6, 1.6, n), rng.uniform(0.3, 2.0, n)
    return m, c, k, force, stiffness, gap, rate, ratio


def _identities_hold(n, seed, most_aperiodic):
    m, c, k, force, stiffness, gap, rate, ratio = _drawn(n, seed)
    models = [
        gs.Oscillator(
            mass=m[i], omega_n=np.sqrt(k[i] / m[i]) / HZ, zeta=0.0, c=c[i], forcing=force[i]
        )
        for i in range(n)
    ]
    laws = [
        gs.Piecewise(stiffness[i], gs.Gap(gap[i], 1.2 * gap[i]), K_ratio=ratio[i]) for i in range(n)
    ]
    names = ["mass", "c", "omega_n", "forcing", "omega", "j_1", "j_2", "K_c"]
    found = gs.gradient(models, laws, names, omega=rate / HZ)
    is_periodic = np.isfinite(found["value"].values[:, 0])
    assert is_periodic.sum() >= n - most_aperiodic
    for quantity in ("x_max", "x_min"):
        by, x = of(found, quantity), found["value"].sel(quantity=quantity).values
        by_k = by["omega_n"] / (2.0 * m * np.sqrt(k / m) * HZ)
        by_m, by_rate = by["mass"] - by_k * k / m, by["omega"] / HZ
        damped, sprung = c * by["c"], k * by_k + stiffness * by["K_c"]
        forced = force * by["forcing"]
        residuals = [
            gap * by["j_1"] + 1.2 * gap * by["j_2"] + forced - x,  # lengths
            m * by_m + damped + sprung + forced,  # forces
            damped + 2.0 * sprung + rate * by_rate + 2.0 * forced,  # times
        ]
        share = np.abs(np.array(residuals) / x)[:, is_periodic]
        assert share.max() < 1e-10


def test_gradients_keep_the_identities_of_dimensions():
    _identities_hold(30, seed=1, most_aperiodic=2)


@pytest.mark.extended
def test_gradients_keep_the_identities_of_dimensions_in_300_drawn_cases():
    _identities_hold(300, seed=2, most_aperiodic=15)


def _two_masses(k=1.3, m=1.0, bend=0.4, turn=1.0):
    return gs.System(
        coordinates=["a", "b"],
        mass=np.diag([m, 0.5]),
        stiffness=[[2.0, -1.0], [-1.0, k]],
        damping=[[0.1, -0.02], [-0.02, 0.06]],
        contacts={"stop": [turn, -1.0], "end": [0.0, 1.0]},
        cubic=[gs.Cubic(alpha=0.7, along=[1, 0]), gs.Cubic(alpha=bend, along=[1, -0.5])],
        lags=gs.Lags(
            force=[[0.1], [0.05]],
            of_speed=[[0.3, bend]],
            of_place=[[0.2, 0.1]],
            of_lags=[[-2.0 * k]],
        ),
        forcing=[
            gs.Harmonic(amplitude=[0.5, 0.0]),
            gs.Harmonic(amplitude=[0.0, 0.02], k=2, phase=0.3, power=1),
            gs.Harmonic(amplitude=[0.05, 0.02], k=0),
        ],
    )


def _laws(stop=3.0, end=5.0, gap=0.2, ratio=0.7):
    return {
        "stop": gs.Piecewise(stop, gs.Gap(0.2, 0.25), K_ratio=ratio),
        "end": gs.Piecewise(end, gs.Gap(gap, gap)),
    }


def test_a_system_with_lags_loads_and_two_contacts():
    names = ["k", "m", "bend", "omega", "K_c[stop]", "K_c[end]", "gap[end]", "K_ratio[stop]"]
    found = gs.gradient(_two_masses, _laws(), names, omega=0.19)
    moved = {
        "k": lambda p: (_two_masses(k=p), _laws(), 0.19),
        "m": lambda p: (_two_masses(m=p), _laws(), 0.19),
        "bend": lambda p: (_two_masses(bend=p), _laws(), 0.19),
        "omega": lambda p: (_two_masses(), _laws(), p),
        "K_c[stop]": lambda p: (_two_masses(), _laws(stop=p), 0.19),
        "K_c[end]": lambda p: (_two_masses(), _laws(end=p), 0.19),
        "gap[end]": lambda p: (_two_masses(), _laws(gap=p), 0.19),
        "K_ratio[stop]": lambda p: (_two_masses(), _laws(ratio=p), 0.19),
    }
    places = dict(zip(names, (1.3, 1.0, 0.4, 0.19, 3.0, 5.0, 0.2, 0.7), strict=True))
    for name, place in places.items():
        ends = []
        for sign in (1.0, -1.0):
            model, laws, omega = moved[name](place * (1.0 + sign * 1e-5))
            steady = gs.Steady(settle_tol=1e-9)
            end = gs.respond(model, laws, omega=omega, rtol=1e-12, steady=steady)
            numbers = [end.x_max, end.x_min, end.amplitude, end.contact_share, end.force_max]
            ends.append(np.concatenate([np.ravel(each) for each in numbers]))
        change = (ends[0] - ends[1]) / (2e-5 * place)
        columns = [f"{x}[{q}]" for x in ("x_max", "x_min", "amplitude") for q in ("a", "b")]
        columns += [f"{x}[{b}]" for x in ("contact_share", "force_max") for b in ("stop", "end")]
        got = found["gradient"].sel(parameter=name, quantity=columns).values
        assert_allclose(got, change, rtol=1e-5, atol=1e-6 * np.abs(change).max())
    with pytest.raises(gs.ModelError, match="direction of a contact"):
        gs.gradient(_two_masses, _laws(), "turn", omega=0.19)


def test_a_linear_system_follows_its_compliance():
    def model(k=3.0, m=2.0):
        return gs.System(
            mass=[[m, 0.0], [0.0, 1.0]],
            stiffness=[[k, -1.0], [-1.0, 2.0]],
            damping=0.1 * np.eye(2),
            forcing=[gs.Harmonic(amplitude=[1.0, 0.0])],
        )

    def amplitude(k=3.0, m=2.0, omega=0.2):
        rate, one = HZ * omega, model(k, m)
        matrix = one.stiffness - rate**2 * one.mass + 1j * rate * one.damping
        return np.abs(np.linalg.solve(matrix, [1.0, 0.0]))

    found = gs.gradient(model, {}, ["k", "m", "omega", "forcing"], omega=[0.2, 0.3])
    assert found["gradient"].dims == ("omega", "quantity", "parameter")
    names = ["x_max[q_1]", "x_max[q_2]"]
    for omega in (0.2, 0.3):
        here = found["gradient"].sel(omega=omega, quantity=names)
        for name, place in (("k", 3.0), ("m", 2.0), ("omega", omega)):
            given = {"omega": omega} | {name: place}
            step = 1e-5 * place
            ends = [amplitude(**given | {name: place + sign * step}) for sign in (1.0, -1.0)]
            change = (ends[0] - ends[1]) / (2.0 * step)
            assert_allclose(here.sel(parameter=name), change, rtol=1e-7)
        assert_allclose(here.sel(parameter="forcing"), amplitude(omega=omega), rtol=1e-9)


@pytest.mark.extended
def test_the_period_of_a_limit_cycle():
    def model(circulation=25.0):
        return gs.System(
            mass=np.eye(2),
            damping=0.3 * np.eye(2),
            stiffness=[[100.0, circulation], [-circulation, 110.0]],
            cubic=[gs.Cubic(along=[1, 0], alpha=4e4), gs.Cubic(along=[0, 1], alpha=1e4)],
            contacts={"stop": [1.0, 0.0]},
        )

    law = gs.Piecewise(2e3, gs.Gap(5e-3, 6e-3))
    found = gs.gradient(model, law, ["circulation", "gap"], q_0=[0.01, -0.01])
    ends = []
    for by in (1e-3, -1e-3):
        end = gs.respond(model(25.0 + by), law, q_0=[0.01, -0.01], rtol=1e-12)
        ends.append([end.period, *end.x_max, end.contact_share])
    change = (np.array(ends[0]) - ends[1]) / 2e-3
    names = ["period", "x_max[q_1]", "x_max[q_2]", "contact_share[stop]"]
    got = found["gradient"].sel(quantity=names, parameter="circulation").values
    assert_allclose(got, change, rtol=1e-5)


def test_a_fold_and_a_graze_move_with_the_parameters():
    branch = gs.branches(machine(), LAW, "omega", (1.0 / HZ, 1.6 / HZ), at=1.3 / HZ)
    fold = gs.special_gradient(branch, 0, ["gap", "K_c", "forcing"])
    assert fold["value"].item() * HZ == pytest.approx(1.410297642910979, abs=1e-12)
    expected = [-1.55984757781, 0.140776343464, 9.07311341091]
    assert_allclose(fold["gradient"].values * HZ, expected, rtol=0, atol=1e-10)
    number = int((branch["special"].values > 0).sum()) - 1
    graze = gs.special_gradient(branch, number, ["gap", "K_c", "forcing"])
    rate = HZ * graze["value"].item()
    assert 0.03 / math.hypot(1.0 - rate**2, 0.05 * rate) == pytest.approx(0.1745, rel=1e-11)
    # the linear amplitude F / D stays on the wall; its stiffness does not count
    slope = -(2.0 * rate * (rate**2 - 1.0) + 0.0025 * rate) * 0.1745**3 / 0.03**2
    by_gap, by_stiffness, by_force = graze["gradient"].values * HZ
    assert_allclose([by_gap, by_force], [1.0 / slope, -0.1745 / 0.03 / slope], rtol=1e-8)
    assert abs(by_stiffness) < 1e-9


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: gs.gradient(machine(), LAW, "stiffness", omega=0.2), ["'stiffness'", "K_c"]),
        (lambda: gs.gradient(machine(), LAW, [], omega=0.2), ["parameters", "K_c"]),
        (lambda: gs.gradient(machine(), LAW, "gap", omega=0.2, engine="scipy"), ["scipy"]),
        (
            lambda: gs.gradient(machine(), gs.Tanh(2.0, LAW.gap, epsilon=1e3), "gap", omega=0.2),
            ["Tanh", "Piecewise"],
        ),
        (
            lambda: gs.gradient(machine(mean_load=0.0), LAW, "mean_load", omega=0.2),
            ["mean_load", "small value"],
        ),
        *(
            (
                lambda law=law, name=name: gs.gradient(machine(), law, name, omega=0.2),
                [name, "wall"],
            )
            for law, name in (
                (gs.Piecewise(0.0, LAW.gap), "K_c"),
                (gs.Piecewise(2.0, LAW.gap, K_ratio=0.0), "K_ratio"),
            )
        ),
    ],
)
def test_what_has_no_gradient_is_refused_in_one_line(call, words):
    with pytest.raises(gs.ModelError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    assert all(word in text for word in words)


def test_oscillators_in_a_batch_have_the_same_quantities():
    models = [machine(mean_load=load) for load in (0.0, 0.01)]
    found = gs.gradient(models, LAW, "K_c", omega=0.2, x_0=0.2)
    alone = [gs.gradient(each, LAW, "K_c", omega=0.2, x_0=0.2) for each in models]
    for i, each in enumerate(alone):
        assert each["quantity"].values.tolist() == found["quantity"].values.tolist()
        assert_allclose(found["gradient"].values[i], each["gradient"].values, rtol=1e-9)


@pytest.mark.parametrize("mean_load", [0.0, 0.004])  # a classic oscillator, and the general form
@pytest.mark.parametrize("pulls", [False, True])
def test_walls_that_meet_move_apart_with_damping(mean_load, pulls):
    law = gs.Piecewise(2.0, gs.Gap(0.0, 0.0), damping=0.4, pulls=pulls)
    model, omega, step = machine(mean_load=mean_load), 0.2, 2e-6
    by = gs.gradient(model, law, ["gap", "j_1", "j_2"], omega=omega)["gradient"]
    for name, moves in (("gap", (1.0, 1.0)), ("j_1", (1.0, 0.0)), ("j_2", (0.0, 1.0))):
        gaps = [gs.Gap(*(step * k * move for move in moves)) for k in range(3)]
        laws = [replace(law, gap=gap) for gap in gaps]
        x_max = gs.respond(model, laws, omega=omega, rtol=1e-13).x_max
        difference = (-3.0 * x_max[0] + 4.0 * x_max[1] - x_max[2]) / (2.0 * step)
        got = by.sel(quantity="x_max", parameter=name).item()
        assert got == pytest.approx(difference, rel=1e-5)


def test_chaos_has_no_gradient():
    law = gs.Piecewise(100.0, gs.Gap(10.0, 0.0), K_ratio=0.0)
    model = gs.Oscillator(mass=1.0, omega_n=1.0 / HZ, zeta=0.0, c=0.05, forcing=1.0)
    classes = gs.respond(model, law, omega=np.linspace(0.3, 0.8, 60))
    (where,) = np.nonzero(classes.response_class == gs.ResponseClass.CHAOTIC)
    omega = classes.inputs["omega"][where[0]]
    with pytest.raises(gs.ModelError, match="chaotic"):
        gs.gradient(model, law, "K_c", omega=omega)
    found = gs.gradient(model, law, "K_c", omega=[omega, 0.1])
    is_known = np.isfinite(found["gradient"].sel(quantity="x_max", parameter="K_c").values)
    assert is_known.tolist() == [False, True]
