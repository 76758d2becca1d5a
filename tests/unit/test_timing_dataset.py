"""Costs of the representations, from hand-made responses."""

import subprocess
import sys

import numpy as np
import xarray as xr
from numpy.testing import assert_allclose

from gapsweep.analysis.datasets.timing import COSTS, timing
from gapsweep.study.schema import POINT_DIMS


def responses(host, cpu_time):
    """Two representations at as many frequencies as columns are given."""
    shape = (2, 1, 1, np.shape(host)[1], 1)

    def grid(values, dtype=float):
        return POINT_DIMS, np.reshape(np.array(values, dtype), shape)

    zeros = np.zeros(shape)
    hosts = {"flag_meanings": "left right", "flag_values": [0, 1]}
    return xr.Dataset(
        {
            "status": grid(zeros, int),
            "host": (*grid(host, int), hosts),
            "cpu_time": grid(cpu_time),
            **{name: grid(zeros, int) for name in COSTS if name != "cpu_time"},
        },
        coords={"representation": ["piecewise", "tanh-1e4"], "omega": np.arange(1.0, shape[3] + 1)},
        attrs=dict.fromkeys(("title", "study", "study_json", "numerics_fingerprint"), ""),
    )


def test_times_of_different_machines_are_never_mixed():
    result = timing(responses([[0, 1, 1], [1, 1, 0]], [[100.0, 2.0, 4.0], [1.0, 3.0, 100.0]]))
    assert_allclose(result["cpu_time_mean"].squeeze(), [3.0, 2.0])
    assert result["n_points_elsewhere"].values.ravel().tolist() == [1, 1]
    assert result.attrs["measured_on"] == "right"


def test_every_variable_has_a_unit_and_a_name():
    for variable in timing(responses([[0], [0]], [[1.0], [1.0]])).data_vars.values():
        assert variable.attrs["units"]
        assert variable.attrs["long_name"]


def test_loading_machine_code_is_no_part_of_the_first_motions_cost():
    """In a separate process: the first call loads modules for all others."""
    script = (
        "import numpy as np, gapsweep as gs\n"
        "gap = gs.Gap(4e-4, 4e-4)\n"
        "law, omega = gs.Piecewise(1.4e4, gap), np.linspace(3.0, 12.0, 64)\n"
        "for _ in range(2):\n"
        "    print(gs.respond(gs.systems.paper_oscillator(), law, omega).cpu_time.sum())\n"
    )
    made = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    first, second = map(float, made.stdout.split())
    assert first < second + 0.05  # [s]; loading takes some tenths
