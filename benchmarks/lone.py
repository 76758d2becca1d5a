"""What one motion and one steady response cost by themselves: medians of processor time [ms].

    python benchmarks/lone.py

To compare two commits, run both in turn: `PYTHONPATH` chooses the package.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import gapsweep as gs


def median(call: Callable[[], Any], n: int) -> float:
    """Median processor time [ms] of n calls, after two that load or compile the machine code."""
    seconds = []
    for _ in range(n + 2):
        begin = time.thread_time()
        call()
        seconds.append(time.thread_time() - begin)
    return 1e3 * statistics.median(seconds[2:])


def row(rtol: float, omega: float) -> None:
    oscillator, law = gs.systems.paper_oscillator(), gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    given: dict[str, Any] = {"omega": omega, "rtol": rtol, "atol": 1e-3 * rtol}
    short = median(lambda: gs.simulate(oscillator, law, t_end=10.0, **given), 200)
    long = median(lambda: gs.simulate(oscillator, law, t_end=100.0, **given), 30)
    response = median(lambda: gs.respond(oscillator, law, **given), 60)
    print(f"{rtol:.0e}  {omega:5g}  {short:13.2f}  {long:14.2f}  {response:7.2f}")


def main() -> None:
    print("rtol   omega  simulate 10 s  simulate 100 s  respond")
    for rtol in (1e-6, 1e-9):
        for omega in (9.0, 7.0):
            row(rtol, omega)


if __name__ == "__main__":
    main()
