"""Compile the kernels of oscillators for levels of x86-64, to be shipped in a wheel.

    python tools/machine_code.py [x86-64-v3 x86-64-v4]

Each level is compiled by a process that numba makes believe it runs on such a processor, into
``pipeline/gapsweep/machine_code``, for the Python that runs this. A wheel built afterwards carries
it. Two minutes a level.
"""

import os
import shutil
import subprocess
import sys
import tempfile

from gapsweep.integrate.jit import SHIP_TO, SHIPPED, folder_of

LABELS = (
    *("piecewise", "piecewise-noevents", "poly-13", "ratpoly-5/3"),
    *("tanh-1e4", "arctan-1e4", "logarctan-1e4"),
)


def compile_all() -> None:
    """Call whatever studies and scripts call, once for every law and with every option."""
    import gapsweep as gs

    gap, start = gs.Gap(4e-4, 4e-4), {"omega": 9.0, "x_0": 1e-3}
    for label in LABELS:
        law = gs.contact_law(label, 1.4e4, gap)
        for options in ({}, {"dense_output": True}, {"tangent": True}):
            motion = gs.simulate(gs.systems.paper_oscillator(), law, **start, t_end=0.2, **options)
            if "dense_output" in options:
                motion.sample([0.1])
        gs.respond(gs.systems.paper_oscillator(), law, **start, rtol=1e-6)
    exact = gs.contact_law("piecewise", 1.4e4, gap)
    for tables in ({"controller": "ode45"}, {"controller": "ode45", "restart": True}):
        gs.simulate(gs.systems.paper_oscillator(), exact, **start, t_end=0.2, **tables)


def main(levels: list[str]) -> None:
    for level in levels:
        target = SHIPPED / folder_of(level)
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir(parents=True)
        with tempfile.TemporaryDirectory() as folder:
            asked = {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": folder}
            subprocess.run(
                [sys.executable, __file__, "--compile"],
                env=os.environ | asked | {SHIP_TO: str(target)},
                check=True,
            )
        size = sum(file.stat().st_size for file in target.iterdir())
        print(f"{target.name}: {len(list(target.iterdir()))} files, {size / 1e6:.1f} MB")


if __name__ == "__main__":
    if sys.argv[1:] == ["--compile"]:
        compile_all()
    else:
        main(sys.argv[1:] or ["x86-64-v3", "x86-64-v4"])
