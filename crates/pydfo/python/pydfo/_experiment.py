"""What a `Calibration` is told about a recording, brought into the form that the native code reads."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from . import _data, _options
from ._errors import BadCalibrationError


@dataclass(frozen=True)
class ExperimentFields:
    """A recording and how it is simulated, as the native code reads it."""

    path: str | None
    columns: _data.Columns
    left_out: list[str]
    time: str | None
    outputs: list[tuple[str, str, float]]
    inputs: list[tuple[str, str]]
    start_values: list[tuple[str, Any]]
    window: tuple[float, float] | None
    kind: str
    start_time: float | None
    timeout: float | None
    relative_tolerance: float | None
    solver: str
    step_size: float | None
    max_step: float | None
    input_derivatives: bool
    chattering: str
    sharing: str


def pairs_of_columns(name: str, value: Mapping[str, str] | Sequence[str] | str | None) -> list[tuple[str, str]]:
    """Pairs of variable and column; of a list, columns that are named like the variables."""
    if value is None:
        return []
    if isinstance(value, str):
        value = [value]
    if isinstance(value, Mapping):
        return [(_options.choice(name, variable), _options.choice(name, column)) for variable, column in value.items()]
    if isinstance(value, Iterable) and not isinstance(value, (set, frozenset)):
        return [(_options.choice(name, variable), variable) for variable in value]
    raise TypeError(f"{name} must be a dict of variable and column, or a list of variables, not {_options.show(value)}")


def weighted(
    outputs: list[tuple[str, str]], weights: Mapping[str, float] | Sequence[float] | None
) -> list[tuple[str, str, float]]:
    """Pairs of output and column with their weights: 1 where nothing is said."""
    if weights is None:
        return [(variable, column, 1.0) for variable, column in outputs]
    if isinstance(weights, Mapping):
        known = [variable for variable, _ in outputs]
        for name in weights:
            if name not in known:
                raise BadCalibrationError(f"weights: there is no output '{name}'; there are: {', '.join(known)}")
        return [(v, c, _options.number("weights", weights.get(v, 1.0))) for v, c in outputs]
    if isinstance(weights, str) or not isinstance(weights, Iterable):
        raise TypeError(f"weights must be a dict of outputs and numbers, or a number per output, not {_options.show(weights)}")
    numbers = [_options.number("weights", w) for w in weights]
    if len(numbers) != len(outputs):
        raise BadCalibrationError(f"{len(numbers)} weights for {len(outputs)} outputs")
    return [(variable, column, weight) for (variable, column), weight in zip(outputs, numbers)]


def path_of(model: Any) -> str:
    """The path of a model that is given as such, or opened."""
    if isinstance(model, (str, os.PathLike)):
        return os.fspath(model)
    path = getattr(model, "path", None)
    if isinstance(path, (str, os.PathLike)):
        return os.fspath(path)
    raise TypeError(f"model must be the path of an FMU or an FMUModel, not {_options.show(model)}")
