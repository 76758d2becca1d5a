"""The typical section with flap freeplay, contacts located: lanes here, and batches of heyoka.

Eight states, three contact modes, no forcing: sixteen speeds between two and three fifths of the
flutter speed, in which the flap limit-cycles. Both are given the same tolerance and the same
motions; processor time per trajectory and simulated second, the largest error at the end beside
a run at 1e-14, and the number of contacts.

Run with ``python benchmarks/peers/section.py`` where heyoka is installed beside gapsweep.
"""

import time

import heyoka as hy
import numpy as np

import gapsweep as gs
from gapsweep.model.system import first_order

SPEEDS = np.linspace(9.0, 14.0, 16)
T_END = 2.0
TOLERANCES = (1e-3, 1e-6, 1e-9)
REPEATS = 7
_START = (0.01, 0.0, 0.0)
_COOLDOWN = 1e-9


class Gapsweep:
    """All speeds in one call."""

    name = "gapsweep"

    def __init__(self, tolerance: float) -> None:
        from gapsweep.integrate.problem import Models, Problems, Solver
        from gapsweep.integrate.simulate import prepared

        systems = [gs.systems.typical_section(speed) for speed in SPEEDS]
        n, law = len(systems), gs.systems.typical_section_law()
        models = Models.of(systems, [(law,)] * n, np.zeros(n))
        self.integrate = prepared(models, Solver.of(rtol=tolerance, atol=tolerance * 1e-3))
        start = np.zeros((n, 8))
        start[:, :3] = _START
        never = np.full(n, np.inf)
        self.problems = Problems(
            which=np.arange(n),
            start=start,
            t_0=np.zeros(n),
            t_end=np.full(n, T_END),
            record_from=never,
        )

    def run(self) -> tuple[np.ndarray, int]:
        found = self.integrate(self.problems)
        return found.state[:, :3], int(found.n_contacts.sum())


class Heyoka:
    """Batches of the processor's width; an event at each wall switches the flap's spring."""

    name = "heyoka"

    def __init__(self, tolerance: float) -> None:
        self.width = hy.recommended_simd_size()
        systems = [gs.systems.typical_section(speed) for speed in SPEEDS]
        law = gs.systems.typical_section_law()
        self.matrices = np.array([first_order(system) for system in systems])
        pulls = [np.linalg.solve(s.mass, s.contacts["flap"]) * law.K_c for s in systems]
        self.pulls, self.gap = np.array(pulls), law.gap
        states = hy.make_vars(*(f"y{i}" for i in range(8)))
        beta = states[2]
        depth = hy.par[67] * (beta - hy.par[68])  # 1 or 0 in contact, and the wall
        equations = []
        for i in range(8):
            right = hy.sum([hy.par[8 * i + j] * states[j] for j in range(8)])
            if 3 <= i < 6:
                right = right - hy.par[64 + i - 3] * depth
            equations.append((states[i], right))
        events = [
            hy.t_event_batch(beta - self.gap.j_2, callback=self._passed(self.gap.j_2, 1)),
            hy.t_event_batch(beta + self.gap.j_1, callback=self._passed(-self.gap.j_1, -1)),
        ]
        self.ta = hy.taylor_adaptive_batch(
            equations,
            np.zeros((8, self.width)),
            tol=tolerance,
            pars=np.zeros((69, self.width)),
            t_events=events,
        )
        self.n_contacts = 0

    def _passed(self, wall: float, side: int):
        def switch(ta, sign, lane):
            ta.pars[67, lane] = 1.0 if sign == side else 0.0
            ta.pars[68, lane] = wall
            self.n_contacts += 1
            return True

        return switch

    def run(self) -> tuple[np.ndarray, int]:
        ta, ends, self.n_contacts = self.ta, [], 0
        for first in range(0, len(SPEEDS), self.width):
            part = slice(first, first + self.width)
            ta.reset_cooldowns()
            ta.set_time(0.0)
            ta.state[:] = 0.0
            ta.state[:3] = np.array(_START)[:, None]
            ta.pars[:64] = self.matrices[part].reshape(self.width, 64).T
            ta.pars[64:67], ta.pars[67:] = self.pulls[part].T, 0.0
            ta.propagate_until(T_END)
            ends.append(ta.state[:3].T.copy())
        return np.concatenate(ends), self.n_contacts


def seconds(method) -> float:
    """Processor time of a run, the median of some."""
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        method.run()
        times.append(time.process_time() - begin)
    return float(np.median(times))


def main() -> None:
    truth, n_contacts = Gapsweep(1e-13).run()
    print(f"{len(SPEEDS)} speeds, {T_END} s each, {n_contacts} contacts")
    for tolerance in TOLERANCES:
        found = {}
        for build in (Gapsweep, Heyoka):
            method = build(tolerance)
            ends, n = method.run()
            error = np.abs(ends - truth).max(axis=0) / np.abs(truth).max(axis=0)
            cost = seconds(method) / len(SPEEDS) / T_END
            found[build] = cost
            print(
                f"{tolerance:g} {method.name:9} {1e6 * cost:8.2f} us per simulated second, "
                f"error {error.max():.1e}, {n} contacts"
            )
        print(f"{tolerance:g} ratio {found[Heyoka] / found[Gapsweep]:.1f}")


if __name__ == "__main__":
    main()
