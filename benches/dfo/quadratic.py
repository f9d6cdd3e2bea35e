"""Quadratic models beside COBYQA, NLopt's BOBYQA and Py-BOBYQA on the same problems in one run.

    python benches/dfo/quadratic.py [--markdown FILE]

Smooth: the 53 instances of Moré and Wild (2009), budget 100 (n + 1). Bounded: 16 of the problems in a box, the minimum inside ("interior")
or cut off in every other coordinate ("active"), budget 200 (n + 1). Tolerances are zero or the smallest that a solver takes, so that only the
budget ends it. Solved at tau: f(x0) - f >= (1 - tau) (f(x0) - f_best), f_best the best of the table (smooth), or of bounded least squares
and all solvers of the run. Units are evaluations / (n + 1); what is not solved counts as infinite in the median. Evaluations outside of the box
count and are worthless.
"""

import argparse
import importlib.metadata
import platform
import sys
import warnings
from pathlib import Path
from typing import Callable

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cobyqa
import nlopt
import numpy as np
import pybobyqa
import pydfo
from more_wild import Problem, bounded, smooth
from scipy.optimize import Bounds

Solver = Callable[[Problem, Callable[[np.ndarray], float], int], object]


class Enough(Exception):
    """The budget is used up."""


def values(solver: Solver, problem: Problem, factor: int) -> np.ndarray:
    """The costs a solver saw, in order, up to the budget."""
    budget, seen = factor * (problem.n + 1), []

    def f(x: np.ndarray) -> float:
        if len(seen) >= budget:
            raise Enough
        inside = np.all(x >= problem.lower) and np.all(x <= problem.upper)
        value = problem.f(np.array(x))
        seen.append(value if inside and np.isfinite(value) else np.inf)
        return value if np.isfinite(value) else 1e300

    try:
        solver(problem, f, budget)
    except (Enough, nlopt.RoundoffLimited):
        pass
    return np.array(seen)


def boxed(problem: Problem) -> bool:
    return bool(np.isfinite(problem.lower).any())


def width(problem: Problem) -> float:
    """A tenth of the box, or of the largest parameter: one radius for all parameters, as these solvers take it."""
    if boxed(problem):
        return 0.1 * float(np.median(problem.upper - problem.lower))
    return 0.1 * float(np.abs(problem.x0).max()) or 0.1


def ours(problem: Problem, f: Callable[[np.ndarray], float], budget: int) -> object:
    bounds = list(zip(problem.lower, problem.upper))
    options = {"x_tol": 0.0, "f_tol": 0.0}
    return pydfo.minimize(f, problem.x0, bounds=bounds, method="quadratic-model", max_evaluations=budget, options=options)


def of_cobyqa(problem: Problem, f: Callable[[np.ndarray], float], budget: int) -> object:
    options = {"maxfev": budget, "maxiter": 10**6, "radius_init": width(problem), "radius_final": 1e-12, "feasibility_tol": 0.0}
    return cobyqa.minimize(f, problem.x0, bounds=Bounds(problem.lower, problem.upper), options=options)


def of_nlopt(problem: Problem, f: Callable[[np.ndarray], float], budget: int) -> object:
    optimiser = nlopt.opt(nlopt.LN_BOBYQA, problem.n)
    optimiser.set_lower_bounds(problem.lower)
    optimiser.set_upper_bounds(problem.upper)
    optimiser.set_min_objective(lambda x, _: f(x.copy()))
    optimiser.set_maxeval(budget)
    return optimiser.optimize(problem.x0)


def of_pybobyqa(problem: Problem, f: Callable[[np.ndarray], float], budget: int) -> object:
    box = {"bounds": (problem.lower, problem.upper), "scaling_within_bounds": True} if boxed(problem) else {}
    rhobeg = 0.1 if boxed(problem) else width(problem)
    return pybobyqa.solve(f, problem.x0, maxfun=budget, rhobeg=rhobeg, rhoend=1e-12 * rhobeg, do_logging=False, **box)


SOLVERS: dict[str, Solver] = {
    "pydfo quadratic-model": ours,
    "COBYQA": of_cobyqa,
    "NLopt BOBYQA": of_nlopt,
    "Py-BOBYQA": of_pybobyqa,
}


def units(seen: np.ndarray, first: float, best: float, n: int, tau: float) -> float:
    """Evaluations / (n + 1) until solved; infinite if not."""
    good = np.flatnonzero(first - seen >= (1.0 - tau) * (first - best))
    return (good[0] + 1) / (n + 1) if len(good) else np.inf


def compare(title: str, problems: list[Problem], factor: int, taus: list[float], refine: bool) -> str:
    """A table with a row per solver: solved and median units at each tau."""
    seen = {name: [values(solver, p, factor) for p in problems] for name, solver in SOLVERS.items()}
    head = [f"{title}, {factor} (n + 1)"] + [f"tau {tau:g}" for tau in taus]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for name, runs in seen.items():
        row = [name]
        for tau in taus:
            cells = []
            for k, p in enumerate(problems):
                best = min([p.best] + [float(others[k].min()) for others in seen.values()]) if refine else p.best
                cells.append(units(runs[k], p.f(p.x0), best, p.n, tau))
            row.append(f"{100 * np.isfinite(cells).mean():.0f} % ({np.median(cells):.1f})")
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path, help="write the tables to this file, too")
    file = parser.parse_args().markdown
    warnings.simplefilter("ignore")
    packages = ("cobyqa", "nlopt", "Py-BOBYQA", "scipy", "numpy")
    versions = f"pydfo {pydfo.__version__}, " + ", ".join(f"{name} {importlib.metadata.version(name)}" for name in packages)
    parts = [
        "# Quadratic models side by side\n\n    python benches/dfo/quadratic.py --markdown benches/dfo/quadratic.md\n",
        f"{versions}; Python {platform.python_version()}. Solved, and in brackets the median of evaluations / (n + 1).\n",
    ]
    print("\n".join(parts))
    for arguments in (
        ("Smooth", smooth(), 100, [1e-1, 1e-3, 1e-5], False),
        ("Bounded, interior", bounded(False), 200, [1e-3, 1e-6], True),
        ("Bounded, active", bounded(True), 200, [1e-3, 1e-6], True),
    ):
        parts.append(compare(*arguments) + "\n")
        print(parts[-1], flush=True)
    if file:
        file.write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
