"""Write what a run of the paper's study answers into docs/answer.md and README.md.

    python benchmarks/answer.py RUN_DIR

From the datasets and claims.json of the run. What is written stands between markers, but for
docs/answer.md, which is written whole.
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
HEAD = ["contact", "✓ use", "◐ with care", "✗ no", "tanh: one well", "tanh: use from ε [1/m]"]
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
Columns are contacts: stiffness [N/m] and gap [mm]. Within 5 % means of the exact law's amplitude,
or of half of the gap where that is larger. Blank: not swept there, or failed throughout.

- **use**: 95 % of the amplitudes lie within 5 %, the thickness of a plotted line, and 95 % of the
  exact law's attractors are found; or both as often as by the exact law against itself, under
  tighter tolerances or from starts moved by at most 10 nm.
- **with care**: half of the amplitudes within 5 % and half of the attractors found, which *use*
  asks too. **no**: less.
- **exact here**: in neither worse than the exact law against itself; counted as *use*.
- **±**: the 95 % interval of the law or of the exact law with other settings includes a threshold,
  or there are too few frequencies for intervals.
- **tanh: one well**: where tanh has no false static equilibrium. That is needed and not enough:
  beside it stands the least ε of this study that may be used.
- `piecewise-noevents` is the exact force, contacts not located: no approximation; it shows what
  locating them saves. Nor is `auto` one, which takes the exact law where it must.
"""
COSTS = """\
The cost of a law is stated in three ways, which must not be mixed:

- (a) one Runge-Kutta pair (Dormand and Prince's), contacts of the exact law located and restarted:
  Table 2 of the paper's report, from both of the paper's initial conditions; without restarts:
  [one method](benchmarks.md);
- (b) this engine's default for each law, a Taylor series for the exact law against an explicit
  Runge-Kutta method of order 8: the costs below;
- (c) scipy's `solve_ivp`, the exact law with terminal events and restarts: the same page.

"""
BEHIND = """\
Every number is the cost (b): processor time per forcing period over that of the exact law, on the
same fixed starts; above 1 × a law costs *more* than the exact one, ≈ 1 × cannot be told from it,
and where the 95 % interval reaches far to both sides of 1 × it stands in place of the number. It
covers the choice of frequencies and how far the exact law with other settings is from 1, in all
contacts together. Nothing is judged (–) where the exact law has no steady response, or touches no
wall.

## The numbers behind

Errors are those of attractors paired one to one, over frequencies; with one start per frequency, of
the response from it. Found: of the exact law's attractors, over frequencies. Cost: of all motions
together, of which the few that are chaotic run longest and weigh most; periodic: where the exact
law is.
"""


def lines(found: Sequence[Contact]) -> Iterator[list[str]]:
    """The table as texts: a contact, the laws by what may be done with them, tanh."""
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
    """All that a verdict rests on, in one contact."""
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
    """Laws by contacts, a sign each."""
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
    page += f"## By contact\n\n{COSTS}{' '.join(in_words(found))}\n\n{table(HEAD, lines(found))}\n"
    page += f"{BEHIND}\n"
    page += "\n".join(map(numbers, every))
    (ROOT / "docs" / "answer.md").write_text(page.rstrip("\n") + "\n")
    claims = json.loads((folder / "claims.json").read_text())
    counts = ", ".join(f"{claims['counts'][verdict]} {verdict}" for verdict in VERDICTS)
    written(ROOT / "README.md", "answer", finding(found, about["machine"]))
    written(ROOT / "README.md", "claims", counts)
    written(ROOT / "README.md", "run", f"{about['created'][:10]}, {about['numerics_fingerprint']}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
