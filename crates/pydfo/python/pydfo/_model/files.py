"""FMU files: packing folders, the bundled examples, the caches."""

from __future__ import annotations

import atexit
import operator
import os
from dataclasses import dataclass
from pathlib import Path

from .. import _core
from .._args import values as _values

PathLike = str | os.PathLike[str]

# FMUs stay open for reuse. Their unpacked folders are removed at the exit of the interpreter.
atexit.register(_core.close_unused)


@dataclass(frozen=True)
class OpenOptions:
    """Options for opening an FMU, as the native code reads them."""

    log_level: int = 7
    logging: bool = False
    log_categories: tuple[str, ...] = ()
    show_log: bool = False
    deepbind: bool = False
    lazy: bool = False
    max_description_bytes: int | None = None
    max_elements: int | None = None


def size_limit(name: str, value: int | None) -> int | None:
    """Returns a limit on a count; None means the default."""
    if value is None:
        return None
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise TypeError(f"{name} must be an integer, not {value!r}")
    number = operator.index(value)
    if not 0 < number < 2**63:
        raise ValueError(f"{name} must be a positive number, not {value!r}")
    return number


def build_fmu(folder: PathLike, out: PathLike, *, platform: str = "native") -> Path:
    """Packs a folder into an FMU.

    Parameters
    ----------
    folder : path
        A folder with ``modelDescription.xml`` at its root. For an FMU to be built, it also contains ``sources/``. A
        library is compiled from the sources and packed with them.
    out : path
        The file to write. An existing file is replaced.
    platform : {'native', 'win64', 'win32'}, optional
        The platform of the library: this one (compiler ``CC``, otherwise ``cc``, ``gcc`` or ``clang``), or Windows
        (compiler ``CC_x86_64_pc_windows_gnu`` or ``CC_i686_pc_windows_gnu``, otherwise the compiler of MinGW-w64).

    Returns
    -------
    Path
        `out`.

    Raises
    ------
    FmuError
        The folder does not contain an FMU, there is no compiler, or the sources do not compile.
    OSError
        Files cannot be read or written.
    Interrupted
        Ctrl-C was pressed; a KeyboardInterrupt. The compiler is ended, and nothing is written.
    """
    _core.build_fmu(_values.path("folder", folder), _values.path("out", out), platform)
    return Path(out)


def example_fmu(name: str, version: str = "2.0", kind: str = "ME") -> Path:
    """Returns the FMU of a bundled model. It is built at the first call and kept in a cache folder.

    Parameters
    ----------
    name : {"furuta", "bouncing_ball", "dahlquist", "van_der_pol", "stair", "switched_input", "quad_tank", "exhaust", "tank_control"}
        Name of the model.
    version : {"1.0", "2.0", "3.0"}
        Version of FMI of the FMU.
    kind : {"ME", "CS"}
        Model exchange or co-simulation. FMUs of FMI 3.0 support both.

    Returns
    -------
    Path
        An ``.fmu`` file.

    Raises
    ------
    ValueError
        There is no such model, version or kind. The message lists the available ones.
    FmuError
        There is no C compiler.

    Examples
    --------
    >>> from pydfo import FMUModel, example_fmu
    >>> FMUModel(example_fmu("dahlquist")).description.model_name
    'Dahlquist'
    """
    if not isinstance(name, str):
        raise TypeError(f"name must be a string, not {name!r}")
    return _core.example_fmu(name, str(version), str(kind))


def clear_caches() -> None:
    """Removes cached files and open FMUs: libraries built from sources, packed example models, unused open FMUs.

    Models in use continue to work. Missing files are created again when they are needed.
    """
    _core.clear_caches()
