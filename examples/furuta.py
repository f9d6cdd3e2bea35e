"""Calibrates the friction of a Furuta pendulum (Gedda, Andersson, Akesson, Diehl 2012, section 6.1).

First the paper's own script, with its import lines changed; then the native door, where the whole fit runs in Rust.
Prints the iterations and the result, and draws measurements, responses and residuals into furuta.png.
"""

from pathlib import Path

import numpy as N

import pydfo
from pydfo import FMUModel, dfo, example_fmu

HERE = Path(__file__).resolve().parent
DATA = HERE / "data" / "furuta.csv"
FURUTA = example_fmu("furuta")  # the bundled model, as an .fmu file

# --- The paper's script -----------------------------------------------------------------------------------------------

# Load measurement data from file (the paper loads a .mat file here)
t_meas, phi_meas, theta_meas = N.loadtxt(DATA, delimiter=",", skiprows=1, unpack=True)
y_meas = N.vstack((phi_meas, theta_meas))


# Define the objective function
def furuta_dfo_cost(x):
    # Scale down
    armFriction = x[0] / 1e3
    pendFriction = x[1] / 1e3

    # Load the FMU model
    model = FMUModel(FURUTA)

    # Set new parameter values
    model.set("armFriction", armFriction)
    model.set("pendulumFriction", pendFriction)

    # Simulate the model response
    res = model.simulate(final_time=40)

    # Load simulation result
    phi_sim = res["armJoint.phi"]
    theta_sim = res["pendulumJoint.phi"]
    t_sim = res["time"]

    # Evaluate the objective function
    y_sim = N.vstack((phi_sim, theta_sim))
    obj = dfo.quad_err(t_meas, y_meas, t_sim, y_sim)

    return obj


# Specify initial conditions (scaled)
x0 = N.array([0.012, 0.002]) * 1e3

# Lower and upper bounds
lb = N.zeros(2)
ub = x0 + 10

# Solve using the Nelder-Mead algorithm
res = dfo.fmin(furuta_dfo_cost, xstart=x0, lb=lb, ub=ub, x_tol=1e-3, f_tol=1e-2)

# Optimal point rescaled
[armFriction_opt, pendFriction_opt] = res[0] / 1e3
print(f"\nThe paper's script: armFriction = {armFriction_opt:.6f}, pendulumFriction = {pendFriction_opt:.6f}")
print(f"cost {res[1]:.4f} after {res[3]} evaluations in {res[4]:.2f} s\n")

# --- The native door --------------------------------------------------------------------------------------------------

calibration = pydfo.Calibration(
    FURUTA,
    data=DATA,
    outputs={"armJoint.phi": "phi", "pendulumJoint.phi": "theta"},
    parameters=[
        pydfo.Parameter("armFriction", 0.012, 0, 0.022),
        pydfo.Parameter("pendulumFriction", 0.002, 0, 0.012),
    ],
)
fit = calibration.fit()
nominal = calibration.residuals([0.012, 0.002])
print(f"The native fit: {fit.parameters}")
print(f"RMS {N.sqrt(N.mean(nominal**2)):.4f} rad nominal, {fit.rms:.4f} rad fitted; {fit.nfev} evaluations")
print(fit.message)

try:
    figure = fit.plot()
except ImportError as error:  # matplotlib is an extra
    print(error)
else:
    out = Path("furuta.png")
    figure.savefig(out, dpi=120)
    print(f"drawn into {out}")
