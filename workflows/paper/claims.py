"""The paper's claims, one function each: which numbers decide it, and what was found.

Quoted words are the paper's; `measures` says what number each of them is. 75 and on are statements
that the first list of 74 left out. Right-hand sides stand for cost: they are the same on every
machine, and processor time stands beside them in words.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.verdicts import Found, NotInRunError, Number, Run, Test, claim, share
from gapsweep.model.labels import law_of
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

from .cftool import cftool
from .ladders import ladders
from .measures import (
    ALIKE,
    ALL,
    HALF,
    LINE,
    TENTH,
    THREE_QUARTERS,
    TWENTIETH,
    Band,
    Scene,
    amplitude_error,
    by_law,
    each,
    f1,
    frequencies,
    larger_over_smaller,
    largest,
    listed,
    mean_of,
    moved_on,
    named,
    of_law,
    ranges,
    recall,
    recall_pooled,
    right,
    same_picture,
    seconds,
    share_of,
    share_of_frequencies,
    shown,
    width,
    work,
)
from .refined import FINEST, bands, basins
from .scenes import (
    ASYMMETRIC,
    EXACT,
    HARD,
    HARD_ASYMMETRIC,
    HARD_SYMMETRIC,
    LARGE,
    LARGE_ENDS,
    NO_EVENTS,
    SOFT,
    SOFT_ASYMMETRIC,
    SOFT_SYMMETRIC,
    STRONG,
    SYMMETRIC,
    TANGENTS,
    VERY_SOFT,
    WEAK,
)
from .starts import starts

Array = NDArray[Any]

DATASETS = {
    "starts": starts, "ladders": ladders, "cftool": cftool, "bands": bands, "basins": basins
}  # fmt: skip

POLY, RATPOLY, TANH, ARCTAN, LOGARCTAN = WEAK
POLY_21, RATPOLY_5, TANH_6, ARCTAN_6, LOGARCTAN_6 = STRONG
VERY_SOFT_SYMMETRIC, SOFT_LARGE = (VERY_SOFT, SYMMETRIC), (SOFT, LARGE)
OPTIMUM = "for the least-squares optimum; the paper's coefficients are not given"
RISE = "grows from one value to the next at most by the factor"

# Table 2, in seconds: the exact law, then the laws of the grade.
TABLE_2 = {
    "weak": dict(zip((EXACT, *WEAK), (48.69, 18.57, 26.49, 7.66, 7.41, 7.29), strict=True)),
    "strong": dict(zip((EXACT, *STRONG), (117.7, 65.69, 132.9, 18.57, 18.08, 18.49), strict=True)),
}
GRADES = {"weak": WEAK, "strong": STRONG}
TABLE_SCENES = {"weak": SOFT_SYMMETRIC, "strong": HARD_SYMMETRIC}
SOFT_SCENES = (SOFT_SYMMETRIC, SOFT_ASYMMETRIC, SOFT_LARGE)


def _ladder(run: Run, name: str, **at: Any) -> xr.DataArray:
    return run.select("ladders", **at)[name]


def _force(run: Run, name: str, label: str, scene: Scene) -> Number:
    """A number of the force alone: nothing rounds or samples it."""
    return _plain(run.scene("static", label, *scene, name)[name])


def _plain(value: Any) -> Number:
    return Number(float(value))


def _slope(rungs: xr.DataArray) -> float:
    """Of a log-log line over the degrees."""
    return float(np.polyfit(np.log(rungs["degree"].values), np.log(rungs.values), 1)[0])


def _where(scene: Scene) -> str:
    return f"{scene[0]:g} N/m, {scene[1]} mm"


def _ahead(
    of: Mapping[str, Number], ours: Iterable[str], others: Iterable[str], says: str
) -> list[Test]:
    """Tests that a number of some laws is above that of each of the others."""
    return [
        Test(f"{says}, {one} minus {other}", of[one] - of[other], ">", 0.0)
        for one in ours
        for other in others
    ]


# --- Sections 1 to 3: the laws themselves ---------------------------------------------------------


@claim(1, "Eqs 4-6", "The three tangent laws tend to the exact force as their parameter grows.",
    "'Eqs. (4-6) approach one another as their convergence parameters are increased' (Sect. 2). A "
    "limit: over five decades the RMS error never rises, and falls a thousandfold.")  # fmt: skip
def limit(run: Run) -> Found:
    tests, falls = [], []
    for family in TANGENTS:
        for gap in (SYMMETRIC, ASYMMETRIC):
            error = _ladder(run, "smooth_rmse", family=family, gap=gap)
            fall = float(error.sel(parameter=1e9) / error.sel(parameter=1e4))
            values = error.sel(parameter=slice(1e3, 1e9)).values
            falls.append(1.0 / fall)
            where = f"{family}, gap {gap}"
            tests += [
                Test(f"{where}: error at 1e9 over error at 1e4", _plain(fall), "<=", 1e-3),
                Test(f"{where}: {RISE}", _plain(np.max(values[1:] / values[:-1])), "<", 1.0),
            ]
    return tests, f"From 1e4 to 1e9 /m the errors fall {min(falls):.2g} to {max(falls):.2g} fold."


@claim(2, "Sect. 2", "A period-n response shows 2n points in the diagram of extrema.",
    "'A period-n response ... will generally manifest as 2n discrete points': generally is in most "
    "cases, counted for exact P1 motions from rest and P3 ones from scattered starts.")  # fmt: skip
def points_of_a_period(run: Run) -> Found:
    tests, above = [], []
    for n, start in ((1, "rest"), (3, "scattered")):
        points = run.points(EXACT, *SOFT_SYMMETRIC, "period_multiple", "n_extrema", start=start)
        points = points.isel(point=points["period_multiple"].values == n)
        number = share(points["n_extrema"] == 2 * n)
        tests.append(Test(f"P{n}: responses with {2 * n} extrema", number, ">", HALF))
        above.append(points["omega"].values[points["n_extrema"].values > 2 * n])
    one, three = (test.number.value for test in tests)
    highest = np.max(above[0], initial=0.0)
    return tests, (
        f"{one:.0%} of the P1 responses show two extrema (those with more lie at {highest:g} Hz or "
        f"below), {three:.0%} of the P3 responses six."
    )


@claim(3, "Sect. 1", "Missing contacts costs accuracy, as roundoff accumulates.",
    "'Time integration methods suffer from accumulating roundoff error if the precise times and "
    "locations of contacts are not captured'. One method (5(4) pairs, ode45's controller) with and "
    "without events says what is lost; roundoff would not fall when the tolerance does (smaller "
    "steps make more of it), an error of the steps would: by half at least.")  # fmt: skip
def roundoff(run: Run) -> Found:
    def distance(label: str) -> Number:
        labels = (label, "piecewise@half", "piecewise@jitter")
        name, at = "section_distance_median", {"regime": "periodic"}
        value, *floors = (
            float(run.scene("agreement", one, *HARD_ASYMMETRIC, name)[name].sel(at))
            for one in labels
        )
        return Number(value, max(floors))

    none, with_events = distance(f"{NO_EVENTS}@paper"), distance("piecewise@paper")
    finer = distance(f"{NO_EVENTS}@finer")
    tests = [
        Test("median distance from the exact section, no events over events",
             none / with_events, ">", 1.0),
        Test("the same without events, tolerance 1e-6 over 1e-4", finer / none, ">=", HALF),
    ]  # fmt: skip
    return tests, (
        f"Without events the periodic motions are {1e6 * none.value:.2g} µm off, with them "
        f"{1e6 * with_events.value:.2g}; a tolerance 100 times finer leaves "
        f"{finer.value / none.value:.2g} of it, which roundoff would not do."
        if tests[1].holds is False
        else f"No events leave {none / with_events} times the distance, finer tolerances "
        f"{finer / none} of it."
    )


@claim(4, "Sect. 2", "A diagram of extrema tells periodic from aperiodic motion.",
    "'A bifurcation diagram constructed as described above can distinguish aperiodic from "
    "periodic.' Distinct values at a plot's resolution (a 200th of the diagram's height) from the "
    "same window: a periodic motion has no others in a longer one. Told apart: 95 % of the chaotic "
    "responses have more of them than 95 % of the periodic ones.")  # fmt: skip
def diagram_tells(run: Run) -> Found:
    tests = []
    for scene in (SOFT_ASYMMETRIC, HARD_SYMMETRIC):
        points = run.points(EXACT, *scene, "extrema", "response_class")
        extrema = points["extrema"].transpose("point", "extremum").values
        resolution = (np.nanmax(extrema) - np.nanmin(extrema)) / 200.0
        rows = np.round(extrema / resolution)
        distinct = np.array([np.unique(row[np.isfinite(row)]).size for row in rows])
        kind = points["response_class"].values
        periodic = distinct[kind == ResponseClass.PERIODIC]
        if not periodic.size:
            raise NotInRunError(f"no periodic response at {_where(scene)}")
        most = np.quantile(periodic, 0.95, method="higher")
        says = f"{_where(scene)}: chaotic responses with more than {most:.0f} distinct extrema"
        tests.append(Test(says, share(distinct[kind == ResponseClass.CHAOTIC] > most), ">=", 0.95))
    return tests, f"Of the chaotic responses these stand out: {shown(tests)}."


@claim(5, "Fig. 2a", "The error of a polynomial inside the gap falls with its degree.",
    "'This error decreases with higher degree': 13 to 21, and along a log-log line.")  # fmt: skip
def polynomial_in_gap(run: Run) -> Found:
    force = _ladder(run, "poly_in_gap_force", gap=SYMMETRIC, constraint="none")
    ratio = float(force.sel(degree=21) / force.sel(degree=13))
    slope = _slope(force)
    tests = [
        Test("largest in-gap force, degree 21 over 13", _plain(ratio), "<", 1.0),
        Test("slope against the degree", _plain(slope), "<", 0.0),
    ]
    return tests, f"Degree 21 exerts {ratio:.2g} of what degree 13 does; it falls as n^{slope:.2f}."


@claim(6, "Fig. 2a", "Polynomials match the force better away from the gap than near it.",
    "'The polynomials match the piecewise behavior away from the freeplay gap better': RMS error "
    "inside the gap over that outside, both degrees of the paper.")  # fmt: skip
def away_from_the_gap(run: Run) -> Found:
    def ratio(label: str) -> Number:
        inside, outside = (
            _force(run, f"rmse_{place}", label, SOFT_SYMMETRIC) for place in ("in_gap", "outside")
        )
        return inside / outside

    tests = each((POLY, POLY_21), "RMS error inside over outside", ratio, ">", 1.0)
    return tests, f"The error inside over that outside: {shown(tests, '.3g')}."


@claim(7, "Fig. 2b", "Without constant and linear terms fits help in the gap, oscillate outside.",
    "'The polynomial function better captures the behavior in the freeplay gap but now oscillates "
    "outside': against the free fit less force inside, more error outside.")  # fmt: skip
def constrained(run: Run) -> Found:
    tests, parts = [], []
    free, held = (
        run.select("ladders", gap=SYMMETRIC, constraint=terms)
        for terms in ("none", "no constant or linear term")
    )
    for degree in (13, 21):
        inside, outside = (
            _plain((held[name] / free[name]).sel(degree=degree))
            for name in ("poly_in_gap_force", "poly_outside_error")
        )
        tests += [
            Test(f"degree {degree}: in-gap force, constrained over free", inside, "<", 1.0),
            Test(f"degree {degree}: largest error outside", outside, ">", 1.0),
        ]
        parts.append(f"degree {degree} {inside} times the force inside, {outside} error outside")
    return tests, f"Constrained: {listed(parts)}."


@claim(8, "Fig. 2c", "With degree 21 very soft contact is matched, hard contact poorly.",
    "'The polynomial representation matches the very soft contact ... For hard contact, the match "
    "is poor even with 21 coefficients.' In newtons, since the relative error is the same at every "
    "stiffness: a tenth of the forcing inside the gap is where motion there changes.")  # fmt: skip
def soft_and_hard_match(run: Run) -> Found:
    name, scenes = "in_gap_force_ratio", ((VERY_SOFT, SYMMETRIC), HARD_SYMMETRIC)
    soft, hard = (_force(run, name, POLY_21, scene) for scene in scenes)
    tests = [
        Test("very soft: largest in-gap force over the forcing", soft, "<", TENTH),
        Test("hard: largest in-gap force over the forcing", hard, ">", TENTH),
    ]
    return tests, (
        f"Inside the gap Poly-21 exerts {soft} of the forcing at very soft and {hard} at hard "
        "contact; R² is the same at both, force and error being proportional to the stiffness."
    )


@claim(9, "Fig. 2", "Polynomials converge slowly, and are badly conditioned at higher degrees.",
    "'The polynomial representation converges slowly yet also suffers from being \"badly "
    "conditioned\"' in polyfit, whose basis is monomials of x as given. Slowly: no faster than the "
    "degree's inverse square; badly: a condition above 1e8 costs half of all digits.")  # fmt: skip
def polynomials_converge(run: Run) -> Found:
    error = _ladder(run, "poly_rmse", gap=SYMMETRIC, constraint="none")
    slope = _slope(error)
    condition = _ladder(run, "poly_condition", degree=21)
    bases = ("monomial in m", "Chebyshev")
    monomial, chebyshev = (float(condition.sel(basis=basis)) for basis in bases)
    tests = [
        Test("slope of the RMS error against the degree", _plain(slope), ">", -2.0),
        Test("condition at degree 21, monomials in metres", _plain(monomial), ">", 1e8),
    ]
    return tests, (
        f"The error falls as n^{slope:.2f}; degree 21 has a condition of {monomial:.1g} in "
        f"monomials, of {chebyshev:.2g} in Chebyshev polynomials."
    )


@claim(10, "Fig. 2", "Harder contact needs more coefficients.",
    "'More coefficients are required for harder contact stiffness beyond what was investigated': "
    "least degree with under a tenth of the forcing in the gap, infinite above 45.")  # fmt: skip
def coefficients(run: Run) -> Found:
    degrees = {
        K_c: float(_ladder(run, "poly_smallest_degree", K_c=K_c, gap=SYMMETRIC)) or math.inf
        for K_c in (VERY_SOFT, SOFT, HARD)
    }
    softest, soft, hard = degrees.values()
    tests = [
        Test("degree that soft contact needs", _plain(soft), ">", softest),
        Test("degree that hard contact needs", _plain(hard), ">", softest),
    ]
    words = [f"{n:.0f}" if n < math.inf else "more than 45" for n in degrees.values()]
    return tests, f"Very soft, soft and hard contact need degrees {listed(words)}."


@claim(11, "Fig. 2", "The fit range of 4 mm covers the largest displacements from rest.",
    "'This encompassed the largest displacements present for the parameters in Table 1', which "
    "start at rest: the largest displacement of the exact law from rest.")  # fmt: skip
def fit_range(run: Run) -> Found:
    number = largest(run, "x_max", EXACT, SOFT_SYMMETRIC)
    up = largest(run, "x_max", EXACT, SOFT_SYMMETRIC, "sweep_up")
    tests = [Test("largest displacement from rest [m]", number, "<=", 4e-3)]
    return tests, (
        f"From rest {1e3 * number.value:.2f} mm is the largest; a sweep upwards follows the upper "
        f"branch to {1e3 * up.value:.2f} mm."
    )


@claim(12, "Fig. 3a", "The rational fit 3/2 is not odd and negative in the gap, 5/3 is odd.",
    "'The 3/2 curve is not rotationally symmetric about the origin and shows a negative force "
    "within most of the freeplay gap, unlike the 5/3 curve': the size of the force at 0, per unit "
    "stiffness, of the best of cftool's random starts and of the least-squares optimum; 1e-7 m, "
    "1.4 mN, tells. Its sign does not: where f(x) is a best fit, so is -f(-x).")  # fmt: skip
def odd_fits(run: Run) -> Found:
    optimum = _ladder(run, "ratpoly_force_at_zero", gap=SYMMETRIC, ratio="5/3")
    random = _random_at_zero(run, SYMMETRIC, "3/2")
    tests = [
        Test("3/2, random starts: size of the force at 0", _plain(abs(random)), ">", 1e-7),
        Test("5/3, optimum: size of the force at 0", _plain(abs(optimum)), "<", 1e-7),
    ]
    return tests, (
        f"At x = 0 the best of the random starts for 3/2 exerts {1e3 * SOFT * random:.2g} mN, the "
        f"optimum 5/3 {1e3 * SOFT * float(optimum):.2g} mN; the paper's coefficients are not given."
    )


def _random_at_zero(run: Run, gap: str, ratio: str) -> float:
    """Force at x = 0 per unit stiffness [m] of the best random start; 0 where it is rounding."""
    found = run.select("cftool", gap=gap, ratio=ratio)
    best = np.nanargmin(found["rmse"].values)
    force = float(found["force_at_zero"][best])
    return force if abs(force) >= 1e-7 else 0.0


@claim(13, "Fig. 3a", "5/3 is closer to the exact force in the gap than 3/2.",
    "'The 5/3 curve also fits more closely within the freeplay gap': largest in-gap force of the "
    "least-squares optima.")  # fmt: skip
def closer_in_gap(run: Run) -> Found:
    force = _ladder(run, "ratpoly_in_gap_force", gap=SYMMETRIC)
    ratio = _plain(force.sel(ratio="5/3") / force.sel(ratio="3/2"))
    return [Test("in-gap force, 5/3 over 3/2", ratio, "<", 1.0)], f"5/3 exerts {ratio} of it."


@claim(14, "Fig. 3b", "For very soft contact the fits from 3/5 to 5/5 are nearly the same.",
    "'There is little advantage if any ... they are all very similar': RMS errors within a tenth. "
    "Their ratio does not depend on the stiffness.")  # fmt: skip
def similar_fits(run: Run) -> Found:
    errors = _ladder(run, "ratpoly_rmse", gap=SYMMETRIC).sel(ratio=["3/5", "5/2", "5/3", "5/5"])
    ratio = _plain(errors.max() / errors.min())
    says = "RMS errors of 3/5, 5/2, 5/3, 5/5: largest over smallest"
    return [Test(says, ratio, "<=", ALIKE)], f"The errors differ by a factor of {ratio}."


@claim(15, "Fig. 3c", "Harder contact is captured better with higher degrees.",
    "'Generally, up to a limit, harder contact stiffnesses are captured better with higher-degree "
    "numerator and denominator': an error a tenth lower from 3/2 to 5/5, and to 7/5.")  # fmt: skip
def higher_degrees(run: Run) -> Found:
    errors = _ladder(run, "ratpoly_rmse", gap=SYMMETRIC)
    tests = [
        Test(f"RMS error, {ratio} over 3/2",
             _plain(errors.sel(ratio=ratio) / errors.sel(ratio="3/2")), "<=", 0.9)
        for ratio in ("5/5", "7/5")
    ]  # fmt: skip
    last = float(errors.sel(ratio="5/5") / errors.sel(ratio="5/3"))
    return tests, (
        f"5/5 and 7/5 leave {tests[0].number} and {tests[1].number} of the error of 3/2 (5/5 "
        f"{last:.2g} times that of 5/3), at every stiffness alike."
    )


@claim(16, "Fig. 3", "Rational fits change with the random start, and poles are a danger.",
    "'The calculated curve fit can change every time ... \"random start points\"', and roots of "
    "the denominator are 'a danger to consider'. Starts as cftool makes them: a tenth must miss "
    "the best fit, and a tenth end with a pole in the range, in either unit of x.")  # fmt: skip
def random_starts(run: Run) -> Found:
    return _starts(run, 1.0 - TENTH, TENTH)


def _starts(run: Run, best: float, poles: float) -> Found:
    """Tests of what starts as cftool makes them end on, in the worse unit of x."""
    tests, parts = [], []
    for ratio in ("5/3", "5/5"):
        found = run.select("cftool", gap=SYMMETRIC, ratio=ratio)
        best_share = found["best_share"]
        tests += [
            Test(f"{ratio}: random starts that find the best fit",
                 _plain(best_share.where(found["rmse"].notnull()).min()), "<", best),
            Test(f"{ratio}: random starts that end with a pole",
                 _plain(found["pole_share"].max()), ">", poles),
        ]  # fmt: skip
        of_units = zip(found["unit"].values, found["pole_share"].values, strict=True)
        shares = [f"{poles_in:.0%} with x in {unit}" for unit, poles_in in of_units]
        parts.append(f"{ratio}: {listed(shares)}")
    return tests, f"Random starts that end with a pole in the range, {'; '.join(parts)}."


@claim(17, "Sect. 4.2",
    "For soft contact large enough degrees with n > m give good accuracy, but are not necessary.",
    "'Generally, the accuracy is good for soft contact stiffnesses as long as the degrees are "
    "\"large enough\" and the numerator degree is greater ..., but these are not necessary "
    "conditions.' Good: the paper's own rule, an RMSE below 0.5 N at soft contact.")  # fmt: skip
def large_enough(run: Run) -> Found:
    errors = SOFT * _ladder(run, "ratpoly_rmse", gap=SYMMETRIC)
    ratios = ("5/3", "7/3", "7/5", "3/5")
    tests = [Test(f"{r}: RMSE [N]", _plain(errors.sel(ratio=r)), "<", 0.5) for r in ratios]
    return tests, f"RMSE in newtons: {shown(tests, '.2g')}; the last has the higher denominator."


@claim(18, "Sect. 4.1", "The weak laws have RMSE below 0.5 N and R² above 0.998 (soft, symmetric).",
    "'Each model has RMSE<0.5 and R² > 0.998 for the symmetric-soft system'.")  # fmt: skip
def quality(run: Run) -> Found:
    rmse = [_force(run, "rmse", label, SOFT_SYMMETRIC).value for label in WEAK]
    r_squared = [_force(run, "r_squared", label, SOFT_SYMMETRIC).value for label in WEAK]
    tests = quality_tests(rmse, r_squared)
    worst = named(WEAK[int(np.argmax(rmse))])
    return (
        tests,
        f"The largest RMSE is {max(rmse):.3g} N ({worst}), R² {min(r_squared):.5f} or more.",
    )


def quality_tests(rmse: Sequence[float], r_squared: Sequence[float]) -> list[Test]:
    return [
        Test("largest RMSE [N]", _plain(max(rmse)), "<", 0.5),
        # As a distance: digits of a number next to 1 say nothing.
        Test("largest 1 - R squared", _plain(1.0 - min(r_squared)), "<", 0.002),
    ]


@claim(19, "Fig. 5c", "Of the tangent laws tanh converges fastest, log-arctan slowest.",
    "'All converge quickly with hyperbolic tangent being the fastest and logarithm-arctangent the "
    "slowest': order of RMS errors at equal parameter, as integrals over the range.")  # fmt: skip
def tangent_order(run: Run) -> Found:
    tests = []
    for parameter in (1e4, 1e6):
        errors = _ladder(run, "smooth_rmse", gap=SYMMETRIC, parameter=parameter)
        tests += [
            Test(f"{parameter:g} /m: error of {one} over that of {other}",
                 _plain(errors.sel(family=one) / errors.sel(family=other)), "<", 1.0)
            for one, other in (("tanh", "arctan"), ("arctan", "logarctan"))
        ]  # fmt: skip
    first, second = tests[:2]
    return tests, (
        f"At 1e4 /m tanh has {first.number} of the error of arctan, arctan {second.number} of that "
        "of log-arctan."
    )


@claim(20, "Fig. 5b", "The convergence of rational fits with their degrees is not straightforward.",
    "'The convergence for rational polynomial is not straightforward': along rising numbers of "
    "coefficients the error rises somewhere, or stays, by more than the fit's 0.1 %.")  # fmt: skip
def rational_convergence(run: Run) -> Found:
    errors = _ladder(run, "ratpoly_rmse", gap=SYMMETRIC)
    by_size: dict[int, list[float]] = {}
    for ratio in errors["ratio"].values:
        size = sum(int(degree) for degree in str(ratio).split("/"))
        by_size.setdefault(size, []).append(float(errors.sel(ratio=ratio)))
    sizes = sorted(by_size)
    rise = max(max(by_size[more]) / min(by_size[fewer]) for fewer, more in pairwise(sizes))
    same = float(errors.sel(ratio="5/3") / errors.sel(ratio="5/2"))
    tests = [
        Test(f"with more coefficients the error {RISE}", _plain(rise), ">", 1.001),
        Test("RMS error, 5/3 over 5/2", _plain(same), ">", 0.999),
    ]
    return tests, (
        f"More coefficients can leave {rise:.3g} times the error; 5/3 has {same:.4g} times that of "
        "5/2: an odd law has no use for an odd power below."
    )


@claim(21, "Sect. 4.2", "The tangent laws' accuracy depends only on the convergence parameter.",
    "'Since the accuracy depends only on the convergence parameter': at 1e4 /m equal errors (a "
    "tenth) for both small gaps, no more static wells at hard contact than at soft.")  # fmt: skip
def only_the_parameter(run: Run) -> Found:
    tests = []
    for family in TANGENTS:
        errors = _ladder(run, "smooth_rmse", family=family, parameter=1e4)
        two = errors.sel(gap=[SYMMETRIC, ASYMMETRIC])
        ratio = _plain(two.max() / two.min())
        tests.append(Test(f"{family}: errors of the two gaps, ratio", ratio, "<=", ALIKE))
    soft, hard = (_force(run, "n_wells", TANH, (K_c, SYMMETRIC)).value for K_c in (SOFT, HARD))
    more = _plain(hard - soft)
    tests.append(Test("tanh: wells at hard contact minus those at soft", more, "<=", 0.0))
    threshold = float(_ladder(run, "tanh_threshold", gap=SYMMETRIC, K_c=HARD))
    return tests, (
        f"Errors per stiffness differ between the gaps by: {shown(tests[:3], '.3g')}. At 1e4 /m "
        f"tanh has {soft:.0f} static wells at soft and {hard:.0f} at hard contact, where it needs "
        f"{threshold:.2g} /m to have one."
    )


# --- Figs 6 and 7: frequency responses ------------------------------------------------------------


@claim(22, "Fig. 6a",
    "With a large gap only superharmonics near 2 Hz are nonlinear; all laws but RatPoly 5/3 agree.",
    "'The only nonlinear behavior that is expected here is superharmonic resonance near 2 Hz, and "
    "every representation except the rational polynomial agrees well'. The gap is not in the text "
    "we have: the sentence can be true from 1.1 to 1.8 mm, decided at 1.5 and at both ends. Agrees "
    "well: three quarters of the amplitude errors within a line.")  # fmt: skip
def large_gap(run: Run) -> Found:
    tests, touched, start = [], [], "scattered"
    for gap in (LARGE_ENDS[0], LARGE, LARGE_ENDS[1]):
        scene = (SOFT, gap)
        number = share_of(run, EXACT, scene, "period not 1", (3.0, 30.0), start)
        tests.append(Test(f"{gap}: responses above 3 Hz not of period 1", number, "<=", TWENTIETH))
        number = share_of(run, EXACT, scene, "ringing", (1.5, 2.5), start)
        tests.append(Test(f"{gap}: responses at 1.5-2.5 Hz that ring", number, ">=", TENTH))
        for label in WEAK:
            error = amplitude_error(run, label, scene, start=start)
            op = ">" if label == RATPOLY else "<="
            tests.append(Test(f"{gap}, {named(label)}: amplitude error of 3 in 4", error, op, LINE))
        points = run.points(EXACT, *scene, "x_max", band=(0.0, 2.9), start=start)
        touches = points["omega"].values[points["x_max"].values > 1e-3 * float(gap.split("/")[0])]
        omega = np.unique(points["omega"].values)
        touched.append(f"{ranges(omega, np.isin(omega, touches))} ({gap})")
    off = [test.says.split(":")[0] for test in tests if test.holds is False]
    return tests, (
        f"Below 3 Hz the exact law touches the walls at {'; '.join(touched)}. Against the claim: "
        f"{'; '.join(off) or 'nothing'}."
    )


@claim(23, "Fig. 6a", "RatPoly 5/3 shows wider superharmonics and a subharmonic at 11-12 Hz.",
    "'The RatPoly 5/3 predicts a larger region of superharmonic resonance and a region of "
    "subharmonic resonance near 11-12 Hz': a tenth more responses of more than two extrema at "
    f"1-4 Hz; a period above 1 at some frequency of the grid. Decided {OPTIMUM}.")  # fmt: skip
def rational_large_gap(run: Run) -> Found:
    omega, hits = frequencies(run, RATPOLY, SOFT_LARGE, "period above 1", (5.0, 30.0), "scattered")
    near = (omega >= 11.0) & (omega <= 12.0)
    ours, exact = (
        share_of(run, label, SOFT_LARGE, "ringing", (1.0, 4.0), "scattered")
        for label in (RATPOLY, EXACT)
    )
    wider = ours / exact
    tests = [
        Test("responses with more than two extrema, over the exact law's", wider, ">", ALIKE),
        Test("frequencies with a subharmonic at 11-12 Hz", _plain(hits[near].sum()), ">=", 1.0),
    ]
    return tests, (
        f"The optimum rings at {wider} times as many points; it has subharmonics at "
        f"{ranges(omega, hits)}."
    )


@claim(24, "Fig. 6a", "Above 22 Hz the whole response of RatPoly 5/3 is below 0.",
    "'The peak amplitude is predicted to be negative' above 22 Hz: the work of a force that is not "
    "odd, as the least-squares optimum of a symmetric gap is.")  # fmt: skip
def rational_below_zero(run: Run) -> Found:
    number = share_of(run, RATPOLY, SOFT_LARGE, "peak below 0", (22.0, 30.0), "scattered")
    random = 1e3 * SOFT * _random_at_zero(run, LARGE, "5/3")
    return [], (
        "Not in the text: the coefficients of the paper's fit, on which it turns. Of the "
        f"least-squares optimum {number.value:.0%} of the responses are; it is odd, so that "
        f"nothing pulls it below 0. The best random start exerts {random:.2g} mN at x = 0."
    )


@claim(25, "Fig. 6b", "All five laws capture the superharmonic range to a degree.",
    "'All the representations are able to capture the region of superharmonic resonance to varying "
    "degrees': below 5 Hz half as many responses ring as with the exact law.")  # fmt: skip
def superharmonics(run: Run) -> Found:
    return _ringing(run, SOFT_SYMMETRIC, HALF)


def _ringing(run: Run, scene: Scene, limit: float) -> Found:
    """Responses from rest below 5 Hz with more than two extrema, over the exact law's."""
    low = (0.1, 5.0)
    exact = share_of(run, EXACT, scene, "ringing", low)
    says = "responses below 5 Hz with more than two extrema, over the exact law's"
    shares = {label: share_of(run, label, scene, "ringing", low) / exact for label in WEAK}
    tests = each(WEAK, says, lambda label: shares[label], ">=", limit)
    errors = {label: amplitude_error(run, label, scene, low, q=HALF) for label in WEAK}
    return tests, f"Median amplitude errors from rest below 5 Hz: {by_law(errors, '.1%')}."


def _periods(run: Run, label: str, scene: Scene, omega: Sequence[float]) -> Array:
    """Periods that 400 starts end on, at some frequencies."""
    cases = run["basins"].load()
    here = cases["omega"].isin(list(omega))
    for name, value in zip(("representation", "K_c", "gap"), (label, *scene), strict=True):
        here = here & (cases[name] == value)
    return np.ravel(cases["period_multiple"].values[here.values])


@claim(26, "Fig. 6b",
    "RatPoly 5/3, tanh and arctan capture the subharmonics at 17-21 Hz; the other two do not.",
    "'Appearing to capture the entire range of subharmonic resonance' and 'do not capture any of "
    "the subharmonic resonance near 17-21 Hz'. Captured: period 3 from some start at half as many "
    "frequencies as the exact law, and from a twentieth of 400 starts at 17, 19 and 21 Hz; not: "
    "from fewer than a hundredth of those.")  # fmt: skip
def subharmonics(run: Run) -> Found:
    band, laws = (17.0, 21.0), (EXACT, *WEAK)
    exact = share_of_frequencies(run, EXACT, SOFT_SYMMETRIC, "period 3", band, "scattered")
    basins = {
        label: share(_periods(run, label, SOFT_SYMMETRIC, (17.0, 19.0, 21.0)) == 3)
        for label in laws
    }
    tests = [
        Test("exact law: frequencies with period 3", exact, ">=", HALF),
        Test("exact law: share of 400 starts that end on it", basins[EXACT], ">=", TWENTIETH),
    ]
    for label in WEAK:
        says = f"{named(label)}: share of 400 starts"
        if label in (RATPOLY, TANH, ARCTAN):
            ours = share_of_frequencies(run, label, SOFT_SYMMETRIC, "period 3", band, "scattered")
            over = f"{named(label)}: frequencies with period 3, over the exact law's"
            tests.append(Test(over, ours / exact, ">=", HALF))
            tests.append(Test(says, basins[label], ">=", TWENTIETH))
        else:
            tests.append(Test(says, basins[label], "<", 0.01))
    return tests, f"Starts that end on period 3 at 17, 19, 21 Hz: {by_law(basins)}; {_bands(run)}"


def _bands(run: Run) -> str:
    """Where the period-3 bands are, in words."""
    texts = []
    for label in (EXACT, *WEAK):
        low, high = (_end(run, label, f"period_3_{end}") for end in ("low", "high"))
        band = f"{low.value:.2f}-{high.value:.2f} Hz" if math.isfinite(low.value) else "none"
        texts.append(f"{named(label)} {band}")
    return f"its band, from any start: {listed(texts)} (paper: 17-21 Hz)."


def _end(run: Run, label: str, name: str) -> Number:
    """The end of a band by bisection [Hz]."""
    return Number(float(run.select("bands", representation=label)[name]), FINEST)


@claim(27, "Fig. 6b", "RatPoly 5/3 has more subharmonic branches than the one of the exact law.",
    "'The RatPoly 5/3 model predicts more subharmonic-resonance branches than the single one': "
    "more frequencies with several attractors of a period above 1, at 12-30 Hz, 16 starts and "
    f"both sweeps. Decided {OPTIMUM}.")  # fmt: skip
def more_branches(run: Run) -> Found:
    def several(label: str) -> Number:
        found = run.scene("attractors", label, *SOFT_SYMMETRIC, "period_multiple")
        periods = found["period_multiple"].sel(omega=slice(12.0, 30.0))
        status = run.scene("responses", label, *SOFT_SYMMETRIC, "status")["status"]
        asked = status.isel(initial_condition=run.starts["scattered"]).sel(omega=slice(12.0, 30.0))
        asked = (asked != Status.NOT_REQUESTED).any("initial_condition")
        return share((periods > 1).sum("attractor")[asked.values] > 1)

    ours, exact = several(RATPOLY), several(EXACT)
    says = "frequencies with several branches, minus the exact law's"
    return [Test(says, ours - exact, ">", 0.0)], (
        f"The optimum has several at {ours.value:.0%} of the frequencies of 12-30 Hz, the exact "
        f"law at {exact.value:.0%}, mirror twins being two, as in a plot of peaks."
    )


@claim(28, "Fig. 6b", "RatPoly 5/3, tanh and arctan are best at the primary peak and its jump.",
    "'The RatPoly 5/3, Tanh, and Arctan also have the best agreement to the primary resonance peak "
    "and to the jump to lower amplitude': from rest, the jump's frequency by bisection and median "
    "amplitude error at 8-14 Hz, worst of the three against better of the others.")  # fmt: skip
def primary_peak(run: Run) -> Found:
    shift = {label: Number(abs(_peak(run, label).value), FINEST) for label in WEAK}
    near = (8.0, 14.0)
    error = {label: amplitude_error(run, label, SOFT_SYMMETRIC, near, q=HALF) for label in WEAK}
    tests = []
    for says, found in (("shift of the jump [Hz]", shift),
                        ("median amplitude error at 8-14 Hz", error)):  # fmt: skip
        worst = max((found[label] for label in (RATPOLY, TANH, ARCTAN)), key=_size)
        better = min((found[label] for label in (POLY, LOGARCTAN)), key=_size)
        says += ", worst of the three minus better of the others"
        tests.append(Test(says, worst - better, "<", 0.0))
    return tests, _peaks(run)


def _size(number: Number) -> float:
    """What to order numbers by; where there is none (no peak), nothing is larger."""
    return math.inf if math.isnan(number.value) else number.value


def _peak(run: Run, label: str) -> Number:
    """How far the primary peak from rest is from the exact one [Hz]."""
    ours, exact = (_end(run, one, "peak_frequency").value for one in (label, EXACT))
    return Number(ours - exact, FINEST)


def _peaks(run: Run) -> str:
    exact = _end(run, EXACT, "peak_frequency").value
    shifts = by_law({label: _peak(run, label) for label in WEAK}, "+.2f")
    return f"From rest the exact peak ends at {exact:.2f} Hz; the others: {shifts} Hz."


@claim(29, "Fig. 6c", "Poly-13 is excellent up to the jump near 12 Hz and captures nothing after.",
    "'The Poly-13 model shows excellent agreement up until the jump phenomenon, and afterwards "
    "captures none': three quarters of the amplitude errors within a line; a tenth of the exact "
    "attractors at most.")  # fmt: skip
def polynomial_asymmetric(run: Run) -> Found:
    error = amplitude_error(run, POLY, SOFT_ASYMMETRIC, (0.2, 12.0), "scattered")
    found = recall(run, POLY, SOFT_ASYMMETRIC, (12.2, 30.0))
    tests = [
        Test("0.2-12 Hz: amplitude error of 3 in 4", error, "<=", LINE),
        Test("12.2-30 Hz: exact attractors found, mean", found, "<=", TENTH),
    ]
    return tests, (
        f"Up to 12 Hz three quarters of the amplitudes are within {error.value:.1%}; beyond, "
        f"{found.value:.0%} of the exact attractors are found."
    )


@claim(30, "Fig. 6c",
    "RatPoly 5/3 does the same, but finds periodic motion at 15-18, subharmonics at 21-22 Hz.",
    "'Operates similarly, except it does capture one section of periodic response between 15-18 "
    "Hz and section of subharmonic resonance between 21-22 Hz': half of those there, a tenth of "
    f"the exact attractors elsewhere. Decided {OPTIMUM}.")  # fmt: skip
def rational_asymmetric(run: Run) -> Found:
    error = amplitude_error(run, RATPOLY, SOFT_ASYMMETRIC, (0.2, 12.0), "scattered")
    periodic = _has_periodic(run, RATPOLY, SOFT_ASYMMETRIC, (15.0, 18.0))
    tests = [
        Test("0.2-12 Hz: amplitude error of 3 in 4", error, "<=", LINE),
        Test("15-18 Hz: frequencies with an exact periodic amplitude", periodic, ">=", HALF),
    ]
    for band, op, limit in (
        ((21.0, 22.0), ">=", HALF), ((12.2, 14.8), "<=", TENTH),
        ((18.2, 20.8), "<=", TENTH), ((22.2, 30.0), "<=", TENTH),
    ):  # fmt: skip
        found = recall(run, RATPOLY, SOFT_ASYMMETRIC, band)
        says = f"{band[0]:g}-{band[1]:g} Hz: exact attractors found, mean"
        tests.append(Test(says, found, op, limit))
    return tests, (
        f"The optimum has an exact periodic amplitude at {periodic.value:.0%} of the frequencies "
        f"of 15-18 Hz; of all exact attractors it finds: {shown(tests[2:])}."
    )


def _has_periodic(run: Run, label: str, scene: Scene, band: Band) -> Number:
    """Frequencies with an exact periodic amplitude that a law has too, to a line's thickness."""

    def amplitudes(label: str) -> dict[float, list[float]]:
        names = ("period_multiple", "amplitude")
        points = run.points(label, *scene, *names, band=band, start="any")
        found: dict[float, list[float]] = {}
        for omega, n, amplitude in zip(
            *(points[name].values.tolist() for name in ("omega", *names)), strict=True
        ):
            if n > 0:
                found.setdefault(omega, []).append(amplitude)
        return found

    ours = amplitudes(label)
    return share(
        [
            any(abs(a - b) <= LINE * b for a in ours.get(omega, []) for b in exact)
            for omega, exact in amplitudes(EXACT).items()
        ]
    )


def _better(
    run: Run, ours: Sequence[str], others: Sequence[str], scene: Scene, band: Band = ALL
) -> list[Test]:
    """Tests that the attractor sets of some laws are nearer to the exact ones than of others."""
    found = {label: f1(run, label, scene, band) for label in (*ours, *others)}
    return _ahead(found, ours, others, f"{_where(scene)}: F1")


def _f1s(run: Run, labels: Iterable[str], scene: Scene) -> str:
    return listed(f"{label} {f1(run, label, scene).value:.2f}" for label in labels)


@claim(31, "Fig. 6c", "Tanh and arctan are best, and get worse with frequency.",
    "'The Tanh and Arctan models have the best agreement to the piecewise results but still lose "
    "accuracy as forcing frequency increases': F1 of their attractor sets above that of the other "
    "three; lower above 15 Hz than below.")  # fmt: skip
def best_asymmetric(run: Run) -> Found:
    tests = _better(run, (TANH, ARCTAN), (POLY, RATPOLY, LOGARCTAN), SOFT_ASYMMETRIC)
    for label in (TANH, ARCTAN):
        high, low = (f1(run, label, SOFT_ASYMMETRIC, band) for band in ((15.0, 30.0), (0.2, 14.8)))
        tests.append(Test(f"{named(label)}: F1 at 15-30 Hz minus F1 below", high - low, "<", 0.0))
    return tests, f"F1 of the attractor sets: {_f1s(run, WEAK, SOFT_ASYMMETRIC)}."


@claim(32, "Fig. 6c",
    "Log-arctan is weakest in the superharmonics, poor at 13-15 Hz, lacks a subharmonic branch "
    "and is low at high frequencies.",
    "'The weakest accuracy in the superharmonic-resonance region', 'poor accuracy in the chaotic "
    "region within 13-15 Hz', 'fails to capture one branch ... and underestimates the "
    "low-amplitude responses at higher frequencies'. Weakest: largest median amplitude error below "
    "5 Hz; poor: less than half of the attractors; lacks: three quarters of the subharmonic "
    "attractors at most (16-30 Hz); low: median amplitude 5 % below (22-30 Hz).")  # fmt: skip
def logarctan_asymmetric(run: Run) -> Found:
    scene, low, high = SOFT_ASYMMETRIC, (0.2, 5.0), (22.0, 30.0)
    errors = {label: amplitude_error(run, label, scene, low, "scattered", HALF) for label in WEAK}
    tests = _ahead(errors, [LOGARCTAN], WEAK[:-1], "median amplitude error below 5 Hz")

    def branches(label: str) -> Number:
        found = run.scene("attractors", label, *scene, "period_multiple")["period_multiple"]
        return _plain((found.sel(omega=slice(16.0, 30.0)) > 1).sum())

    def amplitude(label: str) -> Number:
        points = run.points(label, *scene, "amplitude", band=high, start="scattered")
        return _plain(points["amplitude"].median())

    chaos = recall(run, LOGARCTAN, scene, (13.0, 15.0))
    lacks = of_law(run, LOGARCTAN, lambda label: branches(label) / branches(EXACT))
    small = of_law(run, LOGARCTAN, lambda label: amplitude(label) / amplitude(EXACT))
    tests += [
        Test("13-15 Hz: exact attractors found, mean", chaos, "<", HALF),
        Test("subharmonic attractors at 16-30 Hz, over the exact law's",
             lacks, "<=", THREE_QUARTERS),
        Test("median amplitude at 22-30 Hz, over the exact law's", small, "<", 1.0 - LINE),
    ]  # fmt: skip
    return tests, (
        f"Median amplitude errors below 5 Hz: {by_law(errors, '.1%')}. Log-arctan has {lacks} of "
        f"the subharmonic attractors and {small} of the amplitude at 22-30 Hz."
    )


@claim(33, "Fig. 6c", "The exact law is chaotic at 13-15 Hz.",
    "'The chaotic region within 13-15 Hz': chaotic from rest at half the frequencies.")  # fmt: skip
def chaotic_region(run: Run) -> Found:
    number = share_of(run, EXACT, SOFT_ASYMMETRIC, "chaos", (13.0, 15.0))
    where = ranges(*frequencies(run, EXACT, SOFT_ASYMMETRIC, "chaos"))
    test = Test("responses from rest that are chaotic", number, ">=", HALF)
    return [test], f"{number.value:.0%} are; from rest there is chaos at {where}."


@claim(34, "Fig. 7",
    "In the strong grade all are excellent up to the primary peak; Poly-21 and RatPoly 5/5 begin "
    "to disagree after the jump.",
    "'All representations show excellent agreement in the superharmonic-resonance region and "
    "leading up to the primary resonance peak, but the Poly-21 and RatPoly 5/5 models begin to "
    "disagree with the reference model after the jump' (soft contact, 0/0.8 mm): three quarters of "
    "the amplitude errors within a line up to 12 Hz, and not beyond.")  # fmt: skip
def strong_asymmetric(run: Run) -> Found:
    def errors(labels: Iterable[str], band: Band, op: str) -> list[Test]:
        says = f"amplitude error of 3 in 4, {band[0]:g}-{band[1]:g} Hz"
        number = partial(amplitude_error, run, scene=SOFT_ASYMMETRIC, band=band, start="scattered")
        return each(labels, says, number, op, LINE)

    below, beyond = errors(STRONG, (0.2, 12.0), "<="), errors(STRONG[:2], (12.2, 30.0), ">")
    return below + beyond, (
        f"Up to 12 Hz 3 in 4 are within: {shown(below, '.1%')}; beyond: {shown(beyond, '.1%')}."
    )


@claim(35, "Fig. 7", "At 1e6 tanh and arctan are alike, log-arctan worse at higher frequency.",
    "'The tangent-based models are the most accurate, with Tanh and Arctan having similar accuracy "
    "and Log-Arctan having slightly less accuracy at higher forcing frequency': F1 of the "
    "attractor sets within a tenth; above that of log-arctan at 15-30 Hz.")  # fmt: skip
def strong_tangents(run: Run) -> Found:
    apart = larger_over_smaller(*(f1(run, label, SOFT_ASYMMETRIC) for label in (TANH_6, ARCTAN_6)))
    tests = [Test("F1 of tanh and arctan: larger over smaller", apart, "<=", ALIKE)]
    tests += _better(run, (TANH_6, ARCTAN_6), (LOGARCTAN_6,), SOFT_ASYMMETRIC, (15.0, 30.0))
    return tests, f"F1 of the attractor sets: {_f1s(run, STRONG, SOFT_ASYMMETRIC)}."


# --- Figs 8 and 9: bifurcation diagrams -----------------------------------------------------------


@claim(36, "Fig. 8a", "At very soft contact all are excellent and show ringing and superharmonics.",
    "'All models are in excellent agreement for the very soft contact case', 'all five "
    "representations capture both behaviors well': three quarters of the amplitude errors from "
    "rest within a line; below 5 Hz three quarters as many responses that ring.")  # fmt: skip
def very_soft(run: Run) -> Found:
    scene = VERY_SOFT_SYMMETRIC
    says = "amplitude error of 3 in 4"
    tests = each(WEAK, says, lambda label: amplitude_error(run, label, scene), "<=", LINE)
    ringing, words = _ringing(run, scene, THREE_QUARTERS)
    return tests + ringing, f"3 in 4 of the amplitudes are within: {shown(tests, '.1%')}. {words}"


@claim(37, "Fig. 8b", "Poly-13 misses a range of ringing, chaos and superharmonics.",
    "'Unable to capture the full frequency range of \"ringing\", chaotic, or superharmonic "
    "resonance behaviors': from rest below 7 Hz right at under half the frequencies.")  # fmt: skip
def polynomial_misses(run: Run) -> Found:
    number = right(run, POLY, SOFT_SYMMETRIC, (0.1, 7.0))
    test = Test("below 7 Hz: frequencies with the exact class and amplitude", number, "<", HALF)
    exact, ours = (
        ranges(*frequencies(run, label, SOFT_SYMMETRIC, "chaos", (0.1, 7.0)))
        for label in (EXACT, POLY)
    )
    return [test], (
        f"Class and amplitude are right at {number.value:.0%}; chaotic are {exact} (exact) and "
        f"{ours} (Poly-13)."
    )


@claim(38, "Fig. 8b", "Arctan and log-arctan miss a narrow chaotic band at 4-5 Hz.",
    "'The Arctan and Log-Arctan models also fail to capture the narrow chaotic band near 4-5 Hz': "
    "the exact law from rest is chaotic at some frequency of the grid, they at none.")  # fmt: skip
def narrow_chaos(run: Run) -> Found:
    found = {
        label: frequencies(run, label, SOFT_SYMMETRIC, "chaos", (4.0, 5.0))
        for label in (EXACT, *WEAK)
    }
    tests = [
        Test(f"{named(label)}: chaotic frequencies", _plain(found[label][1].sum()), op, 1.0)
        for label, op in ((EXACT, ">="), (ARCTAN, "<"), (LOGARCTAN, "<"))
    ]
    words = (f"{named(label)} {ranges(*hits)}" for label, hits in found.items())
    return tests, f"Chaos from rest at 4-5 Hz: {listed(words)}."


@claim(39, "Fig. 8b", "Only tanh has both narrow features near 6 and 7 Hz.",
    "'Only the Tanh model captures both the narrow transitions to superharmonic resonance near 6Hz "
    "and 7Hz': not period 1 from rest within half a hertz of either; others lack one.")  # fmt: skip
def narrow_features(run: Run) -> Found:
    tests, words = [], []
    for label in (EXACT, *WEAK):
        features = [
            frequencies(run, label, SOFT_SYMMETRIC, "period not 1", band)
            for band in ((5.5, 6.4), (6.5, 7.4))
        ]
        fewest = _plain(min(int(hits.sum()) for _, hits in features))
        op = ">=" if label in (EXACT, TANH) else "<"
        tests.append(Test(f"{named(label)}: frequencies of the rarer feature", fewest, op, 1.0))
        words.append(f"{named(label)} {' and '.join(ranges(*one) for one in features)}")
    return tests, f"Not period 1: {'; '.join(words)}."


@claim(40, "Fig. 8b", "Poly-13, arctan and log-arctan put the primary peak slightly too high.",
    "'Slightly overestimate the frequency value of the primary resonance peak': from rest, by "
    "bisection to a millihertz, as the words are about less than a step of the grid.")  # fmt: skip
def peak_too_high(run: Run) -> Found:
    tests = [
        Test(f"{named(label)}: frequency of the peak minus the exact one [Hz]",
             _peak(run, label), ">", 0.0)
        for label in (POLY, ARCTAN, LOGARCTAN)
    ]  # fmt: skip
    return tests, _peaks(run)


@claim(41, "Fig. 8b", "RatPoly 5/3 and arctan show an extra nonlinear region after the jump.",
    "'The RatPoly 5/3 and Arctan models predict a region of nonlinear behavior shortly after the "
    "jump phenomenon and before the region of subharmonic resonance', so from rest at 11.5-17 Hz: "
    "responses that are not period 1 with two extrema, a twentieth more than with the exact law. "
    f"RatPoly is decided {OPTIMUM}.")  # fmt: skip
def extra_region(run: Run) -> Found:
    found = {
        label: frequencies(run, label, SOFT_SYMMETRIC, "nonlinear", (11.5, 17.0))
        for label in (EXACT, RATPOLY, ARCTAN)
    }
    shares = {label: share(hits, omega) for label, (omega, hits) in found.items()}
    tests = [
        Test(f"{named(label)}: nonlinear responses minus the exact law's",
             shares[label] - shares[EXACT], ">=", TWENTIETH)
        for label in (RATPOLY, ARCTAN)
    ]  # fmt: skip
    words = (f"{named(label)} at {ranges(*hits)}" for label, hits in found.items())
    return tests, f"Nonlinear from rest: {listed(words)}."


@claim(42, "Fig. 8b",
    "The subharmonic band is much wider for RatPoly 5/3, shifted slightly down for tanh and up "
    "for arctan, of the same size for both.",
    "'Predict a much larger frequency band, predict the correct-size band but shifted slightly "
    "down in frequency, and ... slightly up'. Diagrams are from one start, so the exact law must "
    "show the band from rest; from 16 starts its ends are followed to a millihertz. Much: by half; "
    "the same size: within a quarter.")  # fmt: skip
def subharmonic_band(run: Run) -> Found:
    low, high = (
        {label: _end(run, label, f"period_3_{end}") for label in (EXACT, *WEAK)}
        for end in ("low", "high")
    )
    width = {label: high[label] - low[label] for label in high}
    rest = share_of(run, EXACT, SOFT_SYMMETRIC, "period 3", (17.0, 21.0))
    tests = [
        Test("exact law, from rest: responses of period 3 at 17-21 Hz", rest, ">=", TENTH),
        Test("RatPoly 5/3: width over the exact one", width[RATPOLY] / width[EXACT], ">=", 1.5),
    ]
    for label, op in ((TANH, "<"), (ARCTAN, ">")):
        apart = larger_over_smaller(width[label], width[EXACT])
        tests += [
            Test(f"{label}: lower end minus the exact one [Hz]", low[label] - low[EXACT], op, 0.0),
            Test(f"{label}: widths, larger over smaller", apart, "<=", 1.25),
        ]
    return tests, f"From rest {rest.value:.0%} of the exact responses have it; {_bands(run)}"


@claim(43, "Fig. 8b", "Poly-13 and log-arctan have no subharmonic band.",
    "'Poly-13 and Log-Arctan do not capture any subharmonic resonance behavior': period 3 from any "
    "start at under a twentieth of the frequencies, at 17-21 Hz and above 12 Hz.")  # fmt: skip
def no_subharmonic_band(run: Run) -> Found:
    tests = [
        Test(f"{named(label)}, {band[0]:g}-{band[1]:g} Hz: frequencies with period 3",
             share_of_frequencies(run, label, SOFT_SYMMETRIC, "period 3", band, "scattered"),
             "<", TWENTIETH)
        for label in (POLY, LOGARCTAN)
        for band in ((17.0, 21.0), (12.0, 30.0))
    ]  # fmt: skip
    rest = [
        f"{named(label)} at {ranges(*frequencies(run, label, SOFT_SYMMETRIC, 'period 3'))}"
        for label in (EXACT, *WEAK)
    ]
    return tests, f"Period 3 from rest: {listed(rest)}; {_bands(run)}"


@claim(44, "Fig. 8c", "At hard contact all laws of the weak grade fail.",
    "'All the representations seem to have failed altogether': class and amplitude from rest right "
    "at less than half of the frequencies.")  # fmt: skip
def weak_at_hard(run: Run) -> Found:
    return _rights(run, WEAK, HARD_SYMMETRIC, "<", HALF)


def _rights(
    run: Run, labels: Iterable[str], scene: Scene, op: str, limit: float, band: Band = ALL
) -> Found:
    says = "frequencies with the exact class and amplitude"
    tests = each(labels, says, lambda label: right(run, label, scene, band), op, limit)
    itself = right(run, "piecewise@jitter", scene, band).value
    return tests, (
        f"Class and amplitude, within 5 %, are right from rest at: {shown(tests)} of the "
        f"frequencies (of the exact law from a start 1 nm away: {itself:.0%}). Of the exact "
        f"attractors these are found to 5 % of the gap, which small motions easily are: "
        f"{_found(run, labels, scene)}."
    )


def _found(run: Run, labels: Iterable[str], scene: Scene) -> str:
    """What the report's map says of laws: exact attractors found, of all frequencies together."""
    return by_law({label: recall_pooled(run, label, scene) for label in labels}, ".0%")


@claim(45, "Fig. 8c", "Poly-13 and log-arctan show a tiny periodic motion everywhere.",
    "'Very low-amplitude periodic solutions for the entire frequency range': 98 % periodic from "
    "rest; 95 % of the amplitudes below a tenth of the wall's distance.")  # fmt: skip
def tiny_motion(run: Run) -> Found:
    tests, words = [], []
    for label in (POLY, LOGARCTAN):
        points = run.points(label, *HARD_SYMMETRIC, "amplitude")
        periodic = share_of(run, label, HARD_SYMMETRIC, "periodic")
        most = _plain(np.nanquantile(points["amplitude"], 0.95))
        tests += [
            Test(f"{named(label)}: periodic responses", periodic, ">=", 0.98),
            Test(f"{named(label)}: 95th percentile of the amplitude [m]", most, "<", 0.1 * 0.4e-3),
        ]
        words.append(f"{named(label)} {periodic.value:.0%} periodic, {1e6 * most.value:.3g} µm")
    return tests, f"{'; '.join(words)}."


@claim(46, "Fig. 8c", "RatPoly 5/3 is low, with a negative mean, and larger above 20 Hz.",
    "'A low-amplitude periodic solution, with negative mean, for most of the frequency range "
    "before predicting higher amplitude periodic solutions above 20Hz'. Low: half of the exact "
    "amplitude in the median below 20 Hz; negative: at most frequencies, beyond a tenth of the "
    f"amplitude; higher: by half. Decided {OPTIMUM}.")  # fmt: skip
def rational_at_hard(run: Run) -> Found:
    def median(label: str, band: Band) -> Number:
        found = run.points(label, *HARD_SYMMETRIC, "amplitude", band=band)["amplitude"]
        return _plain(found.median())

    below, above = (0.0, 20.0), (20.1, 30.0)
    points = run.points(RATPOLY, *HARD_SYMMETRIC, "amplitude", "x_max", "x_min", band=below)
    middle = 0.5 * (points["x_max"] + points["x_min"]) / points["amplitude"]
    negative, positive = share(middle < -0.1), share(middle > 0.1)
    low = of_law(run, RATPOLY, lambda label: median(label, below) / median(EXACT, below))
    higher = of_law(run, RATPOLY, lambda label: median(label, above) / median(label, below))
    tests = [
        Test("median amplitude below 20 Hz, over the exact law's", low, "<=", HALF),
        Test("responses below 20 Hz with a negative mean", negative, ">", HALF),
        Test("median amplitude above 20 Hz over that below", higher, ">", 1.5),
    ]
    sizes = listed(f"{1e6 * median(RATPOLY, band).value:.2g}" for band in (below, above))
    return tests, (
        f"The optimum's median amplitudes below and above 20 Hz are {sizes} µm, its mean below is "
        f"negative at {negative.value:.0%}, positive at {positive.value:.0%} of the frequencies."
    )


@claim(47, "Fig. 8c", "Tanh is trapped away from the centre.",
    "'Tanh predicts a very low-amplitude periodic response with a high mean value, almost as if "
    "the system becomes trapped in a potential well away from the origin': several static wells, "
    "and most responses from rest below 0.1 mm with a mean beyond their amplitude.")  # fmt: skip
def trapped(run: Run) -> Found:
    return _trapped(run, TANH)


def _trapped(run: Run, label: str) -> Found:
    names = ("equilibrium_x", "equilibrium_stable", "n_wells")
    static = run.scene("static", label, *HARD_SYMMETRIC, *names)
    stable = static["equilibrium_x"].values[static["equilibrium_stable"].values == 1]
    points = run.points(label, *HARD_SYMMETRIC, "amplitude", "x_max", "x_min")
    middle = abs(0.5 * (points["x_max"] + points["x_min"]))
    number = share((points["amplitude"] < 0.1e-3) & (middle > points["amplitude"]))
    tests = [
        Test("static wells", _plain(static["n_wells"]), ">=", 2.0),
        Test("responses that are small motions away from the centre", number, ">", HALF),
    ]
    wells = listed(f"{1e3 * x:.3f}" for x in stable)
    return tests, f"Static wells at {wells} mm; {number.value:.0%} of the motions are trapped."


@claim(48, "Fig. 8c", "Arctan captures nothing.",
    "'Arctan also captures none of the correct system physics': class and amplitude from rest "
    "right at a tenth of the frequencies at most.")  # fmt: skip
def arctan_at_hard(run: Run) -> Found:
    return _rights(run, (ARCTAN,), HARD_SYMMETRIC, "<=", TENTH)


@claim(49, "Fig. 9",
    "Tanh and arctan (1e6) capture low-frequency chaos, transitions and the motion at 10-12 Hz.",
    "'Capture the low-frequency chaos, the chaotic-to-periodic transitions, and the additional "
    "nonlinear behavior between 10-12 Hz': the exact class from rest at three quarters of the "
    "frequencies at 10-12 and below 4.5 Hz, at half in the transitions between.")  # fmt: skip
def strong_classes(run: Run) -> Found:
    limits = THREE_QUARTERS, HALF, THREE_QUARTERS
    tests = [
        Test(f"{named(label)}, {band[0]:g}-{band[1]:g} Hz: frequencies of the exact class",
             mean_of(run, "class_agreement", label, HARD_SYMMETRIC, band), ">=", limit)
        for label in (TANH_6, ARCTAN_6)
        for band, limit in zip(((0.5, 4.5), (4.6, 9.9), (10.0, 12.0)), limits, strict=True)
    ]  # fmt: skip
    return tests, f"The class is right at: {shown(tests)}."


@claim(50, "Fig. 9", "Arctan captures more of the narrow windows at 12-20 Hz than tanh.",
    "'Arctan captures more of the very narrow higher-period regions between 12-20 Hz than Tanh "
    "does': of the frequencies at which the exact law has an attractor of a period above 1, the "
    "share at which a law has one of the same period.")  # fmt: skip
def narrow_windows(run: Run) -> Found:
    band = (12.0, 20.0)

    def windows(label: str, start: str) -> dict[float, set[int]]:
        """The periods above 1 at every frequency."""
        points = run.points(label, *HARD_SYMMETRIC, "period_multiple", band=band, start=start)
        found: dict[float, set[int]] = {}
        for omega, n in zip(points["omega"].values, points["period_multiple"].values, strict=True):
            found.setdefault(float(omega), set()).update({int(n)} - {0, 1})
        return found

    tests, words = [], []
    for says, start in (("from rest", "rest"), ("from any of 16 starts", "scattered")):
        exact = {omega: periods for omega, periods in windows(EXACT, start).items() if periods}
        tanh, arctan = (
            share([bool(found.get(omega, set()) & exact[omega]) for omega in exact], list(exact))
            for found in (windows(label, start) for label in (TANH_6, ARCTAN_6))
        )
        tests.append(Test(f"windows found {says}, arctan minus tanh", arctan - tanh, ">", 0.0))
        found = f"arctan finds {arctan.value:.0%}, tanh {tanh.value:.0%}"
        words.append(f"of {tanh.n} frequencies with a window {says} {found}")
    return tests, f"{'; '.join(words).capitalize()}."


@claim(51, "Fig. 9", "Log-arctan captures less, and has a false region above 20 Hz.",
    "'Log-Arctan is less accurate ... and it also predicts a narrow region of behavior beyond 20Hz "
    "that does not occur in the other models': class and amplitude right below 20 Hz less often "
    "than with either, and above it too.")  # fmt: skip
def logarctan_strong(run: Run) -> Found:
    tests, words = [], []
    for place, band in (("below", (0.1, 20.0)), ("above", (20.1, 30.0))):
        found = {label: right(run, label, HARD_SYMMETRIC, band) for label in STRONG[2:]}
        tests += _ahead(found, STRONG[2:4], [LOGARCTAN_6], f"right {place} 20 Hz")
        words.append(f"{place} 20 Hz {by_law(found)}")
    return tests, f"Class and amplitude are right, {'; '.join(words)} of the frequencies."


@claim(52, "Fig. 9", "Poly-21 and RatPoly 5/5 capture nothing at hard contact.",
    "'The Poly-21 and RatPoly 5/5 models are still unable to capture any of the system's rich "
    "behavior': class and amplitude from rest right at one frequency in ten at most.")  # fmt: skip
def polynomials_at_hard(run: Run) -> Found:
    return _rights(run, (POLY_21, RATPOLY_5), HARD_SYMMETRIC, "<=", TENTH)


# --- Table 2: cost --------------------------------------------------------------------------------

Costs = dict[str, dict[str, Number]]


def printed() -> Costs:
    """The paper's seconds; half of the last digit is what rounding can do to them."""
    return {
        grade: {label: Number(value, 0.005) for label, value in column.items()}
        for grade, column in TABLE_2.items()
    }


def costs_here(run: Run) -> Costs:
    """Right-hand sides per forcing period, in units of the exact law's, with the paper's solver."""
    return {
        grade: {label: work(run, f"{label}@paper", f"{EXACT}@paper", scene) for label in column}
        for (grade, column), scene in zip(TABLE_2.items(), TABLE_SCENES.values(), strict=True)
    }


def _both(run: Run, tests: Callable[[Costs], list[Test]]) -> list[Test]:
    """Tests of the paper's seconds, and of what the laws need in right-hand sides."""
    both = {"the paper's seconds": printed(), "right-hand sides": costs_here(run)}
    return [
        replace(test, says=f"{what}: {test.says}")
        for what, costs in both.items()
        for test in tests(costs)
    ]


def _cost_words(run: Run) -> str:
    """What the exact law costs beside tanh, by both measures and on this machine."""
    parts = []
    for grade, tanh in (("weak", TANH), ("strong", TANH_6)):
        theirs = TABLE_2[grade][EXACT] / TABLE_2[grade][tanh]
        ours = 1.0 / costs_here(run)[grade][tanh].value
        here = seconds(run, f"{EXACT}@paper", f"{tanh}@paper", TABLE_SCENES[grade])
        parts.append(
            f"{grade}: {theirs:.1f} in the paper's seconds, {ours:.2f} in right-hand sides, {here} "
            "in processor time here"
        )
    return f"The exact law over tanh, {'; '.join(parts)}."


_TABLE_WHY = (
    " The paper's own seconds must bear it out, and so must the right-hand sides per forcing "
    "period with its tolerances, controller and restarts: where only the seconds do, it is "
    "MATLAB's overhead."
)


def _slower(costs: dict[str, Number], label: str) -> Number:
    """How many laws cost more than this one; its floor, of how many that is open."""
    mine = costs[label]
    apart = [other - mine for other in costs.values() if other is not mine]
    is_open = [Test("", each, ">", 0.0).holds is None for each in apart]
    return Number(float(sum(each.value > 0.0 for each in apart)), float(sum(is_open)), len(apart))


def _off_third(costs: dict[str, Number], label: str) -> Number:
    """How many places a law is from the third."""
    slower = _slower(costs, label)
    return Number(abs(slower.value - 2.0), slower.floor, slower.n)


@claim(53, "Table 2", "The exact law is slowest or second in both cases.",
    "'The exact piecewise representation took either the first or second longest': at most one law "
    "costs more." + _TABLE_WHY)  # fmt: skip
def exact_is_slow(run: Run) -> Found:
    def tests(costs: Costs) -> list[Test]:
        says = "laws that cost more than the exact one"
        return [Test(f"{g}: {says}", _slower(costs[g], EXACT), "<=", 1.0) for g in costs]

    return _both(run, tests), _cost_words(run)


@claim(54, "Table 2", "RatPoly is second in the weak case and slowest in the strong one.",
    "'The rational polynomial model took the longest to run for case 2 and the second longest for "
    "case 1.'" + _TABLE_WHY)  # fmt: skip
def rational_is_slow(run: Run) -> Found:
    def tests(costs: Costs) -> list[Test]:
        weak, strong = _slower(costs["weak"], RATPOLY), _slower(costs["strong"], RATPOLY_5)
        return [
            Test("weak: laws that cost more than RatPoly 5/3", weak, "<=", 1.0),
            Test("strong: laws that cost more than RatPoly 5/5", strong, "<=", 0.0),
        ]

    costs = costs_here(run)
    words = by_law({label: costs[g][label] for g, (_, label, *_) in GRADES.items()}, ".2f")
    return _both(run, tests), f"Over the exact law, in right-hand sides: {words}."


def _gains(costs: Costs) -> list[float]:
    """The second slowest law over the polynomial, in both grades."""
    return [
        sorted(number.value for number in column.values())[-2] / column[GRADES[grade][0]].value
        for grade, column in costs.items()
    ]


@claim(55, "Table 2", "The polynomial is third, about one and a half times faster than the second.",
    "'Third slowest for both cases, but it was faster than the second slowest by a factor of about "
    "1.5': on average of both cases, within a tenth." + _TABLE_WHY)  # fmt: skip
def polynomial_is_third(run: Run) -> Found:
    def tests(costs: Costs) -> list[Test]:
        off = abs(float(np.mean(_gains(costs))) / 1.5 - 1.0)
        return [
            *(
                Test(f"{grade}: places that {named(labels[0])} is off the third by",
                     _off_third(costs[grade], labels[0]), "<=", 0.0)
                for grade, labels in GRADES.items()
            ),
            Test("second slowest over polynomial, mean of both: off 1.5 by a share of",
                 _plain(off), "<=", 0.1),
        ]  # fmt: skip

    factors = listed(f"{gain:.2f}" for gain in _gains(printed()))
    return _both(run, tests), f"The paper's factors are {factors}."


def _tangent_costs(costs: Costs) -> dict[str, list[float]]:
    return {
        grade: [costs[grade][label].value for label in labels[2:]]
        for grade, labels in GRADES.items()
    }


@claim(56, "Table 2", "The three tangent laws differ by no more than half a second.",
    "'Differed by no more than half a second', which is 7 % of the weak case's time; 7 % in "
    "both." + _TABLE_WHY)  # fmt: skip
def tangents_alike(run: Run) -> Found:
    def tests(costs: Costs) -> list[Test]:
        return [
            Test(f"{grade}: slowest over fastest tangent law",
                 _plain(max(values) / min(values)), "<=", 1.07)
            for grade, values in _tangent_costs(costs).items()
        ]  # fmt: skip

    found = _both(run, tests)
    paper, here = (
        f"{weak.number.value:.2f} (weak) and {strong.number.value:.2f} (strong)"
        for weak, strong in (found[:2], found[2:])
    )
    return found, f"Slowest over fastest: {paper} in the paper's seconds, {here} in work."


@claim(57, "Table 2", "The tangent laws are about 6.5 times faster than the slowest law.",
    "'These averaged about 6.5 times faster than the slowest model in both cases': the mean of "
    "both, within a tenth." + _TABLE_WHY)  # fmt: skip
def tangents_fast(run: Run) -> Found:
    def tests(costs: Costs) -> list[Test]:
        factors = [
            max(number.value for number in costs[grade].values()) / float(np.mean(values))
            for grade, values in _tangent_costs(costs).items()
        ]
        off = abs(float(np.mean(factors)) / 6.5 - 1.0)
        says = "slowest over mean tangent law, mean of both: off 6.5 by a share of"
        return [Test(says, _plain(off), "<=", 0.1)]

    return _both(run, tests), _cost_words(run)


def _restarts(run: Run, least: float) -> Found:
    """Tests of what restarts cost in work, and in words what the paper's seconds hold beyond it."""
    costs, tests, parts = costs_here(run), [], []
    for grade, scene in TABLE_SCENES.items():
        labels = ("piecewise@paper", "piecewise@paper-norestart")
        number = work(run, *labels, scene)
        tests.append(Test(f"{grade}: work with restarts over without", number, ">=", least))
        parts.append(f"{grade} {number} times ({seconds(run, *labels, scene)} in processor time)")
    exact, *others = (
        f"{named(label)} {TABLE_2['weak'][label] / TABLE_2['weak'][TANH]:.2g} and "
        f"{costs['weak'][label].value / costs['weak'][TANH].value:.2g}"
        for label in (EXACT, POLY, RATPOLY)
    )
    return tests, (
        f"Right-hand sides of one method, with restarts over without: {'; '.join(parts)}. What "
        f"ode45's own overhead is the text does not say; over tanh, in its seconds and in work: "
        f"{exact}; without any event {listed(others)} (weak)."
    )


@claim(58, "Table 2", "The exact law is slow because the solver restarts at every contact.",
    "'Because it uses the event detection capability, which requires the simulation to stop and "
    "restart at every instance of contact': one method with and without restarts, in right-hand "
    "sides; a tenth at least in both cases.")  # fmt: skip
def restarts_cost(run: Run) -> Found:
    return _restarts(run, ALIKE)


# --- Section 4.2: limits --------------------------------------------------------------------------


@claim(59, "Sect. 4.2", "At hard contact 20 to 45 coefficients are still poor.",
    "'A high contact stiffness may be represented by upwards of 20-45 coefficients and still have "
    "a poor accuracy': a force in the gap above a tenth of the forcing.")  # fmt: skip
def still_poor(run: Run) -> Found:
    force = HARD * _ladder(run, "poly_in_gap_force", gap=SYMMETRIC, constraint="none")
    ratio = force / float(run["static"]["forcing"])
    tests = [
        Test(f"degree {n}: in-gap force over the forcing", _plain(ratio.sel(degree=n)), ">", TENTH)
        for n in (21, 33, 45)
    ]
    return tests, f"Degree 45 still exerts {tests[-1].number} times the forcing inside the gap."


@claim(60, "Sect. 4.2", "With a small gap a polynomial of low degree acts like a linear spring.",
    "'A small freeplay gap tends to produce a polynomial that behaves linearly over the entire "
    "displacement range without enough coefficients': the frequency of small motions in the gap is "
    "off 5 Hz by a tenth or more, and by more than at the large gap.")  # fmt: skip
def acts_linear(run: Run) -> Found:
    name = "in_gap_frequency_error"
    small, large = (_force(run, name, POLY, scene) for scene in (SOFT_SYMMETRIC, SOFT_LARGE))
    tests = [
        Test("small gap: error of the in-gap frequency", small, ">", TENTH),
        Test("the same, small minus large gap", small - large, ">", 0.0),
    ]
    return tests, (
        f"Inside the small gap Poly-13 is {small.value:.0%} too fast, inside the large one "
        f"{large.value:.0%}."
    )


@claim(61, "Sect. 4.2", "Several roots inside the gap trap the response.",
    "'If the freeplay representation has multiple roots within the freeplay gap ... the system "
    "response can become trapped at a higher amplitude' (Figs 2c and 9): Poly-21 at hard contact "
    "has several static wells, and most responses from rest are small, off centre.")  # fmt: skip
def roots_trap(run: Run) -> Found:
    return _trapped(run, POLY_21)


@claim(62, "Sect. 4.2",
    "The tangent laws serve soft and hard contact, large, small and asymmetric gaps alike.",
    "'Without problem since the accuracy depends only on the convergence parameter', so at 1e4 and "
    "at 1e6: one static well in every scene, an RMSE below 0.5 N at soft contact for both small "
    "gaps, half of the exact attractors in the soft scenes that were swept, and the exact class "
    "and amplitude at half of the frequencies at hard contact.")  # fmt: skip
def without_problem(run: Run) -> Found:
    tests = []
    for label in (*WEAK[2:], *STRONG[2:]):
        wells = max(
            _force(run, "n_wells", label, (K_c, gap)).value
            for K_c in (VERY_SOFT, SOFT, HARD)
            for gap in (SYMMETRIC, ASYMMETRIC, LARGE)
        )
        rmse = max(_force(run, "rmse", label, (SOFT, g)).value for g in (SYMMETRIC, ASYMMETRIC))
        tests += [
            Test(f"{label}: static wells, worst of all scenes", _plain(wells), "<=", 1.0),
            Test(f"{label}: larger RMSE of the two small gaps [N]", _plain(rmse), "<", 0.5),
        ]
        at_hard = right(run, label, HARD_SYMMETRIC)
        tests.append(Test(f"{label}: right at {_where(HARD_SYMMETRIC)}", at_hard, ">=", HALF))
        tests += [
            Test(
                f"{label}: attractors found at {_where(scene)}, mean",
                recall(run, label, scene),
                ">=",
                HALF,
            )
            for scene in (SOFT_SCENES if label in WEAK else (SOFT_ASYMMETRIC,))
        ]
    off = [test.says for test in tests if test.holds is False]
    grades = (f"at {g} {'; '.join(o for o in off if g in o) or 'nothing'}" for g in ("1e4", "1e6"))
    return tests, f"What fails, {'; '.join(grades)}."


@claim(63, "Sect. 4.2",
    "At equal parameter tanh is better than arctan, arctan than log-arctan, in the dynamics too.",
    "'For a given value of convergence parameter ε or γ, the hyperbolic tangent model overall "
    "seemed to be the most accurate, with the arctangent model second and the logarithm-arctangent "
    "model third': order of the F1 of the attractor sets.")  # fmt: skip
def tangents_in_dynamics(run: Run) -> Found:
    tests, words = [], []
    for (tanh, arctan, log), scene in (
        (WEAK[2:], SOFT_SYMMETRIC), (WEAK[2:], SOFT_ASYMMETRIC), (STRONG[2:], SOFT_ASYMMETRIC)
    ):  # fmt: skip
        tests += _better(run, (tanh,), (arctan,), scene) + _better(run, (arctan,), (log,), scene)
        words.append(f"{_where(scene)}: {_f1s(run, (tanh, arctan, log), scene)}")
    return tests, f"F1, {'; '.join(words)}."


@claim(64, "Sect. 4.2", "The rational polynomial is the hardest to set up.",
    "'The most difficult to formulate and implement'; the other fits have one solution each. Hard: "
    "from starts as cftool makes them, a quarter end with a pole and a quarter miss the best fit, "
    "in one unit of x or the other.")  # fmt: skip
def hardest(run: Run) -> Found:
    return _starts(run, THREE_QUARTERS, 0.25)


# --- Figs 10 and 11: the limit of tanh ------------------------------------------------------------


def _pictures(run: Run) -> dict[str, Number]:
    """Which pairs of laws draw the same diagram, in the paper's tolerances."""
    names = {"tanh-1e6": TANH_6, "tanh-1e9": "tanh-1e9", "no events": NO_EVENTS, "events": EXACT}
    pairs = [(one, other) for other in ("no events", "events") for one in ("tanh-1e6", "tanh-1e9")]
    return {
        f"{one} and {other}": same_picture(
            run, f"{names[one]}@paper", f"{names[other]}@paper", HARD_ASYMMETRIC
        )
        for one, other in (*pairs, ("no events", "events"))
    }


def _picture_words(pictures: dict[str, Number]) -> str:
    words = listed(f"{says} {number.value:.0%}" for says, number in pictures.items())
    return f"Frequencies with the same peak and trough: {words}."


@claim(65, "Fig. 10, their solver",
    "Tanh (1e6, 1e9) equals the exact law without events; the gain is minimal.",
    "'Both hyperbolic tangent responses show excellent agreement with the piecewise "
    "no-event-detection response. Any improvement gained ... is minimal': in the paper's "
    "tolerances from rest, the same peak and trough at three quarters of the frequencies; a "
    "twentieth more at most.")  # fmt: skip
def tanh_is_no_events(run: Run) -> Found:
    pictures = _pictures(run)
    six, nine = pictures["tanh-1e6 and no events"], pictures["tanh-1e9 and no events"]
    tests = [
        Test("tanh-1e6 and no events: same peak and trough", six, ">=", THREE_QUARTERS),
        Test("tanh-1e9 and no events: same peak and trough", nine, ">=", THREE_QUARTERS),
        Test("gain from 1e6 to 1e9", nine - six, "<=", TWENTIETH),
    ]
    nearer = Test("", nine - pictures["no events and events"], ">", 0.0).holds
    words = "nearer" if nearer else "no nearer"
    return tests, (
        f"{_picture_words(pictures)} Tanh at 1e9 is {words} to the law without events than that is "
        "to the one with them."
    )


@claim(66, "Fig. 10, their solver",
    "The difference between events and none does not shrink with the parameter.",
    "'There are discrepancies between the result without and with event detection that do not "
    "resolve by increasing the convergence parameter': in the paper's tolerances from rest tanh at "
    "1e9 shows the picture with events no more often than at 1e6, by a twentieth.")  # fmt: skip
def does_not_resolve(run: Run) -> Found:
    pictures = _pictures(run)
    six, nine = pictures["tanh-1e6 and events"], pictures["tanh-1e9 and events"]
    tests = [
        Test("same picture as with events, 1e9 minus 1e6", nine - six, "<=", TWENTIETH),
        Test("tanh-1e9 and events: same picture", nine, "<", 1.0 - TWENTIETH),
    ]
    return tests, _picture_words(pictures)


@claim(67, "Fig. 10, their solver",
    "Narrow periodic bands agree between events and none, chaos less so.",
    "'The narrow bands of periodic responses agree well in all cases, but the regions of chaos and "
    "other nonlinear behavior show less agreement': what is plotted, the same peak and trough from "
    "rest in the paper's tolerances, at three quarters of the frequencies where the law with "
    "events is periodic, and at fewer chaotic ones, at a plot's resolution or finer.")  # fmt: skip
def bands_agree(run: Run) -> Found:
    events, none = f"{EXACT}@paper", f"{NO_EVENTS}@paper"
    found = run.points(events, *HARD_ASYMMETRIC, "response_class")["response_class"].values

    def same(kind: ResponseClass, resolution: float) -> Number:
        return same_picture(run, none, events, HARD_ASYMMETRIC, found == kind, resolution)

    kinds = (ResponseClass.CHAOTIC, ResponseClass.PERIODIC)  # other frequencies: never in pairs
    fine, coarse = ([same(kind, resolution) for kind in kinds] for resolution in (0.005, 0.02))
    tests = [
        Test("periodic: same peak and trough within 2 %", coarse[1], ">=", THREE_QUARTERS),
        Test("chaotic minus periodic, within 2 %", coarse[0] - coarse[1], "<", 0.0),
        Test("chaotic minus periodic, within 0.5 %", fine[0] - fine[1], "<", 0.0),
    ]
    return tests, (
        f"Peak and trough are the same at {coarse[1].value:.0%} of the periodic and "
        f"{coarse[0].value:.0%} of the chaotic frequencies within 2 % of the gap, at "
        f"{fine[1].value:.0%} and {fine[0].value:.0%} within 0.5 %."
    )


@claim(68, "Fig. 11ab",
    "At 11 Hz the exact law has period 1; period 3, of tanh or without events, is false.",
    "'A period-1 response with superharmonics should have been captured, but a period-3 response "
    "... is falsely detected instead.' From rest in the paper's tolerances; false: of 400 starts "
    "none of the exact law ends on a period 3.")  # fmt: skip
def false_period_3(run: Run) -> Found:
    def period(label: str) -> int:
        points = run.points(label, *HARD_ASYMMETRIC, "period_multiple", band=(11.0, 11.0))
        return int(points["period_multiple"].values[0])

    events = period(f"{EXACT}@paper")
    tests = [Test("with events, from rest: period", _plain(events), "<=", 1.0)]
    others = {label: period(f"{label}@paper") for label in (NO_EVENTS, TANH_6)}
    # P6 and P9 are a P3 with the solver's noise on it; 0 is no period at all.
    tests += [
        Test(f"{label}, from rest: period, modulo 3", _plain(n % 3 if n else 3), "<=", 0.0)
        for label, n in others.items()
    ]
    n = _periods(run, EXACT, HARD_ASYMMETRIC, (11.0,))
    tests.append(Test("exact law: starts that end on a period 3", share(n == 3), "<", 0.01))
    shares = listed(f"P{k} {np.mean(n == k):.0%}" for k in np.unique(n))
    from_rest = (f"{label} P{n}" for label, n in ((EXACT, events), *others.items()))
    paper = [f"{label}@paper" for label in (EXACT, *others)]
    later = [
        f"{law_of(label)} from {periods}"
        for (omega, label), periods in moved_on(run, paper, HARD_ASYMMETRIC).items()
        if omega == 11.0
    ]
    moved = f" By the end of Fig. 11 there went {listed(later)}." if later else ""
    return tests, (
        f"From rest in the paper's tolerances: {listed(from_rest)}.{moved} Of 400 starts the exact "
        f"law's end on {shares}."
    )


@claim(69, "Fig. 11cd", "At 21.75 Hz all show period 2, with small differences.",
    "'The overall behavior of the response is captured well, indicating a period-2 response ... "
    "However, the results still differ on a small scale': from rest period 2 with all three laws; "
    "peak and trough within a twentieth of the gap of the exact ones.")  # fmt: skip
def small_differences(run: Run) -> Found:
    at, scene, ends = (21.75, 21.75), HARD_ASYMMETRIC, ["x_max", "x_min"]
    exact = run.points(EXACT, *scene, *ends, band=at)[ends].to_dataarray().values
    tests, words = [], []
    for label in (EXACT, TANH_6, NO_EVENTS):
        points = run.points(f"{label}@paper", *scene, "period_multiple", *ends, band=at)
        n = int(points["period_multiple"][0])
        apart = float(np.max(abs(points[ends].to_dataarray().values - exact)))
        tests += [
            Test(f"{label}: off period 2 by", _plain(abs(n - 2)), "<=", 0.0),
            Test(f"{label}: peak and trough off the exact ones [m]",
                 _plain(apart), "<=", LINE * width(scene)),
        ]  # fmt: skip
        words.append(f"{label} P{n}, {1e6 * apart:.2g} µm")
    return tests, f"In the paper's tolerances, period and error of the extrema: {listed(words)}."


@claim(70, "Fig. 11", "Only finer tolerances or events remove the difference, both equally well.",
    "'The only way to remove these numerical issues ... is to either refine the tolerances ... or "
    "to implement an event detection procedure', which 'can be comparable': the peak and trough of "
    "the exact law at tight tolerances from rest at more frequencies with either than without, and "
    "within a tenth of one another.")  # fmt: skip
def finer_or_events(run: Run) -> Found:
    none, events, finer = (
        same_picture(run, label, EXACT, HARD_ASYMMETRIC)
        for label in (f"{NO_EVENTS}@paper", f"{EXACT}@paper", f"{NO_EVENTS}@finer")
    )
    tests = [
        Test("finer tolerances minus neither", finer - none, ">", 0.0),
        Test("events minus neither", events - none, ">", 0.0),
        Test("finer and events: ratio", larger_over_smaller(events, finer), "<=", ALIKE),
    ]
    return tests, (
        f"The exact peak and trough are met at {none.value:.0%} with neither, {events.value:.0%} "
        f"with events, {finer.value:.0%} with tolerances a hundred times finer."
    )


@claim(71, "Sect. 4.2", "The limit of tanh is the exact law without events.",
    "'The limit of applicability of the hyperbolic tangent model approaches that of the exact "
    "piecewise model without any event detection procedure': in the paper's tolerances from rest "
    "tanh at 1e9 draws the picture without events more often than at 1e6, and more often than the "
    "picture with events.")  # fmt: skip
def limit_of_tanh(run: Run) -> Found:
    pictures = _pictures(run)
    nine = pictures["tanh-1e9 and no events"]
    tests = [
        Test("same picture as without events, 1e9 minus 1e6",
             nine - pictures["tanh-1e6 and no events"], ">", 0.0),
        Test("tanh-1e9: without events minus with",
             nine - pictures["tanh-1e9 and events"], ">", 0.0),
    ]  # fmt: skip
    return tests, _picture_words(pictures)


# --- Section 5: conclusions -----------------------------------------------------------------------


@claim(72, "Sect. 5", "Polynomials and rational polynomials are the least accurate and dearest.",
    "'The polynomial and rational polynomial representations performed the worst at accurately "
    "capturing system behavior and had the greatest computational costs': F1 below that of every "
    "tangent law at soft asymmetric contact, where the paper says so, in both grades; Table 2: "
    "dearer than every tangent law." + _TABLE_WHY)  # fmt: skip
def worst_and_dearest(run: Run) -> Found:
    def dear(costs: Costs) -> list[Test]:
        return [
            Test(f"{grade}: {named(label)} over the dearest tangent law",
                 _plain(costs[grade][label].value / max(tangents)), ">", 1.0)
            for grade, tangents in _tangent_costs(costs).items()
            for label in GRADES[grade][:2]
        ]  # fmt: skip

    tests = _better(run, WEAK[2:], WEAK[:2], SOFT_ASYMMETRIC)
    tests += _better(run, STRONG[2:], STRONG[:2], SOFT_ASYMMETRIC)
    tests += _both(run, dear)
    words = (
        f"{named(label)} {test.number}"
        for label, test in zip((*WEAK[:2], *STRONG[:2]), tests[-4:], strict=True)
    )
    return tests, (
        f"F1: {_f1s(run, (*WEAK, *STRONG), SOFT_ASYMMETRIC)}. Right-hand sides over those of the "
        f"grade's dearest tangent law: {listed(words)}."
    )


@claim(73, "Sect. 5", "Among the continuous laws tanh is the one to take.",
    "'If this is not a concern, the hyperbolic tangent representation is recommended': in "
    "accuracy, the highest F1 in every soft scene and grade, and right most often at hard contact "
    "('both weak and strong contact nonlinearities'). Restarts: claim 58.")  # fmt: skip
def recommended(run: Run) -> Found:
    tests = []
    for (poly, ratpoly, tanh, *others), scenes in (
        (WEAK, SOFT_SCENES), (STRONG, (SOFT_ASYMMETRIC,))
    ):  # fmt: skip
        for scene in scenes:
            tests += _better(run, (tanh,), (poly, ratpoly, *others), scene)
    hard = {label: right(run, label, HARD_SYMMETRIC) for label in STRONG}
    rivals = [label for label in STRONG if label != TANH_6]
    tests += _ahead(hard, [TANH_6], rivals, "right at hard contact")
    words = [f"{_where(scene)}: {_f1s(run, WEAK, scene)}" for scene in SOFT_SCENES]
    return tests, f"F1, {'; '.join(words)}. Right at hard contact: {by_law(hard)}."


@claim(74, "Sect. 5", "Events without restarts would save significant time.",
    "'If ode45 with event location could be modified to run without restarting, significant time "
    "savings could be obtained.' One method with and without restarts, in right-hand sides; "
    "significant: a fifth. What ode45's overhead would add cannot be measured here.")  # fmt: skip
def without_restarts(run: Run) -> Found:
    return _restarts(run, 1.25)


# --- What the first list left out -----------------------------------------------------------------


@claim(75, "Fig. 5", "The tangent laws converge significantly faster than the fits.",
    "'They also converge significantly faster' (Sect. 3): from the weak to the strong grade the "
    "RMS error of every tangent law falls by twice the factor of either fit or more.")  # fmt: skip
def faster_convergence(run: Run) -> Found:
    fall = {
        weak: _force(run, "rmse", weak, SOFT_SYMMETRIC)
        / _force(run, "rmse", strong, SOFT_SYMMETRIC)
        for weak, strong in zip(WEAK, STRONG, strict=True)
    }
    tests = [
        Test(f"{named(tangent)} over {named(fit)}: factor by which the error falls",
             fall[tangent] / fall[fit], ">=", 2.0)
        for tangent in WEAK[2:]
        for fit in WEAK[:2]
    ]  # fmt: skip
    return tests, f"From the weak to the strong grade errors fall by: {by_law(fall, '.3g')}."


@claim(76, "Fig. 2c", "Even at very soft contact polynomials miss the transition at the walls.",
    "'Matches the very soft contact but still fails to capture the transition at the freeplay "
    "boundaries': the RMS error within 0.1 mm of the walls is above that elsewhere.")  # fmt: skip
def misses_transition(run: Run) -> Found:
    def ratio(label: str) -> Number:
        error = run.scene("static", label, *VERY_SOFT_SYMMETRIC, "force_error")["force_error"]
        x = error["x"].values
        near = np.abs(np.abs(x) - 0.4e-3) <= 0.1e-3
        return _plain(_rms(x, error.values, near) / _rms(x, error.values, ~near))

    says = "RMS error near the walls over that elsewhere"
    tests = each((POLY, POLY_21), says, ratio, ">", 1.0)
    return tests, f"The error near the walls over that elsewhere: {shown(tests, '.2g')}."


def _rms(x: Any, values: Any, where: Any) -> float:
    """Root of the mean square over part of a grid that is not uniform."""
    weights = np.gradient(x)[where]
    return float(np.sqrt(np.sum(weights * values[where] ** 2) / np.sum(weights)))


@claim(77, "Sect. 4.2",
    "At hard contact higher degrees do little for the rational fit and end badly conditioned.",
    "'Increasing the degrees does little to improve the representation accuracy and eventually "
    "leads to \"badly conditioned\" errors which can make the rational polynomial representation "
    "unusable': from 5/3 to 5/5 the error falls by less than half; a quarter of the random starts "
    "for 5/5 end unusable, with a pole, in one unit of x or the other.")  # fmt: skip
def degrees_do_little(run: Run) -> Found:
    errors = _ladder(run, "ratpoly_rmse", gap=SYMMETRIC)
    left = _plain(errors.sel(ratio="5/5") / errors.sel(ratio="5/3"))
    found = run.select("cftool", gap=SYMMETRIC, ratio="5/5")["pole_share"].max()
    poles = _plain(found)
    tests = [
        Test("RMS error, 5/5 over 5/3", left, ">", HALF),
        Test("5/5: random starts that end with a pole", poles, ">=", 0.25),
    ]
    return tests, (
        f"5/5 leaves {left} of the error of 5/3; {poles.value:.0%} of its starts have a pole, in "
        "the worse unit of x."
    )


@claim(78, "Sect. 3", "A large convergence parameter costs the law its smoothness.",
    "'In some situations the convergence parameter should not be too large because then the "
    "smoothness of the representation will be lost': the solver sees it, with more right-hand "
    "sides per forcing period at 1e6 than at 1e4 (soft, 0/0.8 mm), by a tenth.")  # fmt: skip
def smoothness(run: Run) -> Found:
    tests = [
        Test(f"{named(strong)}: work at 1e6 over 1e4", work(run, strong, weak, SOFT_ASYMMETRIC),
             ">", ALIKE)
        for weak, strong in zip(WEAK[2:], STRONG[2:], strict=True)
    ]  # fmt: skip
    return tests, f"At 1e6 they need this many times the right-hand sides: {shown(tests, '.2g')}."


@claim(79, "Fig. 8b", "All laws but Poly-13 capture ringing, chaos and superharmonics.",
    "The other half of claim 37: behaviours 'that all the other models are generally able to "
    "capture': from rest below 7 Hz on the exact attractor at half the frequencies.")  # fmt: skip
def others_capture(run: Run) -> Found:
    return _rights(run, WEAK[1:], SOFT_SYMMETRIC, ">=", HALF, (0.1, 7.0))


@claim(80, "Fig. 9", "Tanh and arctan agree best among all laws at hard contact.",
    "'The Tanh and Arctan models show the best agreement among all the models': class and "
    "amplitude from rest right more often than with each of the others.")  # fmt: skip
def best_at_hard(run: Run) -> Found:
    rights = {label: right(run, label, HARD_SYMMETRIC) for label in STRONG}
    tests = _ahead(rights, STRONG[2:4], (POLY_21, RATPOLY_5, LOGARCTAN_6), "right frequencies")
    return tests, f"Class and amplitude are right at: {by_law(rights)} of the frequencies."


@claim(81, "Sect. 5", "The accuracy of all laws is limited when contact is strong.",
    "'The accuracy of all representations is still limited when strong contact behavior is "
    "present': no law of the strong grade is right at 95 % of them at hard contact.")  # fmt: skip
def limited(run: Run) -> Found:
    return _rights(run, STRONG, HARD_SYMMETRIC, "<", 1.0 - TWENTIETH)


@claim(82, "Fig. 11",
    "Spectra show periods 1 and 3 at 11 Hz, one subharmonic, many superharmonics at 21.75 Hz.",
    "'A period-1 response with superharmonics should have been captured, but a period-3 response "
    "with both subharmonics and superharmonics'; at 21.75 Hz 'a period-2 response with one "
    "subharmonic and many superharmonics'. A line: 1 % of the largest; many: three.")  # fmt: skip
def spectra(run: Run) -> Found:
    def line(label: str, omega: float, multiple: float) -> float:
        names = ("omega", "frequency", "spectrum")
        found = run.select("histories", *names, representation=label)
        here = np.flatnonzero(np.isclose(found["omega"].values, omega))
        if not here.size:
            raise NotInRunError(f"no history of {label} at {omega:g} Hz")
        bins, spectrum = (found[name].isel(history=here[0]).values for name in names[1:])
        near = np.abs(bins - multiple * omega) <= 0.02 * omega
        return float(np.nanmax(spectrum[near]) / np.nanmax(spectrum[bins > 0.1 * omega]))

    events, none = f"{EXACT}@paper", f"{NO_EVENTS}@paper"
    many = sum(line(events, 21.75, k) >= 0.01 for k in (2, 3, 4, 5, 6))
    tests = [
        Test(says, _plain(line(label, omega, multiple)), op, 0.01)
        for says, label, omega, multiple, op in (
            ("11 Hz, no events: line at a third", none, 11.0, 1 / 3, ">="),
            ("11 Hz, events: line at a third", events, 11.0, 1 / 3, "<"),
            ("11 Hz, events: line at a half", events, 11.0, 1 / 2, "<"),
            ("21.75 Hz, events: line at a half", events, 21.75, 1 / 2, ">="),
        )
    ]
    says = "21.75 Hz, events: superharmonic lines"
    tests.append(Test(says, _plain(many), ">=", 3.0))
    missing, third, half = (test.number for test in tests[:3])
    return tests, (
        f"At 11 Hz the spectrum has {missing} of its largest line at a third of the forcing "
        f"frequency without events, {third} with them, and {half} at a half with them; at 21.75 "
        f"Hz there are {many} of the first five superharmonics."
    )
