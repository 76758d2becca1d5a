"""The answer in five sentences from a run: contact laws to use, and their costs."""

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
    """Five sentences; the first is valid for each measure of cost.

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
        f"Locate contacts and use the exact law: at the paper's tolerance its error after four "
        f"forcing periods is {_range(_nearer(run), '.0f')} times smaller than without location "
        f"(hard contact, 0/0.8 mm). The saving by a tangent law depends on the solver: it needs "
        f"{_range(_work(run), '.2f')} of the exact law's right-hand sides with one Runge-Kutta "
        f"pair, {_range(_times(run), '.2g')} times its time with the default solvers, and "
        f"{_range(SCIPY_TIME, '.2f')} times with scipy's terminal events and restarts.",
        f"If a tool cannot locate contacts, use the exact force with tight tolerances: it finds "
        f"{found([NO_EVENTS], *tried)} of the attractors in the four cases with the stiffer walls. "
        f"The exact law with initial conditions shifted by 1 nm finds {found(itself, *tried)}, "
        f"which is the limit for any law. If a method needs a smooth force, use tanh: with "
        f"ε · (half of the gap) = {1e6 * small:.0f} (ε = 1e6 /m) it finds "
        f"{found(['tanh-1e6'], *tried)}, arctan {found(['arctan-1e6'], *tried[:3])} and log-arctan "
        f"{found(['logarctan-1e6'], *tried[:3])} in the first three cases.",
        f"ε · (half of the gap) = {1e4 * small:.0f} is sufficient for walls softer than the spring "
        f"({found(weak, VERY_SOFT_SYMMETRIC)}), {1e4 * large:.0f} for gaps that motions hardly "
        f"cross ({SOFT_LARGE[1]} mm, {found(weak, SOFT_LARGE)}). 4 is insufficient for walls of "
        f"{times[0]} times the spring's stiffness ({found(weak, *tried[:2])}) and of {times[1]} "
        f"times ({found(weak, HARD_SYMMETRIC)}), where tanh has false potential wells below "
        f"ε = {wells} /m.",
        f"Use polynomials and rational fits only for the softest wall "
        f"({found(WEAK[:2], VERY_SOFT_SYMMETRIC)}); at the hardest they find "
        f"{found((*WEAK[:2], *STRONG[:2]), HARD_SYMMETRIC)}.",
        f"At hard contact and 0/0.8 mm the limit is the sensitivity to initial conditions: the "
        f"exact law shifted by 1 nm finds {found(itself, HARD_ASYMMETRIC)} of the attractors, tanh "
        f"with ε = 1e9 /m {found(['tanh-1e9'], HARD_ASYMMETRIC)} and with ε = 1e6 /m "
        f"{found(['tanh-1e6'], HARD_ASYMMETRIC)}.",
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
