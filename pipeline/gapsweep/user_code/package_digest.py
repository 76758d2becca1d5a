"""Digests of gapsweep's source: of the numerics, of the code for datasets, of the whole package.

The digest of the numerics is part of every cache key, so that results of other code are never
reused. The digests are SHA-256 of the source files' bytes; comments count. This
process computes the digest of the numerics when it imports this module, the others at first use.
"""

import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
# Files and folders that affect the response of a sweep point.
NUMERICS = (
    *("status.py", "model", "integrate", "response"),
    *("study/points.py", "execution/task.py", "execution/sweeps.py"),
)
# Folders that affect no dataset.
DRAWING = ("report", "explorer", "cli")


@cache
def numerics_fingerprint() -> str:
    """SHA-256 (16 hex digits) of the source in `NUMERICS`."""
    return _digest(*(PACKAGE / name for name in NUMERICS))


@cache
def data_fingerprint() -> str:
    """SHA-256 (16 hex digits) of the package without the folders in `DRAWING`."""
    return _digest(*(path for path in PACKAGE.iterdir() if path.name not in DRAWING))


@cache
def package_fingerprint() -> str:
    """SHA-256 (16 hex digits) of the whole package, templates of the report included."""
    return _digest(PACKAGE)


def _digest(*places: Path) -> str:
    files = [f for p in places for f in (p.rglob("*") if p.is_dir() else [p])]
    digest = hashlib.sha256()
    for path in sorted(files):
        if path.suffix == ".py" or path.parent.name == "templates":
            digest.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0")
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


numerics_fingerprint()  # at import, before the engines are imported
