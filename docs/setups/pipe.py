"""Calibration of the exhaust pipe that the guides use: four wall parameters, one measured temperature, five recorded inputs."""

import pydfo

outputs = ["T_out"]
inputs = ["T_in", "p_in", "w_turb1", "w_turb2", "p_out"]
parameters = [
    pydfo.Parameter("C1", 2500, 0.25, 50000),
    pydfo.Parameter("G1", 120, 0.012, 500),
    pydfo.Parameter("C2", 9000, 0.9, 50000),
    pydfo.Parameter("G2", 80, 0.008, 500),
]
calibration = pydfo.Calibration("exhaust.fmu", "exhaust.csv", outputs, parameters, inputs=inputs, window=(0, 500))
