"""How much sooner is a fit done than with FMPy and SciPy? Each in a process of its own, opening the FMU included.

    python benches/against_fmpy_fit.py [--models van_der_pol,furuta] [--rtol 1e-6] [--rounds 5] [--cpu] [--require 100,30]

Three parameters are fitted to a recording that our Radau5 makes at 1e-12 with known values and noise of a known seed. All sides
simulate at the same relative tolerance, from the same start, with parameters in units of their sizes. FMPy keeps what it lets one
keep (the unpacked FMU, the description, one instance that is reset), simulates with CVode, and is driven by SciPy's Nelder-Mead, and
by SciPy's `least_squares` with forward differences of several relative steps, of which the fastest counts.

The time runs from the path of the FMU to the first evaluation whose cost is within 1e-6 of the best that simulations of the same
tool reach in any of their runs: every tool is judged by its own simulations. Modules are imported before. A run that ends without
having come so far counts with its whole time, marked ">". `--cpu` takes the time of the processor, of all threads, where other
work shares the machine.
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

#: A cost so near to the best is as good.
WITHIN = 1e-6
#: Relative steps of the differences; None is SciPy's own.
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

    def column(self, k: int) -> np.ndarray:
        return np.array([values[k] for values in self.parameters.values()])

    def times(self) -> np.ndarray:
        return np.arange(self.rows) * (self.stop / (self.rows - 1))


CASES = {
    case.model: case
    for case in (
        Case("van_der_pol", 20.0, 401, ["x0", "x1"], 0.05, {"mu": (1.3, 1, 1), "x0": (1.8, 2, 1), "x1": (0.3, 0, 1)}),
        Case(
            "furuta", 40.0, 801, ["armJoint.phi", "pendulumJoint.phi"], 0.02,
            {"armFriction": (0.010, 0.012, 0.012), "pendulumFriction": (0.001, 0.002, 0.002), "arm.inertia": (0.0011, 0.001, 0.001)},
        ),
    )
}  # fmt: skip


class Reached(Exception):
    """The cost is as good as the best."""


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
        self.instance.reset()
        result = self.fmpy.simulate_fmu(
            self.folder, validate=False, start_time=0.0, stop_time=self.case.stop, solver="CVode",
            relative_tolerance=self.rtol, output_interval=self.case.stop / (self.case.rows - 1), record_events=False,
            fmi_type="ModelExchange", start_values=dict(zip(self.case.parameters, z * self.case.column(2))),
            output=self.case.outputs, model_description=self.description, fmu_instance=self.instance,
        )  # fmt: skip
        residuals = np.concatenate([result[name] for name in self.case.outputs]) - self.data.ravel()
        self.best = min(self.best, float(residuals @ residuals))
        if self.best <= self.target:
            raise Reached
        return residuals

    def cost(self, z: np.ndarray) -> float:
        residuals = self.residuals(z)
        return float(residuals @ residuals)

    def close(self) -> None:
        self.instance.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


def by_fmpy(clock, case: Case, path: Path, data: np.ndarray, rtol: float, target: float, step: float | None, simplex: bool):
    import fmpy  # noqa: F401  (before the clock)
    from scipy.optimize import least_squares, minimize

    begin = clock()
    peer = Peer(case, path, data, rtol, target)
    start = case.column(1) / case.column(2)
    try:
        if simplex:
            minimize(peer.cost, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "maxfev": 2000})
        else:
            least_squares(peer.residuals, start, diff_step=step, xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=100)
    except Reached:
        pass
    taken = clock() - begin
    peer.close()
    return taken, peer.best, peer.calls


def by_pydfo(clock, case: Case, path: Path, data: np.ndarray, rtol: float, target: float, method: str):
    import numpy.ma  # noqa: F401  (NumPy loads it at its first use)
    from pydfo import Calibration, Parameter

    columns = {f"y{i}": values for i, values in enumerate(data)}
    begin = clock()
    calibration = Calibration(
        path,
        data={"time": case.times(), **columns},
        outputs=dict(zip(case.outputs, columns)),
        parameters=[Parameter(name, start, nominal=size) for name, (_, start, size) in case.parameters.items()],
        relative_tolerance=rtol,
    )
    fit = calibration.fit(method, target=target, x_tol=1e-6, f_tol=1e-9)
    return clock() - begin, fit.cost, fit.nfev


def alone(function, *arguments):
    """The call in a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def recording(case: Case, path: Path) -> np.ndarray:
    """What is fitted: truth and noise, a row for each output."""
    import pydfo

    model = pydfo.FMUModel(path)
    model.set(list(case.parameters), case.column(0).tolist())
    result = model.simulate(0, case.stop, times=case.times(), outputs=case.outputs, relative_tolerance=1e-12, solver="radau5")
    truth = np.stack([result[name] for name in case.outputs])
    return truth + np.random.default_rng(2012).normal(0.0, case.noise, truth.shape)


def bench(case: Case, path: Path, rtol: float, rounds: int, clock) -> dict[str, float]:
    """Prints the lines of a model; how many times longer each of FMPy's runs takes."""
    data = recording(case, path)
    setup = (clock, case, path, data, rtol)
    ours = {"pydfo, least squares": (by_pydfo, "least-squares"), "pydfo, Nelder-Mead": (by_pydfo, "nelder-mead")}
    peers = {f"FMPy, least_squares, step {step or 'default'}": (by_fmpy, step, False) for step in STEPS}
    peers["FMPy, Nelder-Mead"] = (by_fmpy, None, True)
    targets = {}
    for runs in (ours, peers):
        ends = {name: alone(function, *setup, -np.inf, *how) for name, (function, *how) in runs.items()}
        best = min(cost for _, cost, _ in ends.values())
        targets |= dict.fromkeys(runs, best * (1 + WITHIN))
    print(f"\n{case.model}: {', '.join(case.parameters)}, {data.size} residuals")
    print(f"  {'':<38}{'seconds':>10}{'evaluations':>13}{'times ours':>12}")
    medians: dict[str, float] = {}
    never = set()
    for name, (function, *how) in (ours | peers).items():
        runs = [alone(function, *setup, targets[name], *how) for _ in range(rounds)]
        medians[name] = statistics.median(seconds for seconds, _, _ in runs)
        _, cost, calls = runs[0]
        if cost > targets[name]:
            never.add(name)
        mark = ">" if name in never else ""
        ratio = medians[name] / medians["pydfo, least squares"]
        print(f"  {name:<38}{mark + f'{medians[name]:.4f}':>10}{calls:>13}{ratio:>12.1f}")
    base = medians["pydfo, least squares"]
    reached = [seconds for name, seconds in medians.items() if "least_squares" in name and name not in never]
    fastest = min(reached, default=np.inf)
    return {"Nelder-Mead": medians["FMPy, Nelder-Mead"] / base, "least_squares": fastest / base}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", default=",".join(CASES))
    parser.add_argument("--rtol", type=float, default=1e-6)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cpu", action="store_true", help="time of the processor instead of the clock on the wall")
    parser.add_argument("--require", default="0,0", help="fail if FMPy with Nelder-Mead, least_squares takes less than so many times")
    arguments = parser.parse_args()
    import pydfo

    names = ("fmpy", "scipy", "fmufit-pydfo")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names[:2])
    print(f"Python {platform.python_version()}, {versions}, pydfo {pydfo.__version__} on {platform.platform()} {platform.machine()}")
    required = dict(zip(("Nelder-Mead", "least_squares"), map(float, arguments.require.split(","))))
    missed = []
    scratch = Path(tempfile.mkdtemp(prefix="against-fmpy-fit-"))
    try:
        for model in arguments.models.split(","):
            path = with_binary(Path(pydfo.example_fmu(model)), scratch)
            ratios = bench(CASES[model], path, arguments.rtol, arguments.rounds, time.process_time if arguments.cpu else time.perf_counter)
            missed += [f"{model}: {r:.1f} times FMPy with {how}" for how, r in ratios.items() if r < required[how]]
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    for line in missed:
        print(line, file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
