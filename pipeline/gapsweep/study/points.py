"""Sweep points: rows of a table, and what identifies the result of each."""

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.problem import Solver
from gapsweep.model import own_law
from gapsweep.model.contact import FIT_RANGE
from gapsweep.model.labels import contact_law, is_fitted
from gapsweep.model.oscillator import OSCILLATOR, Gap
from gapsweep.model.structure import Structure
from gapsweep.response.result import Steady
from gapsweep.study.fingerprint import numerics_fingerprint
from gapsweep.study.software import deciding, versions

# Raised whenever the stored result of a point changes its form or meaning.
RESULT_SCHEMA = 6

FIXED = "fixed"
SWEEPS = ("sweep_up", "sweep_down")
OURS = "null"  # in place of the code of a user's law

# The columns of every table of points: what differs from point to point.
NUMBERS = ("K_c", "j_1", "j_2", "omega", *OSCILLATOR, "x_0", "v_0")
# Those of points whose walls differ. Others do without, and have the keys that they always had.
UNEQUAL = (*NUMBERS[:-2], "K_ratio", *NUMBERS[-2:])
# Those of every contact of a system, which come first there.
OF_CONTACT = ("K_c", "j_1", "j_2", "K_ratio")
KEY = np.dtype("V32")  # a content key, as an element of an array

Numbers = NDArray[np.intp]


def canonical(value: float) -> float:
    """The value rounded to 12 significant digits.

    Grids reach the same coordinate by different arithmetic; after rounding they agree to
    the last bit. Done once, when a study is read: these are the values that are computed
    with, keyed and stored.
    """
    return float(f"{value:.11e}") + 0.0  # -0.0 becomes 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """What the points of a table have in common: all that their results depend on but numbers.

    Attributes
    ----------
    representation : str
        Canonical label, without a protocol.
    solver : Solver
    steady : Steady
    fit_range : float
        Half-width [m] of the range of fitted laws.
    start : str
        ``"fixed"``, or ``"sweep_up"`` or ``"sweep_down"``: from where the point before it ended,
        the first one from the state in the table.
    start_jitter : float
        Added to a fixed initial displacement [m], for exact-against-exact floors.
    law_code : str
        Of a user's own law, as JSON; whoever computes the point must have the same.
    numbers : tuple of str
        Columns of the table: `NUMBERS`, or `UNEQUAL` if the walls differ, or `of_systems`.
    structure : Structure, optional
        Of systems; their arrays are among the numbers.
    contacts : tuple of str
        Of systems the label of every contact's law.
    """

    representation: str
    solver: Solver
    steady: Steady
    fit_range: float = FIT_RANGE
    start: str = FIXED
    start_jitter: float = 0.0
    law_code: str = OURS
    numbers: tuple[str, ...] = NUMBERS
    structure: Structure | None = None
    contacts: tuple[str, ...] = ()

    @property
    def n_states(self) -> int:
        """Length of a start."""
        return 2 if self.structure is None else self.structure.n_states

    @property
    def is_sweep(self) -> bool:
        """Whether a point starts where the one before it ended."""
        return self.start != FIXED

    @property
    def identity(self) -> str:
        """All that it says, with the numerics and libraries that compute it, as canonical JSON."""
        return _identity(self)

    @classmethod
    def of(cls, identity: str) -> "Kind":
        """The kind that an identity describes.

        Raises
        ------
        ValueError
            If it is none.
        """
        try:
            whole = json.loads(identity)
            said = {"fit_range": FIT_RANGE, **whole["kind"], "numbers": tuple(whole["numbers"])}
            said["law_code"] = _json(said.pop("law"))
            said |= {"solver": Solver(**said["solver"]), "steady": Steady(**said["steady"])}
            if said.get("structure"):
                said["structure"] = Structure.read(said["structure"])
                said["contacts"] = tuple(said["contacts"])
            return cls(**said)
        except (TypeError, KeyError, AttributeError, RecursionError) as error:
            raise ValueError(f"{type(error).__name__}: {error}") from None


# The same few kinds stand in all tables of a study.
@lru_cache(maxsize=256)
def _identity(kind: Kind) -> str:
    said = asdict(kind)
    said["law"] = json.loads(said.pop("law_code"))
    if not any(map(is_fitted, (kind.representation, *kind.contacts))):
        del said["fit_range"]
    if kind.structure is None:  # an oscillator's key says nothing of systems
        del said["structure"], said["contacts"]
    whole = {
        "numbers": said.pop("numbers"),
        "kind": said,
        "numerics": numerics_fingerprint(),
        "schema": RESULT_SCHEMA,
        "versions": {
            name: versions()[name]
            for name in deciding((kind.representation, *kind.contacts), kind.solver.engine)
        },
    }
    return _json(whole)


@dataclass(frozen=True, slots=True)
class Points:
    """Sweep points of one kind.

    Attributes
    ----------
    kind : Kind
    numbers : ndarray, shape (n, number of columns)
        Columns as in `Kind.numbers`: N/m, m, m, Hz, then the oscillator's, m, m/s.
    """

    kind: Kind
    numbers: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.numbers)

    def column(self, name: str) -> NDArray[np.float64]:
        return self.numbers[:, self.kind.numbers.index(name)]

    def take(self, rows: Any) -> "Points":
        """Some of the points."""
        return Points(self.kind, self.numbers[rows])

    def gap(self, row: int) -> Gap:
        return Gap(*self.numbers[row, 1:3].tolist())

    def keys(self, follows: NDArray[np.bool_] | None = None) -> NDArray[np.void]:
        """Content keys: SHA-256 of the kind's identity and a row's numbers.

        Parameters
        ----------
        follows : ndarray of bool, shape (n,), optional
            Which points start where the one before it ended; its key is part of theirs.
        """
        kind, keys, previous = hashlib.sha256(self.kind.identity.encode()), [], b""
        after = [False] * len(self) if follows is None else follows.tolist()
        for row, is_after in zip(self._rows, after, strict=True):
            previous = _key(kind, row, previous if is_after else b"")
            keys.append(previous)
        return np.frombuffer(b"".join(keys), KEY)

    def keys_after(self, identity: str, previous: NDArray[np.void]) -> NDArray[np.void]:
        """Content keys of points of an identity, from those that they start from; zero: none."""
        kind, nothing = hashlib.sha256(identity.encode()), bytes(KEY.itemsize)
        rows = zip(self._rows, previous.tolist(), strict=True)
        keys = (_key(kind, row, b"" if before == nothing else before) for row, before in rows)
        return np.frombuffer(b"".join(keys), KEY)

    @property
    def _rows(self) -> list[bytes]:
        size = self.numbers.shape[1] * 8
        data = np.ascontiguousarray(self.numbers, "<f8").tobytes()
        return [data[at : at + size] for at in range(0, len(data), size)]


def of_systems(structure: Structure) -> tuple[str, ...]:
    """The columns of tables of points of systems.

    Those of all contacts, then the frequency (0 where nothing is forced), the arrays, the start.
    """
    contacts = [f"{name}[{i}]" for i in range(len(structure.contacts)) for name in OF_CONTACT]
    sizes = {"q_0": structure.n, "v_0": structure.n, "z_0": structure.m}
    start = [f"{name}[{i}]" for name, size in sizes.items() for i in range(size)]
    return (*contacts, "omega", *structure.names, *start)


def with_ratio(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tables of points with the columns `UNEQUAL`; the ratio of equal walls is 1."""
    if numbers.shape[1] != len(NUMBERS):
        return numbers
    return np.insert(numbers, UNEQUAL.index("K_ratio"), 1.0, axis=1)


def _key(kind: Any, row: bytes, previous: bytes) -> bytes:
    digest = kind.copy()
    digest.update(row + previous)
    return bytes(digest.digest())


def law_code(representation: str) -> str:
    """All that a user's own law computes with, as JSON; null for ours (numerics fingerprint).

    Raises
    ------
    ModelError
        If it cannot be imported or keyed, or is no function of x.
    """
    if ":" not in representation:
        return OURS
    code = own_law.code(representation)
    _try_out(representation, code)
    return code


@lru_cache(maxsize=64)
def _try_out(representation: str, code: str) -> None:
    """Refuse what is no function of x; once, for every table of a study asks."""
    contact_law(representation, 0.0, Gap(0.0, 0.0))


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
