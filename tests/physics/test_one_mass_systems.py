"""An oscillator and its form as a system of one mass give the same results at every door.

The engines integrate an oscillator with a mean load in its general form: its numbers are equal to
the last bit, but for the explorer, in which lengths of transients follow from eigenvalues. Others
have their own kernels, and differ by solver tolerances.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import gapsweep as gs
from gapsweep.explorer import page_results
from gapsweep.explorer.first_question import of_model
from gapsweep.explorer.question import EXACT
from gapsweep.model.doubts import doubts
from gapsweep.model.structure import general_form
from gapsweep.response.respond import respond_models

LAW = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.6e-3))
OMEGA = [6.0, 7.0, 12.0, 24.0, 30.0]
CLASSIC = gs.systems.paper_oscillator(c=2.0)
LOADED = gs.systems.paper_oscillator(mean_load=0.05)


def respond(model):
    found = gs.respond(model, LAW, OMEGA)
    return [found.x_max, found.x_min, found.contact_share, found.period_multiple, found.lyapunov]


def branches(model):
    found = gs.branches(model, LAW, along="omega", between=(5.0, 8.0))
    return [found[name].values for name in ("omega", "x_max")]


def basins(model):
    of = ["x", "v_x"] if isinstance(model, gs.System) else ["x_0", "v_0"]
    found = gs.basins(
        model, LAW, 9.0, x=(of[0], [-1e-3, 0.0, 1e-3]), v=(of[1], [0.0, 0.1]), rtol=1e-7
    )
    return [found[name].values for name in ("attractor", "x_max", "basin_share")]


def advise(model):
    found = [gs.advise(model, LAW, each, (1e-4, -1e-3)) for each in OMEGA]
    return [np.array([(each.model, *each.bound, each.rtol) for each in found])]


def warnings(model):
    starts = np.zeros((1, 2))
    far = gs.Piecewise(1.0, gs.Gap(0.4, 0.4))
    soft = gs.Tanh(1e8, gs.Gap(0.4e-3, 0.4e-3), 1e4)
    found = [*doubts([model], [(far,), (soft,)], [500.0], starts)]
    return [np.array([[len(found)], [sum("natural frequency" in each for each in found)]])]


def explore(model):
    question = of_model(model, LAW, approximations=()).at("omega", 9.0)
    moved = page_results.motion(question, EXACT)
    curve = page_results.from_rest(question, EXACT)
    settled = curve.is_periodic
    return [moved.x, moved.v, moved.spectrum, curve.end[settled], curve.x_max[settled], settled]


def study_of(model):
    block = {"representation": ["piecewise", "auto"], "K_c": LAW.K_c, "omega": OMEGA}
    block |= {"gap": [LAW.gap.j_1, LAW.gap.j_2]}
    if isinstance(model, gs.Oscillator):
        fields = ("mass", "omega_n", "zeta", "forcing", "alpha", "c", "mean_load")
        table = {"oscillator": {name: getattr(model, name) for name in fields}}
    else:
        mass, damping, stiffness = (
            getattr(model, name).tolist() for name in ("mass", "damping", "stiffness")
        )
        cubic = [{"along": [1.0], "alpha": each.alpha} for each in model.cubic]
        forcing = [{"amplitude": each.amplitude.tolist(), "k": each.k} for each in model.forcing]
        table = {
            "system": {
                "mass": mass, "damping": damping, "stiffness": stiffness, "cubic": cubic,
                "contacts": {"x": [1.0]}, "forcing": forcing,
            }
        }  # fmt: skip
    return gs.Study.from_dict({"study": {"name": "one"}, "sweep": [block], **table})


def study(model):
    """Responses of the exact law and of `auto`, as tasks of a run compute them."""
    made = study_of(model)
    cells = np.flatnonzero(made.grid.requested)
    chosen = {}
    for rows, table in made.points(cells):
        (_, models), _ = table.models()
        found = respond_models(models, table.kind.solver, table.starts, made.steady)
        for row, peak in zip(rows.tolist(), found.columns["x_max"].ravel(), strict=True):
            chosen[row] = table.kind.solver.rtol, peak
    return [np.array([chosen[row] for row in sorted(chosen)])]


DOORS = (respond, branches, basins, advise, warnings, explore, study)


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.__name__)
def test_a_loaded_oscillator_is_its_general_form_to_the_last_bit(door):
    for ours, general in zip(door(LOADED), door(general_form(LOADED)), strict=True):
        if door is explore:
            assert_allclose(ours, general, rtol=1e-9, atol=1e-12)
        else:
            assert_array_equal(np.squeeze(ours), np.squeeze(general))


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.__name__)
def test_a_classic_oscillator_is_its_general_form_within_tolerances(door):
    for ours, general in zip(door(CLASSIC), door(general_form(CLASSIC)), strict=True):
        numbers = np.asarray(ours, float)
        length = np.abs(numbers[np.isfinite(numbers)]).max(initial=0.0)
        assert_allclose(np.squeeze(numbers), np.squeeze(general), rtol=1e-5, atol=1e-5 * length)
