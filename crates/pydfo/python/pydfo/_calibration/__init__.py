"""Calibration: recordings, parameters, experiments, fits and what follows from them."""
