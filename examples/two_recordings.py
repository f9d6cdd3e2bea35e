"""Fits one pendulum to two recordings with different initial angles. The frictions are shared; the initial angle is
local.

The recordings are generated with the bundled model, known parameters and noise (seed 7).
"""

import numpy as np

import pydfo

FURUTA = pydfo.example_fmu("furuta")
TRUE = {"armFriction": 0.011, "pendulumFriction": 0.0013}  # N m
ANGLES = {"high": 0.52, "low": 1.9}  # initial angles of the pendulum, rad
NOISE = {"armJoint.phi": 0.03, "pendulumJoint.phi": 0.02}  # standard deviations, rad
TIMES = np.arange(0.0, 20.01, 0.05)


def record(angle, rng):
    """Returns a recording that starts at this angle."""
    model = pydfo.FMUModel(FURUTA)
    result = model.simulate(times=TIMES, start_values=TRUE | {"pendulumJoint.phi": angle}, outputs=list(NOISE))
    return {"time": TIMES} | {name: result[name] + rng.normal(0.0, sigma, TIMES.size) for name, sigma in NOISE.items()}


def main():
    rng = np.random.default_rng(7)
    weights = {name: 1.0 / sigma for name, sigma in NOISE.items()}
    recordings = [
        pydfo.Experiment(
            record(angle, rng),
            list(NOISE),
            name=name,
            weights=weights,
            initial_states={"pendulumJoint.phi": pydfo.Parameter("first angle", round(angle, 1), 0.0, 3.0)},
        )
        for name, angle in ANGLES.items()
    ]
    frictions = [pydfo.Parameter("armFriction", 0.012, 0.0, 0.022), pydfo.Parameter("pendulumFriction", 0.002, 0.0, 0.012)]
    fit = pydfo.Calibration(FURUTA, recordings, frictions).fit()
    print(fit)

    truth = TRUE | {f"pendulumJoint.phi[{name}]": angle for name, angle in ANGLES.items()}
    for name, value in truth.items():
        low, high = fit.confidence_intervals(0.999)[list(fit.parameters).index(name)]
        if not low <= value <= high:
            raise SystemExit(f"{name}: the true value {value} is not in {low} ... {high}")
    if not 0.9 < fit.rms < 1.1:
        raise SystemExit(f"residuals divided by their standard deviations have the RMS {fit.rms}, not 1")


if __name__ == "__main__":
    main()
