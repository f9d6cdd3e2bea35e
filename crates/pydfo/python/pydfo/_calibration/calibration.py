"""`Calibration`: a model, measurements and parameters."""

from __future__ import annotations

import errno
import functools
import logging
import os
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Literal, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import options as _options
from .._args import text as _text
from .._args import values as _values
from .._args.keywords import also_called, argument_names, explained, given_once
from .._errors import CalibrationWarning
from .._model.files import OpenOptions, size_limit
from .._optimize import evaluate as _evaluate
from .._optimize.fmin import Callback, check_callback
from .._optimize.pareto_front import ParetoFront
from .._optimize.result import OptimizeResult
from .._optimize.sensitivity import Sensitivity, analysis, partial_results
from . import check as _check
from . import cost as _cost
from . import stages as _stages
from . import uncertainty as _uncertainty
from . import worker as _worker
from .display import Display
from .evaluation import Evaluation
from .experiment import Experiment, Inputs, Names, Sigmas, Weights, collected, path_of
from .fit import Fit
from .parameter import Parameter
from .settings import Limits, Process, Simulation, merged
from .stages import Stage
from .uncertainty import Preflight, Uncertainty
from .validation import CrossValidation

if TYPE_CHECKING:
    import concurrent.futures

    from matplotlib.figure import Figure
    from typing_extensions import Unpack

    from .settings import LimitKeywords, SimulationKeywords

_log = logging.getLogger("pydfo")


class Calibration(Evaluation):
    """A model, measurements and the parameters to fit.

    The cost is the sum of the squared weighted residuals over all outputs and measured times. A residual is simulated
    minus measured, times weight. The terms are added in the order of `residuals`. Simulations run without the
    interpreter lock. During a fit, a simulation stops early if its cost can no longer change the result. Equal
    parameters always give bit-for-bit identical costs.

    Pass a single recording as `data` and `outputs`. Pass several recordings as a list of `Experiment`, each with its
    own inputs, window, weights and start values: ``Calibration(model, [Experiment(...), ...], parameters)``. The cost
    is then the sum over all experiments.

    A calibration can be pickled and copied. The pickle contains the recordings by value and the model as the path of
    its file and a hash of its content. The file must have the same hash when the calibration is unpickled.

    Parameters
    ----------
    model : path or FMUModel
        The FMU. Values set in an FMUModel are ignored, with a warning. Pass them as `start_values`.
    data : path, dict of arrays, DataFrame, Series, xarray or structured array
        The recording, or a list of `Experiment`: a column of ascending times, which need not be equally spaced, and
        the measured columns. NaN, None and empty cells are missing values.

        A CSV file has one line of names, optionally followed by a line of units. The separators are commas,
        semicolons or tabs. If the separator is not a comma, all numbers may have decimal commas. A file with both
        decimal commas and points is rejected. Other formats are ``.mat`` (read by SciPy, or by h5py for version 7.3),
        ``.xlsx`` (openpyxl; a `sheet`, like a CSV file), ``.parquet`` (pyarrow) and ``.h5`` (tables of pandas; pandas
        and PyTables). In a ``.mat`` file, every
        variable as long as the times is a column. Fields of structs are named ``rig.x``, and the columns of a matrix
        ``y[1]``, ``y[2]``.

        The times are the column ``time`` (in upper or lower case), the index of a DataFrame with this name, or an index
        of dates. The name may include a unit in brackets or parentheses, such as ``time [ms]``. The units are s, ms,
        us, ns, min, h and d, spelled exactly like this. Times without a unit are in the time unit of the model, which is
        s unless the model or `time_unit` state another one. Durations (``timedelta64``, ``datetime.timedelta``) are also
        times. Dates and times of day (``datetime64``, ``datetime``, strings such as 2024-05-31T13:45:10.5 or 31.05.2024
        13:45:10) are converted to the time since the first one.

        A column name may include a unit (``phi [deg]``, ``T (degC)``), which may be omitted in arguments (``phi``).
        If the model also declares a unit of the variable, the column is converted. Units of different quantities are
        an error. Costs, results and plots use the units of the model.
    outputs : dict of str to str, or list of str
        Maps outputs of the model to the columns that measured them. Use a list if both have the same names. A
        simulation counts as failed if an output is NaN or infinite at a time when it was measured.
    parameters : sequence of Parameter
        The parameters to fit. The entries of every ``x`` are in this order. A local parameter occupies one entry per
        experiment.
    inputs : dict, or list of str, optional
        Maps inputs of the model to the columns that drive them. Continuous inputs are interpolated linearly between
        the rows, unless the column is given as `Hold`; other inputs are held constant. A time that occurs twice is a
        jump. Values of a dict may also be numbers or functions of time, see `Experiment`.
    window : (float, float), optional
        Interval of time. Only measurements in this interval count. The simulation still starts at its start
        time.
    weights : dict, or sequence, optional
        Factor of the residuals of each output; default 1. Use the inverse of the standard deviation of the noise if
        it is known. A weight per measurement, or "range", "mean" or "sd", is also possible, see `Experiment`.
    sigma : number, column or dict, optional
        Known standard deviation of the noise of the outputs, for example ``{"y": 0.03}``. The weights are 1/sigma, and
        standard errors, intervals, profiles and bands do not depend on the size of the residuals. An error model, as
        in ``{"y": "0.1 + 0.05*abs(y)"}`` or ``"a + b*abs(y)"``, and ``"log"`` are also possible, see `Experiment`.
    start_values : dict, optional
        Values of other parameters and start values of variables, by name. Fitted parameters are not allowed.
    start_time : float, optional
        Start time of the simulations. It defaults to the start time of the model's default experiment, or 0. It
        is required if the recording starts more than ten of its sampling intervals later.
    units : dict of str to str, optional
        Units of outputs and inputs for which the model declares no unit: ``{"room.T": "K"}``. Columns with a unit are
        converted to it.
    time_unit : str, optional
        Unit in which the model counts its time, such as "h". It defaults to the unit that the model states for its
        independent variable, otherwise s. Times of recordings that state a unit are converted to it. All other times are
        in this unit: times without a unit, `window`, `start_time`, `warm_up`, `resample`, `delays`, step sizes, results
        and plots.
    time : str, optional
        Name of the time column if it is not ``time``. The unit may be omitted.
    mask : array of bool or str, optional
        Selects the rows whose measurements count. Pass one entry per row, or the name of a column, which selects a
        row if its value is neither 0 nor missing. Inputs count in all rows.
    resample : float, optional
        Interval of time, at least the sampling interval of the recording. Times and columns are replaced by their means
        over each interval, excluding masked rows. The weights become weights of the means, see `Experiment`.
    sheet, initial_states, windows, warm_up, delays, hold_inputs : optional
        Settings of the single recording, as in `Experiment`.
    constraints : list of str, optional
        Relations between parameters, such as ``["k1 + k2 + k3 == 1", "tau1 <= tau2", "m*g/k <= 0.1"]``, with the formulas of
        `Parameter` and the comparisons ``==``, ``<=`` and ``>=``. Mistakes and contradictions are errors. Linear
        constraints hold at every simulated point of the search. Nonlinear ones may be violated on the way; the result
        satisfies them within the option ``constraint_tol``, or it is no success.
    simulation : Simulation or dict, optional
        Solver, tolerance, steps and time limit of the simulations, see `Simulation`. Its settings are also accepted
        as arguments: ``solver="bdf"`` is short for ``simulation={"solver": "bdf"}``.
    process : Process or dict, optional
        Isolation, memory limit and sandbox of the FMU, see `Process`. Its settings are also accepted as arguments.
    **settings
        Settings of `simulation` and `process`.

    Warns
    -----
    CalibrationWarning
        An unused column has the name of an undriven input, possibly in another case; values set in an FMUModel are
        ignored; a setting has no effect (`step_size` with an adaptive solver, `max_step` with a fixed-step solver,
        ...).

    Raises
    ------
    OSError
        A file cannot be read.
    FmuError
        The FMU cannot be used.
    KeyError
        The model has no such variable. The message suggests the nearest names.
    ValueError, TypeError
        Data, parameters or settings do not match. The message reports the arguments, the place and the numbers.
    """

    @also_called(groups=(Simulation, Process), input="inputs", output="outputs")
    def __init__(
        self,
        model: Any,
        data: Any,
        outputs: Names | Sequence[Parameter] | Parameter | None = None,
        parameters: Sequence[Parameter] | Parameter | None = None,
        inputs: Inputs | None = None,
        window: tuple[float, float] | None = None,
        *,
        weights: Weights | None = None,
        sigma: Sigmas | None = None,
        start_values: Mapping[str, Any] | str | os.PathLike[str] | None = None,
        start_time: SupportsFloat | None = None,
        time: str | None = None,
        sheet: str | None = None,
        units: Mapping[str, str] | None = None,
        time_unit: str | None = None,
        mask: Any = None,
        resample: SupportsFloat | None = None,
        initial_states: Mapping[str, SupportsFloat | str | Parameter] | str | None = None,
        steady_limit: SupportsFloat | None = None,
        windows: Sequence[tuple[float, float]] | None = None,
        warm_up: SupportsFloat | None = None,
        delays: Mapping[str, SupportsFloat] | None = None,
        hold_inputs: bool | None = None,
        constraints: Sequence[str] | str | None = (),
        simulation: Simulation | Mapping[str, Any] | None = None,
        process: Process | Mapping[str, Any] | None = None,
        **settings: Unpack[SimulationKeywords],
    ) -> None:
        simulated = merged(Simulation, "simulation", simulation, settings)
        run_in = merged(Process, "process", process, settings)
        if run_in.isolation == "process":
            # An interpreter starts while data and model are read; it ends with this object if nothing is evaluated.
            self._started_ahead = _core.start_worker_ahead()
        of_experiment: dict[str, Any] = {
            "window": window,
            "weights": weights,
            "sigma": sigma,
            "start_values": start_values,
            "start_time": start_time,
            "time": time,
            "sheet": sheet,
            "initial_states": initial_states,
            "steady_limit": steady_limit,
            "windows": windows,
            "warm_up": warm_up,
            "delays": delays,
            "hold_inputs": hold_inputs,
            "mask": mask,
            "resample": resample,
        }
        experiments, parameters = collected(data, outputs, parameters, inputs, **of_experiment)
        self._build(model, experiments, parameters, units, time_unit, constraints, simulated, run_in)

    def _build(
        self,
        model: Any,
        experiments: Sequence[Experiment],
        parameters: Any,
        units: Mapping[str, str] | None,
        time_unit: str | None,
        constraints: Sequence[str] | str | None,
        simulated: Simulation,
        run_in: Process,
        goals: Sequence[str] = (),
        combine: str = "sum",
    ) -> None:
        """Creates the native calibration. With `goals`, it evaluates a design."""
        needed = "parameters must be a list of pydfo.Parameter(name, start, lower, upper)"
        if not isinstance(parameters, (Parameter, Iterable)):
            raise TypeError(f"{needed}, not {_text.show(parameters)}")
        relations = [constraints] if isinstance(constraints, str) else constraints or []
        self._parameters = (parameters,) if isinstance(parameters, Parameter) else tuple(parameters)
        for parameter in self._parameters:
            if not isinstance(parameter, Parameter):
                raise TypeError(f"{needed}, not of {_text.show(parameter)}")
        record: dict[str, Any] = {**asdict(simulated), **asdict(run_in), "units": dict(_values.units(units))}
        record["time_unit"] = None if time_unit is None else _values.choice("time_unit", time_unit)
        record["solver"] = _solver(simulated.solver)
        if simulated.kind is None:
            record["kind"] = getattr(model, "kind", "auto")
        self._model = path_of(model)
        self._opened: OpenOptions | None = getattr(model, "_opened", None)
        if self._opened is None and run_in.max_description_bytes is not None:
            self._opened = OpenOptions(max_description_bytes=size_limit("max_description_bytes", run_in.max_description_bytes))
        opened = getattr(model, "_fmu", None)
        source = opened if isinstance(opened, _core.Fmu) else self._model
        self._functions = [
            (k, variable, source)
            for k, experiment in enumerate(experiments)
            for variable, source in experiment.inputs
            if callable(source)
        ]
        relations = _values.names("constraints", relations)
        self._native = _core.Calibration(source, list(experiments), record, list(self._parameters), relations, (list(goals), combine))
        for warning in self._native.warnings():
            warnings.warn(warning, CalibrationWarning, stacklevel=4)
        if run_in.isolation == "process" and not _worker.has_interpreter:
            message = f"the FMU runs in this process, because no Python interpreter was found for worker processes (sys.executable is {sys.executable!r})"
            warnings.warn(message, CalibrationWarning, stacklevel=3)
        given = {name for parameter in self._parameters for name in (parameter.name, *(parameter.variables or ()))}
        given.update(name for experiment in experiments for name, _ in experiment.start_values + experiment.initial_states)
        if forgotten := [name for name in getattr(model, "_names_set", list)() if name not in given]:
            warnings.warn(
                f"values set in an FMUModel are ignored in a calibration: {_text.listed(forgotten)}. To use them, pass them as start_values",
                CalibrationWarning,
                stacklevel=4,
            )

    @also_called(groups=(Limits,))
    def fit(
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
        loss: Literal["linear", "soft_l1", "huber", "cauchy"] = "linear",
        f_scale: SupportsFloat = 1.0,
        start: npt.ArrayLike | Mapping[str, float] | None = None,
        initial_simplex: npt.ArrayLike | None = None,
        rng: int | np.random.Generator | None = None,
        options: Mapping[str, Any] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        resume: Literal["auto", "never", "require"] = "auto",
        search: Literal["local", "global"] = "local",
        stages: Sequence[Stage | Sequence[str]] | None = None,
        objective: str | _cost.Objective = "sum-of-squares",
        covariance: Literal["sandwich", "pooled"] | None = "sandwich",
        preflight: bool = False,
        noise: Literal["auto", "stated", "estimated"] = "auto",
        watch: bool = False,
        limits: Limits | Mapping[str, Any] | None = None,
        **given_limits: Unpack[LimitKeywords],
    ) -> Fit:
        """Fits the parameters without the interpreter lock.

        Parameters
        ----------
        method : str
            The optimiser. "least-squares" uses the individual residuals of the simulations (see `least_squares`). The
            methods of `minimize` are "nelder-mead", "barrier", "quadratic-model", "cma-es", "pattern-search",
            "multistart", "de", "de-classic" and "ga". The last four require two finite bounds for every parameter.
            "auto" selects "least-squares". With integer parameters it selects "de", and with categorical ones "ga".
            If an option exists only for "nelder-mead", it selects that method. The fit records the reason in
            ``method_reason``.
        workers : int or concurrent.futures.Executor, optional
            Number of simulations that may run at once; None and -1 mean all cores. Alternatively, an executor (of
            `concurrent.futures`, Dask, MPI, joblib or Ray) that runs the simulations of the search point by point.
            Problem and model are sent to each of its processes once. Simulations before and after the search run in
            this process. The fit is bit-for-bit identical for any number of workers and any executor.
        x_tol : float, optional
            Tolerance of the x test (default 1e-4): extent of the simplex in units of the sizes of the parameters (see
            `Parameter`). For a parameter on a log scale, it applies to the logarithm.
        f_tol : float, optional
            Tolerance of the f test (default 1e-4): difference between the worst and the best vertex relative to the
            best cost.
        stop : {"all", "any"}, optional
            "all" (the default): both tests must pass. "any": one test ends the fit.
        batch : {"auto", "serial", "ahead"}, "rounds", "workers" or int
            For Nelder-Mead and barrier: number of trial points simulated at once in an iteration, see `fmin`. For
            least squares: "auto", "serial", "rounds", a number of points, or "workers", see `least_squares`.
        disp : bool, optional
            True: show a live line if standard error is a terminal or a notebook, using rich if it is installed.
            Otherwise print one line per iteration, as `fmin` does. In both cases, report how the fit ended. False:
            show nothing. None: show the live line in a terminal or a notebook if the fit lasts more than 2 s.
        callback : callable, optional
            Called after each iteration with a `Progress` on the calling thread. StopIteration or True ends the fit.
        loss, f_scale : optional
            Function of the residuals that is summed up, for every method, see `least_squares`. "soft_l1", "huber" and
            "cauchy" limit the influence of outliers. Priors always contribute their squares. Cost and rms of the fit
            use the function; `Fit.residuals` returns the plain residuals.
        start : array_like or dict, optional
            Start that replaces the start values of the parameters. A start outside of the period of a periodic
            parameter becomes the equivalent one inside.
        initial_simplex : array_like, optional
            Vertices or steps, see `fmin`. Steps of parameters on a log scale are steps of the logarithm.
        rng : int or numpy.random.Generator, optional
            Seed of the random numbers, or a generator from which to draw the seed; None draws one. The fit stores the
            seed in ``seed``.
        options : dict, optional
            Further options of the method, see `minimize`. Scales and sizes are properties of the parameters.
            ``max_failed`` is the fraction of failed evaluations at which the fit ends with its best point.
        checkpoint, resume : optional
            File for the state of the fit, and the rule for continuing from it, see `minimize`. The file is rejected
            if it belongs to another model, other data, parameters or settings, or to an `objective` function with
            another name. The error reports the difference. The message of a resumed fit reports that it was resumed.
        search : {"local", "global"}
            With method "auto", "local" finds the minimum next to the start. "global" searches for the best minimum
            within the bounds by least squares from several starts ("multistart"), which requires two finite bounds
            for every parameter. The fit lists the minima found in ``optima``.
        stages : list of Stage, or of lists of names, optional
            ``[["C2", "G2"], ["C1", "G1"]]``: each stage frees these parameters and holds the others at the values of
            the previous stage. Limits apply to all stages together, and ``nfev`` and the trace cover all stages. The
            fits of the stages are in ``stages``. A checkpoint has one file per stage: ``fit.ckpt.stage1``,
            ``fit.ckpt.stage2`` and so on.
        objective : str or callable
            The function to minimise. "sum-of-squares": the sum of the squared residuals. It is the likelihood with
            known noise if the weights are 1/sigma, the inverse standard deviation of the noise. "mae": mean absolute
            error. "rmse": root mean squared error. "nrmse": mean over the outputs of the RMSE divided by the range of
            the measurements. "likelihood": likelihood with an unknown standard deviation of the noise for each
            output, ``sum N_o / 2 ln(r_o' r_o / N_o)``. Least squares minimises the sums of squares and the likelihood.

            A callable receives (measured, simulated), which are dicts of arrays by output. With several experiments,
            they are dicts of such dicts by experiment name. It returns a cost, or a vector of residuals whose sum of
            squares is minimised. It is called with the interpreter lock, by one thread at a time, and once before the
            fit. An exception ends the fit. The callable is not part of the calibration, so the calibration can be
            pickled in any case.

            Standard errors require the sum of squares or the likelihood, and robust losses the sum of squares. If there are no residuals, method
            "auto" is "quadratic-model", which switches to Nelder-Mead if it detects kinks, and to CMA-ES if it
            detects strong noise or steps.
        covariance : {"sandwich", "pooled"} or None
            Estimator of the standard errors of the fit, see `uncertainty`. They are computed after the search from
            simulations that are not included in ``nfev``: at least two per parameter and one with a tighter
            tolerance, in parallel. None: no standard errors.
        preflight : bool
            If True, examine the start first, see `preflight`. ``fit.preflight`` contains the results, and `disp`
            prints them. A relative `f_tol` below the noise of the simulations is raised to the noise, and the message
            reports it.
        noise : {"auto", "stated", "estimated"}
            Source of the noise level of the measurements, which scales them relative to the priors. The priors count
            in units of their standard deviations. "stated": weights are 1 divided by the known standard deviation of
            the noise, including weights of 1. Standard errors are then absolute, as with `sigma`. "estimated": the noise of all outputs is estimated with the parameters, and
            weights are relative. "auto": if there are priors, the noise is estimated for outputs whose weights do not
            state it (1, or a scale). This applies to the sum of squares without a robust loss.

            The first estimate uses the differences between neighbouring measurements. Then searches alternate with
            estimates from their residuals until the estimates change by less than 1 %. This usually takes two or
            three searches, each starting where the previous one ended. Limits and ``nfev`` cover all searches
            together, and the trace covers the last one. A checkpoint has one file per search (``fit.ckpt``,
            ``fit.ckpt.round2`` and so on). ``fit.noise`` contains the estimates. ``fit.cost``, ``fit.uncertainty``,
            profiles and bands use the weights divided by the noise; ``fit.rms`` uses the given weights.
        watch : bool
            If True, serve a page for a browser on this machine that shows the running fit. The page shows measured
            and simulated values, costs, parameters, running simulations and failures. A button ends the fit with the
            best point. The address is printed to standard error, and the page cannot be reached without it. After the
            fit, the page shows the report until it is closed, the returned `Fit` is deleted or the program ends.
        limits : Limits or dict, optional
            Limits of the fit: evaluations, iterations, wall-clock time and target, see `Limits`. Each limit is also
            accepted as an argument: ``max_time=60`` is short for ``limits={"max_time": 60}``.
        **given_limits
            Settings of `limits`.

        Returns
        -------
        Fit
            The fit with the best point found, regardless of how the fit ended.

        Raises
        ------
        AllStartsFailed
            The simulation failed at every starting point. ``failures`` counts the reasons.
        Interrupted
            Ctrl-C was pressed. This KeyboardInterrupt contains the fit so far in ``result``.
        FmuError
            No further simulation is possible: the FMU has returned "fatal" too often, and no further copy of its
            library can be loaded. ``partial_result`` contains the fit so far.
        ValueError, TypeError
            Invalid arguments.

        Notes
        -----
        Without a limit on evaluations, iterations or time, the limits of the method apply. For Nelder-Mead, they are
        1000 (n + 1) iterations and 5000 (n + 1) evaluations.
        """
        check_callback(callback)
        bounds = merged(Limits, "limits", limits, given_limits)
        method_options = given_once(
            _options.dictionary(options), Calibration.fit, x_tol=x_tol, f_tol=f_tol, stop=stop, initial_simplex=initial_simplex, batch=batch
        )
        for name in ("scale", "nominal", "kinds"):
            if name in method_options:
                raise ValueError(f"options: set {name} in each Parameter instead")
        given: Any = workers
        executor = _evaluate.executor_of(given)
        engine = None
        if executor is not None:
            from .simulation_executor import Simulations

            engine = Simulations(self, executor, _values.optional_number("max_time", bounds.max_time))
        count = engine.width if engine else _options.worker_count("workers", given, None)
        method_options = _options.with_plan(method_options, count)
        cost = _cost.built(objective, self)
        record = functools.partial(
            _options.record,
            Calibration.fit,
            n=len(self.names),
            rng=rng,
            checkpoint=checkpoint,
            function=cost.function,
            workers=count,
            resume=resume,
            search=search,
        )
        requested = record(method, method_options, **asdict(bounds), loss=loss, f_scale=f_scale, covariance=covariance, preflight=preflight, noise=noise)
        display = Display(self.names, disp, watch, callback, bounds)
        begin = self._values(start, "start")
        objects = {
            "start": begin,
            "observer": display.observer,
            "stages": None if stages is None else _stages.records(_stages.collected(stages), method, method_options, record),
            "objective": cost,
            "engine": engine,
            "page": display.page_opened,
        }
        try:
            with display.running():
                result = self._native.fit(requested, objects)
        except BaseException as e:
            # Results attached by the native code also become fits.
            for name in ("result", "partial_result"):
                attached = getattr(e, name, None)
                if isinstance(attached, OptimizeResult) and not isinstance(attached, Fit):
                    setattr(e, name, self._fit(attached, begin))
            raise
        fit = self._fit(result, begin)
        _log.info("fit: %s after %d evaluations", fit.message, fit.nfev)
        display.end(fit)
        return fit

    @explained
    def check(self, simulate: bool = True, *, max_time: SupportsFloat | None = None) -> _check.Check:
        """Checks model, recordings and parameters for mismatches and suggests remedies.

        The check covers the times (unit, start) and the recorded values: constant columns, placeholders, units that
        differ from the model, values far from the simulation at the start, and swapped columns. It reports inputs that
        are not driven, that end early, or whose column is all zero, missing for long or in a different unit. It also
        compares values, ranges and start values with those the model declares for its parameters, and checks the
        accuracy of the simulations.

        Parameters
        ----------
        simulate : bool
            If True, simulate all experiments once at the start values. With a fixed-step solver or co-simulation,
            also simulate them with half the step or half the communication step.
        max_time : float, optional
            Wall-clock limit of the whole check in s; default: no limit. If the limit is reached, the check returns
            the findings so far and a finding that reports the limit.

        Returns
        -------
        Check
            A sequence of findings that prints as a table. Causes come first, and more severe findings before less
            severe ones. ``ok`` is True if there are no errors and no warnings.

        Examples
        --------
        >>> from pydfo import Calibration, Parameter, example_fmu
        >>> data = {"time": [0.0, 1.0, 2.0], "x": [1000.0, 150.0, 20.0]}
        >>> calibration = Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.0, 0.1, 10.0)])
        >>> print(calibration.check(simulate=False))
        nothing found
        >>> calibration.check()[0].severity
        'warning'
        """
        return _check.of(self._native, _values.flag("simulate", simulate), _values.optional_number("max_time", max_time))

    def plot_data(self) -> Figure:
        """Draws the recordings before any simulation: measurements and inputs in the units of the model, in one
        column per experiment.

        Rows outside the windows are grey. Needs matplotlib.

        Returns
        -------
        matplotlib.figure.Figure
            The figure is not shown or saved. Save it with ``calibration.plot_data().savefig("data.png")``.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        from .._plot import data as _plot_data

        return _plot_data.recordings(self._native)

    @explained
    def preflight(self, start: npt.ArrayLike | Mapping[str, float] | None = None, workers: SupportsIndex | None = None) -> Preflight:
        """Checks the start of a fit for problems; ``print(calibration.preflight())`` shows a table.

        Each parameter is moved by a hundredth of its size, with one simulation each, in parallel. The start is
        simulated once more with a tenth of the relative tolerance, or with half the step of a fixed-step solver.

        Parameters
        ----------
        start : array_like or dict, optional
            As in `cost`.
        workers : int, optional
            Number of simulations that may run at once; None means all cores.

        Raises
        ------
        SimulationError
            The simulation fails at the start.
        ValueError, TypeError
            Invalid arguments.
        """
        return _uncertainty.before(self, self._values(start, "start"), workers)

    @explained
    def uncertainty(
        self,
        x: npt.ArrayLike | Mapping[str, float] | None = None,
        covariance: Literal["sandwich", "pooled"] = "sandwich",
        parameters: Sequence[str] | None = None,
        workers: SupportsIndex | None = None,
    ) -> Uncertainty:
        """Returns the uncertainty of a point as the result of a fit: standard errors, correlation and parameters that
        the data do not determine.

        The derivatives are central differences of the residuals. Their steps are about one standard error along the
        principal axes of the covariance. One further simulation uses a tenth of the relative tolerance, or half the
        step of a fixed-step solver. All simulations run in parallel.

        Parameters
        ----------
        x : array_like or dict, optional
            As in `cost`.
        covariance : {"sandwich", "pooled"}
            "sandwich": one residual variance per output of the model over all recordings,
            ``inv(J.T @ J) @ J.T @ S @ J @ inv(J.T @ J)``. "pooled": one residual variance for all outputs, ``s**2 * inv(J.T @ J)``. A fit with a
            robust loss uses the covariance of an M-estimator. A fit with the likelihood uses the inverse of the
            information. Autocorrelated residuals of an output are modelled as a first-order autoregression (Seber and
            Wild, Nonlinear Regression, 1989, chapter 6).
        parameters : sequence of str, optional
            Names of the free parameters. The other parameters are assumed known, so the standard errors are
            conditional.
        workers : int, optional
            Number of simulations that may run at once; None means all cores. The result does not depend on it.

        Raises
        ------
        SimulationError
            The simulation fails at the point, or on both sides of it.
        ValueError, TypeError
            Invalid arguments.
        """
        return _uncertainty.at(self, self._values(x), _values.choice("covariance", covariance), parameters, workers)

    @explained
    def cross_validate(
        self,
        folds: SupportsFloat | None = None,
        method: str = "auto",
        workers: SupportsIndex | None = None,
        x_tol: float | None = None,
        f_tol: float | None = None,
        max_evaluations: SupportsFloat | None = None,
        max_iterations: SupportsFloat | None = None,
        max_time: SupportsFloat | None = None,
        *,
        loss: Literal["linear", "soft_l1", "huber", "cauchy"] = "linear",
        f_scale: SupportsFloat = 1.0,
        rng: int | np.random.Generator | None = None,
        options: Mapping[str, Any] | None = None,
        noise: Literal["auto", "stated", "estimated"] = "auto",
    ) -> CrossValidation:
        """Fits without some of the recordings and validates on the omitted ones.

        A good model predicts an omitted recording as well as it reproduces the fitted recordings. Its parameters are
        similar whichever recording is omitted. Local parameters of an omitted recording, and parameters that act in no
        other recording, cannot be predicted. They are fitted to the omitted recording while all others are held fixed;
        ``fold.validation.fitted`` and the table list them.

        Parameters
        ----------
        folds : int, optional
            Number of groups of recordings. The recordings are assigned to the groups in turn. One group at a time is
            omitted. By default, each recording is its own group.
        method, x_tol, f_tol, max_evaluations, max_iterations, loss, f_scale, rng, options, noise : optional
            Settings of each fit, as in `fit`.
        workers : int, optional
            Number of simulations that may run at once; None and -1 mean all cores. The fits run in parallel.
        max_time : float, optional
            Limit on the wall-clock time of all fits together, in s.

        Returns
        -------
        CrossValidation
            RMS of each recording when it was omitted, and the parameters of each fit.

        Raises
        ------
        ValueError
            There is only one recording, or there are more folds than recordings.
        """
        method_options = given_once(_options.dictionary(options), Calibration.cross_validate, x_tol=x_tol, f_tol=f_tol)
        requested = _options.record(
            Calibration.fit,
            method,
            method_options,
            len(self.names),
            rng=rng,
            workers=_options.worker_count("workers", workers, None),
            max_evaluations=max_evaluations,
            max_iterations=max_iterations,
            max_time=max_time,
            loss=loss,
            f_scale=f_scale,
            noise=noise,
            folds=folds,
        )
        return CrossValidation(_core.cross_validate(self._native, requested))

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
        """Estimates the effect of each parameter on the cost and on the RMS error of each output, over the whole box of
        the bounds.

        Parameters vary independently and uniformly on their scale. Constraints between parameters are ignored. Points
        whose simulation fails are left out and counted.

        Parameters
        ----------
        method : {"morris", "sobol"}
            "morris": elementary effects, with ``n * (D + 1)`` simulations of all experiments for D free parameters.
            "sobol": first- and total-order indices, with ``n * (D + 2)`` simulations, or ``n * (2 * D + 2)`` with
            `second_order`.
        n, levels, second_order, level, n_resamples, rng : optional
            As in `pydfo.sensitivity`.
        workers : int, optional
            Number of simulations that may run at once; None and -1 mean all cores. The result does not depend on it.
        max_time : float, optional
            Limit on the wall-clock time in s. The result then contains the effects from the complete trajectories or
            rows.
        checkpoint : path, optional
            File for the evaluations. An existing file of the same analysis is continued; another one is rejected.

        Returns
        -------
        Sensitivity
            ``outputs`` are "cost" and ``rms(VARIABLE)``, with the name of the experiment if there are several.

        Raises
        ------
        ValueError, TypeError
            Invalid arguments, or a free parameter without finite bounds.
        CalibrationError
            Fewer than two trajectories or rows are complete.
        CheckpointError, OSError
            The file belongs to another analysis, or cannot be read or written.
        Interrupted
            Ctrl-C was pressed. ``result`` contains the effects from the complete trajectories or rows, if there are at
            least two.
        """
        numbers = analysis(method, n, levels, second_order, level, n_resamples)
        with partial_results():
            return Sensitivity(
                _core.calibration_sensitivity(
                    self._native,
                    numbers,
                    _options.seed(rng),
                    _options.worker_count("workers", workers, None),
                    None if max_time is None else _values.number("max_time", max_time),
                    None if checkpoint is None else _values.path("checkpoint", checkpoint),
                )
            )

    def _fit(self, result: OptimizeResult, start: list[float]) -> Fit:
        if isinstance(result, ParetoFront):
            # Only a design has several objectives.
            return result  # type: ignore[return-value]
        return Fit(self, result, np.array(start), self._native.solver())

    def __setattr__(self, name: str, value: object) -> None:
        # An attribute with the name of an argument would have no effect.
        if name in argument_names(Calibration.__init__):
            raise AttributeError(f"{name} cannot be changed; create another Calibration({name}=...)")
        super().__setattr__(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self._native.state(), self._parameters, self._opened, self._functions)

    def __repr__(self) -> str:
        return f"<Calibration of {_text.names(self.names)} in {self._model}: {self.n_measurements} measurements>"


def _solver(name: str) -> str:
    """Returns the name of an integration method, and warns if it replaces the method of another tool."""
    ours = _options.solver(name)
    if ours != name:
        warnings.warn(f"{name} is not available; using solver={ours!r} instead", CalibrationWarning, stacklevel=5)
    return ours


def _restore(
    of: type[Calibration],
    state: bytes,
    parameters: tuple[Parameter, ...],
    opened: OpenOptions | None,
    functions: list[tuple[int, str, Any]],
) -> Calibration:
    """Restores a pickled calibration."""
    path, content = _core.Calibration.model_of(state)
    try:
        fmu = _core.Fmu(path, opened)
    except FileNotFoundError:
        what = f"the model of a pickled Calibration (SHA-256 of its content: {content}) was not found"
        raise FileNotFoundError(errno.ENOENT, what, os.fspath(path)) from None
    calibration = of.__new__(of)
    calibration._parameters = parameters
    calibration._model = os.fspath(path)
    calibration._opened = opened
    calibration._functions = functions
    calibration._native = _core.Calibration.restore(state, fmu, functions)
    return calibration
