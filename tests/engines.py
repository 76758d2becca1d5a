"""The two compiled engines, oscillators' numbers as arguments, and readers of their records."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from gapsweep.integrate.runge_kutta import lanes as ln
from gapsweep.integrate.runge_kutta import smooth as rk
from gapsweep.integrate.taylor import exact as taylor
from gapsweep.integrate.taylor import record
from gapsweep.integrate.taylor.scenes import scenes


@dataclass(frozen=True)
class _Read:
    """A run; its own names are the run's."""

    run: Any

    def __getattr__(self, name):
        return getattr(self.run, name)

    @property
    def x(self):
        """First coordinate reached [m]."""
        return self.run.state[:, 0]

    @property
    def v(self):
        """Its velocity [m/s]."""
        return self.run.state[:, self.run.at.n]


class Exact(_Read):
    """A run of `exact`."""

    def events(self, point, *kinds):
        """Recorded events of one point, all kinds or those given: columns t, x, v, kind.

        Turns, contacts and section points, in this order; each kind in the order of time.
        """
        n, value, state = self.at.n, record.VALUE, record.STATE
        turns, contacts, sections = (
            np.pad(log[log[:, record.POINT] == point], ((0, 0), (0, value + 2 * n)))
            for log in (self.turns, self.contacts, self.sections)
        )
        sections[:, -1] = record.SECTION
        found = np.concatenate(
            [
                turns[:, [record.TIME, value, value + n, record.KIND]],
                contacts[:, [record.TIME, value, value + n, record.KIND]],
                sections[:, [record.TIME, state, state + n, -1]],
            ]
        )
        return found[np.isin(found[:, 3], kinds)] if kinds else found


class Smooth(_Read):
    """A run of `smooth`."""

    def rows(self, kind, point=0):
        """Records of one kind of one point."""
        mine = self.records[:, ln.E_POINT] == point
        return self.records[mine & (self.records[:, ln.E_KIND] == kind)]

    def extrema(self, point=0):
        """Times [s] and displacements [m] of zero velocity."""
        return self.rows(ln.EXTREMUM, point)[:, [ln.E_T, ln.E_STATE]].T

    def section(self, point=0):
        """Times and states at whole forcing periods, shape (n, 1 + n_states)."""
        states = range(ln.E_STATE, ln.E_STATE + self.at.n_states)
        return self.rows(ln.SECTION, point)[:, [ln.E_T, *states]]


def exact(
    *,
    zeta,
    omega_n,
    mass,
    alpha,
    forcing,
    K_c,
    j_1,
    j_2,
    omega,
    t_end,
    K_ratio=1.0,
    x_0=0.0,
    v_0=0.0,
    t_0=0.0,
    record_from=np.inf,
    rtol=1e-9,
    atol=1e-12,
    order=None,
    x_bound=None,
    max_chatter=None,
    **options,
):
    """Oscillators with every contact located; all arguments broadcast, `options` are `run`'s.

    With `order`, `x_bound` and `max_chatter` another degree and other limits than the engine's.
    """
    given = zeta, omega_n, mass, alpha, forcing, K_c, j_1, j_2, omega, K_ratio
    arrays = _flat(*given, x_0, v_0, t_0, t_end, record_from)
    prepared = scenes(*arrays[:10], rtol=rtol, atol=atol)
    if order is not None:
        prepared = replace(prepared, at=replace(prepared.at, order=order))
    start = np.stack(arrays[10:12], axis=1)
    with pytest.MonkeyPatch.context() as patch:
        if x_bound is not None:
            patch.setattr(taylor, "DIVERGED_AT", x_bound)
        if max_chatter is not None:
            patch.setattr(taylor, "_MOST_SHORT", float(max_chatter))
        return Exact(
            taylor.run(prepared, np.arange(arrays[0].size), start, *arrays[12:], **options)
        )


def smooth(
    law,
    *,
    omega,
    t_end,
    t_0=0.0,
    x_0=0.0,
    v_0=0.0,
    record_from=np.inf,
    zeta=0.03,
    omega_n=5.0,
    mass=3.0,
    alpha=7e8,
    forcing=4.0,
    rtol=1e-9,
    atol=1e-12,
    controller="native",
    restart=True,
    method=None,
    x_bound=None,
    max_attempts=None,
    stop_at_layer=True,
    **options,
):
    """Oscillators with one of the other laws; all arguments broadcast, `options` are `run`'s.

    With `method`, `x_bound`, `max_attempts` and `stop_at_layer` other ways than the engine's.
    """
    given = zeta, omega_n, mass, alpha, forcing, omega
    *arrays, _ = _flat(*given, x_0, v_0, t_0, t_end, record_from, law.q[..., 0])
    settings = {"rtol": rtol, "atol": atol, "controller": controller, "restart": restart}
    prepared = rk.scenes(law, *arrays[:6], **settings)
    caps = {"bound": x_bound, "max_attempts": max_attempts}
    changes = {name: float(cap) for name, cap in caps.items() if cap is not None}
    changes |= {} if stop_at_layer else {"cuts_at_layers": False}
    if method is not None:
        prepared = replace(prepared, method=method)
        changes["exponent"] = float(method.exponent)
    prepared = replace(prepared, settings=prepared.settings._replace(**changes))
    start = np.stack(arrays[6:8], axis=1)
    return Smooth(rk.run(prepared, np.arange(len(start)), start, *arrays[8:], **options))


def _flat(*given):
    return [np.array(a, dtype=float).ravel() for a in np.broadcast_arrays(*np.atleast_1d(*given))]
