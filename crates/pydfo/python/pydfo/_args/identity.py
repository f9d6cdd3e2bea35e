"""What a Python function computes, as a hash: its code, and the values that it refers to."""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import struct
import sys
import sysconfig
import types
import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np

#: Folders of what is installed: a function from there is known by its name.
_INSTALLED = tuple(os.path.realpath(sysconfig.get_path(name)) + os.sep for name in ("stdlib", "platstdlib", "purelib", "platlib"))


class _Unknown(Exception):
    """A value that cannot be told from others."""


def of_code(function: Any, *args: Any) -> tuple[str, bool]:
    """The hash of a function and of what it is called with, and True; or why there is none, and False.

    Code is what the interpreter runs, constants and names included; closures, defaults, global variables that it names and functions that
    it calls belong to it, but for those of installed modules, which are known by their names. Behind the hash stand checksums of what has
    a name, so that a message can say which of them is another.
    """
    walk = _Walk()
    try:
        walk.value(function)
        for values in args:
            walk.part("args", values)
        walk.close("")
    except _Unknown as e:
        return f"it refers to {e}", False
    except RecursionError:
        return "it refers to values nested too deeply", False
    return "; ".join([walk.hash.hexdigest(), *(f"{name} = {checksum:x}" for name, checksum in walk.parts.items())]), True


class _Walk:
    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        # By name; what a part refers to by another name is a part of its own.
        self.parts: dict[str, int] = {}
        self._checksum = 0
        self._seen: dict[int, int] = {}
        # What has been seen stays alive, so that no other object gets its number.
        self._kept: list[Any] = []

    def mark(self, kind: str, data: bytes | str = b"") -> None:
        data = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
        for text in (f"{kind} {len(data)}:".encode(), data):
            self.hash.update(text)
            self._checksum = zlib.crc32(text, self._checksum)

    def close(self, name: str) -> None:
        """What came since the last part is one of this name, or the rest of it."""
        self.parts[name] = zlib.crc32(self._checksum.to_bytes(4, "big"), self.parts.get(name, 0))
        self._checksum = 0

    def all(self, kind: str, values: Iterable[Any]) -> None:
        values = list(values)
        self.mark(kind, str(len(values)))
        for value in values:
            self.value(value)

    def value(self, value: Any) -> None:
        if value is None or value is Ellipsis or isinstance(value, (bool, int, str)):
            self.mark(type(value).__name__, repr(value))
        elif isinstance(value, (float, complex)):
            number = complex(value)
            self.mark(type(value).__name__, struct.pack("<dd", number.real, number.imag))
        elif isinstance(value, (bytes, bytearray)):
            self.mark("bytes", bytes(value))
        elif isinstance(value, types.CodeType):
            self._code(value)
        elif (place := self._seen.get(id(value))) is not None:
            # Where it was seen depends on all that came before, which a part says nothing of.
            checksum = self._checksum
            self.mark("seen", str(place))
            self._checksum = zlib.crc32(b"seen", checksum)
        else:
            self._seen[id(value)] = len(self._seen)
            self._kept.append(value)
            self._object(value)

    def _object(self, value: Any) -> None:
        if isinstance(value, (tuple, list)):
            self.all(type(value).__name__, value)
        elif isinstance(value, (set, frozenset)):
            self.all("set", sorted(value, key=repr))
        elif isinstance(value, dict):
            self.all("dict", [part for item in value.items() for part in item])
        elif isinstance(value, (np.ndarray, np.generic)) and value.dtype != object:
            self.mark("array", f"{value.dtype.str} {value.shape}")
            self.mark("data", np.ascontiguousarray(value).tobytes())
        elif isinstance(value, types.ModuleType):
            self.mark("module", value.__name__)
        elif isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, types.MethodType):
            self.all("method", (value.__func__, value.__self__))
        elif isinstance(value, functools.partial):
            self.all("partial", (value.func, value.args, value.keywords))
        elif isinstance(value, (staticmethod, classmethod)):
            self.value(value.__func__)
        elif isinstance(value, property):
            self.all("property", (value.fget, value.fset, value.fdel))
        elif isinstance(value, (types.BuiltinFunctionType, np.ufunc)) and isinstance(
            getattr(value, "__self__", None), (types.ModuleType, type(None))
        ):
            self.mark("builtin", f"{getattr(value, '__module__', None)}.{value.__name__}")
        elif isinstance(value, type):
            self._class(value)
        else:
            self._instance(value)

    def _code(self, code: types.CodeType) -> None:
        self.mark("code", code.co_code)
        # The name in the code of a class body or of a lambda says nothing of what it does; a docstring neither, but it is a constant.
        self.all("arguments", (code.co_argcount, code.co_kwonlyargcount, code.co_posonlyargcount, code.co_flags))
        self.all("names", (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars))
        self.all("constants", code.co_consts)

    def _function(self, function: types.FunctionType) -> None:
        if _is_installed(function):
            self.mark("function", f"{function.__module__}.{function.__qualname__}")
            return
        self._code(function.__code__)
        self.all("defaults", (function.__defaults__, function.__kwdefaults__))
        if isinstance(wrapped := getattr(function, "__wrapped__", None), types.FunctionType):
            self.value(wrapped)
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or ()):
            try:
                self._named(name, cell.cell_contents)
            except ValueError:
                self.mark("empty cell", name)
        names = _names(function.__code__)
        for name in names:
            if name not in function.__globals__:
                continue
            value = function.__globals__[name]
            self._named(name, value)
            if isinstance(value, types.ModuleType) and not _is_installed_file(getattr(value, "__file__", None)):
                for attribute in names:
                    if attribute in vars(value):
                        self._named(f"{name}.{attribute}", vars(value)[attribute])

    def _named(self, name: str, value: Any, of: str = "") -> None:
        self.mark("name", name)
        try:
            self.part(of + name, value)
        except _Unknown as e:
            raise _Unknown(str(e) if " " in str(e) else f"'{name}', an object of type {e}") from None

    def part(self, name: str, value: Any) -> None:
        """A value that has a checksum of its own."""
        around, self._checksum = self._checksum, 0
        self.value(value)
        self.close(name)
        self._checksum = around

    def _attributes(self, kind: type, state: dict[str, Any]) -> None:
        """The attributes of an object, each a part; a dictionary that has been seen already is one part."""
        if id(state) in self._seen:
            self.value(state)
            return
        self._seen[id(state)] = len(self._seen)
        self._kept.append(state)
        self.mark("dict", str(2 * len(state)))
        for name, value in state.items():
            self.value(name)
            self.part(f"{kind.__qualname__}.{name}", value)

    def _class(self, kind: type) -> None:
        self.mark("class", f"{kind.__module__}.{kind.__qualname__}")
        if _is_installed(kind):
            return
        self.all("bases", kind.__bases__)
        for name, value in vars(kind).items():
            if isinstance(value, (types.FunctionType, staticmethod, classmethod, property, int, float, str, tuple)):
                if name not in ("__module__", "__qualname__", "__doc__", "__firstlineno__"):
                    self._named(name, value, f"{kind.__qualname__}.")

    def _instance(self, value: Any) -> None:
        self._class(type(value))
        state = getattr(value, "__dict__", None)
        if not _is_installed(type(value)) and isinstance(state, dict):
            self._attributes(type(value), state)
            return
        try:
            self.mark("state", pickle.dumps(value, 4))
        except Exception:
            raise _Unknown(type(value).__name__) from None


def _names(code: types.CodeType) -> list[str]:
    """Names of globals and attributes in code and in the functions inside of it, each once."""
    names = dict.fromkeys(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names.update(dict.fromkeys(_names(constant)))
    return list(names)


def _is_installed(value: Any) -> bool:
    """Whether a function or class comes with Python or from an installed module."""
    if isinstance(value, types.FunctionType):
        return _is_installed_file(value.__code__.co_filename)
    module = sys.modules.get(value.__module__)
    if module is None or value.__module__ == "__main__":
        return False
    # What is built in has no file.
    file = getattr(module, "__file__", None)
    return file is None or _is_installed_file(file)


def _is_installed_file(file: str | None) -> bool:
    return file is not None and (
        file.startswith("<frozen") or os.path.realpath(file).startswith((*_INSTALLED, os.path.dirname(os.path.dirname(os.path.realpath(__file__))) + os.sep))
    )
