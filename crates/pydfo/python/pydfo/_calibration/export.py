"""Handing a fit on: to a file that is read back, to tables, to other programs."""

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
    """A fit that `Fit.save` has written.

    It has the numbers that it had, bit for bit, and simulates as it did. Where its FMU is not at its place any more, or has
    another content there, the fit still shows all that it holds; what simulates raises FileNotFoundError, which names the
    file and the hash of the content.

    Parameters
    ----------
    path : path
        The file. Reading it runs no code that it holds, unlike a pickle: it is the way to take fits of others.
    fmu : path or FMUModel, optional
        The FMU, where it is at another place than it was when the fit was made. It must have the same content.
    inputs : dict of str to callable, optional
        The functions of time that drive inputs, by the names of the inputs: they are not stored. Where experiments have functions of
        their own, a dict of such by the names of the experiments.

    Returns
    -------
    Fit

    Raises
    ------
    OSError
        The file cannot be read.
    BadCalibrationError
        It holds no fit, is cut or damaged, or was written in a format that this version does not read (the message says by
        which version it was); `fmu` has another content; functions of time are missing. A ValueError.

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
    """The functions of time of a file, from those that are given."""
    if not isinstance(given, Mapping):
        raise TypeError(f"inputs must be a dict of functions by the names of the inputs, not {show(given)}")
    wanted = _core.functions_of_fit(path)
    experiments = {name for _, name, _ in wanted}
    nested = {name: own for name, own in given.items() if isinstance(own, Mapping)}
    found, missing = [], []
    for k, experiment, variable in wanted:
        function = nested.get(experiment, {}).get(variable, given.get(variable))
        if callable(function):
            found.append((k, variable, function))
        elif function is not None:
            raise TypeError(f"inputs[{variable!r}] must be a function of time, not {show(function)}")
        else:
            missing.append(variable)
    known = {variable for _, _, variable in wanted}
    named = [name for name in given if name not in nested] + [name for own in nested.values() for name in own]
    if unknown := [name for name in nested if name not in experiments] + [name for name in named if name not in known]:
        there = ", ".join(sorted(known)) or "none"
        raise BadCalibrationError(f"{path}: no function of time drives {unknown[0]!r}; inputs that functions drive: {there}")
    if missing:
        names = ", ".join(dict.fromkeys(missing))
        raise BadCalibrationError(
            f"{path}: functions of time drive {names}, and a file does not hold functions: give them again, "
            f"load_fit(..., inputs={{{missing[0]!r}: ...}})"
        )
    return found


def _loaded(
    path: str, content: bytes | None, model: Any, opened: OpenOptions | None, functions: list[tuple[int, str, Any]]
) -> Fit:
    from .calibration import Calibration

    fmu = None
    if model is not None:
        known = getattr(model, "_fmu", None)
        fmu = known if isinstance(known, _core.Fmu) else _core.Fmu(path_of(model), opened)
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
    """What a pickle of a fit holds: the bytes of the file that `Fit.save` writes."""
    native = vars(fit).get("_native")
    if native is None:
        # Interrupted twice: there is no more than its fields.
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
    """The native fit."""
    native: _core.Fit | None = vars(fit).get("_native")
    if native is None:
        raise BadCalibrationError("the fit was interrupted twice, and has nothing but its last iteration: fit again")
    return native


def dataframe(fit: Fit, what: str) -> Any:
    """A table of a fit as a pandas.DataFrame."""
    text = native_of(fit).to_csv(_values.choice("what", what))
    return _optional_libraries.pandas().read_csv(io.StringIO(text), float_precision="round_trip")


def export_fmu(fit: Fit, path: PathLike, experiment: str | None, keep: bool) -> Path:
    """Writes a copy of the FMU, or what takes its place."""
    fmu, ssv, warning = native_of(fit).export_fmu(_values.path("path", path), experiment, keep)
    if warning is not None:
        warnings.warn(warning, CalibrationWarning, stacklevel=3)
    written = fmu or ssv
    assert written is not None
    return written
