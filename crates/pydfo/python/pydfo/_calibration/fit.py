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
from . import bootstrap as _bootstrap
from . import export as _export
from . import goodness as _goodness
from . import posterior as _posterior
from . import profile as _profile
from . import validation as _validation
from .bootstrap import Bootstrap
from .check import Finding
from .experiment import Experiment
from .export import PathLike
from .goodness import Comparison, Goodness
from .named import NamedArray, NamedValues
from .posterior import Posterior
from .profile import Profile
from .stages import Windows
from .uncertainty import Preflight, Uncertainty
from .validation import Validation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .calibration import Calibration

FloatArray = npt.NDArray[np.float64]


class OutputFit(NamedTuple):
    """Agreement of a fit with one output of one experiment."""

    experiment: str
    """Name of the experiment."""
    variable: str
    """Name of the variable in the model."""
    column: str
    """Name of the measured column."""
    unit: str | None
    """Unit of the variable, if the model declares one."""
    n: int
    """Number of measurements that count."""
    rms: float
    """Root of the mean squared difference between simulation and measurement, without weights, in the unit of the
    variable."""
    start_rms: float | None
    """RMS at the start; None if the simulation failed there."""
    fit_percent: float
    """Fit percentage: ``100 (1 - norm(simulated - measured) / norm(measured - mean))``; NaN if the measurements do
    not vary."""
    is_log: bool = False
    """True if the fit compared logarithms (``sigma="log"``)."""


class FitNoise(NamedTuple):
    """Noise of the measurements that a fit uses, and its source."""

    source: Literal["known", "stated", "estimated"]
    """Source: "known" if `sigma` or ``noise="stated"`` specifies the noise of all outputs, so that standard errors are
    absolute. "stated" if the weights specify it relative to the priors, "estimated" if it is estimated with the
    parameters."""
    sd: dict[str, float]
    """Estimated standard deviation of each variable, in its unit. If the weights of the variable state a scale, it is
    multiplied by the weight."""
    of_residuals: dict[str, bool]
    """True if the estimate uses the residuals of the variable. False if it uses the differences between neighbouring
    measurements, because there were too few residuals or the search was ended."""
    n_rounds: int
    """Number of searches."""
    settled: bool
    """True if the residuals of the last search confirm the estimates to 1 %, and error models to 0.01 % or, with estimated
    coefficients, 0.1 %."""
    coefficients: dict[str, dict[str, float]] = {}
    """Estimated coefficients of the error model of each variable, as in ``{"y": {"a": 0.1, "b": 0.05}}``."""


class ChosenTolerance(NamedTuple):
    """The relative tolerance that a fit chose for its simulations."""

    used: float
    """Relative tolerance of the simulations."""
    stated: float
    """Relative tolerance of the model, or the default."""
    noise: float | None
    """Expected relative uncertainty of the cost near the best values with the tolerance of the calibration; None if
    it was not estimated."""


def _noise(found: Any) -> FitNoise | None:
    """Converts the noise from the native code: None, "known", "stated" or the estimates."""
    if not isinstance(found, dict):
        return None if found is None else FitNoise(found, {}, {}, 0, True)
    estimated = found["estimated"]
    of_residuals = {output["variable"]: output["is_of_residuals"] for output in estimated["outputs"]}
    models = estimated.get("models", [])
    coefficients: dict[str, dict[str, float]] = {}
    for model in models:
        given = ((model["model"]["constant"], model["a"]), (model["model"]["proportional"], model["b"]))
        fitted = {of["fitted"]: value for of, value in given if "fitted" in of}
        if fitted:
            coefficients.setdefault(model["variable"], {}).update(fitted)
            of_residuals[model["variable"]] = model["is_of_residuals"]
    source: Literal["known", "estimated"] = "known" if estimated["is_known"] else "estimated"
    sds = {output["variable"]: output["sd"] for output in estimated["outputs"]}
    return FitNoise(source, sds, of_residuals, estimated["n_rounds"], estimated["is_settled"], coefficients)


#: Fields of an interrupted fit of which only the last iteration is known.
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
    """The result of a fit: an `OptimizeResult` with names, in terms of the measurements.

    ``print(fit)`` shows a text table, a notebook shows an HTML table, and `report` writes a page.

    Attributes
    ----------
    x : ndarray, shape (n,)
        The fitted values in the order of the parameters, including fixed parameters.
    parameters : dict of str to float
        The fitted values by name.
    cost : float
        Sum of the squared weighted residuals at ``x``; equal to ``fun``. If the `noise` was estimated, the weights
        are divided by it. With a loss, the sum of the losses. With another `objective`, the value of the objective.
    objective : str
        Name of the minimised cost function.
    rms : float
        Root of the mean squared weighted residual at ``x``, with the weights of the calibration and without the loss.
    noise : FitNoise or None
        Noise of the measurements: ``fit.noise.source``, ``fit.noise.sd``. None if nothing depends on it: the noise is
        not known, and there are no priors or the objective is not the sum of squares.
    tolerance : ChosenTolerance or None
        The relative tolerance chosen for the simulations. None if it was given, if the step is fixed, if a
        co-simulation declares no tolerance, or if `f_tol` is zero.
    start : ndarray, shape (n,)
        Starting point of the fit.
    solver : str
        The integration method of all simulations; see `Calibration.solver`.
    start_cost, start_rms : float or None
        `cost` and `rms` at the start; None if the simulation failed there.
    at_bound : dict of str to {"lower", "upper"}
        Parameters that ended at one of their bounds. The best values may be outside the bounds.
    without_effect : list of str
        Parameters that did not change the cost by more than the relative tolerance of the simulations. Their values
        are meaningless.
    n_checks : int
        Number of simulations after the search that determine `at_bound` and `without_effect`. One simulation at the
        bound is made for each parameter that ended within `x_tol` of it. One with the parameter moved is made for
        each parameter that did not change the cost in an evaluation. Without standard errors, which show the effect
        of a parameter, one is also made for each parameter whose effect no evaluation has shown. The evaluations of a
        first simplex show effects, because they differ in one parameter. These simulations are not included in
        ``nfev`` or its limit. They are skipped after an interrupt or if the time is up. They are included in `stats`.
    skipped : list of str
        Checks skipped after a short search. Simulations outside the search and the
        standard errors use at most a quarter of the evaluations of the search. At most four of them simulate the
        result. If "simulation of higher accuracy" was skipped, `Uncertainty.accurate_cost` is None.
    outputs : list of OutputFit
        Quality of each output: RMS at the end and at the start, fit percentage. Empty if the fit was interrupted
        twice.
    scaled_rms : float or None
        RMS relative to the RMS at the start, on the same measurements.
    stages : list of Fit
        The fit of each stage; empty without stages. Standard errors of a stage are conditional, because the
        parameters held fixed by the stage are assumed known. ``success`` of the whole fit requires success of all its
        stages. With or without stages, ``success`` is also False if one more least-squares step of all parameters
        lowers the cost; the first printed line reports it. This test needs standard errors.
    uncertainty : Uncertainty or None
        Standard errors, correlation and parameters that the data do not determine (``print(fit.uncertainty)``). None
        if it was not requested, if an interrupt, an error or the time limit ended the fit, or if simulations around
        the result fail.
    preflight : Preflight or None
        The results of the check at the start, with ``preflight=True``.
    message : str
        How the search ended, in one sentence. Remarks on the result are among the `findings`.
    findings : list of Finding
        Remarks on the fit with their severity ("error", "warning", "note"). Causes come first, notes last. They
        include the findings of `Calibration.check`, reassessed at the fitted values. They also report parameters at a
        bound, without effect or not determined by the data, and properties of the residuals.
    usable : bool
        False if a finding is an error, such as a simulation that is worse than a constant. ``success`` reports how
        the search ended.
    cov, cov_message
        The covariance of `uncertainty` and remarks on it.
    stats : SimulationStats or None
        Cost of all simulations of the fit, including failed and abandoned ones. Simulations before a fit was resumed
        are not included. None if the fit was interrupted twice and running simulations were abandoned.
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
    # Page that shows the fit, see `Calibration.fit`.
    _page: _core.LivePage | None = None

    def __init__(self, calibration: Calibration, result: OptimizeResult, start: FloatArray, solver: str) -> None:
        vars(self).update(vars(result))
        self._calibration = calibration
        self._native: _core.Fit | None = vars(self).get("_native")
        if self._native is None:
            # The fit was interrupted twice.
            fields = {**_UNKNOWN, "rms": calibration._native.rms(list(map(float, self.x)), self.fun)}
        else:
            fields = self._native.fields()
        vars(self).update(fields)
        self.noise = _noise(fields["noise"])
        self.tolerance = fields["tolerance"] and ChosenTolerance(**fields["tolerance"])
        self.stats = fields["stats"] and SimulationStats(**fields["stats"])
        self.stages = [Fit(calibration, stage, np.array(stage._native.start), solver) for stage in fields["stages"]]
        self.findings = [Finding(**finding) for finding in fields["findings"]]
        # Other fields are for comparisons of fits.
        self.outputs = [OutputFit(**{k: v for k, v in output.items() if k in OutputFit._fields}) for output in fields["outputs"]]
        self.preflight = fields["preflight"] and Preflight(fields["preflight"])
        self.uncertainty = fields["uncertainty"] and Uncertainty(fields["uncertainty"])
        self.cov = None if self.uncertainty is None else self.uncertainty.covariance
        self.cov_message = "" if self.uncertainty is None else self.uncertainty.message
        self.start = start
        self.solver = solver

    @property
    def stderr(self) -> NamedArray | None:
        """Standard errors of the parameters; None if there is no `uncertainty`.

        The entries have the names and the order of `parameters`: ``fit.stderr["k"]``. Derived and tied parameters come
        last, with the errors that follow from the covariance of the others. Errors are zero for parameters that are
        fixed or at a bound, and infinite for parameters that the data do not determine."""
        if self.uncertainty is None:
            return None
        errors = self.uncertainty.stderr.tolist()
        derived = [] if self._native is None else self._native.derived_errors()
        return NamedArray({**dict(zip(self._calibration.names, errors)), **dict(derived)})

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance of the parameters, shape (n, n); equal to ``cov``."""
        return self.cov

    @property
    def correlation(self) -> FloatArray | None:
        """Correlation of the parameters, shape (n, n); NaN if a standard error is zero or infinite."""
        return None if self.uncertainty is None else self.uncertainty.correlation

    @explained
    def confidence_intervals(self, level: SupportsFloat = 0.95, *, corrected: bool = True) -> FloatArray:
        """Returns the lower and upper ends of the confidence intervals, shape (n, 2); see
        `Uncertainty.confidence_intervals`.

        Raises
        ------
        ValueError
            The level is not between 0 and 1, or the fit has no `uncertainty`.
        """
        if self.uncertainty is None:
            raise ValueError("the fit has no uncertainty, because it was interrupted or used covariance=None")
        return self.uncertainty.confidence_intervals(level, corrected=corrected)

    @property
    def parameters(self) -> NamedValues:
        """The fitted values by name. Derived and tied parameters come last. ``np.asarray`` returns them in order."""
        x = np.asarray(self.x).tolist()
        return NamedValues({**dict(zip(self._calibration.names, x)), **dict(self._calibration._native.derived(x))})

    @property
    def cost(self) -> float:
        """Sum of the squared weighted residuals at the fitted values."""
        cost: float = self.fun
        return cost

    @property
    def scaled_rms(self) -> float | None:
        """RMS relative to the RMS at the start, on the same measurements; None if the simulation failed at the
        start."""
        return None if self.start_rms is None else self.rms / self.start_rms

    @property
    def goodness(self) -> Goodness:
        """Chi-square and information criteria at the fitted values: ``fit.goodness.redchi``."""
        return _goodness.of_fit(self)

    @property
    def chisqr(self) -> float:
        """Chi-square, as in lmfit; see `goodness`."""
        return self.goodness.chisqr

    @property
    def redchi(self) -> float:
        """Reduced chi-square, as in lmfit; see `goodness`."""
        return self.goodness.redchi

    @property
    def aic(self) -> float:
        """Akaike's information criterion, as in lmfit; see `goodness`."""
        return self.goodness.aic

    @property
    def bic(self) -> float:
        """Bayesian information criterion, as in lmfit; see `goodness`."""
        return self.goodness.bic

    @explained
    def bootstrap(
        self,
        n: SupportsFloat = 200,
        kind: Literal["parametric", "residual", "block"] = "parametric",
        rng: int | np.random.Generator | None = None,
        workers: SupportsIndex | None = None,
        checkpoint: PathLike | None = None,
    ) -> Bootstrap:
        """Fits synthetic measurements, the simulation of this fit plus random errors.

        The spread of the fitted values estimates the uncertainty without a linear model. Each fit starts at the fitted
        values and uses the objective, loss and weights of this fit. Priors and measured initial states do not change.

        Parameters
        ----------
        n : int
            Number of fits: about 200 for standard errors, 1000 for percentile intervals.
        kind : {"parametric", "residual", "block"}
            Errors: "parametric", normal with the known noise, or with the standard deviation of the residuals of each
            output; "residual", residuals of the output drawn with replacement; "block", blocks of ``N**(1/3)``
            consecutive residuals, for autocorrelated errors.
        rng : int or numpy.random.Generator, optional
            Seed of the random numbers, or a generator from which to draw the seed; None draws one. The result stores
            the seed in ``seed``.
        workers : int, optional
            Number of fits that run at once; default: all cores. The result does not depend on it.
        checkpoint : path, optional
            File in which to save the completed fits. If it exists, the bootstrap continues from it, also with a larger
            `n`. If `rng` is None, its seed is used. A file of another fit, kind or seed is an error.

        Returns
        -------
        Bootstrap
            ``samples``, ``stderr`` and ``intervals(level)``; has ``print``.

        Raises
        ------
        ValueError
            The fit minimised neither a sum of squares nor the likelihood, there are no more measurements than
            parameters, none of the fits succeeds, or the file is damaged or contains another bootstrap.
        Interrupted
            Ctrl-C was pressed. The file contains the completed fits.
        """
        return _bootstrap.of_fit(self, n, kind, rng, workers, checkpoint)

    def compare(self, other: Fit) -> Comparison:
        """Compares this fit with a fit of another model to the same measurements.

        A smaller information criterion is better. The F test applies to nested models: the smaller model is the
        larger one with some parameters fixed or derived.

        Parameters
        ----------
        other : Fit
            The other fit, with the same measurements. With other weights, the criteria are those of the likelihood of
            the measurements.

        Returns
        -------
        Comparison
            ``goodness`` of both fits, ``f`` and ``p_value`` of the F test; ``print`` shows a table.

        Raises
        ------
        ValueError
            The fits have different measurements.
        """
        return _goodness.compare(self, other)

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
            Values of the parameters that replace the fitted ones.
        times : array_like, optional
            Times of the rows; default: the measured times.
        outputs : str or iterable of str, optional
            Variables of the model to record directly, without the delays or offsets of outputs. Pass names, elements
            of arrays, patterns with ``*`` and ``?``, or "all".

        Returns
        -------
        dict of str to ndarray, or SimulationResult
            ``"time"`` and the compared outputs by their names in the model. With `outputs`: a `SimulationResult` with
            units. With several experiments: a dict of these results by experiment name.
        """
        return self._calibration.simulate(self.x if x is None else x, times, outputs)

    @also_called(window="windows")
    def validate(
        self, experiment: Experiment | Sequence[Experiment] | None = None, windows: Windows | None = None
    ) -> Validation:
        """Compares the fitted model with other measurements: other recordings, or other parts of the fitted
        recordings.

        To reserve part of a recording for validation, fit to a window:
        ``fit = Calibration(..., window=(0, 600)).fit()``, then
        ``fit.validate(windows=(601, 1800))``.

        Parameters
        ----------
        experiment : Experiment or list of Experiment, optional
            Other recordings. Local parameters are unknown for these recordings. They are first fitted to them from
            their start values, with all other parameters held fixed.
        windows : (float, float) or list of such, optional
            Other windows of the recordings of the calibration. Simulations start at their usual start time, so
            the state at the start of a window is simulated.

        Returns
        -------
        Validation
            RMS, scaled RMS and fit percentage of each output, and the measured and simulated values; has ``print``
            and ``plot``.

        Raises
        ------
        SimulationError
            The simulation failed.
        ValueError, KeyError, TypeError
            Invalid recordings or windows.
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
        """Returns the model's predictions at the fitted values with their uncertainty.

        The uncertainty follows from the covariance of the parameters by the delta method. For a new measurement, it
        includes the noise.

        Parameters
        ----------
        times : array_like, optional
            Times of the predictions, ascending; default: the measured times.
        level : float
            Probability covered by each interval.
        outputs : list of str, optional
            Names of the compared outputs to include; default: all.
        corrected : bool
            If True, correct for autocorrelated residuals, as in `Uncertainty.covariance`. If False, assume
            independent residuals.

        Returns
        -------
        dict of str to PredictionBand
            By output: ``lower``, ``upper`` of the model's output, ``measured_lower``, ``measured_upper`` of a new
            measurement. With several experiments: a dict of such dicts by experiment name.

        Raises
        ------
        ValueError
            The fit has no covariance or no degrees of freedom, the data do not determine some parameters, or the
            level is not between 0 and 1.
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
        """Computes profile likelihoods of the parameters.

        Each parameter is fixed at values farther and farther from its best value, and the others are refitted. A side
        ends when the cost has risen so much that the data exclude the value.

        Unlike the intervals of `confidence_intervals`, profile intervals need not be symmetric. They are open if the
        data do not bound a parameter. The cost is the cost of the fit, with its weights and loss. Its rise is scaled
        with the standard errors of `uncertainty`, so for a linear model the intervals equal
        `confidence_intervals`. The threshold is the quantile of F with 1 and N - p degrees of freedom (Bates and
        Watts, Nonlinear Regression Analysis and Its Applications, 1988, section 6.1). With the likelihood L of N
        residuals, the statistic is ``(N - p) (exp(2 (L - L_min) / N) - 1)``. It equals that of the sum of squares for
        one output, and ``2 (L - L_min)`` for many measurements.

        Parameters
        ----------
        parameters : str or list of str, optional
            Names; default: all fitted parameters.
        level : float
            Level of the intervals, between 0 and 1.
        max_points : int, optional
            Maximum number of points on each side; default 20. A side that has not reached the threshold by then is
            reported as open.
        workers : int, optional
            Number of sides computed at once; default: all cores. The result does not depend on it.
        checkpoint : path, optional
            File that stores the complete sides. If it exists, the profile continues from it.
        corrected : bool
            If True, correct for autocorrelated residuals, as in `Uncertainty.covariance`. If False, assume
            independent residuals.

        Returns
        -------
        Profile
            ``intervals``, ``values``, ``costs`` by parameter; has ``print`` and ``plot``.

        Raises
        ------
        Interrupted
            Ctrl-C was pressed; ``result`` contains the profile so far.
        ValueError
            The objective of the fit is neither a sum of squares nor the likelihood, or its residuals are all zero.
            Also if a parameter was not fitted, the level is not between 0 and 1, or the file belongs to another problem.
        OSError
            The file cannot be read or written.
        """
        return _profile.of_fit(self, parameters, level, corrected, max_points, workers, checkpoint)

    @explained
    def sample(
        self,
        steps: SupportsFloat = 1000,
        *,
        warmup: SupportsFloat | None = None,
        walkers: SupportsFloat | None = None,
        start: str = "fit",
        rng: int | np.random.Generator | None = None,
        workers: SupportsIndex | None = None,
        checkpoint: PathLike | None = None,
        disp: bool | None = None,
    ) -> Posterior:
        """Samples the posterior distribution of the parameters with an ensemble of walkers.

        The density is the product of the likelihood and the priors, within the bounds. The prior of a parameter
        without one is uniform in the parameter or, with ``scale="log"``, in its logarithm. The noise is normal and
        independent. If it is known (``sigma=``, or ``noise="stated"``), the likelihood is ``exp(-cost / 2)``. Otherwise
        the standard deviation of each output is unknown and is integrated out with the prior 1/sigma (Gelman et al.,
        Bayesian Data Analysis, third edition, 2013, section 3.2).

        In each step, each walker moves by a multiple of the difference of two other walkers (ter Braak, Statistics and
        Computing 16, 2006), with one simulation of all experiments. Half of the walkers are simulated in parallel.
        Fixed, integer and categorical parameters keep the values of the fit.

        Parameters
        ----------
        steps : int
            Number of steps, including the warm-up.
        warmup : int, optional
            Number of first steps that are not a part of the sample; default: a quarter of the steps.
        walkers : int, optional
            Number of walkers; default: the larger of 16 and four per parameter.
        start : {"fit", "box"}
            Initial distribution of the walkers: the normal distribution of the fit, or the box of the bounds. Use
            "box" if there may be several modes.
        rng : int or numpy.random.Generator, optional
            Seed of the random numbers, or a generator from which to draw the seed; None draws one.
        workers : int, optional
            Number of parallel simulations; default: all cores. The result does not depend on it.
        checkpoint : path, optional
            File that stores the chain. If it exists, the sample continues from it. A larger number of steps extends
            it.
        disp : bool, optional
            Whether a terminal or notebook shows the number of completed steps; default: after two seconds.

        Returns
        -------
        Posterior
            ``chain``, ``mean``, ``sd``, ``intervals()``; has ``print`` and ``plot``.

        Raises
        ------
        Interrupted
            Ctrl-C was pressed; ``result`` contains the steps so far.
        ValueError
            The fit minimised a robust loss, or a cost that is neither a sum of squares nor the likelihood. Also if
            there are too few walkers or steps, or if the file belongs to another problem.
        OSError
            The file cannot be read or written.
        """
        return _posterior.of_fit(self, steps, warmup, walkers, start, rng, workers, checkpoint, disp)

    def residuals(self) -> FloatArray:
        """Returns the residuals at the fitted values: simulated minus measured, times the weight of the calibration.

        See `Calibration.residuals`."""
        return self._calibration.residuals(self.x)

    def plot(self) -> Figure:
        """Draws the measurements with the responses at the start and at the fitted values, the residuals of the fit,
        and the inputs.

        Returns
        -------
        matplotlib.figure.Figure
            Two panels per output of each experiment. The figure is not shown or saved. Save it with
            ``fit.plot().savefig("fit.png")``.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        from .. import _plot

        return _plot.fit(self, _export.native_of(self))

    def plot_convergence(self) -> Figure:
        """Draws the cost of each evaluation and the best cost so far, and below them the best point. Returns a
        figure, as `plot`."""
        from .. import _plot

        return _plot.convergence(self, self._shown_names())

    def plot_waterfall(self) -> Figure:
        """Draws the sorted final costs of the local searches from several starts. Equal costs belong to one minimum.

        Returns a figure, as `plot`. Raises ValueError if the method was not "multistart"."""
        from .. import _plot

        return _plot.waterfall(self)

    def plot_correlation(self) -> Figure:
        """Draws the correlation of the parameters as a coloured table.

        Returns a figure, as `plot`. Raises ValueError if the fit has no standard errors."""
        from .. import _plot

        return _plot.correlation(self.correlation, self._shown_names())

    def plot_profiles(self, profile: Profile | None = None) -> Figure:
        """Draws the rise of the cost against each parameter, with the threshold and the interval.

        Returns a figure, as `plot`. Without `profile`, computes the profiles of all parameters first."""
        return (self.profile() if profile is None else profile).plot()

    def plot_sensitivity(self) -> Figure:
        """Draws the effect of a relative change of each parameter on each output over time.

        For more than six parameters, draws the root mean square of the effect. Returns a figure, as `plot`. Raises
        ValueError if the fit has no standard errors, and therefore no derivatives."""
        from .. import _plot

        return _plot.sensitivity(_export.native_of(self), self._shown_names())

    def save(self, path: PathLike) -> None:
        """Writes the fit to a file for `load_fit`, including the trace and the calibration. Numbers keep all their
        bits.

        The file is written in one step. It is a CBOR document (RFC 8949) with a hash of its content. It contains the
        recordings by value, the path of the FMU, a hash of the content of the FMU and its model description. The file
        contains no functions and no pickles, and reading it runs no code from it. A pickle of a fit, like any pickle,
        runs code when it is read. From people you do not trust, accept only files written by `save`.

        Parameters
        ----------
        path : path
            The file to write. An existing file is replaced.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        _export.native_of(self).save(_values.path("path", path))

    def __reduce__(self) -> tuple[Any, ...]:
        return _export.pickled(self)

    def parameters_of(self, experiment: str | None = None) -> dict[str, float]:
        """Returns the values of the model variables set by the parameters, in the units of the model, for
        ``model.set``.

        Parameters
        ----------
        experiment : str, optional
            Name of the experiment; required if there are local parameters.

        Returns
        -------
        dict of str to float

        Raises
        ------
        ValueError
            There is no such experiment, or `experiment` is missing although the experiments have different values.

        Examples
        --------
        >>> model.set(fit.parameters_of("run1"))  # doctest: +SKIP
        """
        return dict(self._calibration._native.variable_values(np.asarray(self.x).tolist(), experiment))

    def to_dict(self) -> dict[str, Any]:
        """Returns the results of the fit as dictionaries, lists, numbers and strings.

        They are the parameters with errors, start, bounds and units, tied parameters last (with ``"tied_to"``); cost
        and RMS; the quality of each output; the uncertainty and the settings of the fit. Numbers that are not finite
        are None."""
        found: dict[str, Any] = json.loads(self.to_json())
        return found

    def to_json(self) -> str:
        """Returns the results of `to_dict` as a JSON string."""
        return _export.native_of(self).to_json()

    def to_csv(
        self, path: PathLike, what: Literal["parameters", "trajectories", "trace"] = "parameters"
    ) -> None:
        """Writes a table of the fit as comma-separated values with all digits.

        Names are written as they are in the model and in the recordings. Spreadsheets interpret a cell that starts
        with ``=``, ``+``, ``-`` or ``@`` as a formula. Import tables of models you do not trust as text.

        Parameters
        ----------
        path : path
            The file to write. An existing file is replaced.
        what : {"parameters", "trajectories", "trace"}
            One row for each parameter (with standard errors, start, bounds and unit; tied parameters last), for each
            measurement that counts (measured and simulated), or for each evaluation.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        _export.native_of(self).to_csv(_values.choice("what", what), _values.path("path", path))

    def to_dataframe(self, what: Literal["parameters", "trajectories", "trace"] = "parameters") -> Any:
        """Returns the table of `to_csv` as a pandas.DataFrame. Needs pandas."""
        return _export.dataframe(self, what)

    def export_ssv(self, path: PathLike, experiment: str | None = None) -> Path:
        """Writes the fitted values to an SSP parameter file (System Structure Parameter Values 1.0) for
        system-simulation tools.

        The file contains the values of `parameters_of` with their units.

        Parameters
        ----------
        path : path
            The file to write, ``.ssv``.
        experiment : str, optional
            Name of the experiment; see `parameters_of`.

        Returns
        -------
        Path
            `path`.

        Raises
        ------
        OSError
            The file cannot be written.
        ValueError
            See `parameters_of`; also if the suffix of `path` is not ``.ssv``.
        """
        _export.native_of(self).export_ssv(_values.path("path", path), experiment)
        return Path(path)

    def export_fmu(self, path: PathLike, experiment: str | None = None, *, keep: bool = False) -> Path:
        """Writes a copy of the FMU that starts with the fitted values.

        Only the start values of `parameters_of` in ``modelDescription.xml`` change; all other files are copied
        unchanged. The copy is simulated without further settings and compared with the fit. The libraries of many
        FMUs ignore the start values of the description, as the FMI standard allows. In this case, a
        `CalibrationWarning` reports it, and the values are written to an SSP parameter file next to `path`, with the
        suffix ``.ssv`` (see `export_ssv`).

        Parameters
        ----------
        path : path
            The file to write, ``.fmu``.
        experiment : str, optional
            Name of the experiment; see `parameters_of`. Values given as `start_values` are not written.
        keep : bool
            If True, write the copy even if its library ignores the description. Some importing tools set the start
            values of the description themselves.

        Returns
        -------
        Path
            `path`, or the path of the parameter file if the copy was not written.

        Raises
        ------
        OSError
            The file cannot be written.
        ValueError
            See `parameters_of`; also if the suffix of `path` is not ``.fmu``, or if `path` is the path of the model.
        """
        return _export.export_fmu(self, path, experiment, keep)

    def __getitem__(self, key: Any) -> Any:
        if key in ("parameters", "cost", "stderr", "covariance", "correlation", "scaled_rms"):
            return getattr(self, key)
        return super().__getitem__(key)

    def report(self, path: str | os.PathLike[str]) -> None:
        """Writes a report: one HTML page that needs no network.

        The page contains parameters and their intervals, outputs, figures, settings, versions, and hashes of model
        and data. Each experiment is simulated at the start and at the fitted values. An existing file is replaced
        after the new one is complete.

        Parameters
        ----------
        path : path
            The file, ``"fit.html"``.

        Raises
        ------
        OSError
            The file cannot be written.
        ValueError
            The file name does not end in ``.html``.
        SimulationError
            A simulation fails that succeeded in the fit.
        """
        _export.native_of(self).report(_values.path("path", path))

    def _shown_names(self) -> list[str]:
        """Returns the parameter names for figures."""
        return self._calibration.names if self._native is None else self._native.shown_names

    def __repr__(self) -> str:
        return super().__repr__() if self._native is None else self._native.text()

    def _repr_html_(self) -> str | None:
        """Returns the HTML table for notebooks."""
        return None if self._native is None else self._native.html()
