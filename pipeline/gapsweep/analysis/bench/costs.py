"""What a method costs: processor time of calls that advance a scenario and its neighbours."""

import time
from dataclasses import dataclass

import numpy as np

from gapsweep.analysis.bench.scenarios import Scenario, law_or_none
from gapsweep.analysis.dimensions import Array
from gapsweep.integrate.problem import Integrate, Models, Problems, Solver
from gapsweep.integrate.simulate import prepared
from gapsweep.model.contact import ContactLaw

# The frequencies of the lanes that advance beside a scenario, relative to it and to each other.
_NEIGHBOUR = 1e-4


@dataclass(frozen=True, slots=True)
class Timed:
    """A call that is timed: neighbouring frequencies of a scenario, solved together."""

    integrate: Integrate
    problems: Problems

    @property
    def simulated(self) -> float:
        """Simulated time [s] of all lanes."""
        return float(np.sum(self.problems.t_end - self.problems.t_0))

    def seconds(self) -> float:
        """Processor time [s] of one call."""
        begin = time.process_time()
        self.integrate(self.problems)
        return time.process_time() - begin


def timed(scenario: Scenario, law: ContactLaw, solver: Solver, n_lanes: int) -> Timed:
    """A scenario and its neighbours in frequency, prepared."""
    omega: Array = scenario.omega * (1.0 + _NEIGHBOUR * np.arange(n_lanes, dtype=np.float64))
    models = Models.of([scenario.oscillator] * n_lanes, [(law,)] * n_lanes, omega)
    problems = Problems(
        which=np.arange(n_lanes),
        start=np.full((n_lanes, 2), (scenario.x_0, scenario.v_0)),
        t_0=np.zeros(n_lanes),
        t_end=scenario.n_periods / omega,
        record_from=np.full(n_lanes, np.inf),
    )
    return Timed(prepared(models, solver), problems)


def cost(
    scenario: Scenario, representation: str, solver: Solver, n_lanes: int
) -> tuple[float, float] | None:
    """Processor time and simulated time [s] of one call; None if there is no such law."""
    law = law_or_none(scenario, representation)
    if law is None:
        return None
    call = timed(scenario, law, solver, n_lanes)
    return call.seconds(), call.simulated
