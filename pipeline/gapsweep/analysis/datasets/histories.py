"""Time histories and amplitude spectra of the motions in ``[[history]]`` of a study.

The first and the last forcing periods of every motion are stored, sampled at equal phases of the
forcing. The spectrum is of the last periods: a Hann window over whole forcing periods,
scaled so that a sinusoid on a bin shows its amplitude. The number of periods has many
divisors, so that the harmonics of period-2 to period-6 motions, too, lie on bins.
"""

from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.dimensions import Array
from gapsweep.analysis.spectra import N_PERIODS, SAMPLES_PER_PERIOD, repetition, spectrum
from gapsweep.errors import ModelError
from gapsweep.execution.isolated import CallError, Isolated
from gapsweep.execution.progress import DEFAULT_TIMEOUT
from gapsweep.integrate.simulate import motion_of
from gapsweep.model.contact import OF_WALLS
from gapsweep.model.labels import Representation
from gapsweep.status import Status
from gapsweep.study.grid import START
from gapsweep.study.points import Points
from gapsweep.study.schema import COORDINATES
from gapsweep.study.spec import HistoryTable
from gapsweep.study.study import Study
from gapsweep.user_code.package_digest import numerics_fingerprint
from gapsweep.variables import STATUS_FLAGS, Variable, empty, with_attributes

PARTS = ("start", "steady")

_DIMS = ("history", "representation")
_SCENE = ("K_c", "gap", "j_1", "j_2", "omega", "x_0", "v_0")
SCENE = {
    **{name: COORDINATES[name][1] for name in _SCENE},
    "t_end": Variable("f8", "s", "end of the motion"),
    "n_periods": Variable("i4", "1", "forcing periods stored at either end", 0),
}
_of_samples, _of_bins, _of_motion = (
    partial(Variable, dims=(*_DIMS, *own)) for own in (("part", "sample"), ("frequency_bin",), ())
)
VARIABLES = {
    "x": _of_samples("f8", "m", "displacement"),
    "v": _of_samples("f8", "m s-1", "velocity"),
    "spectrum": _of_bins("f8", "m", "amplitude spectrum of the steady displacement"),
    "period_multiple": _of_motion(
        "i4", "1", "forcing periods after which the steady part repeats, 0: none", 0
    ),
    "status": _of_motion("i1", "1", "outcome of the motion", Status.NOT_REQUESTED, STATUS_FLAGS),
}
AXES = {
    "t": Variable("f8", "s", "time", dims=("history", "part", "sample")),
    "frequency": Variable(
        "f8", "Hz", "frequency of the spectrum", dims=("history", "frequency_bin")
    ),
}
_WINDOW = "Hann over whole forcing periods; a sinusoid at a bin has its amplitude"


def histories(study: Study, timeout: float = DEFAULT_TIMEOUT) -> xr.Dataset:
    """Time histories and spectra of a study's ``[[history]]`` tables.

    Parameters
    ----------
    timeout : float
        Processor time [s] of a motion with a user law, which runs in a separate process.

    Returns
    -------
    Dataset
        Over `history` (the tables in their order) and `representation` (of all tables;
        motions that no table requests are `not_requested`). `x` and `v` over `part` (``start``,
        ``steady``) and `sample`, at times `t`; `spectrum` over `frequency_bin`, at `frequency`.
        Padded with NaN where a motion is shorter than `N_PERIODS` or has failed.
    """
    tables = study.spec.history
    labels = list(dict.fromkeys(label for table in tables for label in table.representation))
    n_samples = N_PERIODS * SAMPLES_PER_PERIOD
    sizes = {
        "history": len(tables),
        "representation": len(labels),
        "part": len(PARTS),
        "sample": n_samples,
        "frequency_bin": n_samples // 2 + 1,
    }
    arrays = empty(VARIABLES | AXES, sizes)
    with Isolated(timeout) as process:
        for h, table in enumerate(tables):
            t, frequency = sampled(table.omega, table.t_end)
            arrays["t"][h, :, : t.shape[1]] = t
            arrays["frequency"][h, : frequency.size] = frequency
            for label in table.representation:
                for name, value in _history(study, table, label, process).items():
                    here = arrays[name][h, labels.index(label), ...]
                    here[_leading(value)] = value
    coords = {
        "representation": ("representation", labels, COORDINATES["representation"][1].attributes),
        "part": ("part", list(PARTS), {"units": "1", "long_name": "first or last periods"}),
        **{
            name: ("history", [_scene(study, table)[name] for table in tables], attributes)
            for name, attributes in _described(study).items()
        },
        **with_attributes(AXES, arrays),
    }
    variables = with_attributes(VARIABLES, arrays)
    variables["spectrum"][2]["window"] = _WINDOW
    attributes = {
        **study.attributes,
        "numerics_fingerprint": numerics_fingerprint(),
    }
    return xr.Dataset(variables, coords, attributes)


def sampled(omega: float, t_end: float) -> tuple[Array, Array]:
    """Times [s], shape (2, n), of the first and last periods, and frequencies [Hz] of the bins."""
    whole = _whole_periods(omega, t_end)
    n_periods = min(N_PERIODS, whole)
    n = n_periods * SAMPLES_PER_PERIOD
    phase = np.arange(n) / SAMPLES_PER_PERIOD
    t = np.array([phase, phase + (whole - n_periods)]) / omega
    frequency = np.arange(n // 2 + 1, dtype=np.float64) * np.float64(omega / n_periods)
    return t, frequency


def _leading(value: Any) -> Any:
    """Index of a value in an array that is padded along its last axis."""
    return (..., slice(np.shape(value)[-1])) if np.ndim(value) else ...


def _whole_periods(omega: float, t_end: float) -> int:
    return int(t_end * omega + 1e-9)


def _described(study: Study) -> dict[str, dict[str, Any]]:
    """Attributes of the coordinates of histories, with oscillator parameters that are given."""
    given = {x for table in study.spec.history for x in (*table.parameter, *table.model_fields_set)}
    others = [x for x in (*study.spec.model, *OF_WALLS) if x in given.union(study.grid.axes)]
    described = SCENE | {name: COORDINATES[name][1] for name in others}
    return {name: variable.attributes for name, variable in described.items()}


def _scene(study: Study, table: HistoryTable) -> dict[str, Any]:
    """Values of the coordinates of a history, by name."""
    values = {name: axis[0] for name, axis in study.history_axes(table).items()}
    gap, (_, (x_0, v_0)) = values["gap"], values[START]
    return values | {
        "gap": gap.label,
        "j_1": gap.j_1,
        "j_2": gap.j_2,
        "x_0": x_0,
        "v_0": v_0,
        "t_end": table.t_end,
        "n_periods": min(N_PERIODS, _whole_periods(table.omega, table.t_end)),
    }


def _history(study: Study, table: HistoryTable, label: str, process: Isolated) -> dict[str, Any]:
    """The variables of one motion by name; only its status if it has failed."""
    try:
        point = study.history_point(table, Representation(label))
        motion = point, table.omega, table.t_end
        return process(_motion, *motion) if point.kind.own else _motion(*motion)
    except ModelError:
        return {"status": Status.MODEL_INVALID}
    except CallError as lost:
        return {"status": lost.status}


def _motion(point: Points, omega: float, t_end: float) -> dict[str, Any]:
    (_, models), refused = point.models()
    for error in refused.values():
        raise error
    t, _ = sampled(omega, t_end)
    n_periods = _whole_periods(omega, t_end)
    motion = motion_of(models, point.kind.solver, point.starts[0], n_periods)
    if motion.t_end < t.max():
        return {"status": motion.status}
    x, v = (values.reshape(t.shape) for values in motion.sample(t)[:2])
    steady = np.transpose([x[-1], v[-1]])[::SAMPLES_PER_PERIOD]
    return {
        "x": x,
        "v": v,
        "spectrum": spectrum(x[-1]),
        "period_multiple": repetition(steady, float(np.max(np.abs(x[-1]))), omega),
        "status": motion.status,
    }
