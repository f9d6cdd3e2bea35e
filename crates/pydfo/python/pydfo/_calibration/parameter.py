"""What is fitted."""

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
    """What is known of a parameter before the fit: normally distributed.

    It adds one residual, ``(p - mean) / sd``, behind those of the measurements, whose weights should be 1/sigma of their
    noise then. `Fit.rms` does not count it.

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
    """What is known of a positive parameter before the fit: its logarithm is normally distributed.

    It adds one residual, ``(ln p - ln median) / sigma``; see `Normal`.

    Parameters
    ----------
    median : float
        In the unit of the parameter.
    sigma : float
        Standard deviation of the natural logarithm: 0.1 is about 10 %.
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
    """A parameter of the model to be fitted.

    Parameters
    ----------
    name : str
        Its name in the model: that of a parameter, or of a variable whose start value is fitted, a state for example. With `variables`,
        `delay_of` or `offset_of` the name is free.
    start : float
        Where the fit starts, in the model's unit (or in `unit`). A parameter that is tied has none.
    lower, upper : float, optional
        Bounds; None where there is none.
    scale : {"linear", "log"}
        Whether the search runs over the value or over its logarithm (for positive parameters known only to an order of
        magnitude). Values and bounds are in the model's unit either way.
    nominal : float, optional
        A typical size, from which steps and tolerances are taken; worth giving where `start` is 0 and there are no bounds.
        Default: the nominal value in the model, else the width of the bounds if it is at most 100 times the start value, else the
        start value; from a start at 0 with wide bounds Nelder-Mead and least squares find it by steps of powers of ten. "de" and
        the other methods that sample the bounds search all of them, however wide.
    kind : {"continuous", "integer", "categorical"}
        Whether it takes any value, whole numbers, or whole numbers that stand for choices. The search is then by "de"
        (integers) or "ga" (both).
    fixed : bool
        Hold the parameter at `start`.
    local : bool
        Each experiment has a value of its own, ``T0[run1]``, ``T0[run2]``, instead of one for all. Where the `start_values` of an
        `Experiment` name the parameter, its search starts there.
    variables : list of str, optional
        The variables of the model that it sets, all to the same value.
    delay_of : str, optional
        It is the delay in s of this output that is compared (``y(t - tau)`` with what was measured at t; before the start the value at the
        start), or of this input (``u(t - tau)``). It needs a finite lower bound.
    offset_of : str, optional
        It is added to this output that is compared, or to this input.
    tied_to : str, optional
        Name of another parameter that it follows: its value is ``factor * other + offset``. It is no entry of ``x`` then; bounds,
        prior and the like are those of the other, and ``fit.parameters`` has its value.
    factor, offset : float
        Those of `tied_to`.
    across_units : bool
        Whether `factor` has a unit: without it a parameter and the one that it is tied to must be quantities of one kind, and of one unit
        where the factor is 1 (as far as the model states units).
    unit : str, optional
        The unit of start, bounds and results, where the model states another one for the variable ("kJ/K", "degC"): values are converted
        for the model.
    display_name : str, optional
        What reports and figures call it.
    prior : Normal or LogNormal, optional
        What is known of it before the fit. (Uniform: the bounds.) The noise of the measurements that it counts beside is estimated where
        the weights do not state it; see `noise` of `Calibration.fit`.

    Raises
    ------
    ValueError
        Numbers that do not fit together: bounds that cross, a start outside of them, a log scale with values that are
        not positive, discrete values that are not whole.

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
    """

    name: str
    start: float | None
    lower: float
    upper: float
    scale: str
    nominal: float | None
    kind: str
    fixed: bool
    local: bool
    variables: tuple[str, ...] | None
    delay_of: str | None
    offset_of: str | None
    tied_to: str | None
    factor: float
    offset: float
    across_units: bool
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
        local: bool = False,
        variables: Sequence[str] | str | None = None,
        delay_of: str | None = None,
        offset_of: str | None = None,
        tied_to: str | None = None,
        factor: float = 1.0,
        offset: float = 0.0,
        across_units: bool = False,
        unit: str | None = None,
        display_name: str | None = None,
        prior: Normal | LogNormal | None = None,
    ) -> None:
        if prior is not None and not isinstance(prior, (Normal, LogNormal)):
            raise TypeError(f"prior must be pydfo.Normal(mean, sd) or pydfo.LogNormal(median, sigma), not {show(prior)}")
        listed = [variables] if isinstance(variables, str) else variables
        asked: Record = {
            "name": name,
            "start": start,
            "lower": lower,
            "upper": upper,
            "scale": scale,
            "nominal": nominal,
            "kind": kind,
            "fixed": fixed,
            "local": local,
            "variables": None if listed is None else names("variables", listed),
            "delay_of": delay_of,
            "offset_of": offset_of,
            "tied_to": tied_to,
            "factor": factor,
            "offset": offset,
            "across_units": across_units,
            "unit": unit,
            "display_name": display_name,
            "prior": None if prior is None else prior._record(),
        }
        checked = _core.check_parameter(asked)
        checked.update(prior=prior, variables=None if listed is None else tuple(asked["variables"]))
        checked.update(lower=-np.inf if checked["lower"] is None else checked["lower"])
        checked.update(upper=np.inf if checked["upper"] is None else checked["upper"])
        for field, value in checked.items():
            object.__setattr__(self, field, value)

    def _record(self) -> Record:
        """As the native code takes it."""
        return {**vars(self), "prior": None if self.prior is None else self.prior._record()}

    @classmethod
    def _of(cls, record: Record) -> Parameter:
        """The parameter of a record of the native code's."""
        prior = record["prior"]
        of_kind = None if prior is None else _PRIORS[next(iter(prior))](**next(iter(prior.values())))
        return cls(**{**record, "prior": of_kind})

    def __repr__(self) -> str:
        said = [repr(self.name)]
        if self.start is not None:
            said.append(repr(self.start))
            said.append("None" if self.lower == -np.inf else repr(self.lower))
            said.append("None" if self.upper == np.inf else repr(self.upper))
        for field in fields(self)[4:]:
            value = getattr(self, field.name)
            if value != _DEFAULTS.get(field.name):
                said.append(f"{field.name}={value!r}")
        return f"Parameter({', '.join(said)})"


#: What stands in no representation; None where it is not here.
_DEFAULTS = {"scale": "linear", "kind": "continuous", "fixed": False, "local": False, "factor": 1.0, "offset": 0.0, "across_units": False}
