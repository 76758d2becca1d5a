"""Known solutions without integration: linear motion, energy, and oscillators without walls."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gapsweep.analysis.bench.references import ScenarioRun
from gapsweep.analysis.bench.scenarios import Scenario
from gapsweep.analysis.dimensions import Array
from gapsweep.model.contact import ContactLaw
from gapsweep.model.equilibria import linear_stiffness, panels, search_points
from gapsweep.status import Status


def plain_duffing(scenario: Scenario) -> Scenario:
    """The scenario without walls; without a gap the contact becomes a linear spring."""
    o = scenario.oscillator
    added = scenario.K_c if scenario.gap.j_1 == scenario.gap.j_2 == 0.0 else 0.0
    omega_n = math.sqrt((linear_stiffness(o) + added) / o.mass) / (2.0 * math.pi)
    zeta = o.zeta * o.omega_n / omega_n
    return replace(scenario, K_c=0.0, oscillator=replace(o, omega_n=omega_n, zeta=zeta))


def closed_form(scenario: Scenario) -> ScenarioRun:
    """Exact motion of the linear oscillator (``alpha = 0``) without walls, at its period ends."""
    o = plain_duffing(scenario).oscillator
    w_n, w, decay = o.omega_n_rad, 2.0 * math.pi * scenario.omega, o.decay_rate
    steady = (o.forcing / o.mass) / complex(w_n**2 - w**2, 2.0 * decay * w)
    t = np.arange(1, scenario.n_periods + 1) / scenario.omega
    # x(t) = Re[steady e^{iwt} + c e^{st}], s = -decay + i w_d
    w_d = math.sqrt(w_n**2 - decay**2)
    x, v = scenario.x_0 - steady.real, scenario.v_0 - (1j * w * steady).real
    c = complex(x, -(v + decay * x) / w_d)
    s = complex(-decay, w_d)
    free = c * np.exp(s * t)
    section = np.stack([steady.real + free.real, (1j * w * steady).real + (s * free).real], axis=1)
    reach = abs(steady) + abs(c)
    return ScenarioRun(status=Status.OK, section=section, t_contacts=np.empty(0), reach=reach)


def energy_drift(scenario: Scenario, law: ContactLaw) -> Callable[[Array], Array]:
    """Function of states, shape (n, 2), that returns the relative change of the initial energy."""
    o = scenario.oscillator
    start = np.array([[scenario.x_0, scenario.v_0]])

    def energy(states: Array) -> Array:
        x, v = states.T
        springs = 0.5 * linear_stiffness(o) * x**2 + 0.25 * o.alpha * x**4
        return np.asarray(0.5 * o.mass * v**2 + springs + contact_energy(law, x))

    at_start = float(energy(start)[0])
    return lambda states: energy(states) / at_start - 1.0


def contact_energy(law: ContactLaw, x: ArrayLike) -> Array:
    """Potential energy of a contact law [J], zero at ``x = 0``."""
    x = np.asarray(x, dtype=float)
    furthest = float(np.max(np.abs(x), initial=1e-9))
    points = np.union1d(search_points(law, furthest), np.append(x.ravel(), 0.0))
    nodes, weights = panels(points)
    work = np.concatenate([[0.0], np.cumsum(np.sum(law.force(nodes) * weights, axis=1))])
    energy = work - work[np.searchsorted(points, 0.0)]
    return np.asarray(energy[np.searchsorted(points, x.ravel())].reshape(x.shape))
