"""Calibration of the four tanks that the guides use: two outlet areas, four measured levels, two recorded inputs."""

import pydfo

outputs = {"qt.x1": "x1", "qt.x2": "x2", "qt.x3": "x3", "qt.x4": "x4"}
inputs = ["u1", "u2"]
parameters = [
    pydfo.Parameter("qt.a1", 3e-6, 2e-6, 4e-6),
    pydfo.Parameter("qt.a2", 3e-6, 2e-6, 4e-6),
]
calibration = pydfo.Calibration("quad_tank.fmu", "quad_tank.csv", outputs, parameters, inputs=inputs)
