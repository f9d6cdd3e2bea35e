"""`Design`: a model, scenarios, parameters and objectives."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Literal, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .._args import options as _options
from .._args import text as _text
from .._args import values as _values
from .._args.keywords import also_called, explained, given_once
from .._calibration.calibration import Calibration
from .._calibration.fit import Fit
from .._calibration.parameter import Parameter
from .._calibration.settings import Limits, Process, Simulation, merged
from .._errors import BadCalibrationError, SimulationError
from .._optimize.fmin import Callback
from .._optimize.minimize import minimize
from .._optimize.pareto_front import ParetoFront
from .._optimize.sensitivity import Sensitivity
from .result import DesignPoint, DesignResult, is_maximised
from .scenario import Scenario

if TYPE_CHECKING:
    import concurrent.futures

    from typing_extensions import Unpack

    from .._calibration.settings import LimitKeywords, SimulationKeywords

_log = logging.getLogger("pydfo")

#: A function of the simulation results of all scenarios that returns a number to minimise.
Objective = Callable[[Any], SupportsFloat]


class Design:
    """A model and the parameters for which its simulations are best.

    An objective is a formula over criteria of the simulated trajectories. Criteria follow from the accepted steps of the
    integration, so a maximum between two rows counts. A design uses the worker processes, methods, limits and checkpoints
    of a `Calibration`.

    Parameters
    ----------
    model : path or FMUModel
        The FMU.
    parameters : sequence of Parameter
        The parameters to choose. The entries of every ``x`` are in this order.
    objective : str, list of str, or callable
        The formula to minimise, such as ``"itae(e1) + 0.1*energy(u1 - 3)"``. It is maximised if it begins with
        ``maximize``. It contains parameters and these criteria of a signal y from the start t0 to the end t1:

        - ``final(y)``, ``max(y)``, ``min(y)``, ``mean(y)``, ``integral(y)``, ``rms(y)``;
        - ``energy(y)``: integral of y squared;
        - ``ise(y, r)``, ``iae(y, r)``, ``itae(y, r)``: integrals of ``(y - r)**2``, ``abs(y - r)`` and
          ``(t - t0)*abs(y - r)``; the reference r defaults to 0;
        - ``overshoot(y, r)``: largest excess beyond the final value of r, in percent of the step from the initial value of
          y to it;
        - ``rise_time(y, r)``: time from 10 % to 90 % of this step; the whole duration if the response does not reach them;
        - ``settling_time(y, r, band)``: time from t0 until y stays within the fraction `band` (default 0.02) of this step
          around r; the whole duration if it does not;
        - ``crossing_time(y, r)``: first time at which y reaches r; t1 if it does not.

        Without r, the reference of `overshoot`, `rise_time` and `settling_time` is the final value of y. Signals and
        references are formulas over variables of the model, columns of the scenario, and ``time``. In a co-simulation, the
        criteria follow from straight lines between the communication points.

        Several objectives are given as a list, for `pareto`; `optimize` uses the first one. A callable receives the
        `SimulationResult` of the variables in `outputs` (a dict by name, if there are several scenarios) and returns the
        number to minimise. It is called with the interpreter lock.
    scenarios : Scenario or list of Scenario, optional
        Inputs, start values and spans of the simulations. Default: one simulation from the start time to the stop time of
        the model.
    constraints : list of str, optional
        Relations between parameters and criteria, such as ``["overshoot(x1, r1) <= 5", "K1 <= K2"]``. A constraint with
        criteria applies in each scenario. Linear constraints between parameters hold at every simulated point. With a
        callable objective: constraints of `minimize`.
    combine : {"sum", "mean", "worst"}
        Combination of the objective over several scenarios. Each value is multiplied by the weight of its scenario.
    outputs : list of str, optional
        Variables that a callable objective receives.
    times : array_like, optional
        Times of the rows that a callable objective receives; required for it.
    units, time_unit, simulation, process : optional
        As in `Calibration`.
    **settings
        Settings of `simulation` and `process`.

    Raises
    ------
    OSError, FmuError, KeyError, ValueError, TypeError
        As in `Calibration`. Mistakes in formulas are reported with their column and the nearest name.

    Examples
    --------
    >>> from pydfo import Parameter, example_fmu
    >>> design = Design(example_fmu("dahlquist"), [Parameter("k", 2.0, 0.1, 10.0)], "integral(x) + k**2", Scenario(50))
    >>> result = design.optimize()
    >>> round(result["k"], 2), round(result.value, 3)
    (0.79, 1.89)
    """

    @also_called(groups=(Simulation, Process), objectives="objective", goal="objective")
    def __init__(
        self,
        model: Any,
        parameters: Sequence[Parameter] | Parameter,
        objective: str | Sequence[str] | Objective,
        scenarios: Scenario | Sequence[Scenario] | None = None,
        *,
        constraints: Any = (),
        combine: Literal["sum", "mean", "worst"] = "sum",
        outputs: Sequence[str] | str | None = None,
        times: npt.ArrayLike | None = None,
        units: Mapping[str, str] | None = None,
        time_unit: str | None = None,
        simulation: Simulation | Mapping[str, Any] | None = None,
        process: Process | Mapping[str, Any] | None = None,
        **settings: Unpack[SimulationKeywords],
    ) -> None:
        simulated = merged(Simulation, "simulation", simulation, settings)
        run_in = merged(Process, "process", process, settings)
        listed = [Scenario()] if scenarios is None else [scenarios] if isinstance(scenarios, Scenario) else scenarios
        if isinstance(listed, (str, Mapping)) or not isinstance(listed, Iterable):
            raise TypeError(f"scenarios must be a list of pydfo.Scenario, not {_text.show(listed)}")
        given = list(listed)
        if not given:
            raise BadCalibrationError("scenarios is empty. Omit it for one simulation with the settings of the model")
        for index, one in enumerate(given):
            if not isinstance(one, Scenario):
                raise TypeError(f"entry {index} of scenarios is a {type(one).__name__}, not a Scenario")
        self._function = objective if callable(objective) else None
        self._outputs = [] if outputs is None else _values.names("outputs", [outputs] if isinstance(outputs, str) else outputs)
        self._times = None if times is None else _values.vector("times", times).tolist()
        self._constraints = constraints if callable(objective) else ()
        if callable(objective):
            if not self._outputs or self._times is None:
                raise BadCalibrationError("a callable objective requires outputs and times")
            # The native code needs a criterion; this one costs nothing.
            goals, relations = ["final(time)"], ()
        else:
            if outputs is not None or times is not None:
                raise BadCalibrationError("outputs and times belong to a callable objective; a formula names its variables")
            goals = [objective] if isinstance(objective, str) else _values.names("objective", objective)
            relations = constraints
        self._calibration = Calibration.__new__(Calibration)
        self._calibration._build(model, given, parameters, units, time_unit, relations, simulated, run_in, goals, _values.choice("combine", combine))

    @property
    def names(self) -> list[str]:
        """Names of the entries of ``x``."""
        return self._calibration.names

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters as given."""
        return self._calibration.parameters

    @property
    def start(self) -> npt.NDArray[np.float64]:
        """Start values of the parameters, shape (n,)."""
        return self._calibration.start

    @property
    def scenarios(self) -> list[str]:
        """Names of the scenarios."""
        return self._calibration.experiments

    @property
    def objectives(self) -> list[str]:
        """The objectives as written; empty for a callable."""
        return [] if self._function else self._calibration._native.goals()

    @property
    def constraints(self) -> list[str]:
        """Constraints as written."""
        return self._calibration.constraints

    def evaluate(self, x: npt.ArrayLike | Mapping[str, float] | None = None) -> DesignPoint:
        """Simulates all scenarios once and returns the objectives, criteria and constraints.

        Parameters
        ----------
        x : array_like or dict, optional
            Values of the parameters, in their order or by name. Omitted parameters have their start values.

        Raises
        ------
        SimulationError
            A simulation failed, or a criterion is not finite.
        ValueError
            The number of values is wrong, or the objective is a callable.
        """
        if self._function:
            raise BadCalibrationError("evaluate requires an objective that is a formula; call simulate, and the function with its result")
        return DesignPoint(self._calibration._native.design_point(self._calibration._checked(x)))

    def simulate(
        self,
        x: npt.ArrayLike | Mapping[str, float] | None = None,
        times: npt.ArrayLike | None = None,
        outputs: str | Iterable[str] | None = None,
    ) -> Any:
        """Simulates all scenarios and records variables.

        Parameters
        ----------
        x : array_like or dict, optional
            As in `evaluate`.
        times : array_like, optional
            Times of the rows, ascending. Default: 500 intervals from the start to the end of the first scenario.
        outputs : str or iterable of str, optional
            Variables to record, as in `Calibration.simulate`. Default: "all".

        Returns
        -------
        SimulationResult
            The rows. With several scenarios: a dict by name.
        """
        return self._calibration.simulate(x, self._rows() if times is None else times, "all" if outputs is None else outputs)

    def _rows(self) -> npt.NDArray[np.float64]:
        start, end = self._calibration._native.span(0)
        return np.linspace(start, end, 501)

    @also_called(groups=(Limits,))
    def optimize(
        self,
        method: str = "auto",
        workers: SupportsIndex | concurrent.futures.Executor | None = None,
        x_tol: float | None = None,
        f_tol: float | None = None,
        stop: Literal["any", "all"] | None = None,
        batch: str | SupportsIndex = "auto",
        disp: bool | None = None,
        callback: Callback | None = None,
        *,
        start: npt.ArrayLike | Mapping[str, float] | None = None,
        rng: int | np.random.Generator | None = None,
        options: Mapping[str, Any] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        resume: Literal["auto", "never", "require"] = "auto",
        search: Literal["local", "global"] = "local",
        limits: Limits | Mapping[str, Any] | None = None,
        **given_limits: Unpack[LimitKeywords],
    ) -> DesignResult:
        """Searches for the parameters with the best value of the (first) objective that satisfy the constraints.

        Designs whose simulation fails rank behind all others. Limits, checkpoints and workers act as in `Calibration.fit`.

        Parameters
        ----------
        method : str
            A method of `minimize`. "auto" selects one that supports the parameters and constraints, usually
            "quadratic-model".
        workers, x_tol, f_tol, stop, batch, disp, callback, start, rng, options, checkpoint, resume, limits : optional
            As in `Calibration.fit`. With a callable objective, the default is one worker, and `disp` is not available.
        search : {"local", "global"}
            With method "auto", "global" searches for the best minimum within the bounds, which must be finite.
        **given_limits
            Settings of `limits`.

        Returns
        -------
        DesignResult
            The best design found, regardless of how the search ended.

        Raises
        ------
        AllStartsFailed
            The simulation failed at every starting point.
        Interrupted
            Ctrl-C was pressed. This KeyboardInterrupt contains the search so far in ``result``.
        ValueError, TypeError
            Invalid arguments.
        """
        if self._function:
            if disp is not None:
                raise BadCalibrationError("disp is not available for a callable objective; use callback")
            of_method = given_once(_options.dictionary(options), Design.optimize, x_tol=x_tol, f_tol=f_tol, stop=stop, batch=batch)
            bounds = merged(Limits, "limits", limits, given_limits)
            search_of = {"method": method, "rng": rng, "checkpoint": checkpoint, "resume": resume, "search": search, "callback": callback}
            return self._minimized(start, bounds, of_method, workers=1 if workers is None else workers, **search_of)
        try:
            fit = self._calibration.fit(
                method, workers, x_tol, f_tol, stop, batch, disp, callback, start=start, rng=rng, options=options, checkpoint=checkpoint,
                resume=resume, search=search, limits=limits, **given_limits,
            )
        except BaseException as e:
            for name in ("result", "partial_result"):
                attached = getattr(e, name, None)
                if isinstance(attached, Fit):
                    setattr(e, name, DesignResult(self, attached, None, None))
            raise
        return self._result(fit)

    @also_called(groups=(Limits,))
    def pareto(
        self,
        population: SupportsIndex | None = None,
        workers: SupportsIndex | concurrent.futures.Executor | None = None,
        disp: bool | None = None,
        callback: Callback | None = None,
        *,
        start: npt.ArrayLike | Mapping[str, float] | None = None,
        rng: int | np.random.Generator | None = None,
        options: Mapping[str, Any] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        resume: Literal["auto", "never", "require"] = "auto",
        limits: Limits | Mapping[str, Any] | None = None,
        **given_limits: Unpack[LimitKeywords],
    ) -> ParetoFront:
        """Searches for designs of which none is better in all objectives: the Pareto front, by NSGA-II.

        The search has no test of convergence and uses its whole budget, so set a limit. Every parameter requires two finite
        bounds.

        Parameters
        ----------
        population : int, optional
            Number of members (100), which limits the number of points of the front.
        workers, disp, callback, start, rng, checkpoint, resume, limits : optional
            As in `optimize`.
        options : dict, optional
            Options of NSGA-II, see `pydfo.pareto`.
        **given_limits
            Settings of `limits`.

        Returns
        -------
        ParetoFront
            Parameters ``x`` and ``criteria`` of the points. All criteria are minimised: an objective to maximise has the
            opposite sign, and its name is ``-(...)``.

        Raises
        ------
        ValueError, TypeError
            There is only one objective, or it is a callable; a parameter has no finite bounds; invalid arguments.
        AllStartsFailed, Interrupted
            As in `optimize`.
        """
        if self._function:
            raise BadCalibrationError("pareto requires a list of formulas as the objective")
        of_method = _options.dictionary(options)
        if population is not None:
            of_method = {**of_method, "population": population}
        front: Any = self._calibration.fit(
            "nsga2", workers, disp=disp, callback=callback, start=start, rng=rng, options=of_method, checkpoint=checkpoint, resume=resume,
            limits=limits, **given_limits,
        )
        front.names = tuple(f"-({text})" if is_maximised(text) else text for text in self.objectives)
        return front  # type: ignore[no-any-return]

    @explained
    def sensitivity(
        self,
        method: Literal["morris", "sobol"] = "morris",
        n: SupportsFloat | None = None,
        workers: SupportsIndex | None = None,
        *,
        levels: SupportsFloat | None = None,
        second_order: bool = False,
        level: SupportsFloat = 0.95,
        n_resamples: SupportsFloat | None = None,
        rng: int | np.random.Generator | None = None,
        max_time: SupportsFloat | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
    ) -> Sensitivity:
        """Estimates the effect of each parameter on the objectives and on the criteria of each scenario, over the whole box of
        the bounds.

        Parameters
        ----------
        method, n, workers, levels, second_order, level, n_resamples, rng, max_time, checkpoint : optional
            As in `Calibration.sensitivity`.

        Returns
        -------
        Sensitivity
            ``outputs`` are the objectives, then the criteria, with the name of the scenario if there are several.

        Raises
        ------
        ValueError, TypeError, CalibrationError, CheckpointError, OSError, Interrupted
            As in `Calibration.sensitivity`; also ValueError for a callable objective.
        """
        if self._function:
            raise BadCalibrationError("sensitivity requires an objective that is a formula; for a function, use pydfo.sensitivity")
        return self._calibration.sensitivity(
            method, n, workers, levels=levels, second_order=second_order, level=level, n_resamples=n_resamples, rng=rng, max_time=max_time,
            checkpoint=checkpoint,
        )

    def _result(self, fit: Fit) -> DesignResult:
        native = self._calibration._native

        def evaluated(x: npt.NDArray[np.float64]) -> DesignPoint | None:
            try:
                return DesignPoint(native.design_point(x.tolist()))
            except SimulationError:
                return None

        return DesignResult(self, fit, evaluated(np.asarray(fit.x)), evaluated(np.asarray(fit.start)))

    def _minimized(self, start: Any, limits: Limits, options: dict[str, Any], **search: Any) -> DesignResult:
        """Minimises a function of the simulation results."""
        calibration, function = self._calibration, self._function
        if [p.name for p in self.parameters] != self.names:
            raise BadCalibrationError("a callable objective requires parameters that are neither local nor derived")

        def value(x: npt.NDArray[np.float64]) -> float:
            try:
                simulated = calibration.simulate(x, self._times, self._outputs)
            except SimulationError as e:
                _log.info("design: %s", e)
                return float("nan")
            return float(function(simulated))  # type: ignore[misc]

        options["scale"] = [p.scale for p in self.parameters]
        found = minimize(
            value,
            calibration._values(start, "start"),
            bounds=[(p.lower, p.upper) for p in self.parameters],
            constraints=self._constraints or None,
            options=options,
            **asdict(limits),
            **search,
        )
        return DesignResult(self, found, None, None)

    def __repr__(self) -> str:
        what = _text.names(self.objectives) if not self._function else getattr(self._function, "__name__", "a function")
        return _text.line(f"<Design of {_text.names(self.names)}: {what}>")
