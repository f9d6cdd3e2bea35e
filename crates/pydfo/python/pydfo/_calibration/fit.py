"""The result of a fit."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import values as _values
from .._args.keywords import also_called, explained
from .._model.trajectory import SimulationStats
from .._optimize.result import OptimizeResult
from . import export as _export
from . import profile as _profile
from . import validation as _validation
from .check import Finding
from .experiment import Experiment
from .export import PathLike
from .profile import Profile
from .stages import Windows
from .uncertainty import Preflight, Uncertainty
from .validation import Validation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .calibration import Calibration

FloatArray = npt.NDArray[np.float64]


class OutputFit(NamedTuple):
    """How well a fit reproduces one output of one experiment."""

    experiment: str
    """The experiment."""
    variable: str
    """The variable of the model."""
    column: str
    """The column that measured it."""
    unit: str | None
    """The unit of the variable, where the model states it."""
    n: int
    """How many measurements count."""
    rms: float
    """Root of the mean squared difference between simulation and measurement, without weights, in the unit of the variable."""
    start_rms: float | None
    """The same at the start; None if the simulation failed there."""
    fit_percent: float
    """Fit percentage: ``100 (1 - norm(simulated - measured) / norm(measured - mean))``; NaN where the measurements do not vary."""


class FitNoise(NamedTuple):
    """Where a fit has the noise of the measurements from, beside which priors count."""

    source: Literal["stated", "estimated"]
    """By the weights, which are 1 over its standard deviation, or estimated with the parameters."""
    sd: dict[str, float]
    """The estimated standard deviation of each variable, in its unit; where its weights state something, times the weight."""
    of_residuals: dict[str, bool]
    """Whether it is that of the residuals; else of the differences between neighbouring measurements: there were too few residuals, or
    the search was ended."""
    n_rounds: int
    """Searches that were made."""
    settled: bool
    """Whether the residuals of the last one confirm the estimates to 1 %."""


class ChosenTolerance(NamedTuple):
    """The relative tolerance that a fit has chosen for its simulations."""

    used: float
    """That of the simulations."""
    stated: float
    """That of the model, or the default."""
    noise: float | None
    """How uncertain the cost is expected to be near the best values, as part of it, with the tolerance of the calibration; None: it
    was not looked at."""


def _noise(found: Any) -> FitNoise | None:
    """The noise as the native code has it: nothing, "stated", or the estimates."""
    if not isinstance(found, dict):
        return None if found is None else FitNoise("stated", {}, {}, 0, True)
    estimated = found["estimated"]
    sds = {output["variable"]: output["sd"] for output in estimated["outputs"]}
    of_residuals = {output["variable"]: output["is_of_residuals"] for output in estimated["outputs"]}
    return FitNoise("estimated", sds, of_residuals, estimated["n_rounds"], estimated["is_settled"])


#: The fields of a fit of which there is no more than the last iteration.
_UNKNOWN: dict[str, Any] = {
    **dict.fromkeys(("noise", "tolerance", "stats", "preflight", "uncertainty", "start_cost", "start_rms")),
    **{name: [] for name in ("stages", "findings", "outputs", "without_effect")},
    "success": False,
    "usable": True,
    "at_bound": {},
    "n_checks": 0,
    "skipped": [],
    "objective": "",
}


class Fit(OptimizeResult):
    """The result of a fit: all that an `OptimizeResult` has, with names and in terms of the measurements.

    ``print(fit)`` shows it as a table, a notebook as a better one, and `report` writes a page.

    Attributes
    ----------
    x : ndarray, shape (n,)
        The fitted values, in the order of the parameters; fixed ones included.
    parameters : dict of str to float
        The same by name.
    cost : float
        Sum of the squared weighted residuals there (the same as ``fun``), by weights over the `noise` where that was estimated; with a
        loss, of what they count; with another `objective`, its value.
    objective : str
        Name of the cost that was minimised.
    rms : float
        Root of the mean squared weighted residual there, by the weights of the calibration, before a loss.
    noise : FitNoise or None
        Where the noise of the measurements was taken from, beside which priors count: ``fit.noise.source``, ``fit.noise.sd``. None:
        nothing depended on it (no priors, or another objective than the sum of squares).
    tolerance : ChosenTolerance or None
        The relative tolerance that was chosen for the simulations; None: it was given, or that of the calibration.
    start : ndarray, shape (n,)
        Where the fit started.
    solver : str
        The integration method of all simulations; see `Calibration.solver`.
    start_cost, start_rms : float or None
        The same as `cost` and `rms` at the start; None if the simulation failed there.
    at_bound : dict of str to {"lower", "upper"}
        Parameters that ended at one of their bounds: the best values may lie beyond.
    without_effect : list of str
        Parameters that did not change the cost, by more than the relative tolerance of the simulations: their values say
        nothing.
    n_checks : int
        Simulations made after the run to find out about both: at the bound, for each parameter that ended as near to it as
        `x_tol`; with the parameter moved, for each that an evaluation has shown not to change the cost, and without standard errors,
        which show it, for each that none has shown to change it (those of a first simplex show it, because they differ in one
        parameter alone). They do not count in ``nfev`` nor in its limit, are not made after an interrupt or when the time is up, and are part of `stats`.
    skipped : list of str
        What was not looked at after the search because the search was short. All that is simulated besides the search and the
        standard errors takes at most a quarter of the evaluations of the search, and no more than four simulations of the result.
        A "simulation of higher accuracy" that was skipped leaves `Uncertainty.accurate_cost` None.
    outputs : list of OutputFit
        How well each output is reproduced: RMS at the end and at the start, fit percentage. (Empty: interrupted twice.)
    scaled_rms : float or None
        The RMS over that at the start, on the same measurements.
    stages : list of Fit
        The fit of each stage; empty if there were none. Standard errors of a stage are conditional: they take
        what the stage holds as known. ``success`` of the whole fit is that of all its stages.
        (Of a fit without stages it is False, too, where one more step of least squares makes the cost less: the first line says so.)
    uncertainty : Uncertainty or None
        Standard errors, correlation, and what the data cannot tell, in words (``print(fit.uncertainty)``). None: not asked for, the fit
        was ended by an interrupt, an error or its time, or simulations around the result fail.
    preflight : Preflight or None
        What was found at the start, where ``preflight=True`` was given.
    message : str
        How the search ended, in one sentence. What is to be said of the result is among the `findings`.
    findings : list of Finding
        What is to be said of the fit, with a severity ("error", "warning", "note"), causes first, notes last: what `Calibration.check`
        finds, judged again with the fitted values, parameters at a bound or without effect, what the data cannot tell, what the
        residuals look like.
    usable : bool
        Whether no finding is an error, such as a simulation that is worse than a constant; ``success`` says how the search ended.
    cov, cov_message
        The covariance of `uncertainty` and what is to be said of it.
    stats : SimulationStats or None
        What all simulations of the fit took together, those that failed or were given up included, those of a resumed fit
        from before not. (None: interrupted twice, and the simulations under way were left behind.)
    """

    noise: FitNoise | None
    tolerance: ChosenTolerance | None
    objective: str
    rms: float
    start_cost: float | None
    start_rms: float | None
    at_bound: dict[str, str]
    without_effect: list[str]
    n_checks: int
    skipped: list[str]
    usable: bool
    # The page that shows it, see `Calibration.fit`.
    _page: _core.LivePage | None = None

    def __init__(self, calibration: Calibration, result: OptimizeResult, start: FloatArray, solver: str) -> None:
        vars(self).update(vars(result))
        self._calibration = calibration
        self._native: _core.Fit | None = vars(self).get("_native")
        if self._native is None:
            # Interrupted twice.
            fields = {**_UNKNOWN, "rms": calibration._native.rms(list(map(float, self.x)), self.fun)}
        else:
            fields = self._native.fields()
        vars(self).update(fields)
        self.noise = _noise(fields["noise"])
        self.tolerance = fields["tolerance"] and ChosenTolerance(**fields["tolerance"])
        self.stats = fields["stats"] and SimulationStats(**fields["stats"])
        self.stages = [Fit(calibration, stage, np.array(stage._native.start), solver) for stage in fields["stages"]]
        self.findings = [Finding(**finding) for finding in fields["findings"]]
        self.outputs = [OutputFit(**output) for output in fields["outputs"]]
        self.preflight = fields["preflight"] and Preflight(fields["preflight"])
        self.uncertainty = fields["uncertainty"] and Uncertainty(fields["uncertainty"])
        self.cov = None if self.uncertainty is None else self.uncertainty.covariance
        self.cov_message = "" if self.uncertainty is None else self.uncertainty.message
        self.start = start
        self.solver = solver

    @property
    def stderr(self) -> FloatArray | None:
        """Standard errors of the parameters, shape (n,): zero for those that are fixed or at a bound, infinite for those that the
        data do not determine; None where there is no `uncertainty`."""
        return None if self.uncertainty is None else self.uncertainty.stderr

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance of the parameters, shape (n, n); the same as ``cov``."""
        return self.cov

    @property
    def correlation(self) -> FloatArray | None:
        """Correlation of the parameters, shape (n, n); NaN where a standard error is zero or infinite."""
        return None if self.uncertainty is None else self.uncertainty.correlation

    @explained
    def confidence_intervals(self, level: SupportsFloat = 0.95, *, corrected: bool = True) -> FloatArray:
        """Lower and upper ends of the confidence intervals, shape (n, 2); see `Uncertainty.confidence_intervals`.

        Raises
        ------
        ValueError
            A level that does not lie between 0 and 1; the fit has no `uncertainty`.
        """
        if self.uncertainty is None:
            raise ValueError("the uncertainty of the fit was not found: it was interrupted, or covariance=None was given")
        return self.uncertainty.confidence_intervals(level, corrected=corrected)

    @property
    def parameters(self) -> dict[str, float]:
        """The fitted values by name, those of parameters that are tied to others last."""
        x = np.asarray(self.x).tolist()
        return {**dict(zip(self._calibration.names, x)), **dict(self._calibration._native.tied(x))}

    @property
    def cost(self) -> float:
        """Sum of the squared weighted residuals at the fitted values."""
        cost: float = self.fun
        return cost

    @property
    def scaled_rms(self) -> float | None:
        """RMS over that at the start, on the same measurements; None if the simulation failed at the start."""
        return None if self.start_rms is None else self.rms / self.start_rms

    @explained
    def simulate(
        self,
        x: npt.ArrayLike | None = None,
        times: npt.ArrayLike | None = None,
        outputs: str | Iterable[str] | None = None,
    ) -> Any:
        """Simulates at the fitted values; see `Calibration.simulate`.

        Parameters
        ----------
        x : array_like, shape (n,), optional
            Other values of the parameters.
        times : array_like, optional
            Times of the rows in s; default: the measured times.
        outputs : str or iterable of str, optional
            Variables of the model to be recorded as they are, without delays or offsets of outputs: names, elements of arrays,
            patterns with ``*`` and ``?``, or "all".

        Returns
        -------
        dict of str to ndarray, or SimulationResult
            ``"time"`` and the compared outputs by their names in the model. With `outputs`: a `SimulationResult`, with
            units. With several experiments: a dict of such by their names.
        """
        return self._calibration.simulate(self.x if x is None else x, times, outputs)

    @also_called(window="windows")
    def validate(
        self, experiment: Experiment | Sequence[Experiment] | None = None, windows: Windows | None = None
    ) -> Validation:
        """Compares with measurements that the fit has not seen: of other recordings, or of other parts of the same ones.

        Hold part of a recording back by fitting to a window of it: ``fit = Calibration(..., window=(0, 600)).fit()``, then
        ``fit.validate(windows=(601, 1800))``.

        Parameters
        ----------
        experiment : Experiment or list of Experiment, optional
            Other recordings. Local parameters, which the fit does not know for them, are fitted to these recordings first, from
            their start values there, with all others held.
        windows : (float, float) or list of such, optional
            Other windows of the recordings of the calibration, in s. Simulations start where they always do, so that the model
            comes to a window with its history.

        Returns
        -------
        Validation
            RMS, scaled RMS and fit percentage of each output, what was measured and simulated; ``print`` and ``plot``.

        Raises
        ------
        SimulationError
            The simulation failed.
        ValueError, KeyError, TypeError
            Recordings or windows that cannot be used.
        """
        return _validation.validate(self, experiment, windows)

    @explained
    def prediction_band(
        self,
        times: npt.ArrayLike | None = None,
        level: float = 0.95,
        outputs: Sequence[str] | str | None = None,
        *,
        corrected: bool = True,
    ) -> dict[str, Any]:
        """What the model predicts at the fitted values, with the uncertainty that the covariance of the parameters leaves (delta
        method) and, for a new measurement, with its noise.

        Parameters
        ----------
        times : array_like, optional
            Times of the predictions in s, ascending; default: the measured times.
        level : float
            The probability that each interval shall hold.
        outputs : list of str, optional
            Only these of the compared outputs.
        corrected : bool
            Whether autocorrelated residuals are taken account of, as in `Uncertainty.covariance`; False: independent ones are supposed.

        Returns
        -------
        dict of str to PredictionBand
            By output: ``lower``, ``upper`` of the model's output, ``measured_lower``, ``measured_upper`` of a new measurement. With
            several experiments: a dict of such by their names.

        Raises
        ------
        ValueError
            The fit has no covariance or no degrees of freedom, or parameters that the data do not determine; a level that does not lie between 0 and 1.
        """
        return _validation.prediction_band(self, times, level, outputs, corrected)

    @explained
    def profile(
        self,
        parameters: str | Sequence[str] | None = None,
        level: SupportsFloat = 0.95,
        max_points: SupportsFloat | None = None,
        workers: SupportsIndex | None = None,
        checkpoint: PathLike | None = None,
        *,
        corrected: bool = True,
    ) -> Profile:
        """Profile likelihoods: each parameter is held at values farther and farther from its best one, and the others are fitted
        again, until the cost has risen so much that the data exclude the value.

        The intervals need not be symmetric as those of `confidence_intervals` are, and they are open where the data do not bound a
        parameter. The cost is that of the fit, with its weights and loss; its rise is measured in the standard errors of `uncertainty`, so
        that the interval of a linear model is that of `confidence_intervals`. The threshold is the quantile of F with 1 and N - p degrees of freedom
        (Bates and Watts, Nonlinear Regression Analysis and Its Applications, 1988, section 6.1).

        Parameters
        ----------
        parameters : str or list of str, optional
            Names; default: all that were fitted.
        level : float
            The level of the intervals, between 0 and 1.
        max_points : int, optional
            Points on each side before a side that has not reached the threshold is said to be open; default 20.
        workers : int, optional
            Sides that run at once; default: all cores. The result does not depend on it.
        checkpoint : path, optional
            A file that keeps the sides that are complete. If it exists, the profile is continued from it.
        corrected : bool
            Whether autocorrelated residuals are taken account of, as in `Uncertainty.covariance`; False: independent ones are supposed.

        Returns
        -------
        Profile
            ``intervals``, ``values``, ``costs`` by parameter; ``print`` and ``plot``.

        Raises
        ------
        Interrupted
            Ctrl-C; what there is so far is in its ``result``.
        ValueError
            The fit minimised something else than a sum of squares, or its residuals are all zero; parameters that were not
            fitted; a level that does not lie between 0 and 1; a file of another problem.
        OSError
            The file cannot be read or written.
        """
        return _profile.of_fit(self, parameters, level, corrected, max_points, workers, checkpoint)

    def residuals(self) -> FloatArray:
        """The residuals at the fitted values, simulated minus measured times weight, by the weights of the calibration;
        see `Calibration.residuals`."""
        return self._calibration.residuals(self.x)

    def plot(self) -> Figure:
        """Draws measurements, the response at the start and the fitted one, below them the residuals of the fitted one, at the
        bottom the inputs.

        Returns
        -------
        matplotlib.figure.Figure
            Two panels per output of each experiment. Nothing is shown or saved: ``fit.plot().savefig("fit.png")``.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        from .. import _plot

        return _plot.fit(self, _export.native_of(self))

    def plot_convergence(self) -> Figure:
        """Draws the cost of each evaluation and the best so far, and below them how the best point moved; as `plot`."""
        from .. import _plot

        return _plot.convergence(self, self._shown_names())

    def plot_waterfall(self) -> Figure:
        """Draws the costs at which local searches from several starts ended, sorted: what lies on one level is one minimum; as
        `plot`. ValueError: the method was another one than "multistart"."""
        from .. import _plot

        return _plot.waterfall(self)

    def plot_correlation(self) -> Figure:
        """Draws the correlation of the parameters as a coloured table; as `plot`. ValueError: the fit has no standard errors."""
        from .. import _plot

        return _plot.correlation(self.correlation, self._shown_names())

    def plot_profiles(self, profile: Profile | None = None) -> Figure:
        """Draws the rise of the cost over each parameter, with the threshold and the interval; as `plot`. Without a `profile` that
        was found before, it is found now, of all parameters."""
        return (self.profile() if profile is None else profile).plot()

    def plot_sensitivity(self) -> Figure:
        """Draws what a relative change of each parameter makes of each output, over time, or for more than six parameters its root
        mean square; as `plot`. ValueError: the fit has no standard errors, and no derivatives."""
        from .. import _plot

        return _plot.sensitivity(_export.native_of(self), self._shown_names())

    def save(self, path: PathLike) -> None:
        """Writes the fit to a file that `load_fit` reads: with all its numbers, bit for bit, its trace, and the calibration.

        The file is written in one step. It is a document in CBOR (RFC 8949), with a hash of its content; it holds the recordings
        by value, and the FMU by its path, a hash of its content and its model description. Reading it runs no code that it holds, and
        neither functions nor pickles are in it; a pickle of a fit, as any pickle, runs code when it is read: of people that you do not
        trust take files of `save` alone.

        Parameters
        ----------
        path : path
            The file to write; one that exists is replaced.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        _export.native_of(self).save(_values.path("path", path))

    def __reduce__(self) -> tuple[Any, ...]:
        return _export.pickled(self)

    def parameters_of(self, experiment: str | None = None) -> dict[str, float]:
        """The variables of the model that the parameters set, with their values in the units of the model: what ``model.set`` takes.

        Parameters
        ----------
        experiment : str, optional
            Whose values, by the name of the experiment; needed where there are local parameters.

        Returns
        -------
        dict of str to float

        Raises
        ------
        ValueError
            There is no such experiment, or none is named and each has values of its own.

        Examples
        --------
        >>> model.set(fit.parameters_of("run1"))  # doctest: +SKIP
        """
        return dict(self._calibration._native.variable_values(np.asarray(self.x).tolist(), experiment))

    def to_dict(self) -> dict[str, Any]:
        """What the fit found, as dictionaries, lists, numbers and texts: parameters with errors, start, bounds and units, those
        that are tied to others last (with ``"tied_to"``); cost and RMS; how well each output is reproduced; the uncertainty of the fit; how it was made. Numbers that are not finite are None."""
        found: dict[str, Any] = json.loads(self.to_json())
        return found

    def to_json(self) -> str:
        """The same as a text in JSON."""
        return _export.native_of(self).to_json()

    def to_csv(
        self, path: PathLike, what: Literal["parameters", "trajectories", "trace"] = "parameters"
    ) -> None:
        """Writes a table of the fit as comma-separated values, numbers with all their digits.

        Names stand as they are in the model and in the recordings. A spreadsheet takes a cell that begins with ``=``, ``+``, ``-`` or
        ``@`` for a formula: import tables of models that you do not trust as text.

        Parameters
        ----------
        path : path
            The file to write; one that exists is replaced.
        what : {"parameters", "trajectories", "trace"}
            A row for each parameter (with standard errors, start, bounds, unit; those that are tied to others last), each measurement that counts (measured and
            simulated), or each evaluation.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        _export.native_of(self).to_csv(_values.choice("what", what), _values.path("path", path))

    def to_dataframe(self, what: Literal["parameters", "trajectories", "trace"] = "parameters") -> Any:
        """The same table as a pandas.DataFrame. Needs pandas."""
        return _export.dataframe(self, what)

    def export_ssv(self, path: PathLike, experiment: str | None = None) -> Path:
        """Writes the fitted values as an SSP parameter file (System Structure Parameter Values 1.0), which tools for system structures
        read: those of `parameters_of`, with their units.

        Parameters
        ----------
        path : path
            The file to write, ``.ssv``.
        experiment : str, optional
            Whose values; see `parameters_of`.

        Returns
        -------
        Path
            `path`.

        Raises
        ------
        OSError
            The file cannot be written.
        ValueError
            As `parameters_of`; `path` has another suffix.
        """
        _export.native_of(self).export_ssv(_values.path("path", path), experiment)
        return Path(path)

    def export_fmu(self, path: PathLike, experiment: str | None = None, *, keep: bool = False) -> Path:
        """Writes a copy of the FMU that starts with the fitted values.

        In ``modelDescription.xml`` the start values of `parameters_of` change, and nothing else; all other files are copied as
        they are. The copy is simulated as it is and compared with the fit. The libraries of many FMUs ignore the start values of the
        description, as the FMI standard allows: then a `CalibrationWarning` says so, and the values are written as an SSP parameter
        file instead (see `export_ssv`), beside `path` with the suffix ``.ssv``.

        Parameters
        ----------
        path : path
            The file to write, ``.fmu``.
        experiment : str, optional
            Whose values; see `parameters_of`. Values that were given as `start_values` are not written.
        keep : bool
            Write the copy also where its library ignores the description, for tools that set the start values of the description
            when they import it.

        Returns
        -------
        Path
            `path`, or that of the parameter file where the copy is not written.

        Raises
        ------
        OSError
            The file cannot be written.
        ValueError
            As `parameters_of`; `path` has another suffix, or is that of the model.
        """
        return _export.export_fmu(self, path, experiment, keep)

    def __getitem__(self, key: Any) -> Any:
        if key in ("parameters", "cost", "stderr", "covariance", "correlation", "scaled_rms"):
            return getattr(self, key)
        return super().__getitem__(key)

    def report(self, path: str | os.PathLike[str]) -> None:
        """Writes a report: one HTML page that needs no network, with parameters and their intervals, outputs, figures, settings,
        versions, and hashes of model and data.

        Each experiment is simulated at the start and at the fitted values. An existing file is replaced once the new one is
        whole.

        Parameters
        ----------
        path : path
            The file, ``"fit.html"``.

        Raises
        ------
        OSError
            It cannot be written.
        ValueError
            The name of the file ends in something else than ``.html``.
        SimulationError
            A simulation fails that did not in the fit.
        """
        _export.native_of(self).report(_values.path("path", path))

    def _shown_names(self) -> list[str]:
        """What figures call the parameters."""
        return self._calibration.names if self._native is None else self._native.shown_names

    def __repr__(self) -> str:
        return super().__repr__() if self._native is None else self._native.text()

    def _repr_html_(self) -> str | None:
        """The same for notebooks."""
        return None if self._native is None else self._native.html()
