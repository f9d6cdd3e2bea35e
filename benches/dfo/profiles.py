"""Data profiles of a set of problems: as tables and as plots (Moré and Wild, SIAM J. Optim. 20, 2009)."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from problem import Array, Problem


@dataclass
class Seen:
    """A run: the problem, the best cost after each evaluation, and the end of each evaluation on each clock."""

    problem: Problem
    costs: Array
    clocks: list[Array]


@dataclass
class Outcome:
    """Results of the runs of a set of problems."""

    target: float | None
    taus: tuple[float, ...]
    workers: tuple[str, ...]
    problems: list[Problem]
    n_runs: int
    factor: int
    runs: dict[str, list[Seen]] = field(default_factory=lambda: defaultdict(list))
    errors: dict[str, dict[str, int]] = field(default_factory=lambda: defaultdict(lambda: defaultdict(int)))

    def add(self, solver: str, problem: Problem, costs: Array, clocks: list[Array], error: str | None) -> None:
        self.runs[solver].append(Seen(problem, costs, clocks))
        if error:
            self.errors[solver][error] += 1

    def best(self) -> dict[str, float]:
        """Returns the best known value of each problem: the stored one, or a lower one found by a solver of this
        run."""
        best = {p.name: p.best for p in self.problems}
        for runs in self.runs.values():
            for seen in runs:
                best[seen.problem.name] = min(best[seen.problem.name], float(seen.costs[-1]))
        return best

    def solved_at(self, seen: Seen, tau: float, best: float) -> int | None:
        """Returns the number of the evaluation that solved the problem."""
        if self.target is not None:
            limit = self.target
        else:
            first = seen.problem.assessed(seen.problem.x0)
            limit = first - (1.0 - tau) * (first - best)
        good = np.flatnonzero(seen.costs <= limit)
        return int(good[0]) if len(good) else None

    def units(self, solver: str, tau: float, clock: int | None = None, odd: bool = False) -> Array:
        """Returns evaluations / (n + 1), or rounds, until solved; infinite if unsolved."""
        best, units = self.best(), []
        for seen in self.runs[solver]:
            if odd and seen.problem.number % 2 == 0:
                continue
            place = self.solved_at(seen, tau, best[seen.problem.name])
            if place is None:
                units.append(np.inf)
            elif clock is None:
                units.append((place + 1) / (seen.problem.n + 1))
            else:
                units.append(seen.clocks[clock][place])
        return np.array(units)

    def tables(self, half: str) -> str:
        """Returns solved fractions and medians of all problems and of the odd ones. If there is a target, returns
        them by function."""
        text = ""
        for odd in (False, True) if half == "all" else (False,):
            taus = self.taus or (0.0,)
            names = [f"tau {tau:g}" for tau in self.taus] or [f"f <= {self.target:g}"]
            head = ["assessment half" if odd else "solved % (median units)"] + names
            head += [f"rounds ({w} in parallel)" for w in self.workers] if len(self.workers) > 1 else []
            rows = []
            for solver in self.runs:
                row = [solver]
                for tau in taus:
                    row.append(cell(self.units(solver, tau, odd=odd)))
                if len(self.workers) > 1:
                    tau = 1e-5
                    row += [number(np.median(self.units(solver, tau, k, odd))) for k in range(len(self.workers))]
                rows.append(row)
            text += markdown(head, rows) + "\n"
        if self.target is not None:
            numbers = sorted({p.number for p in self.problems})
            rows = []
            for solver, runs in self.runs.items():
                by = defaultdict(list)
                for seen in runs:
                    by[seen.problem.number].append(self.solved_at(seen, 0.0, 0.0) is not None)
                rows.append([solver] + [str(sum(by[k])) for k in numbers])
            text += markdown([f"solved of {len(self.problems) // len(numbers)}"] + [f"f{k}" for k in numbers], rows) + "\n"
        for solver, errors in self.errors.items():
            for error, count in errors.items():
                text += f"- {solver}: {count} runs ended with {error[:120]}\n"
        return text

    def each(self) -> str:
        """Returns a line per problem: units at the smallest tau, by solver."""
        tau = min(self.taus, default=0.0)
        columns = {solver: self.units(solver, tau) for solver in self.runs}
        runs = next(iter(self.runs.values()))
        rows = [[s.problem.name] + [number(c[k]) for c in columns.values()] for k, s in enumerate(runs)]
        return markdown(["problem", *columns], rows)

    def plot(self, path: Path, title: str) -> None:
        """Draws data profiles with a panel per tau."""
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt

        taus = self.taus[-2:] or (0.0,)
        figure, axes = plt.subplots(1, len(taus), figsize=(5.5 * len(taus), 4.2), squeeze=False, sharey=True)
        for ax, tau in zip(axes[0], taus):
            for k, solver in enumerate(self.runs):
                units = np.sort(self.units(solver, tau))
                shares = np.arange(1, len(units) + 1) / len(units)
                solved = np.isfinite(units)
                x = np.concatenate((units[solved], [self.factor]))
                y = np.concatenate((shares[solved], [solved.mean()]))
                ax.step(x, y, where="post", label=solver, linestyle=("-", "--", ":")[k // 10 % 3], linewidth=1.2)
            ax.set(xscale="log", ylim=(0, 1), xlabel="evaluations / (n + 1)", title=f"tau = {tau:g}" if tau else "")
            ax.grid(alpha=0.3)
        axes[0][0].set_ylabel("share of problems solved")
        axes[0][-1].legend(fontsize=6)
        figure.suptitle(title, fontsize=9)
        figure.tight_layout()
        figure.savefig(path, metadata={"Date": None})
        plt.close(figure)


def number(value: float) -> str:
    return "-" if not np.isfinite(value) else f"{value:.1f}" if value < 100 else f"{value:.0f}"


def cell(units: Array) -> str:
    """Returns the fraction solved, and the median of the units."""
    return f"{100.0 * np.isfinite(units).mean():.0f} ({number(np.median(units))})"


def markdown(head: list[str], rows: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)) + "\n"
