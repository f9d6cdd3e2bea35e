"""Compares optimisers: ours and the peers on equal problems, with every evaluation counted.

    python benches/dfo/run.py [--set SET ...] [--method SOLVER ...] [--half even|odd] [--seeds N] [--write] [--list]

`--list` lists the sets with their problems, budgets and solvers. A problem is solved at tau if f(x0) - f >= (1 - tau)
(f(x0) - f_best) (Moré and Wild, SIAM J. Optim. 20, 2009), f without noise; in the BBOB sets, if f <= 1e-2. The unit
is evaluations / (n + 1). An unsolved problem counts as infinite in the median. "Rounds" is the time on a machine with
one unit of time per evaluation and the given number of workers. Problems with even numbers may be used for tuning
constants, and odd ones are for assessment (`--half odd`). The tables contain all problems and the odd half
separately.

`--write` writes a table and a plot of data profiles into benches/dfo/results/, with the command that made them.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import bbob
import calibration_like
import more_wild
import numpy as np
import profiles
import solvers
from problem import Problem, Record

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class Set:
    """Problems with budget (in units of n + 1, or of n if `per_n`), tolerances, solvers and seeds."""

    what: str
    problems: Callable[[int], list[Problem]]
    factor: int
    taus: tuple[float, ...]
    solvers: tuple[str, ...]
    seeds: int = 1
    per_n: bool = False
    target: float | None = None
    workers: tuple[str, ...] = ("1",)

    def budget(self, p: Problem) -> int:
        return self.factor * (p.n if self.per_n else p.n + 1)


SCALAR = ("nelder-mead", "quadratic-model", "cma-es", "pattern-search", "auto")
PEERS = ("SciPy Nelder-Mead", "SciPy Nelder-Mead, adaptive", "SciPy Powell", "NLopt Nelder-Mead", "NLopt Sbplx", "NLopt BOBYQA")
PEERS += ("COBYQA", "Py-BOBYQA")
VECTOR = ("least-squares", "least-squares, batch n+4")
VECTOR_PEERS = ("DFO-LS", "SciPy least_squares trf")
GLOBAL = ("auto, global", "multistart", "de", "cma-es", "SciPy DE", "SciPy dual annealing", "pycma BIPOP", "pygmo sade")
ROUNDS = ("1", "4", "n+4")

SETS: dict[str, Set] = {
    "more-wild": Set(
        "53 smooth least-squares problems of Moré and Wild", lambda _: more_wild.smooth(), 100, (1e-1, 1e-3, 1e-5, 1e-7),
        VECTOR + VECTOR_PEERS + SCALAR + PEERS, workers=ROUNDS,
    ),
    "more-wild-stochastic": Set(
        "the same with 1e-3 stochastic relative noise in each residual", lambda _: more_wild.noisy("stochastic"), 100,
        (1e-1, 1e-3, 1e-5), ("least-squares", "DFO-LS", "DFO-LS, noise", "nelder-mead", "quadratic-model", "Py-BOBYQA, noise"), 5,
    ),
    "more-wild-deterministic": Set(
        "the same with 1e-3 deterministic relative noise", lambda _: more_wild.noisy("deterministic"), 100,
        (1e-1, 1e-3, 1e-5), ("least-squares", "DFO-LS", "DFO-LS, noise", "nelder-mead", "quadratic-model", "Py-BOBYQA, noise"),
    ),
    "more-wild-nonsmooth": Set(
        "the sums of absolute residuals", lambda _: more_wild.nonsmooth(), 100, (1e-1, 1e-3), SCALAR + PEERS,
    ),
    "bounded-interior": Set(
        "16 of the problems in a box with the minimum inside", lambda _: more_wild.bounded(False), 200, (1e-3, 1e-6),
        VECTOR + VECTOR_PEERS + SCALAR + PEERS,
    ),
    "bounded-active": Set(
        "16 of the problems in a box that excludes the minimum in every other coordinate", lambda _: more_wild.bounded(True), 200,
        (1e-3, 1e-6), VECTOR + VECTOR_PEERS + SCALAR + PEERS,
    ),
    "failing": Set(
        "17 problems in boxes where some points fail (NaN)", lambda _: more_wild.failing(), 200, (1e-3, 1e-6),
        VECTOR + VECTOR_PEERS + SCALAR + PEERS,
    ),
    "calibration": Set(
        "28 fits of engineering models from three starts each, 1 % noise in the data", lambda _: list(calibration_like.problems(False)),
        200, (1e-3, 1e-5), VECTOR + ("DFO-LS, x / |x0|", *VECTOR_PEERS, "nelder-mead", "quadratic-model", "COBYQA, x / |x0|"),
        workers=ROUNDS,
    ),
    "calibration-bounded": Set(
        "the fits of `calibration` in boxes, most with an active bound", lambda _: list(calibration_like.problems(True)), 200, (1e-3, 1e-5),
        VECTOR + (*VECTOR_PEERS, "nelder-mead", "quadratic-model", "COBYQA, x / |x0|"), workers=ROUNDS,
    ),
    **{
        f"bbob-{n}": Set(
            f"24 BBOB functions in {n} dimensions, 1000 n evaluations", lambda seeds, n=n: bbob.problems(n, seeds), 1000, (),
            GLOBAL, 15, True, 1e-2,
        )
        for n in (2, 5, 10, 20)
    },
}  # fmt: skip


@cache
def problems_of(name: str, seeds: int) -> list[Problem]:
    return SETS[name].problems(seeds)


def one(job: tuple[str, int, int, str, int]) -> tuple[np.ndarray, list[np.ndarray], str | None]:
    """Runs a solver in a worker process; returns the best cost after each evaluation, the end of each, and an
    error."""
    set_name, seeds, place, solver, seed = job
    chosen = SETS[set_name]
    p = problems_of(set_name, seeds)[place]
    seen: Record = solvers.record(solver, p, chosen.budget(p), seed)
    costs = np.minimum.accumulate(seen.costs) if seen.costs else np.array([np.inf])
    clocks = [seen.rounds(p.n + 4 if w == "n+4" else float(w)) for w in chosen.workers]
    return costs, clocks, seen.error


def run(name: str, requested: list[str] | None, half: str, seeds: int, jobs: int) -> profiles.Outcome:
    """Runs all solvers on all problems of a set."""
    chosen = SETS[name]
    n_instances = seeds if chosen.target is not None else 1
    found = problems_of(name, n_instances)
    places = [k for k, p in enumerate(found) if half == "all" or p.number % 2 == (half == "odd")]
    runs = range(1 if chosen.target is not None else seeds)
    names = [s for s in requested or chosen.solvers if s in solvers.SOLVERS]
    work = [(name, n_instances, k, s, seed) for s in names for k in places for seed in runs]
    with ProcessPoolExecutor(jobs) as pool:
        answers = list(pool.map(one, work, chunksize=4))
    outcome = profiles.Outcome(chosen.target, chosen.taus, chosen.workers, [found[k] for k in places], len(runs), chosen.factor)
    for (_, _, k, solver, _), (costs, clocks, error) in zip(work, answers):
        outcome.add(solver, found[k], costs, clocks, error)
    return outcome


def versions() -> str:
    names = ("fmufit", "numpy", "scipy", "nlopt", "cobyqa", "Py-BOBYQA", "DFO-LS", "cma", "pygmo")
    found = {d.metadata["Name"]: d.version for d in importlib.metadata.distributions()}
    return ", ".join(f"{name} {found[name]}" for name in names if name in found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", nargs="+", choices=list(SETS), default=list(SETS), metavar="SET")
    parser.add_argument("--method", nargs="+", choices=list(solvers.SOLVERS), metavar="SOLVER")
    parser.add_argument("--half", choices=("all", "even", "odd"), default="all")
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--each", action="store_true", help="a line per problem")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--list", action="store_true")
    arguments = parser.parse_args()
    if arguments.list:
        for name, s in SETS.items():
            print(f"{name}: {s.what}; {s.factor} (n{'' if s.per_n else ' + 1'}) evaluations; {', '.join(s.solvers)}")
        return
    for name in arguments.set:
        chosen = SETS[name]
        seeds = arguments.seeds or chosen.seeds
        outcome = run(name, arguments.method, arguments.half, seeds, arguments.jobs)
        text = f"# {name}: {chosen.what}\n\n    python benches/dfo/run.py {' '.join(sys.argv[1:])}\n\n"
        text += f"{versions()}; Python {platform.python_version()}. Budget {chosen.factor} (n{'' if chosen.per_n else ' + 1'}) "
        text += f"evaluations; seeds: {seeds}. Problems with even numbers are for tuning, those with odd numbers for assessment.\n\n"
        text += outcome.tables(arguments.half)
        if arguments.each:
            text += outcome.each()
        print(text, flush=True)
        if arguments.write:
            RESULTS.mkdir(exist_ok=True)
            (RESULTS / f"{name}.md").write_text(text + f"\n![data profiles]({name}.svg)\n")
            outcome.plot(RESULTS / f"{name}.svg", f"{name}: {chosen.what}")


if __name__ == "__main__":
    main()
