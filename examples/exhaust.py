"""Calibrates the heat losses of a diesel exhaust pipe: a stiff model driven by five recorded inputs.

There is no recording in this folder: one is made of the model itself with known parameters, noise of a degree, and a drive
cycle of ramps; then the parameters are found again from a start that is off by up to 60 %.
"""

import numpy as np

import pydfo

TRUE = {"C1": 2500.0, "G1": 120.0, "C2": 9000.0, "G2": 80.0}
START = {"C1": 4000.0, "G1": 80.0, "C2": 6000.0, "G2": 120.0}


def drive_cycle(seconds=300):
    """Inputs once a second: a load that goes up and down in ramps moves all of them."""
    time = np.arange(seconds + 1.0)
    load = np.interp(time, [0, 20, 50, 90, 120, 160, 200, 230, 300], [0.1, 0.1, 0.6, 0.4, 0.9, 0.2, 0.7, 0.3, 0.5])
    return {
        "time": time,
        "T_in": 450 + 450 * load,
        "p_in": 1.1e5 + 1.2e5 * load,
        "w_turb1": 2000 + 4000 * load,
        "w_turb2": 1500 + 3500 * load,
        "p_out": np.full_like(time, 1.013e5),
    }


def main():
    """Makes the recording, fits, and prints what comes out."""
    inputs = drive_cycle()
    model = pydfo.FMUModel(pydfo.example_fmu("exhaust"))
    for name, value in TRUE.items():
        model.set(name, value)
    truth = model.simulate(0, 300, times=inputs["time"], inputs=inputs, outputs=["T_out"])
    stats = truth.stats
    print(f"stiff: {stats.accepted_steps} steps, {stats.jacobians} Jacobians, {stats.decompositions} decompositions")
    noise = np.random.default_rng(1).normal(0.0, 1.0, len(inputs["time"]))
    calibration = pydfo.Calibration(
        pydfo.example_fmu("exhaust"),
        data=inputs | {"T_out": truth["T_out"] + noise},
        inputs=[name for name in inputs if name != "time"],
        outputs=["T_out"],
        parameters=[pydfo.Parameter(n, v, 0.1 * v, 10 * v, scale="log") for n, v in START.items()],
    )
    fit = calibration.fit()
    for name, value in fit.parameters.items():
        print(f"{name}: {START[name]:g} -> {value:.1f}, truth {TRUE[name]:g}")
    print(f"RMS {fit.rms:.3f} K, {fit.nfev} simulations")
    if not 0.9 < fit.rms < 1.1:
        raise SystemExit("the fit has not found the noise")


if __name__ == "__main__":
    main()
