"""Schema of `responses.nc`: dimensions, coordinates, variables, units, flags.

Written down once, here; the writer, the analyses and the documentation read this table.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapsweep.model.structure import AnyStructure
from gapsweep.response.result import (
    OF_CONTACTS,
    OF_COORDINATES,
    ExtremumKind,
    ResponseClass,
    has_contact_motion,
)
from gapsweep.status import Status
from gapsweep.study.grid import CONTACT, COORDINATE, LAG, START

# Of a study that sweeps nothing else; each further number swept has a dimension after omega.
POINT_DIMS = ("representation", "K_c", "gap", "omega", "initial_condition")
EXTREMUM = "extremum"
SECTION_POINT = "section_point"
ATTRACTOR = "attractor"
MULTIPLIER = "multiplier"


@dataclass(frozen=True, slots=True)
class Variable:
    """One dataset variable.

    Attributes
    ----------
    dtype : str
        NumPy type code, or ``"str"``.
    units : str
        UDUNITS text, ``"1"`` if nondimensional; empty if its user alone knows.
    long_name : str
    missing : float
        Value in cells that are no sweep point.
    flags : tuple of (str, int)
        Meanings and values, for flag variables.
    """

    dtype: str
    units: str
    long_name: str
    missing: float = float("nan")
    flags: tuple[tuple[str, int], ...] = ()

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the variable in a file."""
        attributes: dict[str, Any] = {"units": self.units} if self.units else {}
        attributes["long_name"] = self.long_name
        if self.flags:
            names, values = zip(*self.flags, strict=True)
            attributes["flag_values"] = np.array(values, dtype=self.dtype)
            attributes["flag_meanings"] = " ".join(names)
        return attributes


# Of every variable the dimensions, and what it is.
Described = Mapping[str, tuple[tuple[str, ...], Variable]]


def empty(table: Described, sizes: Mapping[str, int]) -> dict[str, Any]:
    """Arrays of a table's variables, in which all is missing."""
    return {
        name: np.full([sizes[dim] for dim in dims], variable.missing, variable.dtype)
        for name, (dims, variable) in table.items()
    }


def with_attributes(table: Described, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays with their dimensions and attributes, as a dataset takes them."""
    return {
        name: (dims, arrays[name], variable.attributes) for name, (dims, variable) in table.items()
    }


STATUS_FLAGS = tuple((status.label, int(status)) for status in Status)
KIND_FLAGS = (("none", -9), *((k.name.lower(), int(k)) for k in ExtremumKind))
CLASS_FLAGS = (("none", -1), *((c.name.lower(), int(c)) for c in ResponseClass))
# Units that do not depend on what a coordinate is.
_OWN_UNITS = {"1", "s", "s-1", "Hz"}

# Of every coordinate the dimension it lies along, and what it is. Walls that are swept one by one
# have dimensions of their own.
COORDINATES: dict[str, tuple[str, Variable]] = {
    "representation": ("representation", Variable("str", "1", "representation of the contact")),
    "K_c": ("K_c", Variable("f8", "N m-1", "contact stiffness")),
    "gap": ("gap", Variable("str", "mm", "distances of the lower and upper wall from the origin")),
    "j_1": ("gap", Variable("f8", "m", "distance of the lower wall from the origin")),
    "j_2": ("gap", Variable("f8", "m", "distance of the upper wall from the origin")),
    "omega": ("omega", Variable("f8", "Hz", "forcing frequency")),
    "zeta": ("zeta", Variable("f8", "1", "damping ratio")),
    "omega_n": ("omega_n", Variable("f8", "Hz", "natural frequency of the linear spring alone")),
    "mass": ("mass", Variable("f8", "kg", "mass")),
    "alpha": ("alpha", Variable("f8", "N m-3", "cubic stiffness")),
    "forcing": ("forcing", Variable("f8", "N", "forcing amplitude")),
    "mean_load": ("mean_load", Variable("f8", "N", "constant load")),
    "c": ("c", Variable("f8", "N s m-1", "viscous damping added to that of zeta")),
    "K_ratio": ("K_ratio", Variable("f8", "1", "stiffness of the lower wall over the upper")),
    "initial_condition": ("initial_condition", Variable("i4", "1", "number of the start")),
    "x_0": ("initial_condition", Variable("f8", "m", "initial displacement")),
    "v_0": ("initial_condition", Variable("f8", "m s-1", "initial velocity")),
    "z_0": ("initial_condition", Variable("f8", "", "initial first-order state")),
    "start": ("initial_condition", Variable("str", "1", "fixed, sweep_up or sweep_down")),
}


# Units as engineers write them, by their UDUNITS text.
_WRITTEN = {
    "1": "",
    "N m-1": "N/m",
    "N m-3": "N/m³",
    "m s-1": "m/s",
    "N s m-1": "N s/m",
    "s-1": "1/s",
}


def written(units: str) -> str:
    """A unit as engineers write it."""
    return _WRITTEN.get(units, units)


# Of the numbers that a study of an oscillator may sweep.
UNITS = {
    name: written(variable.units)
    for name, (dim, variable) in COORDINATES.items()
    if variable.dtype == "f8" and variable.units != "1" and dim != START
}

PARAMETER = "parameter"  # of a system: what its coordinate's long name begins with
_PARTS = {
    COORDINATE: Variable("str", "1", "coordinate of the system"),
    CONTACT: Variable("str", "1", "contact of the system"),
    LAG: Variable("str", "1", "first-order state of the system"),
}


Found = dict[str, tuple[tuple[str, ...], Variable]]


def coordinates(dims: Collection[str], structure: AnyStructure) -> Found:
    """The coordinates that dimensions bring along: the dimensions of each, and its description.

    Parameters
    ----------
    dims : collection of str
    structure : Structure or OscillatorStructure
        Of the models; it adds the dimensions within a point.
    """
    parts = part_sizes(structure)
    known = {name: (name if name in dims else dim, v) for name, (dim, v) in COORDINATES.items()}
    parameters = {
        name: (name, Variable("f8", "", f"{PARAMETER} {name}"))
        for name in dims
        if name not in COORDINATES
    }
    found: Found = {
        name: ((dim, *parts_of(name, parts)), described(variable, structure))
        for name, (dim, variable) in (known | parameters).items()
        if dim in dims and exists(name, structure)
    }
    return found | {name: ((name,), _PARTS[name]) for name in parts}


def exists(name: str, structure: AnyStructure) -> bool:
    """Whether datasets of models of a structure have a variable or coordinate."""
    if name in ("z_0", "section_z"):
        return structure.m > 0
    if name in OF_CONTACT_MOTION:
        return has_contact_motion(structure)
    if name in OF_CONTACTS:
        return len(structure.contacts) > 0
    return name != "period" or not structure.is_forced


def described(variable: Variable, structure: AnyStructure) -> Variable:
    """A variable without its unit where only the user knows that of the coordinates."""
    is_known = structure.in_metres or variable.units in _OWN_UNITS
    return variable if is_known else replace(variable, units="")


def part_sizes(structure: AnyStructure) -> dict[str, int]:
    """Dimensions within a point: those of several coordinates, contacts or first-order states."""
    sizes = {COORDINATE: structure.n, CONTACT: len(structure.contacts), LAG: structure.m}
    return {name: size for name, size in sizes.items() if size > 1}


def parts_of(name: str, parts: Collection[str]) -> tuple[str, ...]:
    """The dimensions within a point that a variable has."""
    return (_PART_OF[name],) if _PART_OF.get(name) in parts else ()


VARIABLES: dict[str, Variable] = {
    "x_max": Variable("f8", "m", "peak displacement of the steady response"),
    "x_min": Variable("f8", "m", "trough displacement of the steady response"),
    "amplitude": Variable("f8", "m", "half the range of the steady response"),
    "force_max": Variable("f8", "N", "largest magnitude of the contact force"),
    "contact_share": Variable("f8", "1", "share of the time spent beyond the walls"),
    "contact_x_max": Variable("f8", "m", "peak relative displacement at the contact"),
    "contact_x_min": Variable("f8", "m", "trough relative displacement at the contact"),
    "period_multiple": Variable("i4", "1", "forcing periods in one response period, 0: none", 0),
    "response_class": Variable("i1", "1", "class of the steady response", -1, CLASS_FLAGS),
    "multiplier_abs": Variable("f8", "1", "largest modulus of the Floquet multipliers"),
    "lyapunov": Variable("f8", "s-1", "largest Lyapunov exponent"),
    "lyapunov_error": Variable("f8", "s-1", "standard error of the largest Lyapunov exponent"),
    "noise": Variable(
        "f8",
        "m",
        "predicted scatter of section points a response period apart; of a rest, its distance",
    ),
    "attractor": Variable("i4", "1", "number of the attractor in its scene, -1: none", -1),
    "n_extrema": Variable("i4", "1", "true number of steady extrema", 0),
    "n_contacts": Variable("i8", "1", "wall crossings of the motion, in and out", 0),
    "n_steps": Variable("i8", "1", "accepted steps of the motion", 0),
    "n_rejected": Variable("i8", "1", "rejected steps of the motion", 0),
    "nfev": Variable("i8", "1", "right-hand sides of the motion", 0),
    "t_settled": Variable("f8", "s", "simulated time until the response was accepted"),
    "t_simulated": Variable("f8", "s", "simulated time of the motion: settling and recording"),
    "cpu_time": Variable("f8", "s", "processor time of motion, shots and tangents, in the worker"),
    "host": Variable("i2", "1", "machine on which cpu_time was measured", -1),
    "status": Variable("i1", "1", "outcome of the sweep point", Status.NOT_REQUESTED, STATUS_FLAGS),
    "period": Variable("f8", "s", "period of an unforced response"),
}

# Ragged lists: their extra dimension and what they hold; padded where they end.
LISTS: dict[str, tuple[str, Variable]] = {
    "extrema": (EXTREMUM, Variable("f8", "m", "steady zero-velocity displacements, in time order")),
    "extremum_kind": (EXTREMUM, Variable("i1", "1", "kind of each extremum", -9, KIND_FLAGS)),
    "section_x": (SECTION_POINT, Variable("f8", "m", "displacement at whole forcing periods")),
    "section_v": (SECTION_POINT, Variable("f8", "m s-1", "velocity at whole forcing periods")),
    "section_z": (SECTION_POINT, Variable("f8", "", "first-order state at whole forcing periods")),
    "contact_section_x": (
        SECTION_POINT,
        Variable("f8", "m", "relative displacement at the contact at whole forcing periods"),
    ),
    "contact_section_v": (
        SECTION_POINT,
        Variable("f8", "m s-1", "relative velocity at the contact at whole forcing periods"),
    ),
}

OF_CONTACT_MOTION = ("contact_x_max", "contact_x_min", "contact_section_x", "contact_section_v")
_PART_OF = {
    **dict.fromkeys((*OF_COORDINATES, "extrema", "extremum_kind"), COORDINATE),
    **dict.fromkeys(("x_0", "v_0", "section_x", "section_v"), COORDINATE),
    **dict.fromkeys((*OF_CONTACTS, *OF_CONTACT_MOTION), CONTACT),
    **dict.fromkeys(("z_0", "section_z"), LAG),
}

# `attractors.nc`: over the scenes and `attractor`; names as in `responses.nc` where they are one.
ATTRACTOR_VARIABLES: dict[str, Variable] = {
    **{
        name: VARIABLES[name]
        for name in (
            "period_multiple",
            "response_class",
            "x_max",
            "x_min",
            "contact_x_max",
            "contact_x_min",
            "multiplier_abs",
            "lyapunov",
            "lyapunov_error",
            "period",
        )
    },
    "basin_share": Variable("f8", "1", "share of the starts that end on the attractor"),
    "basin_share_error": Variable("f8", "1", "standard error of the share"),
    "mirror_of": Variable("i4", "1", "number of its mirror image, -1: none", -1),
}
MULTIPLIERS: dict[str, Variable] = {
    "multiplier_real": Variable("f8", "1", "real part of the Floquet multipliers"),
    "multiplier_imag": Variable("f8", "1", "imaginary part of the Floquet multipliers"),
}
N_ATTRACTORS = Variable("i4", "1", "number of attractors found", 0)

# What stands beside selections in calls: arguments of `query` and of the figures.
OF_CALLS = {
    *("self", "study", "client", "cache", "workers", "scheduler", "on_progress"),
    *("along", "ax", "variable", "x", "y"),
}
# Names that a parameter of a system cannot have: they mean something else in files and selections.
TAKEN = {
    *OF_CALLS,
    *(name for name in COORDINATES if name not in ("mean_load", "c")),
    *VARIABLES,
    *LISTS,
    *ATTRACTOR_VARIABLES,
    *MULTIPLIERS,
    *_PARTS,
    *(EXTREMUM, SECTION_POINT, ATTRACTOR, MULTIPLIER, "n_attractors"),
    # of agreement.nc and timing.nc
    *("regime", "bound", "class", "class_exact", "confusion", "kappa", "f1", "precision", "recall"),
    *("n_points", "n_compared", "n_failed", "n_unresolved", "n_jumps", "n_changes"),
}
