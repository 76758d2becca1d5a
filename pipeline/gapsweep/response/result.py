"""Convergence criteria and steady responses as plain values, without computation."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.model.oscillator import called_as, checked, whole
from gapsweep.model.structure import AnyStructure, OscillatorStructure, structure_of
from gapsweep.response.ragged import spans
from gapsweep.status import Status
from gapsweep.variables import (
    CONTACT,
    COORDINATE,
    COUNTS,
    EXTREMUM,
    LAG,
    MULTIPLIER,
    SECTION_POINT,
    STATUS_FLAGS,
    Variable,
    as_html,
    dataset,
    members,
    objects,
    to_dataframe,
)


class ResponseClass(IntEnum):
    """Class of a steady response; datasets store its number.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.ResponseClass.CHAOTIC.value
    1
    """

    PERIODIC = 0
    CHAOTIC = 1
    UNRESOLVED = 2
    FAILED = 3
    QUASIPERIODIC = 4
    EQUILIBRIUM = 5


class ExtremumKind(IntEnum):
    """Kind of a zero-velocity point; the numbers are part of the schema."""

    MINIMUM = -1
    INFLECTION = 0
    MAXIMUM = 1


CLASS_FLAGS = (("none", -1), *((kind.name.lower(), int(kind)) for kind in ResponseClass))
KIND_FLAGS = (("none", -9), *((kind.name.lower(), int(kind)) for kind in ExtremumKind))
_Q, _EXTREMA, _SECTION = (COORDINATE,), (EXTREMUM, COORDINATE), (SECTION_POINT, COORDINATE)
_B, _SECTION_B = (CONTACT,), (SECTION_POINT, CONTACT)

# Numbers of a response, in the order in which they are stored; see `exists`.
COLUMNS: dict[str, Variable] = {
    "status": Variable("i1", "1", "outcome of the sweep point", Status.NOT_REQUESTED, STATUS_FLAGS),
    "response_class": Variable("i1", "1", "class of the steady response", -1, CLASS_FLAGS),
    "period_multiple": Variable("i4", "1", "forcing periods in one response period, 0: none", 0),
    "n_extrema": Variable("i4", "1", "number of steady extrema, stored or not", 0, dims=_Q),
    "x_max": Variable("f8", "m", "peak displacement of the steady response", dims=_Q),
    "x_min": Variable("f8", "m", "trough displacement of the steady response", dims=_Q),
    "amplitude": Variable("f8", "m", "half the range of the steady response", dims=_Q),
    "force_max": Variable("f8", "N", "largest magnitude of the contact force", dims=_B),
    "contact_share": Variable("f8", "1", "share of the time spent beyond the walls", dims=_B),
    "contacts_per_period": Variable(
        "f8", "1", "contacts of the steady response per forcing period, or per section point"
    ),
    "multiplier_abs": Variable("f8", "1", "largest modulus of the Floquet multipliers"),
    "lyapunov": Variable("f8", "s-1", "largest Lyapunov exponent"),
    "lyapunov_error": Variable("f8", "s-1", "standard error of the largest Lyapunov exponent"),
    **COUNTS,
    "t_settled": Variable("f8", "s", "simulated time until the response was steady"),
    "t_simulated": Variable("f8", "s", "simulated time, transient and recording window"),
    "atol": Variable("f8", "m", "absolute tolerance of the integration"),
    "stability_rtol": Variable("f8", "1", "relative tolerance of class, multipliers and exponent"),
    "noise": Variable(
        "f8", "m", "expected numerical noise of the section; for equilibria, distance to it"
    ),
    "x_end": Variable("f8", "m", "displacement at the last section point", dims=_Q),
    "v_end": Variable("f8", "m s-1", "velocity at the last section point", dims=_Q),
    "cpu_time": Variable("f8", "s", "CPU time of motion, shooting and tangents, in the worker"),
    "contact_x_max": Variable("f8", "m", "peak relative displacement at the contact", dims=_B),
    "contact_x_min": Variable("f8", "m", "trough relative displacement at the contact", dims=_B),
    "period": Variable("f8", "s", "period of an unforced response"),
    "z_end": Variable("f8", "", "first-order states at the last section point", dims=(LAG,)),
}
# Lists of any length: names, and NumPy type codes. Section points are their components in turn.
LISTS = {"extrema": "f8", "extremum_kind": "i1", "multipliers": "c16", "section": "f8"}
# All variables of responses in datasets; lists are padded where they end.
RESPONSE: dict[str, Variable] = {
    **COLUMNS,
    "extrema": Variable(
        "f8", "m", "steady zero-velocity displacements in time order", dims=_EXTREMA
    ),
    "extremum_kind": Variable("i1", "1", "kind of each extremum", -9, KIND_FLAGS, _EXTREMA),
    "section_x": Variable("f8", "m", "displacement at whole forcing periods", dims=_SECTION),
    "section_v": Variable("f8", "m s-1", "velocity at whole forcing periods", dims=_SECTION),
    "section_z": Variable(
        "f8", "", "first-order state at whole forcing periods", dims=(SECTION_POINT, LAG)
    ),
    "contact_section_x": Variable(
        "f8", "m", "relative displacement at the contact at whole forcing periods", dims=_SECTION_B
    ),
    "contact_section_v": Variable(
        "f8", "m s-1", "relative velocity at the contact at whole forcing periods", dims=_SECTION_B
    ),
    "multiplier_real": Variable(
        "f8", "1", "real part of the Floquet multipliers", dims=(MULTIPLIER,)
    ),
    "multiplier_imag": Variable(
        "f8", "1", "imaginary part of the Floquet multipliers", dims=(MULTIPLIER,)
    ),
}
_OF_CONTACTS = ("force_max", "contact_share")
_MESSAGE = {"message": Variable("str", "", "reason for a failure or an unresolved response")}
_OSCILLATOR = OscillatorStructure()


@cache
def columns_of(structure: AnyStructure) -> Mapping[str, tuple[str, tuple[int, ...]]]:
    """Columns of responses by name: NumPy type code, and the shape of one point's value.

    Values of a single coordinate, or of a single contact, are plain numbers.
    """
    sizes = {COORDINATE: structure.n, CONTACT: len(structure.contacts)}
    shapes = {dim: () if size == 1 else (size,) for dim, size in sizes.items()}
    shapes |= {LAG: (structure.m,)}
    return {
        name: (variable.dtype, shapes[variable.dims[0]] if variable.dims else ())
        for name, variable in COLUMNS.items()
        if name in _OF_CONTACTS or exists(name, structure)
    }


def exists(name: str, structure: AnyStructure) -> bool:
    """Whether datasets of models of a structure have a variable or coordinate.

    Contacts have a relative displacement unless the only one follows the only coordinate.
    """
    n_contacts = len(structure.contacts)
    if name in ("z_0", "z_end", "section_z"):
        return structure.m > 0
    if name.startswith("contact_") and name not in _OF_CONTACTS:
        return n_contacts > 0 and structure.n * n_contacts > 1
    if name in _OF_CONTACTS:
        return n_contacts > 0
    return name != "period" or not structure.is_forced


def part_sizes(structure: AnyStructure) -> dict[str, int]:
    """Dimensions within a point (coordinate, contact, lag) that are longer than 1, with lengths."""
    sizes = {COORDINATE: structure.n, CONTACT: len(structure.contacts), LAG: structure.m}
    return {name: size for name, size in sizes.items() if size > 1}


def sizes_of(structure: AnyStructure, steady: "Steady") -> dict[str, int]:
    """Lengths of all dimensions within a point: those of padded lists and of `part_sizes`."""
    return {
        EXTREMUM: steady.max_extrema,
        SECTION_POINT: steady.max_period_multiple,
        MULTIPLIER: structure.n_states,
        **part_sizes(structure),
    }


@called_as("gs.Steady(n_periods=64)")
@dataclass(frozen=True, slots=True, kw_only=True)
class Steady:
    """Convergence criteria of a steady response, and its recording window.

    Parameters
    ----------
    settle_tol : float
        Remaining share of a disturbance at which an aperiodic motion counts as settled [-], in
        (0, 0.1].
    max_decay_times, max_periods : float, int
        Longest search for a period, in decay times ``1/(ζ ω_n + c/2m)`` and forcing periods,
        ``> 0``; the shorter limit counts, but at least the settling time. The Lyapunov exponent of
        a motion without a period is computed afterwards. Transient chaos may last many decay times.
    t_max : float, optional
        Longest time [s] before the last recording window of `n_periods`, ``> 0``, for motions that
        have not settled, too. Settled aperiodic motions may be integrated further, for as long per
        attempt, for the Lyapunov exponent and the detection of a torus.
    n_periods : int
        Forcing periods of the recording window, at least twice `max_period_multiple`.
    max_period_multiple : int
        Largest period multiple of the search, 1 to 256.
    lyapunov_error : float, optional
        Standard error [1/s] of the Lyapunov exponent of aperiodic motions, ``> 0``, measured over
        at most `max_periods`; None: until the sign is certain.
    max_extrema : int
        Extrema stored per point, 1 to 65536.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> settings = gs.Steady(settle_tol=1e-3, n_periods=32, max_period_multiple=16)
    >>> gs.respond(gs.systems.paper_oscillator(), law, omega=9.0, steady=settings).status.label
    'ok'
    """

    settle_tol: float = 1e-6
    max_decay_times: float = 113.0
    max_periods: int = 10_000
    t_max: float | None = None
    n_periods: int = 64
    max_period_multiple: int = 32
    lyapunov_error: float | None = None
    max_extrema: int = 256

    def __post_init__(self) -> None:
        for name in ("settle_tol", "max_decay_times", "t_max", "lyapunov_error"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, checked(name, value, low=0.0, strict=True))
        if self.settle_tol > 0.1:
            raise ModelError(f"settle_tol = {self.settle_tol:g}: must be <= 0.1")
        for name, largest in (
            ("max_period_multiple", 256),
            ("max_extrema", 65536),
            ("n_periods", 10**6),
            ("max_periods", 10**7),
        ):
            object.__setattr__(self, name, whole(name, getattr(self, name), 1, largest))
        if not 2 * self.max_period_multiple <= self.n_periods:
            raise ModelError(
                f"n_periods = {self.n_periods}: must be >= 2 max_period_multiple "
                f"({2 * self.max_period_multiple})"
            )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Response:
    """Steady response, or an array of responses.

    Attributes are the variables of ``responses.nc``: plain values, or arrays of several
    responses. Displacements of a `System` with several coordinates have the coordinates as their
    last axis; forces and shares of time have the contacts if there are several.

    Attributes
    ----------
    status : Status
    response_class : ResponseClass
    period_multiple : int
        n of a period-n response, 0 if aperiodic; for an unforced system, number of maxima of the
        first coordinate in a period.
    extrema : tuple of float
        Steady zero-velocity displacements [m] in order of time: over n periods if periodic,
        else over the recording window; at most `max_extrema`. Coordinates of a system follow each
        other, with `n_extrema` values each.
    extremum_kind : tuple of int
        `ExtremumKind` of each.
    n_extrema : int
        Number of extrema, also beyond `max_extrema`.
    x_max, x_min, amplitude : float
        Peak, trough and half their difference [m]; NaN if the point failed.
    force_max : float
        Largest magnitude of the contact force [N] between peak and trough; NaN for a contact of
        periodic stiffness.
    contact_share : float
        Share of the time [-] beyond the walls, ``x < -j_1`` or ``x > j_2``, in a response period,
        or in the recording window if aperiodic.
    contacts_per_period : float
        Contacts per forcing period (unforced: per section point) in the same time, of all contacts
        together: pairs of wall crossings. A response that stays on a wall has none.
    contact_x_max, contact_x_min : float
        Peak and trough of the relative displacement ``b · q`` [m] at each contact of a system; NaN
        if the only contact is at the only coordinate.
    multipliers : ndarray of complex, shape (number of multipliers,)
        Floquet multipliers over n periods [-], largest modulus first; empty unless periodic. The
        multiplier 1 along the orbit of an unforced system is left out.
    multiplier_abs : float
        Largest modulus [-]; NaN if aperiodic.
    lyapunov, lyapunov_error : float
        Largest Lyapunov exponent [1/s] and its standard error. The exponent of a periodic response
        follows from the multipliers, with error zero unless solver error blurs the orbit. NaN if
        unknown.
    section : tuple of float
        Section points ``x, v, x, v, ...`` [m], [m/s], for a system ``q, v, z, q, v, z, ...``: n
        points if periodic, else the last `max_period_multiple` of the recording window.
    n_contacts, n_steps, n_rejected, nfev : int
        Wall crossings, accepted and rejected steps and right-hand-side evaluations of transient and
        recording window, without shooting, tangents and event location.
    t_settled : float
        Simulated time [s] until the response was steady.
    t_simulated : float
        Simulated time [s] of transient and recording window, for which the counts are.
    atol : float
        Absolute tolerance [m] of the integration, as given or by default.
    stability_rtol : float
        Relative tolerance [-] of class, multipliers and exponent: `rtol`, but where that is above
        1e-7, 1e-9 of orbits and 1e-7 of other motions; NaN for a failure or an equilibrium.
    noise : float
        Expected numerical noise of the section [m], from the solver's tolerances: scatter of points
        a response period apart (aperiodic: a forcing period). For equilibria, distance to it.
    period : float
        Period [s] of a periodic response of an unforced system, else NaN.
    x_end, v_end : float
        Last section point [m], [m/s]: initial state of a sweep's next point.
    z_end : tuple of float
        First-order states at the last section point.
    cpu_time : float
        CPU time of the integration [s], including shooting and tangents.
    message : str
        Reason of a failure or an unresolved response, and a remedy; else empty.
    inputs : mapping of str to object
        Arguments of the call by name, defaults included; frequencies and initial states have the
        common shape. ``gs.respond(**found.inputs)`` repeats the call.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> found = gs.respond(gs.systems.paper_oscillator(), law, omega=9.0)
    >>> found.response_class.name, found.multiplier_abs < 1.0
    ('PERIODIC', True)
    >>> several = gs.respond(gs.systems.paper_oscillator(), law, omega=[7.0, 9.0])
    >>> several.response_class == gs.ResponseClass.PERIODIC
    array([ True,  True])
    >>> several.response_class[1].name, dict(several.to_dataset().sizes)["omega"]
    ('PERIODIC', 2)
    """

    status: Status
    response_class: ResponseClass = ResponseClass.FAILED
    period_multiple: int = 0
    extrema: tuple[float, ...] = ()
    extremum_kind: tuple[int, ...] = ()
    n_extrema: int = 0
    x_max: float = math.nan
    x_min: float = math.nan
    amplitude: float = math.nan
    force_max: float = math.nan
    contact_share: float = math.nan
    contacts_per_period: float = math.nan
    contact_x_max: float = math.nan
    contact_x_min: float = math.nan
    multipliers: NDArray[np.complex128] = field(
        default_factory=lambda: np.empty(0, complex), compare=False
    )
    multiplier_abs: float = math.nan
    lyapunov: float = math.nan
    lyapunov_error: float = math.nan
    section: tuple[float, ...] = ()
    n_contacts: int = 0
    n_steps: int = 0
    n_rejected: int = 0
    nfev: int = 0
    t_settled: float = math.nan
    t_simulated: float = math.nan
    atol: float = math.nan
    stability_rtol: float = math.nan
    noise: float = math.nan
    period: float = math.nan
    x_end: float = math.nan
    v_end: float = math.nan
    z_end: tuple[float, ...] = ()
    cpu_time: float = math.nan
    message: str = ""
    inputs: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def to_dataset(self) -> Any:
        """Return the responses as an `xarray.Dataset` with the variables of ``responses.nc``.

        Dimensions are `omega` and `initial_condition` if every frequency has every initial state,
        otherwise `point`. The attribute ``touched_a_wall`` counts steady responses with contact.
        """
        shape, steady = np.shape(self.status), self.inputs["steady"]
        models, n = objects(self.inputs["oscillator"]), math.prod(shape)
        structure = structure_of(models.flat[0])
        columns = {
            name: np.asarray(getattr(self, name)).astype(dtype).reshape(n, *shape)
            for name, (dtype, shape) in columns_of(structure).items()
        }
        lists = {
            name: _joined(name, found.flat if np.ndim(self.status) else [found])
            for name in LISTS
            for found in [getattr(self, name)]
        }
        directions = np.array([model.directions for model in models.flat])
        size = directions.shape[1:]
        of_contacts = np.broadcast_to(directions.reshape(*models.shape, *size), (*shape, *size))
        of_contacts = of_contacts.reshape(n, *size)
        arrays = Responses(columns, lists, {}).arrays(sizes_of(structure, steady), of_contacts)
        arrays["message"] = np.ravel(self.message).astype(str)
        made = dataset(self.inputs, shape, RESPONSE | _MESSAGE, arrays)
        return made.assign_attrs(touched_a_wall=f"{self._n_touching} of {n} responses")

    def __getattr__(self, name: str) -> Any:
        remedy = "; use gs.plot(response)" if name == "plot" else ""
        if name == "to_csv":
            remedy = "; use response.to_dataframe().to_csv(...)"
        raise AttributeError(f"'Response' object has no attribute {name!r}{remedy}")

    @property
    def _n_touching(self) -> int:
        """Number of steady responses with time in contact, or with impacts."""
        is_touched = np.reshape(self.contact_share, (np.size(self.status), -1)) > 0.0
        return int((is_touched.any(axis=1) | (np.ravel(self.contacts_per_period) > 0.0)).sum())

    def to_dataframe(self) -> Any:
        """Return the responses as a `pandas.DataFrame`, a row each, without extrema and sections.

        Columns are the variables of `to_dataset`, one column per coordinate or contact, as
        ``x_max[q_1]``. Status and class are words.
        """
        return to_dataframe(self.to_dataset())

    def _repr_html_(self) -> str | None:
        return as_html(self.to_dataset()) if self.inputs else None  # notebooks then show the repr

    def __repr__(self) -> str:
        kinds, counts = np.unique(np.asarray(self.response_class, object), return_counts=True)
        words = [kind.name.lower() for kind in kinds]
        if shape := np.shape(self.status):
            listed = [f"{n} {kind}" for n, kind in zip(counts, words, strict=True)]
            listed.append(f"{self._n_touching} touched a wall")
            return f"<gapsweep.Response of shape {shape}: {', '.join(listed)}>"
        if self.period_multiple:
            words.append(f"period multiple {self.period_multiple}")
        words.append(self.status.label)
        if self.status == Status.OK and not self._n_touching:
            words.append("no contact")
        for name in ("x_min", "x_max"):
            values = np.atleast_1d(getattr(self, name)).tolist()
            words.append(f"{name} {' '.join(f'{value:.6g}' for value in values)}")
        return f"<gapsweep.Response: {', '.join(words)}>"


def _joined(name: str, rows: Iterable[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Join the lists of one name: all items, row after row, and the number of each row."""
    parts = [np.asarray(row, LISTS[name]) for row in rows]
    return np.concatenate([np.empty(0, LISTS[name]), *parts]), np.array(
        [*map(len, parts)], np.int64
    )


def _padded(
    items: NDArray[Any], counts: NDArray[np.integer], size: int, missing: float
) -> NDArray[Any]:
    """Return lists of different lengths as rows of an array, padded, after the axes of `counts`."""
    rows = np.full((*counts.shape, size, *items.shape[1:]), missing, items.dtype)
    rows[np.arange(size) < counts[..., None]] = items
    return rows


def columns_with(
    values: Mapping[str, NDArray[Any]], points: NDArray[np.intp], n: int, structure: AnyStructure
) -> dict[str, NDArray[Any]]:
    """Return the columns of n points, with values of some points; the others have no response.

    `values`: shape (len(points), ...); columns by name; columns that are left out have missing
    values.
    `points`: numbers of the points, ascending.
    """
    columns: dict[str, NDArray[Any]] = {}
    for name, (dtype, shape) in columns_of(structure).items():
        if name in values and len(points) == n:
            columns[name] = values[name].reshape(n, *shape).astype(dtype)
            continue
        columns[name] = np.full((n, *shape), np.nan if dtype == "f8" else 0, dtype)
        if name == "response_class":
            columns[name][:] = ResponseClass.FAILED
        if name in values:
            columns[name][points] = values[name].reshape(len(points), *shape)
    return columns


def missing(n: int, structure: AnyStructure) -> dict[str, NDArray[Any]]:
    """Return the columns of n points without a response."""
    return columns_with({}, np.arange(0), n, structure)


@dataclass(frozen=True, slots=True, eq=False)
class Responses:
    """Steady responses of n points as columns; `row` gives one as a `Response`."""

    # Shape (n,); columns of `COLUMNS`, named as in a `Response`; enumerations as their numbers.
    # Some columns of systems have a second axis.
    columns: dict[str, NDArray[Any]]
    # Lists of `LISTS`: the items of all rows, row after row, and how many each row has.
    lists: dict[str, tuple[NDArray[Any], NDArray[np.int64]]]
    messages: dict[int, str]  # messages by row, for rows that have one

    def __len__(self) -> int:
        return len(self.columns["status"])

    @classmethod
    def of(
        cls, responses: Sequence[Response], structure: AnyStructure = _OSCILLATOR
    ) -> "Responses":
        """Return single responses, of models of one structure, as columns."""
        columns = missing(len(responses), structure)
        for name, column in columns.items():
            for row, response in enumerate(responses):
                column[row] = getattr(response, name)
        lists = {
            name: _joined(name, (getattr(response, name) for response in responses))
            for name in LISTS
        }
        messages = {k: response.message for k, response in enumerate(responses)}
        return cls(columns, lists, {k: text for k, text in messages.items() if text})

    @classmethod
    def concatenated(cls, parts: "Sequence[Responses]") -> "Responses":
        """Return the rows of all parts, part after part."""
        parts = parts or [cls.of(())]
        if len(parts) == 1:
            return parts[0]
        firsts = np.cumsum([0, *map(len, parts)]).tolist()
        return cls(
            {
                name: np.concatenate([part.columns[name] for part in parts])
                for name in parts[0].columns
            },
            {
                name: (
                    np.concatenate([part.lists[name][0] for part in parts]),
                    np.concatenate([part.lists[name][1] for part in parts]),
                )
                for name in LISTS
            },
            {
                first + k: message
                for first, part in zip(firsts, parts, strict=False)
                for k, message in part.messages.items()
            },
        )

    def take(self, numbers: ArrayLike) -> "Responses":
        """Return the rows of these numbers, in this order."""
        rows = np.asarray(numbers, np.intp)
        lists = {}
        for name, (items, counts) in self.lists.items():
            first = np.cumsum(counts) - counts
            lists[name] = items[spans(first[rows], counts[rows])], counts[rows]
        messages = {}
        if self.messages:
            found = enumerate(map(self.messages.get, rows.tolist()))
            messages = {k: message for k, message in found if message is not None}
        return Responses(
            {name: column[rows] for name, column in self.columns.items()}, lists, messages
        )

    @property
    def ends(self) -> NDArray[np.float64]:
        """Last section points, where a sweep's next points start; else NaN; shape (n, n_states)."""
        names = [name for name in ("x_end", "v_end", "z_end") if name in self.columns]
        return np.column_stack([self.columns[name] for name in names])

    @property
    def has_end(self) -> NDArray[np.bool_]:
        """Whether the states `ends` are finite, shape (n,)."""
        return np.asarray(np.isfinite(self.ends).all(axis=1))

    def arrays(
        self, sizes: Mapping[str, int], directions: NDArray[np.float64]
    ) -> dict[str, NDArray[Any]]:
        """Return the values of the dataset's variables, shape (n, ...), with padded lists.

        `sizes`: lengths of the dimensions within a point; 0 leaves out the extrema.
        `directions`: shape (n, n_contacts, n_coordinates); contact directions of each response, for
        relative displacements ``b · q``.
        """
        n, (_, n_contacts, n_q), n_states = len(self), directions.shape, self.ends.shape[1]
        found = {
            name: column
            for name, column in self.columns.items()
            if n_contacts or name not in _OF_CONTACTS
        }
        if size := sizes[EXTREMUM]:
            shown = np.minimum(found["n_extrema"], size)  # coordinate by coordinate
            for name in ("extrema", "extremum_kind"):
                rows = _padded(self.lists[name][0], shown, size, RESPONSE[name].missing)
                found[name] = np.moveaxis(rows, -1, 1)
        items, counts = self.lists["multipliers"]
        for name, part in (("multiplier_real", items.real), ("multiplier_imag", items.imag)):
            found[name] = _padded(part, counts, sizes[MULTIPLIER], math.nan)
        items, counts = self.lists["section"]
        x, v, z = np.split(items.reshape(-1, n_states), [n_q, 2 * n_q], axis=1)
        points = {"section_x": x, "section_v": v} | ({"section_z": z} if z.shape[1] else {})
        if "contact_x_max" in found:
            along = np.repeat(directions, counts // n_states, axis=0)
            for name, part in (("contact_section_x", x), ("contact_section_v", v)):
                points[name] = np.einsum("skj,sj->sk", along, part)
        for name, part in points.items():
            found[name] = _padded(part, counts // n_states, sizes[SECTION_POINT], math.nan)
        return {
            name: values.reshape(n, *(sizes[dim] for dim in RESPONSE[name].dims if dim in sizes))
            for name, values in found.items()
        }

    def row(self, k: int) -> Response:
        """Return one response as plain values."""
        return self.take([k]).rows()[0]

    def rows(self, **inputs: Any) -> list[Response]:
        """Return all responses as plain values, with the `inputs` of the call."""
        values: dict[str, list[Any]] = {
            name: list(column) if column.ndim > 1 else column.tolist()
            for name, column in self.columns.items()
        }
        values["status"] = [Status(each) for each in values["status"]]
        values["response_class"] = [ResponseClass(each) for each in values["response_class"]]
        values |= {name: list(map(tuple, self._split(name))) for name in LISTS}
        values["multipliers"] = [np.array(each, complex) for each in values["multipliers"]]
        values["message"] = [self.messages.get(k, "") for k in range(len(self))]
        names = tuple(values)
        rows = zip(*values.values(), strict=True)
        return [Response(**dict(zip(names, row, strict=True)), inputs=inputs) for row in rows]

    def shaped(self, shape: tuple[int, ...], **inputs: Any) -> Response:
        """Return all responses as one with arrays as attributes, with the `inputs` of the call."""
        # Whole numbers as int64: short integers of a column would overflow in arithmetic.
        values: dict[str, Any] = {
            name: column.astype(np.int64) if column.dtype.kind == "i" else column
            for name, column in self.columns.items()
        }
        for name, dtype in LISTS.items():
            plain = np.int64 if dtype.startswith("i") else np.dtype(dtype)
            values[name] = np.empty(len(self), dtype=object)
            values[name][:] = [np.array(items, plain) for items in self._split(name)]
        for name, kind in (("status", Status), ("response_class", ResponseClass)):
            values[name] = members(kind, self.columns[name])
        values["message"] = np.array([self.messages.get(k, "") for k in range(len(self))], object)
        for name in ("period", "contact_x_max", "contact_x_min"):
            values.setdefault(name, np.full(len(self), math.nan))
        values.setdefault("z_end", np.empty((len(self), 0)))
        return Response(
            **{name: value.reshape(*shape, *value.shape[1:]) for name, value in values.items()},
            inputs=inputs,
        )

    def _split(self, name: str) -> list[list[Any]]:
        """Return the lists of one name, row by row."""
        items, counts = self.lists[name]
        ends = np.cumsum(counts)
        firsts, all_items = (ends - counts).tolist(), items.tolist()
        return [all_items[i:j] for i, j in zip(firsts, ends.tolist(), strict=True)]
