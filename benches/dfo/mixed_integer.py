"""Compares optimisers on problems with integer parameters: ours and pycma, with every evaluation counted.

    python benches/dfo/mixed_integer.py [--markdown FILE] [--seeds N] [--first SEED] [--solver NAME ...] [--each]

Functions: sphere, ellipsoid, rotated ellipsoid, Rosenbrock, steps, Rastrigin and Ackley with 4, 8 and 16 parameters.
Kinds: `mixed` (the first half of the parameters are integers), `integer` (all are), and `binary` (the first half are 0
or 1). The box and the minimum are drawn with the seed of the problem: bounds from 8 to 12 on either side of zero, the
minimum within 6 of zero, and integers where the parameter is one. The minimum is 0. The budget is 1000 n evaluations.
A run is solved at the first cost of at most 1e-6.

pycma starts where CMA-ES of pydfo starts without a start point, in the middle of the box, with a standard deviation of
0.3 of the width of the box, and with its option `integer_variables`. `pycma` is one run, `pycma BIPOP` restarts.

Seeds 0 to 99 are for tuning, seeds from 100 on (the default) for assessment. The ratio is the geometric mean of the
evaluations of a solver in units of the evaluations of `pycma`, over the runs that both solved.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import itertools
import math
import os
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from problem import Enough

FUNCTIONS = ("sphere", "ellipsoid", "rotated ellipsoid", "Rosenbrock", "steps", "Rastrigin", "Ackley")
KINDS = ("mixed", "integer", "binary")
SIZES = (4, 8, 16)
TARGET = 1e-6
BUDGET = 1000


@dataclass(frozen=True)
class Case:
    """A function with its box; the first `n_integer` parameters are integers."""

    f: Callable[[np.ndarray], float]
    lower: np.ndarray
    upper: np.ndarray
    n_integer: int

    @property
    def n(self) -> int:
        return len(self.lower)


def case(name: str, kind: str, n: int, seed: int) -> Case:
    """Returns a problem drawn with a seed."""
    rng = np.random.default_rng([20261, FUNCTIONS.index(name), KINDS.index(kind), n, seed])
    n_integer = n if kind == "integer" else n // 2
    lower, upper = -rng.integers(8, 13, n).astype(float), rng.integers(8, 13, n).astype(float)
    best = rng.uniform(-6.0, 6.0, n)
    best[:n_integer] = np.round(best[:n_integer])
    if kind == "binary":
        lower[:n_integer], upper[:n_integer] = 0.0, 1.0
        best[:n_integer] = rng.integers(0, 2, n_integer)
    # The place of a parameter in the function does not depend on its kind.
    place = rng.permutation(n)
    turned = np.linalg.qr(rng.normal(size=(n, n)))[0]
    conditioned = 10.0 ** (4.0 * np.arange(n) / (n - 1))
    functions: dict[str, Callable[[np.ndarray], float]] = {
        "sphere": lambda z: z @ z,
        "ellipsoid": lambda z: conditioned @ z**2,
        "rotated ellipsoid": lambda z: conditioned @ (turned @ z) ** 2,
        "Rosenbrock": lambda z: (100.0 * (z[1:] + 1.0 - (z[:-1] + 1.0) ** 2) ** 2 + z[:-1] ** 2).sum(),
        "steps": lambda z: (np.floor(np.abs(2.0 * z) + 0.5) ** 2).sum(),
        "Rastrigin": lambda z: (z**2 + 10.0 - 10.0 * np.cos(2.0 * math.pi * 0.4 * z)).sum(),
        "Ackley": lambda z: (
            20.0 - 20.0 * np.exp(-0.2 * np.sqrt((z**2).mean())) + math.e - np.exp(np.cos(2.0 * math.pi * 0.4 * z).mean())
        ),
    }
    f = functions[name]
    return Case(lambda x: float(f((x - best)[place])), lower, upper, n_integer)


class Counted:
    """A cost that raises `Enough` when it has reached the target or the budget."""

    def __init__(self, of: Case) -> None:
        self.of, self.n, self.solved = of, 0, False

    def __call__(self, x: np.ndarray) -> float:
        if self.solved or self.n >= BUDGET * self.of.n:
            raise Enough
        x = np.array(x, dtype=float)
        k = self.of.n_integer
        x[:k] = np.clip(np.round(x[:k]), self.of.lower[:k], self.of.upper[:k])
        self.n += 1
        value = self.of.f(x)
        if value <= TARGET:
            self.solved = True
        return value


def of_pydfo(method: str, **options: object) -> Callable[[Counted, int], None]:
    """Returns a solver of ours."""

    def solve(f: Counted, seed: int) -> None:
        import pydfo

        of = f.of
        pydfo.minimize(
            f, bounds=list(zip(of.lower, of.upper)), integrality=[k < of.n_integer for k in range(of.n)], method=method,
            rng=seed, max_evaluations=BUDGET * of.n, options=options,
        )  # fmt: skip

    return solve


def of_pycma(bipop: bool) -> Callable[[Counted, int], None]:
    """Returns Hansen's solver with its handling of integers."""

    def solve(f: Counted, seed: int) -> None:
        import cma

        warnings.filterwarnings("ignore", module="cma")
        of = f.of
        half = np.where(np.arange(of.n) < of.n_integer, 0.5, 0.0)
        lower, upper = of.lower - half, of.upper + half
        options = {
            "seed": seed + 1, "verbose": -9, "maxfevals": BUDGET * of.n, "bounds": [of.lower.tolist(), of.upper.tolist()],
            "integer_variables": list(range(of.n_integer)), "CMA_stds": (upper - lower).tolist(),
        }  # fmt: skip
        middle = 0.5 * (lower + upper)
        if bipop:
            draw, starts = np.random.default_rng(seed), itertools.count()
            cma.fmin2(
                f, lambda: draw.uniform(of.lower, of.upper) if next(starts) else middle, 0.3, options, restarts=9, bipop=True
            )
        else:
            cma.fmin2(f, middle, 0.3, options)

    return solve


SOLVERS: dict[str, Callable[[Counted, int], None]] = {
    "auto": of_pydfo("auto"),
    "de": of_pydfo("de"),
    "cma-es": of_pydfo("cma-es"),
    "cma-es bipop": of_pydfo("cma-es", restarts="bipop"),
    "pycma": of_pycma(False),
    "pycma BIPOP": of_pycma(True),
}


def one(job: tuple[str, str, str, int, int]) -> float:
    """Runs a solver; returns the evaluations until it was solved, infinite if it was not."""
    solver, name, kind, n, seed = job
    f = Counted(case(name, kind, n, seed))
    try:
        SOLVERS[solver](f, seed)
    except Enough:
        pass
    return float(f.n) if f.solved else math.inf


def table(solvers: list[str], seeds: range, each: bool, jobs: int | None) -> list[str]:
    """Returns the lines of the tables: the median evaluations of solved runs, the fraction solved, and the ratio."""
    groups = [(kind, n) for kind in KINDS for n in SIZES]
    work = [(s, name, kind, n, seed) for kind, n in groups for name in FUNCTIONS for seed in seeds for s in solvers]
    with ProcessPoolExecutor(jobs) as pool:
        counts = dict(zip(work, pool.map(one, work, chunksize=8)))
    lines = ["| kind | n | " + " | ".join(solvers) + " |", "|---|---|" + "---|" * len(solvers)]

    def cells(kind: str, n: int, names: tuple[str, ...]) -> str:
        found = {s: np.array([counts[s, name, kind, n, seed] for name in names for seed in seeds]) for s in solvers}
        row = []
        for s in solvers:
            solved = np.isfinite(found[s])
            cell = f"{solved.mean():.0%} ({np.median(found[s][solved]):.0f}" if solved.any() else "0% ("
            both = solved & np.isfinite(found["pycma"]) if "pycma" in found else np.zeros(1, bool)
            if s != "pycma" and both.any():
                cell += f", x {np.exp(np.log(found[s][both] / found['pycma'][both]).mean()):.2f}"
            row.append(cell + ")")
        return " | ".join(row)

    for kind, n in groups:
        lines.append(f"| {kind} | {n} | {cells(kind, n, FUNCTIONS)} |")
        if each:
            lines += [f"| {kind}: {name} | {n} | {cells(kind, n, (name,))} |" for name in FUNCTIONS]
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path, help="write the table to this file as well")
    parser.add_argument("--seeds", type=int, default=15)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--solver", nargs="+", choices=list(SOLVERS), default=list(SOLVERS), metavar="NAME")
    parser.add_argument("--each", action="store_true", help="a line per function")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    lines = ["# Integer parameters: comparison with pycma", ""]
    lines += [f"`python benches/dfo/mixed_integer.py --seeds {arguments.seeds} --first {arguments.first}`; cma "]
    lines[-1] += f"{importlib.metadata.version('cma')}. Cells: fraction solved (median evaluations of solved runs, ratio to pycma)."
    lines += ["", *table(arguments.solver, seeds, arguments.each, arguments.jobs)]
    print("\n".join(lines), flush=True)
    if arguments.markdown:
        arguments.markdown.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
