"""The paper's claims: its words, and what must hold for them.

`measures` defines what words and quantities are, `language` how quantities are compared, and when a
claim is decided once more: from rest, with the contact force by mode, other shares, gaps or units.
Claims on Figs 8 to 11 are decided from x_0 = +0.4 mm, which most of the paper's figures agree with:
evidence, not proof (docs/explanation/claims.md). 75 and on are statements that the first list left
out.
"""
# fmt: off
# isort: off

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.claims import NotInRunError, Number, share
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

from .cftool import cftool
from .ladders import ladders
from .language import At, Comparison, Quantity, alike, claim
from .measures import (
    ABOUT, ALIKE, AS_DRAWN, COMPARABLE, HALF, KINDS, LINE, MUCH, REGION, SAME_SIZE, SLIGHTLY,
    TENTH, THREE_QUARTERS, TWENTIETH, Band, Figure, Table, constants, cost, distance, named,
    of_dataset, slope, starting, steepest,
)
from .refined import bands, basins, cloud, motions, runs, starts, windows
from .scenes import (
    ASYMMETRIC, EXACT, HARD, HARD_ASYMMETRIC, LARGE, NO_EVENTS, SOFT,
    SOFT_ASYMMETRIC, SOFT_SYMMETRIC, STARTS, STRONG, SYMMETRIC, TABLE_2, TABLE_CASES, TANGENTS,
    VERY_SOFT, WEAK,
)

DATASETS = {"ladders": ladders, "cftool": cftool, "bands": bands, "windows": windows,
            "basins": basins, "cloud": cloud, "motions": motions, "starts": starts}

POLY, RATPOLY, TANH, ARCTAN, LOGARCTAN = WEAK
POLY_21, RATPOLY_5, TANH_6, ARCTAN_6, LOGARCTAN_6 = STRONG
BOTH_GAPS, PAPER = (SYMMETRIC, ASYMMETRIC), "@paper"
OTHER_FIT = "Random initial values with x in m lead to another fit, with other outcomes. "
COEFFICIENTS = "Not in the text: the coefficients of the paper's fit, which decide"
OPTIMUM = "For the least-squares optimum; the paper does not state its coefficients. "
CFTOOL = "From 20 random initial values, as cftool draws them. "

fig2 = Figure("Fig. 2", SOFT, SYMMETRIC)
fig2c, fig2c_hard = Figure("Fig. 2c", VERY_SOFT, SYMMETRIC), Figure("Fig. 2c", HARD, SYMMETRIC)
fig6a = Figure("Fig. 6a", SOFT, "", "scattered")
fig6b = Figure("Fig. 6b", SOFT, SYMMETRIC, "scattered")
fig6c = Figure("Fig. 6c", SOFT, ASYMMETRIC, "scattered")
fig7 = Figure("Fig. 7", SOFT, ASYMMETRIC, "scattered")
fig8a = Figure("Fig. 8a", VERY_SOFT, SYMMETRIC)
fig8b = Figure("Fig. 8b", SOFT, SYMMETRIC)
fig8c, fig9 = Figure("Fig. 8c", HARD, SYMMETRIC), Figure("Fig. 9", HARD, SYMMETRIC)
fig10, fig11 = Figure("Fig. 10", HARD, ASYMMETRIC), Figure("Fig. 11", HARD, ASYMMETRIC)
asymmetric = Figure("Fig. 6c", SOFT, ASYMMETRIC)


# --- Sections 1 to 3: the laws themselves ---------------------------------------------------------

def ladder(what: str, name: str, reduced: Callable[[xr.DataArray], Any] = float,
           **where: Any) -> Quantity:
    """Of the errors per unit stiffness against degrees and parameters; symmetric gap."""
    return of_dataset("ladders", what, name, reduced, **{"gap": SYMMETRIC, **where})


def tangents(**where: Any) -> Quantity:
    says = "RMS error per unit stiffness [m]"
    return ladder(says, "smooth_rmse", **{"family": TANGENTS, **where})


def in_gap(**where: Any) -> Quantity:
    return ladder("largest force in the gap per unit stiffness [m]", "poly_in_gap_force", **where)


def outside(**where: Any) -> Quantity:
    return ladder("largest error outside per unit stiffness [m]", "poly_outside_error", **where)


def rational(*ratios: str) -> Quantity:
    return ladder("RMS error per unit stiffness [m]", "ratpoly_rmse", ratio=ratios)


FREE, HELD = {"constraint": "none"}, {"constraint": "no constant or linear term"}

c1 = claim(1, "Eqs 4-6",
    "'Eqs. (4-6) approach one another as their convergence parameters are increased.'",
    tangents(gap=BOTH_GAPS, parameter=1e9) / tangents(gap=BOTH_GAPS, parameter=1e4) <= 1e-3,
    ladder("RMS error from one parameter to the next, largest ratio", "smooth_rmse",
           lambda e: steepest(e.sel(parameter=slice(1e3, 1e9))), gap=BOTH_GAPS, family=TANGENTS)
    < 1.0)


def extrema_of(n: int, figure: Figure) -> Quantity:
    """Share of the period-n responses with 2n extrema."""
    def counted(points: xr.Dataset) -> Number:
        here = points.isel(point=points["period_multiple"].values == n)
        return share(here["n_extrema"] == 2 * n)

    names = ("period_multiple", "n_extrema")
    return figure.of_points(f"P{n} responses with {2 * n} extrema", names, counted, ".0%")[EXACT]


c2 = claim(2, "Sect. 2",
    "'A period-n response ... will generally manifest as 2n discrete points.'",
    extrema_of(1, fig8b) > HALF, extrema_of(3, fig6b) > HALF,
    note="Generally is in most cases. Many a period-3 motion swings once in three forcing periods, "
         "and has two extrema.")

NONE, EVENTS, FINER = NO_EVENTS + PAPER, EXACT + PAPER, f"{NO_EVENTS}@finer"
SIX, NINE, TRUTH = TANH_6 + PAPER, "tanh-1e9@paper", "truth"
AFTER_4 = "Reference: the exact law with rtol 1e-12. Motions 1 nm apart stay within 2 nm. "
c3 = claim(3, "Sect. 1",
    "'Time integration methods suffer from accumulating roundoff error if the precise times and "
    "locations of contacts are not captured.'",
    distance(NONE, TRUTH) > distance(EVENTS, TRUTH),
    distance(FINER, TRUTH) / distance(NONE, TRUTH) >= HALF,
    note=AFTER_4 + "With finer tolerances and more steps roundoff would not fall.")


def standing_out(figure: Figure) -> Quantity:
    """Share of the chaotic responses with more distinct extrema than nearly all periodic ones."""
    def told(points: xr.Dataset) -> Number:
        extrema = points["extrema"].transpose("point", "extremum").values
        rows = np.round(extrema * 200.0 / (np.nanmax(extrema) - np.nanmin(extrema)))
        distinct = np.array([np.unique(row[np.isfinite(row)]).size for row in rows])
        kind = points["response_class"].values
        periodic = distinct[kind == ResponseClass.PERIODIC]
        if not periodic.size:
            raise NotInRunError(f"no periodic response at {figure.place}")
        most = np.quantile(periodic, 0.95, method="higher")
        return share(distinct[kind == ResponseClass.CHAOTIC] > most)

    says = "chaotic responses with more distinct extrema than 95 % of the periodic ones"
    return figure.of_points(says, ("extrema", "response_class"), told, ".0%")[EXACT]


c4 = claim(4, "Sect. 2",
    "'A bifurcation diagram constructed as described above can distinguish aperiodic from "
    "periodic.'",
    *(standing_out(Figure(figure.place, figure.K_c, figure.gap, "any")) >= 0.95
      for figure in (asymmetric, fig8c)),
    note="Extrema are distinct that are a 200th of the diagram's height apart.")
c5 = claim(5, "Fig. 2a",
    "'Within the gap itself, the freeplay force is over- or underestimated from zero, but this "
    "error decreases with higher degree.'",
    in_gap(degree=(21,), **FREE) < in_gap(degree=(13,), **FREE),
    ladder("slope of the force over the degree", "poly_in_gap_force", slope, **FREE) < 0.0)
c6 = claim(6, fig2,
    "'The polynomials match the piecewise behavior away from the freeplay gap better.'",
    fig2.static("RMS error in the gap [N]", "rmse_in_gap")[POLY, POLY_21]
    > fig2.static("RMS error outside [N]", "rmse_outside")[POLY, POLY_21])
c7 = claim(7, "Fig. 2b",
    "'The polynomial function better captures the behavior in the freeplay gap but now oscillates "
    "outside' (without constant and linear terms).",
    in_gap(degree=(13, 21), **HELD) / in_gap(degree=(13, 21), **FREE) < 1.0,
    outside(degree=(13, 21), **HELD) / outside(degree=(13, 21), **FREE) > 1.0)
leak = ("largest force in the gap [N]", "in_gap_force")
c8 = claim(8, "Fig. 2c",
    "'The polynomial representation matches the very soft contact ... For hard contact, the match "
    "is poor even with 21 coefficients.'",
    fig2c.static(*leak)[POLY_21] < 0.4, fig2c_hard.static(*leak)[POLY_21] > 0.4,
    note="Very soft, then hard, in newtons: a tenth of the forcing is 0.4 N.")
def condition(*units: str) -> Quantity:
    return of_dataset("ladders", "condition number at degree 21, by the unit of x",
                      "poly_condition", degree=21, unit=units)


c9 = claim(9, "Fig. 2",
    "'The polynomial representation converges slowly yet also suffers from being \"badly "
    "conditioned\" at higher degrees.'",
    ladder("slope of the RMS error over the degree", "poly_rmse", slope, **FREE) > -2.0,
    condition("m", "mm") > 1e10, context=[condition("4 mm")],
    note="MATLAB's polyfit warns of bad conditioning above 1e10: its x was in m or in mm.")


def needed(*K_c: float) -> Quantity:
    """The least degree that is enough, infinite above 45."""
    return ladder("least degree with a tenth of the forcing in the gap", "poly_smallest_degree",
                  lambda n: float(n) or math.inf, K_c=K_c)


c10 = claim(10, "Fig. 2",
    "'More coefficients are required for harder contact stiffness beyond what was investigated.'",
    needed(SOFT, HARD) > needed(VERY_SOFT))
top = ("largest displacement [m]", ("x_max",), lambda points: float(points["x_max"].max()))
c11 = claim(11, fig8b,
    "'Regression is performed over the displacement range x in [-4, 4] mm as this encompassed the "
    "largest displacements present for the parameters in Table 1.'",
    fig8b.of_points(*top)[EXACT] <= 4e-3,
    context=[Figure("Upward sweep", SOFT, SYMMETRIC, "sweep_up").of_points(*top)[EXACT]])


def random_fit(what: str, name: str, *ratios: str, gap: str = SYMMETRIC, form: str = ".0%",
               reduced: Callable[[xr.DataArray], Any] = float) -> Quantity:
    """What random initial values end on, with x in the unit of the settings."""
    return of_dataset("cftool", what, name, reduced, form, gap=gap, ratio=ratios, unit=None)


def at_zero(ratio: str, gap: str = SYMMETRIC) -> Quantity:
    says = "size of the force at 0 per unit stiffness, best random fit [m]"
    return random_fit(says, "force_at_zero", ratio, gap=gap, form=".2g",
                      reduced=lambda force: abs(float(force)))


poles = random_fit("random fits with a pole", "pole_share", "5/3", "5/5")
best_found = random_fit("random fits that are the best", "best_share", "5/3", "5/5")
c12 = claim(12, "Fig. 3a",
    "'The 3/2 curve is not rotationally symmetric about the origin and shows a negative force "
    "within most of the freeplay gap, unlike the 5/3 curve.'",
    unstated=COEFFICIENTS, context=[at_zero("3/2"), at_zero("5/3")],
    note=CFTOOL + "The best of 20 random fits of 3/2 is odd in every unit of x tried.")
leaking = ("largest force in the gap per unit stiffness [m]", "ratpoly_in_gap_force")
c13 = claim(13, "Fig. 3a", "'The 5/3 curve also fits more closely within the freeplay gap.'",
    ladder(*leaking, ratio=("5/3",)) < ladder(*leaking, ratio=("3/2",)))
c14 = claim(14, "Fig. 3b",
    "'There is little advantage if any ... they are all very similar' (3/5 to 5/5).",
    alike(rational("3/5", "5/2", "5/3"), rational("5/5"), ALIKE))
c15 = claim(15, "Fig. 3c",
    "'Generally, up to a limit, harder contact stiffnesses are captured better with higher-degree "
    "numerator and denominator.'",
    rational("5/5", "7/5") / rational("3/2") <= 1.0 - TENTH)
c16 = claim(16, "Fig. 3",
    "'The calculated curve fit can change every time ... \"random start points\"', and roots of "
    "the denominator are 'a danger to consider'.",
    best_found < 1.0 - TENTH, poles > TENTH, note=CFTOOL)
c17 = claim(17, "Sect. 4.2",
    "'The accuracy is good for soft contact stiffnesses as long as the degrees are \"large "
    "enough\" and the numerator degree is greater ..., but these are not necessary conditions.'",
    rational("5/3", "7/3", "7/5", "3/5") < 0.5 / SOFT,
    note="Good is the paper's own rule, an RMSE below 0.5 N; 3/5 has the higher denominator.")
rmse = fig2.static("RMSE [N]", "rmse")
c18 = claim(18, fig2,
    "'This ensures each model has RMSE<0.5 and R² > 0.998 for the symmetric-soft system.'",
    rmse[WEAK] < 0.5, fig2.static("R²", "r_squared", ".5f")[WEAK] > 0.998)
c19 = claim(19, "Fig. 5c",
    "'The tangent-based models all converge quickly with hyperbolic tangent being the fastest and "
    "logarithm-arctangent the slowest.'",
    *(tangents(family=(one,), parameter=at) / tangents(family=(other,), parameter=at) < 1.0
      for at in ((1e4,), (1e6,)) for one, other in (("tanh", "arctan"), ("arctan", "logarctan"))))


def largest_rise(rungs: xr.DataArray) -> float:
    """Largest factor of the error from one number of coefficients to the next."""
    sizes = np.array([sum(int(n) for n in str(r).split("/")) for r in rungs["ratio"].values])
    by_size = [rungs.values[sizes == size] for size in sorted(set(sizes.tolist()))]
    return float(max(b.max() / a.min() for a, b in pairwise(by_size)))


c20 = claim(20, "Fig. 5b", "'The convergence for rational polynomial is not straightforward.'",
    ladder("largest factor with more coefficients", "ratpoly_rmse", largest_rise) > 1.001,
    rational("5/3") / rational("5/2") > 0.999, note="A fit is known to 0.1 %.")
wells = ("static wells", "n_wells", ".0f")
c21 = claim(21, "Sect. 4.2",
    "'Since the accuracy depends only on the convergence parameter' (tangent laws).",
    *(alike(tangents(family=(family,), gap=(SYMMETRIC,), parameter=1e4),
            tangents(family=(family,), gap=(ASYMMETRIC,), parameter=1e4), ALIKE)
      for family in TANGENTS),
    fig8c.static(*wells)[TANH] <= fig8b.static(*wells)[TANH],
    note="At 1e4 /m equal errors for both small gaps; no more wells at hard contact than at soft.")

# --- Figs 6 and 7: frequency responses ------------------------------------------------------------

c22 = claim(22, fig6a,
    "'The only nonlinear behavior that is expected here is superharmonic resonance near 2 Hz, and "
    "every representation except the rational polynomial (RatPoly 5/3) agrees well.'",
    fig6a.share("period not 1", (3.0, 30.0))[EXACT] <= TWENTIETH,
    fig6a.share("ringing", (1.5, 2.5))[EXACT] >= TENTH,
    fig6a.error()[POLY, TANH, ARCTAN, LOGARCTAN] <= LINE, fig6a.error()[RATPOLY] > LINE,
    note="The gap is not in the text we have; the sentence can be true from 1.1 to 1.8 mm.")
rings = fig6a.share("ringing", (1.0, 4.0))
c23 = claim(23, fig6a,
    "'The RatPoly 5/3 predicts a larger region of superharmonic resonance and a region of "
    "subharmonic resonance near 11-12 Hz.'",
    rings[RATPOLY] / rings[EXACT] > ALIKE,
    fig6a.count("period above 1", (11.0, 12.0))[RATPOLY] >= 1.0, note=OPTIMUM)
c24 = claim(24, fig6a,
    "'For ω > 22 Hz the peak amplitude is predicted to be negative' (RatPoly 5/3).",
    unstated=COEFFICIENTS, note="The least-squares optimum of a symmetric gap is odd.",
    context=[fig6a.share("peak below 0", (22.0, 30.0))[RATPOLY], at_zero("5/3", LARGE)])


def ringing(figure: Figure, least: float) -> Comparison:
    """Laws show so much of the exact law's ringing below 5 Hz."""
    names, ring = KINDS["ringing"]
    found = figure.of_points("frequencies that ring", names, lambda p: float(ring(p).sum()), ".0f",
                             (0.1, 5.0))
    return found[WEAK] / found[EXACT] >= least


c25 = claim(25, fig8b,
    "'All the representations are able to capture the region of superharmonic resonance to "
    "varying degrees' (Fig. 6b).",
    ringing(fig8b, TENTH), context=[fig8b.error((0.1, 5.0), HALF)[WEAK]])


def periods(at: At, label: str, scene: tuple[float, str], omega: Sequence[float]) -> Any:
    """Periods that 400 starts end on, at some frequencies."""
    cases = at.run["basins"].load()
    here = cases["omega"].isin(list(omega))
    for name, value in zip(("representation", "K_c", "gap"), (label, *scene), strict=True):
        here = here & (cases[name] == value)
    return np.ravel(cases["period_multiple"].values[here.values])


on_3 = fig6b.share_of_frequencies("period 3", (17.0, 21.0))
starts_on_3 = fig6b.table("share of 400 initial conditions with period 3", lambda at, label: share(
    periods(at, label, SOFT_SYMMETRIC, (17.0, 19.0, 21.0)) == 3), ".1%")
c26 = claim(26, fig6b,
    "'The RatPoly 5/3, Tanh, and Arctan models appearing to capture the entire range of "
    "subharmonic resonance'; Poly-13 and log-arctan 'do not capture any ... near 17-21 Hz'.",
    on_3[EXACT] >= HALF, on_3[RATPOLY, TANH, ARCTAN] / on_3[EXACT] >= 1.0 - TENTH,
    starts_on_3[EXACT, RATPOLY, TANH, ARCTAN] >= TWENTIETH, starts_on_3[POLY, LOGARCTAN] < 0.01)


def several_branches(at: At, label: str) -> Number:
    """Share of the frequencies with several attractors of a period above 1."""
    found = at.run.scene("attractors", label, *SOFT_SYMMETRIC, "period_multiple")
    status = at.run.scene("responses", label, *SOFT_SYMMETRIC, "status")["status"]
    status = status.isel(initial_condition=starting(at.run, "scattered"))
    asked = (status.values != Status.NOT_REQUESTED).any(status.get_axis_num("initial_condition"))
    several = (found["period_multiple"] > 1).sum("attractor") > 1
    return share(several[asked & (several["omega"].values >= 12.0)])


branches = fig6b.table("frequencies with several branches, 12-30 Hz", several_branches, ".0%")
c27 = claim(27, fig6b,
    "'The RatPoly 5/3 model predicts more subharmonic-resonance branches than the single one "
    "predicted by the exact piecewise model.'",
    branches[RATPOLY] > branches[EXACT], note=OPTIMUM + "Mirror twins are two branches.")
peak, jump_error = fig8b.bisected("frequency of the jump", peak=1.0), fig8b.error((8.0, 14.0), HALF)
c28 = claim(28, fig8b,
    "'The RatPoly 5/3, Tanh, and Arctan also have the best agreement to the primary resonance "
    "peak and to the jump to lower amplitude' (Fig. 6b).",
    fig8b.shift(peak)[RATPOLY, TANH, ARCTAN] < fig8b.shift(peak)[POLY, LOGARCTAN],
    jump_error[RATPOLY, TANH, ARCTAN] < jump_error[POLY, LOGARCTAN], context=[peak[EXACT, *WEAK]])
c29 = claim(29, fig6c,
    "'The Poly-13 model shows excellent agreement up until the jump phenomenon, and afterwards "
    "captures none' (12 Hz).",
    fig6c.error((0.2, 12.0))[POLY] <= LINE, fig6c.recall((12.2, 30.0))[POLY] <= TENTH)
c30 = claim(30, fig6c,
    "'The RatPoly 5/3 operates similarly, except it does capture one section of periodic response "
    "between 15-18 Hz and section of subharmonic resonance between 21-22 Hz.'",
    fig6c.error((0.2, 12.0))[RATPOLY] <= LINE,
    *(fig6c.recall(band)[RATPOLY] >= HALF for band in ((15.0, 18.0), (21.0, 22.0))),
    *(fig6c.recall(band)[RATPOLY] <= TENTH for band in ((12.2, 14.8), (18.2, 20.8), (22.2, 30.0))),
    unstated=COEFFICIENTS, note=OTHER_FIT)
thirds = [fig6c.error(band) for band in ((0.2, 11.8), (12.0, 19.8), (20.0, 30.0))]
c31 = claim(31, fig6c,
    "'The Tanh and Arctan models have the best agreement to the piecewise results but still lose "
    "accuracy as forcing frequency increases.'",
    fig6c.f1()[TANH, ARCTAN] > fig6c.f1()[POLY, RATPOLY, LOGARCTAN],
    *(high[TANH, ARCTAN] / low[TANH, ARCTAN] > ALIKE
      for low, high in pairwise(thirds)))
low_error, high = fig6c.error((0.2, 5.0), HALF), (22.0, 30.0)


def attractors_above_1(at: At, label: str) -> Number:
    found = at.run.scene("attractors", label, *SOFT_ASYMMETRIC, "period_multiple")
    return Number(float((found["period_multiple"].sel(omega=slice(16.0, 30.0)) > 1).sum()))


subharmonic = fig6c.table("subharmonic attractors, 16-30 Hz", attractors_above_1, ".0f")
median = ("median amplitude", ("amplitude",), lambda points: float(points["amplitude"].median()))
height = fig6c.of_points(*median, band=high)
c32 = claim(32, fig6c,
    "'The Log-Arctan model has the weakest accuracy in the superharmonic-resonance region and "
    "also has poor accuracy in the chaotic region within 13-15 Hz. It also fails to capture one "
    "branch of subharmonic resonance and underestimates the low-amplitude responses at higher "
    "frequencies.'",
    low_error[LOGARCTAN] > low_error[POLY, RATPOLY, TANH, ARCTAN],
    fig6c.recall((13.0, 15.0))[LOGARCTAN] < HALF,
    subharmonic[LOGARCTAN] / subharmonic[EXACT] <= THREE_QUARTERS,
    height[LOGARCTAN] / height[EXACT] < 1.0 - LINE)
c33 = claim(33, asymmetric, "'The chaotic region within 13-15 Hz.'",
    asymmetric.share("chaos", (13.0, 15.0))[EXACT] >= HALF)
c34 = claim(34, fig7,
    "'All representations show excellent agreement in the superharmonic-resonance region and "
    "leading up to the primary resonance peak, but the Poly-21 and RatPoly 5/5 models begin to "
    "disagree with the reference model after the jump phenomenon.'",
    fig7.error((0.2, 12.0))[STRONG] <= LINE, fig7.error((12.2, 30.0))[POLY_21, RATPOLY_5] > LINE)
f1_high = fig7.f1((15.0, 30.0))
c35 = claim(35, fig7,
    "'The tangent-based models are the most accurate, with Tanh and Arctan having similar "
    "accuracy and Log-Arctan having slightly less accuracy at higher forcing frequency.'",
    fig7.f1()[TANH_6, ARCTAN_6, LOGARCTAN_6] > fig7.f1()[POLY_21, RATPOLY_5],
    alike(fig7.f1()[TANH_6], fig7.f1()[ARCTAN_6], ALIKE),
    f1_high[TANH_6, ARCTAN_6] > f1_high[LOGARCTAN_6])

# --- Figs 8 and 9: bifurcation diagrams -----------------------------------------------------------

c36 = claim(36, fig8a,
    "'All models are in excellent agreement for the very soft contact case', 'all five "
    "representations capture both behaviors well' (ringing, superharmonics).",
    fig8a.error()[WEAK] <= LINE, ringing(fig8a, THREE_QUARTERS),
    note="Swings count that are more than a line.")
c37 = claim(37, fig8b,
    "'The Poly-13 model is unable to capture the full frequency range of \"ringing\", chaotic, or "
    "superharmonic resonance behaviors.'",
    fig8b.right((0.1, 7.0))[POLY] < HALF)
chaos = fig8b.count("chaos", (4.0, 5.0))
c38 = claim(38, fig8b,
    "'The Arctan and Log-Arctan models also fail to capture the narrow chaotic band near 4-5 Hz.'",
    chaos[EXACT] >= 1.0, chaos[ARCTAN, LOGARCTAN] < 1.0, context=[chaos[POLY, RATPOLY, TANH]])
rarer = fig8b.table("frequencies with period not 1 near 6 and near 7 Hz, the fewer",
    lambda at, label: min((fig8b.count("period not 1", band).number(at, label)
                           for band in ((5.5, 6.4), (6.5, 7.4))), key=lambda n: n.value), ".0f")
c39 = claim(39, fig8b,
    "'Only the Tanh model captures both the narrow transitions to superharmonic resonance near 6 "
    "Hz and 7 Hz.'",
    rarer[EXACT, TANH] >= 1.0, rarer[POLY, RATPOLY, ARCTAN, LOGARCTAN] < 1.0,
    note="Nothing else happens near 6 and 7 Hz: every other response of the exact law from 5.2 to "
         "8 Hz has period 1 and two turning points.")
c40 = claim(40, fig8b,
    "'The Poly-13, Arctan, and Log-Arctan slightly overestimate the frequency value of the "
    "primary resonance peak.'",
    peak[POLY, ARCTAN, LOGARCTAN] > peak[EXACT],
    peak[POLY, ARCTAN, LOGARCTAN] - peak[EXACT] < SLIGHTLY)
after_jump = fig8b.count("nonlinear behaviour", (11.7, 16.0))
c41 = claim(41, fig8b,
    "'The RatPoly 5/3 and Arctan models predict a region of nonlinear behavior shortly after the "
    "jump phenomenon and before the region of subharmonic resonance.'",
    after_jump[RATPOLY, ARCTAN] - after_jump[EXACT] >= REGION,
    after_jump[TANH] - after_jump[EXACT] < REGION, note=OPTIMUM)
band_width = fig8b.bisected("width of the period-3 band", low=-1.0, high=1.0)
low_end, high_end = fig8b.bisected("lower end", low=1.0), fig8b.bisected("upper end", high=1.0)
middle = fig8b.bisected("middle of the period-3 band", low=0.5, high=0.5)
c42 = claim(42, fig8b,
    "'The RatPoly 5/3, Tanh, and Arctan models ... predict a much larger frequency band, predict "
    "the correct-size band but shifted slightly down in frequency, and ... slightly up, "
    "respectively.'",
    fig8b.share("period 3", (17.0, 21.0))[EXACT] >= HALF,
    band_width[RATPOLY] / band_width[EXACT] > MUCH,
    alike(band_width[TANH, ARCTAN], band_width[EXACT], SAME_SIZE),
    middle[TANH] < middle[EXACT], middle[EXACT] - middle[TANH] < SLIGHTLY,
    middle[ARCTAN] > middle[EXACT], middle[ARCTAN] - middle[EXACT] < SLIGHTLY,
    context=[low_end[EXACT, RATPOLY, TANH, ARCTAN], high_end[EXACT, RATPOLY, TANH, ARCTAN]])
on_3_once = fig8b.count("period 3", (12.0, 30.0))
c43 = claim(43, fig8b,
    "'The Poly-13 and Log-Arctan do not capture any subharmonic resonance behavior.'",
    on_3_once[EXACT] >= REGION, on_3_once[POLY, LOGARCTAN] < 1.0,
    context=[fig6b.share_of_frequencies("period 3", (12.0, 30.0))[POLY, LOGARCTAN]])
c44 = claim(44, fig8c,
    "'All the representations seem to have failed altogether for their convergence quality.'",
    fig8c.right()[WEAK] < HALF)
c45 = claim(45, fig8c,
    "'The Poly-13 and Log-Arctan predict very low-amplitude periodic solutions for the entire "
    "frequency range.'",
    fig8c.share("periodic")[POLY, LOGARCTAN] >= 0.98,
    fig8c.of_points("95th percentile of the amplitude [m]", ("amplitude",), lambda points: float(
        np.nanquantile(points["amplitude"], 0.95)))[POLY, LOGARCTAN] < 0.1 * 0.4e-3)
ends, below_20, above_20 = ("amplitude", "x_max", "x_min"), (0.0, 20.0), (20.1, 30.0)
low, above = (fig8c.of_points(*median, band=band) for band in (below_20, above_20))
c46 = claim(46, fig8c,
    "'The RatPoly 5/3 model predicts a low-amplitude periodic solution, with negative mean, for "
    "most of the frequency range before predicting higher amplitude periodic solutions above 20 "
    "Hz.'",
    low[RATPOLY] / low[EXACT] <= HALF,
    fig8c.share("negative mean", below_20)[RATPOLY] > HALF,
    above[RATPOLY] / low[RATPOLY] > MUCH, unstated=COEFFICIENTS, note=OTHER_FIT)


def trapped(points: xr.Dataset) -> Number:
    middle = abs(0.5 * (points["x_max"] + points["x_min"]))
    return share((points["amplitude"] < 0.1e-3) & (middle > points["amplitude"]))


small = ("small motions away from the centre", ends, trapped, ".0%")
c47 = claim(47, fig8c,
    "'Tanh predicts a very low-amplitude periodic response with a high mean value, almost as if "
    "the system becomes trapped in a potential well away from the origin.'",
    fig8c.static(*wells)[TANH] >= 2.0, fig8c.of_points(*small)[TANH] > HALF,
    context=[fig8c.share("negative mean")[TANH]])
c48 = claim(48, fig8c, "'Arctan also captures none of the correct system physics.'",
    fig8c.right()[ARCTAN] <= TENTH)


def in_windows(at: At, label: str, name: str, band: Band) -> xr.DataArray:
    found = at.run.select("windows", representation=label, start=at["start"])[name]
    return found.sel(omega=slice(*band)).reset_coords(drop=True)


def same_class(at: At, label: str) -> Number:
    ours, exact = ([in_windows(at, one, name, (10.0, 12.0)) for name in (
        "period_multiple", "response_class")] for one in (label, EXACT))
    return share((ours[0] == exact[0]) & (ours[1] == exact[1]))


def windows_found(at: At, label: str) -> Number:
    """Of the frequencies with an exact period above 1, how many have it with a law too."""
    exact, ours = (in_windows(at, one, "period_multiple", (12.0, 20.0)) for one in (EXACT, label))
    return share((ours == exact)[exact.values > 1])


near_11 = fig9.table("exact class, every 0.02 Hz at 10-12 Hz", same_class, ".0%")
narrow = fig9.table("exact windows found, every 0.02 Hz at 12-20 Hz", windows_found, ".0%")
ITSELF = f"{EXACT}@jitter"
c49 = claim(49, fig9,
    "'Capture the low-frequency chaos, the chaotic-to-periodic transitions, and the additional "
    "nonlinear behavior between 10-12 Hz' (tanh and arctan).",
    fig9.same_class((0.5, 4.5))[TANH_6, ARCTAN_6] >= THREE_QUARTERS,
    fig9.same_class((4.6, 9.9))[TANH_6, ARCTAN_6] >= HALF,
    near_11[TANH_6, ARCTAN_6] >= THREE_QUARTERS, context=[near_11[ITSELF]])
c50 = claim(50, fig9,
    "'Arctan captures more of the very narrow higher-period regions between 12-20 Hz than Tanh "
    "does.'",
    narrow[ARCTAN_6] > narrow[TANH_6], context=[narrow[ITSELF]])


def widest_region(at: At, label: str) -> Number:
    """Most frequencies in a row, every 0.02 Hz beyond 20 Hz, with a period other than 1."""
    other = in_windows(at, label, "period_multiple", (20.02, 30.0)).values != 1
    return Number(float(max((j - i for i, j in runs(other)), default=0)))


beyond_20 = fig9.table("widest region of period not 1 beyond 20 Hz, steps of 0.02 Hz",
                       widest_region, ".0f")
c51 = claim(51, fig9,
    "'Log-Arctan is less accurate ... and it also predicts a narrow region of behavior beyond 20 "
    "Hz that does not occur in the other models.'",
    fig9.right(below_20)[TANH_6, ARCTAN_6] > fig9.right(below_20)[LOGARCTAN_6],
    beyond_20[LOGARCTAN_6] >= REGION, beyond_20[EXACT, TANH_6, ARCTAN_6] < REGION,
    note="A narrow region: five steps in a row. The fits' are in claim 52.")
c52 = claim(52, fig9,
    "'The Poly-21 and RatPoly 5/5 models are still unable to capture any of the system's rich "
    "behavior.'",
    fig9.right()[POLY_21, RATPOLY_5] <= TENTH)

# --- Table 2: cost --------------------------------------------------------------------------------

SECONDS = "Decided by the paper's seconds. Costs here: its tolerances, controller and restarts. "
Seconds = Callable[[list[float]], float]


def table_2(what: str, number: Seconds, *grades: str) -> Quantity:
    """A number of the paper's seconds: exact, polynomial, rational, three tangent laws."""
    return constants(f"Table 2, {what}", {grade: number(list(TABLE_2[grade].values()))
                                          for grade in grades or tuple(TABLE_2)})


def slower_than(i: int) -> Seconds:
    """How many laws take longer than one."""
    return lambda seconds: float(sum(other > seconds[i] for other in seconds))


def over_exact(what: str, name: str) -> Quantity:
    """Costs of all laws over the exact law's."""
    return cost(what, name, {
        f"{named(label)}, {grade}": (label + PAPER, EXACT + PAPER, scene)
        for grade, scene in TABLE_CASES.items() for label in list(TABLE_2[grade])[1:]})


work = over_exact("right-hand sides over the exact law's", "nfev")
c53 = claim(53, "Table 2",
    "'In both cases, the exact piecewise representation took either the first or second longest.'",
    table_2("laws that take longer than the exact one", slower_than(0)) <= 1.0,
    note=SECONDS, context=[work])
slower_than_rational = ("laws that take longer than RatPoly", slower_than(2))
c54 = claim(54, "Table 2",
    "'The rational polynomial model took the longest to run for case 2 and the second longest for "
    "case 1.'",
    table_2(*slower_than_rational, "weak") <= 1.0, table_2(*slower_than_rational, "strong") <= 0.0,
    note=SECONDS)
third = table_2("laws that take longer than the polynomial", slower_than(1))
c55 = claim(55, "Table 2",
    "'The polynomial model was third slowest for both cases, but it was faster than the second "
    "slowest by a factor of about 1.5.'",
    third >= 2.0, third <= 2.0,
    alike(table_2("second slowest over polynomial", lambda s: sorted(s)[-2] / s[1]),
          constants("the paper's", {"1.5": 1.5}), ABOUT), note=SECONDS)
c56 = claim(56, "Table 2",
    "'The tangent-based representations were the fastest in both cases and differed by no more "
    "than half a second.'",
    table_2("slowest tangent law over the fastest other", lambda s: max(s[3:]) / min(s[:3])) < 1.0,
    table_2("slowest minus fastest tangent law [s]", lambda s: max(s[3:]) - min(s[3:])) <= 0.5,
    note=SECONDS)
c57 = claim(57, "Table 2",
    "'These averaged about 6.5 times faster than the slowest model in both cases.'",
    alike(table_2("slowest over mean tangent law", lambda s: max(s) / (sum(s[3:]) / 3.0)),
          constants("the paper's", {"6.5": 6.5}), ABOUT), note=SECONDS)
LOCATED = {grade: (f"{EXACT}@paper", f"{EXACT}@paper-norestart", scene)
           for grade, scene in TABLE_CASES.items()}
restart_work = cost("right-hand sides with restarts over without", "nfev", LOCATED)
# Centres and halves of the ranges of nine rounds.
TYPED_IN = "typed in from benchmarks/one_method.py"
LOOP = constants(f"time of a loop around RK45 with restarts over one without, {TYPED_IN}", {
    "soft 1e-4": (1.14, 0.02), "soft 1e-6": (1.04, 0.05), "hard 1e-4": (1.09, 0.03),
    "hard 1e-6": (1.03, 0.04)})
EVENT_CAPABILITY = constants(f"time of solve_ivp with terminal events over that loop, {TYPED_IN}", {
    "soft 1e-4": (1.56, 0.05), "soft 1e-6": (1.39, 0.04), "hard 1e-4": (1.42, 0.05),
    "hard 1e-6": (1.34, 0.09)})
RESTARTS = ("Cost of the restart, and of terminal events as a whole: one Runge-Kutta pair in "
            "scipy, which is interpreted like the paper's solver. ")
c58 = claim(58, "Table 2",
    "'Because it uses the event detection capability, which requires the simulation to stop and "
    "restart at every instance of contact.'",
    EVENT_CAPABILITY >= ALIKE, context=[LOOP, restart_work],
    note=RESTARTS + "The sentence is about the capability as a whole.")

# --- Section 4.2: limits --------------------------------------------------------------------------

c59 = claim(59, "Sect. 4.2",
    "'A high contact stiffness may be represented by upwards of 20-45 coefficients and still have "
    "a poor accuracy.'",
    ladder("largest force in the gap over 4 N, hard contact, degree", "poly_in_gap_force",
           lambda force: HARD * float(force) / 4.0, degree=(21, 33, 45), **FREE) > TENTH)
stiff = ("error of the frequency in the gap", "in_gap_frequency_error", ".0%")
c60 = claim(60, "Sect. 4.2",
    "'A small freeplay gap tends to produce a polynomial that behaves linearly over the entire "
    "displacement range without enough coefficients.'",
    fig8b.static(*stiff)[POLY] > TENTH,
    fig8b.static(*stiff)[POLY] > Figure("Large gap", SOFT, LARGE).static(*stiff)[POLY])
c61 = claim(61, fig9,
    "'If the freeplay representation has multiple roots within the freeplay gap ... then the "
    "system response can become trapped at a higher amplitude.'",
    fig9.static(*wells)[POLY_21] >= 2.0, fig9.of_points(*small)[POLY_21] > HALF)


def most_wells(at: At, label: str) -> Number:
    """Static wells in the worst of all cases."""
    cases = [(K_c, gap) for K_c in (VERY_SOFT, SOFT, HARD) for gap in (*BOTH_GAPS, LARGE)]
    found = (at.run.scene("static", label, *case, "n_wells")["n_wells"] for case in cases)
    return Number(max(float(n) for n in found))


WEAK_TANGENTS, STRONG_TANGENTS = WEAK[2:], STRONG[2:]
worst = ("most static wells", most_wells, ".0f")
c62 = claim(62, "Sect. 4.2",
    "'Each of these models can also be applied for soft and hard contact stiffnesses and to "
    "large, small, and asymmetric freeplay gaps without problem' (tangent laws, at 1e4 and at "
    "1e6).",
    fig8b.table(*worst)[WEAK_TANGENTS] <= 1.0, fig9.table(*worst)[STRONG_TANGENTS] <= 1.0,
    rmse[WEAK_TANGENTS] < 0.5, asymmetric.static("RMSE [N]", "rmse")[WEAK_TANGENTS] < 0.5,
    fig8c.right()[WEAK_TANGENTS] >= HALF, fig9.right()[STRONG_TANGENTS] >= HALF,
    *(figure.recall()[WEAK_TANGENTS] >= HALF for figure in (fig6a, fig6b, fig6c)),
    fig7.recall()[STRONG_TANGENTS] >= HALF)
c63 = claim(63, "Sect. 4.2",
    "'For a given value of convergence parameter ε or γ, the hyperbolic tangent model overall "
    "seemed to be the most accurate, with the arctangent model second and the "
    "logarithm-arctangent model third.'",
    *(rmse[one] < rmse[other] for laws in (WEAK_TANGENTS, STRONG_TANGENTS)
      for one, other in pairwise(laws)),
    *(figure.f1()[one] - figure.f1()[other] > -TWENTIETH
      for figure, laws in ((fig6b, WEAK_TANGENTS), (fig6c, WEAK_TANGENTS), (fig7, STRONG_TANGENTS))
      for one, other in pairwise(laws)),
    note="Overall: the smaller error of the force, and nowhere fewer attractors by a twentieth.")
c64 = claim(64, "Sect. 4.2",
    "'The rational-polynomial model is the most difficult to formulate and implement.'",
    best_found < THREE_QUARTERS, poles > 0.25, note=CFTOOL + "Other fits have one solution each.")

# --- Figs 10 and 11: the limit of tanh ------------------------------------------------------------

c65 = claim(65, fig10,
    "'Both hyperbolic tangent responses show excellent agreement with the piecewise "
    "no-event-detection response. Any improvement gained from using the more converged "
    "representation is minimal.'",
    distance(SIX, NONE) <= AS_DRAWN, distance(NINE, NONE) <= AS_DRAWN,
    distance(SIX, NONE) < distance(SIX, EVENTS), distance(NINE, NONE) < distance(NINE, EVENTS),
    note=AFTER_4 + "Excellent and minimal: less than a plot shows, and nearer than with events.")
c66 = claim(66, fig10,
    "'There are discrepancies between the result without and with event detection that do not "
    "resolve by increasing the convergence parameter.'",
    distance(NINE, TRUTH) / distance(EVENTS, TRUTH) > MUCH,
    alike(distance(NINE, TRUTH), distance(NONE, TRUTH), COMPARABLE), note=AFTER_4)
regular, chaotic = (distance(NONE, EVENTS, chaotic=kind) for kind in (False, True))
c67 = claim(67, fig10,
    "'The narrow bands of periodic responses agree well in all cases, but the regions of chaos "
    "and other nonlinear behavior show less agreement.'",
    regular <= AS_DRAWN, chaotic / regular > ALIKE, note=AFTER_4)


def off_period_2(at: At, label: str) -> Number:
    """How far the period at 21.75 Hz is from two forcing periods."""
    points = fig11.points(at, label, "period_multiple", band=(21.75, 21.75))
    return Number(abs(float(points["period_multiple"].values[0]) - 2.0))


def near_0_4(n: int) -> Table:
    """Share of 101 initial conditions within 5 nm that lead to period n, at 11 Hz."""
    def number(at: At, label: str) -> Number:
        found = at.run.select("cloud", representation=label, start=at["start"])["period_multiple"]
        # At loose tolerances a P6 or P9 is a P3 with the solver's noise on it.
        return share((found > 0) & (found % n == 0) if n > 1 else found == 1)

    return fig11.table(f"initial conditions within 5 nm that lead to period {n}, 11 Hz", number,
                       ".0%")


false_3 = fig11.table("initial conditions with period 3, 11 Hz", lambda at, label: share(
    periods(at, label, HARD_ASYMMETRIC, (11.0,)) == 3), ".0%")
c68 = claim(68, fig11,
    "'A period-1 response with superharmonics should have been captured, but a period-3 response "
    "with both subharmonics and superharmonics is falsely detected instead' (11 Hz).",
    near_0_4(1)[EXACT] >= HALF, near_0_4(3)[NONE, SIX] > near_0_4(3)[EVENTS],
    context=[near_0_4(1)[EVENTS, NONE, SIX, NINE], near_0_4(3)[NINE], false_3[EXACT]],
    note="The exact law with tight tolerances, the others with the paper's, at which nanometres "
         "decide for every law. Falsely: more often than with events.")


def ends_off(at: At, label: str) -> Number:
    """How far peak or trough at 21.75 Hz are from the exact ones, in widths of the gap."""
    ours, exact = (fig11.points(at, one, "x_max", "x_min", band=(21.75, 21.75)).isel(point=0)
                   for one in (label, EXACT))
    apart = [abs(float(ours[end]) - float(exact[end])) for end in ("x_max", "x_min")]
    return Number(max(apart) / 0.8e-3)


c69 = claim(69, fig11,
    "'The overall behavior of the response is captured well, indicating a period-2 response ... "
    "However, the results still differ on a small scale' (21.75 Hz).",
    fig11.table("period minus 2 at 21.75 Hz", off_period_2, ".0f")[EVENTS, SIX, NONE] <= 0.0,
    fig11.table("peak or trough off, gap widths", ends_off)[EVENTS, SIX, NONE] <= LINE)
c70 = claim(70, fig11,
    "'The only way to remove these numerical issues at this point is to either refine the "
    "tolerances of the numerical solver itself ... or to implement an event detection procedure', "
    "which 'can be comparable'.",
    distance(FINER, TRUTH) < distance(NONE, TRUTH), distance(EVENTS, TRUTH) < distance(NONE, TRUTH),
    alike(distance(EVENTS, TRUTH), distance(FINER, TRUTH), COMPARABLE), note=AFTER_4,
    context=[distance(f"{EXACT}@finer", TRUTH), distance(ITSELF, TRUTH)])
c71 = claim(71, fig11,
    "'The limit of applicability of the hyperbolic tangent model approaches that of the exact "
    "piecewise model without any event detection procedure.'",
    distance(NINE, NONE) < distance(NINE, EVENTS), distance(NINE, NONE) < distance(SIX, NONE),
    note=AFTER_4)

# --- Section 5: conclusions -----------------------------------------------------------------------

c72 = claim(72, "Sect. 5",
    "'The polynomial and rational polynomial representations performed the worst at accurately "
    "capturing system behavior and had the greatest computational costs of all the models "
    "studied.'",
    fig6c.f1()[WEAK[:2]] < fig6c.f1()[WEAK_TANGENTS],
    fig7.f1()[STRONG[:2]] < fig7.f1()[STRONG_TANGENTS],
    table_2("faster fit over slowest tangent law", lambda s: min(s[1:3]) / max(s[3:])) > 1.0,
    note=SECONDS)
c73 = claim(73, "Sect. 5",
    "'If this is not a concern, the hyperbolic tangent representation is recommended ... most "
    "effective at capturing both weak and strong contact nonlinearities.'",
    *(figure.f1()[grade[2]] > figure.f1()[(*grade[:2], *grade[3:])]
      for figure, grade in ((fig6a, WEAK), (fig6b, WEAK), (fig6c, WEAK), (fig7, STRONG))),
    fig9.right()[TANH_6] > fig9.right()[POLY_21, RATPOLY_5, ARCTAN_6, LOGARCTAN_6])
c74 = claim(74, "Sect. 5",
    "'If ode45 with event location could be modified to run without restarting, significant time "
    "savings could be obtained.'",
    LOOP >= 1.25, EVENT_CAPABILITY >= 1.25, context=[restart_work],
    note=RESTARTS + "Significant: a fifth is saved.")

# --- What the first list left out -----------------------------------------------------------------

fall = fig2.table("fall of the RMSE to the strong grade", lambda at, label: (
    rmse.number(at, WEAK[STRONG.index(label)]) / rmse.number(at, label)))
c75 = claim(75, "Fig. 5", "'They also converge significantly faster' (the tangent laws).",
    fall[STRONG_TANGENTS] / fall[STRONG[:2]] >= 2.0,
    note="From the weak to the strong grade the error falls by twice the factor.")


def near_walls(at: At, label: str) -> Number:
    """RMS force error within 0.1 mm of the walls over that elsewhere."""
    error = at.run.scene("static", label, VERY_SOFT, SYMMETRIC, "force_error")["force_error"]
    x, weights = error["x"].values, np.gradient(error["x"].values)
    near = np.abs(np.abs(x) - 0.4e-3) <= 0.1e-3
    inside, elsewhere = (np.average(error.values[here] ** 2, weights=weights[here])
                         for here in (near, ~near))
    return Number(float(np.sqrt(inside / elsewhere)))


c76 = claim(76, fig2c,
    "'The polynomial representation matches the very soft contact but still fails to capture the "
    "transition at the freeplay boundaries.'",
    fig2c.table("RMS error near the walls over that elsewhere", near_walls)[POLY, POLY_21] > 1.0)
c77 = claim(77, "Sect. 4.2",
    "'As the contact stiffness increases, however, increasing the degrees does little to improve "
    "the representation accuracy and eventually leads to \"badly conditioned\" errors which can "
    "make the rational polynomial representation unusable.'",
    rational("5/5") / rational("5/3") > HALF,
    random_fit("random fits with a pole", "pole_share", "5/5") >= 0.25,
    note=CFTOOL + "Relative errors of a fit are the same at every stiffness.")
c78 = claim(78, "Sect. 3",
    "'In some situations the convergence parameter should not be too large because then the "
    "smoothness of the representation will be lost.'",
    cost("right-hand sides at 1e6 over those at 1e4, one Runge-Kutta pair, soft contact", "nfev",
         {named(law): (f"{law}-1e6@paper", f"{law}-1e4@paper", SOFT_SYMMETRIC)
          for law in TANGENTS[1:]}) > ALIKE, note="In some situations: with some laws.")
c79 = claim(79, fig8b, "'... that all the other models are generally able to capture' (claim 37).",
    fig8b.right((0.1, 7.0))[WEAK[1:]] >= HALF)
c80 = claim(80, fig9, "'The Tanh and Arctan models show the best agreement among all the models.'",
    fig9.right()[TANH_6, ARCTAN_6] > fig9.right()[POLY_21, RATPOLY_5, LOGARCTAN_6])
c81 = claim(81, fig9,
    "'The accuracy of all representations is still limited when strong contact behavior is "
    "present.'",
    fig9.right()[ITSELF] - fig9.right()[STRONG] > TWENTIETH,
    note="Limited: a twentieth below the exact law from 1 nm away.",
    context=[fig9.right()[f"{EXACT}@half", ITSELF, TANH_6, ARCTAN_6]])


def lines(label: str, omega: float, *multiples: float) -> Quantity:
    """Spectral line over the largest, at a multiple of the forcing frequency; of many the third."""
    def number(at: At, label: str) -> Number:
        found = at.run.select("histories", representation=label)
        here = np.isclose(found["omega"], omega)
        here &= np.isclose(found["x_0"], STARTS[at["start"]][0], atol=1e-12)
        if not here.any():
            raise NotInRunError(f"no history of {label} at {omega:g} Hz")
        one = found.isel(history=int(np.argmax(here)))
        bins, spectrum = one["frequency"].values, one["spectrum"].values
        near = (np.abs(bins - multiple * omega) <= 0.02 * omega for multiple in multiples)
        heights = sorted(float(np.nanmax(spectrum[one])) for one in near)
        largest = float(np.nanmax(spectrum[bins > 0.1 * omega]))
        return Number(heights[-min(3, len(heights))] / largest)

    at = "the third superharmonic"
    if len(multiples) == 1:
        at = f"1/{1.0 / multiples[0]:.0f} of the forcing frequency"
    return fig11.table(f"spectral line at {at}, {omega:g} Hz", number)[label]


c82 = claim(82, fig11,
    "'A period-1 response with superharmonics should have been captured, but a period-3 response "
    "with both subharmonics and superharmonics'; at 21.75 Hz 'a period-2 response with one "
    "subharmonic and many superharmonics'.",
    lines(NONE, 11.0, 1 / 3) >= 0.01, lines(SIX, 11.0, 1 / 3) >= 0.01,
    lines(EVENTS, 11.0, 1 / 3) < 0.01,
    lines(EVENTS, 11.0, 1 / 2) < 0.01, lines(EVENTS, 21.75, 1 / 2) >= 0.01,
    lines(EVENTS, 21.75, 2, 3, 4, 5, 6) >= 0.01,
    unstated="Not in the text: the initial condition to a nanometre, which decides at 11 Hz",
    context=[near_0_4(3)[EVENTS, NONE, SIX]],
    note="A line is 1 % of the largest, many are three. One history of each law.")
