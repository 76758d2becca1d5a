"""The oscillator of a study file, and forces by pieces: as points, or as a file of points."""

from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, model_validator

from gapsweep.errors import ModelError, StudyError
from gapsweep.model.waves import MAX_KNOTS, ForceByPieces, PeriodicForce, Switched, Wave
from gapsweep.study.axes import NonNegative, Number, Positive, Share, TomlTable

Points = Annotated[list[float], Field(min_length=1, max_length=MAX_KNOTS)]


class WaveTable(TomlTable):
    """A periodic force: times `t` in fractions of a period, and forces `f` or `levels` [N]."""

    t: Points
    f: Points | None = None
    levels: Points | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "WaveTable":
        if (self.f is None) == (self.levels is None):
            raise ValueError("give f, for straight lines between points, or levels")
        try:
            _ = self.force
        except ModelError as error:
            raise ValueError(str(error)) from None
        return self

    @cached_property
    def force(self) -> ForceByPieces:
        """The force of an oscillator."""
        if self.levels is not None:
            return Switched(self.t, self.levels)
        assert self.f is not None, "checked before"
        return PeriodicForce(self.t, self.f)


class OscillatorTable(TomlTable):
    """Parameters of the oscillator, in the units of `Oscillator`; each may be swept."""

    zeta: NonNegative
    omega_n: NonNegative
    mass: Positive
    alpha: Number = 0.0
    forcing: Annotated[
        Annotated[Number, Tag("number")] | Annotated[WaveTable, Tag("wave")],
        Discriminator(lambda value: "wave" if isinstance(value, dict | WaveTable) else "number"),
    ]
    mean_load: Number = 0.0
    c: NonNegative = 0.0
    unbalance: Number = 0.0
    base_amplitude: Number = 0.0
    base_damping: Share = 1.0

    @property
    def numbers(self) -> dict[str, float]:
        """All parameters; as `forcing` the largest force of a wave."""
        force = self.forcing
        peak = force.force.peak if isinstance(force, WaveTable) else force
        return self.model_dump() | {"forcing": peak}

    @property
    def wave(self) -> Wave | None:
        """Values of the forcing over its largest one; None: a cosine."""
        return self.forcing.force.wave if isinstance(self.forcing, WaveTable) else None


def with_points(tables: Any, source: str) -> Any:
    """Return the tables of a study with points in place of files of points.

    ``{ table = "force.csv" }`` is a force with the times and forces of that file, next to the
    study; ``period`` is the period [s] if its times are in seconds. The study then has all numbers,
    as keys and results do.

    Raises `StudyError` if a file cannot be read.
    """
    if not isinstance(tables, dict):
        return tables
    folder, found = Path(source).absolute().parent, dict(tables)
    oscillator, system = found.get("oscillator"), found.get("system")
    if isinstance(oscillator, dict) and "forcing" in oscillator:
        where = f"{source}: oscillator.forcing"
        found["oscillator"] = oscillator | {"forcing": _read(oscillator["forcing"], folder, where)}
    if isinstance(system, dict) and isinstance(system.get("forcing"), list):
        loads = [
            _read(load, folder, f"{source}: system.forcing[{i}]")
            for i, load in enumerate(system["forcing"])
        ]
        found["system"] = system | {"forcing": loads}
    return found


def _read(force: Any, folder: Path, where: str) -> Any:
    """Return a force with the points of its file, if it names one."""
    if not isinstance(force, dict) or "table" not in force:
        return force
    if not isinstance(force["table"], str):
        raise StudyError(f"{where}.table = {force['table']!r:.80}: must be a file, as 'force.csv'")
    rest = {name: value for name, value in force.items() if name not in ("table", "period")}
    try:
        t, f = PeriodicForce.points_of(folder / force["table"], force.get("period", 1.0))
    except ModelError as error:
        raise StudyError(f"{where}: {error}") from None
    return rest | {"t": t.tolist(), "f": f.tolist()}
