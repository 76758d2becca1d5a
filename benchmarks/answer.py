"""Write docs/answer.md and the main finding of README.md from a run of the paper's study.

    python benchmarks/answer.py RUN_DIR

Reads the datasets and claims.json of the run; in README.md replaces the text between markers.
"""

import json
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import gapsweep as gs
from gapsweep.analysis.claims import VERDICTS, Run
from gapsweep.report.answer import SIGNS, Contact, contacts, in_words, times
from gapsweep.report.scales import plain
from gapsweep.report.tables import percent

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
from workflows.paper.answer import answer  # noqa: E402
from workflows.paper.scenes import LARGE_ENDS  # noqa: E402

STIFFNESS = 2961.0  # of the spring of the paper's oscillator [N/m]
HEAD = ["case", "✓ use", "◐ with care", "✗ no", "tanh: one well", "tanh: use from ε [1/m]"]
NUMBERS = [
    "law",
    "verdict",
    "error, median",
    "95 %",
    "attractors found",
    "cost",
    "95 % interval",
    "periodic",
]
HOW = """\
A column is a case: contact stiffness [N/m] and gap [mm]. A blank cell was not computed or failed at
all frequencies. Errors are relative to the amplitude of the exact law, or to half of the gap where
that is larger.

- **✓ use**: 95 % of the amplitudes have an error below 5 % (the thickness of a plotted line), and
  95 % of the exact law's attractors are found. A law that is as close to the exact law as the exact
  law is with tighter tolerances, or with initial conditions shifted by at most 10 nm, counts too.
- **◐ with care**: half of the amplitudes and half of the attractors. **✗ no**: less.
- **= exact here**: not distinguishable from the exact law with other settings; counts as *use*.
- **±**: the 95 % interval includes a threshold, or there are too few frequencies for an interval.
- **tanh: one well**: ε above which tanh has no false equilibrium. The next column has the smallest
  ε of this study with the verdict *use*: one well is necessary and not sufficient.
- `piecewise-noevents` is the exact force without located contacts. It is no approximation: it shows
  the saving by location. `auto` takes the exact law where needed and is no approximation either.
"""
COSTS = """\
The cost of a law is measured in three ways, which must not be mixed:

- (a) with one Runge-Kutta pair (Dormand and Prince) for all laws; the exact law is located and
  restarted: Table 2 of the report of the paper's study; without restarts:
  [one method](benchmarks.md);
- (b) with the default solver of gapsweep for each law, a Taylor series for the exact law and tanh,
  an explicit Runge-Kutta method of order 8 for the others: the costs on this page;
- (c) with scipy's `solve_ivp`, terminal events and restarts for the exact law: [one
  method](benchmarks.md).

"""
BEHIND = """\
Numbers are costs (b): processor time per forcing period over that of the exact law, for the same
initial conditions. Above 1 × a law costs *more* than the exact law; ≈ 1 × is not distinguishable
from it. If the 95 % interval is wide on both sides of 1 ×, the interval replaces the number. The
interval covers the choice of frequencies and the repeatability of timings. A dash (–) marks cases
in which the exact law has no steady response or touches no wall.

## All numbers

Errors: of attractors paired one to one, over all frequencies; with one initial condition per
frequency, of its response. Found: share of the exact law's attractors. Cost: of all motions; a few
chaotic ones run longest. Periodic: cost where the exact law is periodic.
"""


def lines(found: Sequence[Contact]) -> Iterator[list[str]]:
    """Rows of the table: a case, its laws by verdict, thresholds of tanh."""
    for one in found:
        columns = [
            ", ".join(f"{law.name} {law.cost}" for law in laws) or ("–" if one.unjudged else "none")
            for laws in one.columns.values()
        ]
        yield [one.place, *columns, one.threshold, "–" if one.unjudged else one.least_tanh]


def table(head: Sequence[str], rows: Iterator[list[str]] | list[list[str]]) -> str:
    """A table in Markdown."""
    return "".join(f"| {' | '.join(row)} |\n" for row in [head, ["---"] * len(head), *rows])


def numbers(contact: Contact) -> str:
    """The numbers behind the verdicts in one case, as a table."""
    rows = [
        [
            f"`{one.law}`",
            f"{one.verdict}{'' if one.is_firm else ' ±'}",
            percent(one.values["median"][0]),
            percent(one.values["p95"][0]),
            f"{percent(one.values['found'][0])} of {one.n_exact}",
            times(one.cost_ratio),
            f"{times(one.low)} to {times(one.high)}",
            times(one.periodic_cost_ratio),
        ]
        for one in contact.laws
    ]
    floors = [percent(contact.floors[name][0]) for name in ("median", "p95", "found")]
    rows.append(["exact law, other settings", "", *floors, times(contact.floor_cost_ratio), "", ""])
    return f"### {contact.place}\n\n{table(NUMBERS, rows)}"


def signs(found: Sequence[Contact]) -> str:
    """Verdicts of laws over cases, a symbol a cell."""
    laws = dict.fromkeys(law.law for one in found for law in one.laws)
    rows = []
    for law in laws:
        here = [next((of for of in one.laws if of.law == law), None) for one in found]
        cells = [f"{SIGNS[of.verdict]}{'' if of.is_firm else ' ±'}" if of else "" for of in here]
        rows.append([f"`{law}`", *cells])
    return table(["", *(f"{plain(one.K_c)}, {one.gap}" for one in found)], rows)


def finding(found: Sequence[Contact], machine: str) -> str:
    """The main finding, in three sentences with rounded numbers."""
    usable = [[law for law in one.columns["use"] if law.is_approximation] for one in found]

    def count(*families: str) -> int:
        return sum(any(law.law.startswith(families) for law in laws) for laws in usable)

    costs = [law.cost_ratio for laws in usable for law in laws]
    softest, hardest = found[0].K_c / STIFFNESS, found[-1].K_c / STIFFNESS
    return (
        f"In the built-in study (mass 3 kg, spring 2961 N/m, walls {softest:.1f} to {hardest:.0f} "
        "times as stiff as the spring), a tanh law of suitable sharpness is accurate enough in "
        f"{count('tanh')} of {len(found)} pairs of stiffness and gap, a polynomial or rational fit "
        f"in {count('poly', 'ratpoly')}. Accurate smooth laws take {min(costs):.0f} to "
        f"{max(costs):.0f} times the processor time of the exact law ({machine}). So take the "
        "exact law where contacts can be located; [all verdicts and costs](docs/answer.md).\n"
    )


def written(page: Path, name: str, text: str) -> None:
    """Put a text between the markers of a page."""
    marks = re.compile(f"(<!-- {name} -->\n?).*?(<!-- /{name} -->)", re.DOTALL)
    changed, n = marks.subn(lambda m: m[1] + text + m[2], page.read_text())
    if n != 1:
        raise ValueError(f"{page}: {n} places marked <!-- {name} -->, not 1")
    page.write_text(changed)


def main(folder: Path) -> None:
    run = Run({path.stem: gs.open(path) for path in folder.glob("*.nc")})
    every = contacts(run["agreement"], run["static"])
    found = [one for one in every if one.gap not in LARGE_ENDS]  # the gap of Fig. 6a counts once
    first, *others = answer(run)
    lines_ = "".join(f"{n}. {line}\n" for n, line in enumerate([f"**{first}**", *others], 1))
    headline = f"{lines_}\n{signs(found)}"
    about = run["agreement"].attrs
    made = (
        f"Made by `python benchmarks/answer.py` from the run of study `{about['study']}` of "
        f"{about['created'][:10]}, numerics {about['numerics_fingerprint']}, on "
        f"{about['machine']}."
    )
    page = f"# Which contact law is accurate enough, and its cost\n\n{headline}\n{HOW}\n{made}\n\n"
    page += f"## By case\n\n{COSTS}{' '.join(in_words(found))}\n\n{table(HEAD, lines(found))}\n"
    page += f"{BEHIND}\n"
    page += "\n".join(map(numbers, every))
    (ROOT / "docs" / "answer.md").write_text(page.rstrip("\n") + "\n")
    claims = json.loads((folder / "claims.json").read_text())
    tallies = {"from +0.4 mm": claims["counts"], "from rest": claims["otherwise"]["from rest"]}
    counts = "; ".join(
        f"{start} {', '.join(f'{found[verdict]} {verdict}' for verdict in VERDICTS)}"
        for start, found in tallies.items()
    )
    written(ROOT / "README.md", "answer", finding(found, about["machine"]))
    for place in ("README.md", "docs/explanation/claims.md"):
        written(ROOT / place, "claims", counts)
    written(ROOT / "README.md", "run", f"{about['created'][:10]}, {about['numerics_fingerprint']}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
