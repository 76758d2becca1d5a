"""What is asked of a sweep point, and what is answered: plain values, no computation."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.model.oscillator import checked, whole
from gapsweep.model.structure import AnyStructure, OscillatorStructure
from gapsweep.response.ragged import spans
from gapsweep.status import Status

# What responses hold in columns, and in lists of any length: names, NumPy type codes, and the
# order in which they are stored.
COLUMNS = {
    "status": "i1",
    "response_class": "i1",
    "period_multiple": "i4",
    "n_extrema": "i4",
    "x_max": "f8",
    "x_min": "f8",
    "amplitude": "f8",
    "force_max": "f8",
    "contact_share": "f8",
    "multiplier_abs": "f8",
    "lyapunov": "f8",
    "lyapunov_error": "f8",
    "n_contacts": "i8",
    "n_steps": "i8",
    "n_rejected": "i8",
    "nfev": "i8",
    "t_settled": "f8",
    "t_simulated": "f8",
    "noise": "f8",
    "x_end": "f8",
    "v_end": "f8",
    "cpu_time": "f8",
}
LISTS = {"extrema": "f8", "extremum_kind": "i1", "multipliers": "f8", "section": "f8"}
# Columns that have a value of every coordinate, of every contact, of every first-order state.
OF_COORDINATES = ("n_extrema", "x_max", "x_min", "amplitude", "x_end", "v_end")
OF_CONTACTS = ("force_max", "contact_share")
_OSCILLATOR = OscillatorStructure()


def columns_of(structure: AnyStructure) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Columns of responses: NumPy type code, and the shape of one point's value.

    Values of a single coordinate, or of a single contact, are plain numbers. Motions that nothing
    forces have a period, systems with first-order states have their last ones.
    """
    sizes = {
        **dict.fromkeys(OF_COORDINATES, structure.n),
        **dict.fromkeys(OF_CONTACTS, len(structure.contacts)),
    }
    found: dict[str, tuple[str, tuple[int, ...]]] = {
        name: (dtype, () if sizes.get(name, 1) == 1 else (sizes[name],))
        for name, dtype in COLUMNS.items()
    }
    if not structure.is_forced:
        found["period"] = "f8", ()
    if structure.m:
        found["z_end"] = "f8", (structure.m,)
    return found


class ResponseClass(IntEnum):
    """What kind of motion the steady response is; the order is part of the schema.

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
    """What a zero-velocity point is; the order is part of the schema."""

    MINIMUM = -1
    INFLECTION = 0
    MAXIMUM = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Steady:
    """When a response counts as steady, and how much of it is recorded.

    Parameters
    ----------
    settle_tol : float
        Share [-] of a disturbance that may be left when a motion without a period is taken
        for settled, in (0, 0.1].
    max_decay_times, max_periods : float, int
        Times ``1/(ζ ω_n)`` and forcing periods, the fewer of which a motion is watched for a
        period, but never shorter than it needs to settle; then it is asked for its exponent.
        Transient chaos may last many decay times. Both ``> 0``.
    t_max : float, optional
        Bound [s] of the time that it is watched before its last window of `n_periods`, also where
        it then has not settled, ``> 0``. What has settled without a period by then may be watched
        as long again at a time for its exponent, and for a torus.
    n_periods : int
        Forcing periods in a full recording window, at least twice `max_period_multiple`.
    max_period_multiple : int
        Largest period multiple looked for, 1 to 256.
    lyapunov_error : float, optional
        Standard error [1/s] to which the Lyapunov exponent of an aperiodic motion is measured, over
        at most `max_periods`, ``> 0``; without it until the sign is certain.
    max_extrema : int
        Extrema kept per point, 1 to 65536.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> settings = gs.Steady(settle_tol=1e-3, n_periods=32, max_period_multiple=16)
    >>> gs.respond(gs.Oscillator(), law, omega=9.0, steady=settings).status.label
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
    """Steady response of one sweep point, or of an array of them.

    It has an attribute for every dataset variable: a plain value, or an array of values. Of a
    `System` with several coordinates, values of displacements are arrays whose last axis is that
    of its coordinates; with several contacts, forces and shares of time have an axis of contacts.

    Attributes
    ----------
    status : Status
    response_class : ResponseClass
    period_multiple : int
        n of a period-n response, 0 if none was found; where nothing forces it, how many maxima its
        first coordinate has in a period.
    extrema : tuple of float
        Steady zero-velocity displacements [m] in order of time: over n periods if periodic,
        else over the last window; at most `max_extrema`. Of a system those of its first coordinate,
        then of the second, and so on, as `n_extrema` says.
    extremum_kind : tuple of int
        `ExtremumKind` of each.
    n_extrema : int
        Their true count.
    x_max, x_min, amplitude : float
        Peak, trough and half their difference [m]; NaN if the point failed.
    force_max : float
        Largest magnitude of the contact force [N] between peak and trough; NaN of a contact whose
        stiffness changes with time.
    contact_share : float
        Share of the time [-] spent beyond the walls, ``x < -j_1`` or ``x > j_2``: of a whole
        period if periodic, else of the last window.
    multipliers : tuple of float
        Real and imaginary parts of the Floquet multipliers over n periods, largest modulus first;
        empty if not periodic. Where nothing forces the response, without that along the motion,
        which is one.
    multiplier_abs : float
        Largest modulus [-]; NaN if not periodic.
    lyapunov, lyapunov_error : float
        Largest Lyapunov exponent [1/s] and its standard error: zero, as it follows from the
        multipliers, if periodic, unless the solver rattles the motion about its orbit. NaN where
        it could not be told.
    section : tuple of float
        Section points ``x, v, x, v, ...`` [m], [m/s], of a system ``q, v, z, q, v, z, ...``: the n
        of a periodic response, else the last `max_period_multiple` of the window.
    n_contacts, n_steps, n_rejected, nfev : int
        Wall crossings, accepted and rejected steps and right-hand sides of the motion: settling and
        recording; without shots, tangents and the search for events inside a step.
    t_settled : float
        Simulated time [s] after which the response was accepted.
    t_simulated : float
        Simulated time of the motion [s], over which the counts are taken.
    noise : float
        Predicted scatter [m] of section points one response period (one forcing period if there
        is none) apart, from the solver's tolerances alone; of a rest, how far off it is.
    period : float
        Period [s] of a periodic response that nothing forces; NaN of others.
    x_end, v_end : float
        Last section point [m], [m/s]: where a sweep's next point starts.
    z_end : tuple of float
        First-order states there, of a system that has some.
    cpu_time : float
        Processor time of the integration [s], shots and tangents included.
    message : str
        Why the point failed, or is unresolved and what may help; empty otherwise.
    inputs : mapping of str to object
        What was asked: ``oscillator``, ``law``, ``omega`` [Hz] and the initial state ``start``, the
        last two in the shape of the response.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> found = gs.respond(gs.Oscillator(), law, omega=9.0)
    >>> found.response_class.name, found.multiplier_abs < 1.0
    ('PERIODIC', True)
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
    multipliers: tuple[float, ...] = ()
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
    noise: float = math.nan
    period: float = math.nan
    x_end: float = math.nan
    v_end: float = math.nan
    z_end: tuple[float, ...] = ()
    cpu_time: float = math.nan
    message: str = ""
    inputs: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def to_dataframe(self) -> Any:
        """The responses as a `pandas.DataFrame`, a row each, without extrema and sections.

        Columns are the frequency, the initial state, and the attributes. Values of several
        coordinates or contacts have columns of their own, as ``x_max[0]``. Status and class are
        words.
        """
        import pandas as pd  # half a second, which no computation needs

        n, columns = math.prod(np.shape(self.status)), dict[str, Any]()
        found = {each.name: getattr(self, each.name) for each in fields(self)}
        asked = {name: self.inputs[name] for name in ("omega", "start") if name in self.inputs}
        for name, values in {**asked, **found}.items():
            if name not in (*LISTS, "inputs"):
                table = np.reshape(np.asarray(values), (n, -1))
                names = [name] if table.shape[1] == 1 else _numbered(name, table.shape[1])
                columns |= dict(zip(names, table.T, strict=True))
        columns["status"] = [Status(value).label for value in columns["status"]]
        classes = [ResponseClass(value).name.lower() for value in columns["response_class"]]
        return pd.DataFrame(columns | {"response_class": classes}).dropna(axis=1, how="all")

    def _repr_html_(self) -> str:
        shown = self.to_dataframe()
        return str((shown if np.shape(self.status) else shown.T)._repr_html_())

    def __repr__(self) -> str:
        kinds, counts = np.unique(self.response_class, return_counts=True)
        said = [ResponseClass(kind).name.lower() for kind in kinds]
        if shape := np.shape(self.status):
            listed = [f"{n} {kind}" for n, kind in zip(counts, said, strict=True)]
            return f"<gapsweep.Response of shape {shape}: {', '.join(listed)}>"
        if self.period_multiple:
            said.append(f"period multiple {self.period_multiple}")
        said.append(Status(self.status).label)
        for name in ("x_min", "x_max"):
            values = np.atleast_1d(getattr(self, name)).tolist()
            said.append(f"{name} {' '.join(f'{value:.6g}' for value in values)}")
        return f"<gapsweep.Response: {', '.join(said)}>"


def _numbered(name: str, n: int) -> list[str]:
    return [f"{name}[{i}]" for i in range(n)]


def missing(n: int, structure: AnyStructure) -> dict[str, NDArray[Any]]:
    """Columns of n points without a response."""
    columns: dict[str, NDArray[Any]] = {
        name: np.full((n, *shape), np.nan if dtype == "f8" else 0, dtype)
        for name, (dtype, shape) in columns_of(structure).items()
    }
    columns["response_class"][:] = ResponseClass.FAILED
    return columns


@dataclass(frozen=True, slots=True, eq=False)
class Responses:
    """Steady responses of n points as columns; `row` gives one as a `Response`.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (n,)
        Those of `COLUMNS`, named as in a `Response`; enumerations as their numbers. Of systems
        some have a second axis.
    lists : dict of str to (ndarray, ndarray of int, shape (n,))
        Those of `LISTS`: the items of all rows, row after row, and how many are each row's.
    messages : dict of int to str
        Messages by row, where there is one.
    """

    columns: dict[str, NDArray[Any]]
    lists: dict[str, tuple[NDArray[Any], NDArray[np.int64]]]
    messages: dict[int, str]

    def __len__(self) -> int:
        return len(self.columns["status"])

    @classmethod
    def of(
        cls, responses: Sequence[Response], structure: AnyStructure = _OSCILLATOR
    ) -> "Responses":
        """Columns of single responses of what has this structure."""
        columns = missing(len(responses), structure)
        for name, column in columns.items():
            for row, response in enumerate(responses):
                column[row] = getattr(response, name)
        lists = {}
        for name, dtype in LISTS.items():
            rows = [getattr(response, name) for response in responses]
            items = np.array([item for row in rows for item in row], dtype)
            lists[name] = items, np.array(list(map(len, rows)), np.int64)
        messages = {k: response.message for k, response in enumerate(responses)}
        return cls(columns, lists, {k: text for k, text in messages.items() if text})

    @classmethod
    def concatenated(cls, parts: "Sequence[Responses]") -> "Responses":
        """The rows of all parts, part after part."""
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
        """The rows of these numbers, in this order."""
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
        """States that another motion can start from, NaN where there is none; (n, n_states)."""
        names = [name for name in ("x_end", "v_end", "z_end") if name in self.columns]
        return np.column_stack([self.columns[name] for name in names])

    @property
    def has_end(self) -> NDArray[np.bool_]:
        """Which of these states are numbers, shape (n,)."""
        return np.asarray(np.isfinite(self.ends).all(axis=1))

    def row(self, k: int) -> Response:
        """One response as plain values."""
        return self.take([k]).rows()[0]

    def rows(self) -> list[Response]:
        """All responses as plain values."""
        values: dict[str, list[Any]] = {
            name: list(column) if column.ndim > 1 else column.tolist()
            for name, column in self.columns.items()
        }
        values["status"] = [Status(each) for each in values["status"]]
        values["response_class"] = [ResponseClass(each) for each in values["response_class"]]
        values |= {name: list(map(tuple, self._split(name))) for name in LISTS}
        values["message"] = [self.messages.get(k, "") for k in range(len(self))]
        names = tuple(values)
        rows = zip(*values.values(), strict=True)
        return [Response(**dict(zip(names, row, strict=True))) for row in rows]

    def shaped(self, shape: tuple[int, ...]) -> Response:
        """All responses as one, whose attributes are arrays."""
        # Whole numbers as numpy has them: the short ones of a column overflow in arithmetic.
        values: dict[str, Any] = {
            name: column.astype(np.int64) if column.dtype.kind == "i" else column
            for name, column in self.columns.items()
        }
        for name, dtype in LISTS.items():
            plain = np.int64 if dtype.startswith("i") else np.float64
            values[name] = np.empty(len(self), dtype=object)
            values[name][:] = [np.array(items, plain) for items in self._split(name)]
        values["message"] = np.array([self.messages.get(k, "") for k in range(len(self))], object)
        values.setdefault("period", np.full(len(self), math.nan))
        values.setdefault("z_end", np.empty((len(self), 0)))
        return Response(
            **{name: value.reshape(*shape, *value.shape[1:]) for name, value in values.items()}
        )

    def _split(self, name: str) -> list[list[Any]]:
        """The lists of one name, row by row."""
        items, counts = self.lists[name]
        ends = np.cumsum(counts)
        firsts, all_items = (ends - counts).tolist(), items.tolist()
        return [all_items[i:j] for i, j in zip(firsts, ends.tolist(), strict=True)]
