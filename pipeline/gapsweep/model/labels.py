"""Labels: the text form of a contact law in studies, datasets and plots.

========================= ==========================================================
``piecewise``             exact force, every contact located
``piecewise-noevents``    exact force, contacts not located
``poly-13``               polynomial of degree 13
``ratpoly-5/3``           rational polynomial, numerator and denominator degree
``tanh-1e4``              tanh, epsilon = 1e4 /m; ``arctan-…`` likewise
``logarctan-1e4``         log-arctan, gamma = 1e4 /m
``my_module:spring``      the function ``spring(x)`` of the importable ``my_module``
``auto``                  in a study: the least model that each sweep point needs
========================= ==========================================================
"""

import math
import re
from collections.abc import Callable
from decimal import Decimal

from gapsweep.errors import ModelError
from gapsweep.model import own_law
from gapsweep.model.contact import (
    FIT_RANGE,
    Arctan,
    ContactLaw,
    LogArctan,
    Piecewise,
    Polynomial,
    RationalPolynomial,
    Tanh,
    UserLaw,
)
from gapsweep.model.fit import MAX_DEGREE, MAX_RATIONAL_DEGREE
from gapsweep.model.oscillator import Gap

AUTO = "auto"
EXAMPLES = (
    "piecewise, piecewise-noevents, poly-13, ratpoly-5/3, tanh-1e4, arctan-1e4, logarctan-1e4"
)
_SMOOTH: dict[str, type[Tanh] | type[Arctan] | type[LogArctan]] = {
    "tanh": Tanh,
    "arctan": Arctan,
    "logarctan": LogArctan,
}
_FUNCTION = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


def canonical_label(label: str) -> str:
    """The one spelling of a label: ``tanh-10000`` and ``tanh-1e4`` are ``tanh-1e4``.

    Raises
    ------
    ModelError
        If the label is unknown or its parameter out of range.
    """
    if not isinstance(label, str):
        raise ModelError(f"representation = {label!r}: must be a label, one of {EXAMPLES}")
    family, _, parameter = label.partition("-")
    if label in ("piecewise", "piecewise-noevents", AUTO) or _FUNCTION.fullmatch(label):
        return label
    if family in _SMOOTH:
        return f"{family}-{_canonical_number(label, parameter)}"
    if family == "poly":
        return f"poly-{_degree(label, parameter, MAX_DEGREE)}"
    if family == "ratpoly":
        top, _, bottom = parameter.partition("/")
        degrees = (_degree(label, text, MAX_RATIONAL_DEGREE) for text in (top, bottom))
        return "ratpoly-{}/{}".format(*degrees)
    raise ModelError(f"unknown representation {label!r}: use one of {EXAMPLES} or module:function")


def contact_law(label: str, K_c: float, gap: Gap, fit_range: float = FIT_RANGE) -> ContactLaw:
    """Build a contact law from its label.

    Parameters
    ----------
    label : str
        See the module's table.
    K_c : float
        Contact stiffness [N/m], ``>= 0``.
    gap : Gap
        Distances of the walls from the origin.
    fit_range : float
        Half-width [m] of the range on which polynomials are fitted.
    """
    label = canonical_label(label)
    family, _, parameter = label.partition("-")
    if label == AUTO:
        raise ModelError("'auto' is no law: a study chooses one for every sweep point")
    if ":" in label:
        return law(own_law.function(label), K_c, gap)
    if family == "piecewise":
        return Piecewise(K_c, gap, located=not parameter)
    if family == "poly":
        return Polynomial(K_c, gap, int(parameter), fit_range)
    if family == "ratpoly":
        top, bottom = parameter.split("/")
        return RationalPolynomial(K_c, gap, int(top), int(bottom), fit_range)
    return _SMOOTH[family](K_c, gap, float(parameter))


def law(function: Callable[[float], float], K_c: float, gap: Gap) -> UserLaw:
    """A user's own contact law from a scalar function of the displacement [m] to newtons."""
    return UserLaw(K_c, gap, function)


def _canonical_number(label: str, text: str) -> str:
    try:
        value = float(text)
    except ValueError:
        raise ModelError(f"{label!r}: {text!r} is not a number, as in tanh-1e4") from None
    if not (math.isfinite(value) and value > 0.0):
        raise ModelError(f"{label!r}: the convergence parameter must be > 0 and finite, in 1/m")
    digits, exponent = f"{value:.11e}".split("e")
    return f"{Decimal(digits).normalize():f}e{int(exponent)}"


def _degree(label: str, text: str, largest: int) -> int:
    if not re.fullmatch(r"[0-9]{1,3}", text) or not 1 <= int(text) <= largest:
        raise ModelError(f"{label!r}: degree {text!r} must be a whole number in 1..{largest}")
    return int(text)
