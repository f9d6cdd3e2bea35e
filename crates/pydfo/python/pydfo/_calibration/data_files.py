"""Recordings in the formats of other tools, each read by the library that Python people use for it; none is needed before."""

from __future__ import annotations

import contextlib
import importlib
import io
import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import text as _text
from .._errors import BadCalibrationError

Array = npt.NDArray[Any]


def suffix(path: str) -> str:
    """The end of a file's name, in lower case."""
    return os.path.splitext(path)[1].lower()


def _library(path: str, names: list[str]) -> Any:
    """The first of these modules that is installed."""
    for name in names:
        try:
            return importlib.import_module(name)
        except ImportError:
            pass
    package = names[0].split(".", maxsplit=1)[0]
    raise ImportError(f"{path}: reading {suffix(path)} files needs {package}: pip install {package}")


@dataclass(frozen=True)
class Columns:
    """Columns by name, which are read when they are asked for."""

    names: list[str]
    read: Callable[[list[str]], Mapping[str, Any]]
    #: What the file has beside them, with its size.
    others: list[str] = field(default_factory=list)


#: So many bytes of values are read from a file that is smaller than an eighth of that.
MOST_BYTES = 1 << 30

#: So many bytes of the texts of a workbook, which are kept while its rows are read.
_MOST_TEXT = 1 << 26

#: The most rows of a sheet in Excel.
_MOST_ROWS = 1 << 20

#: Values that are read at once; between two such parts Ctrl-C is answered.
_PART = 1 << 20


def check_size(path: str, n_values: int) -> None:
    """Refuses to read so many numbers: compressed files may claim any number of them."""
    most = max(MOST_BYTES, 8 * os.path.getsize(path))
    if 8 * n_values > most:
        raise MemoryError(
            f"{path}: the columns that are needed have {n_values} values, which take {8 * n_values} bytes, more than {most} (1 GiB, or 8 "
            "times the size of the file): give parts of it as arrays"
        )


@contextmanager
def _reading(path: str, what: str) -> Iterator[None]:
    """What a reader of a library raises becomes an error that names the file."""
    try:
        yield
    except MemoryError:
        raise
    except OSError as e:
        if e.errno is not None and e.filename is not None:
            raise
        raise BadCalibrationError(f"{path}: this is not {what}, or it is damaged") from None
    except BadCalibrationError:
        raise
    except Exception as e:
        raise BadCalibrationError(f"{path}: this is not {what}, or it is damaged: {_text.beginning(str(e))}") from e


def parquet(path: str) -> Columns:
    """The columns of a Parquet file."""
    _core.check_regular(path)
    import importlib.util

    if importlib.util.find_spec("pyarrow") is None and importlib.util.find_spec("polars") is not None:
        return _with_polars(path)
    module, arrow = _library(path, ["pyarrow.parquet"]), importlib.import_module("pyarrow")
    with _reading(path, "a Parquet file"):
        file = module.ParquetFile(path)
        names = list(file.schema_arrow.names)

    def read(wanted: list[str]) -> dict[str, Any]:
        with _reading(path, "a Parquet file"):
            check_size(path, file.metadata.num_rows * len(wanted))
            parts: dict[str, list[Any]] = {name: [] for name in wanted}
            n_rows = 0
            for batch in file.iter_batches(batch_size=_PART, columns=wanted):
                n_rows += batch.num_rows
                check_size(path, n_rows * len(wanted))
                for name in wanted:
                    column = batch.column(batch.schema.names.index(name))
                    parts[name].append(arrow.chunked_array([column]).to_numpy())
            return {name: np.concatenate(arrays) if arrays else np.empty(0) for name, arrays in parts.items()}

    return Columns(names, read)


def _with_polars(path: str) -> Columns:
    polars = importlib.import_module("polars")
    with _reading(path, "a Parquet file"):
        names = list(polars.read_parquet_schema(path))
        scan = polars.scan_parquet(path)

    def read(wanted: list[str]) -> dict[str, Any]:
        with _reading(path, "a Parquet file"):
            check_size(path, scan.select(polars.len()).collect().item() * len(wanted))
            frame = scan.select(wanted).collect()
            return {name: frame[name] for name in wanted}

    return Columns(names, read)


def workbook(path: str, needed: list[str], time: str | None) -> tuple[bytes, list[str]]:
    """The columns of the first sheet of an Excel workbook that are needed as the text of a CSV file, and the names of the others."""
    _core.check_regular(path)
    import csv
    import zipfile

    module = _library(path, ["openpyxl"])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    chosen: list[int] | None = None
    names: list[str] = []
    with _reading(path, "an Excel workbook (.xlsx)"):
        with zipfile.ZipFile(path) as archive:
            kept = sum(entry.file_size for entry in archive.infolist() if "/worksheets/" not in entry.filename)
        if kept > max(_MOST_TEXT, 8 * os.path.getsize(path)):
            raise MemoryError(f"{path}: the texts and formats of this workbook take {kept} bytes, more than {_MOST_TEXT}")
        book = module.load_workbook(path, read_only=True, data_only=True)
        try:
            sheet = book.worksheets[0]
            # What a sheet says of its size may be anything.
            sheet.reset_dimensions()
            for row in sheet.iter_rows(max_row=_MOST_ROWS, values_only=True):
                if all(cell is None for cell in row) or (isinstance(row[0], str) and row[0].lstrip().startswith("#")):
                    continue
                if chosen is None:
                    names = ["" if cell is None else str(_cell(cell)).strip() for cell in row]
                    chosen = _chosen(names, needed, time)
                cells = [_cell(row[k]) if k < len(row) and row[k] is not None else "" for k in chosen]
                # A row may have cells in other columns only.
                if any(cell != "" for cell in cells):
                    writer.writerow(cells)
        finally:
            book.close()
    return text.getvalue().encode(), [name for k, name in enumerate(names) if k not in (chosen or []) and name]


def _chosen(names: list[str], needed: list[str], time: str | None) -> list[int]:
    """Positions of the times and of the columns that are needed; what is not there is refused where it is used."""
    try:
        chosen = {_core.find_time(names, time)[0]}
    except ValueError as e:
        raise BadCalibrationError(f"data: {e}") from None
    for name in needed:
        with contextlib.suppress(ValueError):
            chosen.add(_core.find_column(names, name))
    return sorted(chosen)


def _cell(cell: Any) -> Any:
    # Line breaks within a cell would be rows of the table.
    return cell.isoformat() if hasattr(cell, "isoformat") else " ".join(cell.split()) if isinstance(cell, str) else cell


@dataclass(frozen=True)
class _Variable:
    """A numeric variable of a MATLAB file, which is read when it is asked for."""

    shape: tuple[int, ...]
    read: Callable[[], Array]


def mat(path: str, needed: list[str], time: str | None) -> Columns:
    """The numeric variables of a MATLAB file as long as the times, those of structs as ``struct.field``."""
    _core.check_regular(path)
    with open(path, "rb") as file:
        head = file.read(128)
    if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF"):
        variables, others = _of_hdf5(path)
    else:
        variables, others = _of_matlab(path, [*needed, time or "time"])
    try:
        at = _core.find_time(list(variables), time)[0]
    except ValueError as e:
        raise BadCalibrationError(f"data: {e}") from None
    return _of_one_length(path, variables, list(variables)[at], others)


#: The classes of numbers in MATLAB.
_NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


class _Interruptible(io.FileIO):
    """A file that is read by Python code: between two reads Ctrl-C is answered."""

    def read(self, size: int | None = -1) -> bytes:
        return super().read(-1 if size is None else size) or b""


def _of_matlab(path: str, wanted: list[str]) -> tuple[dict[str, _Variable], list[str]]:
    """The variables of a file before version 7.3, of structs those that are wanted, and the names of the others."""
    module = _library(path, ["scipy.io"])

    def load(name: str) -> Any:
        with _reading(path, "a MATLAB file"), _Interruptible(path) as file:
            return module.loadmat(file, variable_names=[name], squeeze_me=False, struct_as_record=True, chars_as_strings=True)[name]

    def lazy(name: str, shape: tuple[int, ...]) -> _Variable:
        return _Variable(shape, lambda: np.asarray(load(name)))

    with _reading(path, "a MATLAB file"):
        listed = module.whosmat(path)
    found: dict[str, _Variable] = {}
    others = []
    for name, shape, kind in listed:
        if kind in _NUMERIC:
            found[name] = lazy(name, shape)
        elif kind == "struct" and any(one.startswith(f"{name}.") for one in wanted):
            check_size(path, math.prod(shape))
            found.update((field, _Variable(array.shape, lambda array=array: array)) for field, array in _numeric(name, load(name)))  # type: ignore[misc]
        elif kind == "struct":
            others.append(f"{name} (a struct: {name}.field)")
    return found, others


def _numeric(name: str, value: Any) -> Iterator[tuple[str, Array]]:
    """The numeric arrays in a variable that SciPy has read."""
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            yield from _numeric(f"{name}.{field}", value.reshape(-1)[0][field])
    elif value.dtype.kind in "fiub":
        yield name, value


def _of_hdf5(path: str) -> tuple[dict[str, _Variable], list[str]]:
    """The variables of a file of version 7.3, where they stand column by column."""
    h5py = _library(path, ["h5py"])
    found: dict[str, _Variable] = {}

    def lazy(name: str, shape: tuple[int, ...]) -> _Variable:
        def read() -> Array:
            with _reading(path, "a MATLAB file of version 7.3"), h5py.File(path, "r") as file:
                stored = file[name]
                values = np.empty(stored.shape, stored.dtype)
                for rows in _parts(stored.shape):
                    values[rows] = stored[rows]
                return values.T

        return _Variable(tuple(reversed(shape)), read)

    def visit(group: Any, prefix: str) -> None:
        for name, value in group.items():
            if name.startswith("#"):
                continue
            if isinstance(value, h5py.Group):
                visit(value, f"{prefix}{name}.")
            elif value.dtype.kind in "fiub" and value.attrs.get("MATLAB_class") != b"char" and "MATLAB_empty" not in value.attrs:
                found[prefix + name] = lazy(value.name, value.shape)

    with _reading(path, "a MATLAB file of version 7.3"), h5py.File(path, "r") as file:
        visit(file, "")
    return found, []


def _parts(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Parts of an array that are read at once."""
    if not shape:
        yield ()
        return
    axis = shape.index(max(shape))
    step = max(_PART * shape[axis] // max(math.prod(shape), 1), 1)
    for start in range(0, shape[axis], step):
        yield (slice(None),) * axis + (slice(start, start + step),)


def _of_one_length(path: str, variables: dict[str, _Variable], time: str, others: list[str]) -> Columns:
    """The columns of the variables that are as long as `time`: vectors under their names, the columns of a matrix `y` as
    ``y[1]``, ``y[2]`` and so on, as MATLAB and models count them. The names of the others with their sizes come beside them."""
    shape = variables[time].shape
    n = math.prod(shape)
    if max(shape, default=0) != n:
        raise BadCalibrationError(f"data: the times '{time}' are a {_size(shape)} matrix, not a vector")
    sources: dict[str, tuple[str, int | None]] = {}
    others = list(others)
    for name, variable in variables.items():
        if math.prod(variable.shape) == n and max(variable.shape, default=1) == n:
            sources[name] = (name, None)
        elif len(variable.shape) == 2 and n in variable.shape and math.prod(variable.shape) <= n * _MOST_COLUMNS:
            sources.update({f"{name}[{k + 1}]": (name, k) for k in range(math.prod(variable.shape) // max(n, 1))})
        else:
            others.append(f"{name} ({_size(variable.shape)})")

    def read(wanted: list[str]) -> dict[str, Array]:
        whole = dict.fromkeys(sources[name][0] for name in wanted)
        check_size(path, sum(math.prod(variables[name].shape) for name in whole))
        values = {name: variables[name].read() for name in whole}
        columns = {}
        for name in wanted:
            variable, k = sources[name]
            value = values[variable]
            columns[name] = value.reshape(-1) if k is None else (value if value.shape[0] == n else value.T)[:, k]
        return columns

    return Columns(list(sources), read, others)


#: The most columns of a matrix.
_MOST_COLUMNS = 1 << 16


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(n) for n in shape)
