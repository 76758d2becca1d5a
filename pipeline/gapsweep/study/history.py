"""Oscillator and walls of the time histories of a study."""

from collections.abc import Iterator, Mapping, Sequence

from gapsweep.study.grid import Axes
from gapsweep.study.spec import HistoryTable


def setting(history: HistoryTable, model: Mapping[str, float], axes: Axes) -> dict[str, float]:
    """Parameters of the model, and the ratio of the walls' stiffnesses, of a time history.

    Its own; else the only one that the study sweeps; else the model's.
    """
    found = {**model, "K_ratio": 1.0}
    return found | {name: axes[name][0] for name in found if name in axes} | _own(history)


def undecided(
    histories: Sequence[HistoryTable], model: Mapping[str, float], axes: Axes
) -> Iterator[str]:
    """Problems of histories that could have several swept values."""
    for number, table in enumerate(histories):
        for name in (*model, "K_ratio"):
            axis = axes.get(name, ())
            if len(axis) > 1 and name not in _own(table):
                remedy = f"choose one value, as {name} = {axis[0]:g}"
                yield f"history[{number}].{name}: swept by the study; {remedy}"


def _own(history: HistoryTable) -> dict[str, float]:
    ratio = {} if history.K_ratio is None else {"K_ratio": history.K_ratio}
    return history.parameter | ratio
