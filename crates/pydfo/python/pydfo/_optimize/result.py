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

#: Numbers for the ways in which a run can end. Zero and multiples of ten are successes.
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
}


@dataclass(kw_only=True, eq=False, repr=False)
class Trace:
    """Every evaluation of a run: first those of its path, in request order, the same for any number of workers; then those
    that were made ahead of need and not needed.

    Attributes
    ----------
    x : ndarray, shape (m, n)
        The points, in the user's units.
    fun : ndarray, shape (m,)
        Their costs; NaN where the evaluation failed, or was given up because the cost could not matter any more.
    above : ndarray, shape (m,)
        Where an evaluation was given up: the value that the cost is known to exceed; NaN elsewhere.
    used : ndarray of bool, shape (m,)
        Whether the path of the method went through the point. False for points evaluated ahead of need and not needed,
        and for evaluations that the end of the run cut short; they are never returned as best.
    id, batch : ndarray of int, shape (m,)
        Running numbers of the point (from 2**63 on for points evaluated ahead of need) and of the batch it belonged to.
    seconds : ndarray, shape (m,)
        Wall-clock time of each evaluation, in s; an equal share of its batch for a vectorized objective and for a map.
    messages : dict of int to str
        Why evaluations failed, by their position in the trace.
    n_dropped : int
        Evaluations at the beginning of the run that a limit of the trace has dropped.
    problem : str or None
        The problem that the costs belong to (``options={"problem": ...}``; a `Calibration` has its own): a warm start
        reuses costs only where it is the same.
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
        """Which evaluations failed (shape (m,))."""
        failed = np.zeros(len(self), dtype=np.bool_)
        failed[list(self.messages)] = True
        return failed

    def best(self) -> int | None:
        """Position of the best used point, the first of equals; None if all failed."""
        candidates = np.where(self.used, self.fun, np.nan)
        return None if np.isnan(candidates).all() else int(np.nanargmin(candidates))

    def running_best(self) -> FloatArray:
        """The smallest cost of the used points up to each evaluation; infinite before the first (shape (m,))."""
        costs = np.where(self.used & ~np.isnan(self.fun), self.fun, np.inf)
        return np.minimum.accumulate(costs)

    def to_dataframe(self) -> Any:
        """The trace as a pandas.DataFrame, one row per evaluation. Needs pandas."""
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
    """A minimum that local searches from several starts ended at.

    Attributes
    ----------
    x : ndarray, shape (n,)
        The point.
    fun : float
        Its cost.
    n_starts : int
        How many starts led there.
    """

    x: FloatArray
    fun: float
    n_starts: int


class BarrierStage(NamedTuple):
    """One stage of a sequential barrier search.

    Attributes
    ----------
    mu : float
        The barrier parameter.
    barrier : float
        The barrier at the end of the stage.
    x : ndarray, shape (n,)
        The best point of the stage for the cost with its barrier.
    value : float
        That cost with its barrier: ``fun + mu * barrier``.
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

    Fields are attributes and dictionary entries (``res.x``, ``res["x"]``). Unpacked or indexed by number it is the
    five-tuple ``(x_opt, f_opt, nbr_iters, nbr_fevals, solve_time)`` of the paper's tool: ``res[0]`` is ``res.x``.

    Attributes
    ----------
    x : ndarray, shape (n,)
        The best point, in the user's units and order.
    fun : float
        The cost there.
    nit : int
        Complete iterations.
    nfev : int
        Evaluations of the path of the method: those of a run with one worker. What budgets count.
    nfail : int
        Calls that failed (an exception where tolerated, NaN, infinities).
    n_lost : int
        Answers that the executor lost, because a machine or a connection was gone. Their points were evaluated again and
        count once; a run ends with status 6 if the same point is lost three times.
    n_speculative : int
        Further calls of the objective: made ahead of need, and not needed. May depend on the number of workers and on how
        long calls take.
    n_cached : int
        Answers that count as no call, because the point was known already. Where only that it lies above a lower cutoff was
        known, it is called all the same, outside of budget and trace.
    n_batches : int
        Batches of calls that could run at once.
    solve_time : float
        Wall-clock time, in s.
    success : bool
        Whether the tolerance tests passed, or the target was reached, or all parameters are fixed. A search from several starts
        ("multistart", ``search="global"``) that a limit ended is no success: it may have missed the best minimum.
    status : int
        0 converged, 10 target reached, 30 all parameters fixed; 1 evaluations, 2 iterations, 3 time used up; 4 stopped by
        a callback, 5 interrupted, 6 ended by an exception, 7 the checkpoint could not be written; 11 the simplex or
        population has no extent left, 12 only one vertex has a cost, 13 every point failed, 14 nothing new for long, 15 the
        cost did not change, 16 it fell without bound, 17 too many calls failed, 18 points around the best one fail, 19 the
        fit has found that one more step of least squares lowers the cost.
    termination : str
        The same in a word.
    message : str
        The same in a sentence, with the test that fired and its values.
    x_size, f_spread : float or None
        Last values of the two tests: extent of the simplex or population, spread of its costs.
    final_simplex : tuple of ndarray or None
        Vertices (n + 1, n) and their costs (n + 1,), best first, for methods that have a simplex.
    final_population : tuple of ndarray or None
        Members (m, n) and their costs (m,), best first, for methods that have a population.
    schedule : tuple of BarrierStage
        The stages of a sequential barrier search.
    seed : int or None
        The seed of the random numbers, given or drawn; None for methods that draw none.
    failures : dict of str to int
        The reasons of failed calls and how often each occurred.
    trace : Trace or None
        Every evaluation.
    optima : tuple of Optimum
        The distinct minima that local searches from several starts ended at, the lowest first ("multistart"). A run that was cut off may
        have a result that is lower than all of them.
    method, batch : str
        The method, and its plan of which points are evaluated ahead of need.
    method_reason : str or None
        Why the method was chosen, where the choice was left open ("auto").
    options : dict of str to str
        The options of the method and the tolerances, by name, as text.
    workers : int
        Evaluations that could run at once.
    figures : tuple of matplotlib figures
        What ``plot`` and ``plot_conv`` drew.
    jac : ndarray, shape (m, n), or None
        The derivatives of the residuals by the parameters (in the user's units, also where a parameter is searched by its
        logarithm; zero for fixed ones), as the model of "least-squares" has them at the end; None for other methods.
    active_mask : ndarray of int, shape (n,), or None
        With ``jac``: -1 where a parameter lies at its lower bound (fixed ones, too), 1 at its upper, else 0.
    cov : ndarray, shape (n, n), or None
        With ``jac``, the covariance of the parameters: ``s**2 * inv(J.T @ J)`` with ``s**2 = sum(r**2) / (m - n)`` over the
        parameters that lie at no bound; zero for the others, infinite for those that the residuals do not determine: combinations
        of parameters whose effect is less than curvature and rounding of the residuals make of it.
    cov_message : str
        What is to be said of ``cov``, in words; empty if nothing is.
    """

    x: FloatArray
    fun: Any
    nit: int
    nfev: int
    nfail: int
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

    def __post_init__(self) -> None:
        self.status = STATUS[self.termination]

    @classmethod
    def _of(cls, record: dict[str, Any]) -> OptimizeResult:
        """That of a record of the native code's."""
        found = _progress.named(record, cls)
        if "schedule" in found:
            found["schedule"] = tuple(BarrierStage(*stage.values()) for stage in found["schedule"])
            found["optima"] = tuple(Optimum(*optimum.values()) for optimum in found["optima"])
            found["active_mask"] = None if found["jac"] is None else np.array(found["active_mask"], dtype=np.int64)
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
            raise KeyError(f"{key} (there are: {', '.join(vars(self))})") from None

    def __iter__(self) -> Iterator[Any]:
        return iter(self._tuple())

    def __len__(self) -> int:
        return 5

    def __contains__(self, key: object) -> bool:
        return key in vars(self)

    def keys(self) -> KeysView[str]:
        """Names of the fields."""
        return vars(self).keys()

    def values(self) -> ValuesView[Any]:
        """Values of the fields."""
        return vars(self).values()

    def items(self) -> ItemsView[str, Any]:
        """Pairs of name and value."""
        return vars(self).items()

    def get(self, key: str, default: Any = None) -> Any:
        """The field of a name, or `default`."""
        return vars(self).get(key, default)

    def __repr__(self) -> str:
        evaluations = f"{self.nfev} in {self.n_batches} batches" if self.n_batches else str(self.nfev)
        remarks = [f"{n} {what}" for n, what in ((self.nfail, "failed"), (self.n_lost, "lost"), (self.n_speculative, "speculative")) if n]
        lines = [
            ("message", _text.line(self.message)),
            ("success", f"{self.success} (status {self.status}, {self.termination})"),
            *self._value_lines(),
            ("x", np.array2string(np.asarray(self.x), prefix=" " * 13)),
            ("nit", str(self.nit)),
            ("nfev", evaluations + (f" ({', '.join(remarks)})" if remarks else "")),
            ("solve_time", f"{self.solve_time:.3g} s"),
        ]
        return "\n".join(f"{name:>10}: {text}" for name, text in lines)


@dataclass(kw_only=True, eq=False, repr=False)
class LeastSquaresResult(OptimizeResult):
    """The result of `least_squares`: ``fun`` is the vector of residuals, and ``cost`` their sum of squares.

    ``cost`` has no factor 1/2, which SciPy's has. With a loss other than "linear" it is the sum of
    ``f_scale**2 * rho((r / f_scale)**2)``, and ``sum_of_squares`` the plain sum. All else is as in `OptimizeResult`; unpacked
    or indexed by number it is ``(x, cost, nit, nfev, solve_time)``.

    Attributes
    ----------
    fun : ndarray, shape (m,)
        The residuals at ``x``, whatever the loss. (Empty in the result of a run that was interrupted twice.)
    cost : float
        What was minimised: the smallest of all evaluations.
    sum_of_squares : float
        The sum of the squares of ``fun``.
    jac : ndarray, shape (m, n), or None
        The derivatives of ``fun`` by the parameters, whatever the loss, by a regression on the points around ``x``: good to a few
        digits, not to the last. None where the run ended before there were enough points.
    cov : ndarray, shape (n, n), or None
        As in `OptimizeResult`. With a loss it is that of the M-estimator, as fits of a `Calibration` use it: ``s**2`` is the mean
        square of the scores over the square of their mean slope (Huber, Robust Statistics, 1981, section 7.6).
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
