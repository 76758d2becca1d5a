"""Labels: the text form of a contact law in studies, datasets and plots.

A label is a family with its parameter, as ``tanh-1e4`` (all families are in `LAWS`), or

- ``my_module:spring``, the function ``spring(x)`` in ``my_module.py``, or a table of that name;
- ``stop.csv:mm``, measured forces [N] at displacements [mm] in ``stop.csv``;
- ``auto``, in a study: the simplest adequate model of each point.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable
from pathlib import Path

from gapsweep.errors import ModelError
from gapsweep.model.contact import (
    FIT_RANGE,
    OF_LABELS,
    ContactLaw,
    HuntCrossley,
    Piecewise,
    Rigid,
)
from gapsweep.model.laws import LAWS
from gapsweep.model.laws.fitted import Fitted
from gapsweep.model.oscillator import Gap, called_as
from gapsweep.model.own_law import OwnLaw
from gapsweep.model.user_law import UserLaw

# The label of a user's law, ``module:name``.
FUNCTION = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


# Laws that take a parameter of contacts, for messages.
TAKEN_BY = {
    "damping": "piecewise, tanh, arctan and logarctan have, and own functions f(x, v)",
    "preload": "piecewise has",
    "chi": "huntcrossley without a number has",
    "restitution": "rigid without a number has",
}

# Every law that a label names, by its family, in the order of the user guide. Contacts that lose
# energy are located: they have no compiled formulas of `LAWS`.
_EVERY: tuple[type[ContactLaw], ...] = (*LAWS, HuntCrossley, Rigid)
FAMILIES = {law.family: law for law in _EVERY}
EXAMPLES = ", ".join(example for law in FAMILIES.values() for example in law.examples)


class Representation(str):
    """A contact law with, optionally, a solver protocol: the text of its label, and its parts.

    It is equal to its label, ``law`` or ``law@protocol``, in study files, keys and datasets. Labels
    of datasets are taken as they are; `parsed` checks a label that a user wrote.
    """

    __slots__ = ()

    @classmethod
    def parsed(cls, label: str) -> Representation:
        """Return the representation of a label in canonical spelling.

        Raises `ModelError` if the law is unknown or its parameter is out of range.
        """
        law, at, protocol = label.partition("@")
        return cls(canonical_label(law) + at + protocol)

    @property
    def law(self) -> Representation:
        """The law without the protocol."""
        return Representation(self.partition("@")[0])

    @property
    def protocol(self) -> str:
        """Name of the solver protocol; empty without one."""
        return self.partition("@")[2]

    @property
    def family(self) -> str:
        """Name of the law's family, as ``tanh``; empty for ``auto``, user laws and other texts."""
        name = self.law.partition("-")[0]
        return name if name in FAMILIES else ""

    @property
    def parameter(self) -> str:
        """Parameter of a law of a family, as ``1e4`` or ``5/3``; empty without one."""
        return self.law.partition("-")[2] if self.family else ""

    @property
    def law_type(self) -> type[ContactLaw] | None:
        """Class of the law; None without a family."""
        return FAMILIES.get(self.family)

    @property
    def is_auto(self) -> bool:
        """Whether gapsweep chooses the simplest adequate model of each point."""
        return self.law == AUTO

    @property
    def is_own(self) -> bool:
        """Whether the law is a user's, ``module:name`` or ``file.csv:unit``."""
        return ":" in self.law

    @property
    def is_located(self) -> bool:
        """Whether the times of contacts are located."""
        kind = self.law_type
        return kind is not None and issubclass(kind, Piecewise) and self.law != NOT_LOCATED

    @property
    def numbers(self) -> dict[str, float]:
        """Values in the label of parameters that otherwise are numbers of a study, by name."""
        own = self.law_type.of_label(self.parameter, FIT_RANGE) if self.law_type else {}
        return {name: value for name, value in own.items() if name in OF_LABELS}

    def takes(self, name: str) -> bool:
        """Whether the law has a parameter of contacts that its label does not set, as `damping`."""
        if self.law == NOT_LOCATED and name in ("damping", "preload"):
            return False
        return (self.law_type or ContactLaw).takes(name) and name not in self.numbers

    @property
    def missing(self) -> list[str]:
        """Parameters of the law without a default value that its label does not set."""
        return [name for name in OF_LABELS if self.takes(name)]

    def refusal(self, name: str) -> str:
        """Return why the law does not take a parameter of contacts, for messages."""
        if name in self.numbers:
            return f"{self} has it in its label; write {self.family}, or leave {name} out"
        return f"{self} has none; {TAKEN_BY[name]}"

    @property
    def is_fitted(self) -> bool:
        """Whether the law is fitted over a range."""
        return self.law_type is not None and issubclass(self.law_type, Fitted)


AUTO = Representation("auto")
# The exact law, to which all others are compared, and its form without located contacts.
EXACT, NOT_LOCATED = Representation("piecewise"), Representation("piecewise-noevents")


def canonical_label(label: str) -> str:
    """Return the canonical spelling of a label, as ``tanh-1e4`` for ``tanh-10000``.

    Raises
    ------
    ModelError
        If the label is unknown or its parameter is out of range.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.canonical_label("tanh-10000")
    'tanh-1e4'
    """
    if not isinstance(label, str):
        raise ModelError(f"representation = {label!r}: must be a label, one of {EXAMPLES}")
    if label == AUTO or FUNCTION.fullmatch(label):
        return label
    name, dash, parameter = label.partition("-")
    law = FAMILIES.get(name)
    if law is None:
        raise ModelError(
            f"unknown representation {label!r}: {_likely(label)}use one of {EXAMPLES} or "
            "module:name, or stop.csv:mm for a table"
        )
    return f"{name}{dash}{law.canonical(label, parameter)}"


def _likely(label: str) -> str:
    """The question "did you mean …?" with a label of similar spelling; empty without any."""
    word, parameter = re.findall(r"([A-Za-z]*)[-\s]*(.*)", label)[0]
    alike = difflib.get_close_matches(word.lower(), FAMILIES, n=1)
    return f"did you mean {'-'.join(filter(None, [alike[0], parameter]))}? Or " if alike else ""


def unknown_number(name: str, known: Iterable[str]) -> str:
    """Return why a study has no number of this name to vary, for messages."""
    if name in TAKEN_BY:
        return f"no representation has it; {TAKEN_BY[name]}"
    return f"must be one of {', '.join(known)}"


@called_as("gs.contact_law('tanh-1e4', K_c=1.4e4, gap=gs.Gap(4e-4, 4e-4)), in N/m and m")
def contact_law(
    label: str,
    K_c: float,
    gap: Gap,
    fit_range: float = FIT_RANGE,
    *,
    K_ratio: float = 1.0,
    damping: float = 0.0,
    preload: float = 0.0,
    pulls: bool = False,
    chi: float | None = None,
    restitution: float | None = None,
) -> ContactLaw:
    """Return the contact law of a label.

    Parameters
    ----------
    label : str
        Family and parameter, as ``piecewise``, ``tanh-1e4`` [1/m], ``poly-13`` or ``ratpoly-5/3``.
    K_c : float
        Contact stiffness [N/m], ``>= 0``; stiffness of the upper wall if the walls differ.
    gap : Gap
        Distances of the walls from the origin [m].
    fit_range : float
        Half-width of the fit range of polynomials [m].
    K_ratio : float
        Stiffness of the lower wall over the stiffness of the upper wall [-], ``>= 0``.
    damping : float
        Damping of both walls [N s/m], ``>= 0``, for ``piecewise``, ``tanh``, ``arctan`` and
        ``logarctan``.
    preload : float
        Force of the compressed springs of both walls at the wall [N], ``>= 0``, for ``piecewise``.
    pulls : bool
        Whether walls with damping pull, for ``piecewise``; those of the other three always do.
    chi : float, optional
        χ [s/m], ``>= 0``, of ``huntcrossley`` without a number.
    restitution : float, optional
        Coefficient of restitution [-], 0 to 1, of ``rigid`` without a number.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.contact_law("tanh-1e4", 1.4e4, gs.Gap(0.4e-3, 0.4e-3)).epsilon
    10000.0
    """
    law = Representation(canonical_label(label))
    if law.is_auto:
        raise ModelError("'auto' is for studies only; write a representation, as 'piecewise'")
    elastic = {"damping": damping or None, "preload": preload or None}
    numbers = elastic | {"chi": chi, "restitution": restitution}
    given = {name: value for name, value in numbers.items() if value is not None}
    for name, value in given.items():
        if not law.takes(name):
            raise ModelError(f"{name} = {value}: {law.refusal(name)}")
    if law.law_type is None:
        return OwnLaw.of(law, [Path.cwd()]).law(K_c, gap, K_ratio)
    for name in law.missing:
        if name not in given:
            raise ModelError(f"{name}: missing; give it, or write {law.law_type.examples[0]}")
    own = law.law_type.of_label(law.parameter, fit_range) | given
    if damping and law.law_type.takes("pulls"):
        own["pulls"] = bool(pulls)
    return law.law_type.made(K_c, gap, K_ratio=K_ratio, **own)


@called_as("gs.law(function, K_c=1.4e4, gap=gs.Gap(4e-4, 4e-4)), in N/m and m")
def law(
    function: Callable[..., float],
    K_c: float,
    gap: Gap,
    *,
    K_ratio: float = 1.0,
    **parameters: float,
) -> UserLaw:
    """Return a user law: a function from displacement [m] to restoring force [N].

    A second argument with the name ``v`` is the velocity [m/s]. `parameters` are values of its
    other arguments, 4 at most: the function is compiled once for all values.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.law(lambda x: 1e9 * x**3, K_c=1.0, gap=gs.Gap(0.0, 0.0)).force(1e-3).round(6).item()
    1.0
    >>> hertz = lambda x, n: 1e6 * x * abs(x) ** (n - 1.0)
    >>> laws = [gs.law(hertz, 1.4e4, gs.Gap(0.0, 0.0), n=n) for n in (1.4, 1.5, 1.6)]
    >>> gs.respond(gs.systems.paper_oscillator(), laws, omega=9.0).amplitude.shape
    (3,)
    """
    return UserLaw(K_c, gap, function, parameters, K_ratio=K_ratio)
