"""Access to ``responses.nc`` by parameter set: all points at one stiffness, gap, ..."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.dimensions import At
from gapsweep.report.drawing import labels_of
from gapsweep.status import Status
from gapsweep.study.axis_selection import positions

# Variables that figures and sentences use.
_SHOWN = (
    *("status", "response_class", "period_multiple", "amplitude", "attractor"),
    *("x_max", "x_min", "extrema"),
)
_PADDED = "extremum"


class Scenes:
    """Parameter sets of a dataset in memory; the last one is kept.

    Whole chunks are read and cut in memory: to select frequencies or initial conditions while
    reading a compressed file takes longer than all other work of a report.

    Parameters
    ----------
    responses : Dataset
        As stored in ``responses.nc``.
    """

    def __init__(self, responses: xr.Dataset) -> None:
        self._responses = responses[[name for name in _SHOWN if name in responses]]
        self._asked = responses["status"].load() != Status.NOT_REQUESTED
        self._last: tuple[At | None, xr.Dataset | None] = (None, None)

    def at(self, at: At) -> xr.Dataset | None:
        """The part of the dataset swept at a position; None if nothing was swept there.

        `at`: position along every dimension of parameter sets.
        """
        if self._last[0] != at:
            self._last = (None, None)  # never two parameter sets in memory
            asked = self._asked.isel(at)
            self._last = (at, self._scene(at) if bool(asked.any()) else None)
        return self._last[1]

    def labelled(self, K_c: float, gap: str) -> xr.Dataset | None:
        """The parameter set of a stiffness [N/m] and gap, None if it was not swept."""
        wanted = {"K_c": K_c, "gap": gap}
        try:
            found = {n: positions(n, self._responses[n].values, v) for n, v in wanted.items()}
        except ValueError:
            return None
        return self.at({name: int(where[0]) for name, where in found.items()})

    def _scene(self, at: At) -> xr.Dataset:
        asked = self._asked.isel(at)
        rows = np.flatnonzero(asked.any(["omega", "initial_condition"]))
        omega = np.flatnonzero(asked.any(["representation", "initial_condition"]))
        starts = np.flatnonzero(asked.any(["representation", "omega"]))
        parts = []
        for row in rows.tolist():
            slab = self._responses.isel({**at, "representation": row}).load()
            parts.append(_without_padding(slab.isel(omega=omega, initial_condition=starts)))
        longest = max(part.sizes.get(_PADDED, 0) for part in parts)
        padded = [
            p.pad({_PADDED: (0, longest - n)}) if (n := p.sizes.get(_PADDED)) else p for p in parts
        ]
        return xr.concat(
            padded, "representation", coords="minimal", compat="override", join="exact"
        )


def _without_padding(slab: xr.Dataset) -> xr.Dataset:
    """A dataset without the empty end of its padded extrema, which become single precision."""
    if _PADDED not in slab.dims:
        return slab
    others = [dim for dim in slab["extrema"].dims if dim != _PADDED]
    used = np.flatnonzero(slab["extrema"].notnull().any(others).values)
    kept = slab.isel({_PADDED: slice(0, int(used[-1]) + 1 if used.size else 1)})
    # Figures need no more digits, and a view would keep the whole dataset in memory.
    return kept.assign(extrema=kept["extrema"].astype("f4"))


def swept(scene: xr.Dataset) -> xr.Dataset:
    """The parameter set without representations, frequencies and states not requested here."""
    asked = scene["status"] != Status.NOT_REQUESTED
    for dim in asked.dims:
        others = [other for other in asked.dims if other != dim]
        scene = scene.isel({dim: np.flatnonzero(asked.any(others).values)})
    return scene


def caption_of_starts(scene: xr.Dataset) -> str:
    """Caption words on the number of initial conditions; empty if every law has one."""
    asked = (scene["status"] != Status.NOT_REQUESTED).transpose("representation", "omega", ...)
    groups: dict[str, list[str]] = {}
    for label, of_law in zip(labels_of(scene), asked.values, strict=True):
        groups.setdefault(_many(of_law), []).append(label)
    commonest, *others = sorted(groups, key=lambda words: -len(groups[words]))
    if not others:
        return "" if commonest == "1 initial condition" else f" from {commonest}"
    exceptions = [f"of {', '.join(groups[one])} from {one}" for one in others]
    laws = groups[commonest]
    rest = "the other laws" if len(laws) > 1 else laws[0]
    return f", {', '.join(exceptions)}, of {rest} from {commonest}"


def starts_of(responses: xr.Dataset, label: str, at: At) -> str:
    """Range of the number of initial conditions of a law per frequency, as ``1–19``."""
    status = responses["status"].sel(representation=label).isel(at)
    counts = (status != Status.NOT_REQUESTED).sum("initial_condition").values
    several = np.unique(counts[counts > 0]).tolist()
    return "–".join(map(str, dict.fromkeys([*several[:1], *several[-1:]])))


def _many(asked: NDArray[np.bool_]) -> str:
    """Initial conditions at each frequency, in words; `asked` has shape (n_omega, n_starts)."""
    counts = asked.sum(axis=1)[asked.any(axis=1)]
    if not counts.size:
        return "none"
    least, most, all_in_all = counts.min(), counts.max(), asked.any(axis=0).sum()
    noun = f"initial condition{'s' * int(all_in_all > 1)}"
    if least == most == all_in_all:
        return f"{most} {noun}"
    of_all = f" of {all_in_all}" if all_in_all > most else ""
    return f"{most if least == most else f'{least} to {most}'}{of_all} {noun} per frequency"
