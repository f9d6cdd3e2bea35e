"""Sequential rounds of SciPy's TRF with parallel finite differences, on the problems of `crates/dfo/benches/rounds.rs`.

`python rounds_peers.py BENCH [seed K]`, where BENCH is the built bench. A Jacobian takes ceil(n / workers) rounds and a
trial point takes one.
"""

import subprocess
import sys

import numpy as np
from scipy import optimize

WORKERS = {"8": lambda n: 8, "32": lambda n: 32, "n + 2": lambda n: n + 2}
TAU = 1e-5


class Solved(Exception):
    """The cost has reached the goal."""


def main() -> None:
    bench = subprocess.Popen([sys.argv[1], "serve", *sys.argv[2:]], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def reply(line):
        bench.stdin.write(line + "\n")
        bench.stdin.flush()
        return bench.stdout.readline().strip()

    def vector(text):
        return np.array([float(x) for x in text.strip("[]").split(",")])

    problems, line = [], reply("list")
    while line != "end":
        problems.append(line.split("|"))
        line = bench.stdout.readline().strip()
    rounds: dict[str, list[list[float]]] = {}
    for k, of_set, _, start, lower, upper, best in problems:
        x0, lower, upper = vector(start), vector(lower), vector(upper)
        n, counts = len(x0), [0, 0]

        def residuals(x, k=k):
            values = [float(r) for r in reply(" ".join([k, *(format(x, ".17g") for x in x)])).split()]
            return np.nan_to_num(np.array(values), nan=1e100, posinf=1e100, neginf=-1e100)

        first = residuals(x0)
        goal = float(best) + TAU * (first @ first - float(best))

        def trial(x):
            counts[0] += 1
            r = residuals(x)
            if r @ r <= goal:
                raise Solved
            if sum(counts) > 200 * (n + 1):
                raise RuntimeError
            return r

        def jacobian(x):
            counts[1] += 1
            f, steps = residuals(x), 1.5e-8 * np.maximum(1.0, abs(x))
            steps = np.where(x + steps > upper, -steps, steps)
            return np.column_stack([(residuals(x + h * e) - f) / h for h, e in zip(steps, np.eye(n))])

        inside = np.clip(x0, lower + 1e-10 * (upper > lower), upper)
        solved = False
        try:
            optimize.least_squares(trial, inside, jacobian, (lower, upper), "trf", 1e-15, 1e-15, 1e-15, x_scale="jac", max_nfev=500)
        except Solved:
            solved = True
        except (RuntimeError, ValueError, np.linalg.LinAlgError):
            pass
        of = [counts[0] + counts[1] * -(-n // workers(n)) if solved else np.inf for workers in WORKERS.values()]
        rounds.setdefault(of_set, []).append(of)
    for name, of in rounds.items():
        table = np.array(of)
        medians = np.sort(table, axis=0)[len(table) // 2]
        shown = ", ".join(f"{w} {m:4.0f}" for w, m in zip(WORKERS, medians))
        print(f"{name:12}: solved {100 * np.mean(np.isfinite(table[:, 0])):5.1f} %, rounds with workers {shown}")
    bench.stdin.close()


if __name__ == "__main__":
    main()
