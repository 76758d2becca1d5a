"""The section on force errors of contact laws, and the rule by which these are judged.

`docs/explanation/rule.md` has the rule and its test.
"""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from gapsweep.analysis.datasets.contact_errors import ADEQUATE, TOO_COARSE
from gapsweep.analysis.dimensions import Array, scene_dims
from gapsweep.model.labels import NOT_LOCATED
from gapsweep.report.drawing import labels_of
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Part, Table
from gapsweep.report.sections.parameter_sets import title_of
from gapsweep.report.tables import number

_MOST_CASES = 8  # columns of cases; more cases are counted
_WORDS = {"✓": "accurate", "◐": "between", "✗": "too coarse"}


def sections(inputs: Inputs) -> Iterator[Part]:
    """The force error of every approximation in every case, none if the forcing is zero."""
    if (static := inputs.static) is None:
        return
    name = "force_error_ratio"
    laws = [label for label in labels_of(static) if not (label.is_located or label == NOT_LOCATED)]
    ratio = static[[name]].sel(representation=laws).load()
    dims = scene_dims(ratio[name].dims)
    errors = ratio[name].transpose("representation", *dims).values
    is_known = np.isfinite(errors).any(axis=0)
    if not is_known.any():
        return
    errors, positions = errors[:, is_known], np.argwhere(is_known)
    is_listed = len(positions) <= _MOST_CASES
    names = [
        title_of(ratio.isel(dict(zip(dims, position, strict=True))))
        for position in positions[:_MOST_CASES]
    ]
    of_law = _each if is_listed else _counted
    rows = [
        [law, *of_law(values)]
        for law, values in zip(laws, errors, strict=True)
        if np.isfinite(values).any()
    ]
    header = ["Representation", *(names if is_listed else ["Range", *_WORDS.values()])]
    title = f"Force error{'' if is_listed else f' in {len(positions)} cases'}"
    visited = static[name].attrs["visited"].replace("by", "visited by", 1)
    sentences = [
        "Root-mean-square difference of a law's force from that of the exact law over the "
        f"displacements {visited}, divided by the forcing amplitude.",
        f"✓ accurate: at most {ADEQUATE:g}; 95 % of tested oscillators keep 95 % of the exact "
        "law's periodic attractors, with displacements within 5 %. ◐ between: compare the "
        f"responses. ✗ too coarse: at least {TOO_COARSE:g}. The rule was tested for walls of equal "
        "stiffness.",
    ]
    yield Part("force-errors", "Force errors", sentences, [Table(title, header, rows)])


def _sign(error: float) -> str:
    """The judgement of a force error by the rule; empty if it is unknown."""
    if np.isnan(error):
        return ""
    return "✓" if error <= ADEQUATE else "◐" if error < TOO_COARSE else "✗"


def _each(errors: Array) -> list[str]:
    return [f"{_sign(error)} {number(error)}".strip() for error in errors]


def _counted(errors: Array) -> list[str]:
    """Range of the force errors of a law, and the numbers of cases by judgement."""
    known = errors[np.isfinite(errors)]
    counts = Counter(map(_sign, known))
    return [f"{number(known.min())} to {number(known.max())}", *(f"{counts[s]}" for s in _WORDS)]
