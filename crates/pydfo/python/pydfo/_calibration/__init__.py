"""Calibration: recordings, parameters, experiments, fits and their evaluation."""
