"""FMPy's functions with their names and arguments, implemented with `pydfo`:
``from pydfo.compat.fmpy import simulate_fmu``.

Unsupported functions raise `NotProvided` when they are called, and suggest an alternative. docs/compat.md lists all
names.
"""

from __future__ import annotations

import os
import platform as _platform
import shutil
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import mkdtemp
from typing import IO

from ..._args import text as _text
from ..._model.description import read_description
from .._refused import NotProvided, hand_out
from .model_description import PathLike, read_model_description
from .simulation import instantiate_fmu, simulate_fmu
from .util import fmu_info, plot_result, read_csv, write_csv

__all__ = [
    "NotProvided",
    "architecture",
    "dump",
    "extract",
    "fmi_info",
    "instantiate_fmu",
    "platform",
    "platform_tuple",
    "plot_result",
    "read_csv",
    "read_model_description",
    "sharedLibraryExtension",
    "simulate_fmu",
    "supported_platforms",
    "system",
    "write_csv",
]

#: Names of this platform: "linux", "x86_64", "linux64" and so on.
system = {"win32": "windows", "darwin": "darwin"}.get(sys.platform, "linux")
sharedLibraryExtension = {"windows": ".dll", "darwin": ".dylib"}.get(system, ".so")
architecture = {"arm64": "aarch64", "amd64": "x86_64"}.get(_platform.machine().lower(), _platform.machine().lower())
platform = {"windows": "win"}.get(system, system) + ("64" if sys.maxsize > 2**32 else "32")
platform_tuple = f"{architecture}-{system}"

#: Names of platforms, with the folders below ``binaries/`` and the suffixes of their libraries.
_FOLDERS = {
    "darwin64": (("darwin64", "aarch64-darwin", "x86_64-darwin"), ".dylib"),
    "linux32": (("linux32", "i686-linux"), ".so"),
    "linux64": (("linux64", "x86_64-linux"), ".so"),
    "win32": (("win32", "x86-windows"), ".dll"),
    "win64": (("win64", "x86_64-windows"), ".dll"),
}


def _names(filename: PathLike | IO[bytes]) -> list[str]:
    if isinstance(filename, (str, os.PathLike)) and os.path.isdir(filename):
        return [path.relative_to(filename).as_posix() for path in Path(filename).rglob("*") if path.is_file()]
    with zipfile.ZipFile(filename) as archive:
        return archive.namelist()


def supported_platforms(filename: PathLike | IO[bytes]) -> list[str]:
    """Returns the platforms with a library in the FMU ("linux64" and so on), and "c-code" if it has sources."""
    files = [(os.path.dirname(name), name) for name in _names(filename)]
    found = ["c-code"] if any(folder == "sources" and name.endswith(".c") for folder, name in files) else []
    for name, (folders, end) in _FOLDERS.items():
        if any(folder in {f"binaries/{one}" for one in folders} and file.endswith(end) for folder, file in files):
            found.append(name)
    return found


def fmi_info(filename: PathLike) -> tuple[str, list[str]]:
    """Returns the version of FMI, and the supported interfaces among "ModelExchange" and "CoSimulation"."""
    found = read_description(filename)
    kinds = [("ModelExchange", found.model_exchange), ("CoSimulation", found.co_simulation)]
    return found.fmi_version, [name for name, interface in kinds if interface is not None]


def extract(filename: PathLike, unzipdir: PathLike | None = None, include: Callable[[str], bool] | None = None) -> Path:
    """Unpacks an FMU, or the names accepted by `include`, into a folder (default: a new one, which is not removed).

    Raises
    ------
    ValueError
        A name in the archive leads outside the folder.
    """
    with zipfile.ZipFile(filename) as archive:
        names = archive.namelist()
        for name in names:
            if "\\" in name or ":" in name or name.startswith("/") or ".." in name.split("/"):
                raise ValueError(f"Illegal path {_text.line(name)} found in {filename}: the path must be relative, use forward slashes and stay inside the folder")
        members = [name for name in names if include is None or include(name)]
        folder = Path(unzipdir if unzipdir is not None else mkdtemp())
        try:
            archive.extractall(folder, members=members)
        except BaseException:
            if unzipdir is None:
                shutil.rmtree(folder, ignore_errors=True)
            raise
    return folder


def dump(filename: PathLike | IO[bytes], causalities: Sequence[str] = ("input", "output")) -> None:
    """Prints the result of `fmu_info` of `pydfo.compat.fmpy.util`."""
    print(fmu_info(filename, causalities))


REFUSED = {name: "FMUs are called from Rust, not through ctypes" for name in ("calloc", "free", "freeLibrary", "realloc")}
__getattr__ = hand_out("pydfo.compat.fmpy", REFUSED)
