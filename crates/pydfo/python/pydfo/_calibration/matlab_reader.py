"""Reads MATLAB files as a program in a separate process, because a damaged file can crash its reader.

`data_files` starts it with the path as its argument and a request on standard input. It imports nothing from the
package.
"""

from __future__ import annotations

import io
import json
import math
import sys
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np

#: Exit code after an exception of a reader; the message is on standard error.
REFUSED = 3

#: The numeric classes of MATLAB.
_NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


def _numeric(name: str, value: Any) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Yields the numeric arrays in a variable read by SciPy; fields of structs are named ``struct.field``."""
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            yield from _numeric(f"{name}.{field}", value.reshape(-1)[0][field])
    elif value.dtype.kind in "fiub":
        yield name, value


def _load(path: str, names: list[str]) -> dict[str, np.ndarray[Any, Any]]:
    """Returns the numeric arrays of variables of a file before version 7.3."""
    read = import_module("scipy.io").loadmat(path, variable_names=names, squeeze_me=False, struct_as_record=True, chars_as_strings=True)
    return {full: array for name in names for full, array in _numeric(name, read[name])}


def _listed(path: str, wanted: list[str], most: int) -> tuple[dict[str, tuple[int, ...]], list[str]]:
    """Returns the shapes of the numeric variables before version 7.3 and the names of the other variables.

    Only wanted structs are included. They are read for this, if they claim at most `most` elements.
    """
    found: dict[str, tuple[int, ...]] = {}
    others = []
    for name, shape, kind in import_module("scipy.io").whosmat(path):
        if kind in _NUMERIC:
            found[name] = shape
        elif kind == "struct" and any(one.startswith(f"{name}.") for one in wanted) and math.prod(shape) <= most:
            found.update((field, array.shape) for field, array in _load(path, [name]).items())
        elif kind == "struct":
            others.append(f"{name} (a struct: {name}.field)")
    return found, others


def _datasets(group: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the numeric arrays of a file of version 7.3; fields of structs are named ``struct.field``."""
    for name, value in group.items():
        if name.startswith("#"):
            continue
        if hasattr(value, "items"):
            yield from _datasets(value, f"{prefix}{name}.")
        elif value.dtype.kind in "fiub" and value.attrs.get("MATLAB_class") != b"char" and "MATLAB_empty" not in value.attrs:
            yield prefix + name, value


def _listed_of_hdf5(path: str) -> tuple[dict[str, tuple[int, ...]], list[str]]:
    """Returns shapes and names for a file of version 7.3, which stores arrays column by column."""
    with import_module("h5py").File(path, "r") as file:
        return {name: tuple(reversed(stored.shape)) for name, stored in _datasets(file)}, []


def _load_of_hdf5(path: str, names: list[str]) -> dict[str, np.ndarray[Any, Any]]:
    with import_module("h5py").File(path, "r") as file:
        stored = dict(_datasets(file))
        return {name: stored[name][()].T for name in names}


def answer(path: str, request: dict[str, Any]) -> bytes:
    """Returns the answer to a request: the list of variables as JSON, or consecutive arrays in NumPy's format."""
    is_hdf5 = request["is_hdf5"]
    if (names := request.get("names")) is None:
        variables, others = _listed_of_hdf5(path) if is_hdf5 else _listed(path, request["wanted"], request["most"])
        return json.dumps({"variables": variables, "others": others}).encode()
    # A struct is read with all its fields. Names of variables do not contain dots.
    arrays = _load_of_hdf5(path, names) if is_hdf5 else _load(path, list({name.partition(".")[0] for name in names}))
    out = io.BytesIO()
    for name in names:
        np.save(out, arrays[name], allow_pickle=False)
    return out.getvalue()


def _main() -> None:
    try:
        result = answer(sys.argv[1], json.load(sys.stdin))
    except Exception as e:
        print(f"{type(e).__name__}: {e}", file=sys.stderr)
        sys.exit(REFUSED)
    sys.stdout.buffer.write(result)
    sys.stdout.flush()


if __name__ == "__main__":
    _main()
