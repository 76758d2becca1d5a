"""The software that computes: what two processes must have in common to give the same numbers."""

import platform
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version

from gapsweep.model.labels import is_fitted
from gapsweep.user_code.package_digest import data_fingerprint

LIBRARIES = ("numba", "llvmlite", "numpy", "scipy")


def software() -> Mapping[str, str]:
    """Digest of the sources that compute and store results, and `versions`, of this process."""
    return {"gapsweep": data_fingerprint(), **versions()}


@cache
def versions() -> Mapping[str, str]:
    """Versions of Python, without its last number, and of the libraries that compute."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python, **{name: version(name) for name in LIBRARIES}}


def deciding(labels: Iterable[str], engine: str) -> tuple[str, ...]:
    """The libraries that decide a result: a new version of one may give other numbers.

    What writes the machine code of the compiled engine, the solver of the other one, the searches
    by which laws are fitted, and the curve through a user's table. numpy's arithmetic is in all of
    them, but the same in all versions up to rounding: an upgrade of it is recorded and asks for no
    new numbers.
    """
    is_made = any(is_fitted(label) or ":" in label for label in labels)
    making = ("numpy", "scipy") if is_made else ()
    solving = ("numba", "llvmlite") if engine == "compiled" else ("scipy",)
    return tuple(dict.fromkeys((*making, *solving)))
