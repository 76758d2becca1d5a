"""Static equilibria against closed forms, other root finders and prescribed roots."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial, chebyshev
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import brentq
from tests.builders import strategies as own

import gapsweep as gs
from gapsweep.model.contact import ContactLaw
from gapsweep.model.equilibria import (
    equilibria,
    linear_stiffness,
    restoring_force,
    restoring_slope,
    search_points,
    sign_changes,
)
from gapsweep.model.fit import Fit

OSCILLATOR = gs.systems.paper_oscillator()
RANGE = 4e-3
SYMMETRIC = gs.Gap(0.4e-3, 0.4e-3)
HARD = 1.4e6


@dataclass(frozen=True)
class Prescribed(ContactLaw):
    """A law that makes the restoring force ``slope (x - r_1) (x - r_2) ... / scale``."""

    roots: tuple[float, ...] = ()

    def _rest(self) -> Polynomial:
        """The wanted restoring force, in u = x/RANGE [N]."""
        return Polynomial.fromroots(np.array(self.roots) / RANGE)

    def force(self, x):
        u = np.asarray(x, dtype=float) / RANGE
        product = np.prod([u - r / RANGE for r in self.roots], axis=0)
        return product - x * (linear_stiffness(OSCILLATOR) + OSCILLATOR.alpha * x**2)

    def derivative(self, x):
        springs = linear_stiffness(OSCILLATOR) + 3.0 * OSCILLATOR.alpha * x**2
        return self._rest().deriv()(np.asarray(x) / RANGE) / RANGE - springs


places = st.lists(st.floats(-0.95, 0.95), min_size=1, max_size=7)


@given(places)
def test_prescribed_roots_are_all_found(places):
    roots = np.sort(np.array(places)) * RANGE
    assume(np.all(np.diff(roots) > 1e-7))
    found = equilibria(OSCILLATOR, Prescribed(0.0, SYMMETRIC, tuple(roots)), RANGE)
    assert_allclose(found.x, roots, atol=1e-9)
    # The force rises through the outermost root on the right, and so on alternately.
    assert found.stable[::-1].tolist() == [i % 2 == 0 for i in range(len(roots))]


@pytest.mark.parametrize("distance", [1e-6, 1e-8, 1e-9])
def test_a_close_pair_of_roots_between_samples_is_found(distance):
    middle = 1.2345678e-3
    roots = (-1e-3, middle - distance / 2, middle + distance / 2)
    found = equilibria(OSCILLATOR, Prescribed(0.0, SYMMETRIC, roots), RANGE)
    assert_allclose(found.x, roots, atol=1e-2 * distance)


def exact_equilibria(oscillator, K_c, gap):
    """Real roots of the three cubic pieces, each kept inside its piece."""
    k, alpha = linear_stiffness(oscillator), oscillator.alpha
    edges = (-RANGE, -gap.j_1, gap.j_2, RANGE)
    pieces = ((k + K_c, K_c * gap.j_1), (k, 0.0), (k + K_c, -K_c * gap.j_2))
    found = []
    for low, high, (stiffness, constant) in zip(edges[:-1], edges[1:], pieces, strict=True):
        # Scaled, or the roots lose digits to the spread of the coefficients.
        scaled = [alpha * RANGE**3, 0.0, stiffness * RANGE, constant]
        roots = np.roots(scaled)
        real = roots.real[np.abs(roots.imag) < 1e-9] * RANGE
        found += [x for x in real if low - 1e-15 <= x <= high + 1e-15]
    return np.sort(found)


@given(st.floats(-3e9, -1e8), st.floats(0.0, 1e5), own.gaps)
def test_softening_oscillator_with_the_exact_law(alpha, K_c, gap):
    oscillator = gs.systems.paper_oscillator(alpha=alpha)
    expected = exact_equilibria(oscillator, K_c, gap)
    slope = np.abs(restoring_slope(oscillator, gs.Piecewise(K_c, gap), expected))
    # Not at a fold, on a wall or at the end, where a rounding error decides.
    assume(np.all(slope > 10.0))
    assume(
        not np.any(np.abs(np.subtract.outer(expected, [gap.j_2, -gap.j_1, RANGE, -RANGE])) < 1e-9)
    )
    found = equilibria(oscillator, gs.Piecewise(K_c, gap), RANGE)
    assert_allclose(found.x, expected, atol=1e-12)
    x = found.x
    penetration = x - np.clip(x, -gap.j_1, gap.j_2)
    k = linear_stiffness(oscillator)
    energy = 0.5 * k * x**2 + 0.25 * alpha * x**4 + 0.5 * K_c * penetration**2
    assert_allclose(found.energy, energy, rtol=1e-9, atol=1e-15)


def test_barrier_of_the_softening_oscillator_is_the_energy_of_its_saddle():
    oscillator = gs.systems.paper_oscillator(alpha=-1e9)
    found = equilibria(oscillator, gs.Piecewise(0.0, SYMMETRIC), RANGE)
    k = linear_stiffness(oscillator)
    assert_allclose(found.x, [-math.sqrt(k / 1e9), 0.0, math.sqrt(k / 1e9)], atol=1e-15)
    assert found.stable.tolist() == [False, True, False]
    # V = k x²/2 + α x⁴/4 at x² = -k/α is k²/(4|α|).
    assert_allclose(found.barrier, [np.nan, k**2 / 4e9, np.nan])


@given(own.gaps, own.stiffnesses, st.integers(1, 60))
def test_polynomials_agree_with_their_companion_matrix(gap, K_c, degree):
    law = gs.Polynomial(K_c, gap, degree)
    k, alpha = linear_stiffness(OSCILLATOR), OSCILLATOR.alpha
    springs = chebyshev.poly2cheb([0.0, k * RANGE, 0.0, alpha * RANGE**3])
    roots = chebyshev.chebroots(chebyshev.chebadd(law.coefficients[0], springs))
    # A fold splits into a conjugate pair by rounding: those cases decide nothing.
    assume(not np.any((np.abs(roots.imag) < 1e-5) & (roots.imag != 0.0) & (abs(roots.real) < 1.01)))
    expected = np.sort(roots.real[(roots.imag == 0.0) & (np.abs(roots.real) <= 1.0)]) * RANGE
    assume(np.all(np.abs(restoring_slope(OSCILLATOR, law, expected)) > 1e-6 * K_c))
    found = equilibria(OSCILLATOR, law, RANGE)
    assert_allclose(found.x, expected, atol=1e-10)


@given(own.gaps, own.stiffnesses, own.smooth_labels | st.just("piecewise"))
def test_equilibria_of_a_hardening_oscillator_alternate_from_well_to_well(gap, K_c, label):
    found = equilibria(OSCILLATOR, gs.contact_law(label, K_c, gap), RANGE)
    assert found.stable.tolist() == [i % 2 == 0 for i in range(found.x.size)]
    assert found.x.size % 2 == 1
    assert np.all(found.barrier[found.stable] > 0.0) or found.x.size == 1


@given(own.gaps, own.stiffnesses, own.smooth_labels.filter(lambda s: not s.startswith("log")))
def test_mirrored_gap_has_mirrored_equilibria(gap, K_c, label):
    here = equilibria(OSCILLATOR, gs.contact_law(label, K_c, gap), RANGE)
    mirrored = gs.contact_law(label, K_c, gs.Gap(gap.j_2, gap.j_1))
    there = equilibria(OSCILLATOR, mirrored, RANGE)
    assert_allclose(there.x[::-1], -here.x, atol=1e-12)
    assert_allclose(there.barrier[::-1], here.barrier, rtol=1e-6, atol=1e-15)


@given(own.gaps, own.stiffnesses, own.convergences)
def test_logarctan_has_one_equilibrium_since_its_slope_is_positive(gap, K_c, epsilon):
    law = gs.contact_law(f"logarctan-{epsilon}", K_c, gap)
    assert equilibria(OSCILLATOR, law, RANGE).x.size == 1


@pytest.mark.parametrize("epsilon", [1e6, 1e9])
def test_false_wells_inside_a_thin_layer_are_found(epsilon):
    # At a wall far from the other, K_c/ε z(1 + tanh z)/2 with z = ε(x - j) balances the springs.
    j = 0.4e-3
    springs = linear_stiffness(OSCILLATOR) * j + OSCILLATOR.alpha * j**3
    K_c = 20.0 * springs * epsilon

    def layer(z):
        return 10.0 * z * (1.0 + math.tanh(z)) + 1.0

    z = np.array([brentq(layer, -20.0, -0.7), brentq(layer, -0.6, 0.0)])
    found = equilibria(OSCILLATOR, gs.Tanh(K_c, SYMMETRIC, epsilon), RANGE)
    assert found.x.size == 5
    assert_allclose(epsilon * (found.x[-2:] - j), z, rtol=20.0 / (epsilon * j))
    assert found.stable.tolist() == [True, False, True, False, True]


def test_tanh_at_hard_contact_has_the_known_false_wells():
    law = gs.contact_law("tanh-1e4", HARD, SYMMETRIC)
    found = equilibria(OSCILLATOR, law, RANGE)
    assert [f"{1e3 * x:+.3f}" for x in found.x] == ["-0.398", "+0.000", "+0.398"]
    assert found.stable.tolist() == [True, False, True]
    work, _ = quad(lambda x: float(restoring_force(OSCILLATOR, law, x)), found.x[2], 0.0)
    assert_allclose(found.barrier[2], work, rtol=1e-9)
    assert f"{1e3 * found.barrier[2]:.1f}" == "2.6"  # mJ
    slope = float(restoring_slope(OSCILLATOR, law, found.x[2]))
    assert f"{math.sqrt(slope / 3.0) / (2 * math.pi):.1f}" == "75.7"  # Hz


def test_polynomial_at_hard_contact_has_the_known_false_wells():
    found = equilibria(OSCILLATOR, gs.contact_law("poly-21", HARD, SYMMETRIC), RANGE)
    assert [f"{1e3 * x:+.3f}" for x in found.x[found.stable]] == ["-0.246", "+0.246"]


@dataclass(frozen=True)
class Dent(gs.RationalPolynomial):
    """A fit with a pair of poles at ``CENTRE ± i WIDTH``: a dent between all fit points."""

    CENTRE, WIDTH, DEPTH = 0.123456, 1e-6, 20.0

    @property
    def fit(self):
        bottom = chebyshev.poly2cheb([self.CENTRE**2 + self.WIDTH**2, -2.0 * self.CENTRE, 1.0])
        return Fit((-self.DEPTH * self.WIDTH**2,), tuple(bottom), 0.0, 0.0)


def test_a_dent_of_a_rational_fit_between_all_samples_is_seen():
    found = equilibria(OSCILLATOR, Dent(1.0, SYMMETRIC, 1, 2), RANGE)
    centre, width = Dent.CENTRE * RANGE, Dent.WIDTH * RANGE
    springs = linear_stiffness(OSCILLATOR) * centre + OSCILLATOR.alpha * centre**3
    # DEPTH / (1 + (x - centre)²/width²) = springs
    half = width * math.sqrt(Dent.DEPTH / springs - 1.0)
    assert_allclose(found.x[-2:], [centre - half, centre + half], atol=0.01 * half)
    assert found.stable.tolist() == [True, False, True]


def test_poles_are_no_roots_and_jumps_are():
    points = np.linspace(-1.0, 1.0, 8)
    assert sign_changes(lambda x: 1.0 / x, points)[0].size == 0
    zeros, direction = sign_changes(lambda x: np.sign(x - 0.3), points)
    assert_allclose(zeros, 0.3, atol=1e-12)
    assert direction.tolist() == [1.0]


def test_zeros_on_points_and_touching_zeros_are_found_once():
    points = np.linspace(-1.0, 1.0, 9)
    zeros, direction = sign_changes(lambda x: x * (x - 0.5) ** 2, points)
    assert zeros.tolist() == [0.0, 0.5]
    assert direction.tolist() == [1.0, 0.0]


def test_gaps_in_the_domain_are_not_bridged():
    points = np.linspace(-1.0, 1.0, 9)
    with np.errstate(invalid="ignore"):
        zeros, _ = sign_changes(lambda x: np.sign(x) * np.sqrt(np.abs(x) - 0.3), points)
    assert zeros.size == 0


@given(own.gaps)
def test_walls_and_zero_are_search_points(gap):
    points = search_points(gs.Piecewise(1.0, gap), RANGE)
    assert np.all(np.diff(points) > 0.0)
    assert (points[0], points[-1]) == (-RANGE, RANGE)
    assert {0.0, -gap.j_1, gap.j_2} <= set(points.tolist())
