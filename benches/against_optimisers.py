"""Nelder-Mead beside SciPy's and NLopt's, on the same problems in one run; differential evolution with two workers.

    python benches/against_optimisers.py [--markdown FILE]

Smooth: the 53 instances of Moré and Wild (2009), budget 100 (n + 1). Bounded: 16 of the problems in a box, the minimum
inside ("interior") or cut off in every other coordinate ("active"), budget 200 (n + 1). Each solver has its defaults
but tolerances of zero, so that only the budget ends it. Solved at tau: f(x0) - f >= (1 - tau) (f(x0) - f_best), f_best
the best of the table (smooth), or of bounded least squares and all solvers of the run (bounded). Units are evaluations / (n + 1);
a problem that is not solved counts as infinite in the median.
"""

import argparse
import importlib.metadata
import os
import platform
import time
from pathlib import Path
from typing import Callable

import more_wild
import nlopt
import numpy as np
import pydfo
from more_wild import Problem
from scipy.optimize import minimize

Solver = Callable[[Problem, Callable[[np.ndarray], float], int], object]


class Enough(Exception):
    """The budget is used up."""


def values(solver: Solver, problem: Problem, factor: int) -> np.ndarray:
    """The costs a solver saw, in order, up to the budget; evaluations outside of the box count and are worthless."""
    budget, seen = factor * (problem.n + 1), []

    def f(x: np.ndarray) -> float:
        if len(seen) >= budget:
            raise Enough
        inside = np.all(x >= problem.lower) and np.all(x <= problem.upper)
        value = problem.f(x)
        seen.append(value if inside and np.isfinite(value) else np.inf)
        return value

    try:
        solver(problem, f, budget)
    except Enough:
        pass
    return np.array(seen)


def ours(**options: object) -> Solver:
    """pydfo.minimize with Nelder-Mead."""

    def solve(problem: Problem, f: Callable[[np.ndarray], float], budget: int) -> object:
        bounds = list(zip(problem.lower, problem.upper))
        own = {"x_tol": 0.0, "f_tol": 0.0, **options}
        return pydfo.minimize(f, problem.x0, bounds, "nelder-mead", max_evaluations=budget, options=own)

    return solve


def scipy(adaptive: bool) -> Solver:
    """scipy.optimize.minimize with its Nelder-Mead."""

    def solve(problem: Problem, f: Callable[[np.ndarray], float], budget: int) -> object:
        options = {"xatol": 0.0, "fatol": 0.0, "maxfev": budget, "maxiter": 10**9, "adaptive": adaptive}
        boxed = np.isfinite(problem.lower).any() or np.isfinite(problem.upper).any()
        bounds = list(zip(problem.lower, problem.upper)) if boxed else None
        return minimize(f, problem.x0, method="Nelder-Mead", bounds=bounds, options=options)

    return solve


def of_nlopt(algorithm: int) -> Solver:
    """An algorithm of NLopt."""

    def solve(problem: Problem, f: Callable[[np.ndarray], float], budget: int) -> object:
        optimiser = nlopt.opt(algorithm, problem.n)
        optimiser.set_lower_bounds(problem.lower)
        optimiser.set_upper_bounds(problem.upper)
        # NLopt ends with an error of its own if a value is not finite.
        optimiser.set_min_objective(lambda x, _: min(f(x.copy()), 1e300))
        optimiser.set_maxeval(budget)
        try:
            return optimiser.optimize(problem.x0)
        except nlopt.RoundoffLimited:
            return None

    return solve


SOLVERS: dict[str, Solver] = {
    "pydfo": ours(),
    "pydfo, bounds by sine": ours(bounds_handling="sine"),
    "pydfo, bounds by clamp": ours(bounds_handling="clamp"),
    "SciPy": scipy(False),
    "SciPy, adaptive": scipy(True),
    "NLopt Nelder-Mead": of_nlopt(nlopt.LN_NELDERMEAD),
    "NLopt Sbplx": of_nlopt(nlopt.LN_SBPLX),
}


def units(seen: np.ndarray, first: float, best: float, n: int, tau: float) -> float:
    """Evaluations / (n + 1) until solved; infinite if not."""
    good = np.flatnonzero(first - seen >= (1.0 - tau) * (first - best))
    return (good[0] + 1) / (n + 1) if len(good) else np.inf


def compare(problems: list[Problem], factor: int, taus: list[float], refine: bool, names: list[str]) -> list[list[str]]:
    """A row per solver: solved and median units at each tau."""
    seen = {name: [values(SOLVERS[name], p, factor) for p in problems] for name in names}
    rows = []
    for name in names:
        row = [name]
        for tau in taus:
            cells = []
            for k, p in enumerate(problems):
                best = min([p.best] + [float(seen[other][k].min()) for other in names]) if refine else p.best
                cells.append(units(seen[name][k], p.f(p.x0), best, p.n, tau))
            solved = int(np.isfinite(cells).sum())
            median = float(np.median(cells)) if np.isfinite(np.median(cells)) else np.inf
            row.append(f"{solved} of {len(problems)} ({median:.1f})")
        rows.append(row)
    return rows


def table(title: str, taus: list[float], rows: list[list[str]]) -> str:
    head = [title] + [f"tau {tau:g}" for tau in taus]
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]
    return "\n".join(lines) + "\n"


def gain(method: str, workers: int, evaluations: int = 200) -> float:
    """Seconds of a run whose objective waits for 5 ms without the interpreter lock."""

    def slow(x: np.ndarray) -> float:
        time.sleep(0.005)
        return float(100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2)

    begin = time.perf_counter()
    options = {"population": 20} if method != "nelder-mead" else {}
    pydfo.minimize(
        slow, [-1.2, 1.0], [(-2, 2)] * 2, method, workers=workers, rng=1, max_evaluations=evaluations, options=options
    )
    return time.perf_counter() - begin


def asking(method: str, n: int = 10, evaluations: int = 20_000) -> float:
    """Microseconds per evaluation of ask and tell from Python, whole batches, the objective left out."""
    optimizer = pydfo.Optimizer(method, np.full(n, -1.2), [(-5, 5)] * n, rng=1, max_evaluations=evaluations)
    spent, count = 0.0, 0
    while not optimizer.done:
        begin = time.perf_counter()
        asked = optimizer.ask()
        spent += time.perf_counter() - begin
        costs = [float(np.sum(100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2)) for x in asked.x]
        begin = time.perf_counter()
        optimizer.tell(asked.ids, costs)
        spent += time.perf_counter() - begin
        count += len(costs)
    return 1e6 * spent / count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path, help="write the tables to this file")
    arguments = parser.parse_args()
    versions = ", ".join(f"{p} {importlib.metadata.version(p)}" for p in ("fmufit-pydfo", "scipy", "nlopt", "numpy"))
    parts = [
        "# Optimisers side by side\n",
        "    python benches/against_optimisers.py --markdown benches/optimisers.md\n",
        f"{versions}; Python {platform.python_version()}, {os.cpu_count()} cores. Solved, and in brackets the median of "
        "evaluations / (n + 1).\n",
    ]
    free = ["pydfo", "SciPy", "SciPy, adaptive", "NLopt Nelder-Mead", "NLopt Sbplx"]
    taus = [1e-1, 1e-3, 1e-5]
    parts.append(table("Smooth, 100 (n + 1) evaluations", taus, compare(more_wild.smooth(), 100, taus, False, free)))
    for active in (False, True):
        name, taus = ("active" if active else "interior"), [1e-3, 1e-6]
        rows = compare(more_wild.bounded(active), 200, taus, True, list(SOLVERS))
        parts.append(table(f"Bounded, {name}, 200 (n + 1)", taus, rows))
    lines = ["| | 1 worker | 2 workers | gain |", "|---|---|---|---|"]
    for method in ("de-classic", "de", "ga", "nelder-mead"):
        one, two = gain(method, 1), gain(method, 2)
        lines.append(f"| {method}, 200 evaluations of 5 ms | {one:.2f} s | {two:.2f} s | {one / two:.2f} |")
    parts.append("\n".join(lines) + "\n")
    lines = ["| ask + tell from Python, n = 10 | µs per evaluation |", "|---|---|"]
    lines += [f"| {method} | {asking(method):.2f} |" for method in ("nelder-mead", "de", "de-classic", "ga")]
    parts.append("\n".join(lines) + "\n")
    text = "\n".join(parts)
    print(text)
    if arguments.markdown:
        arguments.markdown.write_text(text)


if __name__ == "__main__":
    main()
