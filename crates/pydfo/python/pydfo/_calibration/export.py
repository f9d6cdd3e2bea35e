"""Export of a fit: to a file for `load_fit`, to tables and to other programs."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import _core
from .._args import optional_libraries as _optional_libraries
from .._args import values as _values
from .._args.keywords import also_called
from .._args.text import show
from .._errors import BadCalibrationError, CalibrationWarning
from .experiment import path_of
from .parameter import Parameter

if TYPE_CHECKING:
    from .._model.files import OpenOptions
    from .fit import Fit

PathLike = str | os.PathLike[str]

Inputs = Mapping[str, Callable[[float], float]]


@also_called(model="fmu")
def load_fit(path: PathLike, fmu: Any = None, inputs: Inputs | Mapping[str, Inputs] | None = None) -> Fit:
    """Loads a fit written by `Fit.save`.

    The loaded fit has bit-for-bit the same numbers and simulates as the saved fit. If its FMU was moved or has
    changed, the fit still provides its stored results. Simulations then raise FileNotFoundError with the file and the
    hash of the content.

    Parameters
    ----------
    path : path
        The file. Unlike a pickle, reading it runs no code from it, so it is suitable for fits from other people.
    fmu : path or FMUModel, optional
        The FMU, if it was moved since the fit. It must have the same content.
    inputs : dict of str to callable, optional
        Functions of time that drive inputs, by input name. The file does not contain them. If experiments have
        different functions, pass a dict of such dicts by experiment name.

    Returns
    -------
    Fit

    Raises
    ------
    OSError
        The file cannot be read.
    BadCalibrationError
        The file does not contain a fit, is truncated or damaged, or has a format that this version cannot read; the
        message reports the version that wrote it. It is also raised if the content of `fmu` differs, or
        functions of time are missing. A ValueError.

    Examples
    --------
    >>> fit.save("furuta.fit")  # doctest: +SKIP
    >>> pydfo.load_fit("furuta.fit").parameters  # doctest: +SKIP
    {'armFriction': 0.010001, 'pendulumFriction': 0.001}
    """
    place = _values.path("path", path)
    functions = _functions(place, {} if inputs is None else inputs)
    return _loaded(place, None, fmu, getattr(fmu, "_opened", None), functions)


def _functions(path: str, given: Inputs | Mapping[str, Inputs]) -> list[tuple[int, str, Any]]:
    """Returns the given functions of time that the fit in a file needs."""
    if not isinstance(given, Mapping):
        raise TypeError(f"inputs must be a dict of input names and functions, not {show(given)}")
    wanted = _core.functions_of_fit(path)
    experiments = {name for _, name, _ in wanted}
    nested = {name: functions for name, functions in given.items() if isinstance(functions, Mapping)}
    found, missing = [], []
    for k, experiment, variable in wanted:
        function = nested.get(experiment, {}).get(variable, given.get(variable))
        if callable(function):
            found.append((k, variable, function))
        elif function is not None:
            raise TypeError(f"inputs[{variable!r}] must be a function of time, not {show(function)}")
        else:
            missing.append(variable)
    available = {variable for _, _, variable in wanted}
    named = [name for name in given if name not in nested] + [name for functions in nested.values() for name in functions]
    if unknown := [name for name in nested if name not in experiments] + [name for name in named if name not in available]:
        there = ", ".join(sorted(available)) or "none"
        raise BadCalibrationError(f"{path}: {unknown[0]!r} is not driven by a function of time; inputs driven by functions: {there}")
    if missing:
        names = ", ".join(dict.fromkeys(missing))
        raise BadCalibrationError(
            f"{path}: {names}: these inputs are driven by functions of time, which files do not contain. Pass the functions again "
            f"with load_fit(..., inputs={{{missing[0]!r}: ...}})"
        )
    return found


def _loaded(
    path: str, content: bytes | None, model: Any, opened: OpenOptions | None, functions: list[tuple[int, str, Any]]
) -> Fit:
    from .calibration import Calibration

    fmu = None
    if model is not None:
        native = getattr(model, "_fmu", None)
        fmu = native if isinstance(native, _core.Fmu) else _core.Fmu(path_of(model), opened)
    native, result = _core.load_fit(path, content, fmu, functions)
    calibration = Calibration.__new__(Calibration)
    place, parameters = native.arguments()
    calibration._parameters = tuple(Parameter._of(record) for record in parameters)
    calibration._model = os.fspath(place)
    calibration._opened = opened
    calibration._functions = functions
    calibration._native = native
    return calibration._fit(result, vars(result)["_native"].start)


def pickled(fit: Fit) -> tuple[Any, ...]:
    """Returns the pickle of a fit: the bytes that `Fit.save` writes."""
    native = vars(fit).get("_native")
    if native is None:
        # A fit interrupted twice has only its fields.
        return _restored_fields, (type(fit), vars(fit))
    calibration = fit._calibration
    return _restored, (native.to_bytes(), calibration._opened, calibration._functions)


def _restored(content: bytes, opened: OpenOptions | None, functions: list[tuple[int, str, Any]]) -> Fit:
    return _loaded("the pickle of a Fit", content, None, opened, functions)


def _restored_fields(of: type[Fit], fields: dict[str, Any]) -> Fit:
    fit = of.__new__(of)
    vars(fit).update(fields)
    return fit


def native_of(fit: Fit) -> _core.Fit:
    """Returns the native fit."""
    native: _core.Fit | None = vars(fit).get("_native")
    if native is None:
        raise BadCalibrationError("the fit was interrupted twice and contains only its last iteration; fit again")
    return native


def dataframe(fit: Fit, what: str) -> Any:
    """Returns a table of a fit as a pandas.DataFrame."""
    text = native_of(fit).to_csv(_values.choice("what", what))
    return _optional_libraries.pandas().read_csv(io.StringIO(text), float_precision="round_trip")


def export_fmu(fit: Fit, path: PathLike, experiment: str | None, keep: bool) -> Path:
    """Writes a copy of the FMU, or the parameter file that replaces it, and returns its path."""
    fmu, ssv, warning = native_of(fit).export_fmu(_values.path("path", path), experiment, keep)
    if warning is not None:
        warnings.warn(warning, CalibrationWarning, stacklevel=3)
    written = fmu or ssv
    assert written is not None
    return written
