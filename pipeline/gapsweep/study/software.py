"""Versions of the software, which two processes must share to compute the same numbers."""

import platform
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version

from gapsweep.model.labels import Representation
from gapsweep.user_code.package_digest import data_fingerprint

LIBRARIES = ("numba", "llvmlite", "numpy", "scipy")


def software() -> Mapping[str, str]:
    """Return the digest of the sources that compute and store results, and `versions`."""
    return {"gapsweep": data_fingerprint(), **versions()}


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of Python (major and minor) and of the numerical libraries."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python, **{name: version(name) for name in LIBRARIES}}


def deciding(laws: Iterable[Representation], engine: str) -> tuple[str, ...]:
    """Return the libraries that determine a result: a new version of one may change numbers.

    They compile the compiled engine, are the solver of the reference engine, fit laws, and
    interpolate a user's table. numpy's arithmetic is in all of them, but equal in all versions up
    to rounding: an upgrade of numpy is recorded, and results need not be recomputed.
    """
    is_made = any(law.is_fitted or law.is_own for law in laws)
    making = ("numpy", "scipy") if is_made else ()
    solving = ("numba", "llvmlite") if engine == "compiled" else ("scipy",)
    return tuple(dict.fromkeys((*making, *solving)))
