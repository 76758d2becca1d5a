"""Published systems against their printed numbers, closed forms and other integrators.

The reference states were integrated twice: by scipy's DOP853, restarted at every located contact
(rtol 1e-12), and by matrix exponentials between contacts (the gear pair's periodic stiffness: by
Radau). They agree to 1.2e-11 (the gear pair: 3.6e-11). The limit cycles and bifurcations come from
those exponentials.
"""

import math

import numpy as np
import pytest
from scipy.fft import dst
from scipy.linalg import expm

import gapsweep as gs
from gapsweep.model.system import first_order

W = 2.0 * math.pi
EXACT = {"rtol": 1e-12, "atol": 1e-14}
PLUNGE = [0.01, 0.0, 0.0]


def state(motion):
    return np.concatenate([motion.q_end, motion.v_end, motion.z_end])


# The typical section.


def attached(speed, copy):
    """Matrix of the section whose flap hangs on its spring without freeplay."""
    system = gs.systems.typical_section(speed, copy)
    matrix = first_order(system)
    pull = np.linalg.solve(system.mass, system.contacts["flap"])
    matrix[3:6, 2] -= gs.systems.typical_section_law(copy).K_c * pull
    return matrix


def growth(speed, copy):
    """Largest growth rate of a swinging mode [1/s]."""
    rates = np.linalg.eigvals(attached(speed, copy))
    return rates[rates.imag > 1.0].real.max()


@pytest.mark.extended
@pytest.mark.parametrize(
    ("copy", "flutter", "frequency"),
    [
        ("darabseh", 23.8980, 6.0877),
        ("conner-scaled", 23.8459, 6.0794),
    ],
)
def test_linear_flutter(copy, flutter, frequency):
    assert growth(flutter - 1e-4, copy) < 0.0 < growth(flutter + 1e-4, copy)
    assert flutter == pytest.approx(23.9, rel=0.01)  # printed
    rates = np.linalg.eigvals(attached(flutter, copy))
    critical = rates[np.argmin(np.abs(rates.real) + 1e3 * (rates.imag < 1.0))]
    assert critical.imag / W == pytest.approx(frequency, abs=1e-4)


@pytest.mark.extended
@pytest.mark.parametrize(("speed", "grows"), [(23.85, False), (23.95, True)])
def test_a_motion_without_freeplay_grows_beyond_flutter_alone(speed, grows):
    law = gs.systems.typical_section_law(freeplay=0.0)
    section = gs.systems.typical_section(speed)
    early, late = (
        gs.simulate(section, law, q_0=PLUNGE, t_end=t_end, **EXACT) for t_end in (10.0, 40.0)
    )
    for motion in (early, late):
        expected = expm(attached(speed, "darabseh") * motion.t_end) @ [*PLUNGE, *np.zeros(5)]
        np.testing.assert_allclose(state(motion), expected, rtol=0, atol=1e-9)
    # Its flap swings through both walls, which are one, twice a period.
    assert late.n_contacts == pytest.approx(4 * 40.0 * 6.0877, rel=0.01)
    extrema = late.extrema["h"], late.t_extrema["h"]
    first, last = (np.abs(extrema[0][(extrema[1] > t)])[:12].max() for t in (10.0, 38.0))
    assert (last > first) == grows
    assert math.log(last / first) / 28.0 == pytest.approx(growth(speed, "darabseh"), rel=0.1)


@pytest.mark.extended
@pytest.mark.parametrize(
    ("copy", "m", "m_t", "zeta_h", "within"),
    [
        ("darabseh", 1.558, 3.3843, 0.0133, 1e-5),
        ("conner-scaled", 1.5666, 3.39298, 0.0113, 1e-9),
    ],
)
def test_the_copies_have_the_printed_frequencies_and_damping(copy, m, m_t, zeta_h, within):
    """Each coordinate alone, plunge with the mass of the wing alone."""
    vacuum = gs.systems.typical_section(10.0, copy, density=0.0)
    inertias = np.diag(vacuum.mass) * [m / m_t, 1.0, 1.0]
    springs = [*np.diag(vacuum.stiffness)[:2], gs.systems.typical_section_law(copy).K_c]
    rates = np.sqrt(springs / inertias)
    np.testing.assert_allclose(rates, [42.5352, 52.6506, 109.3093], rtol=within)
    zeta = np.diag(vacuum.damping) / (2.0 * inertias * rates)
    np.testing.assert_allclose(zeta, [zeta_h, 0.01626, zeta_h + 0.0002 * (m > 1.56)], rtol=1e-12)


def thin_airfoil(speed, density, a=-0.5, b=0.127, c=0.5, n=1 << 15):
    """Loads of the air by quadrature over the chord, with no constant of Theodorsen's.

    The bound potential of each coordinate's downwash is its sine series; x = cos(theta).
    """
    theta = (np.arange(n) + 0.5) * np.pi / n
    x, k = np.cos(theta), np.arange(1, n + 1)
    moved = [np.ones(n), b * (x - a), b * np.maximum(x - c, 0.0)]
    turned = [np.zeros(n), np.ones(n), (x > c) * 1.0]
    by_speed, by_place = (
        np.array([dst(f * np.sin(theta), type=2) / n for f in fs]) for fs in (moved, turned)
    )
    inner = b * b * np.pi * (by_speed / k) @ by_speed.T
    mixed = b * b * np.pi * (by_speed / k) @ by_place.T
    of_speed = np.array([np.mean(f * (1.0 + x)) for f in moved])
    of_place = speed * np.array([np.mean(f * (1.0 + x)) for f in turned])
    whole = 2.0 * density * speed * b * np.pi
    bound = whole * np.array([np.mean(f * x) for f in moved])
    return {
        "mass": density * inner,
        "damping": density * speed * (mixed - mixed.T) + np.outer(bound, of_speed),
        "stiffness": -density * speed**2 * b * b * np.pi * (by_place / k) @ by_place.T
        + np.outer(bound, of_place),
        "load": whole * np.array([np.mean(f * (1.0 - x)) for f in moved]),
        "of_speed": of_speed,
        "of_place": of_place,
    }


@pytest.mark.extended
def test_the_air_is_that_of_thin_airfoil_theory():
    speed, density = 12.0, 1.225
    air = thin_airfoil(speed, density)
    section = gs.systems.typical_section(speed)
    vacuum = gs.systems.typical_section(speed, density=0.0)
    parts, rates = np.array([0.165, 0.335]), np.array([0.0455, 0.300]) * speed / 0.127
    lags = section.lags

    arms = np.array([1.0, 0.127, 0.127])

    def close(found, expected):
        """All entries as forces and lengths, so that those of the flap count as much."""
        units = np.outer(arms, arms) if np.shape(expected) == (3, 3) else 1.0
        found, expected = found / units, expected / units
        np.testing.assert_allclose(found, expected, rtol=0, atol=4e-5 * np.abs(expected).max())

    close(section.mass - vacuum.mass, air["mass"])
    circulatory = np.outer(air["load"], air["of_speed"]), np.outer(air["load"], air["of_place"])
    close(section.damping - vacuum.damping, air["damping"] + 0.5 * circulatory[0])
    close(section.stiffness - vacuum.stiffness, air["stiffness"] + 0.5 * circulatory[1])
    close(lags.force, np.outer(air["load"], parts))
    close(lags.of_speed, np.outer(rates, air["of_speed"]))
    close(lags.of_place, np.outer(rates, air["of_place"]))
    close(lags.of_lags, np.diag(-rates))


# copy, speed [m/s], extrema of the flap [deg, or mirrored], frequency [Hz], wall crossings a period
LIMIT_CYCLES = [
    ("darabseh", 5.0, 2.6422935, 2.6422935, 4.6218515, 4),
    ("darabseh", 8.0, 2.8088391, 2.8088391, 4.7974676, 4),
    ("darabseh", 11.0, 3.3181361, 2.3883012, 4.9801916, 4),
    ("darabseh", 16.0, 3.7167767, 3.7167767, 11.1420650, 4),
    ("darabseh", 20.0, 3.8456381, 3.8456381, 11.3533786, 4),
    ("conner-scaled", 8.0, 2.8149284, 2.8149284, 4.8077082, 4),
    ("conner-scaled", 12.36842, 3.4291061, 2.4621163, 5.1000493, 6),  # printed: not symmetric
    ("conner-scaled", 12.63158, 3.4522829, 2.4839996, 5.1223862, 6),
    ("conner-scaled", 13.0, 3.4838154, 3.4838149, 10.8332683, 4),  # beyond the printed change
]


@pytest.mark.extended
@pytest.mark.parametrize(
    ("copy", "speed", "larger", "smaller", "frequency", "crossings"), LIMIT_CYCLES
)
def test_limit_cycles_of_the_section(copy, speed, larger, smaller, frequency, crossings):
    section = gs.systems.typical_section(speed, copy)
    law = gs.systems.typical_section_law(copy)
    far = gs.simulate(section, law, q_0=PLUNGE, t_end=40.0, rtol=1e-11)
    late = gs.simulate(
        section, law, q_0=far.q_end, v_0=far.v_end, z_0=far.z_end, t_end=2.0, rtol=1e-11
    )
    times = late.t_contacts["flap"]
    periods = times[crossings:] - times[:-crossings]
    np.testing.assert_allclose(periods, 1.0 / frequency, rtol=1e-6)
    flap = np.degrees(late.extrema["beta"])
    found = sorted([-flap.min(), flap.max()])
    np.testing.assert_allclose(found, [smaller, larger], rtol=1e-6)


@pytest.mark.extended
def test_the_printed_change_of_limit_cycle():
    """Printed at 12.7778 m/s: one like those at 12.63 m/s gives way to one like that at 13 m/s."""
    law = gs.systems.typical_section_law("conner-scaled")
    for speed, is_symmetric, crossings, frequency in (
        (12.72, False, 6, 5.1224),
        (12.7778, True, 4, 10.8333),
    ):
        section = gs.systems.typical_section(speed, "conner-scaled")
        far = gs.simulate(section, law, q_0=PLUNGE, t_end=300.0)
        late = gs.simulate(section, law, q_0=far.q_end, v_0=far.v_end, z_0=far.z_end, t_end=2.0)
        times, flap = late.t_contacts["flap"], np.degrees(late.extrema["beta"])
        periods = times[crossings:] - times[:-crossings]
        np.testing.assert_allclose(periods, periods[0], rtol=1e-5)
        assert 1.0 / periods[0] == pytest.approx(frequency, rel=0.005)
        offset = abs(flap.max() + flap.min())
        assert offset < 1e-3 if is_symmetric else offset > 0.9


@pytest.mark.extended
def test_the_section_comes_to_rest_in_slow_air():
    """Conner's scaled copy has no limit cycle at 4.5 m/s, but one at 4.75 m/s."""
    law = gs.systems.typical_section_law("conner-scaled")
    slow, fast = (
        gs.simulate(gs.systems.typical_section(speed, "conner-scaled"), law, q_0=PLUNGE, t_end=40.0)
        for speed in (4.5, 4.75)
    )
    assert np.abs(slow.q_end).max() < 1e-5
    assert slow.t_contacts["flap"].max() < 30.0
    assert fast.t_contacts["flap"].max() > 39.5


# Two masses.


def two_masses(rate, t_end, *, q_0=0.0, v_0=0.0, tangent=False):
    system, law = gs.systems.two_masses(), gs.systems.two_masses_law()
    return gs.simulate(
        system, law, omega=rate / W, q_0=q_0, v_0=v_0, t_end=t_end, tangent=tangent, **EXACT
    )


def linear_response(system, rate):
    """Complex amplitude out of contact."""
    dynamic = system.stiffness - rate**2 * system.mass + 1j * rate * system.damping
    return np.linalg.solve(dynamic, system.forcing[0].amplitude)


def grazing_of_two_masses():
    """2 pi omega at which the linear |x_1| = 1, by the determinant ``s² - 3 s u + u²``.

    ``s = 1 + 0.03 i sqrt(u)``, ``u`` the squared rate: ``|det|² = 0.01 |s|²`` is a quartic in u.
    """
    u, c = np.polynomial.Polynomial([0.0, 1.0]), 0.03**2
    quartic = (
        (1.0 - (3.0 + c) * u + u**2) ** 2 + c * u * (2.0 - 3.0 * u) ** 2 - 0.01 * (1.0 + c * u)
    )
    roots = quartic.roots()
    return np.sqrt(np.sort(roots[np.abs(roots.imag) < 1e-9].real))


def soft_impact(rate, t_end, *, q_0=0.0, v_0=0.0):
    system, law = gs.systems.soft_impact_oscillator(), gs.systems.soft_impact_oscillator_law()
    return gs.simulate(system, law, omega=rate / W, q_0=q_0, v_0=v_0, t_end=t_end, **EXACT)


def grazing_of_soft_impact(zeta=0.01, load=0.9 * 0.8**2 / 1.26):
    """2 pi omega at which the linear |x| = 1: ``(1 - u)² + 4 zeta² u = load²``."""
    middle = 1.0 - 2.0 * zeta**2
    spread = math.sqrt(middle**2 - 1.0 + load**2)
    return np.sqrt([middle - spread, middle + spread])


@pytest.mark.extended
@pytest.mark.parametrize(
    ("system", "run", "grazing", "expected"),
    [
        ("two_masses", two_masses, grazing_of_two_masses, [0.5818996390393, 0.6534401404164]),
        (
            "soft_impact_oscillator",
            soft_impact,
            grazing_of_soft_impact,
            [0.7369496600, 1.2068575700],
        ),
    ],
)
def test_grazing_frequencies(system, run, grazing, expected):
    system = getattr(gs.systems, system)()
    low, high = [root for root in grazing() if 0.55 < root < 1.3]
    np.testing.assert_allclose([low, high], expected, atol=1e-8)
    # On the linear response, the wall is met between the two, and nowhere beside.
    for rate, touches in ((low, 1.0), (high, -1.0)):
        for sign in (1.0, -1.0):
            shifted = rate * (1.0 + sign * 1e-7)
            swing = linear_response(system, shifted)
            q_0, v_0 = swing.real, -shifted * swing.imag
            motion = run(shifted, 3.0 * W / shifted, q_0=q_0, v_0=v_0)
            assert bool(motion.n_contacts) == (sign == touches)
            if sign != touches:
                largest = motion.extrema[system.coordinates[0]].max()
                assert largest == pytest.approx(abs(swing[0]), abs=1e-11)


@pytest.mark.extended
def test_the_response_of_two_masses_at_the_printed_frequencies():
    """Of one period at 0.635, and of none up to 16 at 0.6."""
    settled = [0.9613616, 0.65788321, 0.31679085, 0.08600155]
    motion = two_masses(0.635, 600 * W / 0.635, q_0=[0.95, 0.6])
    np.testing.assert_allclose(state(motion), settled, atol=1e-7)
    assert motion.extrema["x_1"][-40:].max() == pytest.approx(1.0241765, abs=1e-7)
    section = two_masses(0.6, 600 * W / 0.6, q_0=[0.95, 0.6]).section[400:]
    for periods in range(1, 17):
        assert np.abs(section[periods:] - section[:-periods]).max() > 1e-3


# What bifurcates, 2 pi omega, the start of the periodic orbit (x_1, x_2, x_1', x_2'), and its
# two critical multipliers, to the digits that exponentials gave.
BIFURCATIONS = [
    (
        "Neimark-Sacker",
        0.618606874,
        [0.97276704, 0.64513736, 0.24830191, 0.0705074],
        [-0.06976 + 0.99756j, -0.06976 - 0.99756j],
    ),
    (
        "period doubling",
        0.738783025,
        [0.4454693, 0.46330273, 0.64172537, 1.01734237],
        [-1.0, 0.7955 + 0.20632j],
    ),
    (
        "period doubling",
        0.755586159,
        [-0.60288937, -0.81067582, 1.03970326, 0.27409367],
        [-1.0, 0.98988],
    ),
    (
        "fold",
        0.755627353,
        [-0.67602946, -0.81760471, 1.05087819, 0.190766],
        [1.0, -0.90547],
    ),
]


@pytest.mark.extended
@pytest.mark.parametrize(("kind", "rate", "start", "critical"), BIFURCATIONS)
def test_bifurcations_of_two_masses(kind, rate, start, critical):
    orbit = two_masses(rate, W / rate, q_0=start[:2], v_0=start[2:], tangent=True)
    np.testing.assert_allclose(state(orbit), start, rtol=0, atol=3e-7)
    assert orbit.n_contacts == 2
    multipliers = np.linalg.eigvals(orbit.monodromy)
    for multiplier in critical:
        assert np.abs(multipliers - multiplier).min() < 1e-4, kind
    shrinks = math.exp(-0.03 * 3.0 * W / rate)
    assert np.prod(multipliers).real == pytest.approx(shrinks, rel=1e-9)


# The soft impact oscillator and the gear pair.


@pytest.mark.extended
def test_a_motion_of_the_soft_impact_oscillator():
    motion = soft_impact(0.8, 50.0)
    assert motion.n_contacts == 6
    np.testing.assert_allclose(state(motion), [-0.208328011543, -0.664315253597], atol=1e-9)


@pytest.mark.extended
@pytest.mark.parametrize(
    ("rate", "periods", "largest", "orbit"),
    [
        (0.7, 1, 0.8960210, [0.8956836, 0.01721117]),
        (0.8, 2, 1.1779988, [0.38467804, 0.07749053]),
        (1.0, 3, 1.2409426, [0.81470902, 0.10815246]),
        (1.1, 1, 1.2038502, [1.19334898, 0.36965066]),
    ],
)
def test_responses_of_the_soft_impact_oscillator(rate, periods, largest, orbit):
    settled = soft_impact(rate, 798 * W / rate)
    again = soft_impact(rate, 6 * W / rate, q_0=settled.q_end, v_0=settled.v_end)
    repeats = [k for k in range(1, 4) if np.abs(again.section[k] - again.section[0]).max() < 1e-7]
    assert repeats[0] == periods
    assert np.abs(again.section - orbit).max(axis=1).min() < 1e-7
    assert again.extrema["x"].max() == pytest.approx(largest, abs=1e-6)


@pytest.mark.extended
def test_smooth_laws_of_the_stop_of_two_masses_find_the_exact_periods():
    stop = gs.systems.two_masses_law()
    omega = [0.085, 0.094, 0.098, 0.1011, 0.12]
    for label in ("piecewise", "piecewise-noevents", "tanh-1e3", "arctan-1e5"):
        law = gs.contact_law(label, stop.K_c, stop.gap, K_ratio=stop.K_ratio)
        found = gs.respond(gs.systems.two_masses(), law, omega=omega)
        assert found.period_multiple.tolist() == [1, 6, 4, 1, 1], label
        assert set(found.response_class) == {gs.ResponseClass.PERIODIC}, label


@pytest.mark.extended
def test_an_arctan_stop_on_one_side_has_the_force_of_its_one_wall():
    for stop in (gs.systems.two_masses_law(), gs.systems.soft_impact_oscillator_law()):
        law = gs.contact_law("arctan-1e3", stop.K_c, stop.gap, K_ratio=stop.K_ratio)
        depth = np.linspace(-3.0, 1.0, 9)
        one_wall = (0.5 + np.arctan(1e3 * depth) / np.pi) * stop.K_c * depth
        np.testing.assert_allclose(law.force(1.0 + depth), one_wall, rtol=1e-12, atol=0.0)


@pytest.mark.extended
def test_no_motion_reaches_the_other_wall_of_a_one_sided_stop():
    motion = soft_impact(0.8, 10.0, q_0=[-2e3])
    assert gs.Status(motion.status) is gs.Status.DIVERGED
    assert motion.n_contacts == 0


@pytest.mark.extended
@pytest.mark.parametrize(
    ("rate", "n_contacts", "end"),
    [
        (0.5, 52, [0.997089104208, -0.015924073218]),
        (0.84, 52, [0.852638726753, -0.003661724453]),
        (1.2, 15, [1.097325705256, 0.080721303772]),
    ],
)
def test_motions_of_the_gear_pair(rate, n_contacts, end):
    gears, law = gs.systems.gear_pair(), gs.systems.gear_pair_law()
    motion = gs.simulate(gears, law, omega=rate / W, t_end=200.0, tangent=True, **EXACT)
    assert motion.n_contacts == n_contacts
    np.testing.assert_allclose(state(motion), end, rtol=0, atol=1e-9)
    assert np.linalg.det(motion.monodromy) == pytest.approx(math.exp(-0.1 * 200.0), rel=1e-6)


@pytest.mark.extended
def test_the_module_shows_machines_and_their_laws():
    shown = {name for name in dir(gs.systems) if name.islower()}
    systems = {"gear_pair", "soft_impact_oscillator", "two_masses", "typical_section"}
    assert shown == systems | {f"{name}_law" for name in systems} | {"paper_oscillator"}


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: gs.systems.typical_section(0.0), r"speed = 0: must be > 0"),
        (lambda: gs.systems.typical_section(math.nan), r"speed = nan: must be finite"),
        (lambda: gs.systems.typical_section(12.0, density=-1.0), r"density = -1: must be >= 0"),
        (lambda: gs.systems.typical_section(12.0, "conor"), r"copy = 'conor': must be one of"),
        (lambda: gs.systems.typical_section_law("conor"), r"copy = 'conor': must be one of"),
        (lambda: gs.systems.typical_section_law(freeplay=-0.1), r"freeplay = -0.1: must be >= 0"),
        (lambda: gs.systems.gear_pair(zeta=-1.0), r"zeta = -1: must be >= 0"),
        (lambda: gs.systems.gear_pair(mean_load=math.nan), r"mean_load = nan: must be finite"),
        (lambda: gs.systems.gear_pair(errors=("a",)), r"errors = 'a': must be a number"),
        (lambda: gs.systems.soft_impact_oscillator(zeta=-1.0), r"zeta = -1: must be >= 0"),
        (lambda: gs.systems.soft_impact_oscillator(load=math.inf), r"load = inf: must be finite"),
        (lambda: gs.systems.soft_impact_oscillator_law(ratio=-2.0), r"ratio = -2: must be >= 0"),
    ],
)
def test_wrong_arguments_are_named(call, said):
    with pytest.raises(gs.ModelError, match=said):
        call()
