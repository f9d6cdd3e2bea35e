"""Calibration of the pendulum that the guides use. The page "Your first fit" explains each line."""

import pydfo

outputs = {"armJoint.phi": "phi", "pendulumJoint.phi": "theta"}
parameters = [
    pydfo.Parameter("armFriction", 0.012, 0, 0.022),
    pydfo.Parameter("pendulumFriction", 0.002, 0, 0.012),
]
calibration = pydfo.Calibration("furuta.fmu", "furuta.csv", outputs, parameters)
