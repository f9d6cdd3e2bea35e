"""Results: fields by name as in SciPy, and the five values of the paper's tool when unpacked."""

from __future__ import annotations

from collections.abc import ItemsView, Iterator, KeysView, Sequence, ValuesView
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from .._args import optional_libraries as _optional_libraries
from .._args import text as _text
from . import progress as _progress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = npt.NDArray[np.float64]

#: Status numbers of the ways in which a run can end. Zero and multiples of ten are successes.
STATUS: Final[dict[str, int]] = {
    "converged": 0,
    "target": 10,
    "noise": 20,
    "all-fixed": 30,
    "max-evaluations": 1,
    "max-iterations": 2,
    "max-time": 3,
    "stopped-by-observer": 4,
    "interrupted": 5,
    "aborted": 6,
    "not-saved": 7,
    "collapsed": 11,
    "one-finite-vertex": 12,
    "all-failed": 13,
    "stalled": 14,
    "constant-cost": 15,
    "unbounded": 16,
    "too-many-failed": 17,
    "beside-failures": 18,
    "before-minimum": 19,
    "infeasible": 21,
}


@dataclass(kw_only=True, eq=False, repr=False)
class Trace:
    """Every evaluation of a run.

    The evaluations of the path come first, in request order, and do not depend on the number of workers. Unneeded
    speculative evaluations follow.

    Attributes
    ----------
    x : ndarray, shape (m, n)
        The points, in the user's units.
    fun : ndarray, shape (m,)
        Costs of the points; NaN if the evaluation failed, or was abandoned because its cost could no longer matter.
    above : ndarray, shape (m,)
        Lower bound of the cost of an abandoned evaluation; NaN for other evaluations.
    used : ndarray of bool, shape (m,)
        True if the point is on the path of the method. False for unneeded speculative points, and for
        evaluations cut short by the end of the run. These points are never returned as best.
    id, batch : ndarray of int, shape (m,)
        Sequence numbers of the point (from 2**63 on for speculative points) and of its batch.
    seconds : ndarray, shape (m,)
        Wall-clock time of each evaluation in s. For a vectorized objective and for a map, an equal share of the
        batch.
    messages : dict of int to str
        Reasons of failed evaluations, by their index in the trace.
    n_dropped : int
        Number of evaluations at the start of the run dropped because of a limit of the trace.
    problem : str or None
        Problem of the costs (``options={"problem": ...}``; set by a `Calibration`). A warm start reuses costs only if
        the problem is the same.
    """

    x: FloatArray
    fun: FloatArray
    above: FloatArray
    used: npt.NDArray[np.bool_]
    id: npt.NDArray[np.uint64]
    batch: npt.NDArray[np.uint64]
    seconds: FloatArray
    messages: dict[int, str]
    n_dropped: int = 0
    problem: str | None = None

    @property
    def failed(self) -> npt.NDArray[np.bool_]:
        """True for failed evaluations, shape (m,)."""
        failed = np.zeros(len(self), dtype=np.bool_)
        failed[list(self.messages)] = True
        return failed

    def best(self) -> int | None:
        """Returns the index of the best used point, the first if several are equal; None if all failed."""
        candidates = np.where(self.used, self.fun, np.nan)
        return None if np.isnan(candidates).all() else int(np.nanargmin(candidates))

    def running_best(self) -> FloatArray:
        """Returns the smallest cost of the used points up to each evaluation, shape (m,); infinite before the first
        cost."""
        costs = np.where(self.used & ~np.isnan(self.fun), self.fun, np.inf)
        return np.minimum.accumulate(costs)

    def to_dataframe(self) -> Any:
        """Returns the trace as a pandas.DataFrame, one row per evaluation. Needs pandas."""
        columns: dict[str, Any] = {f"x{i}": self.x[:, i] for i in range(self.x.shape[1])}
        columns |= {"fun": self.fun, "above": self.above, "used": self.used, "failed": self.failed}
        columns |= {"batch": self.batch, "seconds": self.seconds}
        return _optional_libraries.pandas().DataFrame(columns)

    def __len__(self) -> int:
        return len(self.fun)

    def __repr__(self) -> str:
        failed, unused = len(self.messages), int(np.count_nonzero(~self.used))
        return f"<Trace: {len(self)} evaluations of {self.x.shape[1]} parameters, {failed} failed, {unused} unused>"


class Optimum(NamedTuple):
    """A minimum found by local searches from several starts.

    Attributes
    ----------
    x : ndarray, shape (n,)
        The point.
    fun : float
        Cost at the point.
    n_starts : int
        Number of starts that led to the point.
    """

    x: FloatArray
    fun: float
    n_starts: int


@dataclass(frozen=True)
class ActiveConstraint:
    """An active constraint at the best point.

    Attributes
    ----------
    is_linear : bool
        True for a linear constraint.
    index : int
        Index among the linear rows or among the values of the nonlinear constraints.
    multiplier : float
        Decrease of the cost per unit by which the active limit moves outwards.
    """

    is_linear: bool
    index: int
    multiplier: float


class BarrierStage(NamedTuple):
    """One stage of a sequential barrier search.

    Attributes
    ----------
    mu : float
        The barrier parameter.
    barrier : float
        Value of the barrier at the end of the stage.
    x : ndarray, shape (n,)
        Best point of the stage for the cost with its barrier.
    value : float
        Cost with the barrier at the best point: ``fun + mu * barrier``.
    nfev : int
        Calls of the objective in the stage.
    """

    mu: float
    barrier: float
    x: FloatArray
    value: float
    nfev: int


@dataclass(kw_only=True, eq=False, repr=False)
class OptimizeResult:
    """The result of a minimisation.

    Fields are attributes and dictionary entries (``res.x``, ``res["x"]``). Unpacking and integer indices use the
    five-tuple ``(x_opt, f_opt, nbr_iters, nbr_fevals, solve_time)`` of the paper's tool: ``res[0]`` is ``res.x``.

    Attributes
    ----------
    x : ndarray, shape (n,)
        The best point, in the user's units and order.
    fun : float
        Cost at the best point.
    nit : int
        Number of complete iterations.
    nfev : int
        Number of evaluations of the path of the method, equal to a run with one worker. Budgets count these.
    nfail : int
        Number of calls that failed (a tolerated exception, NaN or infinity).
    n_infeasible : int
        Number of points whose cost was not evaluated, because they violate a constraint with ``keep_feasible``.
    n_lost : int
        Number of results that the executor lost because a machine or a connection failed, and of overdue tasks
        (`Resubmit`). Their points were evaluated again and count once. A run ends with status 6 if a point is lost three
        times.
    n_speculative : int
        Number of further calls of the objective, made speculatively and not needed. It may depend on the number of
        workers and on the duration of calls.
    n_cached : int
        Number of results that needed no call because the point was known. If only a lower cutoff was known to be
        exceeded, the objective is called again, outside the budget and the trace.
    n_batches : int
        Number of batches of calls that could run at once.
    solve_time : float
        Wall-clock time in s.
    success : bool
        True if the tolerance tests passed, the target was reached, or all parameters are fixed. A search from several
        starts ("multistart", ``search="global"``) that a limit ended is not a success, because it may have missed the
        best minimum.
    status : int
        0 converged, 10 target reached, 20 the noise of the residuals hides any further decrease (a success if the x
        test passed), 30 all parameters fixed; 1 limit of evaluations, 2 limit of iterations, 3 limit of time; 4
        stopped by a callback, 5 interrupted, 6 ended by an exception, 7 the checkpoint could not be written; 11 the
        simplex or population collapsed, 12 only one vertex has a cost, 13 every point failed, 14 stalled, 15 the cost
        did not change, 16 the cost is unbounded below, 17 too many calls failed, 18 points around the best one fail,
        19 one more step of least squares after the fit lowers the cost, 21 the best point violates a nonlinear
        constraint.
    termination : str
        The status as a word.
    message : str
        The status as a sentence, with the test that ended the run and its values.
    x_size, f_spread : float or None
        Last values of the two tests: extent of the simplex or population, and spread of its costs.
    final_simplex : tuple of ndarray or None
        Vertices (n + 1, n) and their costs (n + 1,), best first, for methods that have a simplex.
    final_population : tuple of ndarray or None
        Members (m, n) and their costs (m,), best first, for methods that have a population.
    schedule : tuple of BarrierStage
        The stages of a sequential barrier search.
    seed : int or None
        Seed of the random numbers, given or drawn; None for methods without random numbers.
    failures : dict of str to int
        Reasons of failed calls and their counts.
    trace : Trace or None
        Every evaluation.
    optima : tuple of Optimum
        The distinct minima found by local searches from several starts, lowest first ("multistart"). The result of a
        run that was cut off may be lower than all of them.
    method, batch : str
        Name of the method, and its batch plan as text. `batch_plan` is the plan as a value for ``batch=``.
    method_reason : str or None
        Reason for the chosen method if it was "auto".
    options : dict of str to str
        The options of the method and the tolerances by name, as strings.
    workers : int
        Number of evaluations that could run at once.
    figures : tuple of matplotlib figures
        Figures of ``plot`` and ``plot_conv``.
    jac : ndarray, shape (m, n), or None
        Derivatives of the residuals with respect to the parameters from the final model of "least-squares"; None for
        other methods. They are in the user's units, even if a parameter is searched by its logarithm, and zero for
        fixed parameters.
    active_mask : ndarray of int, shape (n,), or None
        With ``jac``: -1 if a parameter is at its lower bound (even if it is fixed), 1 at its upper bound, otherwise 0.
    cov : ndarray, shape (n, n), or None
        With ``jac``, the covariance of the parameters: ``s**2 * inv(J.T @ J)`` with ``s**2 = sum(r**2) / (m - n)``
        over the parameters that are not at a bound. It is zero for parameters at a bound and infinite for parameters
        that the residuals do not determine. The effect of such combinations of parameters is smaller than the
        curvature and rounding of the residuals.
    cov_message : str
        Remarks on ``cov``; empty if there are none.
    constr_violation : float
        Largest violation of a nonlinear constraint at ``x``; 0 without nonlinear constraints.
    constraints : ndarray, shape (m,)
        Values of the nonlinear constraints at ``x``.
    multipliers : tuple of ActiveConstraint
        The active constraints with their Lagrange multipliers, for methods that have them.
    """

    x: FloatArray
    fun: Any
    nit: int
    nfev: int
    nfail: int
    n_infeasible: int = 0
    n_lost: int = 0
    n_speculative: int = 0
    n_batches: int = 0
    n_cached: int = 0
    solve_time: float
    success: bool
    status: int = field(init=False)
    termination: str
    message: str
    x_size: float | None = None
    f_spread: float | None = None
    final_simplex: tuple[FloatArray, FloatArray] | None = None
    final_population: tuple[FloatArray, FloatArray] | None = None
    schedule: Sequence[BarrierStage] = ()
    optima: Sequence[Optimum] = ()
    method_reason: str | None = None
    options: dict[str, str] = field(default_factory=dict)
    seed: int | None = None
    failures: dict[str, int] = field(default_factory=dict)
    trace: Trace | None = None
    method: str = "nelder-mead"
    batch: str = ""
    workers: int = 1
    figures: tuple[Figure, ...] = ()
    jac: FloatArray | None = None
    active_mask: npt.NDArray[np.int64] | None = None
    cov: FloatArray | None = None
    cov_message: str = ""
    constr_violation: float = 0.0
    constraints: FloatArray = field(default_factory=lambda: np.empty(0))
    multipliers: Sequence[ActiveConstraint] = ()

    def __post_init__(self) -> None:
        self.status = STATUS[self.termination]

    @property
    def batch_plan(self) -> str | int:
        """The batch plan as a value for the argument ``batch``. With it, another run follows the same path on any
        machine, for any number of workers."""
        return int(self.batch) if self.batch.isdigit() else self.batch

    @classmethod
    def _of(cls, record: dict[str, Any]) -> OptimizeResult:
        """Creates the result from a record of the native code."""
        found = _progress.named(record, cls)
        if "schedule" in found:
            found["schedule"] = tuple(BarrierStage(*stage.values()) for stage in found["schedule"])
            found["optima"] = tuple(Optimum(*optimum.values()) for optimum in found["optima"])
            found["active_mask"] = None if found["jac"] is None else np.array(found["active_mask"], dtype=np.int64)
            found["multipliers"] = tuple(ActiveConstraint(*active.values()) for active in found["multipliers"])
            found.update(options=dict(found["options"]), failures=dict(found["failures"]))
        return cls(**found)

    def _tuple(self) -> tuple[FloatArray, float, int, int, float]:
        return self.x, self.fun, self.nit, self.nfev, self.solve_time

    def _value_lines(self) -> list[tuple[str, str]]:
        return [("fun", f"{self.fun!r}")]

    @overload
    def __getitem__(self, key: slice) -> tuple[Any, ...]: ...
    @overload
    def __getitem__(self, key: int | str) -> Any: ...
    def __getitem__(self, key: int | str | slice) -> Any:
        if not isinstance(key, str):
            return self._tuple()[key]
        try:
            return vars(self)[key]
        except KeyError:
            raise KeyError(f"{key} (expected one of: {', '.join(vars(self))})") from None

    def __iter__(self) -> Iterator[Any]:
        return iter(self._tuple())

    def __len__(self) -> int:
        return 5

    def __contains__(self, key: object) -> bool:
        return key in vars(self)

    def keys(self) -> KeysView[str]:
        """Returns the names of the fields."""
        return vars(self).keys()

    def values(self) -> ValuesView[Any]:
        """Returns the values of the fields."""
        return vars(self).values()

    def items(self) -> ItemsView[str, Any]:
        """Returns pairs of name and value."""
        return vars(self).items()

    def get(self, key: str, default: Any = None) -> Any:
        """Returns the field with this name, or `default`."""
        return vars(self).get(key, default)

    def __repr__(self) -> str:
        evaluations = f"{self.nfev} in {self.n_batches} batches" if self.n_batches else str(self.nfev)
        remarks = [f"{n} {what}" for n, what in ((self.nfail, "failed"), (self.n_infeasible, "infeasible"), (self.n_lost, "lost"), (self.n_speculative, "speculative")) if n]
        lines = [
            ("message", _text.line(self.message)),
            ("success", f"{self.success} (status {self.status}, {self.termination})"),
            *self._value_lines(),
            ("x", np.array2string(np.asarray(self.x), prefix=" " * 13)),
            ("nit", str(self.nit)),
            ("nfev", evaluations + (f" ({', '.join(remarks)})" if remarks else "")),
            ("solve_time", f"{self.solve_time:.3g} s"),
        ]
        if self.constraints.size:
            lines.insert(-2, ("violation", f"{self.constr_violation:.3g}"))
        return "\n".join(f"{name:>10}: {text}" for name, text in lines)


@dataclass(kw_only=True, eq=False, repr=False)
class LeastSquaresResult(OptimizeResult):
    """The result of `least_squares`: ``fun`` is the vector of residuals, and ``cost`` their sum of squares.

    ``cost`` has no factor 1/2, unlike SciPy. With a loss other than "linear", it is the sum of
    ``f_scale**2 * rho((r / f_scale)**2)``, and ``sum_of_squares`` is the plain sum. The other fields are as in
    `OptimizeResult`. Unpacking and integer indices use ``(x, cost, nit, nfev, solve_time)``.

    Attributes
    ----------
    fun : ndarray, shape (m,)
        Residuals at ``x``, without the loss. Empty if the run was interrupted twice.
    cost : float
        The minimised function at ``x``: the smallest value of all evaluations.
    sum_of_squares : float
        The sum of the squares of ``fun``.
    jac : ndarray, shape (m, n), or None
        Derivatives of ``fun`` with respect to the parameters, without the loss, from a regression on the points
        around ``x``. They are accurate to a few digits only. None if the run ended before there were enough points.
    cov : ndarray, shape (n, n), or None
        As in `OptimizeResult`. With a loss, the covariance of the M-estimator, as in fits of a `Calibration`:
        ``s**2`` is the mean square of the scores divided by the square of their mean slope (Huber, Robust Statistics,
        1981, section 7.6).
    """

    cost: float
    sum_of_squares: float

    @classmethod
    def _of(cls, record: dict[str, Any]) -> OptimizeResult:
        residuals, cost = record.get("residuals", np.empty(0)), record["fun"]
        rest = {"fun": residuals, "cost": cost, "sum_of_squares": record.get("sum_of_squares", cost)}
        return super()._of({**record, **rest})

    def _tuple(self) -> tuple[FloatArray, float, int, int, float]:
        return self.x, self.cost, self.nit, self.nfev, self.solve_time

    def _value_lines(self) -> list[tuple[str, str]]:
        shown = np.array2string(self.fun, prefix=" " * 13, threshold=8, edgeitems=2)
        return [("cost", f"{self.cost!r}"), ("fun", shown)]
