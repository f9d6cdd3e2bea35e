"""Measures how much faster a fit with eight recordings is if the recordings of a point are simulated at the same time.

    python benches/recordings.py [--rounds 3]

The model waits in its right-hand side, so that the ratios do not depend on the number of cores. Nelder-Mead
evaluates one point at a time (``batch="serial"``). The first two points are simulated in one process, which tests
whether the model can be reset. The recordings have equal length and seeded noise. All fits must
have the same bits.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import pydfo
from small_models import build

RECORDINGS = 8
WORKERS = (1, 2, 4, 8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3)
    rounds = parser.parse_args().rounds
    t = np.linspace(0.0, 4.0, 41)
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        model = build("slow_decay", Path(folder))
        data = [{"time": t, "a": np.exp(-0.7 * t) + rng.normal(0.0, 0.01, t.size)} for _ in range(RECORDINGS)]
        seconds: dict[int, list[float]] = {workers: [] for workers in WORKERS}
        bits = set()
        for _ in range(rounds):
            for workers in WORKERS:
                calibration = pydfo.Calibration(
                    model,
                    [pydfo.Experiment(recording, {"a": "a"}) for recording in data],
                    parameters=[pydfo.Parameter("k1", 1.0, 0.1, 3.0), pydfo.Parameter("k2", 0.3, fixed=True)],
                    solver="tsit5",
                )
                calibration.cost([1.1, 0.3])
                start = time.perf_counter()
                fit = calibration.fit(
                    "nelder-mead", batch="serial", workers=workers, disp=False, max_evaluations=200, x_tol=1e-12, f_tol=1e-15, covariance=None
                )
                seconds[workers].append(time.perf_counter() - start)
                bits.add((fit.x.tobytes(), fit.cost, fit.nfev))
        assert len(bits) == 1, bits
        medians = {workers: statistics.median(values) for workers, values in seconds.items()}
        for workers in WORKERS:
            speed_up = medians[1] / medians[workers]
            print(f"{workers} workers: {medians[workers]:.3f} s, {speed_up:.2f} times as fast, {speed_up / workers:.2f} of the number of workers")


if __name__ == "__main__":
    main()
