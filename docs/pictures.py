"""Draws the pictures of the pages: fits of the examples, with the seed 1 where something is random.

    python docs/pictures.py [FOLDER]        default: docs/pictures, beside this file
"""

import runpy
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import pydfo

HERE = Path(__file__).resolve().parent
SEED = 1
EXHAUST_INPUTS = ["T_in", "p_in", "w_turb1", "w_turb2", "p_out"]
WALLS = {"C1": (2500, 50000), "G1": (120, 500), "C2": (9000, 50000), "G2": (80, 500)}


def pendulum(files):
    """The calibration of the pendulum."""
    angles = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}
    frictions = [pydfo.Parameter("armFriction", 0.012, 0, 0.022), pydfo.Parameter("pendulumFriction", 0.002, 0, 0.012)]
    return pydfo.Calibration(files / "furuta.fmu", files / "furuta.csv", angles, frictions)


def methods(calibration):
    """The best cost over the evaluations, by method."""
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for method in ("least-squares", "nelder-mead", "cma-es", "de"):
        fit = calibration.fit(method=method, rng=SEED, covariance=None)
        best = np.fmin.accumulate(fit.trace.fun[fit.trace.used])
        axes.plot(range(1, len(best) + 1), best, label=f"{method}: {fit.nfev} evaluations")
    axes.set(xscale="log", yscale="log", xlabel="evaluations", ylabel="best cost so far")
    axes.legend()
    return figure


def drawn(files):
    """Each picture with its name, one after the other."""
    calibration = pendulum(files)
    fit = calibration.fit()
    yield "furuta", fit.plot()
    yield "profile", fit.plot_profiles()
    yield "sensitivity", fit.plot_sensitivity()
    yield "waterfall", calibration.fit(search="global", rng=SEED).plot_waterfall()
    yield "methods", methods(calibration)
    parameters = [pydfo.Parameter(name, start, 1e-4 * start, upper) for name, (start, upper) in WALLS.items()]
    pipe = pydfo.Calibration(files / "exhaust.fmu", files / "exhaust.csv", ["T_out"], parameters, inputs=EXHAUST_INPUTS, window=(0, 500))
    staged = pipe.fit(stages=[["C2", "G2"], ["C1", "G1"]])
    yield "exhaust", staged.plot()
    yield "validation", staged.validate(windows=(501, 1200)).plot()
    yield "correlation", staged.plot_correlation()


def write(folder):
    """Draws all pictures into a folder; returns their files."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with tempfile.TemporaryDirectory() as files:
        runpy.run_path(str(HERE / "example_files.py"))["write"](files)
        for name, figure in drawn(Path(files)):
            path = folder / f"{name}.png"
            figure.savefig(path, dpi=72, metadata={"Software": None})
            plt.close(figure)
            written.append(path)
    return written


if __name__ == "__main__":
    plt.switch_backend("Agg")
    write(sys.argv[1] if len(sys.argv) > 1 else HERE / "pictures")
