"""Schema of `responses.nc`: dimensions, coordinates, variables, units, flags.

Written down once, here; the writer, the analyses and the documentation read this table.
"""

from collections.abc import Collection

from gapsweep.model.structure import AnyStructure
from gapsweep.quantities import UNITS
from gapsweep.response.disturbances import DISTURBANCES
from gapsweep.response.result import RESPONSE, exists, part_sizes
from gapsweep.study.grid import START
from gapsweep.study.samples import DRAWN, SAMPLE
from gapsweep.variables import (
    CONTACT,
    COORDINATE,
    EXTREMUM,
    INPUTS,
    MULTIPLIER,
    PART_UNITS,
    PARTS,
    SECTION_POINT,
    Units,
    Variable,
    part_units,
)

# Dimensions of a study without further swept numbers, which have dimensions after omega.
POINT_DIMS = ("representation", "K_c", "gap", "omega", "initial_condition")
ATTRACTOR = "attractor"

# Description of every other number of an oscillator, which has a dimension if it is swept.
_NUMBERS = {
    "zeta": "damping ratio",
    "omega_n": "natural frequency without contact",
    "mass": "mass",
    "alpha": "cubic stiffness",
    "forcing": "forcing amplitude",
    "mean_load": "constant load",
    "c": "viscous damping added to that of zeta",
    "unbalance": "unbalance",
    "base_amplitude": "amplitude of the base's motion",
    "base_damping": "share of the damping connected to the base",
    "K_ratio": "stiffness ratio, lower wall over upper wall",
    "damping": "damping of both walls",
    "preload": "preload of both walls",
    "chi": "factor of the speed of penetration",
    "restitution": "coefficient of restitution",
}
# Dimension and description of every coordinate. Walls that are swept separately have separate
# dimensions.
COORDINATES: dict[str, tuple[str, Variable]] = {
    "representation": ("representation", Variable("str", "1", "representation of the contact")),
    "K_c": ("K_c", Variable("f8", UNITS["K_c"], "contact stiffness")),
    "gap": ("gap", Variable("str", "mm", "distances of the lower and upper wall from the origin")),
    "j_1": ("gap", Variable("f8", UNITS["j_1"], "distance of the lower wall from the origin")),
    "j_2": ("gap", Variable("f8", UNITS["j_2"], "distance of the upper wall from the origin")),
    "omega": ("omega", INPUTS["omega"]),
    **{
        name: (name, Variable("f8", UNITS[name], description))
        for name, description in _NUMBERS.items()
    },
    "initial_condition": (START, INPUTS[START]),
    "x_0": (START, INPUTS["x_0"]),
    "v_0": (START, INPUTS["v_0"]),
    "z_0": (START, INPUTS["z_0"]),
    SAMPLE: (SAMPLE, Variable("i4", "1", "number of the sample of uncertain numbers")),
    "matrix": (SAMPLE, Variable("i4", "1", "matrix of the sample: 0 A, 1 B, from 2 on mixed")),
    "repeat": (SAMPLE, Variable("i4", "1", "independent repeat of the sample")),
    "start": ("initial_condition", Variable("str", "1", "fixed, sweep_up or sweep_down")),
}


# Numbers of an oscillator whose names parameters of a system may have, too.
SHARED = ("mean_load", "c", "unbalance", "base_amplitude", "base_damping")
_OF_CONTACTS = ("K_c", "gap", "j_1", "j_2", "damping", "preload", "chi", "restitution")
PARAMETER = "parameter"  # beginning of the long name of a system parameter's coordinate


Found = dict[str, tuple[tuple[str, ...], Variable]]


def coordinates(
    dims: Collection[str], structure: AnyStructure, units: Units, drawn: Collection[str] = ()
) -> Found:
    """Return dimensions and description of every coordinate of a dataset with these dimensions.

    Parameters
    ----------
    structure : Structure or OscillatorStructure
        Structure of the models; it adds the dimensions within a point.
    units : mapping of str to sequence of str
        Units of their coordinates and contacts.
    drawn : collection of str
        Uncertain numbers, over the dimension `sample`.
    """
    parts = part_sizes(structure)
    own = () if structure.in_metres else SHARED  # parameters of a user's system, of any meaning
    known = {
        name: (name if name in dims else dim, variable)
        for name, (dim, variable) in COORDINATES.items()
        if name not in own
    }
    parameters = {
        name: (name, Variable("f8", "", f"{PARAMETER} {name}"))
        for name in dims
        if name not in known
    }
    for name in drawn:
        unit = UNITS.get(name, "") if structure.in_metres or name in _OF_CONTACTS else ""
        parameters[f"{DRAWN}{name}"] = (SAMPLE, Variable("f8", unit, f"drawn {name}"))
    found: Found = {
        name: (
            (dim, *parts_of(name, parts)),
            variable.in_units(
                units, CONTACT if name.removeprefix(DRAWN) in _OF_CONTACTS else COORDINATE
            ),
        )
        for name, (dim, variable) in (known | parameters).items()
        if dim in dims and exists(name, structure)
    }
    found |= {name: ((name,), PARTS[name]) for name in parts}
    return found | {name: (PART_UNITS[name].dims, PART_UNITS[name]) for name in part_units(units)}


def parts_of(name: str, parts: Collection[str]) -> tuple[str, ...]:
    """Return the dimensions within a point, among `parts`, of a variable or input."""
    described = {**VARIABLES, **INPUTS}
    return tuple(dim for dim in described[name].dims if dim in parts) if name in described else ()


VARIABLES: dict[str, Variable] = {
    **{
        name: variable
        for name, variable in RESPONSE.items()
        if not name.endswith("_end") and MULTIPLIER not in variable.dims
    },
    "attractor": Variable("i4", "1", "number of the attractor of the case, -1: none", -1),
    "host": Variable("i2", "1", "machine on which cpu_time was measured", -1),
}

# Variables of `attractors.nc`, over cases and `attractor`; shared names are as in `responses.nc`.
ATTRACTOR_VARIABLES: dict[str, Variable] = {
    **{
        name: RESPONSE[name]
        for name in (
            *("period_multiple", "response_class", "x_max", "x_min", "multiplier_abs"),
            *("lyapunov", "lyapunov_error", "period", "multiplier_real", "multiplier_imag"),
            *("section_x", "section_v", "section_z", "contact_section_x", "contact_section_v"),
            *("contact_x_max", "contact_x_min"),
        )
    },
    "basin_share": Variable(
        "f8", "1", "share of the initial conditions, without sweeps, that lead to the attractor"
    ),
    "basin_share_error": Variable("f8", "1", "standard error of the share"),
    "mirror_of": Variable("i4", "1", "number of the mirror-image attractor, -1: none", -1),
    **DISTURBANCES,
}
N_ATTRACTORS = Variable("i4", "1", "number of attractors found", 0)

# Arguments of `query` and of the figures, in addition to selections.
OF_CALLS = {
    *("self", "study", "client", "cache", "workers", "scheduler", "on_progress"),
    *("along", "ax", "variable", "x", "y", "n_points", "n_periods"),
}
# Names that a parameter of a system cannot have: files and selections use them otherwise.
TAKEN = {
    *OF_CALLS,
    *(name for name in COORDINATES if name not in SHARED),
    *VARIABLES,
    *ATTRACTOR_VARIABLES,
    *PARTS,
    *PART_UNITS,
    *(EXTREMUM, SECTION_POINT, ATTRACTOR, MULTIPLIER, "n_attractors"),
    # of branches.nc and curves.nc
    *("branch", "step", "state", "match", "stable", "special", "n_orbits", "n_lost"),
    *("begins", "ends", "parent", "start_state", "curve_kind"),
    # of risk.nc and the table [uncertain]
    *("event", "quantity", "level", "number", "samples", "repeats", "seed", "indices"),
    *("correlation", "quantities", "safe", "probability", "low", "high", "first_order", "total"),
    # of gradients.nc
    *("parameter", "gradient", "value", "reason"),
    # of agreement.nc and timing.nc
    *("regime", "bound", "f1", "precision", "recall"),
    *("n_points", "n_compared", "n_failed", "n_unresolved"),
}
