"""The table ``[bench]`` of a study file: motions and methods to compare."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from gapsweep.integrate.problem import LARGEST_RTOL, SMALLEST_RTOL
from gapsweep.study.axes import Label, NonNegative, Pair, Positive, Range, TomlTable
from gapsweep.study.oscillator_table import OscillatorTable, WaveTable

# Longest motion that is compared with its reference, in forcing periods.
MAX_BENCH_PERIODS = 100_000
# Share of rtol that is the absolute tolerance [m], [m/s] where a method states none: motions are
# about a millimetre wide.
ATOL_PER_RTOL = 1e-3


class SceneOscillatorTable(TomlTable):
    """Parameters of the oscillator that differ from those of the study."""

    zeta: NonNegative | None = None
    omega_n: Positive | None = None
    mass: Positive | None = None
    alpha: float | None = None
    forcing: float | None = None


Expected = Literal["reference", "energy", "duffing", "linear", "phase", "mirror"]
Periods = Annotated[int, Field(ge=1, le=MAX_BENCH_PERIODS)]
Tolerance = Annotated[float, Field(ge=SMALLEST_RTOL, le=LARGEST_RTOL)]


class BenchSceneTable(TomlTable):
    """A scenario of a benchmark: one motion.

    `expected` is the kind of the known solution, `without` lists excluded methods.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,63}$")]
    oscillator: SceneOscillatorTable = SceneOscillatorTable()
    K_c: NonNegative
    gap: Pair
    omega: Positive
    start: Range = Field([0.0, 0.0])
    expected: Expected | None = None
    horizon: Periods | None = None
    without: list[Label] = Field([])

    def merged(self, oscillator: OscillatorTable) -> OscillatorTable:
        """Return the oscillator of the scenario: that of the study with its changes."""
        return oscillator.model_copy(update=self.oscillator.model_dump(exclude_none=True))

    def contradictions(self, oscillator: OscillatorTable) -> list[str]:
        """Problems that exclude the expected solution, for the oscillator of the study."""
        own, touching = self.merged(oscillator), self.gap == [0.0, 0.0]
        if isinstance(own.forcing, WaveTable):
            return ["forcing: must be the amplitude of a cosine, as 4.0"]
        needs = {
            "energy": ("zeta = 0 and forcing = 0", own.zeta == 0.0 and own.forcing == 0.0),
            "linear": (
                "alpha = 0, and K_c = 0 or gap = [0, 0]",
                own.alpha == 0.0 and (self.K_c == 0.0 or touching),
            ),
            "mirror": ("j_1 = j_2", self.gap[0] == self.gap[1]),
        }
        condition, is_met = needs.get(self.expected or "", ("", True))
        found = [] if is_met else [f"expected = {self.expected!r}: needs {condition}"]
        if not (
            own.omega_n > 0.0
            and own.mean_load == own.c == own.unbalance == own.base_amplitude == 0.0
        ):
            found.append("needs omega_n > 0; mean_load, c, unbalance and base_amplitude must be 0")
        return found


class MethodTable(TomlTable):
    """A method: representation, solver and descending tolerances."""

    label: Label
    rtol: Annotated[list[Tolerance], Field(min_length=1)]
    atol: Annotated[list[Positive], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _pairs(self) -> "MethodTable":
        if self.atol is not None and len(self.atol) != len(self.rtol):
            raise ValueError(
                f"atol has {len(self.atol)} values, rtol has {len(self.rtol)}: must be equal"
            )
        if sorted(set(self.rtol), reverse=True) != self.rtol:
            raise ValueError("rtol must be descending, as [1e-3, 1e-6, 1e-9]")
        return self

    @property
    def rungs(self) -> list[tuple[float, float]]:
        """Pairs of relative [-] and absolute [m, m/s] tolerances."""
        atol = self.atol or [ATOL_PER_RTOL * rtol for rtol in self.rtol]
        return list(zip(self.rtol, atol, strict=True))


class BenchTable(TomlTable):
    """Benchmarks of work-precision and stability: every method on every scenario."""

    scene: Annotated[list[BenchSceneTable], Field(min_length=1)]
    method: Annotated[list[MethodTable], Field(min_length=1)]
    horizon: Periods = 10
    repeats: Annotated[int, Field(ge=1, le=1000)] = 5
    lanes: Annotated[int, Field(ge=1, le=65536)] = 64

    @model_validator(mode="after")
    def _named_once(self) -> "BenchTable":
        names: tuple[list[str], ...]
        names = [scene.name for scene in self.scene], [method.label for method in self.method]
        twice = [name for some in names for name in dict.fromkeys(some) if some.count(name) > 1]
        if twice:
            raise ValueError(f"{', '.join(twice)}: must occur once only")
        unknown = {label for scene in self.scene for label in scene.without} - set(names[1])
        if unknown:
            raise ValueError(f"without {', '.join(sorted(unknown))}: no such method")
        return self
