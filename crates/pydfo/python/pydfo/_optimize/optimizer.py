"""`Optimizer`: a run controlled by the user, who asks for points and reports their costs."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple, SupportsFloat, SupportsIndex

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import options as _options
from .._args import values as _values
from .._args.keywords import explained
from . import constraints as _constraints
from .minimize import describe
from .result import OptimizeResult

FloatArray = npt.NDArray[np.float64]


class Asked(NamedTuple):
    """Points to evaluate.

    Attributes
    ----------
    ids : ndarray of int, shape (k,)
        Numbers of the points, to be passed to `Optimizer.tell`.
    x : ndarray, shape (k, n)
        The points.
    cutoffs : ndarray, shape (k,)
        Cost above which the value of a point makes no difference; infinite if there is none.
    """

    ids: npt.NDArray[np.uint64]
    x: FloatArray
    cutoffs: FloatArray


class Above(NamedTuple):
    """The value of a point whose evaluation was abandoned because its cost exceeds the cutoff of the point.

    It never counts as a cost. A method makes the same decision as with the cost.

    Attributes
    ----------
    cutoff : float
        Strict lower bound of the cost, at least the cutoff of the point. A smaller value is a failed evaluation.
    """

    cutoff: float


class Optimizer:
    """A run controlled by the user.

    The trace is bit-for-bit identical to `minimize` with the same arguments, for any order and grouping of the
    results. Methods work in rounds: `ask` returns no points while results of a round are missing.

    Parameters
    ----------
    method : str
        As in `minimize`.
    x0, bounds, rng, max_evaluations, max_iterations, max_time, target, options, checkpoint, resume, search : optional
        As in `minimize`. The checkpoint is written after each complete round, at the end, and by `save`.
    constraints : optional
        As in `minimize`. The functions of nonlinear constraints are called by `tell`, which knows the points, unless it
        receives their values.
    workers : int
        Number of points that will be evaluated at once. A batch plan may depend on it.

    Examples
    --------
    >>> import pydfo
    >>> opt = pydfo.Optimizer("de", bounds=[(-5, 5), (-5, 5)], rng=1, max_evaluations=600)
    >>> while not opt.done:
    ...     ids, points, _ = opt.ask(4)
    ...     opt.tell(ids, [(x[0] - 1) ** 2 + (x[1] + 2) ** 2 for x in points])
    >>> opt.report().x.round(1)
    array([ 1., -2.])
    """

    @explained
    def __init__(
        self,
        method: str = "auto",
        x0: npt.ArrayLike | None = None,
        bounds: Any = None,
        workers: SupportsIndex = 1,
        rng: int | np.random.Generator | None = None,
        max_evaluations: SupportsFloat | None = None,
        max_iterations: SupportsFloat | None = None,
        max_time: SupportsFloat | None = None,
        target: SupportsFloat | None = None,
        options: Mapping[str, Any] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        resume: Literal["auto", "never", "require"] = "auto",
        search: Literal["local", "global"] = "local",
        constraints: Any = None,
    ) -> None:
        native, self._function = _constraints.of_call(constraints, x0, bounds)
        #: Pending points, whose constraint values are computed when their costs are reported.
        self._points: dict[int, FloatArray] = {}
        count = _options.worker_count("workers", workers, 1)
        _options.tell_of_checkpoint(checkpoint, resume, options)
        described = describe(
            Optimizer,
            method,
            x0,
            bounds,
            options,
            rng=rng,
            checkpoint=checkpoint,
            workers=count,
            max_evaluations=max_evaluations,
            max_iterations=max_iterations,
            max_time=max_time,
            target=target,
            resume=resume,
            search=search,
        )
        _constraints.complete(described[-1], self._function)
        self._native = _core.Optimizer(*described, native)

    def ask(self, k: SupportsIndex | None = None) -> Asked:
        """Returns at most `k` points to evaluate (None: all of the round); none while results are missing, and after
        the end."""
        at_most = None if k is None else _values.limit("k", _values.index("k", k), 0)
        asked = Asked(*self._native.ask(at_most))
        if self._function is not None:
            # The caller may change the points.
            self._points.update(zip(asked.ids.tolist(), asked.x.copy()))
        return asked

    def tell(self, ids: SupportsIndex | Iterable[SupportsIndex], values: Any, constraints: Any = None) -> None:
        """Reports the costs of points, or their residuals ("least-squares"), in any order and grouping.

        Parameters
        ----------
        ids : int or sequence of int
            Numbers of requested points.
        values : float or sequence
            Costs of the points, or vectors of residuals for "least-squares". None, NaN, infinities and exception
            objects mean that the evaluation failed. `Above` means that it was abandoned above the cutoff. Ellipsis
            returns a point, which `ask` then returns again.
        constraints : array_like, shape (k, m) or (m,), optional
            Values of the nonlinear constraints at the points. By default, the functions of the constraints are called.
            The cost of a point that violates a constraint with ``keep_feasible`` is ignored, as if it had not been
            evaluated.

        Raises
        ------
        KeyError
            A number does not belong to a pending point. The values before it have been recorded.
        ValueError, TypeError
            The numbers of values and ids differ, a value is not a number, it is not a vector of residuals if required,
            or there are constraint values without nonlinear constraints.
        Interrupted
            Ctrl-C was pressed while the method chose its next points; a KeyboardInterrupt. The value counts, and the
            next `ask` continues the choice.
        """
        if type(ids) is np.ndarray and ids.ndim == 1:
            numbers = ids.tolist()
        elif isinstance(ids, Iterable):
            numbers = [_values.index("ids", i) for i in ids]
        else:
            numbers, values = [_values.index("ids", ids)], [values]
            constraints = None if constraints is None else [constraints]
        costs = list(values)
        tell = self._native.tell
        if len(numbers) != len(costs):
            raise ValueError(f"tell: got {len(costs)} values for {len(numbers)} points")
        if constraints is not None and self._function is None:
            raise ValueError("tell: got constraint values, but the run has no nonlinear constraints")
        given = [None] * len(numbers) if constraints is None else [_values.vector("constraints", of_point) for of_point in constraints]
        if len(given) != len(numbers):
            raise ValueError(f"tell: got constraint values of {len(given)} points for {len(numbers)} points")
        for of_point in given:
            if of_point is not None and self._function is not None and of_point.size != self._function.count:
                raise ValueError(f"tell: got {of_point.size} constraint values of a point; expected {self._function.count}")
        for number, cost, of_point in zip(numbers, costs, given):
            if not 0 <= number < 2**64:
                raise KeyError(f"tell: point {number} is not waiting for an answer")
            above = isinstance(cost, Above)
            if self._function is None or cost is ...:
                tell(number, cost.cutoff if above else cost, above)
                continue
            if of_point is None and number in self._points:
                of_point = self._function(self._points[number])
            tell(number, cost.cutoff if above else cost, above, None if of_point is None else of_point.tolist())
            self._points.pop(number, None)

    @property
    def best(self) -> tuple[FloatArray, float] | None:
        """The best point of complete rounds so far and its cost; None if there is none."""
        return self._native.best

    @property
    def done(self) -> bool:
        """True if the run has ended."""
        return self._native.termination is not None

    @property
    def n_pending(self) -> int:
        """Number of points requested but not yet reported."""
        return self._native.n_pending

    def report(self) -> OptimizeResult:
        """Returns the result so far, a `LeastSquaresResult` for "least-squares".

        ``termination`` is "interrupted" if the run has not ended.

        Raises
        ------
        NoResult
            No point of a complete round had a cost.
        """
        return self._native.report()

    def save(self) -> None:
        """Writes the checkpoint, including the results of the current round. Does nothing without a checkpoint."""
        self._native.save()

    def stop(self) -> None:
        """Ends the run, if it has not ended, with the values reported so far."""
        self._native.stop()

    def __repr__(self) -> str:
        state = self._native.termination or "running"
        best = "no cost yet" if self.best is None else f"best {self.best[1]:.6g}"
        return f"<Optimizer: {state}, {best}, {self.n_pending} pending>"
