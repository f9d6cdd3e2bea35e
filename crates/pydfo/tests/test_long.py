"""Tests that take minutes: many simulations from Python in constant memory. Run by `make test-long`."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from pydfo import FMUModel, example_fmu


def resident() -> int:
    """Returns the resident memory of this process in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) * 1024
    raise AssertionError("no VmRSS")


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_paper_cost_function_runs_in_constant_memory():
    path = example_fmu("furuta")

    def cost(k: int) -> None:
        model = FMUModel(path)
        model.set("armFriction", 0.008 + 1e-7 * (k % 1000))
        model.set("pendulumFriction", 0.001 + 1e-8 * (k % 997))
        assert len(model.simulate(final_time=40)["armJoint.phi"]) == 501

    calls = 20_000
    for k in range(calls // 10):
        cost(k)
    before = resident()
    for k in range(calls // 10, calls):
        cost(k)
    assert resident() - before < 2 << 20
