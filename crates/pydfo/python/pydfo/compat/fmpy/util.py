"""Files, plots and strings for simulations, as in FMPy."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Iterable, Sequence
from typing import IO, Any

import numpy as np

from ..._args import text as _text
from ..._model.description import read_description
from ..._model.model import FMUModel
from .._refused import hand_out
from .model_description import PathLike, path_of, read_model_description, text_of
from .simulation import auto_interval as auto_interval


def read_csv(filename: PathLike, variable_names: Sequence[str] | None = None) -> np.ndarray[Any, Any]:
    """Returns a structured array of the columns of a CSV file.

    Elements of an array share a field, separated by blanks."""
    with open(filename, newline="", encoding="utf-8") as file:
        header, *rows = list(csv.reader(file))
    cells = [[[float(item) for item in cell.split()] for cell in row] for row in rows if row]
    if not cells:
        raise ValueError(f"{filename} has no rows")
    sizes = [len(cell) for cell in cells[0]]
    dtype = [(name, np.float64, (size,)) if size > 1 else (name, np.float64) for name, size in zip(header, sizes)]
    array = np.array([tuple(tuple(cell) if size > 1 else cell[0] for cell, size in zip(row, sizes)) for row in cells], dtype=dtype)
    return array if variable_names is None else array[["time", *variable_names]]


def write_csv(filename: PathLike, result: np.ndarray[Any, Any], columns: Sequence[str] | None = None) -> None:
    """Writes a structured array to a CSV file."""
    names = list(result.dtype.names or ()) if columns is None else ["time", *columns]
    with open(filename, "w", encoding="utf-8") as file:
        file.write(",".join(f'"{name}"' for name in names) + "\n")
        for row in result:
            cells = (" ".join(f"{v:.16g}" for v in np.ravel(row[name])) if np.ndim(row[name]) else str(row[name]) for name in names)
            file.write(",".join(cells) + "\n")


def plot_result(
    result: np.ndarray[Any, Any],
    reference: np.ndarray[Any, Any] | None = None,
    names: Iterable[str] | None = None,
    filename: PathLike | None = None,
    window_title: str | None = None,
    events: bool = False,
    markers: bool = False,
    height: int | None = None,
) -> None:
    """Draws each column of a result over time in a separate plot with matplotlib, and shows or writes the figure.

    Parameters
    ----------
    result, reference : structured ndarray
        Results with a first field ``time`` in s. The reference is dashed.
    events : bool
        If True, draw vertical lines at times listed twice.
    height : int, optional
        Height of the figure in pixels.
    """
    from ..._plot import pyplot

    plt = pyplot()
    columns = list(result.dtype.names or ())
    time = columns.pop(0)
    chosen = list(names) if names is not None else columns
    figure, plots = plt.subplots(max(len(chosen), 1), 1, sharex=True, squeeze=False, layout="constrained")
    if height is not None:
        figure.set_figheight(height / figure.get_dpi())
    jumps = result[time][1:][np.diff(result[time]) == 0] if events else ()
    for axes, name in zip(plots[:, 0], chosen):
        style = "default" if result[name].dtype.kind == "f" else "steps-post"
        for array, line in ((reference, "--"), (result, "-")):
            if array is not None and name in (array.dtype.names or ()):
                axes.plot(array[time], np.reshape(array[name], (len(array), -1)), line, marker="." if markers else None, drawstyle=style)
        for jump in jumps:
            axes.axvline(jump, color="0.7", linewidth=0.5)
        axes.set_ylabel(name)
    plots[-1, 0].set_xlabel("time [s]")
    if window_title is not None and figure.canvas.manager is not None:
        figure.canvas.manager.set_window_title(window_title)
    if filename is None:
        plt.show()
    else:
        figure.savefig(filename)
        plt.close(figure)


def fmu_info(filename: PathLike | IO[bytes], causalities: Sequence[str] = ("input", "output")) -> str:
    """Returns a text that describes an FMU and its variables with these causalities."""
    from . import supported_platforms

    model, platforms = read_model_description(filename), supported_platforms(filename)
    kinds = [name for name, interface in (("Model Exchange", model.modelExchange), ("Co-Simulation", model.coSimulation)) if interface]
    facts = {
        "FMI Version": model.fmiVersion,
        "FMI Type": ", ".join(kinds),
        "Model Name": model.modelName,
        "Description": model.description,
        "Platforms": ", ".join(platforms),
        "Continuous States": model.numberOfContinuousStates,
        "Event Indicators": model.numberOfEventIndicators,
        "Variables": len(model.modelVariables),
        "Generation Tool": model.generationTool,
        "Generation Date": model.generationDateAndTime,
    }
    lines = ["", "Model Info", "", *(f"  {name:17}  {value}" for name, value in facts.items()), ""]
    if (default := model.defaultExperiment) is not None:
        times = {"Start Time": default.startTime, "Stop Time": default.stopTime, "Tolerance": default.tolerance, "Step Size": default.stepSize}
        lines += ["Default Experiment", "", *(f"  {name:17}  {value}" for name, value in times.items() if value), ""]
    lines += [f"Variables ({', '.join(causalities)})", "", "  Name               Causality              Start Value  Unit     Description"]
    for v in model.modelVariables:
        if v.causality in causalities:
            name = v.name if len(v.name) <= 18 else f"...{v.name[-15:]}"
            lines.append(f"  {name:18} {v.causality:10} {v.start or '':>23}  {v.unit or '':8} {v.description or ''}".rstrip())
    return "\n".join(_text.line(line) for line in lines)


def get_start_values(filename: PathLike) -> dict[str, str]:
    """Returns the values of all variables after the initialization, as strings."""
    with FMUModel(filename) as model:
        names = [name for name, v in model.description.variables.items() if v.type not in ("Binary", "Clock")]
        return {name: str(text_of(value)) for name, value in zip(names, model.get(names))}


def validate_fmu(filename: PathLike | IO[bytes]) -> list[str]:
    """Returns the violations of the standard in a description, as strings; empty if there are none."""
    path, folder = path_of(filename)
    try:
        return [quirk.message for quirk in read_description(path).quirks]
    except (OSError, ValueError, RuntimeError) as e:
        return [str(e)]
    except Exception as e:
        if type(e).__module__.startswith("pydfo"):
            return [str(e)]
        raise
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


_ELSEWHERE = "use the FMPy package for this, because it does not simulate"
REFUSED = {
    "add_remoting": "pydfo runs each FMU in a separate process, and models for Windows under Wine",
    "can_simulate": "FMUModel raises FmuError with the reason if an FMU cannot run on this machine",
    "create_cmake_project": "use pydfo.build_fmu to compile the sources of a folder",
    "create_jupyter_notebook": _ELSEWHERE,
    "create_plotly_figure": "use plot_result, which draws with matplotlib",
    "create_zip_archive": "use pydfo.build_fmu to pack a folder",
    "download_file": "pydfo opens no connections",
    "download_test_file": "pydfo opens no connections",
    "fmu_path_info": "the FMI Cross-Check repository is closed",
    "has_wine64": "pydfo looks for Wine when a model needs it; `fmufit info` shows how a model runs here",
    "has_wsl": "pydfo does not run FMUs for Linux on Windows",
    "read_ref_opt_file": "the FMI Cross-Check repository is closed",
    "remove_source_code": _ELSEWHERE,
    "sha256_checksum": "hashlib.file_digest",
    "validate_result": "the FMI Cross-Check repository is closed",
    "validate_signal": "the FMI Cross-Check repository is closed",
    "visual_c_versions": "sources are built with the compiler in CC",
    "visual_studio_installation_paths": "sources are built with the compiler in CC",
}
__getattr__ = hand_out("pydfo.compat.fmpy.util", REFUSED)
