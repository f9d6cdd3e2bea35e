"""Profile likelihoods: how the cost rises as one parameter is held away from its best value and the others are fitted again."""

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
        Confidence intervals by parameter; infinite where an end is open.
    messages : dict of str to str
        Why an interval is open, in words; empty where it is not.
    values : dict of str to ndarray, shape (k,)
        Where a parameter was held, ascending; the optimum is one of them.
    costs : dict of str to ndarray, shape (k,)
        How much the cost is above that of the optimum there, the others fitted again, as the square of a distance in standard
        errors: the rise over the variance that `Uncertainty.covariance` has for the residuals (one for each output; with a robust loss that
        of an M-estimator; corrected where residuals are autocorrelated).
    points : dict of str to ndarray, shape (k, n)
        All parameters there.
    threshold : float
        What the costs are at the ends of the intervals.
    level : float
        The level of the intervals.
    parameters : dict of str to float
        The optimum of the fit's cost, about which the intervals are: that of the fit, found more accurately.
    degrees_of_freedom : float
        Degrees of freedom of the fit, as in `Uncertainty`.
    interrupted : bool
        Whether Ctrl-C ended it: some sides are not complete.
    autocorrelated : bool
        Whether residuals of an output are autocorrelated: the intervals are corrected for that, as those of `Uncertainty`.
    n_simulations : int
        Points that were simulated, those of a file that was continued included.
    stats : SimulationStats
        What the simulations took, without those of a file that was continued.
    """

    intervals: dict[str, tuple[float, float]]
    messages: dict[str, str]
    values: dict[str, FloatArray]
    costs: dict[str, FloatArray]
    points: dict[str, FloatArray]
    level: float
    threshold: float
    degrees_of_freedom: float
    interrupted: bool
    autocorrelated: bool
    n_simulations: int

    def __init__(self, names: Sequence[str], fields: dict[str, Any], units: dict[str, str]) -> None:
        vars(self).update({name: fields[name] for name in Profile.__annotations__ if name in fields})
        for name, of_one in (("intervals", "interval"), ("messages", "message"), *((name, name) for name in ("values", "costs", "points"))):
            setattr(self, name, {profile["name"]: profile[of_one] for profile in fields["profiles"]})
        self.parameters: dict[str, float] = dict(zip(names, fields["x"].tolist()))
        self.stats = SimulationStats(**fields["stats"])
        self._text: str = fields["text"]
        #: Of the parameters that have one.
        self._units = units

    @property
    def message(self) -> str:
        """Which intervals are open, and why; empty if none is."""
        return "; ".join(f"{_text.line(name)}: {message}" for name, message in self.messages.items() if message)

    def __repr__(self) -> str:
        return self._text

    def plot(self) -> Figure:
        """Draws the cost over each parameter, with the threshold and the interval.

        Returns
        -------
        matplotlib.figure.Figure
            One panel per parameter. Nothing is shown or saved: ``profile.plot().savefig("profile.png")``.

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
    """The profiles of these parameters of a fit."""
    names = fit._calibration.names
    chosen = None
    if parameters is not None:
        given = _values.names("parameters", [parameters] if isinstance(parameters, str) else parameters)
        if unknown := [name for name in given if name not in names]:
            raise BadCalibrationError(f"there is no parameter '{unknown[0]}'; there are: {', '.join(names)}")
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
        # What there is so far, as the class that holds it.
        found: Any = e.result
        if isinstance(found, dict):
            e.result = Profile(names, found, units)
        raise
    return Profile(names, fields, units)
