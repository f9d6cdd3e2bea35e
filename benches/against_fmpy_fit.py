"""Compares the time of whole fits with FMPy and SciPy, each in a separate process that also opens the FMU.

    python benches/against_fmpy_fit.py [--models van_der_pol,furuta,...] [--rtol 1e-6] [--rounds 1] [--require 100,15]

Parameters are fitted to a recording from our Radau5 at 1e-12 with known values and seeded noise, from five starts.
All sides simulate at equal relative tolerances, from equal starts, with parameters in units of their sizes. FMPy
keeps all reusable objects (the unpacked FMU, the description, one instance that is reset) and simulates with CVode.
The optimisers are SciPy's Nelder-Mead, and SciPy's `least_squares` with forward differences of several relative
steps.

The time runs from the path of the FMU to the returned result: here with standard errors and findings, there without.
Modules are imported before. Every tool ends by its own defaults, except that Nelder-Mead may use 2000 evaluations. A
run whose cost is more than 1 % above the lowest of all tools is marked "!". Times are medians over the starts. For
`least_squares`, the step counts that is the fastest of those with the lowest cost from most starts.
"""

import argparse
import importlib.metadata
import multiprocessing
import platform
import shutil
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from against_fmpy import with_binary
from small_models import MODELS, build

#: Relative difference from the best cost of a tool that counts as equal, for the time to reach it.
WITHIN = 1e-6
#: A run that ends higher than this fraction above the lowest cost of all tools is marked.
ENDED = 0.01
#: Residuals of a failed simulation of FMPy.
FAILED = 1e3
#: Relative steps of the differences; None is SciPy's default.
STEPS = (None, 1e-6, 1e-4, 1e-3, 1e-2)


@dataclass
class Case:
    """A model with parameters: name -> (true value, start, size)."""

    model: str
    stop: float
    rows: int
    outputs: list[str]
    noise: float
    parameters: dict[str, tuple[float, float, float]]
    #: Starts of whole fits, in the order of the parameters; the first one is the start of `parameters`.
    starts: list[tuple[float, ...]]

    def column(self, k: int) -> np.ndarray:
        return np.array([values[k] for values in self.parameters.values()])

    def times(self) -> np.ndarray:
        return np.arange(self.rows) * (self.stop / (self.rows - 1))


CASES = {
    case.model: case
    for case in (
        Case(
            "van_der_pol", 20.0, 401, ["x0", "x1"], 0.05, {"mu": (1.3, 1, 1), "x0": (1.8, 2, 1), "x1": (0.3, 0, 1)},
            [(1, 2, 0), (3, 1, 1), (1.5, 1.4, 0.4), (0.8, 2.2, -0.3), (2, 1.5, 0.5)],
        ),
        Case(
            "furuta", 40.0, 801, ["armJoint.phi", "pendulumJoint.phi"], 0.02,
            {"armFriction": (0.010, 0.012, 0.012), "pendulumFriction": (0.001, 0.002, 0.002), "arm.inertia": (0.0011, 0.001, 0.001)},
            [(0.012, 0.002, 0.001), (0.008, 0.0005, 0.0011), (0.015, 0.002, 0.0012), (0.011, 0.0015, 0.00105), (0.009, 0.0012, 0.001)],
        ),
        Case(
            "spring_pendulum", 10.0, 201, ["r", "phi"], 0.01, {"k": (45.0, 40, 40), "l0": (0.95, 1, 1), "d": (0.15, 0.1, 0.1)},
            [(40, 1, 0.1), (50, 0.9, 0.3), (43, 1.02, 0.05), (47, 0.93, 0.2), (41, 0.97, 0.12)],
        ),
        Case(
            "friction_pendulum", 10.0, 301, ["phi"], 0.01, {"mu": (0.4, 0.3, 0.3), "c": (0.08, 0.05, 0.05), "g_l": (9.5, 9.81, 10)},
            [(0.3, 0.05, 9.81), (0.5, 0.02, 9.3), (0.2, 0.1, 9.7), (0.35, 0.07, 9.4), (0.45, 0.1, 9.6)],
        ),
    )
}  # fmt: skip


class Reached(Exception):
    """The cost equals the best one within the tolerance."""


class Peer:
    """FMPy's simulations as residuals, with the time of each cost."""

    def __init__(self, case: Case, path: Path, data: np.ndarray, rtol: float, target: float):
        import fmpy

        self.fmpy, self.case, self.data, self.rtol, self.target = fmpy, case, data, rtol, target
        self.best, self.calls = np.inf, 0
        self.folder = fmpy.extract(path)
        self.description = fmpy.read_model_description(self.folder)
        self.instance = fmpy.instantiate_fmu(self.folder, self.description, "ModelExchange")

    def residuals(self, z: np.ndarray) -> np.ndarray:
        self.calls += 1
        try:
            residuals = self.simulated(z) - self.data.ravel()
        except RuntimeError:  # CVode failed
            residuals = np.full(self.data.size, FAILED)
        self.best = min(self.best, float(residuals @ residuals))
        if self.best <= self.target:
            raise Reached
        return residuals

    def simulated(self, z: np.ndarray) -> np.ndarray:
        self.instance.reset()
        result = self.fmpy.simulate_fmu(
            self.folder, validate=False, start_time=0.0, stop_time=self.case.stop, solver="CVode",
            relative_tolerance=self.rtol, output_interval=self.case.stop / (self.case.rows - 1), record_events=False,
            fmi_type="ModelExchange", start_values=dict(zip(self.case.parameters, z * self.case.column(2))),
            output=self.case.outputs, model_description=self.description, fmu_instance=self.instance,
        )  # fmt: skip
        return np.concatenate([result[name] for name in self.case.outputs])

    def cost(self, z: np.ndarray) -> float:
        residuals = self.residuals(z)
        return float(residuals @ residuals)

    def close(self) -> None:
        self.instance.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


def by_fmpy(case: Case, path: Path, data: np.ndarray, rtol: float, start: tuple[float, ...], step: float | None, simplex: bool):
    """Returns seconds, cost and evaluations of a whole fit."""
    import fmpy  # noqa: F401  (before the clock)
    from scipy.optimize import least_squares, minimize

    begin = time.perf_counter()
    peer = Peer(case, path, data, rtol, -np.inf)
    z = np.array(start) / case.column(2)
    if simplex:
        cost = minimize(peer.cost, z, method="Nelder-Mead", options={"maxfev": 2000}).fun
    else:
        cost = 2 * least_squares(peer.residuals, z, diff_step=step).cost
    taken = time.perf_counter() - begin
    peer.close()
    return taken, cost, peer.calls


def by_pydfo(case: Case, path: Path, data: np.ndarray, rtol: float, start: tuple[float, ...], method: str):
    import numpy.ma  # noqa: F401  (NumPy loads it at its first use)
    from pydfo import Calibration, Parameter

    columns = {f"y{i}": values for i, values in enumerate(data)}
    begin = time.perf_counter()
    calibration = Calibration(
        path,
        data={"time": case.times(), **columns},
        outputs=dict(zip(case.outputs, columns)),
        parameters=[Parameter(name, x, nominal=size) for x, (name, (_, _, size)) in zip(start, case.parameters.items())],
        relative_tolerance=rtol,
    )
    fit = calibration.fit(method)
    return time.perf_counter() - begin, fit.cost, fit.nfev


def alone(function, *arguments):
    """Runs the call in a separate process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def recording(case: Case, path: Path) -> np.ndarray:
    """Returns the recording to fit: true values with noise, one row per output."""
    import pydfo

    model = pydfo.FMUModel(path)
    model.set(list(case.parameters), case.column(0).tolist())
    result = model.simulate(0, case.stop, times=case.times(), outputs=case.outputs, relative_tolerance=1e-12, solver="radau5")
    truth = np.stack([result[name] for name in case.outputs])
    return truth + np.random.default_rng(2012).normal(0.0, case.noise, truth.shape)


def bench(case: Case, path: Path, rtol: float, rounds: int) -> dict[str, float]:
    """Prints the lines of a model and returns how many times longer each whole fit of FMPy takes."""
    data = recording(case, path)
    ours = {"pydfo, least squares": (by_pydfo, "least-squares"), "pydfo, Nelder-Mead": (by_pydfo, "nelder-mead")}
    peers = {f"FMPy, least_squares, step {step or 'default'}": (by_fmpy, step, False) for step in STEPS}
    peers["FMPy, Nelder-Mead"] = (by_fmpy, None, True)
    runs = {
        name: [min(alone(function, case, path, data, rtol, start, *how) for _ in range(rounds)) for start in case.starts]
        for name, (function, *how) in (ours | peers).items()
    }
    lowest = min(cost for of_tool in runs.values() for _, cost, _ in of_tool)
    print(f"\n{case.model}: {', '.join(case.parameters)}, {data.size} residuals; ms of each start, ! ended more than 1 % above the lowest cost")
    medians, arrived = {}, {}
    for name, of_tool in runs.items():
        marks = ["!" if cost > lowest * (1 + ENDED) else "" for _, cost, _ in of_tool]
        medians[name] = statistics.median(seconds for seconds, _, _ in of_tool)
        arrived[name] = marks.count("")
        each = " ".join(f"{1e3 * seconds:.1f}{mark}" for (seconds, _, _), mark in zip(of_tool, marks))
        calls = statistics.median(calls for _, _, calls in of_tool)
        ratio = medians[name] / medians["pydfo, least squares"]
        print(f"  {name:<36}{1e3 * medians[name]:>9.1f} ms{calls:>6.0f} evaluations{ratio:>8.1f} times ours   ({each})")
    of_steps = [name for name in runs if "least_squares" in name]
    best = max(arrived[name] for name in of_steps)
    fastest = min(medians[name] for name in of_steps if arrived[name] == best)
    base = medians["pydfo, least squares"]
    return {"Nelder-Mead": medians["FMPy, Nelder-Mead"] / base, "least_squares": fastest / base}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", default=",".join(CASES))
    parser.add_argument("--rtol", type=float, default=1e-6)
    parser.add_argument("--rounds", type=int, default=1, help="times that each start is fitted; the shortest counts, on all sides")
    parser.add_argument("--require", default="0,0", help="fail if FMPy with Nelder-Mead, least_squares takes less than this multiple")
    arguments = parser.parse_args()
    import pydfo

    names = ("fmpy", "scipy", "fmufit")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names[:2])
    print(f"Python {platform.python_version()}, {versions}, pydfo {pydfo.__version__} on {platform.platform()} {platform.machine()}")
    required = dict(zip(("Nelder-Mead", "least_squares"), map(float, arguments.require.split(","))))
    missed = []
    scratch = Path(tempfile.mkdtemp(prefix="against-fmpy-fit-"))
    try:
        for model in arguments.models.split(","):
            path = build(model, scratch) if model in MODELS else with_binary(Path(pydfo.example_fmu(model)), scratch)
            ratios = bench(CASES[model], path, arguments.rtol, arguments.rounds)
            print(f"  FMPy over pydfo, least squares: {', '.join(f'{how} {ratio:.0f}' for how, ratio in ratios.items())}", flush=True)
            missed += [f"{model}: {r:.1f} times FMPy with {how}" for how, r in ratios.items() if r < required[how]]
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    for line in missed:
        print(line, file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
