"""Write what a run of the paper's study answers into docs/answer.md and README.md.

    python benchmarks/answer.py RUN_DIR

From agreement.nc and static.nc of the run; the README has the same table between its markers.
"""

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import gapsweep as gs
from gapsweep.report.answer import Contact, contacts, in_words, times
from gapsweep.report.tables import percent

ROOT = Path(__file__).parents[1]
MARKS = re.compile("(<!-- answer -->\n).*?(<!-- /answer -->\n)", re.DOTALL)
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
Every number is the cost: processor time per forcing period over that of the exact law, on the same
fixed starts, with the solver of the study; above 1 × a law costs *more* than the exact one, ≈ 1 ×
cannot be told from it, and where the 95 % interval reaches far to both sides of 1 × it stands in
place of the number. It covers the choice of frequencies and how far prices of exact against exact
are from 1, in all contacts together. Another solver has other prices: this one
locates contacts inside its steps, which makes the exact law cheap. A law that a row does not name
was not swept there, or failed throughout. Nothing is judged (–) where the exact law has no steady
response, or touches no wall.

- **use**: 95 % of the amplitudes lie within 5 %, the thickness of a plotted line, and 95 % of the
  exact law's attractors are found; or both as often as by the exact law against itself, under
  tighter tolerances or from starts moved by at most 10 nm.
- **with care**: half of the amplitudes within 5 % and half of the attractors found, which *use*
  asks too. **no**: less.
- **exact here**: in neither worse than the exact law against itself; counted as *use*.
- **±**: the 95 % intervals, its own and those of exact against exact, leave open on which side of a
  line it lies, or the frequencies are too few for any.
- **tanh: one well**: where tanh has no false static equilibrium. That is needed and not enough:
  beside it stands the least ε of this study that may be used.
- `piecewise-noevents` is the exact force, contacts not located: no stand-in; it shows what locating
  them saves. Nor is `auto` one, which takes the exact law where it must.
"""
BEHIND = """\
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
            times(one.price),
            f"{times(one.low)} to {times(one.high)}",
            times(one.periodic_price),
        ]
        for one in contact.laws
    ]
    floors = [percent(contact.floors[name][0]) for name in ("median", "p95", "found")]
    rows.append(["exact against exact", "", *floors, times(contact.floor_price), "", ""])
    return f"### {contact.place}\n\n{table(NUMBERS, rows)}"


def main(folder: Path) -> None:
    agreement, static = (gs.open(folder / name) for name in ("agreement.nc", "static.nc"))
    found = contacts(agreement, static)
    first, *rest = in_words(found)
    headline = f"**{first}** {' '.join(rest)}\n\n{table(HEAD, lines(found))}"
    about = agreement.attrs
    made = (
        f"Made by `python benchmarks/answer.py` from the run of study `{about['study']}` of "
        f"{about['created'][:10]}, numerics {about['numerics_fingerprint']}, on "
        f"{about['machine']}."
    )
    page = f"# Which law, where, at what price\n\n{headline}\n{HOW}\n{made}\n\n{BEHIND}\n"
    page += "\n".join(map(numbers, found))
    (ROOT / "docs" / "answer.md").write_text(page.rstrip("\n") + "\n")
    readme = ROOT / "README.md"
    text, n_marked = MARKS.subn(lambda m: m[1] + headline + m[2], readme.read_text())
    if n_marked != 1:
        raise ValueError(f"{readme}: {n_marked} places marked <!-- answer -->, not 1")
    readme.write_text(text)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
