"""The answer in five lines, made from a run: which law, where, why, and at what price."""

from collections.abc import Iterable

import numpy as np

from gapsweep.analysis.verdicts import Number, Run
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
    """Five lines; the first holds for every way in which a law's price is stated.

    Raises
    ------
    NotInRunError
        If the run lacks one of the numbers.
    """
    half_gap = 0.5 * width(SOFT_SYMMETRIC)

    def found(laws: Iterable[str], *cases: Case) -> str:
        """Shares of the exact law's attractors that laws find, in percent."""
        shares = [
            run.scene("agreement", law, *case, "recall_pooled")["recall_pooled"].sel(regime="all")
            for law in laws
            for case in cases
        ]
        return f"{_range([100.0 * float(share) for share in shares], '.0f')} %"

    tried, weak = (SOFT_ASYMMETRIC, SOFT_SYMMETRIC, HARD_SYMMETRIC), ("tanh-1e4", "arctan-1e4")
    itself = [f"{EXACT}@jitter"]
    K_c, gap = HARD_SYMMETRIC
    wells = number(float(run.select("static", K_c=K_c, gap=gap)["tanh_threshold"]))
    times = (f"{SOFT / SPRING:.1f}", f"{HARD / SPRING:.0f}")
    return [
        f"Locate contacts and take the exact law: at the paper's tolerance it is "
        f"{_nearer(run):.0f} times nearer to the truth than without location (hard contact, 0/0.8 "
        f"mm). What a tangent law saves depends on the solver: it takes "
        f"{_range(_work(run), '.2f')} of the exact law's right-hand sides with one Runge-Kutta "
        f"pair, {_range(_times(run), '.2g')} times its time with this engine's defaults, and "
        f"{_range(SCIPY_TIME, '.2f')} times with scipy's terminal events and restarts.",
        f"If a tool cannot locate contacts: tanh with ε · (half of the gap) ≥ "
        f"{1e6 * half_gap:.0f}, here 1e6 /m. It finds {found(['tanh-1e6'], *tried)} of the "
        f"exact attractors in three of the four cases tried; the exact law from 1 nm away "
        f"finds {found(itself, *tried)}, arctan "
        f"{found(['arctan-1e6'], *tried)}, log-arctan {found(['logarctan-1e6'], *tried)}.",
        f"ε · (half of the gap) = {1e4 * half_gap:.0f} is enough for walls softer than the spring "
        f"and gaps that are hardly crossed ({found(weak, VERY_SOFT_SYMMETRIC, SOFT_LARGE)}), not "
        f"for walls of {times[0]} times its stiffness ({found(weak, *tried[:2])}) or {times[1]} "
        f"times ({found(weak, HARD_SYMMETRIC)}), where tanh has false wells below ε = {wells} /m.",
        f"Polynomials and rational fits: only for the softest wall "
        f"({found(WEAK[:2], VERY_SOFT_SYMMETRIC)}); at the hard one they find "
        f"{found((*WEAK[:2], *STRONG[:2]), HARD_SYMMETRIC)}.",
        f"At hard contact and 0/0.8 mm no law is to blame: the exact law from 1 nm away finds "
        f"{found(itself, HARD_ASYMMETRIC)} of its own attractors, tanh with ε = 1e9 /m "
        f"{found(['tanh-1e9'], HARD_ASYMMETRIC)}, with 1e6 {found(['tanh-1e6'], HARD_ASYMMETRIC)}.",
    ]


def _first(run: Run, quantity: Quantity) -> list[Number]:
    """Numbers of a quantity with the first value of every setting."""
    at = At(run, {name: next(iter(values)) for name, values in SETTINGS.items()})
    return [read(at) for _, read in quantity.parts]


def _nearer(run: Run) -> float:
    """How many times the error of unlocated contacts is that of located ones."""
    apart = distance(f"{NO_EVENTS}@paper", TRUTH) / distance(f"{EXACT}@paper", TRUTH)
    (decades,) = _first(run, apart)
    return float(10.0**decades.value)


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
