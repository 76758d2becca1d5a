"""Stored results of one representation in one parameter set, as NumPy arrays."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.dimensions import Array, At, Bools, Ints
from gapsweep.response.attractors import NONE as NO_ATTRACTOR
from gapsweep.response.result import ResponseClass as R
from gapsweep.status import Status
from gapsweep.study.points import FIXED

_LONGEST = 8
CLASSES = (
    *(f"P{n}" for n in range(1, _LONGEST + 1)),
    f"P>{_LONGEST}",
    "chaotic",
    "quasiperiodic",  # from here on for systems
    "equilibrium",
    "unresolved",
    "failed",
)
CHAOTIC, UNRESOLVED, FAILED = (CLASSES.index(n) for n in ("chaotic", "unresolved", "failed"))
_NAMED = {kind: CLASSES.index(kind.name.lower()) for kind in R if kind != R.PERIODIC}
NONE = -1


def class_numbers(requested: Bools, response_class: Ints, period_multiple: Ints) -> Ints:
    """Number in `CLASSES` of every response; `NONE` for points that were not requested."""
    periodic = np.minimum(period_multiple, _LONGEST + 1) - 1
    which = [response_class == kind for kind in (R.PERIODIC, *_NAMED)]
    numbers = np.select(which, [periodic, *_NAMED.values()], FAILED)
    return np.where(requested, numbers, NONE)


_KINDS = ("status", "response_class", "period_multiple")
_FIELDS = (
    *("attractor", "amplitude", "extrema", "noise"),
    *("host", "cpu_time", "contacts_per_period", "t_simulated"),
)
_SECTION = ("section_x", "section_v")
_FOUND_INTEGERS = ("response_class", "period_multiple", "mirror_of")
_FOUND_FLOATS = ("x_max", "x_min", *_SECTION)


@dataclass(frozen=True, slots=True, kw_only=True)
class AttractorTable:
    """The attractors at every frequency, padded to the largest number of attractors."""

    n: Ints  # shape (n_omega,); number of attractors
    # `response_class`, `period_multiple`, `mirror_of`: shape (n_omega, n_attractors).
    response_class: Ints
    period_multiple: Ints
    mirror_of: Ints
    amplitude: Array  # shape (n_omega, n_attractors); half the range [m]
    # Shape (n_omega, n_attractors, n_points, 2); stroboscopic section ``(x, v / (2π ω))`` [m].
    section: Array
    # Shape (n_omega, n_attractors); largest noise of the responses on the attractor [m].
    noise: Array

    @property
    def size(self) -> int:
        """The largest number of attractors."""
        return int(self.amplitude.shape[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class LawTable:
    """Responses over frequency and initial condition, and the attractors that they are on."""

    omega: Array  # shape (n_omega,); forcing frequency [Hz]
    # Shape (n_starts,); whether an initial condition is a fixed state; otherwise it is a sweep.
    fixed: Bools
    # Shape (n_omega, n_starts); whether a cell is a sweep point. Further arrays have this shape,
    # and some a last dimension.
    requested: Bools
    class_number: Ints  # position in `CLASSES`, -1 for cells that were not requested
    attractor: Ints
    amplitude: Array  # amplitude [m]; NaN without a response
    extrema: Array  # shape (..., n_extrema); extrema [m], padded with NaN
    noise: Array  # numerical scatter of section points [m]
    # `host`, `cpu_time`, `contacts_per_period`, `t_simulated`: as in ``responses.nc``.
    host: Ints
    cpu_time: Array
    contacts_per_period: Array
    t_simulated: Array
    found: AttractorTable

    @property
    def exists(self) -> Bools:
        """Mask of points with a response, resolved or not."""
        return np.asarray(self.requested & np.isfinite(self.amplitude))

    @property
    def periodic(self) -> Bools:
        return np.asarray((self.class_number != NONE) & (self.class_number < CHAOTIC))

    @property
    def chaotic(self) -> Bools:
        return np.asarray(self.class_number == CHAOTIC)


def law_table(responses: xr.Dataset, attractors: xr.Dataset, at: At) -> LawTable:
    """Read the results of one representation in one parameter set.

    `responses` and `attractors`: as stored in ``responses.nc`` and ``attractors.nc``.
    `at`: position along the representation and the dimensions of parameter sets.
    """
    here = _read(responses, (*_KINDS, *_FIELDS), at)
    requested = here["status"] != Status.NOT_REQUESTED
    return LawTable(
        omega=responses["omega"].values,
        fixed=responses["start"].values == FIXED,
        requested=requested,
        class_number=class_numbers(requested, here["response_class"], here["period_multiple"]),
        found=_found(attractors, at, here),
        **{name: here[name] for name in _FIELDS},
    )


def _found(attractors: xr.Dataset, at: At, responses: dict[str, Any]) -> AttractorTable:
    here = _read(attractors, ("n_attractors", *_FOUND_INTEGERS, *_FOUND_FLOATS), at)
    speed = 2.0 * np.pi * attractors["omega"].values.reshape(-1, 1, 1)
    noise = np.zeros(here["x_max"].shape)
    w, s = np.nonzero(responses["attractor"] != NO_ATTRACTOR)
    np.fmax.at(noise, (w, responses["attractor"][w, s]), responses["noise"][w, s])
    return AttractorTable(
        noise=noise,
        n=here["n_attractors"],
        amplitude=0.5 * (here["x_max"] - here["x_min"]),
        section=np.stack([here["section_x"], here["section_v"] / speed], axis=-1),
        **{name: here[name] for name in _FOUND_INTEGERS},
    )


def _read(dataset: xr.Dataset, names: tuple[str, ...], at: At) -> dict[str, Any]:
    """Variables at a position as arrays by name; integers as int64."""
    here = {name: dataset.variables[name].isel(at).values for name in names}
    return {n: v.astype(np.int64) if v.dtype.kind == "i" else v for n, v in here.items()}
