"""Sweep points as rows of a table, and the content keys of their results."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache, lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Models, Solver
from gapsweep.model.contact import FIT_RANGE, OF_WALLS, ContactLaw
from gapsweep.model.labels import Representation, contact_law
from gapsweep.model.oscillator import Gap
from gapsweep.model.own_law import OwnLaw
from gapsweep.model.structure import (
    AnyStructure,
    OscillatorStructure,
    copies,
    extremes,
    read_structure,
)
from gapsweep.response.result import Steady
from gapsweep.study.software import deciding, versions
from gapsweep.user_code.package_digest import numerics_fingerprint
from gapsweep.variables import canonical as canonical

# Raised whenever the stored result of a point changes its form or meaning.
RESULT_SCHEMA = 9

FIXED = "fixed"
SWEEPS = ("sweep_up", "sweep_down")

# Columns of every table of points: numbers that differ between points.
OF_CONTACT = ("K_c", "j_1", "j_2", *OF_WALLS)  # of every contact, first
_OSCILLATOR = OscillatorStructure()
KEY = np.dtype("V32")  # a content key, as an element of an array

Numbers = NDArray[np.intp]
Made = TypeVar("Made")


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """Common settings of the points of a table: everything but numbers that affects results."""

    representation: Representation  # without a protocol
    solver: Solver
    steady: Steady
    fit_range: float = FIT_RANGE  # half-width [m] of the range of fitted laws
    pulls: bool = False  # whether exact walls with damping pull
    # ``"fixed"``, or ``"sweep_up"`` or ``"sweep_down"``: a point starts in the end state of the one
    # before, the first one in the state of the table.
    start: str = FIXED
    # Added to a fixed initial displacement [m], to measure the reproducibility of the exact law.
    start_jitter: float = 0.0
    law_code: str | None = None  # key of a user law
    contacts: tuple[Representation, ...]  # of every contact
    structure: AnyStructure = _OSCILLATOR  # the arrays of systems are among the numbers
    # The law of that key; None in a kind that was read from a cache.
    own: OwnLaw | None = field(default=None, compare=False, repr=False)

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of the columns of the table."""
        return columns_of(self.structure)

    @property
    def n_states(self) -> int:
        """Length of an initial state."""
        return self.structure.n_states

    @property
    def is_sweep(self) -> bool:
        """Whether a point starts in the end state of the one before it."""
        return self.start != FIXED

    def laws(self, walls: NDArray[np.float64]) -> list[tuple[ContactLaw, ...]]:
        """Return the laws of all contacts for each of n rows.

        Raises `ModelError` if a law cannot be built.

        `walls`: shape (n, n_contacts * number of columns); columns `OF_CONTACT` of every contact.
        """
        several = np.split(walls, len(self.contacts), axis=1) if self.contacts else []
        pairs = zip(self.contacts, several, strict=True)
        laws = [self._laws(one, rows) for one, rows in pairs]
        return list(zip(*laws, strict=True)) if laws else [()] * len(walls)

    def _laws(self, one: Representation, rows: NDArray[np.float64]) -> list[ContactLaw]:
        """Return the laws of one contact; laws of a family that differ in numbers as copies."""
        if one.law_type is None or not one.law_type.is_numbers:
            return [self._law(one, row) for row in rows.tolist()]
        example, *_ = (self._law(one, row.tolist()) for row in extremes(rows))
        columns = dict(zip(OF_CONTACT, rows.T.tolist(), strict=True))
        gaps = copies(example.gap, {name: columns.pop(name) for name in ("j_1", "j_2")})
        own = {field.name for field in fields(example) if field.init}
        known = {name: column for name, column in columns.items() if name in own}
        return copies(example, known | {"gap": gaps})

    def _law(self, one: Representation, walls: list[float]) -> ContactLaw:
        K_c, j_1, j_2, *others = walls
        gap, of_walls = Gap(j_1, j_2), dict(zip(OF_WALLS, others, strict=True))
        if not one.is_own:
            taken = {name: value for name, value in of_walls.items() if one.takes(name)}
            return contact_law(one, K_c, gap, self.fit_range, **taken, pulls=self.pulls)
        if self.own is None:
            raise ModelError(f"{one}: the code of this user law is not stored")
        return self.own.law(K_c, gap, of_walls["K_ratio"])

    @property
    def identity(self) -> str:
        """All fields, fingerprint of the numerics, and library versions, as canonical JSON."""
        return identity_of(self)

    @classmethod
    def of(cls, identity: str) -> "Kind":
        """Return the kind of an identity; ValueError if the text is no identity."""
        try:
            whole = json.loads(identity)
            values = {"fit_range": FIT_RANGE, **whole["kind"]}
            values["law_code"] = values.pop("law")
            values |= {"solver": Solver(**values["solver"]), "steady": Steady(**values["steady"])}
            values["structure"] = read_structure(values["structure"])
            values["representation"] = Representation(values["representation"])
            values["contacts"] = tuple(map(Representation, values["contacts"]))
            return cls(**values)
        except (TypeError, KeyError, AttributeError, RecursionError) as error:
            raise ValueError(f"{type(error).__name__}: {error}") from None


# All tables of a study share a few kinds.
@lru_cache(maxsize=256)
def identity_of(kind: Kind) -> str:
    """Return `Kind.identity`; the last 256 are kept."""
    values = asdict(replace(kind, own=None))
    values["law"] = values.pop("law_code")
    del values["own"]
    if not any(contact.is_fitted for contact in kind.contacts):
        del values["fit_range"]
    whole = {
        "numbers": kind.numbers,
        "kind": values,
        "numerics": numerics_fingerprint(),
        "schema": RESULT_SCHEMA,
        "versions": {
            name: versions()[name] for name in deciding(kind.contacts, kind.solver.engine)
        },
    }
    return json.dumps(whole, sort_keys=True, separators=(",", ":"), allow_nan=False)


@dataclass(frozen=True, slots=True)
class Points:
    """Sweep points of one kind."""

    kind: Kind
    # Shape (n, number of columns); columns as in `Kind.numbers`: N/m, m, m, 1, Hz, then the
    # oscillator's, m, m/s.
    numbers: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.numbers)

    def column(self, name: str) -> NDArray[np.float64]:
        return self.numbers[:, self.kind.numbers.index(name)]

    def take(self, rows: Any) -> "Points":
        """Return some of the points."""
        return Points(self.kind, self.numbers[rows])

    def from_states(self, states: NDArray[np.float64]) -> "Points":
        """Return the points with other fixed initial states, shape (n, n_states)."""
        kind = replace(self.kind, start=FIXED, start_jitter=0.0)
        return Points(kind, np.hstack([self.numbers[:, : -self.kind.n_states], states]))

    @property
    def starts(self) -> NDArray[np.float64]:
        """Fixed initial states, shape (n, n_states), shifted by the jitter of the protocol."""
        found = self.numbers[:, -self.kind.n_states :].copy()
        found[:, 0] += self.kind.start_jitter
        return found

    def models(self) -> tuple[tuple[Numbers, Models], dict[int, ModelError]]:
        """Return the rows of valid points and their models, and the errors of the other rows."""
        kind = self.kind
        n = len(kind.contacts) * len(OF_CONTACT)
        walls, omega, others = np.split(self.numbers[:, : -kind.n_states], [n, n + 1], axis=1)
        systems, its_system, no_system = _made(kind.structure.systems, others)
        several, its_laws, no_laws = _made(kind.laws, walls)
        refused = no_system | no_laws
        rows = np.array([row for row in range(len(self)) if row not in refused], np.intp)
        columns = {"system": its_system[rows], "law": its_laws[rows], "omega": omega[rows, 0]}
        return (rows, Models(systems=systems, laws=several, **columns)), refused

    def gap(self, row: int) -> Gap:
        return Gap(*self.numbers[row, 1:3].tolist())

    def keys(self, follows: NDArray[np.bool_] | None = None) -> NDArray[np.void]:
        """Return content keys: SHA-256 of the kind's identity and a row's numbers.

        `follows`: shape (n,); whether a point starts in the end state of the one before; its key
        includes that key.
        """
        begun, keys, previous = hashlib.sha256(self.kind.identity.encode()).copy, [], b""
        if follows is None or not follows.any():
            for row in self._rows:  # without a call of `_key`, which takes as long as SHA-256
                digest = begun()
                digest.update(row)
                keys.append(digest.digest())
        else:
            for row, is_after in zip(self._rows, follows.tolist(), strict=True):
                previous = _key(begun, row, previous if is_after else b"")
                keys.append(previous)
        return np.frombuffer(b"".join(keys), KEY)

    def keys_after(self, identity: str, previous: NDArray[np.void]) -> NDArray[np.void]:
        """Return content keys for an identity, from the keys of the points before; zero: none."""
        kind, nothing = hashlib.sha256(identity.encode()).copy, bytes(KEY.itemsize)
        rows = zip(self._rows, previous.tolist(), strict=True)
        keys = (_key(kind, row, b"" if before == nothing else before) for row, before in rows)
        return np.frombuffer(b"".join(keys), KEY)

    @property
    def _rows(self) -> list[bytes]:
        numbers = np.ascontiguousarray(self.numbers, "<f8")
        found: list[bytes] = numbers.view(f"V{8 * numbers.shape[1]}").ravel().tolist()
        return found


@cache
def columns_of(structure: AnyStructure) -> tuple[str, ...]:
    """Return the names of the columns of tables of points.

    First those of all contacts, then the frequency (0 if unforced), the model's numbers, the
    initial state.
    """
    if isinstance(structure, OscillatorStructure):
        return (*OF_CONTACT, "omega", *structure.names, "x_0", "v_0")
    contacts = [f"{name}[{i}]" for i in range(len(structure.contacts)) for name in OF_CONTACT]
    sizes = {"q_0": structure.n, "v_0": structure.n, "z_0": structure.m}
    start = [f"{name}[{i}]" for name, size in sizes.items() for i in range(size)]
    return (*contacts, "omega", *structure.names, *start)


def _made(
    make: Callable[[NDArray[np.float64]], Sequence[Made]], rows: NDArray[np.float64]
) -> tuple[list[Made], Numbers, dict[int, ModelError]]:
    """Objects made of the distinct rows, the number of its object for every row, and errors.

    The number is -1 for rows that `make` refuses; their errors are returned by row.
    """
    some = rows if rows.shape[1] else np.zeros((len(rows), 1))
    _, first, which = np.unique(some, axis=0, return_index=True, return_inverse=True)
    which, distinct, errors = which.reshape(-1), rows[first], dict[int, ModelError]()
    if not len(first):
        return [], which, {}
    try:
        return [*make(distinct)], which, {}
    except ModelError:
        made, number = list[Made](), np.full(len(first), -1)
    for i in range(len(first)):
        try:
            made += make(distinct[[i]])
            number[i] = len(made) - 1
        except ModelError as error:
            errors[i] = error
    refused = {row: errors[i] for row, i in enumerate(which.tolist()) if i in errors}
    return made, number[which], refused


def _key(begun: Callable[[], Any], row: bytes, previous: bytes) -> bytes:
    digest = begun()
    digest.update(row + previous)
    return bytes(digest.digest())
