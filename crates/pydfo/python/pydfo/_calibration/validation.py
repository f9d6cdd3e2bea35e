"""How well a fit reproduces what it was not fitted to, and how uncertain its predictions are."""

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
    """An output of an experiment: measured, and simulated with fitted parameters."""

    experiment: str
    """Name of the experiment."""
    variable: str
    """Name of the output in the model."""
    column: str
    """Name of the column that measured it."""
    unit: str | None
    """Its unit, where the model states it."""
    n: int
    """How many measurements count."""
    rms: float
    """Root of the mean squared difference between simulation and measurement, without weights, in the unit of the output."""
    start_rms: float | None
    """The same at the start of the fit; None if the simulation failed there."""
    fit_percent: float
    """``100 (1 - |simulated - measured| / |measured - mean|)``; NaN where the measurements do not vary."""
    time: FloatArray
    """Times of the measurements, in s."""
    measured: FloatArray
    """What was measured."""
    simulated: FloatArray
    """What was simulated at these times."""
    residuals: FloatArray
    """Simulated minus measured, without weights."""
    start_residuals: FloatArray | None
    """The same at the start of the fit; None if the simulation failed there."""

    @property
    def scaled_rms(self) -> float | None:
        """RMS over that at the start of the fit."""
        return None if self.start_rms is None else self.rms / self.start_rms

    def __repr__(self) -> str:
        return _text.line(f"<ValidatedOutput {self.variable} in {self.experiment}: RMS {self.rms:.4g} over {self.n} measurements>")


class Validation:
    """How well fitted parameters reproduce measurements that they were not fitted to; printed as a table.

    Attributes
    ----------
    rms, start_rms, scaled_rms : float
        Root of the mean squared weighted residual; the same at the start of the fit (None if the simulation failed there), and the
        first over the second.
    n : int
        How many measurements count.
    outputs : list of ValidatedOutput
        Each output of each experiment: RMS, fit percentage, what was measured and simulated.
    parameters : dict of str to float
        The values: those of the fit; local parameters as the validated recordings have them.
    findings : list of Finding
        Measurements that the fit has seen: of these the RMS says nothing of predictions. The print has them, too.
    n_simulations : int
        Simulations that were made.
    stats : SimulationStats
        What they took.
    """

    n: int
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
        """The RMS over that at the start of the fit."""
        return None if self.start_rms is None else self.rms / self.start_rms

    def __repr__(self) -> str:
        return self._text

    def plot(self) -> Figure:
        """Draws what was measured and simulated, at the start and as fitted, and below the residuals of both.

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
            lower.set_xlabel("time [s]")
            lower.legend(loc="best", fontsize="small")
        return figure


def _validated(fields: dict[str, Any]) -> ValidatedOutput:
    measured, residuals = fields["measured"], fields["residuals"]
    series = {"time": fields["times"], "measured": measured, "simulated": measured + residuals, "residuals": residuals}
    return ValidatedOutput(**fields["fit"], **series, start_residuals=fields["start_residuals"])


@dataclass(frozen=True)
class Fold:
    """Recordings that were held out of a fit, and how well it reproduces them."""

    held_out: list[str]
    """Names of the recordings that were held out."""
    parameters: dict[str, float]
    """What was fitted to the others."""
    fit_rms: float
    """Root of the mean squared weighted residual of the others."""
    nfev: int
    """Evaluations of the fit."""
    success: bool
    """Whether it converged."""
    message: str
    """How it ended."""
    validation: Validation
    """How well it reproduces what was held out."""


class CrossValidation:
    """Fits without some of the recordings, each validated on those that it was not given; printed as a table.

    Attributes
    ----------
    folds : list of Fold
        Each fit, in the order of the recordings.
    unfinished : list of list of str
        Recordings that were to be held out in folds for which the time did not suffice.
    rms : float
        Root of the mean squared weighted residual of all recordings, each when it was held out.
    parameters : dict of str to (float, float)
        The shared parameters: mean over the folds, and standard deviation between them.
    stats : SimulationStats
        What all simulations took.
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
    """The prediction of an output, with its uncertainty at each time (of each alone, not of the curve as a whole)."""

    experiment: str
    """Name of the experiment."""
    variable: str
    """Name of the output in the model."""
    unit: str | None
    """Its unit, where the model states it."""
    time: FloatArray
    """Times, in s."""
    value: FloatArray
    """The prediction."""
    standard_error: FloatArray
    """Its standard error: what the uncertainty of the parameters makes of it."""
    noise: FloatArray
    """Standard deviation of the noise of a measurement at each time: that of the residuals over the weight of the measurement, between
    measurements along straight lines."""
    lower: FloatArray
    """The interval of the model's output: lower end."""
    upper: FloatArray
    """Upper end."""
    measured_lower: FloatArray
    """The interval of a new measurement, which has noise: lower end."""
    measured_upper: FloatArray
    """Upper end."""

    def __repr__(self) -> str:
        return _text.line(f"<PredictionBand of {self.variable} in {self.experiment} at {len(self.time)} times>")


def prediction_band(
    fit: Fit, times: npt.ArrayLike | None, level: float, outputs: Sequence[str] | str | None, corrected: bool
) -> dict[str, Any]:
    """`Fit.prediction_band`."""
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
    """`Fit.validate`."""
    if (experiment is None) == (windows is None):
        raise BadCalibrationError("a fit is validated on another recording, experiment=Experiment(...), or in windows=(from, to): one of both")
    experiments = None
    if experiment is not None:
        experiments = listed(experiment)
        if experiments is None:
            raise TypeError(f"experiment must be an Experiment or a list of such, not {_text.show(experiment)}")
    return Validation(_core.validate(_export.native_of(fit), intervals("windows", windows), experiments))
