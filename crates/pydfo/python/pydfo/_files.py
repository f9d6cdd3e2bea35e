"""FMU files: packing folders, the bundled examples, the caches."""

from __future__ import annotations

import atexit
import os
from pathlib import Path

from . import _core

PathLike = str | os.PathLike[str]

# FMUs stay open for the next one who opens them; their unpacked folders go with the interpreter.
atexit.register(_core.close_unused)


def build_fmu(folder: PathLike, out: PathLike) -> Path:
    """Packs a folder into an FMU.

    Parameters
    ----------
    folder : path
        With ``modelDescription.xml`` at its root and, for an FMU that is to be built, ``sources/``. A library for this
        platform is compiled from the sources (``CC``, else ``cc``, ``gcc`` or ``clang``) and packed with them.
    out : path
        The file to write; one that exists is replaced.

    Returns
    -------
    Path
        `out`.

    Raises
    ------
    FmuError
        The folder holds no FMU; there is no compiler; the sources do not compile.
    OSError
        Files cannot be read or written.
    """
    _core.build_fmu(folder, out)
    return Path(out)


def example_fmu(name: str, version: str = "2.0", kind: str = "ME") -> Path:
    """The FMU of a bundled model; built at the first call, and kept in a cache folder.

    Parameters
    ----------
    name : {"furuta", "bouncing_ball", "dahlquist", "van_der_pol", "stair", "switched_input", "quad_tank", "exhaust"}
        The model.
    version : {"1.0", "2.0", "3.0"}
        The version of FMI that it is made for.
    kind : {"ME", "CS"}
        Model exchange or co-simulation; FMUs of FMI 3.0 have both.

    Returns
    -------
    Path
        An ``.fmu`` file.

    Raises
    ------
    ValueError
        There is no such model, version or kind; the message lists those there are.
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
    """Removes what is kept between runs: libraries built from sources, packed example models, open FMUs.

    Models that are in use go on; what is missing is made again when it is needed.
    """
    _core.clear_caches()
