"""CPU time of calls that integrate a scenario and its neighbours in frequency."""

import time

import numpy as np

from gapsweep.analysis.bench.scenarios import Scenario, law_or_none
from gapsweep.integrate.problem import Models, Problems, Solver
from gapsweep.integrate.simulate import prepared

# Relative distance of the frequencies of the lanes of a call.
_NEIGHBOUR = 1e-4


def cost(
    scenario: Scenario, representation: str, solver: Solver, n_lanes: int
) -> tuple[float, float] | None:
    """CPU time [s] of one call, and simulated time [s] of all its lanes together.

    The preparation of the models is not timed. None if the law cannot be built.
    """
    law = law_or_none(scenario, representation)
    if law is None:
        return None
    omega = scenario.omega * (1.0 + _NEIGHBOUR * np.arange(n_lanes, dtype=np.float64))
    integrate = prepared(
        Models.of([scenario.oscillator] * n_lanes, [(law,)] * n_lanes, omega), solver
    )
    problems = Problems(
        which=np.arange(n_lanes),
        start=np.full((n_lanes, 2), (scenario.x_0, scenario.v_0)),
        t_0=np.zeros(n_lanes),
        t_end=scenario.n_periods / omega,
        record_from=np.full(n_lanes, np.inf),
    )
    begin = time.process_time()
    integrate(problems)
    return time.process_time() - begin, float(np.sum(problems.t_end - problems.t_0))
