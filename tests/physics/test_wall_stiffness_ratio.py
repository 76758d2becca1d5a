"""Walls of different stiffness: engines against each other, closed forms, and mirror images."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.builders.studies import LABELS

import gapsweep as gs
from gapsweep.model.systems import paper_oscillator

GAP = gs.Gap(0.2e-3, 0.5e-3)
SYMMETRIC, CLOSED = gs.Gap(0.4e-3, 0.4e-3), gs.Gap(0.0, 0.0)
TIGHT = {"rtol": 1e-11, "atol": 1e-14}
LINEAR = paper_oscillator(alpha=0.0)


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
@pytest.mark.parametrize("K_ratio", [0.0, 0.2, 5.0])
def test_a_bilinear_spring_swings_in_two_half_periods(K_ratio, engine):
    o, K_c, x_0 = paper_oscillator(zeta=0.0, alpha=0.0, forcing=0.0), 1.4e4, 1e-3
    spring = o.mass * o.omega_n_rad**2
    above, below = spring + K_c, spring + K_ratio * K_c
    period = math.pi * (math.sqrt(o.mass / above) + math.sqrt(o.mass / below))
    law = gs.Piecewise(K_c, CLOSED, K_ratio=K_ratio)
    run = gs.simulate(o, law, 1.0, x_0, t_end=3.0 * period, engine=engine, **TIGHT)
    assert_allclose(run.x_end, x_0, rtol=1e-8)
    assert_allclose(run.extrema.min(), -x_0 * math.sqrt(above / below), rtol=1e-9)
    # Each wall is passed twice in each period, both in one place; one without stiffness is none.
    assert run.n_contacts == (12 if K_ratio else 6)


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
@pytest.mark.parametrize("label", LABELS)
def test_a_wall_without_stiffness_is_none(label, engine):
    near, far = (
        gs.simulate(
            paper_oscillator(),
            gs.contact_law(label, 1.4e4, gs.Gap(j_1, GAP.j_2), K_ratio=0.0),
            9.0, t_end=1.0, dense_output=True, engine=engine, rtol=1e-9, atol=1e-12,
        )
        for j_1 in (GAP.j_1, 3e-3)
    )  # fmt: skip
    assert (near.x_end, near.v_end, near.nfev) == (far.x_end, far.v_end, far.nfev)
    assert near.n_contacts == far.n_contacts > 10
    # Only the other wall is passed.
    assert_allclose(near.sample(near.t_contacts)[0], GAP.j_2, atol=1e-8)


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_a_wall_without_stiffness_is_as_one_out_of_reach(engine):
    law, far = gs.Piecewise(1.4e4, SYMMETRIC, K_ratio=0.0), gs.Piecewise(1.4e4, gs.Gap(1e3, 4e-4))
    runs = [gs.respond(paper_oscillator(), each, 9.0, engine=engine) for each in (law, far)]
    for name in ("x_end", "v_end", "n_steps", "n_contacts", "contact_share", "multiplier_abs"):
        assert getattr(runs[0], name) == getattr(runs[1], name), name
    assert_allclose(runs[0].contact_share, 0.359, atol=1e-3)  # own integrator; .894 with both


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
@pytest.mark.parametrize("label", LABELS)
def test_a_stop_below_is_the_mirror_image_of_a_stop_above(label, engine):
    """The mirror image of a motion under a cosine begins half a period later."""
    ends = [
        gs.simulate(
            paper_oscillator(), gs.contact_law(label, K_c, gap, K_ratio=0.5), 9.0, x_0, t_0=t_0,
            t_end=t_0 + 1.0, engine=engine, rtol=1e-10, atol=1e-13,
        )
        for K_c, gap, x_0, t_0 in (
            (1.4e4, gs.Gap(None, GAP.j_2), 1e-4, 0.0),
            (2.8e4, gs.Gap(GAP.j_2, None), -1e-4, 0.5 / 9.0),
        )
    ]  # fmt: skip
    assert_allclose(ends[1].x_end, -ends[0].x_end, rtol=1e-6)
    assert ends[0].n_contacts == ends[1].n_contacts > 10


@pytest.mark.parametrize("label", ["tanh-1e3", "arctan-1e3", "logarctan-1e3"])
@pytest.mark.parametrize("gap", [gs.Gap(1e6, 1.0), gs.Gap(1.0, 1e6)])
def test_a_smooth_law_refuses_a_wall_that_only_its_tail_reaches(label, gap):
    with pytest.raises(gs.ModelError, match=r"wall at 1e\+06: .*within 1000, .*one side"):
        gs.contact_law(label, 100.0, gap)
    gs.contact_law(label, 100.0, gs.Gap(1e6, 1.0), K_ratio=0.0)  # no wall, hence no tail


@pytest.mark.parametrize("law", [gs.Piecewise(0.0, SYMMETRIC), gs.Tanh(0.0, SYMMETRIC, 1e5)])
@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_walls_without_stiffness_are_never_touched(law, engine):
    found = gs.respond(LINEAR, law, [4.5, 6.0], engine=engine)
    assert (found.x_max > 2.0 * SYMMETRIC.j_2).all()
    assert not found.n_contacts.any()
    assert not found.contact_share.any()


def test_basins_say_between_which_walls():
    law = gs.Piecewise(1.4e4, SYMMETRIC, K_ratio=0.5)
    found = gs.basins(paper_oscillator(), law, 9.0, x=[-1e-3, 1e-3], v=[0.0])
    assert found.attrs["K_ratio"] == 0.5


def two_masses():
    return gs.System(
        mass=np.diag([1.0, 0.5]),
        stiffness=[[300.0, -100.0], [-100.0, 200.0]],
        damping=[[0.6, -0.2], [-0.2, 0.4]],
        contacts={"stop": [1.0, 0.0], "joint": [-1.0, 1.0]},
        forcing=[gs.Harmonic(amplitude=[0.0, 2.0])],
    )


@pytest.mark.extended
@pytest.mark.parametrize("law", [gs.Piecewise, gs.Tanh])
def test_a_wall_without_stiffness_of_a_system_is_none(law):
    more = {} if law is gs.Piecewise else {"epsilon": 1e4}
    joint = law(K_c=5e3, gap=gs.Gap(0.002, 0.002), **more)
    runs = [
        gs.simulate(
            two_masses(),
            {"stop": law(K_c=2e4, gap=gs.Gap(j_1, 0.001), K_ratio=0.0, **more), "joint": joint},
            2.5, t_end=4.0, q_0=[-0.002, 0.0],  # beyond the nearer of both walls
        )
        for j_1 in (0.001, 0.5)
    ]  # fmt: skip
    assert (runs[0].q_end == runs[1].q_end).all()
    assert (runs[0].v_end == runs[1].v_end).all()
    assert runs[0].n_contacts == runs[1].n_contacts
