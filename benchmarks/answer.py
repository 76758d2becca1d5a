"""Write docs/answer.md and the main finding of README.md from a run of the paper's study.

    python benchmarks/answer.py RUN_DIR

Reads the datasets and claims.json of the run; in README.md replaces the text between markers.
"""

import json
import math
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

import gapsweep as gs
from gapsweep.analysis.claims import VERDICTS, NotInRunError, Run
from gapsweep.model.labels import Representation
from gapsweep.report.scales import plain
from gapsweep.report.tables import percent
from gapsweep.report.verdicts import SIGNS, Contact, Judged, contacts, times, verdict

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
from workflows.paper.answer import (  # noqa: E402
    ENOUGH,
    FITS,
    SCIPY_AS_WRITTEN,
    SCIPY_BY_MODE,
    SHARPNESS,
    answer,
    count,
    gains,
    judged,
    spread,
)
from workflows.paper.language import At  # noqa: E402
from workflows.paper.measures import cost  # noqa: E402
from workflows.paper.scenes import EXACT, NO_EVENTS, STRONG, TABLE_CASES, WEAK  # noqa: E402

RULE = "explanation/rule.md"
PICTURE = "![Share of attractors found over the force error](images/rule.png)"
FAMILIES = ("tanh", "arctan", "logarctan", "poly", "ratpoly")
NUMBERS = [
    "law",
    "verdict",
    "force error / forcing",
    "error, median",
    "95 %",
    "attractors found",
    "cost",
    "95 % interval",
    "periodic",
]
SIGNS_SAY = """\
A column is a case: contact stiffness [N/m] and gap [mm]. A cell has the 95th percentile of the
amplitude error and the share of the exact law's attractors that are found, both in percent; the
number in bold decides. Blank: not computed, or failed at all frequencies.

- **The rule**: ✓ use: error up to 5 % and 95 % found; ◐ with care: 20 % and 80 %; ✗ no: worse.
- **= exact here**: neither number is worse than for the exact law with tighter tolerances, or with
  initial conditions shifted by at most 10 nm; counts as *use*. No law with a median error below 5 %
  has to be better than that for a verdict.
- **±**: the 95 % interval includes a threshold, or there are too few frequencies for an interval.
- **Smallest adequate ε**: 1e5: the next smaller one of this study is not adequate; ≤: no smaller
  one was tried (below 3e3 /m the layer 1/ε is as wide as half of the gap of 0.4/0.4 mm); >: none is
  adequate up to this.
- **tanh: one well**: ε above which tanh has no false equilibrium, which is necessary and not
  sufficient.
- `piecewise-noevents` is the exact force without located contacts. It is no approximation: it shows
  the saving by location.
- Errors are relative to the amplitude of the exact law, or to half of the gap where that is larger.
"""
COSTS = """\
## Costs

A cost is measured in three ways, each relative to the exact law with the same program.

**(a) One Runge–Kutta pair** (Dormand and Prince, step control of `ode45`, the paper's tolerances)
for all laws, contacts of the exact law located and restarted: right-hand sides, which do not differ
from run to run. For times with this pair see [one method](benchmarks.md).

"""
OF_DEFAULTS = """
**(b) The default solver of gapsweep for each law**, a Taylor series for the exact law and tanh, an
explicit Runge–Kutta method of order 8 for the others: processor time per forcing period, the 95 %
interval from the choice of frequencies and the repeatability of timings in this run. In runs of
six versions of the code, with equal errors and shares, on one machine, ratios differed by up to a
factor of 2.1. "?": no interval.

"""
OF_SCIPY = """
**(c) scipy's `solve_ivp`** with terminal events and restarts for the exact law: smooth tangent laws
take 0.34 to 0.74 times the time of the exact law (typed in from [one method](benchmarks.md), where
every ratio has its range over nine rounds).

## All numbers

Errors: of attractors paired one to one, over all frequencies; with one initial condition per
frequency, of its response. Found: share of the exact law's attractors. Cost: (b), of all motions; a
few chaotic ones run longest. Periodic: cost where the exact law is periodic.
"""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "".join(f"| {' | '.join(row)} |\n" for row in [head, ["---"] * len(head), *rows])


def numbers(run: Run, contact: Contact) -> str:
    """The numbers behind the verdicts in one case, as a table."""
    place = contact.K_c, contact.gap
    rows = [
        [
            f"`{one.law}`",
            f"{one.verdict}{'' if one.is_firm else ' ±'}",
            force_error(run, one.law, *place),
            percent(one.values["median"][0]),
            percent(one.values["p95"][0]),
            f"{percent(one.values['found'][0])} of {one.n_exact}",
            times(one.cost_ratio),
            f"{times(one.low)} to {times(one.high)}",
            times(one.periodic_cost_ratio),
        ]
        for one in in_order(contact.laws)
    ]
    floors = [percent(contact.floors[name][0]) for name in ("median", "p95", "found")]
    rows.append(
        ["exact law, other settings", "", "", *floors, times(contact.floor_cost_ratio), "", ""]
    )
    return f"### {contact.place}\n\n{table(NUMBERS, rows)}"


def force_error(run: Run, law: str, K_c: float, gap: str) -> str:
    """The force error of a law over the forcing; empty for the exact force and in runs without."""
    try:
        at = run.scene("static", law, K_c, gap, "force_error_ratio")
    except NotInRunError:
        return ""
    return f"{float(at['force_error_ratio']):.2g}" if law != NO_EVENTS else ""


def in_order(laws: Iterable[Judged]) -> list[Judged]:
    """Laws by family, the smallest parameter first; the exact force without location last."""

    def key(one: Judged) -> tuple[int, float, str]:
        law = Representation(one.law)
        if law.family not in FAMILIES:
            return len(FAMILIES), 0.0, law
        return FAMILIES.index(law.family), float(law.parameter.split("/")[0]), law

    return sorted(laws, key=key)


def cell(one: Judged, contact: Contact) -> str:
    """The verdict of a law, and both numbers; the one that decides is bold unless it is "use"."""
    error, share = (one.values[name][0] for name in ("p95", "found"))
    shown = [_percent(error), _percent(share)]
    if one.column != "use":
        known = {name: value[:1] for name, value in one.values.items()}
        floors = {name: value[:1] for name, value in contact.floors.items()}
        for i, perfect in enumerate(({"found": np.ones(1)}, {"p95": np.zeros(1)})):
            if verdict(known | perfect, floors) == [one.verdict]:
                shown[i] = f"**{shown[i]}**"
    return f"{SIGNS[one.verdict]}{'' if one.is_firm else ' ±'} {' / '.join(shown)}"


def _percent(number: float) -> str:
    if not np.isfinite(number):
        return "–"
    if 0.0 < number < 1e-4:
        return "<0.01"
    return f"{100.0 * number:{'.2g' if number < 0.0995 else '.0f'}}"


def by_law(found: Sequence[Contact], text: Callable[[Judged, Contact], str]) -> list[list[str]]:
    """A row for each law, with a text for each case."""
    laws = {one.law: one for contact in found for one in contact.laws}
    return [
        [
            f"`{law.law}`",
            *(next((text(o, c) for o in c.laws if o.law == law.law), "") for c in found),
        ]
        for law in in_order(laws.values())
    ]


def signs(found: Sequence[Contact]) -> str:
    """Verdicts of laws over cases, and the smallest adequate parameters."""
    rows = by_law(found, cell)
    for family in FAMILIES[:2]:
        rows.append(
            [
                f"{family}: smallest adequate ε [1/m]",
                *(one.least(family) or "not tried" for one in found),
            ]
        )
    rows.append(["tanh: one well [1/m]", *(one.threshold for one in found)])
    return table(heads(found), rows)


def heads(found: Sequence[Contact]) -> list[str]:
    return ["", *(f"{plain(one.K_c)}, {one.gap}" for one in found)]


def interval(one: Judged, _: Contact) -> str:
    """The interval of a cost ratio."""
    if not np.isfinite(one.cost_ratio):
        return "–"
    ends = [one.low, one.high] if np.isfinite(one.low) else [one.cost_ratio]
    return f"{spread(ends, '.2g')} ×" + " ?" * bool(np.isnan(one.low))


def costs(run: Run, found: Sequence[Contact]) -> str:
    """The costs, each with its solver."""
    rows = [
        [case, f"`{law}`", f"{ratio:.2f}"]
        for case, ratios in zip(("soft", "hard"), work(run), strict=True)
        for law, ratio in ratios.items()
    ]
    work_ = table(["contact, 0.4/0.4 mm", "law", "right-hand sides over the exact law's"], rows)
    return f"{COSTS}{work_}{OF_DEFAULTS}{table(heads(found), by_law(found, interval))}{OF_SCIPY}"


def finding(run: Run) -> str:
    """The main finding in sixty words, true for scipy and for gapsweep."""
    by_mode, as_written = gains(run)
    least, most = min(*by_mode, *SCIPY_BY_MODE), max(*as_written, *SCIPY_AS_WRITTEN)
    least -= least % 10.0 ** math.floor(math.log10(least))
    found = judged(run)
    return (
        f"Locate contacts and write the force by contact mode: errors after four periods fall at "
        f"least {least:.0f}-fold; with one expression, at most {math.ceil(most)}-fold. A smooth "
        f"law is [accurate](docs/answer.md) if its force error is below {percent(ENOUGH)} of the "
        f"forcing (tanh: ε ≥ {SHARPNESS:.0f} K_c/p suffices). Among the paper's {len(found)} "
        f"cases, tanh suits {count(found, 'tanh')}; polynomials and rational fits suit "
        f"{count(found, *FITS)}."
    )


def work(run: Run) -> list[dict[str, float]]:
    """Right-hand sides of each grade's laws over the exact law's, by one Runge-Kutta pair."""
    of = [
        {law: (f"{law}@paper", f"{EXACT}@paper", case) for law in laws}
        for laws, case in zip((WEAK, STRONG), TABLE_CASES.values(), strict=True)
    ]
    at = At(run, {})
    return [
        {n: read(at).value for n, read in cost("right-hand sides", "nfev", one).parts} for one in of
    ]


def page(run: Run) -> str:
    """docs/answer.md."""
    found, about = judged(run), run["agreement"].attrs
    first, *others = answer(run)
    said = "".join(f"{n}. {line}\n" for n, line in enumerate([f"**{first}**", *others], 1))
    has_rule = (ROOT / "docs/images/rule.png").exists()
    picture = f"{PICTURE}\n\n[The rule: how it was found and tested, where it fails]({RULE})\n\n"
    made = (
        f"Made by `python benchmarks/answer.py` from the run of study `{about['study']}` of "
        f"{about['created'][:10]}, numerics {about['numerics_fingerprint']}, on "
        f"{about['machine']}."
    )
    every = contacts(run["agreement"], run["static"])
    return (
        f"# Which contact law is accurate enough, and its cost\n\n{said}\n{picture * has_rule}"
        f"{signs(found)}\n{SIGNS_SAY}\n{made}\n\n{costs(run, found)}\n"
        f"{chr(10).join(numbers(run, one) for one in every)}"
    )


def written(page: Path, name: str, text: str) -> None:
    """Put a text between the markers of a page."""
    marks = re.compile(f"(<!-- {name} -->\n?).*?(<!-- /{name} -->)", re.DOTALL)
    changed, n = marks.subn(lambda m: m[1] + text + m[2], page.read_text())
    if n != 1:
        raise ValueError(f"{page}: {n} places marked <!-- {name} -->, not 1")
    page.write_text(changed)


def main(folder: Path) -> None:
    run = Run({path.stem: gs.open(path, lazy=True) for path in folder.glob("*.nc")})
    about = run["agreement"].attrs
    (ROOT / "docs" / "answer.md").write_text(page(run).rstrip("\n") + "\n")
    claims = json.loads((folder / "claims.json").read_text())
    tallies = {"from +0.4 mm": claims["counts"], "from rest": claims["otherwise"]["from rest"]}
    counts = "; ".join(
        f"{start} {', '.join(f'{found[verdict]} {verdict}' for verdict in VERDICTS)}"
        for start, found in tallies.items()
    )
    written(ROOT / "README.md", "answer", f"{finding(run)}\n")
    for place in ("README.md", "docs/explanation/claims.md"):
        written(ROOT / place, "claims", counts)
    written(ROOT / "README.md", "run", f"{about['created'][:10]}, {about['numerics_fingerprint']}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
