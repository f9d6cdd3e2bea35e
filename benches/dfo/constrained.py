"""Peers of `crates/dfo/benches/constrained.rs`: pycma's augmented Lagrangian and SciPy's differential evolution.

    python benches/dfo/constrained.py

The problems, budgets and the definition of "solved" are those of the Rust bench: within 1e-5 of the minimum, feasible up
to 1e-6, within 2000 n evaluations. pycma evaluates a point and its constraints together. SciPy does not evaluate the
cost of infeasible points; with linear constraints, only evaluations of the cost count, with balls every point counts.
"""

import math
import warnings

import cma
import numpy as np
from scipy.optimize import LinearConstraint, NonlinearConstraint, differential_evolution

SEEDS = 10
FUNCTIONS = ["sphere", "ellipsoid", "rotated", "rastrigin"]


class Enough(Exception):
    """The budget is used, or the problem is solved."""


class Numbers:
    """The generator of the Rust bench."""

    def __init__(self, seed: int) -> None:
        self.state = seed

    def next(self) -> float:
        self.state = (self.state * 6364136223846793005 + 1442695040888963407) % 2**64
        return (self.state >> 11) / 2.0**52 - 1.0

    def vector(self, n: int) -> np.ndarray:
        return np.array([self.next() for _ in range(n)])


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


class Problem:
    """A function with constraints whose minimum is known."""

    def __init__(self, function: int, n: int, m: int, seed: int) -> None:
        numbers = Numbers(seed * 1000003 + function * 10007 + n * 101 + m)
        for _ in range(10):
            numbers.next()
        self.n = n
        self.minimum = 2 * numbers.vector(n)
        gradient = unit(numbers.vector(n))
        axis = unit(numbers.vector(n))
        self.axis = axis if function == 2 else None
        exponent, lowest = (6, 0.05) if function in (1, 2) else (0, 0.25)
        self.weights = lowest * 10.0 ** (exponent * np.arange(n) / (n - 1))
        self.centre = self.minimum - self.reflected(self.reflected(gradient) / (2 * self.weights))
        self.cosine = 2.5 if function == 3 else 0.0
        first = -gradient
        normals, gaps = [], []
        for i in range(1, m):
            normal = unit(numbers.vector(n))
            share = 0.6 + 0.4 * numbers.next()
            if i < n:
                first = first - share * normal
            gaps.append(0.0 if i < n else share)
            normals.append(normal)
        self.normals, self.gaps = np.array([*normals, first]), np.array([*gaps, 0.0])
        self.target = self.cost(self.minimum) + 1e-5

    def reflected(self, v: np.ndarray) -> np.ndarray:
        return v if self.axis is None else v - 2 * (v @ self.axis) * self.axis

    def cost(self, x: np.ndarray) -> float:
        wave = np.sum(1 - np.cos(2 * math.pi * (x - self.minimum)))
        return float(np.sum(self.weights * self.reflected(x - self.centre) ** 2) + self.cosine * wave)

    def values(self, x: np.ndarray, are_balls: bool) -> np.ndarray:
        """Returns the constraint values, feasible up to 0."""
        if not are_balls:
            return self.normals @ (x - self.minimum) - self.gaps
        centres = self.minimum - 2 * self.normals / np.linalg.norm(self.normals, axis=1)[:, None]
        return np.sum((x - centres) ** 2, axis=1) - (2 + self.gaps) ** 2


class Run:
    """Counts the evaluations of a solver, and ends it."""

    def __init__(self, problem: Problem, are_balls: bool) -> None:
        self.problem, self.are_balls, self.n_evaluations, self.solved = problem, are_balls, 0, False

    def cost(self, x: np.ndarray) -> float:
        x, problem = np.asarray(x), self.problem
        self.count()
        cost = problem.cost(x)
        inside = np.all(np.abs(x) <= 5) and np.max(problem.values(x, self.are_balls)) <= 1e-6
        if cost <= problem.target and inside:
            self.solved = True
            raise Enough
        return cost

    def count(self) -> None:
        if self.n_evaluations >= 2000 * self.problem.n:
            raise Enough
        self.n_evaluations += 1

    def pycma(self, seed: int) -> None:
        n = self.problem.n
        options = {"bounds": [-5, 5], "seed": seed + 1, "verbose": -9, "tolfun": 0, "tolx": 0, "tolfunhist": 0}
        options |= {"tolstagnation": 10**9, "maxfevals": 10**9}
        options |= {"tolflatfitness": 10**9}
        lagrangian = cma.ConstrainedFitnessAL(self.cost, lambda x: self.problem.values(np.asarray(x), self.are_balls))
        cma.fmin2(lagrangian, np.zeros(n), 3.0, options, callback=lagrangian.update)

    def scipy(self, seed: int) -> None:
        problem, n = self.problem, self.problem.n
        if self.are_balls:
            last = {}

            def values(x: np.ndarray) -> np.ndarray:
                found = problem.values(x, True)
                if np.max(found) > 0:
                    self.count()
                return found

            last["constraint"] = NonlinearConstraint(values, -np.inf, 0)
            constraint = last["constraint"]
        else:
            limits = problem.normals @ problem.minimum + problem.gaps
            constraint = LinearConstraint(problem.normals, -np.inf, limits)
        differential_evolution(self.cost, [(-5, 5)] * n, constraints=constraint, x0=np.zeros(n), rng=seed, tol=0, atol=0, maxiter=10**6, polish=False)

    def spent(self, solver: str, seed: int) -> float:
        try:
            getattr(self, solver)(seed)
        except Enough:
            pass
        return self.n_evaluations if self.solved else math.inf


def main() -> None:
    warnings.simplefilter("ignore")
    for are_balls in [False, True]:
        totals = {"pycma": 0, "scipy": 0}
        n_runs = 0
        for function, name in enumerate(FUNCTIONS):
            for n in [2, 5, 10]:
                for m in [1, n, n + n // 2]:
                    if are_balls and m > n:
                        continue
                    line = f"| {'balls' if are_balls else 'linear'} | {name} | {n} | {m} |"
                    n_runs += SEEDS
                    for solver in totals:
                        runs = [Run(Problem(function, n, m, seed), are_balls) for seed in range(SEEDS)]
                        spent = sorted(run.spent(solver, seed) for seed, run in enumerate(runs))
                        n_solved = sum(map(math.isfinite, spent))
                        totals[solver] += n_solved
                        line += f" {solver} {n_solved}/{SEEDS} {spent[SEEDS // 2]:.0f} |"
                    print(line, flush=True)
        print(totals, "of", n_runs, flush=True)


if __name__ == "__main__":
    main()
