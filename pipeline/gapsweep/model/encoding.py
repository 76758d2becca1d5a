"""Values in memory as digests: alike in every process and on every machine, or refused.

Everything is written with its type in front, so that no two values that can be told apart are
written alike. What is plain data is written out, functions as their instructions and all that they
have taken along, other objects as they would be copied. Of the standard library and of installed
packages names suffice. Ids, addresses and hash order are never written.
"""

import dis
import functools
import hashlib
import re
import struct
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path, PurePath
from types import (
    BuiltinFunctionType,
    CellType,
    ClassMethodDescriptorType,
    CodeType,
    FunctionType,
    GetSetDescriptorType,
    MappingProxyType,
    MemberDescriptorType,
    MethodDescriptorType,
    MethodType,
    ModuleType,
    UnionType,
    WrapperDescriptorType,
)
from typing import Any

import numpy as np

# Where they stand, what they say to readers, and what Python notes down for itself.
_OF_EVERY_CLASS = {
    "__dict__", "__weakref__", "__doc__", "__module__", "__firstlineno__",
    "__static_attributes__", "__annotations_cache__", "_abc_impl",
}  # fmt: skip
_HAS_DOCSTRING = 0x4000000  # a flag of code objects since Python 3.13
_MADE_AT_RUN_TIME = 1 << 9  # a flag of classes; those without are part of an interpreter or library
_LRU_CACHE = type(functools.lru_cache(len))
_OF_CLASSES = {
    ClassMethodDescriptorType,
    GetSetDescriptorType,
    MemberDescriptorType,
    MethodDescriptorType,
    WrapperDescriptorType,
}


class UnkeyableError(TypeError):
    """A value that no digest can stand for; the message names its type."""


class Encoder:
    """Writes one value into a digest.

    Parameters
    ----------
    file : Path
        Of the module that holds the value. Paths above and below it are written relative to it.
    followed : collection of str
        Modules whose variables stand in the key themselves.
    is_foreign : callable
        Whether a module belongs to Python or to an installed package.
    """

    def __init__(
        self, file: Path, followed: Collection[str], is_foreign: Callable[[str], bool]
    ) -> None:
        self._folders = [str(each) for each in file.parents if each != each.parent]
        self._followed = followed
        self._is_foreign = is_foreign
        self._hash = hashlib.sha256()
        # By id, in the order in which they were met; kept, or another might get the same id.
        self._seen: dict[int, tuple[int, Any]] = {}

    def digest(self, value: Any) -> bytes:
        """SHA-256 of a value.

        Raises
        ------
        UnkeyableError
            If something in it cannot be written.
        """
        self._write(value)
        return self._hash.digest()

    def _put(self, tag: str, content: bytes = b"") -> None:
        # With its length, or ("a", "b") could be written as ("ab",) is.
        self._hash.update(f"{tag} {len(content)}:".encode())
        self._hash.update(content)

    def _write(self, value: Any) -> None:
        kind = type(value)
        if kind in _ATOMS:
            self._put(kind.__name__, _ATOMS[kind](value))
        elif kind is str:
            self._text(value)
        elif kind is tuple:  # whether equal ones are one object is for the compiler to choose
            self._all("tuple", value)
        elif id(value) in self._seen:
            self._put("again", str(self._seen[id(value)][0]).encode())
        else:
            self._seen[id(value)] = len(self._seen), value
            self._compound(kind, value)

    def _compound(self, kind: type, value: Any) -> None:
        if kind is list:
            self._all("list", value)
        elif kind is dict:
            self._mapping("dict", value)
        elif kind in _PARTS:
            self._all(kind.__name__, _PARTS[kind](value))
        elif issubclass(kind, set | frozenset):
            self._set(kind, value)
        elif issubclass(kind, type):
            self._class(value)
        elif issubclass(kind, ModuleType):
            self._module(value)
        elif kind is FunctionType:
            self._function(value)
        elif kind in _OF_CLASSES:
            self._all(kind.__name__, [value.__objclass__, value.__name__])
        elif issubclass(kind, PurePath):
            self._all("path", [kind, str(value)])
        elif kind is np.ufunc:
            self._ufunc(value)
        elif kind.__module__.startswith("numba."):
            self._of_numba(kind, value)
        elif kind is BuiltinFunctionType and isinstance(value.__self__, ModuleType | None):
            self._builtin(value)
        else:
            self._object(kind, value)

    # --- data -----------------------------------------------------------------------------------

    def _text(self, text: str) -> None:
        """A text; a path to or near the module's own file tells how it lies to that."""
        for n, folder in enumerate(self._folders):
            if text == folder or text.startswith((folder + "/", folder + "\\")):
                self._put(f"below folder {n}", _utf8(text[len(folder) :]))
                return
        self._put("str", _utf8(text))

    def _all(self, tag: str, values: Iterable[Any]) -> None:
        values = list(values)
        self._put(tag, str(len(values)).encode())
        for each in values:
            self._write(each)

    def _mapping(self, tag: str, values: Mapping[Any, Any]) -> None:
        self._all(tag, (part for item in values.items() for part in item))

    def _set(self, kind: type, values: Any) -> None:
        """Sorted by digests: the order in memory is another in every process."""
        base: Any = frozenset if issubclass(kind, frozenset) else set
        whole, n_seen, digests = self._hash, len(self._seen), []
        for each in base.__iter__(values):
            self._hash = hashlib.sha256()
            self._write(each)
            digests.append(self._hash.digest())
            while len(self._seen) > n_seen:  # every element as if it were the first
                self._seen.popitem()
        self._hash = whole
        self._put(base.__name__, b"".join(sorted(digests)))
        if kind is not base:
            self._write(kind)
            self._attributes(kind, values)

    # --- code -----------------------------------------------------------------------------------

    def _module(self, module: ModuleType) -> None:
        name = module.__name__
        if name not in self._followed and not self._is_foreign(name):
            raise UnkeyableError(f"the module {name}, which no import statement leads to")
        self._put("module", name.encode())

    def _function(self, function: FunctionType) -> None:
        if self._by_name("function", function):
            return
        self._all("function", [function.__module__, function.__qualname__])
        self._write(function.__code__)
        self._all("called with", [function.__defaults__, function.__kwdefaults__])
        self._all("closure", function.__closure__ or ())
        self._all("notes", [function.__dict__, function.__annotations__])
        names = function.__globals__
        module = names.get("__name__")
        if (
            isinstance(module, str)
            and names is getattr(sys.modules.get(module), "__dict__", None)
            and (module in self._followed or self._is_foreign(module))
        ):
            return  # the variables of that module stand in the key themselves
        used = sorted(_names(function.__code__) & names.keys() - {"__builtins__"})
        self._mapping("globals", {name: names[name] for name in used})

    def _builtin(self, value: Any) -> None:
        module = value.__module__ or "builtins"
        if not self._is_foreign(module):
            raise UnkeyableError(f"a compiled function of {module}")
        self._all("builtin", [module, value.__qualname__])

    def _class(self, value: type) -> None:
        is_fixed = not value.__flags__ & _MADE_AT_RUN_TIME
        if is_fixed:
            self._all("class", [value.__module__, value.__qualname__])
        elif not self._by_name("class", value):
            self._all("own class", [value.__module__, value.__qualname__])
            self._all("bases", [type(value), *value.__bases__])
            own = {name: v for name, v in vars(value).items() if name not in _OF_EVERY_CLASS}
            self._mapping("variables", own)

    def _by_name(self, tag: str, value: Any) -> bool:
        """Write the name alone if an installed package has this very value under it."""
        module, name = value.__module__, value.__qualname__
        if not isinstance(module, str) or not self._is_foreign(module):
            return False
        found = sys.modules.get(module)
        for part in name.split("."):
            found = getattr(found, part, None)
        if found is value:
            self._all(tag, [module, name])
        return found is value

    def _ufunc(self, value: np.ufunc) -> None:
        for module in ("numpy", "scipy.special"):
            if getattr(sys.modules.get(module), value.__name__, None) is value:
                self._all("ufunc", [module, value.__name__])
                return
        raise UnkeyableError(f"the ufunc {value.__name__!r}, which does not tell what it computes")

    def _of_numba(self, kind: type, value: Any) -> None:
        """Compiled functions as what they were compiled from; types have a name that says all."""
        function = getattr(value, "py_func", None) or getattr(value, "__wrapped__", None)
        if function is not None:
            options = getattr(value, "targetoptions", None)
            self._all("compiled", [kind.__qualname__, options, function])
        elif kind.__module__.startswith("numba.core.types"):
            # Copies hold numbers that numba gives to types in the order in which it meets them.
            self._all("numba type", [kind.__qualname__, value.name])
        else:
            self._object(kind, value)

    # --- anything else --------------------------------------------------------------------------

    def _object(self, kind: type, value: Any) -> None:
        """An object as it would be copied; one of the user's classes with all its attributes."""
        if (place := self._place(kind, value)) is not None:
            self._all("variable", place)
            return
        try:
            copied = value.__reduce_ex__(2)
        except UnkeyableError:
            raise
        except Exception:  # __reduce_ex__ of a user's class raises any type: it has no key then
            raise UnkeyableError(_type_name(kind)) from None
        self._all("object", [kind])
        if isinstance(copied, str):
            self._all("global", [getattr(value, "__module__", None), copied])
        else:
            self._all("copied by", copied[:3])
            for items in copied[3:5]:
                self._all("items", items or ())
        self._attributes(kind, value)

    def _place(self, kind: type, value: Any) -> tuple[str, str] | None:
        """Module and name of a variable of an installed package, as ``os.environ``."""
        if not self._is_foreign(kind.__module__) or kind.__module__ == "builtins":
            return None
        for module in (kind.__module__, "sys"):
            for name, found in list(vars(sys.modules[module]).items()):
                # `__stdout__` is the same as `stdout` unless somebody catches what is printed.
                if found is value and not name.startswith("__"):
                    return module, name
        return None

    def _attributes(self, kind: type, value: Any) -> None:
        """What a copy may leave out: an array's subclass, or one that says how to copy it."""
        if self._is_foreign(kind.__module__):
            return
        found = {}
        for each in kind.__mro__:
            for name, member in vars(each).items():
                if type(member) is MemberDescriptorType and not self._is_foreign(each.__module__):
                    found[f"{each.__qualname__}.{name}"] = _slot(member, value)
        self._mapping("slots", found)
        self._mapping("attributes", getattr(value, "__dict__", {}))


def _utf8(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


def _type_name(kind: type) -> str:
    return f"a {kind.__module__}.{kind.__qualname__}".replace("builtins.", "")


def _slot(member: Any, value: Any) -> Any:
    try:
        return [member.__get__(value)]
    except AttributeError:  # nothing assigned yet
        return []


def _cell(cell: CellType) -> list[Any]:
    try:
        return [cell.cell_contents]
    except ValueError:  # nothing assigned yet
        return []


def _instructions(code: CodeType) -> Iterator[Any]:
    """A code object without its file, lines and docstring.

    Constants stand with the instructions that load them: a docstring is loaded by none.
    """
    yield code.co_name
    yield code.co_flags & ~_HAS_DOCSTRING
    yield code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount
    yield code.co_varnames, code.co_cellvars, code.co_freevars
    yield code.co_exceptiontable
    for each in dis.get_instructions(code):
        yield each.opname
        yield each.argval


def _names(code: CodeType) -> set[str]:
    """What a function, or one inside it, may look up among its global variables."""
    inner = (_names(each) for each in code.co_consts if isinstance(each, CodeType))
    return set(code.co_names).union(*inner)


# As bytes: two floats that print alike differ, and no length of a number is too much.
_ATOMS: dict[type, Callable[[Any], bytes]] = {
    type(None): lambda value: b"",
    type(...): lambda value: b"",
    type(NotImplemented): lambda value: b"",
    bool: lambda value: str(value).encode(),
    int: lambda value: hex(value).encode(),
    float: lambda value: struct.pack("<d", value),
    complex: lambda value: struct.pack("<2d", value.real, value.imag),
    bytes: lambda value: value,
}

# What cannot be copied, or would be copied with what differs between processes.
_PARTS: dict[type, Callable[[Any], Iterable[Any]]] = {
    CellType: _cell,
    CodeType: _instructions,
    MethodType: lambda value: [value.__func__, value.__self__],
    MappingProxyType: lambda value: [dict(value)],
    UnionType: lambda value: value.__args__,
    classmethod: lambda value: [value.__func__],
    staticmethod: lambda value: [value.__func__],
    property: lambda value: [value.fget, value.fset, value.fdel],
    functools.cached_property: lambda value: [value.func, value.attrname],
    _LRU_CACHE: lambda value: [vars(value)],
    re.Pattern: lambda value: [value.pattern, value.flags],
}
