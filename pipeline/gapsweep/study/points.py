"""Sweep points: what one unit of work is, and what identifies its result."""

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

from gapsweep.integrate.problem import Solver
from gapsweep.model.contact import ContactLaw, UserLaw
from gapsweep.model.labels import contact_law
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.response.respond import Steady
from gapsweep.study.fingerprint import normalised_source, numerics_fingerprint

# Raised whenever the stored result of a point changes its form or meaning.
RESULT_SCHEMA = 2

FIXED = "fixed"
SWEEPS = ("sweep_up", "sweep_down")


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

    @property
    def law(self) -> ContactLaw:
        build = contact_law if ":" in self.representation else _own_law
        return build(self.representation, self.K_c, self.gap, self.fit_range)

    def identity(self) -> dict[str, Any]:
        """All fields that the result depends on, as plain JSON values."""
        fields = asdict(self)
        fields["law_source"] = _law_source(self.representation)
        if not self.representation.startswith(("poly-", "ratpoly-")):
            del fields["fit_range"]
        return fields


# Points of one curve share their law. Not so a user's law, which may be imported anew.
_own_law = lru_cache(maxsize=256)(contact_law)


@lru_cache(maxsize=64)
def _law_source(representation: str) -> str | None:
    """Normalised source of a user's own law; None for ours (in the numerics fingerprint)."""
    if ":" not in representation:
        return None
    law = contact_law(representation, 0.0, Gap(0.0, 0.0))
    assert isinstance(law, UserLaw)
    return normalised_source(law.source)


def key(point: Point, previous: str | None = None) -> str:
    """Content key of a point's result: SHA-256 of its canonical JSON.

    Parameters
    ----------
    point : Point
    previous : str, optional
        Key of the point whose end this one starts from (sweeps only).
    """
    identity = {
        "point": point.identity(),
        "previous": previous,
        "numerics": numerics_fingerprint(),
        "schema": RESULT_SCHEMA,
    }
    text = json.dumps(identity, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
