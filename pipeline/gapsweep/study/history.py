"""Parameters of the oscillator and the walls for the time histories of a study."""

from collections.abc import Iterator, Mapping, Sequence

from gapsweep.study.grid import Axes
from gapsweep.study.spec import HistoryTable


def setting(history: HistoryTable, model: Mapping[str, float], axes: Axes) -> dict[str, float]:
    """Return the parameters of the model, and the stiffness ratio of the walls, of a time history.

    Values of the history come first, then the single value of a sweep axis, then the model's.
    """
    found = {**model, "K_ratio": 1.0}
    return found | {name: axes[name][0] for name in found if name in axes} | _own(history)


def undecided(
    histories: Sequence[HistoryTable], model: Mapping[str, float], axes: Axes
) -> Iterator[str]:
    """Yield a problem for every parameter that the study sweeps and a history does not set."""
    for number, table in enumerate(histories):
        for name in (*model, "K_ratio"):
            axis = axes.get(name, ())
            if len(axis) > 1 and name not in _own(table):
                remedy = f"choose one value, as {name} = {axis[0]:g}"
                yield f"history[{number}].{name}: swept by the study; {remedy}"


def _own(history: HistoryTable) -> dict[str, float]:
    ratio = {} if history.K_ratio is None else {"K_ratio": history.K_ratio}
    return history.parameter | ratio
