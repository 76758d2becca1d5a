"""Layout of the arrays that the stepping code shares: one row per quantity, one column per lane.

A row of ``lanes`` is one vector load. The number of rows depends on the system; a `RowLayout` names
them. It is a compile-time value: its numbers are part of its numba type, so that a step is compiled
once for every size of system, and the number of a row is a constant in its code. Loads, cubic
springs and modulations of systems are counted at run time, in loops: their rows stand last. Code
for single lanes reads all numbers from a record (`RowLayout.numbers`): one for all layouts.

Clocks count forcing periods: a time is the pair (whole periods since the beginning of the
point's first period, fraction of a period in [0, 1)). The fraction *is* the forcing phase, hence
time and phase cannot drift apart however long the run.
"""

import math
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from itertools import accumulate
from typing import Any, ClassVar

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import (
    NativeValue,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)
from numpy.typing import NDArray

from gapsweep.integrate.simd import WIDTH

from .parameters import N_PARAMETERS

# Degrees of Taylor polynomials for loose and for tight tolerances, and the relative tolerance below
# which these are tight: the cheapest pair measured. A step is compiled once for both degrees.
_DEGREES, _TIGHT = (12, 16), 2e-8
_LAYER_DEGREES, _LAYER_TIGHT = (8, 12), 2e-5

# Numbers of things that each have rows.
_COUNTS = ("harmonics", "cubics", "modulations")
# Blocks of the equation of motion per unit mass, by which parameters act on a motion. Those with
# rows for every cubic spring or load are last.
SOURCES = (
    *("stiffness", "damping", "lag_force", "of_speed", "of_place", "of_lag", "pull"),
    *("lower", "upper", "lower_stiffness", "upper_stiffness", "contact_damping", "chi"),
    *("lower_rest", "upper_rest", "restitution"),
    *("cubic", "push"),
)
# Names of the blocks of rows and, by the counts of a `RowLayout`, how many rows each has.
_ONE = (
    # the clock, with the digits that its sum has lost; of the last step the length and beginning
    *("tau", "tau_low", "cycle", "step", "tau_0", "cycle_0"),
    # phase and time [s] of the point's own start, and its end
    *("tau_start", "t_start", "end_cycle", "end_tau"),
    *("omega", "omega_rad", "period"),
    # from these (whole periods + fraction) on section points are recorded, and all events
    *("record_clock", "event_clock"),
    "atol",  # [m]: of an error, of displacements and speeds alike
    "floor",  # absolute part of the step's tolerance [m/s]
    "rate",  # fastest angular frequency of the linear parts [rad/s]
    "min_step",  # [s]: a shorter step, unless it ends on a wall or at the end, is an underflow
    *("n_steps", "n_contacts", "n_short"),
    "is_fresh",  # why the derivative is missing, or 0 (of Runge-Kutta methods)
    # results of recording the last step: its initial time [s], zero of a velocity
    *("start_time", "turn_time", "turn_x", "turn_v"),
)


@dataclass(frozen=True)
class RowLayout:
    """Sizes of a system, and the first row of every quantity that is stored for a point.

    Attributes
    ----------
    n : int
        Coordinates q.
    m : int
        First-order states z.
    contacts, cubics, harmonics, modulations : int
        Contacts, cubic springs, harmonics of the forcing (a constant load is one), and of the
        contacts' stiffness.
    pieces : int
        Coefficients of a piece if a load is given by pieces, else 0.
    is_plain : bool
        Whether the system is an oscillator: one coordinate with one contact, one cubic spring and
        one harmonic with the frequency and the phase of the clock.
    is_tanh : bool
        Whether the contact of an oscillator is smoothed by tanh.
    is_free : bool
        Whether the system is unforced: its section is then at the maxima of the first coordinate.
    is_located : bool
        Whether steps end where a contact passes a wall.
    is_damped : bool
        Whether located contacts lose energy.
    has_slack : bool
        Whether some of them never pull: they have the mode `contact_modes.SLACK`.
    has_chi : bool
        Whether the spring's force of some of them depends on the speed, see `Losses.chi`.
    has_impacts : bool
        Whether some contacts have rigid walls, or a preload: they have the mode
        `contact_modes.HOLD`.
    has_preload : bool
        Whether some contacts have a preload.
    laws : tuple of (int, int, int)
        Of a Taylor series the law of every contact: its place in `LAWS`, numbers of coefficients of
        numerator and denominator. Empty if contacts are located.
    is_taylor : bool
        Whether steps are those of a Taylor series; a Runge-Kutta method needs more rows.
    order : int
        Degree of the polynomials of a step; no constant of the code.
    tangent : int
        1 if the variational equation is integrated too, else 0; a constant of the code for tanh.
    columns : int
        Parameters by which the motion is differentiated, see `lanes.columns`; with a tangent only.
    """

    n: int = 1
    m: int = 0
    contacts: int = 1
    cubics: int = 1
    harmonics: int = 1
    modulations: int = 0
    pieces: int = 0
    is_plain: bool = True
    is_tanh: bool = False
    is_free: bool = False
    is_located: bool = True
    is_damped: bool = False
    has_slack: bool = False
    has_chi: bool = False
    has_impacts: bool = False
    has_preload: bool = False
    is_taylor: bool = True
    laws: tuple[tuple[int, int, int], ...] = ()
    order: int = 12
    tangent: int = 0
    columns: int = 0

    derived: ClassVar[tuple[str, ...]] = (
        *("n_states", "all_lanes", "n_terms", "n_series", "first_gap", "n_turning", "n_rows"),
        *("first_hold", "has_forces"),
        *("n_rates", "width", "gap_end", "spring_series", "column_size"),
        *("lower_source", "upper_source", "pull_source", "restitution_source"),
    )

    @property
    def n_states(self) -> int:
        """Length of a state (q, v, z)."""
        return 2 * self.n + self.m

    @property
    def degrees(self) -> tuple[int, ...]:
        """Degrees for which the code of a step is compiled."""
        if not self.is_taylor:
            return (self.order,)
        return _LAYER_DEGREES if self.has_layers else _DEGREES

    @property
    def tight(self) -> float:
        """Relative tolerance below which a Taylor step has the larger degree."""
        return _LAYER_TIGHT if self.has_layers else _TIGHT

    def with_degree(self, rtol: float) -> "RowLayout":
        """Return the layout with the degree of the Taylor polynomials at a tolerance."""
        return known(replace(self, order=self.degrees[rtol < self.tight]))

    @cached_property
    def of_code(self) -> "RowLayout":
        """The layout that stands for all those with the same code."""
        tangent = self.tangent if self.is_tanh else 0
        columns = min(self.columns, 1)
        found = replace(self, order=self.degrees[-1], tangent=tangent, columns=columns)
        found = replace(found, is_free=False, harmonics=1)
        if self.is_plain:
            return known(found)
        # a Taylor step without springs or modulations has no loops; to other methods they cost
        # nothing
        cubics, modulations = min(self.cubics, 1), min(self.modulations, 1)
        some = (cubics, modulations) if self.is_taylor else (1, 1)
        return known(replace(found, cubics=some[0], modulations=some[1]))

    @property
    def counted(self) -> tuple[str, ...]:
        """Names of the numbers that code reads at run time; all others are its constants."""
        columns = ("columns", "column", "column_size", "push_source") if self.columns else ()
        if self.is_plain:
            return columns
        return (*_COUNTS, *self._item_blocks(), "spring_series", "n_rows", *columns)

    @cached_property
    def of_motion(self) -> "RowLayout":
        """The layout without the tangent, whose rows no other code reads."""
        return known(replace(self, tangent=0))

    @cached_property
    def of_tangent(self) -> "RowLayout":
        """The layout with the tangent."""
        return known(replace(self, tangent=1))

    @property
    def width(self) -> int:
        """Number of lanes."""
        return WIDTH

    @property
    def all_lanes(self) -> int:
        """All lanes as a mask."""
        return (1 << self.width) - 1

    @property
    def n_terms(self) -> int:
        """Number of coefficients of a series for which there are rows."""
        return self.degrees[-1] + 1

    @property
    def n_series(self) -> int:
        """Number of series of a step: those of q and z, of the contacts' gaps, of hold forces."""
        return self.first_hold + self.contacts * self.has_impacts

    @property
    def first_hold(self) -> int:
        """Number of the series of the force that holds the first contact on its wall."""
        return 1 if self.is_plain else self.n + self.m + self.contacts

    @property
    def has_forces(self) -> int:
        """Whether a force ends some modes of contacts."""
        return int(self.has_slack or self.has_impacts)

    @property
    def n_rates(self) -> int:
        """Number of derivatives of a stage: accelerations, then rates of first-order states."""
        return self.n + self.m

    @property
    def first_gap(self) -> int:
        """Number of the first contact's series; of a plain oscillator, that of the coordinate."""
        return 0 if self.is_plain else self.n + self.m

    @property
    def is_smooth(self) -> bool:
        """Whether contact forces are smooth."""
        return self.is_tanh or bool(self.laws)

    @property
    def has_layers(self) -> bool:
        """Whether contact forces are smooth within layers at the walls, as no fit is."""
        return self.is_smooth and not any(top for _, top, _ in self.laws)

    @property
    def has_laws(self) -> bool:
        """Whether contacts have rows of parameters of their laws."""
        return bool(self.laws) or not self.is_taylor

    @property
    def gap_end(self) -> int:
        """First row of the contacts' gaps at the end of the last step."""
        if self.is_plain:
            return self.q
        return self.gap if self.is_taylor else self.gap_1

    @property
    def n_turning(self) -> int:
        """Number of quantities whose extrema are recorded: coordinates, then gaps of contacts."""
        return 1 if self.is_plain else self.n + self.contacts

    @property
    def n_kept(self) -> int:
        """Number of series of a step and of all solutions of the variational equation."""
        return self.n_series + (self.tangent * self.n_states + self.columns) * self.n_rates

    @cached_property
    def sources(self) -> dict[str, int]:
        """First row within a parameter column of the derivative of every block in `SOURCES`."""
        sizes = [self.blocks[name] for name in SOURCES]
        return dict(zip(SOURCES, accumulate(sizes, initial=self.n_states), strict=False))

    @property
    def lower_source(self) -> int:
        """First row within a parameter column of the derivatives of the lower walls' places."""
        return self.sources["lower"]

    @property
    def upper_source(self) -> int:
        """First row within a parameter column of the derivatives of the upper walls' places."""
        return self.sources["upper"]

    @property
    def pull_source(self) -> int:
        """First row within a parameter column of the derivatives of M^-1 b of the contacts."""
        return self.sources["pull"]

    @property
    def restitution_source(self) -> int:
        """First row within a parameter column of the derivatives of restitutions."""
        return self.sources["restitution"]

    @property
    def push_source(self) -> int:
        """First row within a parameter column of the derivatives of loads."""
        return self.sources["push"]

    @cached_property
    def column_size(self) -> int:
        """Number of rows of a parameter column: its state, then derivatives of `SOURCES`."""
        return self.n_states + sum(self.blocks[name] for name in SOURCES)

    @property
    def spring_series(self) -> int:
        """First coefficient of the series of cubic springs: of a.q, of its square, of a tangent."""
        return self.n_kept * self.n_terms

    @property
    def n_coefficients(self) -> int:
        """Number of all coefficients of a step."""
        return self.spring_series + 3 * self.n_terms * self.cubics * (not self.is_plain)

    @cached_property
    def blocks(self) -> dict[str, int]:
        """Number of rows of every block."""
        n, m, k = self.n, self.m, self.contacts
        several = not self.is_plain
        return dict.fromkeys(_ONE, 1) | {
            # state, and the largest |q| at the ends of steps
            **{"q": n, "v": n, "z": m, "reach": n},
            # solutions of the variational equation, one after the other, from unit states
            "tangent_state": self.n_states**2,
            # contacts: mode (+1 upper wall, -1 lower, 0 none) now and before the last step, wall
            # that step ended on (+1, -1, 0 none), present position in the gap several, walls
            # -j_1 and j_2 [m], their stiffnesses, b'M^-1 b, and the sum of times [s] at which
            # contact was left less those at which it was made
            **{"mode": k, "mode_0": k, "side": k, "gap": k * several},
            **{"lower": k, "upper": k, "lower_stiffness": k, "upper_stiffness": k},
            # damping of both walls, the largest force while it was recorded, and the integral of
            # the rate at which contacts shrink volumes in state space
            **{name: k * self.is_damped for name in ("contact_damping", "contact_force")},
            **{"contact_loss": 1 * (self.is_damped or self.has_impacts), "chi": k * self.has_chi},
            # damping of contacts that never pull, 0 for others; 1 if the force was zero when the
            # present mode began, -1 if a hold ended then
            **{"slack_damping": k * self.has_slack, "switched": k * self.has_forces},
            # rigid walls: whether a contact has them, restitution, contact loss of an impact,
            # inverse of B'M^-1 B of the held contacts, speeds before impacts at the end of a step
            **dict.fromkeys(("rigid", "restitution", "of_impact"), k * self.has_impacts),
            # height of flights that are left out, over the largest displacement; its least value
            # [m]; preload, and places of the gap at which the springs of the walls have no force
            **{"low": k * self.has_impacts, "least_reach": 1 * self.has_impacts},
            **dict.fromkeys(("preload", "lower_rest", "upper_rest"), k * self.has_preload),
            **{"held": k * k * self.has_impacts, "v_in": n * self.has_impacts},
            # of impacts at the end of a step, for single lanes, see `stepping.impacts`
            **dict.fromkeys(("impact_share", "impulse", "hold_force"), k * self.has_impacts),
            "lost_force": k * self.has_impacts,
            **dict.fromkeys(("acceleration", "unprojected"), n * self.has_impacts),
            "impact_kick": k * (n + m) * self.has_impacts,
            # smoothing: 2 epsilon [1/m], half-width of the layers [m], whether one is near, longest
            # step [s]; what to add to the time of the contact that ended the last step [s]
            **dict.fromkeys(("sharpness", "layer", "is_near", "longest"), 1 * self.is_tanh),
            "lag": 1 * (self.is_tanh or self.has_impacts),
            **{"compliance": k * several, "contact_time": k},
            # q'' = push cos(..) - damping v - stiffness q - lag_force z - cubic's and contacts'
            # pull, all per unit mass (multiplied by M^-1); z' = of_speed v + of_place q + of_lag z
            **{"stiffness": n * n, "damping": n * n, "lag_force": n * m},
            **{"of_speed": m * n, "of_place": m * n, "of_lag": m * m},
            **{"pull": n * k * several, "direction": k * n * several},
            # scales of step errors: roots of the matrices of masses and springs, square of the
            # fastest rate [1/s^2] and rate of decay [1/s] of the linear parts, speed of a metre
            # [1/s], sizes of lags relative to a metre
            **{"mass_root": n * n * several, "spring_root": n * n * several},
            **{"fastest": 1 * several, "decay": 1 * several, "slow": 1 * several, "lag_floor": m},
            **self._piece_blocks(),
            # parameters of the contacts' laws, whether the motion has left the range of a fit,
            # coefficients of fits
            "law": k * N_PARAMETERS * self.has_laws,
            "out_of_range": 1 * self.has_laws,
            "fit": sum(top + bottom for _, top, bottom in self.laws),
            **self._runge_kutta_blocks(),
            **self._item_blocks(),
        }

    def _piece_blocks(self) -> dict[str, int]:
        """Number of rows of every block of loads by pieces, see `pieces`."""
        has_pieces = int(self.pieces > 0)
        return {
            # the present piece: accelerations, by coordinate and by powers of the time [s] since
            # the knot at its end; the clock there
            "piece": self.n * self.pieces,
            **dict.fromkeys(("knot_cycle", "knot_tau"), has_pieces),
            # the end of the motion, of which `end_cycle` and `end_tau` are that of the piece
            **dict.fromkeys(("last_cycle", "last_tau"), has_pieces),
            # rows of the table of pieces: the first, behind the last, the present one; whether
            # they are in seconds
            **dict.fromkeys(("first_piece", "no_piece", "this_piece", "is_record"), has_pieces),
        }

    def _item_blocks(self) -> dict[str, int]:
        """Number of rows of the blocks with rows of every load, cubic spring and modulation."""
        n, h, c, s, several = (
            self.n,
            self.harmonics,
            self.cubics,
            self.modulations,
            not self.is_plain,
        )
        stages = several and not self.is_taylor
        return {
            # forcing: amplitudes, multiples of the frequency, phases in periods
            **{"push": h * n, "multiple": h * several, "phase": h * several},
            # cubic springs: alpha M^-1 a, a, and for n > 1 alpha, a'M^-1 a, 1 / (a'K^-1 a)
            **{"cubic": c * n, "along": c * n * several},
            **{"alpha": c * several, "softness": c * several, "holding": c * several},
            # periodic stiffness of contacts
            **{"depth": s * self.contacts, "depth_multiple": s, "depth_phase": s},
            # of a Runge-Kutta stage: cosines of loads, cubes of springs, and three squares
            **{"cosine": h * stages, "cube": c * stages, "bend": c * stages},
        }

    def _runge_kutta_blocks(self) -> dict[str, int]:
        """Number of rows of every block that only Runge-Kutta methods need."""
        n, m, k, s = self.n, self.m, self.contacts, self.n_states
        several = not self.is_plain
        sizes = {
            # derivatives at the beginning of the next step: of speeds, and of first-order states
            **{"a": n, "w": m},
            # the next step and the longest one [s], the step before a smoothing layer, why the last
            # one is repeated if it is
            **dict.fromkeys(("h", "h_max", "h_saved", "failed"), 1),
            # `n_extra`: right-hand sides at initial states and on walls
            **{"n_rejected": 1, "n_extra": 1},
            # end of the attempted step, committed or not; of its tangent
            **{"q_1": n, "v_1": n, "z_1": m, "a_1": n, "w_1": m, "tangent_1": s * s},
            # gaps of several contacts, their speeds and accelerations, at both ends of it
            **{"gap_0": 3 * k * several, "gap_1": 3 * k * several},
            # of a stage of a system: state; of every contact its gap, its force (or slope, or
            # denominator) and the factor of its stiffness
            **{"stage": s * several, "stage_gap": k, "force": k, "modulation": k * several},
            # of contacts that lose energy: speed of the gap, the part of the force that is damping
            # (or its slope), derivative of the force by the speed, last force of a search for the
            # largest one; series of `contact_loss` within a step
            **{
                name: k * self.is_damped for name in ("stage_speed", "drag", "drag_rate", "sampled")
            },
            "loss": self.n_terms * self.is_damped,
        }
        return {name: size * (not self.is_taylor) for name, size in sizes.items()}

    @cached_property
    def first(self) -> dict[str, int]:
        """First row of every block."""
        first = dict(zip(self.blocks, accumulate(self.blocks.values(), initial=0), strict=False))
        return first | {"column": sum(self.blocks.values())}

    @cached_property
    def n_rows(self) -> int:
        return sum(self.blocks.values()) + self.columns * self.column_size

    @cached_property
    def numbers(self) -> NDArray[Any]:
        """All sizes and first rows, by name, for code compiled once for all layouts.

        An array of one record: numba takes ten microseconds for each argument that is a record.
        """
        given = [field.name for field in fields(self) if field.name != "laws"]
        names = *given, *self.derived, *self.first
        values = tuple(int(getattr(self, name)) for name in names)
        return np.array([values], dtype=_record_of(names))

    def __getattr__(self, name: str) -> int:
        """Return the first row of a block, and store it as an attribute."""
        if name.startswith("_") or name not in self.first:
            raise AttributeError(name)
        self.__dict__[name] = self.first[name]
        return self.first[name]


@cache
def _record_of(names: tuple[str, ...]) -> Any:
    """Return the type of a record of whole numbers; numba compares equal ones field by field."""
    return np.dtype((np.record, [(name, np.int64) for name in names]))


@cache
def oscillator_layout(rtol: float, *, is_tanh: bool) -> RowLayout:
    """Return the layout of oscillators with a located contact, or one smoothed by tanh."""
    return RowLayout(is_tanh=is_tanh).with_degree(rtol)


_KNOWN: dict[RowLayout, RowLayout] = {}


def known(layout: RowLayout) -> RowLayout:
    """Return the first layout that equals this one, so that rows are computed only once."""
    return _KNOWN.setdefault(layout, layout)


def aligned(*shape: int) -> NDArray[np.float64]:
    """Return an array of zeros whose rows of one vector start on cache lines."""
    size = math.prod(shape)
    raw = np.zeros(size + 8)
    skip = (-raw.__array_interface__["data"][0] // 8) % 8
    return raw[skip : skip + size].reshape(shape)


class LayoutType(types.Type):
    """numba's type of one layout: its numbers are constants of the code, but for `counted` ones."""

    def __init__(self, layout: RowLayout) -> None:
        self.layout = layout
        super().__init__(repr(layout))


@register_model(LayoutType)
class _Counts(models.StructModel):
    def __init__(self, manager: Any, typ: LayoutType) -> None:
        super().__init__(manager, typ, [(name, types.int64) for name in typ.layout.counted])


def counts_of(context: Any, builder: Any, typ: LayoutType, value: Any) -> dict[str, Any]:
    """Return the numbers of a layout that are read at run time, by name."""
    counts = cgutils.create_struct_proxy(typ)(context, builder, value=value)
    return {name: getattr(counts, name) for name in typ.layout.counted}


_typed = cache(LayoutType)  # needed in every call from Python


@typeof_impl.register(RowLayout)
def _typeof(layout: RowLayout, context: Any) -> LayoutType:
    return _typed(layout.of_code)


@unbox(LayoutType)
def _unbox(typ: LayoutType, value: Any, c: Any) -> NativeValue:
    counts = cgutils.create_struct_proxy(typ)(c.context, c.builder)
    for name in typ.layout.counted:
        number = c.pyapi.object_getattr_string(value, name)
        setattr(counts, name, c.pyapi.long_as_longlong(number))
        c.pyapi.decref(number)
    return NativeValue(counts._getvalue())


@infer_getattr
class _Numbers(AttributeTemplate):
    key = LayoutType

    def generic_resolve(self, typ: LayoutType, name: str) -> Any:
        found = getattr(typ.layout, name)
        if isinstance(found, RowLayout):
            return _typed(found)
        return types.int64 if isinstance(found, int) else None


@lower_getattr_generic(LayoutType)
def _number(context: Any, builder: Any, typ: LayoutType, value: Any, name: str) -> Any:
    found = getattr(typ.layout, name)
    if isinstance(found, RowLayout):
        return value
    if name in typ.layout.counted:
        return counts_of(context, builder, typ, value)[name]
    return context.get_constant(types.int64, int(found))
