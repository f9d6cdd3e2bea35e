"""Handing a fit on: to a file that is read back, to tables, to other programs."""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _core, _options
from ._errors import CalibrationWarning
from ._experiment import path_of
from ._parameter import Parameter

if TYPE_CHECKING:
    from ._fit import Fit
    from ._files import OpenOptions

PathLike = str | os.PathLike[str]


def load_fit(path: PathLike, model: Any = None) -> Fit:
    """A fit that `Fit.save` has written.

    It has the numbers that it had, bit for bit, and simulates as it did. Where its FMU is not at its place any more, or has
    another content there, the fit still shows all that it holds; what simulates raises FileNotFoundError, which names the
    file and the hash of the content.

    Parameters
    ----------
    path : path
        The file. Of a fit with inputs that are functions of time it cannot be read: functions are not stored (a pickle has them).
    model : path or FMUModel, optional
        The FMU, where it is at another place than it was when the fit was made. It must have the same content.

    Returns
    -------
    Fit

    Raises
    ------
    OSError
        The file cannot be read.
    BadCalibrationError
        It holds no fit, is cut or damaged, or was written in a format that this version does not read (the message says by
        which version it was); `model` has another content. A ValueError.

    Examples
    --------
    >>> fit.save("furuta.fit")  # doctest: +SKIP
    >>> pydfo.load_fit("furuta.fit").parameters  # doctest: +SKIP
    {'armFriction': 0.010001, 'pendulumFriction': 0.001}
    """
    return _loaded(os.fspath(path), None, model, getattr(model, "_opened", None), [])


def _loaded(
    path: str, content: bytes | None, model: Any, opened: OpenOptions | None, functions: list[tuple[int, str, Any]]
) -> Fit:
    from ._calibration import Calibration

    fmu = None
    if model is not None:
        known = getattr(model, "_fmu", None)
        fmu = known if isinstance(known, _core.Fmu) else _core.Fmu(path_of(model), opened)
    native, result = _core.load_fit(path, content, fmu, functions)
    calibration = Calibration.__new__(Calibration)
    place, parameters = _core.parameters_of(native)
    calibration._parameters = tuple(Parameter(**arguments) for arguments in parameters)
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
    return _restored, (_core.fit_to_bytes(native), calibration._opened, calibration._functions)


def _restored(content: bytes, opened: OpenOptions | None, functions: list[tuple[int, str, Any]]) -> Fit:
    return _loaded("the pickle of a Fit", content, None, opened, functions)


def _restored_fields(of: type[Fit], fields: dict[str, Any]) -> Fit:
    fit = of.__new__(of)
    vars(fit).update(fields)
    return fit


def native_of(fit: Fit) -> _core.Fit:
    """The native fit."""
    native = vars(fit).get("_native")
    if native is None:
        raise ValueError("the fit was interrupted twice and has no more than its last point: it cannot be handed on")
    assert isinstance(native, _core.Fit)
    return native


def dataframe(fit: Fit, what: str) -> Any:
    """A table of a fit as a pandas.DataFrame."""
    text = _core.fit_to_csv(native_of(fit), what)
    return _options.pandas().read_csv(io.StringIO(text), float_precision="round_trip")


def export_fmu(fit: Fit, path: PathLike, experiment: str | None, keep: bool) -> Path:
    """Writes a copy of the FMU, or what takes its place."""
    native = native_of(fit)
    fmu, ssv, warning = _core.export_fmu(native, os.fspath(path), experiment, keep)
    if warning is not None:
        warnings.warn(warning, CalibrationWarning, stacklevel=3)
    written = fmu or ssv
    assert written is not None
    return written
