"""Measures the gain from several workers, and the cost of ask and tell from Python.

    python benches/dfo/workers.py
"""

import time

import numpy as np
import pydfo


def gain(method: str, workers: int, evaluations: int = 200) -> float:
    """Returns the seconds of a run whose objective waits for 5 ms without the interpreter lock."""

    def slow(x: np.ndarray) -> float:
        time.sleep(0.005)
        return float(100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2)

    begin = time.perf_counter()
    pydfo.minimize(slow, [-1.2, 1.0], [(-2, 2)] * 2, method, workers=workers, rng=1, max_evaluations=evaluations)
    return time.perf_counter() - begin


def time_per_ask(method: str, n: int = 10, evaluations: int = 20_000) -> float:
    """Returns microseconds per evaluation of ask and tell from Python, with whole batches, without the objective."""
    optimizer = pydfo.Optimizer(method, np.full(n, -1.2), [(-5, 5)] * n, rng=1, max_evaluations=evaluations)
    spent, count = 0.0, 0
    while not optimizer.done:
        begin = time.perf_counter()
        points = optimizer.ask()
        spent += time.perf_counter() - begin
        costs = [float(np.sum(100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2)) for x in points.x]
        begin = time.perf_counter()
        optimizer.tell(points.ids, costs)
        spent += time.perf_counter() - begin
        count += len(costs)
    return 1e6 * spent / count


def main() -> None:
    methods = [name for name, _ in pydfo._core.method_names() if name != "least-squares"]
    print("| 200 evaluations of 5 ms | 1 worker | 2 workers | gain |\n|---|---|---|---|")
    for method in methods:
        one, two = gain(method, 1), gain(method, 2)
        print(f"| {method} | {one:.2f} s | {two:.2f} s | {one / two:.2f} |")
    print("\n| ask + tell from Python, n = 10 | µs per evaluation |\n|---|---|")
    for method in methods:
        print(f"| {method} | {time_per_ask(method):.2f} |")


if __name__ == "__main__":
    main()
