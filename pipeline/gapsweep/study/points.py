"""Sweep points: what one unit of work is, and what identifies its result."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

from gapsweep.integrate.problem import Solver
from gapsweep.model import own_law
from gapsweep.model.contact import FIT_RANGE, ContactLaw
from gapsweep.model.labels import contact_law
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.response.result import Steady
from gapsweep.study.fingerprint import numerics_fingerprint
from gapsweep.study.software import deciding, versions

# Raised whenever the stored result of a point changes its form or meaning.
RESULT_SCHEMA = 5

FIXED = "fixed"
SWEEPS = ("sweep_up", "sweep_down")
OURS = "null"  # in place of the code of a user's law


def canonical(value: float) -> float:
    """The value rounded to 12 significant digits.

    Grids reach the same coordinate by different arithmetic; after rounding they agree to
    the last bit. Done once, when a study is read: these are the values that are computed
    with, keyed and stored.
    """
    return float(f"{value:.11e}") + 0.0  # -0.0 becomes 0.0


@dataclass(frozen=True, slots=True)
class Start:
    """Initial condition: a fixed state, or the end of the neighbouring frequency's response.

    Attributes
    ----------
    kind : str
        ``"fixed"``, ``"sweep_up"`` or ``"sweep_down"``.
    x_0, v_0 : float
        Displacement [m] and velocity [m/s]; a sweep's first point starts at rest.
    """

    kind: str = FIXED
    x_0: float = 0.0
    v_0: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One sweep point, complete: all that its result depends on.

    Attributes
    ----------
    representation : str
        Canonical label, without a protocol.
    K_c, omega : float
        Contact stiffness [N/m] and forcing frequency [Hz].
    fit_range : float
        Half-width [m] of the range of fitted laws.
    start_jitter : float
        Added to a fixed initial displacement [m], for exact-against-exact floors.
    law_code : str
        Of a user's own law, as JSON; whoever computes the point must have the same.
    """

    oscillator: Oscillator
    representation: str
    K_c: float
    gap: Gap
    omega: float
    start: Start
    solver: Solver
    steady: Steady
    fit_range: float
    start_jitter: float = 0.0
    law_code: str = OURS

    @property
    def law(self) -> ContactLaw:
        """The contact law.

        Raises
        ------
        ClusterError
            If it is the user's own, and its code is another one here.
        """
        asked = self.representation, self.K_c, self.gap, self.fit_range
        if self.law_code == OURS:
            return _our_law(*asked)
        own_law.require(self.representation, self.law_code)
        return contact_law(*asked)

    def identity(self, previous: str | None = None) -> str:
        """All that the result depends on, as canonical JSON; its SHA-256 is the content key.

        Parameters
        ----------
        previous : str, optional
            Key, in hex, of the point whose end this one starts from (sweeps only).
        """
        fields = {
            "K_c": repr(self.K_c),
            "gap": _canonical_json(self.gap),
            "law": self.law_code,
            "omega": repr(self.omega),
            "oscillator": _canonical_json(self.oscillator),
            "representation": json.dumps(self.representation),
            "solver": _canonical_json(self.solver),
            "start": _canonical_json(self.start),
            "start_jitter": repr(self.start_jitter),
            "steady": _canonical_json(self.steady),
        }
        if self.representation.startswith(("poly-", "ratpoly-")):
            fields["fit_range"] = repr(self.fit_range)
        whole = {
            "numerics": json.dumps(numerics_fingerprint()),
            "point": _object(fields),
            "previous": json.dumps(previous),
            "schema": str(RESULT_SCHEMA),
            "versions": _versions(self.representation, self.solver.engine),
        }
        return _object(whole)


def point_of(identity: str) -> tuple[Point, str | None]:
    """The sweep point that an identity describes, and the key, in hex, of the one before it."""
    stored = json.loads(identity)
    fields: dict[str, Any] = {"fit_range": FIT_RANGE, **stored["point"]}
    fields["law_code"] = _json(fields.pop("law"))
    for name, kind in _SETTINGS.items():
        fields[name] = kind(**fields[name])
    return Point(**fields), stored["previous"]


_SETTINGS: dict[str, Callable[..., Any]] = {
    "oscillator": Oscillator,
    "gap": Gap,
    "start": Start,
    "solver": Solver,
    "steady": Steady,
}


def content_key(identity: str) -> bytes:
    """SHA-256 (32 bytes) of an identity."""
    return hashlib.sha256(identity.encode()).digest()


def _object(members: Mapping[str, str]) -> str:
    """A JSON object of members that are JSON already, without spaces, sorted by name."""
    return "{" + ",".join(f'"{name}":{members[name]}' for name in sorted(members)) + "}"


@lru_cache(maxsize=4096)
def _canonical_json(settings: Any) -> str:
    # The same few settings stand in all points of a study: they are written out once.
    return _json(asdict(settings))


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


# Points of one curve share their law. Not so a user's law, which may be imported anew.
_our_law = lru_cache(maxsize=256)(contact_law)


@lru_cache(maxsize=256)
def _versions(representation: str, engine: str) -> str:
    return _json({name: versions()[name] for name in deciding(representation, engine)})


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
    """Refuse what is no function of x; once, for every point of a study asks."""
    contact_law(representation, 0.0, Gap(0.0, 0.0))
