"""Groups of settings of a calibration and of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, SupportsFloat, SupportsIndex, TypedDict, TypeVar

from .._args import text as _text

R = TypeVar("R", "Simulation", "Process", "Limits")


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """Settings of the simulations of a `Calibration`. Each one is also accepted as an argument of `Calibration`.

    Attributes
    ----------
    kind : {"auto", "ME", "CS"}, optional
        Interface used to run the model, as in `FMUModel`. It defaults to the kind of the given FMUModel, otherwise
        "auto".
    solver : str
        "auto", "tsit5", "dop853", "radau5", "adams", "bdf", "rk4" or "euler". With "auto", each simulation
        starts with an explicit method and switches to an implicit one if the model is stiff.
    relative_tolerance : float, optional
        Relative tolerance of the integration. The default is the tolerance of the model's default experiment, but at
        most 1e-6, because a larger one makes the cost noisy. Without a default experiment, it is 1e-6. A fit uses a
        smaller tolerance if necessary. Unless `f_tol` is at least 100 times the model's tolerance, the fit divides
        the tolerance by a power of ten. With the chosen tolerance, simulation errors of this size relative to the
        measurements make the cost uncertain by less than `f_tol` near the best values. ``fit.tolerance`` and a note
        among the findings report the choice.
    step_size : float, optional
        Step size of the fixed-step methods, or communication step of co-simulation, in the time unit of the model. If a co-simulation cannot
        stop at the measured times, values are interpolated linearly between its steps, see `between_steps` in
        `FMUModel.simulate`.
    max_step : float, optional
        Largest step of the other methods, in the time unit of the model.
    timeout : float, optional
        Wall-clock limit of one simulation in s. A simulation that reaches the limit counts as failed. The limit of a
        whole fit is the argument `max_time` of `Calibration.fit`.
    interior_samples : int, optional
        Number of points within each step at which event indicators are evaluated, as in `FMUModel.simulate`.
    chattering : {"error", "warn", "slide"}
        Action if state events follow each other so closely that time hardly advances, as in `FMUModel.simulate`. A
        simulation that ends with this error counts as failed.
    input_derivatives : bool
        If True, co-simulations receive the derivatives of their inputs, as in `FMUModel.simulate`.
    """

    kind: str | None = None
    solver: str = "auto"
    relative_tolerance: SupportsFloat | None = None
    step_size: SupportsFloat | None = None
    max_step: SupportsFloat | None = None
    timeout: SupportsFloat | None = None
    interior_samples: SupportsIndex | None = None
    chattering: Literal["error", "warn", "slide"] = "error"
    input_derivatives: bool = True


@dataclass(frozen=True, kw_only=True)
class Process:
    """Process in which the FMU of a `Calibration` runs. Each setting is also accepted as an argument of `Calibration`.

    Attributes
    ----------
    isolation : {"process", "none"}
        The costs do not depend on it. "process": separate processes, one per worker, that start when they are needed
        and end with the calibration, or at the latest with this process. A crash, a hang beyond `timeout`, a call of
        `exit` or use of more than `memory_limit` is a failed evaluation with its reason. "none": this process, one
        simulation at a time. Inputs that are functions are always called in this process.
    memory_limit : float, optional
        Maximum memory of a process of the FMU in bytes; default: the memory of the machine.
    sandbox : bool
        Confines the processes of the FMU. They can write only into a private folder, which is removed with them. They
        cannot open connections or reach other processes. Requires Linux with Landlock; SECURITY.md lists what remains
        possible. Raises an error if the system does not support it, and with ``isolation="none"``.
    max_description_bytes : int, optional
        Largest size of ``modelDescription.xml`` if the model is a path; default 64 MiB. An FMUModel has its own
        limit.
    """

    isolation: Literal["process", "none"] = "process"
    memory_limit: SupportsFloat | None = None
    sandbox: bool = False
    max_description_bytes: int | None = None


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a fit. Each one is also accepted as an argument of `Calibration.fit`.

    Attributes
    ----------
    max_evaluations, max_iterations : int, optional
        Exact limits on the simulations and iterations of the search. The simulations counted in `Fit.n_checks` follow
        after it.
    max_time : float, optional
        Limit on the wall-clock time in s.
    target : float, optional
        The fit ends with the first evaluation whose cost is at or below this value, for any number of workers.
        Simultaneous evaluations that come later in the order count as speculative.
    """

    max_evaluations: SupportsFloat | None = None
    max_iterations: SupportsFloat | None = None
    max_time: SupportsFloat | None = None
    target: SupportsFloat | None = None


class SimulationKeywords(TypedDict, total=False):
    """Fields of `Simulation` and `Process` as arguments of `Calibration`."""

    kind: str | None
    solver: str
    relative_tolerance: SupportsFloat | None
    step_size: SupportsFloat | None
    max_step: SupportsFloat | None
    timeout: SupportsFloat | None
    interior_samples: SupportsIndex | None
    chattering: Literal["error", "warn", "slide"]
    input_derivatives: bool
    isolation: Literal["process", "none"]
    memory_limit: SupportsFloat | None
    sandbox: bool
    max_description_bytes: int | None


class LimitKeywords(TypedDict, total=False):
    """Fields of `Limits` as arguments of `Calibration.fit`."""

    max_evaluations: SupportsFloat | None
    max_iterations: SupportsFloat | None
    max_time: SupportsFloat | None
    target: SupportsFloat | None


def names_of(*records: type) -> tuple[str, ...]:
    """Returns the names of the fields of the records."""
    return tuple(field.name for record in records for field in fields(record))


def merged(record: type[R], argument: str, group: R | Mapping[str, Any] | None, keywords: Mapping[str, Any]) -> R:
    """Returns a record from the value of `argument` and from those keywords that are fields of the record.

    Raises TypeError if a field is given twice, or if the value is neither a record nor a dict of its fields."""
    names = names_of(record)
    given = {name: keywords[name] for name in names if name in keywords}
    if group is None:
        return record(**given)
    values = asdict(group) if isinstance(group, record) else group
    if not isinstance(values, Mapping):
        raise TypeError(f"{argument} must be a {record.__name__} or a dict, not {_text.show(group)}")
    if unknown := [name for name in values if name not in names]:
        raise TypeError(f"{argument}: unknown setting {_text.show(unknown[0])}; expected one of: {', '.join(names)}")
    if given:
        raise TypeError(f"{argument} and {next(iter(given))} are both specified; put {next(iter(given))} into {argument}")
    return record(**values)
