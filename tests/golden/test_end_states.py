"""Both engines against end states of independent high-precision methods."""

import numpy as np
import pytest
from tests.conftest import golden

import gapsweep as gs

# engine, tolerances, error allowed relative to the amplitude: exact law, smooth laws
REFERENCE = ("scipy", 1e-10, 1e-13, 1e-6, 1e-6)
COMPILED = ("compiled", 1e-12, 1e-15, 1e-9, 1e-8)
both = pytest.mark.parametrize("engine", [REFERENCE, COMPILED], ids=lambda engine: engine[0])
ROWS = golden("piecewise.json")
# The reference engine, which takes seconds for each of them, computes every third one.
OF_ENGINES = [(row, COMPILED) for row in ROWS] + [(row, REFERENCE) for row in ROWS[::3]]
LAWS = {"tanh": "tanh", "arctan": "arctan", "log-arctan": "logarctan"}


def piecewise_run(row, **options):
    scene = row["scene"]
    names = ("zeta", "omega_n", "mass", "alpha", "forcing")
    oscillator = gs.systems.paper_oscillator(**{name: scene[name] for name in names})
    law = gs.Piecewise(scene["K_c"], gs.Gap(scene["j_1"], scene["j_2"]))
    start = {name: scene[name] for name in ("omega", "x_0", "v_0")}
    return oscillator, gs.simulate(oscillator, law, **start, t_end=row["T"], **options)


def scaled_error(oscillator, run, row, amplitude):
    distances = abs(run.x_end - row["x_T"]), abs(run.v_end - row["v_T"]) / oscillator.omega_n_rad
    return max(distances) / amplitude


@pytest.mark.parametrize(("row", "engine"), OF_ENGINES)
def test_exact_law_reaches_the_true_end_state(row, engine):
    name, rtol, atol, allowed, _ = engine
    oscillator, run = piecewise_run(row, engine=name, rtol=rtol, atol=atol)
    amplitude = 0.5 * (row["tail_max"] - row["tail_min"])
    tail = run.extrema[run.t_extrema > row["tail_from"]]
    assert run.status is gs.Status.OK
    assert scaled_error(oscillator, run, row, amplitude) < allowed
    assert run.n_contacts == row["contact_transitions"]
    assert len(run.section) == row["n_forcing_periods"]
    np.testing.assert_allclose(tail.max(), row["tail_max"], atol=allowed * amplitude)
    np.testing.assert_allclose(tail.min(), row["tail_min"], atol=allowed * amplitude)


@both
@pytest.mark.parametrize("row", golden("smooth.json"))
def test_smooth_laws_reach_the_true_end_state(row, engine):
    name, rtol, atol, _, allowed = engine
    label = f"{LAWS[row['representation']]}-{row['convergence']:g}"
    law = gs.contact_law(label, row["K_c"], gs.Gap(row["j_1"], row["j_2"]))
    oscillator = gs.systems.paper_oscillator()
    run = gs.simulate(
        oscillator, law, row["omega"], t_end=row["T"], engine=name, rtol=rtol, atol=atol
    )
    last_period = run.t_extrema > row["T"] - 1.0 / row["omega"]
    amplitude = np.abs(run.extrema[last_period]).max()
    assert scaled_error(oscillator, run, row, amplitude) < allowed


def test_a_stiffness_off_by_one_percent_is_noticed():
    row = ROWS[1]
    changed = row | {"scene": row["scene"] | {"K_c": 1.01 * row["scene"]["K_c"]}}
    oscillator, run = piecewise_run(changed, engine="compiled")
    assert scaled_error(oscillator, run, row, row["tail_max"]) > 1e-3
