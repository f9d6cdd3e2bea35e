"""Memory of recordings: the memory of a calibration in addition to the given data."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from /proc")

PROGRAM = """
import numpy as np, sys
from pydfo import Calibration, Parameter, example_fmu

def status(key):
    return next(int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith(key))

def calibration(n, as_list):
    t = np.arange(n) * 1e-6
    data = {"time": t, "x": np.exp(-t), "w": np.ones(n)}
    if as_list:
        data = {name: values.tolist() for name, values in data.items()}
    before = status("VmRSS")
    open("/proc/self/clear_refs", "w").write("5")
    built = Calibration(example_fmu("dahlquist"), data, ["x"], [Parameter("k", 1.5, 0.1, 10.0)], weights={"x": "w"})
    return built, status("VmHWM") - before

calibration(100, False)
_, peak = calibration(3_000_000, sys.argv[1] == "lists")
print(peak / 72e6)
"""


@pytest.mark.parametrize("shape", ["arrays", "lists"])
def test_calibration_uses_at_most_three_times_its_columns(shape):
    program = textwrap.dedent(PROGRAM)
    done = subprocess.run([sys.executable, "-c", program, shape], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 3.2
