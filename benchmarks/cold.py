"""What a first study costs: machine code compiled on the spot, shipped, or kept from a run before.

    python tools/machine_code.py x86-64-v3
    python benchmarks/cold.py

Processor time of `workflows/quick.toml` with all its workers, and of a script from import to its
first number, each in an empty home.
"""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from gapsweep.integrate.jit import SHIPPED

ROOT = Path(__file__).parents[1]
SCRIPT = (
    "import gapsweep as gs; gs.simulate(gs.systems.paper_oscillator(), "
    "gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4)), 9.0, t_end=1.0)"
)
RUN = "import sys; from gapsweep.cli import main; sys.argv[0] = 'gapsweep'; main()"


def seconds(home: Path, *arguments: str) -> float:
    """Processor time of a fresh Python and all its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", *arguments],
        env={"HOME": str(home), "PATH": os.environ["PATH"], "PYTHONPATH": str(SHIPPED.parents[1])},
        cwd=home,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(home: Path) -> str:
    script = seconds(home, SCRIPT)
    study = seconds(home, RUN, "run", str(ROOT / "workflows" / "quick.toml"), "--out", "out")
    for left in (*(home / "out").rglob("*"), *(home / "data").rglob("*")):
        left.unlink() if left.is_file() else None
    return f"quick.toml {study:.1f} s, a script {script:.1f} s"


def main() -> None:
    if not SHIPPED.is_dir():
        sys.exit(f"{SHIPPED}: make it first: python tools/machine_code.py x86-64-v3")
    with tempfile.TemporaryDirectory() as folder:
        shipped, bare = (Path(folder) / name for name in ("shipped", "bare"))
        shipped.mkdir(), bare.mkdir()
        print("shipped:    ", measured(shipped))
        away = SHIPPED.rename(SHIPPED.with_name("machine_code_away"))
        try:
            print("on the spot:", measured(bare))
            print("warm:       ", measured(bare))
        finally:
            away.rename(SHIPPED)


if __name__ == "__main__":
    main()
