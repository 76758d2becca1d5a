"""A user's own law, ``module:name``: a function or a force table, and the code behind it.

The code is what cache keys hold and what a worker must have. It is the sources of the module and
of all modules of the user's that it imports, at any depth; versions stand in for what is installed.
Numbers may reach a module from outside as well (a table, the environment), so the values of its
variables count too, as they are when it has just been imported.

The files decide, not what this process happens to have in memory: for every study a law is imported
anew, with all of these modules, and what Python then has loaded must be what was read.
"""

import functools
import importlib
import importlib.metadata
import importlib.util
import json
import os
import pkgutil
import sys
import sysconfig
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

from gapsweep.errors import ClusterError, ModelError, described
from gapsweep.model.encoding import Encoder, UnkeyableError
from gapsweep.source import read, short_digest, with_parents

_STANDARD = Path(sysconfig.get_path("stdlib"))
_INSTALLED = {"site-packages", "dist-packages"}
_OURS = "gapsweep"  # stands in every key by a fingerprint of its own
# What Python puts into modules: where they stand, and what they say to readers.
_OF_EVERY_MODULE = {
    "__name__", "__doc__", "__package__", "__loader__", "__spec__", "__path__", "__file__",
    "__cached__", "__builtins__", "__warningregistry__",
}  # fmt: skip


@dataclass(frozen=True)
class _Sources:
    """What the import statements of a module lead to.

    Attributes
    ----------
    package : str
        The law's own, followed by its files also where it is installed.
    files : dict of str to Path
        The user's modules.
    digests : dict of str to str
        Of what these files say.
    installed : dict of str to str
        Versions of the installed packages that they import.
    absent : set of str
        What is not to be found, as it may be under an ``except ImportError``.
    """

    package: str
    files: dict[str, Path] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    installed: dict[str, str] = field(default_factory=dict)
    absent: set[str] = field(default_factory=set)


# The code of what was imported, by module.
_loaded: dict[str, str] = {}
_lock = threading.RLock()

# What is said of a module that cannot be imported.
OF_LAWS = "the module must be importable here and on every worker"


def code(label: str) -> str:
    """All that a law computes with, as a JSON object: digests by module, versions by package.

    Parameters
    ----------
    label : str
        ``"module:name"``.

    Raises
    ------
    ModelError
        If the module cannot be imported, or something in it cannot be keyed.
    """
    module = label.partition(":")[0]
    with _lock:
        if module not in _loaded:
            _loaded[module] = json.dumps(_load(label), sort_keys=True, separators=(",", ":"))
        return _loaded[module]


def named(label: str) -> Any:
    """What a label names, of that code: a function, or a force table."""
    with _lock:
        code(label)
        module, _, name = label.partition(":")
        try:
            return getattr(sys.modules[module], name)
        except (AttributeError, KeyError) as error:  # not in its module, or that was taken away
            raise _unusable(label, error) from None


def refresh() -> None:
    """Import all laws anew when they are asked for next: files, and what they read, may differ."""
    with _lock:
        _loaded.clear()


def require(label: str, wanted: str) -> None:
    """Have a law of this code, imported anew if need be.

    Raises
    ------
    ClusterError
        If the files here hold another one, or if no two imports give the same; the message
        names what differs.
    """
    try:
        if code(label) == wanted:
            return
        with _lock:
            _loaded.pop(label.partition(":")[0], None)
        here, there = json.loads(code(label)), json.loads(wanted)
        unstable = _unstable(label) if here != there else []
    except ModelError as error:  # the client could use it
        raise ClusterError(
            f"a worker cannot use the law {error}, as after client.upload_file('law.py')"
        ) from None
    if unstable:
        raise ClusterError(
            f"{label!r}: {', '.join(unstable)} is another at every import: make it a constant, or "
            "keep it inside a function"
        )
    if here != there:
        differing = {n.split()[0] for n in {**here, **there} if here.get(n) != there.get(n)}
        raise ClusterError(
            f"{label!r}: {', '.join(sorted(differing))} differ between client and worker, or were "
            "edited during the run: make them the same on both sides and run again"
        )


def _unstable(label: str) -> list[str]:
    """Variables that no two imports agree upon, as a time or a random number."""
    with _lock:
        first, second = _variables(label), _variables(label)
    return sorted(name for name in {**first, **second} if first.get(name) != second.get(name))


def _unusable(label: str, error: BaseException | str) -> ModelError:
    return ModelError(f"{label!r}: {error}; {OF_LAWS}")


def _load(label: str) -> dict[str, str]:
    """The code of a law, imported anew: digests of files and of values in memory, versions."""
    sources = _imported(label)
    values = {
        f"{name} (values)": short_digest(json.dumps(found, sort_keys=True).encode())
        for name in sources.files
        if (found := _values(label, name, sources))
    }
    return sources.digests | sources.installed | values


def _variables(label: str) -> dict[str, str]:
    """Digests of all variables, by module and name, of the modules imported anew."""
    sources = _imported(label)
    return {
        f"{name}.{variable}": digest
        for name in sources.files
        for variable, digest in _values(label, name, sources).items()
    }


def _imported(label: str) -> _Sources:
    """Import a module, and all of the user's that it imports, from the files as they are now."""
    module = label.partition(":")[0]
    sources = _sources(module)
    if module not in sources.files:
        reason = f"No module named {module!r}" if module in sources.absent else "no file of yours"
        raise _unusable(label, reason)
    try:
        with _compiled_apart(sources), _imported_anew(sources):
            try:
                importlib.import_module(module)
            except ModelError as error:  # of a table in it, say
                raise ModelError(f"{label!r}: {error}") from None
            for name in sources.files:
                # What only a function imports has values, too.
                with suppress(Exception):  # what the user's code raises here, the function raises
                    importlib.import_module(name)
                _check(label, name, sources)
    except (ModelError, KeyboardInterrupt):
        raise
    except ImportError as error:
        raise _unusable(label, error) from None
    except BaseException as error:  # the user's code may raise anything, SystemExit too
        raise _unusable(label, f"importing it raised {described(error)}") from None
    for name, path in sources.files.items():
        if name not in sys.modules:
            _forget_byte_code(path)
    if _sources(module) != sources:
        raise ModelError(f"{label!r}: edited while it was imported; run again")
    return sources


# --- files --------------------------------------------------------------------------------------


def _sources(module: str) -> _Sources:
    """Follow the import statements of a module, without running anything."""
    importlib.invalidate_caches()
    found = _Sources(module.partition(".")[0])
    folders: dict[str, Sequence[str]] = {}
    waiting, seen = [module], {_OURS}
    while waiting:
        for name in with_parents(waiting.pop()):
            if name not in seen:
                seen.add(name)
                waiting += _follow(name, found, folders)
    return found


def _follow(name: str, found: _Sources, folders: dict[str, Sequence[str]]) -> Sequence[str]:
    """Add a module to what was found; what it imports, if it is a file of the user's.

    `folders` are those in which the modules of a package lie, of the user's packages alone.
    """
    parent = name.rpartition(".")[0]
    if parent and parent not in folders:
        return ()
    spec = _spec(name, folders.get(parent))
    if spec is None:
        # Within a package it may be any variable.
        found.absent.update(() if parent else (name,))
        return ()
    if spec.origin is None:  # a folder without __init__.py
        folders[name] = list(spec.submodule_search_locations or ())
        return ()
    path = Path(spec.origin)
    if not spec.has_location or _is_standard(path):
        return ()
    package = name.partition(".")[0]
    is_foreign = _is_installed(path) and package != found.package
    if is_foreign and (version := _version(package)) is not None:
        found.installed[package] = version
        return ()
    try:
        if path.suffix != ".py":
            raise ValueError("must be a .py file, or of an installed package")
        source = read(path, name)
    except (OSError, SyntaxError, ValueError) as error:
        raise ModelError(f"{path}: cannot be keyed: {error}") from None
    found.files[name], found.digests[name] = path, source.digest
    if spec.submodule_search_locations is not None:
        folders[name] = spec.submodule_search_locations
    return source.imports


def _spec(name: str, folders: Sequence[str] | None) -> ModuleSpec | None:
    """Where Python would import a module from; `importlib.util.find_spec` runs its packages."""
    if folders is None:
        found = (finder.find_spec(name, None) for finder in sys.meta_path)
        return next((spec for spec in found if spec is not None), None)
    without_file = ModuleSpec(name, None, is_package=True)
    for folder in folders:
        in_folder = pkgutil.get_importer(folder)
        spec = in_folder.find_spec(name) if in_folder is not None else None
        if spec is not None and spec.loader is not None:
            return spec
        if spec is not None and without_file.submodule_search_locations is not None:
            without_file.submodule_search_locations += spec.submodule_search_locations or ()
    return without_file if without_file.submodule_search_locations else None


def _is_installed(path: Path) -> bool:
    return not _INSTALLED.isdisjoint(path.parts)


def _is_standard(path: Path) -> bool:
    return _STANDARD in path.parents and not _is_installed(path)


@functools.cache
def _version(package: str) -> str | None:
    """Version of what an installed package comes with; None if nobody says."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        names = importlib.metadata.packages_distributions().get(package, [])
        return " ".join(map(importlib.metadata.version, sorted(set(names)))) or None


# --- memory -------------------------------------------------------------------------------------


@contextmanager
def _imported_anew(sources: _Sources) -> Iterator[None]:
    """Imports in this block run the user's modules again, from their files."""
    # With the folders that they lie in, which need no file to be packages.
    names = {each for name in sources.files for each in with_parents(name)}
    old = {name: sys.modules.pop(name) for name in names if name in sys.modules}
    settings = sys.pycache_prefix, sys.dont_write_bytecode
    # Byte code is recognised by the second and the size: it may be that of a file edited since.
    sys.pycache_prefix, sys.dont_write_bytecode = os.devnull, True
    try:
        yield
    except BaseException:
        sys.modules.update(old)
        raise
    finally:
        sys.pycache_prefix, sys.dont_write_bytecode = settings
        for name, module in old.items():
            _keep_submodules(module, sys.modules.get(name, module))


def _forget_byte_code(path: Path) -> None:
    """Have a module read from its file that is imported when a function of the law is called."""
    with suppress(OSError, NotImplementedError):  # who may not delete it could not write it either
        Path(importlib.util.cache_from_source(str(path))).unlink()


def _keep_submodules(old: ModuleType, new: ModuleType) -> None:
    """``import a.b`` sets `b` in `a` once; what was not imported again must still be there."""
    for name, value in vars(old).items():
        if _is_submodule(old, name) and not hasattr(new, name):
            setattr(new, name, value)


def _is_submodule(module: ModuleType, name: str) -> bool:
    key = f"{module.__name__}.{name}"
    return key in sys.modules and vars(module)[name] is sys.modules[key]


@contextmanager
def _compiled_apart(sources: _Sources) -> Iterator[None]:
    """What numba keeps on disk of functions imported in this block is found by no other process.

    It would load old machine code after an edit of a helper, or of a number, in another file.
    """
    if "numba" not in sources.installed:
        yield
        return
    from numba import config  # most laws need none, and it takes a second

    users_choice = config.CACHE_DIR
    config.CACHE_DIR = tempfile.mkdtemp(dir=_scratch().name)
    try:
        yield
    finally:
        config.CACHE_DIR = users_choice


@functools.cache
def _scratch() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="gapsweep-laws-")


def _check(label: str, name: str, sources: _Sources) -> None:
    """Refuse a module whose contents come from where no import statement led."""
    module = sys.modules.get(name)
    if module is None:  # imported by a function that nobody has called
        return
    loaded = [(name, module)]
    for value in vars(module).values():
        is_module = issubclass(type(value), ModuleType)
        origin = value.__name__ if is_module else _module_of(value)
        if origin in sys.modules:
            loaded.append((origin, sys.modules[origin]))
    for origin, each in loaded:
        path = Path(getattr(each, "__file__", None) or _STANDARD / "built-in")
        is_followed = path == sources.files.get(origin, path) and (
            origin in sources.files
            or origin.partition(".")[0] == _OURS
            or _is_standard(path)
            or _is_installed(path)
        )
        if not is_followed:
            raise ModelError(
                f"{label!r}: {name} uses {origin} ({path}), which no import statement leads to, "
                "so it cannot be keyed: import it by its name, from a folder in PYTHONPATH"
            )


def _module_of(value: Any) -> str:
    try:
        name = getattr(value, "__module__", None)
    except Exception:  # __getattr__ of a user's class raises any type: it names no module
        return ""
    return name if isinstance(name, str) else ""


def _values(label: str, name: str, sources: _Sources) -> dict[str, str]:
    """Digests of a module's variables; none if a function imports it that nobody has called."""
    module = sys.modules.get(name)
    if module is None:
        return {}
    found = {}
    for variable, value in vars(module).items():
        # Which of its modules a package has loaded, others decide as well.
        if variable not in _OF_EVERY_MODULE and not _is_submodule(module, variable):
            found[variable] = _value(f"{label!r}: {name}.{variable}", value, name, sources)
    return found


def _value(where: str, value: Any, name: str, sources: _Sources) -> str:
    """Digest of one variable; what has none is refused."""
    is_foreign = functools.partial(_is_foreign, sources)
    try:
        return Encoder(sources.files[name], sources.files, is_foreign).digest(value).hex()
    except UnkeyableError as error:
        reason = str(error)
    except Exception as error:  # methods of a user's class raise any type: refused by name
        reason = f"a {type(value).__qualname__}: {type(error).__name__}"
    raise ModelError(f"{where} cannot be keyed: {reason}: keep it inside a function")


def _is_foreign(sources: _Sources, name: str) -> bool:
    """Whether a module is of Python, of an installed package or of gapsweep: its name suffices."""
    if name in sources.files or name not in sys.modules:
        return False
    path = getattr(sys.modules[name], "__file__", None)
    if name.partition(".")[0] == _OURS:
        return True
    return name != "__main__" and (
        path is None or _is_standard(Path(path)) or _is_installed(Path(path))
    )
