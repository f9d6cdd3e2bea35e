"""Profile likelihoods: the rise of the cost if one parameter is fixed away from its best value and the others are
refitted."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import options as _options
from .._args import text as _text
from .._args import values as _values
from .._errors import BadCalibrationError, Interrupted
from .._model.trajectory import SimulationStats
from . import export as _export

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .fit import Fit

FloatArray = npt.NDArray[np.float64]


class Profile:
    """Profile likelihoods of the parameters of a fit (``fit.profile()``); printed as a table.

    Attributes
    ----------
    intervals : dict of str to (float, float)
        Confidence intervals by parameter; infinite at open ends.
    messages : dict of str to str
        Reasons of open intervals; empty for closed intervals.
    values : dict of str to ndarray, shape (k,)
        Values at which a parameter was held, ascending, including the optimum.
    costs : dict of str to ndarray, shape (k,)
        Rise of the cost above the optimum at these values, with the other parameters refitted. It is the square of a
        distance in standard errors: the rise divided by the residual variance of `Uncertainty.covariance`. There is
        one variance for each output. With a robust loss, it is the variance of an M-estimator. It is corrected for
        autocorrelated residuals.
    factors : dict of str to float
        The costs divided by the statistic of a single variance, ``(N - p) (cost / minimum - 1)`` with the cost as a sum
        of squares. It differs from 1 if outputs have separate variances, which are estimated without bias, or if the
        intervals are corrected for autocorrelated residuals.
    points : dict of str to ndarray, shape (k, n)
        All parameters at these values.
    threshold : float
        The value of the costs at the ends of the intervals.
    level : float
        The level of the intervals.
    parameters : dict of str to float
        Optimum of the cost of the fit, inside the intervals. It is a more accurate optimum than the result of the
        fit.
    degrees_of_freedom : float
        Degrees of freedom of the fit, as in `Uncertainty`.
    interrupted : bool
        True if Ctrl-C ended the profile, so some sides are not complete.
    autocorrelated : bool
        True if residuals of an output are autocorrelated. The intervals are corrected for it, as in `Uncertainty`.
    n_simulations : int
        Number of points simulated, including the points of a continued file.
    stats : SimulationStats
        Computational cost of the simulations, without the simulations of a continued file.
    """

    intervals: dict[str, tuple[float, float]]
    messages: dict[str, str]
    values: dict[str, FloatArray]
    costs: dict[str, FloatArray]
    points: dict[str, FloatArray]
    factors: dict[str, float]
    level: float
    threshold: float
    degrees_of_freedom: float
    interrupted: bool
    autocorrelated: bool
    n_simulations: int

    def __init__(self, names: Sequence[str], fields: dict[str, Any], units: dict[str, str]) -> None:
        vars(self).update({name: fields[name] for name in Profile.__annotations__ if name in fields})
        for name, of_one in (("intervals", "interval"), ("messages", "message"), ("factors", "factor"), *((name, name) for name in ("values", "costs", "points"))):
            setattr(self, name, {profile["name"]: profile[of_one] for profile in fields["profiles"]})
        self.parameters: dict[str, float] = dict(zip(names, fields["x"].tolist()))
        self.stats = SimulationStats(**fields["stats"])
        self._text: str = fields["text"]
        #: Units of the parameters that have one.
        self._units = units

    @property
    def message(self) -> str:
        """The open intervals and their reasons; empty if there are none."""
        return "; ".join(f"{_text.line(name)}: {message}" for name, message in self.messages.items() if message)

    def __repr__(self) -> str:
        return self._text

    def plot(self) -> Figure:
        """Draws the cost against each parameter, with the threshold and the interval.

        Returns
        -------
        matplotlib.figure.Figure
            One panel per parameter. The figure is not shown or saved. Save it with
            ``profile.plot().savefig("profile.png")``.

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        from .. import _plot

        return _plot.profiles(self)


def of_fit(
    fit: Fit,
    parameters: str | Sequence[str] | None,
    level: SupportsFloat,
    corrected: bool,
    max_points: SupportsFloat | None,
    workers: SupportsIndex | None,
    checkpoint: str | os.PathLike[str] | None,
) -> Profile:
    """Returns the profiles of these parameters of a fit."""
    names = fit._calibration.names
    chosen = None
    if parameters is not None:
        given = _values.names("parameters", [parameters] if isinstance(parameters, str) else parameters)
        if unknown := [name for name in given if name not in names]:
            raise BadCalibrationError(f"unknown parameter '{unknown[0]}'; expected one of: {', '.join(names)}")
        chosen = [names.index(name) for name in given]
    units = {one["name"]: one["unit"] for one in fit.to_dict()["parameters"] if one.get("unit")}
    try:
        fields = _core.profile(
            _export.native_of(fit),
            chosen,
            (_values.number("level", level), _values.flag("corrected", corrected), _values.limit("max_points", max_points, 1)),
            _options.worker_count("workers", workers, None),
            None if checkpoint is None else _values.path("checkpoint", checkpoint),
        )
    except Interrupted as e:
        # Convert the partial result to a Profile.
        found: Any = e.result
        if isinstance(found, dict):
            e.result = Profile(names, found, units)
        raise
    return Profile(names, fields, units)
