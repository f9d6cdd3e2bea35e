"""Compares the Pareto fronts of pydfo and of pymoo's NSGA-II at equal numbers of evaluations.

    python benches/dfo/pareto.py [--markdown FILE] [--seeds N] [--first SEED]

Problems: ZDT1 to ZDT3 with 30 parameters (Zitzler, Deb and Thiele, Evol. Comput. 8, 2000), and two convex criteria, the
squared distances of two parameters in [-3, 3] from (1, 0) and (-1, 0). Both programs have 100 members and their own
default settings. The hypervolumes of both fronts are computed by pymoo, up to (1.1, 1.1) for ZDT1 and ZDT2, (1, 1.1)
for ZDT3, and (4.4, 4.4) for the convex criteria. A ratio above 1 is in favour of pydfo.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pydfo
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem
from pymoo.indicators.hv import HV
from pymoo.optimize import minimize

BUDGETS = (5000, 10_000, 25_000)


def zdt(shape: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """Returns the criteria of points in columns: f1 = x1, and f2 = g h(f1, g)."""

    def criteria(x: np.ndarray) -> np.ndarray:
        g = 1.0 + 9.0 * x[1:].mean(axis=0)
        return np.stack([x[0], g * shape(x[0], g)])

    return criteria


def convex(x: np.ndarray) -> np.ndarray:
    return np.stack([(x[0] - 1.0) ** 2 + x[1] ** 2, (x[0] + 1.0) ** 2 + x[1] ** 2])


@dataclass(frozen=True)
class Case:
    """Criteria of points in columns, their box, and the reference point of the hypervolume."""

    criteria: Callable[[np.ndarray], np.ndarray]
    bounds: list[tuple[float, float]]
    reference: tuple[float, float]


UNIT = [(0.0, 1.0)] * 30
CASES = {
    "ZDT1": Case(zdt(lambda f, g: 1.0 - np.sqrt(f / g)), UNIT, (1.1, 1.1)),
    "ZDT2": Case(zdt(lambda f, g: 1.0 - (f / g) ** 2), UNIT, (1.1, 1.1)),
    "ZDT3": Case(zdt(lambda f, g: 1.0 - np.sqrt(f / g) - f / g * np.sin(10.0 * np.pi * f)), UNIT, (1.0, 1.1)),
    "convex": Case(convex, [(-3.0, 3.0)] * 2, (4.4, 4.4)),
}


def of_pydfo(case: Case, budget: int, seed: int) -> np.ndarray:
    return pydfo.pareto(case.criteria, case.bounds, max_evaluations=budget, rng=seed, vectorized=True).criteria


class Given(Problem):
    """The problem in the form of pymoo."""

    def __init__(self, case: Case) -> None:
        low, high = map(np.array, zip(*case.bounds))
        super().__init__(n_var=len(low), n_obj=2, xl=low, xu=high)
        self.case = case

    def _evaluate(self, x: np.ndarray, out: dict, *_: object, **__: object) -> None:
        out["F"] = self.case.criteria(x.T).T


def of_pymoo(case: Case, budget: int, seed: int) -> np.ndarray:
    result = minimize(Given(case), NSGA2(pop_size=100), ("n_eval", budget), seed=seed)
    assert result.algorithm.evaluator.n_eval == budget
    return result.F


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path, help="write the table to this file as well")
    parser.add_argument("--seeds", type=int, default=11)
    parser.add_argument("--first", type=int, default=1)
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    lines = ["# Several criteria: comparison with NSGA-II of pymoo", ""]
    lines += [f"`python benches/dfo/pareto.py --seeds {arguments.seeds} --first {arguments.first}`; pymoo {importlib.metadata.version('pymoo')}."]
    lines += ["Hypervolumes: medians over the seeds, with their smallest and largest values in parentheses.", ""]
    lines += ["| problem | evaluations | pydfo | pymoo | ratio of medians |", "|---|---|---|---|---|"]
    for name, case in CASES.items():
        for budget in BUDGETS:
            volumes = [[HV(ref_point=np.array(case.reference))(of(case, budget, seed)) for seed in seeds] for of in (of_pydfo, of_pymoo)]
            medians = [statistics.median(of_program) for of_program in volumes]
            cells = [f"{median:.4f} ({min(v):.4f} to {max(v):.4f})" for median, v in zip(medians, volumes)]
            lines.append(f"| {name} | {budget} | {' | '.join(cells)} | {medians[0] / medians[1]:.4f} |")
            print(lines[-1], flush=True)
    print("\n".join(lines), flush=True)
    if arguments.markdown:
        arguments.markdown.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
