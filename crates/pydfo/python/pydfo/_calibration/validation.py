"""Validation of a fit on other measurements, and the uncertainty of its predictions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import text as _text
from .._args import values as _values
from .._errors import BadCalibrationError
from .._model.trajectory import SimulationStats
from . import export as _export
from .check import Finding
from .experiment import Experiment, listed
from .stages import Windows, intervals

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from .fit import Fit

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class ValidatedOutput:
    """An output of an experiment: measured values, and simulated values at the fitted parameters."""

    experiment: str
    """Name of the experiment."""
    variable: str
    """Name of the output in the model."""
    column: str
    """Name of the measured column."""
    unit: str | None
    """Unit of the output, if the model declares one."""
    n: int
    """Number of measurements that count."""
    rms: float
    """Root of the mean squared difference between simulation and measurement, without weights, in the unit of the output."""
    start_rms: float | None
    """RMS at the start of the fit; None if the simulation failed there."""
    fit_percent: float
    """``100 (1 - |simulated - measured| / |measured - mean|)``; NaN if the measurements do not vary."""
    time: FloatArray
    """Times of the measurements, in the time unit of the model."""
    measured: FloatArray
    """Measured values."""
    simulated: FloatArray
    """Simulated values at these times."""
    residuals: FloatArray
    """Simulated minus measured, without weights."""
    start_residuals: FloatArray | None
    """Residuals at the start of the fit; None if the simulation failed there."""
    is_log: bool = False
    """True if the fit compared logarithms (``sigma="log"``)."""

    @property
    def scaled_rms(self) -> float | None:
        """RMS relative to the RMS at the start of the fit."""
        return None if self.start_rms is None else self.rms / self.start_rms

    def __repr__(self) -> str:
        return _text.line(f"<ValidatedOutput {self.variable} in {self.experiment}: RMS {self.rms:.4g} over {self.n} measurements>")


class Validation:
    """Result of a validation of fitted parameters with other measurements; printed as a table.

    Attributes
    ----------
    rms, start_rms, scaled_rms : float
        Root of the mean squared weighted residual, its value at the start of the fit (None if the simulation failed
        there), and their ratio.
    n : int
        Number of measurements that count.
    time_unit : str
        Unit of the times.
    fitted : list of str
        Parameters that were fitted to these recordings, because the fit does not contain their values there.
    outputs : list of ValidatedOutput
        Each output of each experiment: RMS, fit percentage, measured and simulated values.
    parameters : dict of str to float
        Values of the fit. Local parameters have the values of the validated recordings.
    findings : list of Finding
        Warnings about measurements used in the fit: their RMS does not assess predictions. The printed table includes
        them.
    n_simulations : int
        Number of simulations.
    stats : SimulationStats
        Computational cost of the simulations.
    """

    n: int
    time_unit: str
    fitted: list[str]
    rms: float
    start_rms: float | None
    n_simulations: int

    def __init__(self, fields: dict[str, Any]) -> None:
        vars(self).update({name: fields[name] for name in Validation.__annotations__})
        self.parameters: dict[str, float] = dict(zip(fields["names"], fields["x"].tolist()))
        self.findings = [Finding(**finding) for finding in fields["findings"]]
        self.stats = SimulationStats(**fields["stats"])
        self.outputs = [_validated(output) for output in fields["outputs"]]
        self._text: str = fields["text"]

    @property
    def scaled_rms(self) -> float | None:
        """RMS relative to the RMS at the start of the fit."""
        return None if self.start_rms is None else self.rms / self.start_rms

    def __repr__(self) -> str:
        return self._text

    def plot(self) -> Figure:
        """Draws the measurements with the simulations at the start and at the fitted values, and below them the
        residuals of both.

        Returns
        -------
        matplotlib.figure.Figure
            One column per output of each experiment.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        from .._plot import pyplot

        figure: Figure
        figure, axes = pyplot().subplots(
            2, len(self.outputs), sharex="col", squeeze=False, figsize=(6.4 * len(self.outputs), 6.0), height_ratios=[2, 1],
            layout="constrained",
        )
        for (upper, lower), output in zip(axes.T, self.outputs):
            unit = f" [{_text.line(output.unit)}]" if output.unit else ""
            upper.plot(output.time, output.measured, ".", color="0.6", markersize=3, label="measured")
            for residuals, colour, style, label in (
                (output.start_residuals, "tab:orange", "--", "start"), (output.residuals, "tab:blue", "-", "fitted"),
            ):
                if residuals is None:
                    continue
                rms = float(np.sqrt(np.mean(residuals**2)))
                upper.plot(output.time, output.measured + residuals, style, color=colour, linewidth=1.0, label=label)
                lower.plot(output.time, residuals, style, color=colour, linewidth=0.8, label=f"{label}: RMS {rms:.4g}")
            upper.set_title(_text.line(f"validation, {output.experiment}"))
            upper.set_ylabel(_text.line(output.variable) + unit)
            upper.legend(loc="best", fontsize="small")
            lower.axhline(0.0, color="0.3", linewidth=0.5)
            lower.set_ylabel("simulated - measured" + unit)
            lower.set_xlabel(f"time [{self.time_unit}]")
            lower.legend(loc="best", fontsize="small")
        return figure


def _validated(fields: dict[str, Any]) -> ValidatedOutput:
    measured, residuals = fields["measured"], fields["residuals"]
    series = {"time": fields["times"], "measured": measured, "simulated": measured + residuals, "residuals": residuals}
    of_fit = {name: value for name, value in fields["fit"].items() if name in ValidatedOutput.__dataclass_fields__}
    return ValidatedOutput(**of_fit, **series, start_residuals=fields["start_residuals"])


@dataclass(frozen=True)
class Fold:
    """Recordings omitted from a fit, and the validation of the fit on them."""

    held_out: list[str]
    """Names of the omitted recordings."""
    parameters: dict[str, float]
    """Parameters fitted to the other recordings."""
    fit_rms: float
    """Root of the mean squared weighted residual of the other recordings."""
    nfev: int
    """Evaluations of the fit."""
    success: bool
    """True if the fit converged."""
    message: str
    """How the fit ended."""
    validation: Validation
    """Validation of the fit on the omitted recordings."""


class CrossValidation:
    """Fits without some of the recordings, each validated on the omitted ones; printed as a table.

    Attributes
    ----------
    folds : list of Fold
        The fits in the order of the recordings.
    unfinished : list of list of str
        Omitted recordings of the folds for which there was not enough time.
    rms : float
        Root of the mean squared weighted residual of all recordings, each from the fit that omitted it.
    parameters : dict of str to (float, float)
        Mean and standard deviation of the shared parameters over the folds.
    stats : SimulationStats
        Computational cost of all simulations.
    """

    unfinished: list[list[str]]
    rms: float
    parameters: dict[str, tuple[float, float]]

    def __init__(self, fields: dict[str, Any]) -> None:
        vars(self).update({name: fields[name] for name in CrossValidation.__annotations__})
        self.folds = [Fold(**{**fold, "validation": Validation(fold["validation"])}) for fold in fields["folds"]]
        self.stats = SimulationStats(**fields["stats"])
        self._text: str = fields["text"]

    def __repr__(self) -> str:
        return self._text


@dataclass(frozen=True, repr=False)
class PredictionBand:
    """The prediction of an output with its pointwise uncertainty. The intervals do not apply to the whole curve."""

    experiment: str
    """Name of the experiment."""
    variable: str
    """Name of the output in the model."""
    unit: str | None
    """Unit of the output, if the model declares one."""
    time: FloatArray
    """Times."""
    value: FloatArray
    """Predicted values."""
    standard_error: FloatArray
    """Standard error of the prediction due to the uncertainty of the parameters."""
    noise: FloatArray
    """Standard deviation of the noise of a measurement at each time: standard deviation of the residuals divided by
    the weight.

    It is interpolated linearly between measurements."""
    lower: FloatArray
    """Lower end of the interval of the model's output."""
    upper: FloatArray
    """Upper end of the interval of the model's output."""
    measured_lower: FloatArray
    """Lower end of the interval of a new measurement, including its noise."""
    measured_upper: FloatArray
    """Upper end of the interval of a new measurement, including its noise."""

    def __repr__(self) -> str:
        return _text.line(f"<PredictionBand of {self.variable} in {self.experiment} at {len(self.time)} times>")


def prediction_band(
    fit: Fit, times: npt.ArrayLike | None, level: float, outputs: Sequence[str] | str | None, corrected: bool
) -> dict[str, Any]:
    """Implements `Fit.prediction_band`."""
    rows = None if times is None else _values.vector("times", times).tolist()
    chosen = [outputs] if isinstance(outputs, str) else outputs
    names = None if chosen is None else [_values.choice("outputs", name) for name in chosen]
    calibration = fit._calibration
    extent = (_values.number("level", level), _values.flag("corrected", corrected))
    found = _core.prediction_bands(_export.native_of(fit), rows, extent, names)
    bands = [PredictionBand(**fields) for fields in found]
    by_experiment = [{b.variable: b for b in bands if b.experiment == name} for name in calibration.experiments]
    return by_experiment[0] if len(by_experiment) == 1 else dict(zip(calibration.experiments, by_experiment))


def validate(fit: Fit, experiment: Experiment | Sequence[Experiment] | None, windows: Windows | None) -> Validation:
    """Implements `Fit.validate`."""
    if (experiment is None) == (windows is None):
        raise BadCalibrationError("validation requires either another recording, experiment=Experiment(...), or windows=(from, to), but not both")
    experiments = None
    if experiment is not None:
        experiments = listed(experiment)
        if experiments is None:
            raise TypeError(f"experiment must be an Experiment or a list of Experiments, not {_text.show(experiment)}")
    return Validation(_core.validate(_export.native_of(fit), intervals("windows", windows), experiments))
