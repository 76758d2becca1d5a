"""Systems as rows of a table: their common structure, and the numbers in which they differ.

Arrays identify a system, names do not: a system made from a row has contacts ``"0"``, ``"1"``, ...
and coordinates ``q_1``, ``q_2``, ...
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import accumulate, pairwise, repeat
from typing import Any, ClassVar, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import OSCILLATOR, Oscillator
from gapsweep.model.system import LATE, Cubic, Harmonic, Lags, Modulation, System
from gapsweep.model.waves import ForceByPieces, Wave

Array = NDArray[np.float64]
T = TypeVar("T")
AnyStructure: TypeAlias = "Structure | OscillatorStructure"


def structure_of(model: Oscillator | System) -> AnyStructure:
    """Return the structure of an oscillator or a system."""
    return Structure.of(model) if isinstance(model, System) else OscillatorStructure(model.wave)


def general_form(oscillator: Oscillator) -> System:
    """Return an oscillator as a `System` of one coordinate and one contact, both named ``x``."""
    o = oscillator
    return System(
        mass=[[o.mass]],
        stiffness=[[o.mass * o.omega_n_rad**2]],
        damping=[[2.0 * o.mass * o.zeta * o.omega_n_rad + o.c]],
        contacts={"x": [1.0]},
        cubic=[Cubic(along=[1.0], alpha=o.alpha)],
        forcing=[
            Harmonic(amplitude=[o.forcing], k=1)
            if o.wave is None
            else ForceByPieces(o.wave, o.forcing, [1.0]),
            Harmonic(amplitude=[o.mean_load], k=0),
            *(Harmonic(amplitude=[u], power=2) for u in [o.inertial_load] if u),
            *(Harmonic(amplitude=[d], power=1, phase=LATE) for d in [o.damper_load] if d),
        ],
        coordinates=o.coordinates,
    )


def with_walls_apart(
    model: Oscillator | System, laws: tuple[ContactLaw, ...]
) -> tuple[Oscillator | System, tuple[ContactLaw, ...]]:
    """Return a model in which each wall of a pair that overlaps is a contact, and its laws."""
    apart = [law.of_walls for law in laws]
    if len(laws) == sum(map(len, apart)):
        return model, laws
    system = general_form(model) if isinstance(model, Oscillator) else model
    names = [name for name, several in zip(system.contacts, apart, strict=True) for _ in several]
    terms = system.modulation
    modulation = {str(i): terms[name] for i, name in enumerate(names) if name in terms}
    contacts = {str(i): system.contacts[name] for i, name in enumerate(names)}
    system = replace(system, contacts=contacts, modulation=modulation, units={})
    return system, tuple(law for several in apart for law in several)


def extremes(rows: Array) -> Iterator[Array]:
    """Yield the smallest, the smallest positive and the largest numbers of all rows, as rows.

    Where each number has a separate range, all rows are valid if these are.
    """
    smallest, largest = rows.min(axis=0), rows.max(axis=0)
    positive = np.min(rows, axis=0, where=rows > 0.0, initial=math.inf)
    yield from (smallest, np.where(np.isinf(positive), largest, positive), largest)


def copies(example: T, columns: Mapping[str, Sequence[Any]]) -> list[T]:
    """Return copies of a frozen dataclass with other values of some fields, not checked."""
    (size,) = {len(column) for column in columns.values()}
    found = [object.__new__(type(example)) for _ in range(size)]
    put = object.__setattr__
    for field in fields(cast(Any, example)):
        values = columns.get(field.name, repeat(getattr(example, field.name)))
        for one, value in zip(found, values, strict=False):  # a repeated value has no end
            put(one, field.name, value)
    return found


def read_structure(fields: Mapping[str, Any]) -> AnyStructure:
    """Return the structure with these fields, read from JSON; without fields, an oscillator's.

    Raises `ValueError`, `TypeError` or `KeyError` if the fields are those of no structure.
    """
    return Structure.read(fields) if "n" in fields else OscillatorStructure.read(fields)


@dataclass(frozen=True)
class OscillatorStructure:
    """The structure of every `Oscillator`: one coordinate, one periodic load, one contact.

    Attributes
    ----------
    wave : Wave, optional
        Values of the forcing over its amplitude; None: a cosine.
    in_metres : bool
        Whether coordinates are known to be lengths in metres.
    is_odd : bool
        Whether the mirror image of a motion is known to be a motion, if the contact is symmetric
        and no mean load acts.
    """

    in_metres: ClassVar[bool] = True
    n: ClassVar[int] = 1
    m: ClassVar[int] = 0
    n_states: ClassVar[int] = 2
    is_forced: ClassVar[bool] = True
    contacts: ClassVar[tuple[tuple[int, ...], ...]] = ((),)
    names: ClassVar[tuple[str, ...]] = OSCILLATOR
    wave: Wave | None = None

    @classmethod
    def read(cls, fields: Mapping[str, Any]) -> "OscillatorStructure":
        """Return the structure with these fields, read from JSON."""
        return cls(Wave.read(fields["wave"]) if fields.get("wave") else None)

    @property
    def is_odd(self) -> bool:
        return self.wave is None

    def row(self, oscillator: Any) -> Array:
        """Return the row of an oscillator: its parameters in the order of `names`."""
        return np.array([getattr(oscillator, name) for name in OSCILLATOR])

    def system(self, row: Array) -> Oscillator:
        """Return the oscillator of a row."""
        return Oscillator(**dict(zip(OSCILLATOR, row.tolist(), strict=True)), wave=self.wave)

    def systems(self, rows: Array) -> list[Oscillator]:
        """Return the oscillators of many rows, each a tenth as expensive as from its row."""
        example, *_ = map(self.system, extremes(rows))
        return copies(example, dict(zip(OSCILLATOR, rows.T.tolist(), strict=True)))


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Structure of a system: its sizes and the frequencies of its loads, without other numbers."""

    # `in_metres`, `is_odd`: unknown, hence False; see `OscillatorStructure`.
    in_metres: ClassVar[bool] = False
    is_odd: ClassVar[bool] = False
    # `n`, `m`: coordinates and first-order states.
    n: int
    m: int
    n_cubic: int  # cubic springs
    # For every load the multiple of the forcing frequency and its `Harmonic.power`, or its wave.
    loads: tuple[tuple[int, int] | Wave, ...]
    # For every contact the multiples of the forcing frequency in its periodic stiffness.
    contacts: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, system: System) -> "Structure":
        return cls(
            n=system.n,
            m=system.n_lags,
            n_cubic=len(system.cubic),
            loads=tuple(
                load.wave if isinstance(load, ForceByPieces) else (load.k, load.power)
                for load in system.forcing
            ),
            contacts=tuple(
                tuple(term.k for term in system.modulation.get(name, ()))
                for name in system.contacts
            ),
        )

    @classmethod
    def read(cls, fields: Mapping[str, Any]) -> "Structure":
        """Return the structure with these fields, read from JSON."""
        loads = tuple(
            Wave.read(load) if isinstance(load, Mapping) else (int(load[0]), int(load[1]))
            for load in fields["loads"]
        )
        contacts = tuple(tuple(map(int, each)) for each in fields["contacts"])
        sizes = {name: int(fields[name]) for name in ("n", "m", "n_cubic")}
        return cls(**sizes, loads=loads, contacts=contacts)

    @property
    def n_states(self) -> int:
        """Length of a state (q, v, z)."""
        return 2 * self.n + self.m

    @property
    def is_forced(self) -> bool:
        """Whether a load or a contact stiffness varies with the forcing frequency."""
        periodic = (
            not load.in_seconds if isinstance(load, Wave) else load[0] for load in self.loads
        )
        return any(periodic) or any(self.contacts)

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the arrays of a system, by name, in the order in which a row holds them."""
        n, m, n_terms = self.n, self.m, sum(map(len, self.contacts))
        return {
            **dict.fromkeys(("mass", "damping", "stiffness"), (n, n)),
            "contact": (len(self.contacts), n),
            **{"cubic": (self.n_cubic, n), "alpha": (self.n_cubic,)},
            **{"load": (len(self.loads), n), "load_phase": (len(self.loads),)},
            **{"depth": (n_terms,), "depth_phase": (n_terms,)},
            **{"lags_force": (n, m), "lags_of_speed": (m, n), "lags_of_place": (m, n)},
            "lags_of_lags": (m, m),
        }

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers of a row, as ``mass[0,1]``."""
        return tuple(
            f"{name}[{','.join(map(str, at))}]"
            for name, shape in self.shapes.items()
            for at in np.ndindex(shape)
        )

    def row(self, system: Any) -> Array:
        """Return the row of a system of this structure: the numbers of all arrays."""
        terms = [term for name in system.contacts for term in system.modulation.get(name, ())]
        lags = system.lags
        parts: Sequence[Any] = (
            *(system.mass, system.damping, system.stiffness, system.directions),
            *([spring.along for spring in system.cubic], [spring.alpha for spring in system.cubic]),
            *([load.amplitude for load in system.forcing], [load.phase for load in system.forcing]),
            *([term.depth for term in terms], [term.phase for term in terms]),
            *((lags.force, lags.of_speed, lags.of_place, lags.of_lags) if lags else ()),
        )
        # Adding zero turns -0.0 into 0.0, the same number.
        return np.concatenate([np.ravel(np.asarray(part, float)) for part in parts]) + 0.0

    def systems(self, rows: Array) -> list[System]:
        """Return the systems of many rows."""
        return [self.system(row) for row in rows]

    def system(self, row: Array) -> System:
        """Return the system of a row."""
        sizes = map(math.prod, self.shapes.values())
        ends = pairwise(accumulate(sizes, initial=0))
        parts: dict[str, Any] = {
            name: row[begin:end].reshape(shape)
            for (name, shape), (begin, end) in zip(self.shapes.items(), ends, strict=True)
        }
        lags = [parts[f"lags_{name}"] for name in ("force", "of_speed", "of_place", "of_lags")]
        terms = iter(zip(parts["depth"].tolist(), parts["depth_phase"].tolist(), strict=True))
        return System(
            mass=parts["mass"],
            damping=parts["damping"],
            stiffness=parts["stiffness"],
            contacts={str(i): along for i, along in enumerate(parts["contact"])},
            cubic=[
                Cubic(along=along, alpha=alpha)
                for along, alpha in zip(parts["cubic"], parts["alpha"].tolist(), strict=True)
            ],
            forcing=[
                ForceByPieces(load, 1.0, amplitude)
                if isinstance(load, Wave)
                else Harmonic(amplitude=amplitude, k=load[0], phase=phase, power=load[1])
                for load, amplitude, phase in zip(
                    self.loads, parts["load"], parts["load_phase"].tolist(), strict=True
                )
            ],
            modulation={
                str(i): [
                    Modulation(k=k, **dict(zip(("depth", "phase"), next(terms), strict=True)))
                    for k in multiples
                ]
                for i, multiples in enumerate(self.contacts)
                if multiples
            },
            lags=Lags(*lags) if self.m else None,
        )
