"""The section on the claims of a study: their verdicts and tests, from ``claims.json``."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Part
from gapsweep.report.tables import VERDICTS, number, tally


def sections(inputs: Inputs) -> Iterator[Part]:
    """The list of claims, and counts of their verdicts."""
    if (claims := inputs.claims) is None:
        return
    tallies = {"": claims["counts"], **claims.get("otherwise", {})}
    sentences = [f"{words}{': ' * bool(words)}{tally(n)}." for words, n in tallies.items()]
    content = {"verdicts": VERDICTS, "rows": list(claim_rows(claims))}
    yield Part("claims", "Claims", sentences, content=content)


def claim_rows(decided: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Rows of the list from ``claims.json``, with tests as texts."""
    for claim in decided["claims"]:
        tests = [
            {
                "says": test["says"],
                "outcome": outcome(test),
                "floor": number(test["floor"]) if test["floor"] else "–",
                "n": test["n"],
            }
            for test in claim["tests"]
        ]
        yield {
            **claim,
            "sign": _SIGNS[claim["verdict"]],
            "open": _open(claim["tests"]),
            "tests": tests,
        }


def _open(tests: Sequence[Mapping[str, Any]]) -> str:
    """Text on undecided tests of a claim, if all other tests hold; else empty."""
    outcomes = [test["holds"] for test in tests]
    if {None, True} != set(outcomes):
        return ""
    return f"{outcomes.count(None)} of {len(outcomes)} tests undecided, none failed"


def outcome(test: Mapping[str, Any]) -> str:
    """The outcome of a test of ``claims.json``, in a few words."""
    value, threshold = (
        "no finite number" if test[name] is None else number(test[name])
        for name in ("value", "threshold")
    )
    wanted = f"{_SHOWN_AS.get(test['op'], test['op'])} {threshold}"
    if test["holds"] is not None:
        return f"{value} {wanted} holds" if test["holds"] else f"{value}, not {wanted}"
    if None in (test["value"], test["threshold"]):
        return f"undecided: {value}, required {wanted}"
    return f"undecided: {value} is within its uncertainty of {wanted}"


_SHOWN_AS = {"<=": "≤", ">=": "≥"}
_SIGNS = {"confirmed": "✓", "refuted": "✗", "partly": "◐", "undecidable": "?"}
