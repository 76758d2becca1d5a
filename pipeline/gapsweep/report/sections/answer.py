"""The section at the head of the report: which contact law to use, and its cost.

The answer in words, as a map of all laws in all cases, as one figure, and the numbers behind it. A
study's own answer comes before that of the rules.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.dimensions import REPRESENTATION, SWEPT, by_coordinate
from gapsweep.model.labels import EXACT
from gapsweep.report.backdrop import caption_of_walls
from gapsweep.report.drawing import caption_of_marks
from gapsweep.report.figure_data import Choice
from gapsweep.report.figures import compared_with_exact, peaks_of_laws
from gapsweep.report.heat import GROUPS, MANY, cells, heads, swept_columns
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Figured, Part
from gapsweep.report.scenes import Scenes, starts_of, swept
from gapsweep.report.sections.findings import unreached_walls
from gapsweep.report.sections.own import answer_of
from gapsweep.report.tables import VERDICTS, percent
from gapsweep.report.verdicts import (
    LIMITS,
    SIGNS,
    Contact,
    Judged,
    how_many,
    in_words,
    telling,
    times,
)

# Cases and points that the page of a figure holds: seconds to make, a megabyte of text.
_MOST_CHOICES, _MOST_VALUES = 200, 200_000
_MOST_LISTED = 400  # cases with their numbers on the page


def sections(inputs: Inputs) -> Iterator[Part]:
    """The study's own answer, and verdicts on the laws of a study that has the exact law."""
    own, found, responses = answer_of(inputs), inputs.cases, inputs.responses
    if not (found or own.sentences or own.tables or own.figures):
        return
    said = in_words(found)
    headline = [*own.sentences] or said[:1]
    is_mostly_free = 2 * sum(bool(one.unjudged) for one in found) >= len(found)
    is_compared = inputs.agreement is not None
    if is_compared and is_mostly_free and (far := unreached_walls(responses)):
        headline[:1] = [" ".join([far, *headline[:1]])]
    counts = inputs.claims["counts"] if inputs.claims else {}
    content = {
        "counts": {verdict: counts[verdict] for verdict in VERDICTS if counts.get(verdict)},
        "map": _map(responses, found) if found else None,
        "sentences": said if own.sentences else said[1:],
        "numbers": list(map(_numbers, telling(found, _MOST_LISTED))),
    }
    figures = [*_compared(inputs), *own.figures]
    yield Part("answer", "Answer", headline, own.tables, figures, content)


def _map(responses: xr.Dataset, found: Sequence[Contact]) -> dict[str, Any]:
    """Texts of the map of laws and cases, for its template."""
    listed = telling(found)
    return {
        "cut": how_many(len(listed), found) if len(found) > len(listed) else "",
        "verdicts": [
            (sign, verdict, [percent(limit) for limit in LIMITS.get(verdict, ())])
            for verdict, sign in SIGNS.items()
        ],
        "has_own_starts": any(len({law.n_exact for law in one.laws}) > 1 for one in listed),
        "has_unknown": any(np.isnan(law.low) for one in listed for law in one.laws),
        "has_tanh": any(one.least("tanh") for one in listed),
        "groups": GROUPS,
        "n_contacts": len(listed),
        "units": "stiffness [N/m], gap [mm]" if found[0].in_metres else "K_c, gap",
        "is_many": len(listed) > MANY,
        "stiffnesses": heads(one.stiffness for one in listed),
        "gaps": [(gap.split("/"), n) for (_, gap), n in heads((c.K_c, c.gap) for c in listed)],
        "swept": swept_columns(listed) if any(one.swept for one in listed) else None,
        "starts": [starts_of(responses, EXACT, one.at) for one in listed],
        "rows": cells(listed),
    }


def _numbers(contact: Contact) -> tuple[str, list[list[str]]]:
    """Heading and rows of a case in the table of numbers behind the map."""
    rows = [
        [
            one.law,
            f"{SIGNS[one.verdict]} {one.verdict}{' ±' * (not one.is_firm)}",
            *(percent(one.values[name][0]) for name in ("median", "p95")),
            f"{percent(one.values['found'][0])} of {one.n_exact}",
            one.cost,
            f"{times(one.low)} to {times(one.high)}",
            times(one.periodic_cost_ratio),
        ]
        for one in contact.laws
    ]
    if np.isfinite(contact.floors["median"][0]):
        median, p95, share = (percent(contact.floors[n][0]) for n in ("median", "p95", "found"))
        cost = times(contact.floor_cost_ratio)
        rows.append(["exact law, other settings", "", median, p95, share, cost, "", ""])
    if contact.unjudged:
        return f"{contact.place}: cannot be judged: {contact.unjudged}", rows
    least = contact.least("tanh")
    of_tanh = f"; tanh has one static equilibrium: {contact.threshold}, adequate: {least}"
    return f"{contact.place}{of_tanh if least and contact.in_metres else ''}", rows


def _compared(inputs: Inputs) -> Iterator[Figured]:
    """Laws and the exact law in the case with the most verdicts; others can be chosen.

    Among equals it is the case with most chaos, lost attractors and error.
    """
    responses, found = inputs.responses, inputs.cases
    if not found or responses.sizes.get("omega", 1) < 2:
        return
    scenes = Scenes(responses)

    def shown(contact: Contact) -> tuple[xr.Dataset, Choice] | None:
        laws: dict[str, str] = {
            o.law: f"{o.law}: {o.verdict}{' ±' * (not o.is_firm)}" for o in panels_of(contact)
        }
        scene = scenes.at(contact.at) if laws else None
        if scene is None:
            return None
        scene, _ = next(by_coordinate(swept(scene.sel(representation=[EXACT, *laws]))))
        return scene, peaks_of_laws(contact.place, scene, EXACT, laws, inputs.branches)

    def telling_most(contact: Contact) -> tuple[float, ...]:
        n_verdicts = len([laws for laws in contact.columns.values() if laws])
        return n_verdicts, contact.n_chaotic, contact.lost, contact.error, contact.K_c

    contact = max(found, key=telling_most)
    if (drawn := shown(contact)) is None:
        return
    n_values = math.prod(responses.sizes[dim] for dim in (REPRESENTATION, *SWEPT))
    n_most = min(_MOST_CHOICES, max(1, _MOST_VALUES // n_values))
    others = telling(found, n_most) if len(found) > 1 else []
    description = (
        f"Peak displacement at {contact.place}: contact laws (coloured) and the exact law (larger "
        "dots behind), for the same initial conditions"
    )
    figure = compared_with_exact(*drawn)
    words = " Dashed lines: unstable orbits." if inputs.branches is not None else ""
    looks = f"{caption_of_walls(drawn[0], of_peaks=True)}{words}{caption_of_marks(figure)}"
    more = f" Explore shows {how_many(len(others), found)}." if others else ""
    choices = (each[1] for case in others if (each := shown(case)))
    yield Figured(figure, f"{description}.{looks}{more}", description, choices=choices)


def panels_of(contact: Contact) -> list[Judged]:
    """Approximations for the first figure: one of each verdict, a firm one if any.

    If all have the same verdict, the most and the least accurate.
    """
    columns = ([one for one in laws if one.is_approximation] for laws in contact.columns.values())
    shown = [next((one for one in laws if one.is_firm), laws[0]) for laws in columns if laws]
    if len(shown) > 1:
        return shown
    laws = [one for one in contact.laws if one.is_approximation]
    laws.sort(key=lambda one: np.nan_to_num(one.values["p95"][0], nan=np.inf))
    return laws[:1] + laws[1:][-1:]
