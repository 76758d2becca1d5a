"""Of which oscillator and walls the time histories of a study are."""

from collections.abc import Iterator, Sequence

from gapsweep.study.axes import SWEEPABLE, OscillatorTable
from gapsweep.study.grid import Axes
from gapsweep.study.spec import HistoryTable


def setting(history: HistoryTable, oscillator: OscillatorTable, axes: Axes) -> dict[str, float]:
    """Numbers of the oscillator, and the ratio of the walls' stiffnesses, of a time history.

    Its own; else the only one that the study sweeps; else that of ``[oscillator]``.
    """
    model = {**oscillator.model_dump(), "K_ratio": 1.0}
    swept = {name: axes[name][0] for name in SWEEPABLE if name in axes}
    own = {name: getattr(history, name) for name in SWEEPABLE}
    return model | swept | {name: value for name, value in own.items() if value is not None}


def undecided(histories: Sequence[HistoryTable], axes: Axes) -> Iterator[str]:
    """What is wrong with those that could be of several values that the study sweeps."""
    for number, table in enumerate(histories):
        for name in SWEEPABLE:
            axis = axes.get(name, ())
            if len(axis) > 1 and getattr(table, name) is None:
                remedy = f"say which, as {name} = {axis[0]:g}"
                yield f"history[{number}].{name}: the study sweeps it; {remedy}"
