"""Parameters to fit and their priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from .. import _core
from .._args.keywords import explained
from .._args.options import Record
from .._args.text import show
from .._args.values import names, number


@dataclass(frozen=True)
class Normal:
    """Prior knowledge of a parameter: a normal distribution.

    It adds one residual, ``(p - mean) / sd``, after the residuals of the measurements. The weights of the
    measurements should then be 1/sigma of their noise. `Fit.rms` does not include this residual.

    Parameters
    ----------
    mean, sd : float
        Mean and standard deviation, in the unit of the parameter.
    """

    mean: float
    sd: float

    def __post_init__(self) -> None:
        _numbers(self, mean=self.mean, sd=self.sd)

    def _record(self) -> Record:
        return {"normal": vars(self)}


@dataclass(frozen=True)
class LogNormal:
    """Prior knowledge of a positive parameter: a normal distribution of its logarithm.

    It adds one residual, ``(ln p - ln median) / sigma``; see `Normal`.

    Parameters
    ----------
    median : float
        Median in the unit of the parameter.
    sigma : float
        Standard deviation of the natural logarithm; 0.1 is about 10 %.
    """

    median: float
    sigma: float

    def __post_init__(self) -> None:
        _numbers(self, median=self.median, sigma=self.sigma)

    def _record(self) -> Record:
        return {"log-normal": vars(self)}


_PRIORS: dict[str, type[Normal | LogNormal]] = {"normal": Normal, "log-normal": LogNormal}


def _numbers(prior: Normal | LogNormal, **given: object) -> None:
    for name, value in given.items():
        object.__setattr__(prior, name, number(name, value))  # type: ignore[arg-type]


@dataclass(frozen=True, init=False)
class Parameter:
    """A parameter of the model to fit.

    Parameters
    ----------
    name : str
        Name of a parameter of the model, or of a variable whose start value is fitted, such as a state. With
        `variables`, `delay_of`, `offset_of` or `factor_of`, any name is allowed.
    start : float
        Start value of the fit, in the model's unit or in `unit`. A derived or tied parameter has no start value.
    lower, upper : float, optional
        Bounds; None if there is no bound.
    scale : {"linear", "log"}
        "log" searches over the logarithm of the value, for positive parameters known only to an order of magnitude.
        Values and bounds remain in the model's unit.
    nominal : float, optional
        Typical size, which determines steps and tolerances. Set it if `start` is 0 and there are no bounds. The
        default is the nominal value in the model. Without it, the default is the width of the bounds if it is at most
        100 times the start value, otherwise the start value. If the start is 0 and the bounds are wide, Nelder-Mead
        and least squares find the size by steps of powers of ten. "de" and other methods that sample the bounds
        always search all of them.
    kind : {"continuous", "integer", "categorical"}
        Values of the parameter: any value, integers, or integers that represent choices. Discrete parameters require
        "cma-es" or "de" (integers), or "ga" (both).
    fixed : bool
        If True, hold the parameter at `start`.
    periodic : bool
        If True, the parameter is an angle, and both bounds are the same point: ``Parameter("angle", 3, -pi, pi,
        periodic=True)``. The period is ``upper - lower``. The search crosses the bounds, and profiles and intervals may
        extend beyond them. The model and the results have values within the bounds. It cannot be combined with a log
        scale, a discrete kind, a prior or `delay_of`.
    local : bool
        If True, each experiment has a separate value, ``T0[run1]``, ``T0[run2]``, instead of one for all. If the
        `start_values` of an `Experiment` include the parameter, its search starts there.
    experiments : list of str, optional
        Names of the experiments in which the parameter acts. In the others, its variables keep the value of the
        model, a start value, or the value of another parameter; default: all.
    variables : list of str, optional
        Variables of the model that the parameter sets, all to one value. With ``[]``, it sets none and only acts through
        the formulas of derived parameters. A derived parameter is then only a result.
    delay_of : str, optional
        Compared output or input with this parameter as its delay. ``y(t - tau)`` is compared with the
        measurement at t, with the value at the start for earlier times. An input becomes ``u(t - tau)``. The
        parameter requires a finite lower bound.
    offset_of : str, optional
        Compared output or input to which the parameter is added.
    factor_of : str, optional
        Compared output or input that the parameter multiplies, before an offset is added: a calibration factor of a
        sensor, or a scaling factor of PEtab and PyBNF.
    tied_to : str, optional
        Name of another parameter that determines this one: its value is ``factor * other + offset``. The tied
        parameter is not an entry of ``x``. Bounds, prior and similar settings come from the other parameter.
        ``fit.parameters`` includes its value.
    factor, offset : float
        Factor and offset of `tied_to`.
    across_units : bool
        If True, `factor` has a unit. Otherwise, a tied parameter and the other one must have the same quantity, and
        the same unit if the factor is 1. The check covers units declared by the model.
    expr : str, optional
        Formula of a derived parameter over other parameters, such as ``"1 - k1 - k2"``. Its value is not searched.
        ``fit.parameters`` includes it, and ``fit.stderr`` its standard error, propagated with exact derivatives. Other
        derived parameters may occur in the formula. A value outside `lower` and `upper` is a failed evaluation. The
        operators are ``+ - * / **``, the functions sqrt, exp, log, log10, abs, min, max, sin, cos, tan, asin, acos,
        atan, atan2, sinh, cosh and tanh, the constants pi and e. Names with other characters than letters, digits,
        ``_``, dots and brackets are quoted: ``"2 * 'my name'"``.
    unit : str, optional
        Unit of start, bounds and results, if it differs from the unit in the model ("kJ/K", "degC"). Values are
        converted for the model.
    display_name : str, optional
        Name in reports and figures.
    prior : Normal or LogNormal, optional
        Prior knowledge of the parameter. Use bounds for a uniform prior. The noise of the measurements relative to
        the prior is estimated if the weights do not state it; see `noise` of `Calibration.fit`.

    Raises
    ------
    ValueError
        Inconsistent numbers: bounds that cross, a start outside the bounds, values that are not positive with a log
        scale, discrete values that are not integers. A mistake in `expr`, with its column.

    Examples
    --------
    >>> Parameter("armFriction", 0.012, 0, 0.022)
    Parameter('armFriction', 0.012, 0.0, 0.022)
    >>> Parameter("outlets", 3e-6, 2e-6, 4e-6, variables=["qt.a1", "qt.a2"], prior=LogNormal(3e-6, 0.1))
    Parameter('outlets', 3e-06, 2e-06, 4e-06, variables=('qt.a1', 'qt.a2'), prior=LogNormal(median=3e-06, sigma=0.1))
    >>> Parameter("tau", 0.05, 0, 1, delay_of="armJoint.phi")
    Parameter('tau', 0.05, 0.0, 1.0, delay_of='armJoint.phi')
    >>> Parameter("qt.a3", tied_to="outlets", factor=0.5)
    Parameter('qt.a3', tied_to='outlets', factor=0.5)
    >>> Parameter("k3", expr="1 - k1 - k2", lower=0)
    Parameter('k3', lower=0.0, expr='1 - k1 - k2')
    """

    name: str
    start: float | None
    lower: float
    upper: float
    scale: str
    nominal: float | None
    kind: str
    fixed: bool
    periodic: bool
    local: bool
    experiments: tuple[str, ...] | None
    variables: tuple[str, ...] | None
    delay_of: str | None
    offset_of: str | None
    factor_of: str | None
    tied_to: str | None
    factor: float
    offset: float
    across_units: bool
    expr: str | None
    unit: str | None
    display_name: str | None
    prior: Normal | LogNormal | None

    @explained
    def __init__(
        self,
        name: str,
        start: float | None = None,
        lower: float | None = None,
        upper: float | None = None,
        *,
        scale: Literal["linear", "log"] = "linear",
        nominal: float | None = None,
        kind: Literal["continuous", "integer", "categorical"] = "continuous",
        fixed: bool = False,
        periodic: bool = False,
        local: bool = False,
        experiments: Sequence[str] | str | None = None,
        variables: Sequence[str] | str | None = None,
        delay_of: str | None = None,
        offset_of: str | None = None,
        factor_of: str | None = None,
        tied_to: str | None = None,
        factor: float = 1.0,
        offset: float = 0.0,
        across_units: bool = False,
        expr: str | None = None,
        unit: str | None = None,
        display_name: str | None = None,
        prior: Normal | LogNormal | None = None,
    ) -> None:
        if prior is not None and not isinstance(prior, (Normal, LogNormal)):
            raise TypeError(f"prior must be pydfo.Normal(mean, sd) or pydfo.LogNormal(median, sigma), not {show(prior)}")
        listed = [variables] if isinstance(variables, str) else variables
        acting = [experiments] if isinstance(experiments, str) else experiments
        given: Record = {
            "name": name,
            "start": start,
            "lower": lower,
            "upper": upper,
            "scale": scale,
            "nominal": nominal,
            "kind": kind,
            "fixed": fixed,
            "periodic": periodic,
            "local": local,
            "experiments": None if acting is None else names("experiments", acting),
            "variables": None if listed is None else names("variables", listed),
            "delay_of": delay_of,
            "offset_of": offset_of,
            "factor_of": factor_of,
            "tied_to": tied_to,
            "factor": factor,
            "offset": offset,
            "across_units": across_units,
            "expr": expr,
            "unit": unit,
            "display_name": display_name,
            "prior": None if prior is None else prior._record(),
        }
        checked = _core.check_parameter(given)
        checked.update(prior=prior, variables=None if listed is None else tuple(given["variables"]))
        checked.update(experiments=None if acting is None else tuple(given["experiments"]))
        checked.update(lower=-np.inf if checked["lower"] is None else checked["lower"])
        checked.update(upper=np.inf if checked["upper"] is None else checked["upper"])
        for field, value in checked.items():
            object.__setattr__(self, field, value)

    def _record(self) -> Record:
        """Returns the parameter as a record for the native code."""
        return {**vars(self), "prior": None if self.prior is None else self.prior._record()}

    @classmethod
    def _of(cls, record: Record) -> Parameter:
        """Creates the parameter from a record of the native code."""
        prior = record["prior"]
        of_kind = None if prior is None else _PRIORS[next(iter(prior))](**next(iter(prior.values())))
        return cls(**{**record, "prior": of_kind})

    def __repr__(self) -> str:
        arguments = [repr(self.name)]
        if self.start is not None:
            arguments.append(repr(self.start))
            arguments.append("None" if self.lower == -np.inf else repr(self.lower))
            arguments.append("None" if self.upper == np.inf else repr(self.upper))
        else:
            bounds = {"lower": self.lower, "upper": self.upper}
            arguments += [f"{side}={bound!r}" for side, bound in bounds.items() if np.isfinite(bound)]
        for field in fields(self)[4:]:
            value = getattr(self, field.name)
            if value != _DEFAULTS.get(field.name):
                arguments.append(f"{field.name}={value!r}")
        return f"Parameter({', '.join(arguments)})"


#: Default values, which representations omit; None for all other fields.
_DEFAULTS = {"scale": "linear", "kind": "continuous", "fixed": False, "periodic": False, "local": False, "factor": 1.0, "offset": 0.0, "across_units": False}
