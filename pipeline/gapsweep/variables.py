"""Variables of datasets, and the datasets and tables of the results of one call."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import permutations
from typing import TYPE_CHECKING, Any

from gapsweep.status import Status

# Models import this module: numpy and xarray are imported where they are used, so that
# ``import gapsweep`` does not wait for them.
if TYPE_CHECKING:
    import numpy as np
    import xarray as xr
    from numpy.typing import ArrayLike, NDArray

START, POINT = "initial_condition", "point"
# Dimensions within a point: the parts of a system, and lists that are padded where they end.
COORDINATE, CONTACT, LAG = "coordinate", "contact", "lag"
EXTREMUM, SECTION_POINT, MULTIPLIER = "extremum", "section_point", "multiplier"
# Units that do not depend on the meaning of a coordinate.
_OWN_UNITS = {"1", "s", "s-1", "Hz"}
# Units of the coordinates and contacts of a model, by dimension; those of an oscillator.
Units = Mapping[str, Sequence[str]]
METRES: Units = {COORDINATE: ("m",), CONTACT: ("m",)}
# Units of quantities with coordinates in radians or without dimension, by those in metres.
_IN = {
    "rad": {
        "m": "rad",
        "mm": "rad",
        "m s-1": "rad s-1",
        "N": "N m",
        "N m-1": "N m rad-1",
        "N s m-1": "N m s rad-1",
        "m-1": "rad-1",
        "s m-1": "s rad-1",
    },
    "1": {
        **dict.fromkeys(("m", "mm", "m s-1", "N", "N m-1", "N s m-1", "m-1"), "1"),
        "s m-1": "s",
    },
}


@dataclass(frozen=True, slots=True)
class Variable:
    """Metadata of a dataset variable: type, units, long name, missing value, flags."""

    dtype: str  # type code of NumPy, or ``"str"``
    units: str  # UDUNITS text, ``"1"`` if nondimensional; empty if only the user knows
    long_name: str
    missing: float = float("nan")  # value in cells that are no sweep point
    flags: tuple[tuple[str, int], ...] = ()  # meanings and values, for flag variables
    # Dimensions, those within a point for a variable of points. An oscillator has no `COORDINATE`,
    # `CONTACT` and `LAG`.
    dims: tuple[str, ...] = ()

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the variable in a file."""
        import numpy as np

        attributes: dict[str, Any] = {"units": self.units} if self.units else {}
        attributes["long_name"] = self.long_name
        if self.flags:
            names, values = zip(*self.flags, strict=True)
            attributes["flag_values"] = np.array(values, dtype=self.dtype)
            attributes["flag_meanings"] = " ".join(names)
        return attributes

    def in_units(self, units: Units, of: str = COORDINATE) -> "Variable":
        """Return the variable of a model with coordinates and contacts in these units.

        It has no unit if these differ; see `PART_UNITS`.

        `units`: units of all coordinates, and of all contacts: of the displacement ``b · q``.
        `of`: dimension that a variable without dimensions belongs to.
        """
        own = {*units[CONTACT if CONTACT in self.dims else of]}
        return replace(self, units=unit_in(self.units, own.pop() if len(own) == 1 else ""))


def unit_in(units: str, own: str) -> str:
    """Return the unit of a quantity with coordinates in `own`, from its unit with metres.

    Empty if `own` is unknown and matters.
    """
    if own == "m" or units in _OWN_UNITS:
        return units
    return _IN.get(own, {}).get(units, "")


def canonical(value: float) -> float:
    """Return the value rounded to 12 significant digits.

    Grids reach the same coordinate by different arithmetic; after rounding they agree to the last
    bit. Studies round when they are read: they compute, key and store these values. Datasets of a
    call have rounded coordinates, so that they align with those of studies.
    """
    return float(f"{value:.11e}") + 0.0  # -0.0 becomes 0.0


def canonical_values(values: "ArrayLike") -> "NDArray[np.float64]":
    """Return `canonical` of every element; an array of the shape of `values`."""
    import numpy as np

    of = np.asarray(values, float)
    with np.errstate(all="ignore"):
        digits = 11.0 - np.floor(np.log10(np.abs(of)))  # behind the decimal point
        is_exact = (digits >= 0.0) & (digits <= 22.0)  # those powers of ten are
        powers = np.array([10.0**k for k in range(23)])[np.where(is_exact, digits, 0.0).astype(int)]
        shifted = of * powers
        whole = np.rint(shifted)
        # Rounding of the product shifts it by less than 1e-4, and a quotient is correctly rounded.
        is_sure = is_exact & (np.abs(np.abs(shifted - whole) - 0.5) > 1e-3)
        is_sure &= (np.abs(shifted) >= 1e11) & (np.abs(shifted) < 1e12)
        found = np.asarray(whole / powers)
    found[~is_sure] = [canonical(value) for value in of[~is_sure].tolist()]
    return found


def empty(table: Mapping[str, Variable], sizes: Mapping[str, int]) -> dict[str, Any]:
    """Arrays of a table's variables, filled with their missing values."""
    import numpy as np

    return {
        name: np.full([sizes[dim] for dim in one.dims], one.missing, one.dtype)
        for name, one in table.items()
    }


def with_attributes(table: Mapping[str, Variable], arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return dimensions, values and attributes of every variable, as for `xarray.Dataset`."""
    return {name: (one.dims, arrays[name], one.attributes) for name, one in table.items()}


STATUS_FLAGS = tuple((status.label, int(status)) for status in Status)
# Variables of every motion.
COUNTS = {
    "n_contacts": Variable("i8", "1", "wall crossings of the motion, in and out", 0),
    "n_steps": Variable("i8", "1", "accepted steps of the motion", 0),
    "n_rejected": Variable("i8", "1", "rejected steps of the motion", 0),
    "nfev": Variable("i8", "1", "right-hand-side evaluations of the motion", 0),
}
# Coordinates of the points of a call: frequency and initial state.
INPUTS = {
    "omega": Variable("f8", "Hz", "forcing frequency"),
    START: Variable("i4", "1", "number of the initial condition"),
    "x_0": Variable("f8", "m", "initial displacement", dims=(COORDINATE,)),
    "v_0": Variable("f8", "m s-1", "initial velocity", dims=(COORDINATE,)),
    "z_0": Variable("f8", "", "initial first-order state", dims=(LAG,)),
}
# The dimensions that systems have within a point.
PARTS = {
    COORDINATE: Variable("str", "1", "coordinate of the system"),
    CONTACT: Variable("str", "1", "contact of the system"),
    LAG: Variable("str", "1", "first-order state of the system"),
}
# The units of coordinates and of contacts, if they differ: a coordinate along either dimension.
PART_UNITS = {
    f"{dim}_unit": Variable("str", "1", f"unit of the {dim}", dims=(dim,))
    for dim in (COORDINATE, CONTACT)
}


def part_units(units: Units) -> dict[str, list[str]]:
    """Return the values of `PART_UNITS` of a model, without those that are all the same."""
    return {f"{dim}_unit": list(some) for dim, some in units.items() if len({*some}) > 1}


def members(kind: type[IntEnum], numbers: "NDArray[np.integer]") -> Any:
    """Array of the members of an enumeration with these numbers, counted from 0; a 0-d array
    gives one member.
    """
    import numpy as np

    return np.array([*kind], dtype=object)[numbers]


def objects(value: Any) -> "NDArray[Any]":
    """Array of the objects of a list, tuple or array; a single object gives a 0-d array."""
    import numpy as np

    if isinstance(value, list | tuple | np.ndarray):
        return np.array(value, dtype=object)
    found = np.empty((), object)
    found[()] = value
    return found


def dataset(
    inputs: Mapping[str, Any],
    shape: tuple[int, ...],
    table: Mapping[str, Variable],
    arrays: Mapping[str, "NDArray[Any]"],
    labels: Mapping[str, Sequence[str]] | None = None,
) -> "xr.Dataset":
    """Dataset of the results of one call, with its inputs as coordinates and attributes.

    Its dimensions are `omega` and `initial_condition` if one model is computed at every frequency
    from every initial state, otherwise `point`. The other inputs are its attributes.

    Parameters
    ----------
    inputs : mapping of str to object
        Arguments of the call by name; frequencies and initial states in the shape of the points.
    shape : tuple of int
    table : mapping of str to Variable
        The variables.
    arrays : mapping of str to ndarray, shape (n, ...)
        Values of the variables for all points (flattened), along their dimensions.
    labels : mapping of str to sequence of str, optional
        Further dimensions within a point, with their coordinates.
    """
    import numpy as np
    import xarray as xr  # takes half a second, which no computation needs

    model = objects(inputs["oscillator"]).flat[0]
    parts = model.parts
    is_grid = not any(np.ndim(inputs.get(name, 0)) for name in ("oscillator", "law", "n_periods"))
    states = {
        name.replace("q", "x"): np.reshape(inputs[name], (*shape, -1))
        for name in ("x_0", "q_0", "v_0", "z_0")
        if name in inputs
    }
    axes = {START: np.concatenate([*states.values()], axis=-1)}
    if inputs["omega"] is not None:
        axes = {"omega": np.reshape(inputs["omega"], (*shape, 1))} | axes

    def spans(dims: tuple[str, ...]) -> bool:
        """Whether every input varies along its own dimension only."""
        others = ((i, axes[x]) for i, dim in enumerate(dims) for x in axes if x != dim)
        return all(bool((values == values.take([0], i)).all()) for i, values in others)

    grids = permutations(axes, len(shape)) if is_grid else ()
    dims = next(filter(spans, grids), (POINT,))
    n = math.prod(shape)
    sizes = dict(zip(dims, shape if len(dims) == len(shape) else (n,), strict=True))
    parts = {**parts, **(labels or {})}
    sizes |= {name: len(each) for name, each in parts.items()}
    described = {**INPUTS, **table}

    def variable(name: str, along: tuple[str, ...], values: "NDArray[Any]") -> tuple[Any, ...]:
        """Return a variable as for xarray, without dimensions that the model does not have."""
        form = described[name].in_units(model.part_units)
        along += tuple(dim for dim in form.dims if dim in parts or dim not in PARTS)
        return along, values.reshape([sizes.get(dim, -1) for dim in along]), form.attributes

    found = {
        name: (name, list(each), PARTS[name].attributes if name in PARTS else {})
        for name, each in parts.items()
    }
    for name, some in part_units(model.part_units).items():
        found[name] = (PART_UNITS[name].dims, some, PART_UNITS[name].attributes)
    if START in dims:
        found[START] = variable(START, (START,), np.arange(sizes[START], dtype="i4"))
    for name, values in (axes | states).items():
        own = tuple(dim for dim in dims if dim in (POINT, "omega" if name == "omega" else START))
        if name != START:
            at = tuple(slice(None) if dim in own else 0 for dim in dims)
            rounded = canonical_values(values[at].ravel())
            found[name] = variable(name, own, rounded)
    found |= {name: variable(name, dims, values) for name, values in arrays.items()}
    attributes = {
        name: value if isinstance(value, str | float) else repr(value)
        for name, value in inputs.items()
        if name not in ("omega", *states, "q_0") and value is not None
    }
    coordinates = [name for name in found if name not in arrays]
    made = xr.Dataset(found, attrs=attributes).set_coords(coordinates)
    return made.transpose("omega", START, ...) if dims == (START, "omega") else made


def to_dataframe(dataset: "xr.Dataset", *more: str) -> Any:
    """Return the points of a dataset as a `pandas.DataFrame`.

    Parameters
    ----------
    dataset : Dataset
        As ``responses.nc``, or a part of it.
    *more : str
        Further dimensions with a row for each entry.

    Returns
    -------
    DataFrame
        Columns are dimensions, then variables with one value in a row, with a column for every
        coordinate or contact of a system, as ``x_max[h]``. Flags are words. Cells that are no sweep
        point are left out.
    """
    rows, columns = (*dataset["status"].dims, *more), dict[str, Any]()
    if not rows:
        return to_dataframe(dataset.expand_dims(POINT)).drop(columns=POINT)
    for name, variable in _in_words(dataset.reset_coords()).data_vars.items():
        within = [dim for dim in variable.dims if dim not in rows]
        if not within:
            columns[str(name)] = variable
        elif len(within) == 1 and within[0] in PARTS:
            for part in variable.transpose(within[0], ...):
                columns[f"{name}[{part[within[0]].item()}]"] = part.drop_vars(within)
    frame = type(dataset)(columns).to_dataframe(dim_order=rows).reset_index()
    return frame[frame["status"] != Status.NOT_REQUESTED.label]


def as_html(dataset: "xr.Dataset") -> str:
    """HTML table of a dataset's points, a row each; a single point has a row for each value."""
    shown = to_dataframe(dataset)
    return str((shown if dataset["status"].dims else shown.T)._repr_html_())


def flags_of(variable: "xr.DataArray") -> dict[int, str]:
    """Return the meanings of a flag variable by value; none of other variables."""
    import numpy as np

    values = np.ravel(variable.attrs.get("flag_values", [])).tolist()
    return dict(zip(values, str(variable.attrs.get("flag_meanings", "")).split(), strict=False))


def _in_words(dataset: "xr.Dataset") -> "xr.Dataset":
    import numpy as np

    words = {}
    for name, variable in dataset.data_vars.items():
        if known := flags_of(variable):
            text = [known.get(value, "") for value in variable.values.ravel().tolist()]
            words[name] = (variable.dims, np.array(text, dtype=object).reshape(variable.shape))
    return dataset.assign(words)
