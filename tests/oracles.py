"""Independent end states: heyoka where it is installed, scipy's DOP853 elsewhere.

And the distance of two orbits, plainly.
"""

import math

import numpy as np

import gapsweep as gs

try:
    import heyoka as hy
except ImportError:  # not a Linux x86-64 machine, or too new a Python
    hy = None


def exact_end_state(oscillator, law, omega, x_0, v_0, t_end):
    """(x, v, contacts) of the exact law at `t_end`, by a method that is not under test.

    The start must lie strictly inside the gap.
    """
    if hy is None:
        run = gs.simulate(
            oscillator, law, omega, x_0, v_0, t_end=t_end, engine="scipy", rtol=1e-13, atol=1e-17
        )
        return run.x_end, run.v_end, run.n_contacts
    return _heyoka_end_state(oscillator, law, omega, x_0, v_0, t_end)


def _heyoka_end_state(oscillator, law, omega, x_0, v_0, t_end):
    x, v = hy.make_vars("x", "v")
    stiffness, wall = hy.par[0], hy.par[1]
    o, j_1, j_2 = oscillator, law.gap.j_1, law.gap.j_2
    springs = o.omega_n_rad**2 * x + o.alpha / o.mass * x * x * x + stiffness * (x - wall)
    drive = o.forcing / o.mass * hy.cos(2.0 * math.pi * omega * hy.time)
    contacts = []

    def switch(position, inward, contact):
        def callback(ta, sign):
            contacts.append(ta.time)
            inside = sign == inward
            ta.pars[0] = 0.0 if inside else contact / o.mass
            ta.pars[1] = position
            return True

        return callback

    events = [
        hy.t_event(x - j_2, callback=switch(j_2, -1, law.K_c), cooldown=1e-12),
        hy.t_event(x + j_1, callback=switch(-j_1, 1, law.K_ratio * law.K_c), cooldown=1e-12),
    ]
    ta = hy.taylor_adaptive(
        [(x, v), (v, drive - 2.0 * o.decay_rate * v - springs)],
        [x_0, v_0],
        pars=[0.0, 0.0],
        t_events=events,
        tol=1e-16,
    )
    ta.propagate_until(t_end)
    return ta.state[0], ta.state[1], len(contacts)


def orbit_distance(a, b):
    """Largest distance of two periodic orbits' section points, modulo a shift in time [m].

    Infinite if they have different numbers of points.
    """
    if len(a) != len(b):
        return float("inf")
    gaps = (np.roll(a, s) - b for s in range(len(a)))
    return float(min(max(np.abs(gap.real).max(), np.abs(gap.imag).max()) for gap in gaps))
