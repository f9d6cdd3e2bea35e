"""CMA-ES compared with pycma, and pattern search compared with compass search, on equal problems in one run.

    python benches/dfo/cma_es.py [--markdown FILE] [--seeds N]

CMA-ES: evaluations until the cost is at most 1e-6, the median over seeds 0, 1, ... (25 by default). Both use equal
starts, a first standard deviation of 0.5 (without a box) or 0.3 of the width (in a box), a population of 4 + floor(3
ln n), and tests that never pass. In the boxes [-4, 4]^n, every other upper bound is 1, with the minimum on it. There,
the cost of the ellipsoids decreases towards the bound with the given slope. With restarts: fraction of seeds that
reach 1e-6 of the lowest minimum of Rastrigin's function within 2000 n evaluations.

Pattern search: instances of Moré and Wild with odd numbers (even numbers were used for tuning), budget 200 (n + 1),
as sums of squares and as sums of absolute residuals. Solved at tau means f(x0) - f >= (1 - tau) (f(x0) - f_best).
f_best is the best value of the table, or of all solvers of the run. Units are evaluations / (n + 1). An unsolved
problem counts as infinite in the median.
"""

import argparse
import importlib.metadata
import math
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import cma
import more_wild
import nlopt
import numpy as np
import pydfo
import pygmo
from problem import Enough

Cost = Callable[[np.ndarray], float]
TARGET = 1e-6


class Counted:
    """A cost that records its values, up to a budget or a target."""

    def __init__(self, f: Cost, budget: int, target: float = -math.inf) -> None:
        self.f, self.budget, self.target, self.values = f, budget, target, []

    def __call__(self, x: np.ndarray) -> float:
        if len(self.values) >= self.budget or (self.values and self.values[-1] <= self.target):
            raise Enough
        value = self.f(np.asarray(x, dtype=float))
        self.values.append(value if math.isfinite(value) else math.inf)
        return self.values[-1]

    def __deepcopy__(self, memo: object) -> "Counted":
        # pygmo copies its problems, but the count must be shared.
        return self

    def run(self, solver: Callable[["Counted"], object]) -> float:
        """Returns the evaluations until the target; infinite if it was not reached."""
        try:
            solver(self)
        except Enough:
            pass
        reached = np.flatnonzero(np.array(self.values) <= self.target)
        return float(reached[0] + 1) if len(reached) else math.inf


def turned(n: int) -> np.ndarray:
    """Returns a rotation drawn with a separate seed."""
    return np.linalg.qr(np.random.default_rng(1000 + n).normal(size=(n, n)))[0]


def functions(n: int) -> dict[str, tuple[Cost, np.ndarray]]:
    """Returns cost functions with minimum 0 and their start points, by name."""
    q, exponent = turned(n), np.arange(n) / (n - 1)
    start = np.ones(n)
    return {
        "ellipsoid 1e6": (lambda x: float(10 ** (6 * exponent) @ (q @ x) ** 2), start),
        "Rosenbrock": (rosenbrock, np.zeros(n)),
        "sphere": (lambda x: float(x @ x), start),
        "cigar 1e6": (lambda x: float((q @ x)[0] ** 2 + 1e6 * ((q @ x)[1:] ** 2).sum()), start),
        "different powers": (lambda x: float((np.abs(q @ x) ** (2 + 4 * exponent)).sum()), start),
    }


def rosenbrock(x: np.ndarray) -> float:
    return float((100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2).sum())


def boxed(n: int, condition: float, slope: float) -> Cost:
    """Returns a rotated ellipsoid with its minimum 0 at ones, plus a slope towards the bounds."""
    q, weights = turned(n), 10 ** (condition * np.arange(n) / (n - 1))
    return lambda x: float(weights @ (q @ (x - 1)) ** 2 + slope * (1 - x[::2]).sum())


def of_pydfo(x0: np.ndarray, sigma: float, bounds: list[tuple[float, float]] | None, seed: int) -> Callable[[Counted], object]:
    """Returns our solver, with sizes of the parameters that give sigma its meaning in pycma."""
    options = {"sigma": sigma, "x_tol": 0.0, "f_tol": 0.0, "nominal": [1.0 if bounds is None else None] * len(x0)}
    return lambda f: pydfo.minimize(f, x0, bounds=bounds, method="cma-es", rng=seed, max_evaluations=f.budget, options=options)


def of_pycma(x0: np.ndarray, sigma: float, bounds: list[tuple[float, float]] | None, seed: int) -> Callable[[Counted], object]:
    """Returns Hansen's solver, driven by ask and tell, without its stopping tests."""
    options = {"seed": seed + 1, "verbose": -9}
    if bounds is not None:
        lower, upper = np.array(bounds).T
        # One standard deviation per coordinate.
        options |= {"bounds": [lower.tolist(), upper.tolist()], "CMA_stds": (upper - lower).tolist()}

    def solve(f: Counted) -> None:
        search = cma.CMAEvolutionStrategy(x0, sigma, options)
        while True:
            points = search.ask()
            search.tell(points, [f(x) for x in points])

    return solve


def cma_rows(seeds: int) -> Iterator[str]:
    """Yields a row per problem: the medians, their ratio, and the fractions of the seeds that reached the target."""
    yield "| problem | n | pydfo | pycma | ratio | reached |"
    yield "|---|---|---|---|---|---|"
    problems = [(name, n, f, x0, 0.5, None) for n in (2, 5, 10, 20) for name, (f, x0) in functions(n).items()]
    for n in (2, 3, 8):
        bounds = [(-4.0, 1.0 if k % 2 == 0 else 4.0) for k in range(n)]
        costs = {f"1e{c:g}, slope {s:g}": boxed(n, c, s) for c, s in ((0, 1), (4, 1), (4, 100), (6, 1), (6, 0))}
        costs |= {"Rosenbrock": rosenbrock}
        problems += [(f"box: {name}", n, f, np.full(n, -2.0), 0.3, bounds) for name, f in costs.items()]
    for name, n, f, x0, sigma, bounds in problems:
        both = [
            [Counted(f, 5000 * n, TARGET).run(solver(x0, sigma, bounds, seed)) for seed in range(seeds)]
            for solver in (of_pydfo, of_pycma)
        ]
        ours, theirs = (float(np.median(counts)) for counts in both)
        reached = " / ".join(f"{np.isfinite(counts).mean():.0%}" for counts in both)
        yield f"| {name} | {n} | {ours:.0f} | {theirs:.0f} | {ours / theirs:.2f} | {reached} |"


def restart_rows(seeds: int) -> Iterator[str]:
    """Yields a row per number of parameters."""
    yield "| Rastrigin, n | pydfo ipop | pydfo bipop | pycma bipop |"
    yield "|---|---|---|---|"
    for n in (2, 3, 5):
        bounds, budget = [(-5.0, 5.0)] * n, 2000 * n

        def rastrigin(x: np.ndarray) -> float:
            z = x - 0.7
            return float(10 * len(x) + (z**2 - 10 * np.cos(2 * math.pi * z)).sum())

        def ours(kind: str, seed: int) -> Callable[[Counted], object]:
            options = {"restarts": kind}
            return lambda f: pydfo.minimize(f, bounds=bounds, method="cma-es", rng=seed, max_evaluations=budget, options=options)

        def theirs(kind: str, seed: int) -> Callable[[Counted], object]:
            options = {"seed": seed + 1, "verbose": -9, "bounds": [-5, 5], "maxfevals": budget}
            draw = np.random.default_rng(seed).uniform
            return lambda f: cma.fmin2(f, lambda: draw(-5, 5, n), 3.0, options, restarts=9, bipop=True)

        def share(solver: Callable[[str, int], Callable[[Counted], object]], kind: str) -> str:
            reached = [Counted(rastrigin, budget, TARGET).run(solver(kind, seed)) for seed in range(seeds)]
            return f"{np.isfinite(reached).mean():.0%} ({np.median(reached):.0f})"

        yield f"| {n} | {share(ours, 'ipop')} | {share(ours, 'bipop')} | {share(theirs, 'bipop')} |"


class OfPygmo:
    """A problem for pygmo, in a box so wide that it has no effect."""

    def __init__(self, f: Counted, x0: np.ndarray) -> None:
        self.f, size = f, np.where(x0 != 0, np.abs(x0), 1.0)
        self.bounds = (x0 - 50 * size, x0 + 50 * size)

    def fitness(self, x: np.ndarray) -> list[float]:
        return [min(self.f(x), 1e300)]

    def get_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.bounds


def compass(f: Counted, x0: np.ndarray) -> None:
    """Runs pygmo's compass search with the first step of our pattern search."""
    problem = pygmo.problem(OfPygmo(f, x0))
    population = pygmo.population(problem, 0)
    population.push_back(x0, [min(f(x0), 1e300)])
    search = pygmo.compass_search(max_fevals=10 * f.budget, start_range=0.003, stop_range=1e-12, reduction_coeff=0.5)
    pygmo.algorithm(search).evolve(population)


def of_nlopt(algorithm: int) -> Callable[[Counted, np.ndarray], None]:
    def solve(f: Counted, x0: np.ndarray) -> None:
        optimiser = nlopt.opt(algorithm, len(x0))
        optimiser.set_min_objective(lambda x, _: f(x))
        optimiser.set_initial_step(0.3 * np.where(x0 != 0, np.abs(x0), 1.0))
        try:
            optimiser.optimize(x0)
        except nlopt.RoundoffLimited:
            pass

    return solve


def pattern_search(f: Counted, x0: np.ndarray) -> None:
    pydfo.minimize(f, x0, method="pattern-search", max_evaluations=f.budget)


def nelder_mead(f: Counted, x0: np.ndarray) -> None:
    pydfo.minimize(f, x0, method="nelder-mead", max_evaluations=f.budget, options={"batch": "serial"})


SEARCHES = {
    "pydfo pattern-search": pattern_search,
    "pygmo compass_search": compass,
    "NLopt SBPLX": of_nlopt(nlopt.LN_SBPLX),
    "pydfo nelder-mead": nelder_mead,
}


def pattern_rows() -> Iterator[str]:
    """Yields a row per kind of cost and solver: the fractions solved, and the median units."""
    yield "| cost | solver | tau 1e-1 | tau 1e-3 | tau 1e-5 |"
    yield "|---|---|---|---|---|"
    for kind, problems in (("squares", more_wild.smooth()), ("absolute values", more_wild.nonsmooth())):
        problems = [p for p in problems if int(p.name.split("/")[0].strip("|")) % 2 == 1]
        values: dict[str, list[np.ndarray]] = {name: [] for name in SEARCHES}
        for problem in problems:
            for name, solver in SEARCHES.items():
                f = Counted(problem.assessed, 200 * (problem.n + 1))
                f.run(lambda f, solver=solver, problem=problem: solver(f, problem.x0))
                values[name].append(np.minimum.accumulate(f.values))
        lowest = [min(seen[k][-1] for seen in values.values()) for k in range(len(problems))]
        for name, seen in values.items():
            cells = []
            for tau in (1e-1, 1e-3, 1e-5):
                units = []
                for problem, v, low in zip(problems, seen, lowest):
                    solved = np.flatnonzero(v[0] - v >= (1 - tau) * (v[0] - min(problem.best, low)))
                    units.append((solved[0] + 1) / (problem.n + 1) if len(solved) else math.inf)
                cells.append(f"{np.isfinite(units).mean():.0%} ({np.median(units):.1f})")
            yield f"| {kind} | {name} | {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path, help="write the tables to this file as well")
    parser.add_argument("--seeds", type=int, default=25)
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore", module="cma")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("cma", "nlopt", "pygmo", "numpy"))
    title = "# CMA-ES and pattern search: comparison with other implementations"
    lines = [title, "", f"`python benches/dfo/cma_es.py --seeds {arguments.seeds}`; {versions}.", ""]
    for title, rows in (
        ("## CMA-ES: evaluations to 1e-6, medians", cma_rows(arguments.seeds)),
        ("## CMA-ES with restarts: fraction of seeds that succeed (median of evaluations)", restart_rows(arguments.seeds)),
        ("## Pattern search: fraction solved (median units)", pattern_rows()),
    ):
        print(title, flush=True)
        lines += [title, ""]
        for row in rows:
            print(row, flush=True)
            lines.append(row)
        lines.append("")
    if arguments.markdown:
        arguments.markdown.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
