"""Demands on steady responses, as signed margins: negative where a demand holds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Laws, Model
from gapsweep.model.oscillator import called_as, checked, whole
from gapsweep.quantities import without_units
from gapsweep.response.result import RESPONSE, ResponseClass, Responses
from gapsweep.status import Status
from gapsweep.variables import CONTACT, COORDINATE

Array = NDArray[np.float64]

# A gap so close to a rigid wall, as a share of its distance, touches it: no gap is beyond it.
AT_WALL = 1e-10
_NAME = re.compile(r"(\w+)(?:\[(.+)\])?")
# Numbers of a response that are no physical quantity.
_NOT = {
    *("status", "response_class", "n_extrema", "n_contacts", "n_steps", "n_rejected", "nfev"),
    *("t_settled", "t_simulated", "atol", "stability_rtol", "noise", "cpu_time"),
    *("x_end", "v_end", "lyapunov_error"),
}
QUANTITIES = tuple(
    name
    for name, variable in RESPONSE.items()
    if name not in _NOT and not set(variable.dims) - {COORDINATE, CONTACT}
)


def quantity(name: str, found: Responses, model: Model) -> Array:
    """Return a quantity of responses, shape (n, number of coordinates or contacts).

    Raises `ModelError` if the responses of the model do not have it.

    `name`: variable of responses, as ``"x_max"``; of one coordinate or contact as ``"x_max[h]"``.
    """
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    known = [each for each in QUANTITIES if each in found.columns]
    if match is None or match[1] not in known:
        raise ModelError(f"quantity {name!r}: must be one of {', '.join(known)}")
    values = np.asarray(found.columns[match[1]], float).reshape(len(found), -1)
    if match[2] is None:
        return values
    dims = RESPONSE[match[1]].dims
    labels: Sequence[str] = ()
    if dims:
        of_coordinates = dims[0] == COORDINATE
        labels = getattr(model, "coordinates", ("x",)) if of_coordinates else [*model.contacts]
    if match[2] not in labels:
        said = f"must have one of {', '.join(labels)} in brackets" if labels else "has no parts"
        raise ModelError(f"quantity {name!r}: {said}")
    return values[:, [list(labels).index(match[2])]]


@dataclass(frozen=True, slots=True, repr=False)
class Demand:
    """A demand on a steady response, made by `at_most`, `at_least`, `no_contact`, `no_chaos` or
    `periodic`.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.at_least("x_max", "0.3 mm").limit
    0.0003
    """

    words: str
    quantity: str = ""  # variable of responses
    limit: float = 0.0
    sign: int = 1  # 1: the quantity must not be larger than the limit; -1: not smaller
    most_periods: int = 0  # of `periodic`; 0: any number

    def __repr__(self) -> str:
        return f"<gapsweep.Demand: {self.words}>"

    @property
    def is_graded(self) -> bool:
        """Whether the margin says how far a response is from violating the demand."""
        return bool(self.quantity) or self.words == "no contact"

    def margin(self, found: Responses, model: Model, laws: Sequence[Laws]) -> Array:
        """Return a number per response, ``<= 0`` where the demand holds; shape (n,).

        Parameters
        ----------
        laws : sequence of tuple of ContactLaw, length n
            Laws of the contacts of each response.
        """
        kind = found.columns["response_class"]
        if self.quantity:
            values = self.sign * (quantity(self.quantity, found, model) - self.limit)
            return np.asarray(values.max(axis=1) / (abs(self.limit) or 1.0))
        if self.words == "no contact":
            return _beyond(found, laws)
        holds = kind != ResponseClass.CHAOTIC
        if self.words != "no chaos":
            multiple = found.columns["period_multiple"]
            holds = (kind == ResponseClass.PERIODIC) | (kind == ResponseClass.EQUILIBRIUM)
            holds &= (multiple <= self.most_periods) | (self.most_periods == 0)
        return np.where(holds, -1.0, 1.0)


def _beyond(found: Responses, laws: Sequence[Laws]) -> Array:
    """Largest distance of a response beyond a wall that is felt, over the wall's distance."""
    columns = found.columns
    prefix = "contact_x" if "contact_x_max" in columns else "x"
    high, low = (columns[f"{prefix}_{end}"].reshape(len(found), -1) for end in ("max", "min"))
    walls = np.array([[law.walls for law in each] for each in laws]).reshape(len(found), -1, 2)
    size = np.abs(walls).min(axis=2)
    size = np.where(size > 0.0, size, 1.0)
    beyond = np.maximum(high - walls[:, :, 1], walls[:, :, 0] - low) / size
    is_rigid = np.array([[law.losses.is_rigid for law in each] for each in laws])
    beyond += AT_WALL * is_rigid.reshape(len(found), -1)
    return np.asarray(beyond.max(axis=1, initial=-np.inf))


def margins(
    demands: Sequence[Demand], found: Responses, model: Model, laws: Sequence[Laws]
) -> tuple[Array, NDArray[np.intp]]:
    """Return the largest margin of each response, and the number of its demand.

    A response that failed or is unresolved violates every demand.
    """
    every = np.array([demand.margin(found, model, laws) for demand in demands])
    is_known = (found.columns["status"] == Status.OK) & np.isfinite(every).all(axis=0)
    every[:, ~is_known] = 1.0
    return every.max(axis=0), every.argmax(axis=0)


@called_as("gs.at_most('amplitude', 5e-4)")
def at_most(quantity: str, limit: Any) -> Demand:
    """Return the demand that a quantity of the steady response is not larger than a limit.

    Parameters
    ----------
    quantity : str
        Variable of responses with one number, coordinate or contact, as ``"amplitude"``,
        ``"x_max"``, ``"force_max"`` or ``"contact_share"``. All coordinates or contacts of a system
        count; ``"x_max[h]"`` is that of coordinate h.
    limit : float
        In the unit of the variable.

    Raises
    ------
    ModelError
        If the quantity is unknown, or the limit is no finite number.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.at_most("amplitude", 5e-4)
    <gapsweep.Demand: amplitude at most 0.0005>
    """
    return _limited(quantity, limit, 1, "at most")


@called_as("gs.at_least('amplitude', 2e-4)")
def at_least(quantity: str, limit: Any) -> Demand:
    """Return the demand that a quantity of the steady response is not smaller than a limit.

    Parameters, errors as `at_most`.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.at_least("amplitude", 2e-4)
    <gapsweep.Demand: amplitude at least 0.0002>
    """
    return _limited(quantity, limit, -1, "at least")


def _limited(name: str, limit: Any, sign: int, words: str) -> Demand:
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None or match[1] not in QUANTITIES:
        raise ModelError(f"quantity = {name!r}: must be one of {', '.join(QUANTITIES)}")
    number = checked("limit", without_units("limit", limit, RESPONSE[match[1]].units))
    return Demand(f"{name} {words} {number:g}", name, number, sign)


@called_as("gs.no_contact()")
def no_contact() -> Demand:
    """Return the demand that the steady response touches no wall.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.no_contact()
    <gapsweep.Demand: no contact>
    """
    return Demand("no contact")


@called_as("gs.no_chaos()")
def no_chaos() -> Demand:
    """Return the demand that the steady response is not chaotic.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.no_chaos()
    <gapsweep.Demand: no chaos>
    """
    return Demand("no chaos")


@called_as("gs.periodic(1)")
def periodic(most_periods: int | None = None) -> Demand:
    """Return the demand that the steady response is periodic, or an equilibrium.

    Parameters
    ----------
    most_periods : int, optional
        Largest period multiple, 1 to 256; None: any.

    Raises
    ------
    ModelError
        If `most_periods` is out of range.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.periodic(1)
    <gapsweep.Demand: periodic, period multiple at most 1>
    """
    if most_periods is None:
        return Demand("periodic")
    most = whole("most_periods", most_periods, 1, 256)
    return Demand(f"periodic, period multiple at most {most}", most_periods=most)
