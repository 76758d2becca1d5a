"""heyoka's Taylor integrator in SIMD batches: events that switch the contact; plain for tanh."""

import heyoka as hy
import numpy as np
from scenes import OSCILLATOR, Scene

TOLERANCES = (1e-3, 1e-4, 1e-6, 1e-9, 1e-12, 1e-15)
# Started at rest on a wall, heyoka's automatic cooldown is zero and the event fires for ever.
_COOLDOWN = 1e-8
_STIFFNESS, _WALL, _OMEGA, _J_1, _J_2 = range(5)


class Heyoka:
    """A batch of neighbouring frequencies; `form` is ``piecewise`` or ``tanh:<epsilon>``."""

    def __init__(self, form, width):
        self.name, self.form, self.width = f"heyoka batch{width}", form, width
        self.integrators = {}

    def run(self, scene: Scene, tolerance):
        """End state of the scene and its neighbours: (x, v), each of shape (width,)."""
        if tolerance not in self.integrators:
            self.integrators[tolerance] = self._build(tolerance)
        ta, n = self.integrators[tolerance], self.width
        self.stiffness, self.j_1, self.j_2 = scene.K_c / OSCILLATOR.mass, scene.j_1, scene.j_2
        self.pars = ta.pars  # a view: fetching it in the callback costs more than the switch
        if ta.with_events:
            ta.reset_cooldowns()
        ta.set_time(0.0)
        ta.state[:] = 0.0
        ta.pars[:] = 0.0
        ta.pars[_STIFFNESS] = 0.0 if self.form == "piecewise" else self.stiffness
        ta.pars[_OMEGA] = 2.0 * np.pi * scene.frequencies(n)
        ta.pars[_J_1], ta.pars[_J_2] = scene.j_1, scene.j_2
        times = np.concatenate([[0.0], scene.grid])
        _, out = ta.propagate_grid(np.repeat(times[:, None], n, axis=1))
        if any(result[0] != hy.taylor_outcome.time_limit for result in ta.propagate_res):
            raise RuntimeError(str(ta.propagate_res[0]))
        return out[-1, 0], out[-1, 1]

    def _build(self, tolerance):
        x, v = hy.make_vars("x", "v")
        q, o = hy.par, OSCILLATOR
        linear = -2.0 * o.decay_rate * v - o.omega_n_rad**2 * x - o.alpha / o.mass * x * x * x
        force = linear + o.forcing / o.mass * hy.cos(q[_OMEGA] * hy.time)
        events = {}
        if self.form == "piecewise":
            force = force - q[_STIFFNESS] * (x - q[_WALL])
            events["t_events"] = self._contact_events(x)
        else:
            epsilon = float(self.form.partition(":")[2])
            below, above = x + q[_J_1], x - q[_J_2]
            force = force - 0.5 * q[_STIFFNESS] * (
                (1.0 - hy.tanh(epsilon * below)) * below + (1.0 + hy.tanh(epsilon * above)) * above
            )
        start = np.zeros((2, self.width))
        pars = np.zeros((5, self.width))
        return hy.taylor_adaptive_batch(
            [(x, v), (v, force)], start, tol=tolerance, pars=pars, **events
        )

    def _contact_events(self, x):
        # Plain functions: heyoka copies callbacks, and of a bound method its object too.
        def at_upper(ta, sign, lane):
            self.pars[_STIFFNESS, lane] = self.stiffness if sign > 0 else 0.0
            self.pars[_WALL, lane] = self.j_2
            return True

        def at_lower(ta, sign, lane):
            self.pars[_STIFFNESS, lane] = self.stiffness if sign < 0 else 0.0
            self.pars[_WALL, lane] = -self.j_1
            return True

        return [
            hy.t_event_batch(x - hy.par[_J_2], callback=at_upper, cooldown=_COOLDOWN),
            hy.t_event_batch(x + hy.par[_J_1], callback=at_lower, cooldown=_COOLDOWN),
        ]
