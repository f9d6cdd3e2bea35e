"""`Calibration`: a model, measurements and parameters."""

from __future__ import annotations

import errno
import logging
import os
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing, nullcontext
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
from .._optimize.fmin import Callback, check_callback, combine, listen
from .._optimize.live_line import DELAY, LiveLine, is_watched
from .._optimize.progress import Printer
from .._optimize.result import OptimizeResult
from . import check as _check
from . import cost as _cost
from . import stages as _stages
from . import uncertainty as _uncertainty
from . import worker as _worker
from .evaluation import Evaluation
from .experiment import Inputs, Names, Weights, collected, path_of
from .fit import Fit
from .parameter import Parameter
from .stages import Stage
from .uncertainty import Preflight, Uncertainty
from .validation import CrossValidation

if TYPE_CHECKING:
    import concurrent.futures

    from matplotlib.figure import Figure

_log = logging.getLogger("pydfo")


class Calibration(Evaluation):
    """A model, measurements and parameters to be fitted.

    The cost is the sum of the squared weighted residuals (simulated minus measured, times weight) over all outputs and
    measured times, added up in the order of `residuals`. Simulations run without the interpreter lock, and stop early
    in a fit when their cost can no longer matter. The same parameters give the same bits, always.

    One recording is given by `data` and `outputs`; several by a list of `Experiment`, each with its own inputs, window,
    weights and start values: ``Calibration(model, [Experiment(...), ...], parameters)``. The cost is then the sum over all
    of them.

    It can be pickled and copied: with the recordings by value, and the model by the path of its file and a hash of the content,
    which must be the same where it is unpickled.

    Parameters
    ----------
    model : path or FMUModel
        The FMU. Values that were set in an FMUModel do not count (a warning says so); give them as `start_values`.
    data : path, dict of arrays, DataFrame, Series, xarray or structured array
        The recording (or a list of `Experiment`): a column of times (ascending, intervals as they come) and what was measured. NaN, None and
        empty cells are missing values. A CSV file has one line of names, which a line of units may follow; commas, semicolons or tabs
        separate, and where no commas do, numbers may have decimal commas (all of them: a file with commas and points is refused).
        Other files are read by the library that Python people use for them: ``.mat`` (SciPy; h5py for version 7.3), ``.xlsx``
        (openpyxl; the first sheet, as a CSV file) and ``.parquet`` (pyarrow). Of a ``.mat`` file all variables that are as long as the
        times are columns: fields of structs are called ``rig.x``, the columns of a matrix ``y[1]``, ``y[2]``.
        The times are those of the column (or the named index of a DataFrame) ``time``, in any case, or of an index of dates; a unit in
        brackets or parentheses is read, ``time [ms]``: s, ms, us, ns, min, h, d (exactly so). Durations
        (``timedelta64``, ``datetime.timedelta``) are times, too, and so are dates and times of day (``datetime64``, ``datetime``, texts as
        2024-05-31T13:45:10.5 or 31.05.2024 13:45:10): s since the first.
        A column may state its unit (``phi [deg]``, ``T (degC)``), and be named without (``phi``). Where the model states that of the
        variable, too, it is converted; units of another quantity are an error. Costs, results and plots are in the units of the model.
    outputs : dict of str to str, or list of str
        Which output of the model was measured by which column; a list if they have the same names. A simulation in which
        one of them is NaN or infinite where something was measured counts as failed.
    parameters : sequence of Parameter
        What is fitted. The entries of every ``x`` are in this order; a local parameter has one entry per experiment in its
        place.
    inputs : dict, or list of str, optional
        Which input of the model is driven by which column: linearly between the rows if the input is continuous, else
        held. A time that stands there twice is a jump. In a dict also by a number or a function of time, see `Experiment`.
    window : (float, float), optional
        Only measurements at times in this interval count, in s; the simulation still starts at its start time.
    timeout : float, optional
        Wall-clock limit of one simulation in s. One that reaches it counts as failed. (The limit of a whole fit is the `max_time` of
        `fit`.)
    weights : dict, or sequence, optional
        Per output, what its residuals are multiplied with (default 1): the inverse of the standard deviation of its noise,
        if that is known; or a weight per measurement, or "range", "mean", "sd", see `Experiment`.
    start_values : dict, optional
        Values of other parameters and start values of variables, by name; not of those that are fitted.
    relative_tolerance : float, optional
        Of the integration; default: that of the model's default experiment, but at most 1e-6 (a larger one makes the cost noisy), else
        1e-6. A fit simulates with a smaller one where it needs it: unless its `f_tol` is 100 times the model's tolerance or more, it
        takes so many tenths that errors of that part of the measurements leave the cost uncertain by less than `f_tol` near the best
        values (``fit.tolerance``, and a note among the findings).
    solver : str
        "auto", "tsit5", "dop853", "radau5", "bdf", "rk4" or "euler". With "auto" each simulation begins with an explicit method and
        changes to an implicit one where the model is stiff.
    step_size, max_step : float, optional
        Step of the fixed-step methods, or the communication step of co-simulation; largest step of the other methods;
        in s. Measurements between the steps of a co-simulation that cannot stop there are compared with values interpolated
        linearly between the steps, see `between_steps` in `FMUModel.simulate`.
    interior_samples : int, optional
        Points within each step at which event indicators are looked at, as in `FMUModel.simulate`.
    chattering : {"error", "warn", "slide"}
        What happens when state events follow each other so closely that time hardly advances, as in `FMUModel.simulate`;
        a simulation that ends with the error counts as failed.
    start_time : float, optional
        Where simulations start, in s; default: the model's default experiment, else 0. It must be given where the recording
        begins more than ten of its sampling intervals later.
    kind : {"auto", "ME", "CS"}, optional
        How the model is run, as in `FMUModel`; default: as the FMUModel that is given, else "auto".
    input_derivatives : bool
        Whether co-simulations are told the derivatives of their inputs, as in `FMUModel.simulate`.
    isolation : {"process", "none"}
        Where the FMU runs; no cost depends on it. "process": in processes of its own, one per worker, started when they are needed
        and ended with the calibration, at the latest with this process. Whatever happens there (a crash, a hang beyond
        `timeout`, `exit`, more memory than `memory_limit`) is an evaluation that failed, with its reason. "none": in this
        process, one simulation at a time. Inputs that are functions are always called in this process.
    memory_limit : float, optional
        Bytes of memory that a process of the FMU may have; default: the memory of the machine.
    sandbox : bool
        Confine the processes of the FMU: they write into a folder of their own only, which is removed with them, open no
        connections and reach no other process (Linux with Landlock; SECURITY.md lists what remains possible). An error where the
        system cannot do that, and with ``isolation="none"``.
    max_description_bytes : int, optional
        Largest size of ``modelDescription.xml`` where `model` is a path; default 64 MiB. An FMUModel has its own limit.
    units : dict of str to str, optional
        Units of outputs and inputs of which the model states none: ``{"room.T": "K"}``. Columns that state a unit are converted to it.
    time : str, optional
        Name of the column of times, where it is not ``time``; its unit may be left out.
    mask : array of bool or str, optional
        Rows whose measurements count, one entry per row, or the column that says so (neither 0 nor missing). Inputs count in all rows.
    resample : float, optional
        Interval in s over which the times and all columns are replaced by their means (of what the mask leaves); at least that of the
        recording. Weights become those of the means, see `Experiment`.
    initial_states, windows, warm_up, delays, hold_inputs : optional
        Of the one recording, as in `Experiment`.

    Warns
    -----
    CalibrationWarning
        A column that is not used has the name of an input that nothing drives, but for its case perhaps;
        values set in an FMUModel do not count; a setting has no effect (`step_size` with a solver that chooses its
        steps itself, `max_step` with one that does not, ...).

    Raises
    ------
    OSError
        A file cannot be read.
    FmuError
        The FMU cannot be used.
    KeyError
        The model has no such variable; the nearest names are offered.
    ValueError, TypeError
        Data, parameters or settings that do not fit together; the message says which, where, and with which numbers.
    """

    @also_called(input="inputs", output="outputs")
    def __init__(
        self,
        model: Any,
        data: Any,
        outputs: Names | Sequence[Parameter] | Parameter | None = None,
        parameters: Sequence[Parameter] | Parameter | None = None,
        inputs: Inputs | None = None,
        window: tuple[float, float] | None = None,
        timeout: SupportsFloat | None = None,
        weights: Weights | None = None,
        start_values: Mapping[str, Any] | str | os.PathLike[str] | None = None,
        relative_tolerance: SupportsFloat | None = None,
        solver: str = "auto",
        step_size: SupportsFloat | None = None,
        max_step: SupportsFloat | None = None,
        start_time: SupportsFloat | None = None,
        kind: str | None = None,
        chattering: Literal["error", "warn", "slide"] = "error",
        input_derivatives: bool = True,
        time: str | None = None,
        *,
        isolation: Literal["process", "none"] = "process",
        memory_limit: SupportsFloat | None = None,
        sandbox: bool = False,
        max_description_bytes: int | None = None,
        interior_samples: SupportsIndex | None = None,
        units: Mapping[str, str] | None = None,
        initial_states: Mapping[str, SupportsFloat | str | Parameter] | None = None,
        windows: Sequence[tuple[float, float]] | None = None,
        warm_up: SupportsFloat | None = None,
        delays: Mapping[str, SupportsFloat] | None = None,
        hold_inputs: bool | None = None,
        mask: Any = None,
        resample: SupportsFloat | None = None,
    ) -> None:
        if isolation == "process":
            # An interpreter starts while data and model are read; it ends with this object if nothing is evaluated.
            self._started_ahead = _core.start_worker_ahead()
        own: dict[str, Any] = {
            "window": window,
            "weights": weights,
            "start_values": start_values,
            "start_time": start_time,
            "time": time,
            "initial_states": initial_states,
            "windows": windows,
            "warm_up": warm_up,
            "delays": delays,
            "hold_inputs": hold_inputs,
            "mask": mask,
            "resample": resample,
        }
        experiments, parameters = collected(data, outputs, parameters, inputs, **own)
        needed = "parameters must be a list of pydfo.Parameter(name, start, lower, upper)"
        if not isinstance(parameters, (Parameter, Iterable)):
            raise TypeError(f"{needed}, not {_text.show(parameters)}")
        self._parameters = (parameters,) if isinstance(parameters, Parameter) else tuple(parameters)
        for parameter in self._parameters:
            if not isinstance(parameter, Parameter):
                raise TypeError(f"{needed}, not of {_text.show(parameter)}")
        settings: dict[str, Any] = {
            "kind": getattr(model, "kind", "auto") if kind is None else kind,
            "timeout": timeout,
            "relative_tolerance": relative_tolerance,
            "solver": _solver(solver),
            "step_size": step_size,
            "max_step": max_step,
            "interior_samples": interior_samples,
            "chattering": chattering,
            "input_derivatives": input_derivatives,
            "isolation": isolation,
            "memory_limit": memory_limit,
            "sandbox": sandbox,
            "max_description_bytes": max_description_bytes,
            "units": dict(_values.units(units)),
        }
        self._model = path_of(model)
        self._opened: OpenOptions | None = getattr(model, "_opened", None)
        if self._opened is None and max_description_bytes is not None:
            self._opened = OpenOptions(max_description_bytes=size_limit("max_description_bytes", max_description_bytes))
        opened = getattr(model, "_fmu", None)
        source = opened if isinstance(opened, _core.Fmu) else self._model
        self._functions = [
            (k, variable, source)
            for k, experiment in enumerate(experiments)
            for variable, source in experiment.inputs
            if callable(source)
        ]
        self._native = _core.Calibration(source, experiments, settings, list(self._parameters))
        for warning in self._native.warnings():
            warnings.warn(warning, CalibrationWarning, stacklevel=3)
        if isolation == "process" and not _worker.is_known:
            said = f"the FMU runs in this process: no Python interpreter is found to start others (sys.executable is {sys.executable!r})"
            warnings.warn(said, CalibrationWarning, stacklevel=2)
        given = {name for parameter in self._parameters for name in (parameter.name, *(parameter.variables or ()))}
        given.update(name for experiment in experiments for name, _ in experiment.start_values + experiment.initial_states)
        if forgotten := [name for name in getattr(model, "_names_set", list)() if name not in given]:
            warnings.warn(
                f"values set in an FMUModel do not count in a calibration: {_text.listed(forgotten)}; give them as "
                "start_values, if they shall",
                CalibrationWarning,
                stacklevel=3,
            )

    @explained
    def fit(
        self,
        method: str = "auto",
        workers: SupportsIndex | concurrent.futures.Executor | None = None,
        x_tol: float | None = None,
        f_tol: float | None = None,
        max_evaluations: SupportsFloat | None = None,
        max_iterations: SupportsFloat | None = None,
        max_time: SupportsFloat | None = None,
        target: SupportsFloat | None = None,
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
    ) -> Fit:
        """Fits the parameters, without the interpreter lock.

        Parameters
        ----------
        method : str
            The optimiser: "least-squares", which takes the residuals of the simulations one by one (see `least_squares`), and those
            of `minimize`: "nelder-mead", "barrier", "quadratic-model", "cma-es", "pattern-search", "multistart", "de", "de-classic",
            "ga". The last four need two finite bounds for every parameter. "auto" is "least-squares", with integer parameters "de", with categorical
            ones "ga"; where an option is given that only "nelder-mead" has, it is that. The fit has the reason
            (``method_reason``).
        workers : int or concurrent.futures.Executor, optional
            Simulations that may run at once; None and -1: all cores. Or an executor (of `concurrent.futures`, Dask, MPI, joblib, Ray) that
            makes the simulations of the search point by point: problem and model travel to each of its processes once. What comes
            before the search and after it is simulated here. The fit is the same, bit for bit, for any number and any executor.
        x_tol : float, optional
            Tolerance of the x test (default 1e-4): extent of the simplex in units of the parameters' sizes (see `Parameter`). For a log
            scale: of the logarithm.
        f_tol : float, optional
            Tolerance of the f test (default 1e-4): difference between the worst and the best vertex as a fraction of the best cost.
        max_evaluations, max_iterations : int, optional
            Exact limits of the search: simulations (those of `Fit.n_checks` come after it) and iterations.
        max_time : float, optional
            Limit of wall-clock time in s.
        target : float, optional
            End the fit with the first evaluation whose cost is at or below this, for any number of workers. What was evaluated
            at once with it and comes after it counts as speculative.
        stop : {"all", "any"}, optional
            Whether both tests must hold (the default), or one ends the fit.
        batch : {"auto", "serial", "ahead"}, "rounds", "workers" or int
            Nelder-Mead and barrier: how many trial points are simulated at once in an iteration; see `fmin`. Least squares:
            "serial", "rounds", a number of points, or "workers"; see `least_squares`.
        disp : bool, optional
            True: show a line that follows the fit where standard error is a terminal or a notebook (by rich, where that is
            installed), else print a line per iteration, as `fmin` does; and how the fit ended. False: show nothing. None: show the
            line in a terminal or a notebook where the fit lasts more than 2 s.
        callback : callable, optional
            Called after each iteration with a `Progress`, on the calling thread; StopIteration or True end the fit.
        loss, f_scale : optional
            What a residual of a measurement counts, see `least_squares`, by every method: "soft_l1", "huber" and "cauchy" keep outliers
            from deciding. Priors count by their squares.
            Cost and rms of the fit are those of what the residuals count then; `Fit.residuals` has the plain ones.
        start : array_like or dict, optional
            Another start than that of the parameters.
        initial_simplex : array_like, optional
            Vertices or steps; see `fmin`. Steps of parameters on a log scale are steps of the logarithm.
        rng : int or numpy.random.Generator, optional
            The seed of what is random, or a generator to draw it from; None draws one. It stands in the fit (``seed``).
        options : dict, optional
            What else the method can be told, see `minimize` (scales and sizes are those of the parameters). ``max_failed``: the share of
            evaluations whose failure ends the fit, with its best point.
        checkpoint, resume : optional
            A file for the state of the fit, and whether to continue from it; see `minimize`. A file that belongs to
            another model, other data, parameters, settings or, where `objective` is a function, to a function with another name is
            refused, saying what differs. The message of a fit that was continued says so.
        search : {"local", "global"}
            With method "auto": the minimum next to the start, or the best within the bounds of the parameters, by least squares from
            several starts ("multistart"), which needs two finite bounds for every parameter; the minima found are the
            fit's ``optima``.
        stages : list of Stage, or of lists of names, optional
            ``[["C2", "G2"], ["C1", "G1"]]``: each stage frees these parameters, from where the last one left them, and holds the
            others. Limits hold for all stages together, ``nfev`` and the trace are those of all; the fit has that of each stage in
            ``stages``. A checkpoint has a file for each: ``fit.ckpt.stage1``, ``fit.ckpt.stage2`` and so on.
        objective : str or callable
            What is minimised: "sum-of-squares" of the residuals (with weights of 1/sigma, the inverse standard deviation of the noise, the
            likelihood with known noise), "mae" (mean absolute error), "rmse", "nrmse" (mean over the outputs of RMSE over the range of
            the measurements), "likelihood" (with an unknown standard deviation of the noise for each output:
            ``sum N_o / 2 ln(r_o' r_o / N_o)``); or a function of (measured, simulated), dicts of arrays by output (with several
            experiments: dicts of such by their names), that returns a cost or a vector of residuals, whose sum of squares is minimised.
            It is called with the interpreter lock, by one thread at a time, and once before the fit; what it raises ends the fit. It is
            no part of the calibration, which can be pickled in any case. Only the sum of squares has standard errors and robust losses;
            where there are no residuals, method "auto" is "quadratic-model", which hands over to Nelder-Mead where noise or kinks show.
        covariance : {"sandwich", "pooled"} or None
            How the standard errors of the fit are estimated, see `uncertainty`. Found out after the run, with simulations that do not
            count in ``nfev``: at least two for each parameter and an accurate one, in parallel. None: not at all.
        preflight : bool
            Look at the start first, see `preflight`; the fit has what was found (``fit.preflight``), and `disp` prints it. A
            relative `f_tol` below the noise of the simulations is raised to it, with a word in the message.
        noise : {"auto", "stated", "estimated"}
            Where the noise of the measurements is taken from, beside which priors count in units of their standard deviations. "stated":
            weights are 1 over its standard deviation, also those of 1. "estimated": of all outputs with the parameters; weights are
            relative. "auto": where there are priors, that of outputs whose weights state none (1, or by a scale) is estimated, for the
            sum of squares without a robust loss. The first estimate is that of the differences between neighbouring measurements; then
            searches take turns with estimates from their residuals, until these change by less than 1 %: mostly two or three searches,
            each from where the last one ended. Limits and ``nfev`` are those of all together, the trace is that of the last, and a
            checkpoint has a file for each (``fit.ckpt``, ``fit.ckpt.round2`` and so on). ``fit.noise`` has the estimates; ``fit.cost``,
            ``fit.uncertainty``, profiles and bands are those with weights over them, ``fit.rms`` that with the weights as given.
        watch : bool
            Serve a page for a browser of this machine that shows the fit while it runs: measured against simulated, the costs, the
            parameters, what is under way, what failed, with a button that ends the fit with the best point. Its address, without
            which nobody gets at it, is printed to standard error. Afterwards it shows the report, until the page is closed,
            the `Fit` that is returned is gone, or the program ends.

        Returns
        -------
        Fit
            However the fit ends, with the best point that was seen.

        Raises
        ------
        AllStartsFailed
            The simulation failed at every starting point; the reasons are counted in its ``failures``.
        Interrupted
            Ctrl-C: a KeyboardInterrupt with the fit so far in ``result``.
        FmuError
            No simulation can be made any more: the FMU has answered "fatal" too often, and no further copy of its library can
            be loaded. The fit so far is in ``partial_result``.
        ValueError, TypeError
            Arguments that cannot be used.

        Notes
        -----
        Without any of the three limits the method's own hold: for Nelder-Mead 1000 (n + 1) iterations or 5000 (n + 1)
        evaluations.
        """
        check_callback(callback)
        own = given_once(
            _options.dictionary(options), Calibration.fit, x_tol=x_tol, f_tol=f_tol, stop=stop, initial_simplex=initial_simplex, batch=batch
        )
        for name in ("scale", "nominal", "kinds"):
            if name in own:
                raise ValueError(f"options: {name} of a fit is that of its parameters")
        given: Any = workers
        executor = _evaluate.executor_of(given)
        engine = None
        if executor is not None:
            from .simulation_executor import Simulations

            engine = Simulations(self, executor, _values.optional_number("max_time", max_time))
        count = engine.width if engine else _options.worker_count("workers", given, None)
        own = _options.with_plan(own, count)
        cost = _cost.built(objective, self)

        def record(method: str, own: Mapping[str, Any], **more: Any) -> _options.Record:
            return _options.record(
                Calibration.fit,
                method,
                own,
                len(self.names),
                rng=rng,
                checkpoint=checkpoint,
                function=cost.function,
                workers=count,
                resume=resume,
                search=search,
                **more,
            )

        asked = record(
            method,
            own,
            max_evaluations=max_evaluations,
            max_iterations=max_iterations,
            max_time=max_time,
            target=target,
            loss=loss,
            f_scale=f_scale,
            covariance=covariance,
            preflight=preflight,
            noise=noise,
        )
        of_stages = None if stages is None else _stages.records(_stages.collected(stages), method, own, record)
        begin = self._values(start, "start")
        printer = Printer(self.names)
        shown = disp if disp is None else _values.flag("disp", disp)
        live: LiveLine | None = None
        page: _core.LivePage | None = None

        def opened(started: _core.LivePage) -> None:
            nonlocal page
            page = started
            print(f"watch the fit at {page.url}", file=sys.stderr, flush=True)

        watched = opened if _values.flag("watch", watch) else None
        listeners: list[Callback] = []
        if shown is not False and is_watched():
            live = LiveLine(self.names, DELAY if shown is None else 0.0, max_evaluations, max_iterations, max_time)
            listeners.append(live)
        elif shown:
            listeners.append(printer)
        if callback is not None:
            listeners.append(listen(callback))
        observer = combine(listeners)
        if live:
            # Called between iterations, too.
            setattr(observer, "tick", live.tick)
        try:
            with closing(live) if live else nullcontext():
                objects = {"start": begin, "observer": observer, "stages": of_stages, "objective": cost, "engine": engine, "page": watched}
                result = self._native.fit(asked, objects)
        except BaseException as e:
            if page is not None:
                page.show_error(f"{type(e).__name__}: {e}")
            # What the native code attached becomes a fit, too.
            for name in ("result", "partial_result"):
                attached = getattr(e, name, None)
                if isinstance(attached, OptimizeResult) and not isinstance(attached, Fit):
                    setattr(e, name, self._fit(attached, begin))
            raise
        fit = self._fit(result, begin)
        # It is served as long as there is the fit.
        if page is not None:
            fit._page = page
        _log.info("fit: %s; cost %r after %d evaluations", fit.message, fit.cost, fit.nfev)
        if disp and fit.preflight is not None:
            print(fit.preflight)
        if disp:
            printer.end(fit.message, fit.x, fit.cost, fit.nit, fit.nfev, fit.solve_time)
        return fit

    @explained
    def check(self, simulate: bool = True, *, max_time: SupportsFloat | None = None) -> _check.Check:
        """Looks for what does not fit between model, recordings and parameters, and says what to do about it.

        It compares the times (unit, start), the recorded values (constant, placeholders, in other units than the model, far from the
        simulation at the start, columns that are swapped), inputs that nothing drives, that end early, or whose column is all zero,
        missing for long or in another unit, values, ranges and start values that the model states for its parameters, and the accuracy
        of the simulations.

        Parameters
        ----------
        simulate : bool
            Whether to simulate all experiments once at the start values (and once with half the step, where that is fixed, or half
            the communication step).
        max_time : float, optional
            Wall-clock limit of the whole check in s; default: none. What was found until then is the result, with a finding that says so.

        Returns
        -------
        Check
            A sequence of findings, causes and the gravest first, which prints as a table; its ``ok`` says whether there are neither errors nor warnings.

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
        """Draws the recordings before anything is simulated: measurements and inputs in the units of the model, the rows outside of the
        windows in grey; a column per experiment. Needs matplotlib.

        Returns
        -------
        matplotlib.figure.Figure
            Nothing is shown or saved: ``calibration.plot_data().savefig("data.png")``.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        from .._plot import data as _plot_data

        return _plot_data.recordings(self._native)

    @explained
    def preflight(self, start: npt.ArrayLike | Mapping[str, float] | None = None, workers: SupportsIndex | None = None) -> Preflight:
        """Looks before a fit at what would spoil it; ``print(calibration.preflight())`` shows a table.

        Each parameter is moved by a hundredth of its size (one simulation each, in parallel), and the start is simulated once
        more with a tenth of the relative tolerance (with a fixed-step solver: half the step).

        Parameters
        ----------
        start : array_like or dict, optional
            As in `cost`.
        workers : int, optional
            Simulations that may run at once; None: all cores.

        Raises
        ------
        SimulationError
            The simulation fails at the start.
        ValueError, TypeError
            Arguments that cannot be used.
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
        """Uncertainty of a point as the result of a fit: standard errors, correlation, what the data cannot tell.

        From central differences of the residuals over steps of about one standard error along the principal axes of the
        covariance, and one simulation with a tenth of the relative tolerance (with a fixed-step solver: half the step); all in parallel.

        Parameters
        ----------
        x : array_like or dict, optional
            As in `cost`.
        covariance : {"sandwich", "pooled"}
            With one residual variance per output of the model, over all of its recordings:
            ``inv(J.T @ J) @ J.T @ S @ J @ inv(J.T @ J)``; or with one for all: ``s**2 * inv(J.T @ J)``. Of a fit with a robust loss it is
            that of an M-estimator, of one with the likelihood the inverse of its information; where the residuals of an output are
            autocorrelated they are taken for a first-order autoregression (Seber and Wild, Nonlinear Regression, 1989, chapter 6).
        parameters : sequence of str, optional
            Only these are free, the others are taken as known: the standard errors are conditional then.
        workers : int, optional
            Simulations that may run at once; None: all cores. The result does not depend on it.

        Raises
        ------
        SimulationError
            The simulation fails there, or on both sides of it.
        ValueError, TypeError
            Arguments that cannot be used.
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
        """Fits without some of the recordings, and validates on those that were left out.

        A fit that describes the machine predicts a recording as well as it reproduces those that it was fitted to, with much the same
        parameters whichever is left out. Local parameters of a recording that is held out are fitted to it, all others held.

        Parameters
        ----------
        folds : int, optional
            Into how many groups the recordings are divided (each k-th recording in one), of which one is held out at a time; default:
            each recording alone.
        method, x_tol, f_tol, max_evaluations, max_iterations, loss, f_scale, rng, options, noise : optional
            Of each fit, as in `fit`.
        workers : int, optional
            Simulations that may run at once; the fits run side by side. None and -1: all cores.
        max_time : float, optional
            Limit of wall-clock time of all fits together, in s.

        Returns
        -------
        CrossValidation
            RMS of each recording when it was held out, and the parameters of each fit.

        Raises
        ------
        ValueError
            There is only one recording, or there are more folds than recordings.
        """
        own = given_once(_options.dictionary(options), Calibration.cross_validate, x_tol=x_tol, f_tol=f_tol)
        asked = _options.record(
            Calibration.fit,
            method,
            own,
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
        return CrossValidation(_core.cross_validate(self._native, asked))

    def _fit(self, result: OptimizeResult, start: list[float]) -> Fit:
        return Fit(self, result, np.array(start), self._native.solver())

    def __setattr__(self, name: str, value: object) -> None:
        # An attribute of that name would have no effect.
        if name in argument_names(Calibration.__init__):
            raise AttributeError(f"{name} cannot be changed: make another Calibration({name}=...)")
        super().__setattr__(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self._native.state(), self._parameters, self._opened, self._functions)

    def __repr__(self) -> str:
        return f"<Calibration of {_text.names(self.names)} in {self._model}: {self.n_measurements} measurements>"


def _solver(name: str) -> str:
    """The name of an integration method; says which one stands for that of another tool."""
    ours = _options.solver(name)
    if ours != name:
        warnings.warn(f"there is no {name} here: solver={ours!r} is used instead", CalibrationWarning, stacklevel=4)
    return ours


def _restore(
    of: type[Calibration],
    state: bytes,
    parameters: tuple[Parameter, ...],
    opened: OpenOptions | None,
    functions: list[tuple[int, str, Any]],
) -> Calibration:
    """A pickled calibration."""
    path, content = _core.Calibration.model_of(state)
    try:
        fmu = _core.Fmu(path, opened)
    except FileNotFoundError:
        what = f"the model of a pickled Calibration (SHA-256 of its content: {content}) is not where it was"
        raise FileNotFoundError(errno.ENOENT, what, os.fspath(path)) from None
    calibration = of.__new__(of)
    calibration._parameters = parameters
    calibration._model = os.fspath(path)
    calibration._opened = opened
    calibration._functions = functions
    calibration._native = _core.Calibration.restore(state, fmu, functions)
    return calibration
