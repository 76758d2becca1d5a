"""Print the kernels that are compiled for this code: their number, and the layouts.

    export NUMBA_CACHE_DIR=$(mktemp -d)
    python -m pytest && python tools/kernels.py

A kernel is the stepping loop for one `RowLayout` and method. Kernels with users' functions are not
kept on disk, and not counted.
"""

import pickle  # machine code that this user's processes wrote
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from gapsweep.integrate import (
    compiled,  # noqa: F401  defines the types that the files name
    jit,
)


def kernels(folder):
    """Layouts of the kernels in a folder, with the names of their methods."""
    for file in sorted(Path(folder).glob("*loop._advance-*.code")):
        parts = pickle.loads(file.read_bytes()[jit.CHECKSUM :])
        (args,) = (each.args for each in parts if type(each).__name__ == "Signature")
        state = args[1]
        method = state.types[state.fields.index("method")].instance_class.__name__
        yield {"method": method, **asdict(args[0].layout)}


def main(folder):
    found = list(kernels(folder))
    print(f"{len(found)} kernels in {folder}")
    for name in found[0] if found else ():
        counts = Counter(each[name] for each in found)
        others = {tuple(v for k, v in each.items() if k != name) for each in found}
        values = ", ".join(f"{value}: {n}" for value, n in sorted(counts.items()))
        print(f"{name:12s} without it {len(others):3d}   {values}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else jit.code_folder())
