"""The answer in five lines, made from a run: which law, where, why, and at what cost."""

from collections.abc import Iterable

import numpy as np

from gapsweep.analysis.claims import Number, Run
from gapsweep.report.tables import number

from .language import SETTINGS, At, Quantity
from .measures import cost, distance, named
from .refined import TRUTH
from .scenes import (
    EXACT,
    HARD,
    HARD_ASYMMETRIC,
    HARD_SYMMETRIC,
    NO_EVENTS,
    SOFT,
    SOFT_ASYMMETRIC,
    SOFT_LARGE,
    SOFT_SYMMETRIC,
    SPRING,
    STARTS,
    STRONG,
    TABLE_CASES,
    VERY_SOFT_SYMMETRIC,
    WEAK,
    Case,
    width,
)

# Medians of benchmarks/one_method.py: time over the exact law's by solve_ivp, the exact law with
# terminal events and restarts; the least and the largest of the tangent laws.
SCIPY_TIME = (0.34, 0.74)


def answer(run: Run) -> list[str]:
    """Five lines; the first holds for every way in which a law's cost is stated.

    Raises
    ------
    NotInRunError
        If the run lacks one of the numbers.
    """

    def found(laws: Iterable[str], *cases: Case) -> str:
        """Shares of the exact law's attractors that laws find, in percent."""
        shares = [
            run.scene("agreement", law, *case, "recall_pooled")["recall_pooled"].sel(regime="all")
            for law in laws
            for case in cases
        ]
        return f"{_range([100.0 * float(share) for share in shares], '.0f')} %"

    tried = (SOFT_ASYMMETRIC, SOFT_SYMMETRIC, HARD_SYMMETRIC, HARD_ASYMMETRIC)
    itself, weak = [f"{EXACT}@jitter"], ("tanh-1e4", "arctan-1e4")
    K_c, gap = HARD_SYMMETRIC
    wells = number(float(run.select("static", K_c=K_c, gap=gap)["tanh_threshold"]))
    times = (f"{SOFT / SPRING:.1f}", f"{HARD / SPRING:.0f}")
    small, large = (0.5 * width(case) for case in (SOFT_SYMMETRIC, SOFT_LARGE))
    return [
        f"Locate contacts and take the exact law: at the paper's tolerance its error is "
        f"{_range(_nearer(run), '.0f')} times smaller after four forcing periods than "
        f"without location (hard contact, 0/0.8 mm). The saving of a tangent law depends on "
        f"the solver: it takes {_range(_work(run), '.2f')} of the exact law's right-hand sides "
        f"with one Runge-Kutta pair, {_range(_times(run), '.2g')} times its time with the engine's "
        f"defaults, and {_range(SCIPY_TIME, '.2f')} times with scipy's terminal events and "
        f"restarts.",
        f"If a tool cannot locate contacts, take the exact force all the same, with tight "
        f"tolerances: it finds {found([NO_EVENTS], *tried)} of the attractors in the four cases "
        f"with the stiffer walls, where the exact law itself, started 1 nm away, finds "
        f"{found(itself, *tried)}: no law can do better. Only a method that needs a smooth force "
        f"needs tanh: with ε · (half of the gap) = {1e6 * small:.0f} (ε = 1e6 /m) it finds "
        f"{found(['tanh-1e6'], *tried)}, arctan {found(['arctan-1e6'], *tried[:3])}, log-arctan "
        f"{found(['logarctan-1e6'], *tried[:3])} in the first three.",
        f"ε · (half of the gap) = {1e4 * small:.0f} is enough for walls softer than the spring "
        f"({found(weak, VERY_SOFT_SYMMETRIC)}), {1e4 * large:.0f} for gaps that are hardly crossed "
        f"({SOFT_LARGE[1]} mm, {found(weak, SOFT_LARGE)}); 4 is not for walls of {times[0]} "
        f"times the spring's stiffness ({found(weak, *tried[:2])}) or {times[1]} times "
        f"({found(weak, HARD_SYMMETRIC)}), where tanh has false wells below ε = {wells} /m.",
        f"Polynomials and rational fits: only for the softest wall "
        f"({found(WEAK[:2], VERY_SOFT_SYMMETRIC)}); at the hard one they find "
        f"{found((*WEAK[:2], *STRONG[:2]), HARD_SYMMETRIC)}.",
        f"At hard contact and 0/0.8 mm no law is to blame: the exact law, started 1 nm away, finds "
        f"{found(itself, HARD_ASYMMETRIC)} of the attractors, tanh with ε = 1e9 /m "
        f"{found(['tanh-1e9'], HARD_ASYMMETRIC)}, with 1e6 {found(['tanh-1e6'], HARD_ASYMMETRIC)}.",
    ]


def _first(run: Run, quantity: Quantity) -> list[Number]:
    """Numbers of a quantity with the first value of every setting."""
    at = At(run, {name: next(iter(values)) for name, values in SETTINGS.items()})
    return [read(at) for _, read in quantity.parts]


def _nearer(run: Run) -> list[float]:
    """How many times the error of unlocated contacts is that of located ones, from each start."""
    apart = distance(f"{NO_EVENTS}@paper", TRUTH) / distance(f"{EXACT}@paper", TRUTH)
    ((_, read),) = apart.parts
    return [10.0 ** read(At(run, {"start": start})).value for start in STARTS]


def _work(run: Run) -> list[float]:
    """Right-hand sides of the tangent laws over the exact law's, by one Runge-Kutta pair."""
    of = {
        named(law): (f"{law}@paper", f"{EXACT}@paper", case)
        for laws, case in zip((WEAK, STRONG), TABLE_CASES.values(), strict=True)
        for law in laws[2:]
    }
    return [number.value for number in _first(run, cost("right-hand sides", "nfev", of))]


def _times(run: Run) -> list[float]:
    """Time of the tangent laws over the exact law's, all cases, with this engine's defaults."""
    ratio = run["agreement"]["cpu_time_per_period_ratio"].sel(regime="all").load()
    laws = [law for law in (*WEAK[2:], *STRONG[2:]) if law in ratio["representation"]]
    values = ratio.sel(representation=laws).values
    return [float(np.nanmin(values)), float(np.nanmax(values))]


def _range(numbers: Iterable[float], form: str) -> str:
    return " to ".join(dict.fromkeys(f"{end:{form}}" for end in (min(numbers), max(numbers))))
