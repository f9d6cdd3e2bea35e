"""The solvers of the benchmarks, ours and the peers, as one table.

Each uses its defaults, except tolerances of (nearly) zero, so that only the budget ends it."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pydfo
from problem import Array, Problem, Record

Run = Callable[[Problem, Record], Any]


@dataclass(frozen=True)
class Solver:
    """A solver; `residuals` is True if it uses the residual vector."""

    run: Run
    residuals: bool = False
    module: str = "pydfo"


NO_TOLERANCES = {"x_tol": 0.0, "f_tol": 0.0}
WITH_RESIDUALS = ("least-squares",)


def ours(method: str, workers: int | str = 1, residuals: bool = False, **keywords: Any) -> Solver:
    """Returns a method of pydfo, driven batch by batch; `workers` is the number of workers ("n+4" means n + 4)."""

    def run(p: Problem, record: Record) -> None:
        # A global search uses the default tolerances, which decide when a local search ends and the next one starts.
        tolerances = {} if "search" in keywords or method == "multistart" else NO_TOLERANCES
        options = {**tolerances, **keywords.get("options", {})}
        if options.get("batch") == "n+4":
            options["batch"] = p.n + 4
        count = p.n + 4 if workers == "n+4" else int(workers)
        rest = {k: v for k, v in keywords.items() if k != "options"}
        optimizer = pydfo.Optimizer(
            method, p.x0 if p.has_start else None, p.bounds, workers=count, rng=record.seed,
            max_evaluations=record.budget, options=options, **rest,
        )  # fmt: skip
        while not optimizer.done:
            ids, points, _ = optimizer.ask()
            record.batch(len(points))
            optimizer.tell(ids, [record.r(x) if residuals else record.f(x) for x in points])

    return Solver(run, residuals)


def _finite(f: Callable[[Array], float], x: Array) -> float:
    value = f(np.array(x))
    return value if np.isfinite(value) else 1e100


def scipy_minimize(method: str, **options: Any) -> Solver:
    """scipy.optimize.minimize."""

    def run(p: Problem, record: Record) -> object:
        from scipy.optimize import minimize

        return minimize(record.f, p.x0, method=method, bounds=p.bounds if p.is_boxed else None, options=options)

    return Solver(run, module="scipy")


def scipy_least_squares(method: str) -> Solver:
    """scipy.optimize.least_squares with differences."""

    def run(p: Problem, record: Record) -> object:
        from scipy.optimize import least_squares

        bounds = (p.lower, p.upper) if p.is_boxed else (-np.inf, np.inf)
        tight = dict(xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=10**6)
        return least_squares(record.r, p.x0, method=method, x_scale="jac", bounds=bounds, **tight)

    return Solver(run, True, "scipy")


def scipy_de() -> Solver:
    """scipy.optimize.differential_evolution, with its generations evaluated as batches."""

    def run(p: Problem, record: Record) -> object:
        from scipy.optimize import differential_evolution

        def generation(function: Callable[[Array], float], points: Any) -> list[float]:
            points = list(points)
            record.batch(len(points))
            return [function(x) for x in points]

        return differential_evolution(
            record.f, p.bounds, maxiter=10**6, tol=0.0, rng=record.seed, workers=generation, updating="deferred"
        )

    return Solver(run, module="scipy")


def scipy_annealing() -> Solver:
    """scipy.optimize.dual_annealing."""

    def run(p: Problem, record: Record) -> object:
        from scipy.optimize import dual_annealing

        return dual_annealing(record.f, p.bounds, maxiter=10**6, maxfun=10**9, rng=record.seed)

    return Solver(run, module="scipy")


def of_nlopt(name: str) -> Solver:
    """An algorithm of NLopt."""

    def run(p: Problem, record: Record) -> object:
        import nlopt

        optimiser = nlopt.opt(getattr(nlopt, name), p.n)
        optimiser.set_lower_bounds(p.lower)
        optimiser.set_upper_bounds(p.upper)
        # NLopt ends with a separate error if a value is not finite.
        optimiser.set_min_objective(lambda x, _: _finite(record.f, x))
        optimiser.set_maxeval(record.budget)
        with contextlib.suppress(nlopt.RoundoffLimited):
            return optimiser.optimize(p.x0)

    return Solver(run, module="nlopt")


def of_cobyqa() -> Solver:
    """COBYQA; its first radius is 10 % of the largest |x0|, as in its authors' benchmarks."""

    def run(p: Problem, record: Record) -> object:
        from cobyqa import minimize
        from scipy.optimize import Bounds

        radius = 0.1 * max(1.0, float(np.abs(p.x0).max()))
        options = {"maxfev": record.budget, "initial_tr_radius": radius, "final_tr_radius": 1e-12}
        return minimize(record.f, p.x0, bounds=Bounds(p.lower, p.upper) if p.is_boxed else None, options=options)

    return Solver(run, module="cobyqa")


def of_pybobyqa(noise: bool = False) -> Solver:
    """Py-BOBYQA."""

    def run(p: Problem, record: Record) -> object:
        import pybobyqa

        bounds = (np.maximum(p.lower, -1e20), np.minimum(p.upper, 1e20)) if p.is_boxed else None
        options = dict(maxfun=record.budget, rhoend=1e-12, objfun_has_noise=noise, scaling_within_bounds=_finite_box(p))
        return pybobyqa.solve(record.f, p.x0, bounds=bounds, **options)

    return Solver(run, module="Py-BOBYQA")


def of_dfols(noise: bool = False) -> Solver:
    """DFO-LS."""

    def run(p: Problem, record: Record) -> object:
        import dfols

        bounds = (np.maximum(p.lower, -1e20), np.minimum(p.upper, 1e20)) if p.is_boxed else None
        options = dict(maxfun=record.budget, rhoend=1e-12, objfun_has_noise=noise, scaling_within_bounds=_finite_box(p))
        return dfols.solve(record.r, p.x0, bounds=bounds, **options)

    return Solver(run, True, "DFO-LS")


def scaled(inner: Solver) -> Solver:
    """Divides every parameter by the size of its start, for solvers without scaling."""

    def run(p: Problem, record: Record) -> object:
        import dataclasses

        unit = np.where(p.x0 != 0.0, np.abs(p.x0), 1.0)
        view = _Scaled(record, unit)
        q = dataclasses.replace(p, x0=p.x0 / unit, lower=p.lower / unit, upper=p.upper / unit)
        return inner.run(q, view)  # type: ignore[arg-type]

    return Solver(run, inner.residuals, inner.module)


class _Scaled:
    """A record that receives points in other units."""

    def __init__(self, record: Record, unit: Array) -> None:
        self._record, self._unit = record, unit
        self.budget, self.seed, self.batch = record.budget, record.seed, record.batch

    def _inside(self, x: Array) -> Array:
        # Dividing and multiplying may leave the box by a rounding error.
        p = self._record.problem
        return np.clip(np.asarray(x) * self._unit, p.lower, p.upper)

    def f(self, x: Array) -> float:
        return self._record.f(self._inside(x))

    def r(self, x: Array) -> Array:
        return self._record.r(self._inside(x))


def _finite_box(p: Problem) -> bool:
    return bool(np.isfinite(p.lower).all() and np.isfinite(p.upper).all())


def of_pycma(restarts: str) -> Solver:
    """pycma with restarts ("bipop" or "ipop"), sigma0 = 2 as in the BBOB experiments; 10 % of the start without a box."""

    def run(p: Problem, record: Record) -> object:
        import cma

        sigma = 2.0 if _finite_box(p) else 0.1 * max(1.0, float(np.abs(p.x0).max()))
        options = {"verbose": -9, "seed": record.seed + 1, "maxfevals": record.budget, "tolfun": 1e-12, "tolx": 1e-12}
        options |= {"bounds": [p.lower.tolist(), p.upper.tolist()]} if p.is_boxed else {}

        def start() -> Array:
            return record.rng.uniform(p.lower, p.upper) if _finite_box(p) else p.x0

        bipop = restarts == "bipop"
        return cma.fmin2(record.f, start, sigma, options, restarts=100 if restarts else 0, bipop=bipop)

    return Solver(run, module="cma")


def of_pygmo(name: str, population: int = 20) -> Solver:
    """A self-adaptive differential evolution of pygmo."""

    def run(p: Problem, record: Record) -> object:
        import pygmo

        class Udp:
            def fitness(self, x: Array) -> list[float]:
                return [_finite(record.f, x)]

            def get_bounds(self) -> tuple[list[float], list[float]]:
                return p.lower.tolist(), p.upper.tolist()

        seed = record.seed + 1
        generations = record.budget // population + 1
        algorithm = pygmo.algorithm(getattr(pygmo, name)(gen=generations, ftol=0.0, xtol=0.0, seed=seed))
        problem = pygmo.problem(Udp())
        return algorithm.evolve(pygmo.population(problem, population, seed=seed))

    return Solver(run, module="pygmo")


SOLVERS: dict[str, Solver] = {
    **{name: ours(name, residuals=name in WITH_RESIDUALS) for name, _ in pydfo._core.method_names()},
    "nelder-mead, clamp": ours("nelder-mead", options={"bounds_handling": "clamp"}),
    "nelder-mead, 4 workers": ours("nelder-mead", workers=4),
    "least-squares, batch n+4": ours("least-squares", "n+4", True, options={"batch": "n+4"}),
    "least-squares, noise": ours("least-squares", 1, True, options={"noise": True}),
    "auto": ours("auto"),
    "auto, global": ours("auto", search="global"),
    "SciPy Nelder-Mead": scipy_minimize("Nelder-Mead", xatol=0.0, fatol=0.0, maxfev=10**9, maxiter=10**9),
    "SciPy Nelder-Mead, adaptive": scipy_minimize(
        "Nelder-Mead", xatol=0.0, fatol=0.0, maxfev=10**9, maxiter=10**9, adaptive=True
    ),
    "SciPy Powell": scipy_minimize("Powell", xtol=1e-12, ftol=1e-12, maxfev=10**9, maxiter=10**9),
    "SciPy least_squares trf": scipy_least_squares("trf"),
    "SciPy DE": scipy_de(),
    "SciPy dual annealing": scipy_annealing(),
    "NLopt Nelder-Mead": of_nlopt("LN_NELDERMEAD"),
    "NLopt Sbplx": of_nlopt("LN_SBPLX"),
    "NLopt BOBYQA": of_nlopt("LN_BOBYQA"),
    "COBYQA": of_cobyqa(),
    "Py-BOBYQA": of_pybobyqa(),
    "Py-BOBYQA, noise": of_pybobyqa(True),
    "DFO-LS": of_dfols(),
    "DFO-LS, noise": of_dfols(True),
    "DFO-LS, x / |x0|": scaled(of_dfols()),
    "COBYQA, x / |x0|": scaled(of_cobyqa()),
    "pycma": of_pycma(""),
    "pycma BIPOP": of_pycma("bipop"),
    "pygmo sade": of_pygmo("sade"),
    "pygmo de1220": of_pygmo("de1220"),
}


def record(name: str, problem: Problem, budget: int, seed: int) -> Record:
    """Records one run."""
    from problem import Enough

    logging.getLogger("pydfo").setLevel(logging.ERROR)
    seen = Record(problem, budget, seed)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            SOLVERS[name].run(problem, seen)
        except Enough:
            pass
        except (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError, AssertionError, RuntimeError) as error:
            seen.error = f"{type(error).__name__}: {error}"
    return seen
