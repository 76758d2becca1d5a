"""The answer from a run: sentences for README, docs/answer.md and the report.

No sentence has a processor time, which differs from run to run, or numbers of two programs.
"""

from collections.abc import Iterable
from contextlib import suppress

from gapsweep.analysis.claims import NotInRunError, Run
from gapsweep.report.tables import percent
from gapsweep.report.verdicts import Contact, contacts

from .language import At
from .measures import distance
from .refined import TRUTH
from .scenes import (
    EXACT,
    HARD_ASYMMETRIC,
    HARD_SYMMETRIC,
    LARGE_ENDS,
    NO_EVENTS,
    SOFT_ASYMMETRIC,
    SOFT_SYMMETRIC,
    STARTS,
    Case,
)

# benchmarks/one_method.py, scipy's RK45 from both initial conditions, 55 frequencies: how many
# times the error falls.
SCIPY_BY_MODE, SCIPY_AS_WRITTEN = (12.0, 27.0), (1.7, 3.1)
ENOUGH = 1e-3  # force error over the forcing, as `gapsweep advise` demands
SHARPNESS = 30.0  # epsilon of tanh in K_c over the forcing
FITS = ("poly", "ratpoly")


def judged(run: Run) -> list[Contact]:
    """The verdicts in every case; of the gaps that Fig. 6a may have, the middle one counts."""
    every = contacts(run["agreement"], run["static"])
    return [one for one in every if one.gap not in LARGE_ENDS]


def answer(run: Run) -> list[str]:
    """Sentences, the first two of which hold for any machine.

    Raises
    ------
    NotInRunError
        If the run lacks one of the numbers.
    """

    def share(law: str, *cases: Case) -> str:
        """Shares of the exact law's attractors that a law finds, in percent."""
        shares = [
            run.scene("agreement", law, *case, "recall_pooled")["recall_pooled"].sel(regime="all")
            for case in cases
        ]
        return f"{spread([100.0 * float(share) for share in shares], '.0f')} %"

    tried = (SOFT_ASYMMETRIC, SOFT_SYMMETRIC, HARD_SYMMETRIC, HARD_ASYMMETRIC)
    by_mode, as_written = gains(run)
    found, shifted = judged(run), f"{EXACT}@jitter"
    fits = ", ".join(one.place for one in found if count([one], *FITS) == "1")
    return [
        f"Write the contact force by contact mode, locate every contact and switch the mode there: "
        f"at the paper's rtol of 1e-4 the error after four forcing periods is "
        f"{spread(by_mode, '.0f')} times smaller than without location (hard contact, 0/0.8 mm). "
        f"Location with the force as one expression of x (the paper's Eq. 1b) makes it "
        f"{spread(as_written, '.1f')} times smaller. With scipy's RK45 the factors are "
        f"{spread(SCIPY_BY_MODE, '.0f')} by mode and {spread(SCIPY_AS_WRITTEN, '.1f')} with one "
        f"expression.",
        f"A smooth law is accurate enough if its force error, the root mean square over the "
        f"displacements that occur, is below {percent(ENOUGH)} of the forcing p; for tanh, "
        f"ε ≥ {SHARPNESS:.0f} K_c/p is enough.{_by_the_rule(run, found)} gapsweep advise computes "
        f"the smallest ε, γ or degree for any machine.",
        f"In this study tanh with a suitable ε is accurate enough in {count(found, 'tanh')} of "
        f"the {len(found)} cases, arctan in {count(found, 'arctan')}, polynomials and rational "
        f"fits in {count(found, *FITS)}{f' ({fits})' * bool(fits)}.",
        f"Without located contacts, use the exact force with tight tolerances: it finds "
        f"{share(NO_EVENTS, *tried)} of the attractors in the four cases with the stiffer walls. "
        f"For comparison: the exact law with initial conditions shifted by 1 nm finds "
        f"{share(shifted, *tried)}.",
    ]


def _by_the_rule(run: Run, found: list[Contact]) -> str:
    """How laws of the study on both sides of the rule are judged; empty without force errors."""
    sides: dict[bool, list[tuple[bool, str]]] = {True: [], False: []}
    for contact in found:
        for law in (law for law in contact.laws if law.is_approximation):
            with suppress(NotInRunError):
                at = run.scene("static", law.law, contact.K_c, contact.gap, "force_error_ratio")
                side = sides[bool(at["force_error_ratio"] <= ENOUGH)]
                side.append((law.column == "use", contact.place))
    below, above = (sum(is_good for is_good, _ in side) for side in sides.values())
    places = " and ".join(dict.fromkeys(place for is_good, place in sides[True] if not is_good))
    return (
        f" In this study {below} of {len(sides[True])} laws up to {percent(ENOUGH)} are accurate "
        f"enough{f' (others: {places})' * bool(places)}; above it, {above} of {len(sides[False])}."
    ) * any(sides.values())


def count(found: Iterable[Contact], *families: str) -> str:
    """In how many cases a law of some families is accurate enough, and in how many undecided."""
    n, n_open = 0, 0
    for contact in found:
        laws = [one for one in contact.laws if one.law.family in families]
        is_suited = any(one.column == "use" for one in laws)
        n += is_suited
        n_open += not is_suited and any("use" in one.possible for one in laws)
    return f"{n}{f' ({n_open} undecided)' * bool(n_open)}"


def gains(run: Run) -> tuple[list[float], list[float]]:
    """How many times the error falls by location: force by mode, and as one expression."""
    return _nearer(run, "paper-mode"), _nearer(run, "paper")


def _nearer(run: Run, protocol: str) -> list[float]:
    """How many times the error of unlocated contacts is that of located ones, from each start."""
    apart = distance(f"{NO_EVENTS}@paper", TRUTH) / distance(f"{EXACT}@{protocol}", TRUTH)
    ((_, read),) = apart.parts
    return [10.0 ** read(At(run, {"start": start})).value for start in STARTS]


def spread(numbers: Iterable[float], form: str) -> str:
    """The least and the largest of some numbers, in words."""
    return " to ".join(dict.fromkeys(f"{end:{form}}" for end in (min(numbers), max(numbers))))
