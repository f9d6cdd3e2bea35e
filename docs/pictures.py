"""Draws the pictures of the pages. Methods with random numbers use the seed 1.

    python docs/pictures.py [FOLDER]        default: docs/pictures
"""

import os
import runpy
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydfo import Design, Parameter, Scenario

HERE = Path(__file__).resolve().parent
SEED = 1


def calibration_of(setup):
    """Returns the calibration of a set-up file in docs/setups. The working folder must contain the example files."""
    return runpy.run_path(f"{setup}.py")["calibration"]


def methods(calibration):
    """Best cost against the number of evaluations for four methods."""
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for method in ("least-squares", "nelder-mead", "cma-es", "de"):
        fit = calibration.fit(method=method, rng=SEED, covariance=None)
        best = np.fmin.accumulate(fit.trace.fun[fit.trace.used])
        axes.plot(range(1, len(best) + 1), best, label=f"{method}: {fit.nfev} evaluations")
    axes.set(xscale="log", yscale="log", xlabel="evaluations", ylabel="best cost so far")
    axes.legend()
    return figure


def designs():
    """Yields the name and the figure of a design and of a Pareto front."""
    controller = [Parameter("K1", 3.0, 0.5, 20.0), Parameter("T1", 30.0, 5.0, 200.0)]
    step = Scenario(60, start_values={"r2": 12.783})
    design = Design("tank_control.fmu", controller, "itae(e1)", step, constraints=["overshoot(x1, r1) <= 5"])
    yield "design", design.optimize().plot(["x1", "u1"])
    trade_off = Design("tank_control.fmu", controller, ["itae(e1)", "max(abs(u1 - u2))"], step)
    yield "front", trade_off.pareto(population=40, rng=SEED, max_evaluations=1200).plot()


def drawn():
    """Yields the name and the figure of each picture."""
    calibration = calibration_of("pendulum")
    fit = calibration.fit()
    yield "furuta", fit.plot()
    yield "profile", fit.plot_profiles()
    yield "sensitivity", fit.plot_sensitivity()
    yield "waterfall", calibration.fit(search="global", rng=SEED).plot_waterfall()
    yield "methods", methods(calibration)
    pipe = calibration_of("pipe").fit()
    yield "exhaust", pipe.plot()
    yield "validation", pipe.validate(windows=(501, 1200)).plot()
    yield "correlation", pipe.plot_correlation()
    yield from designs()


def write(folder):
    """Draws all pictures into a folder and returns their paths."""
    folder = Path(folder).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with tempfile.TemporaryDirectory() as files:
        runpy.run_path(str(HERE / "example_files.py"))["write"](files)
        before = Path.cwd()
        os.chdir(files)
        try:
            for name, figure in drawn():
                path = folder / f"{name}.png"
                figure.savefig(path, dpi=72, metadata={"Software": None})
                plt.close(figure)
                written.append(path)
        finally:
            os.chdir(before)
    return written


if __name__ == "__main__":
    plt.switch_backend("Agg")
    write(sys.argv[1] if len(sys.argv) > 1 else HERE / "pictures")
