"""Constraints beyond bounds, in the forms of SciPy."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .._args import bounds as _bounds
from .._args import text as _text
from .._args import values as _arguments
from .evaluate import Batches

FloatArray = npt.NDArray[np.float64]
#: Linear constraints (coefficients, lower, upper), and limits of the nonlinear ones (lower, upper, keep_feasible).
Native = tuple[list[tuple[list[float], float, float]], list[tuple[float, float, bool]]]


@dataclass(eq=False)
class LinearConstraint:
    """The linear constraints ``lb <= A @ x <= ub``, as ``scipy.optimize.LinearConstraint``.

    They hold at every evaluated point, up to the rounding of their terms. An equality reduces the dimension of the
    search.

    Attributes
    ----------
    A : array_like, shape (m, n) or (n,)
        Coefficients of the parameters.
    lb, ub : array_like, shape (m,), or float
        Limits; infinite if there is none. Equal limits are an equality.

    Examples
    --------
    >>> import pydfo
    >>> sum_is_one = pydfo.LinearConstraint([1, 1], 1, 1)
    >>> res = pydfo.minimize(lambda x: x[0] ** 2 + 2 * x[1] ** 2, [0, 0], constraints=sum_is_one)
    >>> res.x.round(4)
    array([0.6667, 0.3333])
    """

    A: npt.ArrayLike
    lb: npt.ArrayLike = -np.inf
    ub: npt.ArrayLike = np.inf


@dataclass(eq=False)
class NonlinearConstraint:
    """The nonlinear constraints ``lb <= fun(x) <= ub``, as ``scipy.optimize.NonlinearConstraint``.

    They may be violated on the way. The result satisfies them within the option ``constraint_tol``, or it is no
    success.

    Attributes
    ----------
    fun : callable
        ``fun(x)`` returns a number or an array of shape (m,). It is called at each point before the objective.
    lb, ub : array_like, shape (m,), or float
        Limits; infinite if there is none. Equal limits are an equality.
    keep_feasible : bool
        If True, the objective is not evaluated where these constraints are violated.

    Examples
    --------
    >>> import pydfo
    >>> circle = pydfo.NonlinearConstraint(lambda x: x[0] ** 2 + x[1] ** 2, ub=1)
    >>> res = pydfo.minimize(lambda x: x[0] + x[1], [0, 0], bounds=[(-2, 2)] * 2, constraints=circle)
    >>> res.x.round(3), res.constr_violation < 1e-6
    (array([-0.707, -0.707]), True)
    """

    fun: Callable[..., Any]
    lb: npt.ArrayLike = -np.inf
    ub: npt.ArrayLike = np.inf
    keep_feasible: bool = False


class Evaluation(NamedTuple):
    """Values of the nonlinear constraints at a point, and the value of the objective (Ellipsis: not evaluated)."""

    constraints: FloatArray
    value: Any


class ConstraintFunction:
    """The functions of all nonlinear constraints; picklable if they are."""

    def __init__(self, parts: list[tuple[Callable[..., Any], tuple[Any, ...], int]]) -> None:
        self.parts = parts

    def __call__(self, x: FloatArray) -> FloatArray:
        # A function may change its argument.
        return np.concatenate([_values(fun(np.array(x), *args), count) for fun, args, count in self.parts])

    @property
    def count(self) -> int:
        """Number of values."""
        return sum(count for *_, count in self.parts)


class Constrained:
    """An objective with the functions of its nonlinear constraints; picklable if they are."""

    def __init__(
        self, fun: Callable[..., Any], function: ConstraintFunction, limits: list[tuple[float, float, bool]], options: Mapping[str, Any]
    ) -> None:
        self.fun = fun
        tolerance = float(options.get("constraint_tol", 1e-6))
        self.function = function
        kept = np.array([keep for *_, keep in limits])
        self.lower = np.where(kept, [lower for lower, *_ in limits], -np.inf) - tolerance
        self.upper = np.where(kept, [upper for _, upper, _ in limits], np.inf) + tolerance

    def forbids(self, values: FloatArray) -> bool:
        """True if the objective must not be evaluated."""
        finite = np.isfinite(self.lower) | np.isfinite(self.upper)
        return bool(np.any(finite & ~((values >= self.lower) & (values <= self.upper))))

    def __call__(self, x: FloatArray, **cutoff: float) -> Evaluation:
        values = self.function(x)
        return Evaluation(values, ... if self.forbids(values) else self.fun(x, **cutoff))

    def of_batches(self, evaluate: Batches) -> Batches:
        """Adds the constraint values to a function that evaluates whole batches."""

        def evaluate_with(points: FloatArray, cutoffs: FloatArray, stopped: Callable[[], bool]) -> list[Any]:
            values = [self._values_or_error(x) for x in points]
            allowed = np.array([not isinstance(of_point, Exception) and not self.forbids(of_point) for of_point in values])
            costs = iter(evaluate(points[allowed], cutoffs[allowed], stopped) if allowed.any() else [])
            both = [(of_point, next(costs) if is_allowed else ...) for of_point, is_allowed in zip(values, allowed)]
            return [_joined(of_point, cost) for of_point, cost in both]

        return evaluate_with

    def _values_or_error(self, x: FloatArray) -> FloatArray | Exception:
        """Returns an exception instead of raising it, so that one point does not affect its batch."""
        try:
            return self.function(x)
        except Exception as e:
            return e


def _joined(values: FloatArray | Exception, cost: Any) -> Any:
    """Returns the answer for a point of a batch: its evaluation, or the raised exception."""
    if isinstance(values, Exception):
        return values
    return cost if isinstance(cost, BaseException) else Evaluation(values, cost)


def complete(requested: dict[str, Any], function: ConstraintFunction | None) -> None:
    """Adds the constraint values to the points of a warm start among the options."""
    for point in requested.get("warm_start") or ():
        if function is not None and np.isfinite(point["cost"]):
            point["constraints"] = function(np.array(point["x"])).tolist()


def of_call(constraints: Any, x0: Any, bounds: Any) -> tuple[Native | None, ConstraintFunction | None]:
    """Returns the result of `read` for arguments of `minimize`."""
    if constraints is None:
        return None, None
    start = None if x0 is None else _arguments.vector("x0", x0)
    return read(constraints, start, *_bounds.pairs_of_bounds(bounds, None if start is None else len(start)))


def read(constraints: Any, start: FloatArray | None, lower: FloatArray, upper: FloatArray) -> tuple[Native | None, ConstraintFunction | None]:
    """Returns the constraints for the native code and the function of the nonlinear ones.

    `constraints` is one constraint or a sequence: `LinearConstraint`, `NonlinearConstraint`, SciPy's objects of these
    names, or SciPy's dictionaries. Constraint functions whose number of values is unknown are called once, at the
    start point or in the middle of the bounds."""
    if constraints is None:
        return None, None
    single = isinstance(constraints, Mapping) or hasattr(constraints, "lb")
    if not single and not isinstance(constraints, Iterable):
        raise TypeError(f"constraints must be a LinearConstraint, a NonlinearConstraint, a dictionary or a sequence of these, not {_text.show(constraints)}")
    linear: list[tuple[list[float], float, float]] = []
    limits: list[tuple[float, float, bool]] = []
    parts: list[tuple[Callable[..., Any], tuple[Any, ...], int]] = []
    example = _example(start, lower, upper)
    for index, constraint in enumerate([constraints] if single else constraints):
        name = "constraints" if single else f"constraints[{index}]"
        if isinstance(constraint, Mapping):
            fun, args, bounds, keep = _of_dictionary(name, constraint)
        elif hasattr(constraint, "A"):
            linear += _linear(name, constraint, len(lower))
            continue
        elif callable(getattr(constraint, "fun", None)):
            fun, args, bounds, keep = constraint.fun, (), (constraint.lb, constraint.ub), constraint.keep_feasible
        else:
            raise TypeError(f"{name} must be a LinearConstraint, a NonlinearConstraint or a dictionary, not {_text.show(constraint)}")
        count = max(np.size(bound) for bound in (*bounds, keep))
        if count == 1:
            count = _values(fun(example.copy(), *args), None, name).size
        lows, highs, kept = (_broadcast(f"{name}.{what}", value, count) for what, value in zip(("lb", "ub", "keep_feasible"), (*bounds, keep)))
        limits += zip(lows.tolist(), highs.tolist(), (kept != 0).tolist())
        parts.append((fun, args, count))
    if not linear and not limits:
        return None, None
    return (linear, limits), ConstraintFunction(parts) if parts else None


def _example(start: FloatArray | None, lower: FloatArray, upper: FloatArray) -> FloatArray:
    if start is not None:
        return start
    middle: FloatArray = 0.5 * (np.maximum(lower, -1e6) + np.minimum(upper, 1e6))
    return middle


def _of_dictionary(name: str, constraint: Mapping[str, Any]) -> tuple[Callable[..., Any], tuple[Any, ...], tuple[float, float], bool]:
    kind, fun = str(constraint.get("type", "")).lower(), constraint.get("fun")
    if kind not in ("eq", "ineq"):
        raise ValueError(f"{name}['type'] = {constraint.get('type')!r} is invalid; expected 'eq' (fun(x) == 0) or 'ineq' (fun(x) >= 0)")
    if not callable(fun):
        raise TypeError(f"{name}['fun'] must be callable, not {_text.show(fun)}")
    args = constraint.get("args", ())
    return fun, args if isinstance(args, tuple) else (args,), (0.0, 0.0 if kind == "eq" else np.inf), False


def _linear(name: str, constraint: Any, n: int) -> list[tuple[list[float], float, float]]:
    # SciPy also accepts sparse matrices.
    matrix = constraint.A.toarray() if hasattr(constraint.A, "toarray") else constraint.A
    try:
        rows = np.atleast_2d(np.asarray(matrix, dtype=np.float64))
    except (TypeError, ValueError):
        raise TypeError(f"{name}.A must be a matrix of numbers, not {_text.show(matrix)}") from None
    if rows.ndim != 2 or rows.shape[1] != n:
        raise ValueError(f"{name}.A has shape {np.shape(matrix)}; expected (m, {n}), one column per parameter")
    lows, highs = (_broadcast(f"{name}.{what}", getattr(constraint, what), len(rows)) for what in ("lb", "ub"))
    return list(zip(rows.tolist(), lows.tolist(), highs.tolist()))


def _broadcast(name: str, value: Any, count: int) -> FloatArray:
    try:
        array = np.asarray(value, dtype=np.float64)
        return np.array(np.broadcast_to(array.ravel() if array.size == count else array, count))
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {_text.show(value)} does not fit {count} constraint values") from None


def _values(returned: Any, count: int | None, name: str = "a constraint function") -> FloatArray:
    try:
        values = np.atleast_1d(np.asarray(returned, dtype=np.float64)).ravel()
    except (TypeError, ValueError):
        raise TypeError(f"{name} must return numbers, not {_text.show(returned)}") from None
    if count is not None and values.size != count:
        raise ValueError(f"{name} returned {values.size} values; expected {count}")
    return values
