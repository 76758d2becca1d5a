"""Contact laws: quoted errors, derivatives, symmetry, limits, refusals."""

import json
import math
import pickle
from dataclasses import replace
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from numpy.polynomial import chebyshev
from numpy.testing import assert_allclose
from tests.builders import strategies as own
from tests.builders.studies import LABELS

import gapsweep as gs
from gapsweep.integrate.lanes.law_rows import rows_of_law
from gapsweep.model import laws
from gapsweep.model.contact import FIT_RANGE
from gapsweep.model.fit import Fit, best_pole_free, poles, rational_candidates, unit_force
from gapsweep.model.labels import EXAMPLES, Representation
from gapsweep.model.laws.fitted import Fitted, in_blocks
from gapsweep.model.parameters import numbers_of, with_numbers

SOFT = 1.4e4
SYMMETRIC = gs.Gap(0.4e-3, 0.4e-3)
ASYMMETRIC = gs.Gap(0.0, 0.8e-3)


def soft_spring(x: float) -> float:
    return 1e3 * x


@pytest.mark.parametrize(
    ("label", "rmse"), [("tanh-1e4", "0.044"), ("arctan-1e4", "0.056"), ("logarctan-1e4", "0.376")]
)
def test_smooth_laws_have_the_published_static_errors(label, rmse):
    error, r_squared, *_ = gs.static_error(gs.contact_law(label, SOFT, SYMMETRIC))
    assert f"{error:.3f}" == rmse
    assert r_squared > 0.998


@pytest.mark.parametrize(("label", "rmse"), [("poly-13", "0.409"), ("ratpoly-5/3", "0.130")])
def test_fits_have_the_published_static_errors(label, rmse):
    law = gs.contact_law(label, SOFT, SYMMETRIC)
    assert f"{law.rmse:.3f}" == rmse
    assert law.r_squared > 0.998


def test_asymmetric_logarctan_breaks_the_quality_rule():
    error, r_squared, *_ = gs.static_error(gs.contact_law("logarctan-1e4", SOFT, ASYMMETRIC))
    assert f"{error:.3f}" == "1.415"
    assert f"{r_squared:.4f}" == "0.9974"


@pytest.mark.parametrize("label", ["poly-21", "ratpoly-3/2"])
def test_r_squared_of_a_fit_does_not_depend_on_stiffness(label):
    very_soft, hard = (gs.contact_law(label, K_c, ASYMMETRIC) for K_c in (1.4e3, 1.4e6))
    assert very_soft.r_squared == hard.r_squared
    assert_allclose(hard.rmse, 1e3 * very_soft.rmse)


def test_polynomial_is_the_least_squares_one():
    law = gs.contact_law("poly-9", SOFT, ASYMMETRIC)
    x = np.linspace(-4e-3, 4e-3, 8001)
    residual = law.force(x) - gs.Piecewise(SOFT, ASYMMETRIC).force(x)
    moments = [residual @ (x / 4e-3) ** n for n in range(10)]
    assert_allclose(moments, 0.0, atol=1e-8 * np.linalg.norm(residual))


def test_rational_fit_beats_polynomial_of_as_many_coefficients():
    rational = gs.contact_law("ratpoly-5/3", SOFT, ASYMMETRIC)
    assert not poles(rational.fit.denominator, rational.fit_range)
    assert rational.rmse < 0.5 * gs.contact_law("poly-9", SOFT, ASYMMETRIC).rmse


@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC])
def test_no_denominator_near_that_of_a_rational_fit_is_better(gap):
    """However little it is moved, with the best numerator of each."""
    fit = gs.contact_law("ratpoly-5/3", 1.0, gap).fit
    u = np.linspace(-1.0, 1.0, 401)
    exact = unit_force(u * FIT_RANGE, gap)

    def least(denominator):
        basis = chebyshev.chebvander(u, 5) / chebyshev.chebval(u, denominator)[:, None]
        return np.sum((basis @ np.linalg.lstsq(basis, exact, rcond=None)[0] - exact) ** 2)

    best = least(fit.denominator)
    for k in (1, 2, 3):
        for moved in (-1e-3, -1e-4, 1e-4, 1e-3):
            other = np.array(fit.denominator)
            other[k] += moved
            assert least(other) > best * (1.0 - 1e-12)


def test_rational_fit_with_a_pole_in_range_is_refused_by_name():
    with_pole = Fit((0.0, 1.0), (1.0, 2.0), rmse=1.0, r_squared=0.9)  # 1 + 2u = 0 at u = -1/2
    with pytest.raises(gs.ModelError, match=r"ratpoly-1/1: .* pole at x = -2 mm"):
        best_pole_free([with_pole], 4e-3, "ratpoly-1/1")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("share", [0.97, 0.9975, 0.9999, 0.999999])
@pytest.mark.parametrize("degrees", [(5, 3), (5, 5), (3, 2), (1, 1)])
def test_where_the_gap_fills_the_range_a_rational_fit_is_no_worse_than_none(share, degrees):
    gap = gs.Gap(share * FIT_RANGE, share * FIT_RANGE)
    try:
        law = gs.RationalPolynomial(1.4e4, gap, *degrees)
    except gs.ModelError:
        # A straight line over another one always has a fit, and all have where something is left.
        assert share > 0.99
        assert degrees != (1, 1)
        return
    x = np.linspace(-FIT_RANGE, FIT_RANGE, 100_001)
    wrong = law.force(x) - law.exact.force(x)
    assert np.abs(wrong).max() < 2.0 * np.abs(law.exact.force(x)).max()
    assert law.r_squared > 0.0


def test_fit_without_pole_is_preferred_to_a_better_one_with_pole():
    with_pole = Fit((0.0, 1.0), (1.0, 2.0), rmse=1.0, r_squared=0.9)
    without = Fit((0.0, 1.0), (1.0, 0.5), rmse=2.0, r_squared=0.8)
    assert best_pole_free([with_pole, without], 4e-3, "any") is without


@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC])
def test_starts_of_a_rational_fit_hold_the_adopted_one(gap):
    law = gs.RationalPolynomial(1.0, gap, 3, 2)
    found = rational_candidates(gap, 3, 2, FIT_RANGE)
    if gap.is_symmetric:
        found += rational_candidates(gap, 3, 2, FIT_RANGE, odd=True)
    assert law.fit in found
    best = min(fit.rmse for fit in found if not poles(fit.denominator, FIT_RANGE))
    assert law.rmse <= best * (1.0 + 1e-5)


def test_odd_terms_alone_give_an_odd_fit():
    for fit in rational_candidates(SYMMETRIC, 3, 2, FIT_RANGE, odd=True):
        assert not np.any(fit.numerator[::2])
        assert not np.any(fit.denominator[1::2])


@given(own.smooth_labels | own.fitted_labels, own.symmetric_gaps, own.displacements)
def test_force_of_a_symmetric_gap_is_odd(label, gap, x):
    law = gs.contact_law(label, SOFT, gap)
    assert_allclose(law.force(-x), -law.force(x), atol=1e-9 * SOFT * 4e-3)


def numbers(law):
    """Numbers of the formulas of the compiled engine for one law, by the names of arguments."""
    low, high = map(np.asarray, law.walls)
    ratio, sharpness = np.asarray(law.K_ratio), getattr(law, law.symbol, np.nan)
    found = {"stiffness": law.K_c, "low": low, "high": high, "ratio": ratio}
    if isinstance(law, Fitted):
        top, bottom = law.coefficients
        found |= {"numerator": in_blocks(top), "denominator": in_blocks(bottom)}
        found |= {"stiffness": 1.0, "fit_range": law.fit_range}
    return found | law.rows(low, high, ratio, np.asarray(sharpness))


@pytest.mark.parametrize("label", LABELS)
@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC, gs.Gap(2e-4, 0.0)])
def test_formulas_of_the_compiled_engine_give_force_and_slope(label, gap):
    """On plain numbers, and compared with the force in NumPy, which is written separately."""
    law = gs.contact_law(label, SOFT, gap, K_ratio=0.4)
    given, x = numbers(law), np.linspace(-1.3e-3, 1.7e-3, 61)
    for formula, expected in (
        (law.formulas.force, law.force(x)),
        (law.formulas.slope, law.derivative(x)),
    ):
        names = [*signature(formula).parameters][1:]
        found = [formula(at, *(given[name] for name in names)) for at in x.tolist()]
        assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("label", ["tanh-1e4", "arctan-1e4", "logarctan-1e4"])
def test_damping_acts_by_the_switch_of_a_law(label):
    """The derivative by the speed is c beyond the walls and falls to 0 between; by two hands."""
    law = gs.contact_law(label, SOFT, ASYMMETRIC, K_ratio=0.4, damping=2.0)
    x, v, h = np.linspace(-1.3e-3, 1.7e-3, 61), 0.3, 1e-9
    elastic, rate = replace(law, damping=0.0).force(x), law.derivative_by_speed(x, v)
    assert_allclose(law.force(x, v), elastic + rate * v, rtol=1e-12)
    slope = (law.force(x + h, v) - law.force(x - h, v)) / (2.0 * h)
    assert_allclose(law.derivative(x, v), slope, rtol=1e-5)
    given = numbers(law)
    for formula, expected in (
        (law.formulas.switch, rate),
        (law.formulas.switch_slope, law.derivative(x, 1.0) - law.derivative(x, 0.0)),
    ):
        names = [*signature(formula).parameters][1:]
        found = [2.0 * formula(at, *(given[name] for name in names)) for at in x.tolist()]
        assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    far = law.derivative_by_speed([-0.5, 0.5 * (law.walls[0] + law.walls[1]), 0.5], v)
    assert far == pytest.approx([2.0, 0.0, 2.0], abs=0.5)
    assert law.exact.losses.damping == 2.0


def test_every_law_in_the_folder_is_registered():
    files = {path.stem for path in Path(laws.__file__).parent.glob("*.py")}
    registered = {law.__module__.rpartition(".")[2] for law in laws.LAWS}
    assert files - {"__init__", "sharpened"} == registered - {"contact"}
    assert [Representation(label).law_type for label in EXAMPLES.split(", ")] == [
        law for law in (*laws.LAWS, gs.HuntCrossley, gs.Rigid) for _ in law.examples
    ]


@pytest.mark.parametrize("law", laws.LAWS, ids=lambda law: law.family)
def test_no_two_numbers_of_a_law_share_a_row(law):
    """Four rows are free: a fifth number of a law would be read as its layer."""
    rows = rows_of_law(law)
    assert len({*rows.values()}) == len(rows)


@pytest.mark.parametrize("law", [law for law in laws.LAWS if law.is_sharpened], ids=str)
def test_a_law_with_layers_says_how_thin_they_are(law):
    """Steps look for them there; a layer that is not known is stepped over."""
    sharpness = np.array([1e4, 1e6])
    rows = law.rows(np.full(2, -4e-4), np.full(2, 4e-4), np.ones(2), sharpness)
    assert (rows["layer"] > 0.0).all()
    assert_allclose(rows["layer"][0] / rows["layer"][1], 100.0)


@pytest.mark.parametrize("family", ["tanh", "arctan", "logarctan"])
@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC, gs.Gap(0.0, 0.0)])
def test_smooth_laws_tend_to_the_exact_one(family, gap):
    errors = [gs.static_error(gs.contact_law(f"{family}-1e{e}", SOFT, gap))[0] for e in (4, 6, 8)]
    rounding = 1e-13
    assert errors[2] < 1e-2 * errors[0] + rounding
    assert errors[2] <= errors[1] + rounding
    assert errors[1] <= errors[0] + rounding


@given(own.smooth_labels, own.displacements)
def test_zero_gap_leaves_the_bare_contact_spring(label, x):
    law = gs.contact_law(label, SOFT, gs.Gap(0.0, 0.0))
    assert_allclose(law.force(x), SOFT * x, atol=1e-9)


def test_user_law_is_evaluated_and_differentiated():
    law = gs.law(soft_spring, SOFT, SYMMETRIC)
    assert_allclose(law.force([1e-3, -2e-3]), [1.0, -2.0])
    assert_allclose(law.derivative(np.array([[1e-3]])), [[1e3]], rtol=1e-6)


def hertz(x: float, n: float) -> float:
    depth = abs(x) - 0.4e-3
    return 0.0 if depth <= 0.0 else math.copysign(1e6 * depth**n, x)


def test_a_user_law_takes_named_numbers():
    law = gs.law(hertz, SOFT, SYMMETRIC, n=1.5)
    assert_allclose(law.force([1.4e-3, -1.4e-3, 0.0]), [10.0**1.5, -(10.0**1.5), 0.0], rtol=1e-9)
    assert law == gs.law(hertz, SOFT, SYMMETRIC, n=1.5) != gs.law(hertz, SOFT, SYMMETRIC, n=1.4)


JUMPS = {
    "a relay at 0": (lambda x: 5.0 * np.sign(x) + 1e4 * x, 0.0, 5.0),
    "a relay beyond a wall": (lambda x: 5.0 * (x > 0.4e-3) + 1e4 * x, 0.4e-3, 5.0),
    "a relay on a wall": (lambda x: 5.0 * (x <= -0.4e-3) + 1e4 * x, -0.4e-3, 5.0),
    "in the gap": (lambda x: 0.25 * (x > 1.2345e-4), 1.2345e-4, 0.25),
}


@pytest.mark.parametrize("name", JUMPS)
def test_a_jump_of_the_force_is_refused_by_its_place_and_size(name):
    force, place, size = JUMPS[name]
    with pytest.raises(gs.ModelError, match="jumps by") as refused:
        gs.law(force, SOFT, SYMMETRIC)
    words = str(refused.value).split()
    assert_allclose(float(words[words.index("by") + 1]), size, rtol=1e-2)
    assert_allclose(float(words[words.index("=") + 1]), place, atol=1e-12)


@pytest.mark.parametrize("gap", [SYMMETRIC, gs.Gap(0.0, 0.0), gs.Gap(1e-9, 1.0)])
@pytest.mark.parametrize(
    "force",
    [
        lambda x: math.tanh(1e12 * (x - 0.4e-3)),
        lambda x: 5.0 * min(max(x / 1e-15, -1.0), 1.0),
        lambda x: math.copysign(abs(x) ** 0.1, x),
        lambda x: 1e18 * x**3,
        lambda x: 1e-6 / (5.1e-6 - x) - 1e-6 / 5.1e-6,
        lambda x: 1e3 * x * (1.0 - 0.1 / math.hypot(0.1, x)),
        lambda x: 1e6 * max(x - 0.4e-3, 0.0) ** 1.5,
        lambda x: 0.0,
    ],
)
def test_a_steep_continuous_force_is_taken(force, gap):
    assert gs.law(force, SOFT, gap).force(0.0) == force(0.0)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: gs.contact_law("logarctan-1e4", SOFT, (-1e-4, 4e-4)), r"-0.0001: .*at x = 0"),
        (lambda: gs.contact_law("poly-13", SOFT, (-2e-4, 1e-4)), r"-0.0002, 0.0001: .*overlap"),
        (lambda: gs.law(lambda x: x, SOFT, (-2e-4, 1e-4)), r"overlap"),
        (lambda: gs.ForceTable([-1.0, 1.0], [-1.0, 1.0], gap=(-0.2, 0.1)), r"overlap"),
        (lambda: gs.Gap(0.0, math.nan), r"j_2 = nan: must be finite"),
        (lambda: gs.Piecewise(-1.0, SYMMETRIC), r"K_c = -1: must be >= 0"),
        (lambda: gs.Tanh(SOFT, SYMMETRIC, 0.0), r"epsilon = 0: must be > 0"),
        (lambda: gs.LogArctan(SOFT, SYMMETRIC, math.inf), r"gamma = inf: must be finite"),
        (
            lambda: gs.Polynomial(SOFT, SYMMETRIC, 61),
            r"degree = 61: must be a whole number in 1..60",
        ),
        (
            lambda: gs.RationalPolynomial(SOFT, SYMMETRIC, 0, 1),
            r"degree = 0: must be a whole number in 1..20",
        ),
        (lambda: gs.systems.paper_oscillator(zeta=-0.1), r"zeta = -0.1: must be >= 0"),
        (lambda: gs.systems.paper_oscillator(omega_n=-1.0), r"omega_n = -1: must be >= 0"),
        (lambda: gs.systems.paper_oscillator(mass="heavy"), r"mass = 'heavy': must be a number"),
        (lambda: gs.Gap(None, None), r"no wall on either side"),
        (lambda: gs.Gap(math.inf, None), r"no wall on either side"),
        (lambda: gs.Gap(math.nan, 1e-4), r"j_1 = nan: must be finite"),
        (lambda: gs.Gap(1e-4, -math.inf), r"j_2 = -inf: must be finite"),
        (lambda: gs.Piecewise(SOFT, (None, None)), r"no wall on either side"),
        (lambda: gs.law(lambda x: 1 / x, SOFT, SYMMETRIC), r"raised ZeroDivisionError"),
        (lambda: gs.law(lambda x: "12", SOFT, SYMMETRIC), r"must return a number, not '12'"),
        (lambda: gs.law(lambda x: x > 1.0, SOFT, SYMMETRIC), r"must return a number, not False"),
        (lambda: gs.law(lambda x, v, a: x, SOFT, SYMMETRIC), r"\(x, v, a\).*velocity v"),
        (lambda: gs.law(lambda x, a, v: x, SOFT, SYMMETRIC), r"\(x, a, v\).*velocity v"),
        (lambda: gs.law(lambda x, *, v: x, SOFT, SYMMETRIC), r"raised TypeError"),
        (lambda: gs.law(lambda x, v: math.nan, SOFT, SYMMETRIC), r"nan: must be finite"),
        (lambda: gs.law(soft_spring, SOFT, SYMMETRIC, damping=2.0), r"damping.*velocity v"),
        (lambda: gs.Piecewise(SOFT, SYMMETRIC, friction=0.3), r"'friction'.*loses energy"),
        (lambda: gs.Tanh(SOFT, SYMMETRIC, 1e4, restitution=0.3), r"'restitution'.*loses energy"),
        (lambda: gs.law(hertz, SOFT, SYMMETRIC, n="1.5"), r"n = '1.5': must be a number"),
        (lambda: gs.law(hertz, SOFT, SYMMETRIC, m=1.5), r"\(x, n\) with \{'m': 1.5\}.*n=1.5"),
        (
            lambda: gs.law(
                lambda x, a, b, c, d, e: x, SOFT, SYMMETRIC, **dict.fromkeys("abcde", 1)
            ),
            r"up to 4 numbers",
        ),
    ],
)
def test_bad_parameters_are_refused_by_name(build, message):
    with pytest.raises(gs.ModelError, match=message):
        build()


@pytest.mark.parametrize(
    ("label", "canonical"),
    [
        ("tanh-10000", "tanh-1e4"),
        ("tanh-1e4", "tanh-1e4"),
        ("arctan-2.50e+05", "arctan-2.5e5"),
        ("logarctan-500", "logarctan-5e2"),
        ("poly-013", "poly-13"),
        ("ratpoly-5/3", "ratpoly-5/3"),
        ("piecewise-noevents", "piecewise-noevents"),
        ("my_module:spring", "my_module:spring"),
    ],
)
def test_labels_have_one_spelling(label, canonical):
    assert gs.canonical_label(label) == canonical
    assert gs.canonical_label(canonical) == canonical


@pytest.mark.parametrize(
    ("text", "law", "protocol", "family", "parameter"),
    [
        ("piecewise", "piecewise", "", "piecewise", ""),
        ("piecewise-noevents@half", "piecewise-noevents", "half", "piecewise", "noevents"),
        ("tanh-10000@a-b", "tanh-1e4", "a-b", "tanh", "1e4"),
        ("ratpoly-05/3", "ratpoly-5/3", "", "ratpoly", "5/3"),
        ("auto", "auto", "", "", ""),
        ("my_module:spring@x", "my_module:spring", "x", "", ""),
        ("poly.csv:mm", "poly.csv:mm", "", "", ""),
    ],
)
def test_a_representation_has_a_law_and_a_protocol(text, law, protocol, family, parameter):
    """It stays equal to its text, also as a key, in JSON and in another process."""
    one = Representation.parsed(text)
    assert (one.law, one.protocol) == (law, protocol)
    assert (one.family, one.parameter) == (family, parameter)
    assert (one.law_type is None) == (family == "")
    assert one == f"{law}@{protocol}".removesuffix("@")
    assert {str(one): 1}[one] == json.loads(json.dumps({one: 1}))[one] == 1
    again = pickle.loads(pickle.dumps(one))
    assert (again, type(again), again.protocol) == (one, Representation, protocol)


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        ("piecewise", (False, False, False)),
        ("poly-13@x", (True, False, False)),
        ("ratpoly-5/3", (True, False, False)),
        ("stop.csv:mm@x", (False, True, False)),
        ("auto", (False, False, True)),
        ("measured", (False, False, False)),  # a label that a user gave to data of theirs
    ],
)
def test_kinds_of_representations(text, kinds):
    one = Representation(text)
    assert (one.is_fitted, one.is_own, one.is_auto) == kinds


@pytest.mark.parametrize(
    "label",
    [
        "",
        "tan-1e4",
        "tanh",
        "tanh-",
        "tanh--1",
        "tanh-inf",
        "poly-0",
        "poly-x",
        "ratpoly-5",
        "a:b:c",
    ],
)
def test_unknown_labels_are_refused(label):
    with pytest.raises(gs.ModelError, match=repr(label).replace("(", r"\(")):
        gs.canonical_label(label)


def test_label_of_a_missing_module_says_what_to_do():
    with pytest.raises(
        gs.ModelError, match=r"no_such_module.*must lie in a folder of Python's path"
    ):
        gs.contact_law("no_such_module:spring", SOFT, SYMMETRIC)


def test_a_fit_that_would_leave_a_wall_out_is_refused():
    """In millimetres, say: its force would be zero."""
    gap = gs.Gap(5e-3, 1e-3)
    with pytest.raises(gs.ModelError, match=r"fit range = 0\.004: must be > 0\.005"):
        gs.Polynomial(1e4, gap, degree=5)
    assert gs.Polynomial(1e4, gap, degree=5, fit_range=6e-3).force(2e-3) > 0.0
    # A wall without stiffness is none.
    assert gs.Polynomial(1e4, gap, degree=5, K_ratio=0.0).force(2e-3) > 0.0


def test_only_an_oscillator_of_the_paper_has_its_numbers():
    linear = gs.Oscillator(mass=1.0, omega_n=1.0, zeta=0.05, forcing=10.0)
    assert (linear.alpha, linear.c, linear.mean_load) == (0.0, 0.0, 0.0)
    paper = gs.systems.paper_oscillator(zeta=0.1)
    stated = {"zeta": 0.1, "omega_n": 5.0, "mass": 3.0, "alpha": 7e8, "forcing": 4.0}
    assert paper == gs.Oscillator(**stated)


def test_numbers_are_read_and_set_by_name():
    oscillator = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.03, forcing=4.0)
    law = gs.Piecewise(1e4, gs.Gap(4e-4, np.inf))
    assert numbers_of(oscillator).items() >= {"mass": 3.0, "zeta": 0.03, "alpha": 0.0}.items()
    known = {"K_c": 1e4, "K_ratio": 1.0, "damping": 0.0, "preload": 0.0, "j_1": 4e-4}
    assert numbers_of(law) == known, "no distance of a wall that is missing"
    found = with_numbers(law, {"gap": 1e-4, "K_c": 2e4, "zeta": 0.1})
    assert found == gs.Piecewise(2e4, gs.Gap(1e-4, np.inf))
    assert with_numbers(law, {"j_2": 2e-4}) == gs.Piecewise(1e4, gs.Gap(4e-4, 2e-4))
    assert with_numbers(oscillator, {"gap": 1e-4, "K_c": 2e4}) is oscillator
    spring = gs.UserLaw(1e4, law.gap, lambda x, k: k * x, {"k": 3.0})
    found = with_numbers(spring, {"k": 5.0, "gap": 2e-4})
    assert (found.parameters, found.gap) == ({"k": 5.0}, law.gap), "its walls push nothing"
