"""Compares the speed of warm simulations with FMPy, at equal outputs, times and errors.

    python benches/against_fmpy.py [--models furuta,...] [--rtol 1e-6] [--rounds 15] [--rows N] [--require 50]
    python benches/against_fmpy.py --peer-only --fmus FOLDER        FMPy's half alone, on FOLDER/<model>.fmu

Warm means that the FMU is unpacked, its library is loaded and its instance is reused on both sides (FMPy:
`fmu_instance`, `validate=False`, reset before each run). Both set equal parameters and return equal columns at equal
times. The error is the largest difference from a reference over all columns and times. The reference is a closed form
(bouncing ball), SciPy's DOP853 at 1e-13 (Van der Pol), FMPy at 1e-13 (Furuta), or our Radau5 at 1e-12 for models
driven by inputs, for which FMPy fails at tight tolerances. FMPy runs twice. The first run uses our relative
tolerance. The second run ("equal error") uses the tolerance, in half decades, with the smallest error that is at
least ours. If no tolerance is that loose, it uses ours. Single calls alternate, as a script makes them between other
work; times are medians. `cost()` is the native path of a calibration: one simulation and its sum of squares, without
a trajectory. The last line is the time outside a model with 24 event indicators.
"""

import argparse
import importlib.metadata
import math
import platform
import shutil
import statistics
import sys
import tempfile
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path
from collections.abc import Callable

import fmpy
import numpy as np

TURN = 0.1
LADDER = [10 ** (-k / 2) for k in range(6, 25)]  # 1e-3 ... 1e-12


@dataclass
class Case:
    """A model with its arguments, outputs and reference. `parameters` maps names to values."""

    model: str
    stop: float
    rows: int
    outputs: list[str]
    parameters: dict[str, float]
    truth: Callable[["Case", np.ndarray], np.ndarray] | None  # rows of outputs at the times; None: FMPy at 1e-13
    inputs: dict[str, np.ndarray] | None = None  # a column "time" and one per input

    def table(self) -> np.ndarray | None:
        """Returns the inputs in the form of FMPy."""
        if self.inputs is None:
            return None
        return np.array(list(zip(*self.inputs.values())), dtype=[(name, float) for name in self.inputs])

    def times(self) -> np.ndarray:
        return np.arange(self.rows) * (self.stop / (self.rows - 1))


def bouncing_ball(case: Case, times: np.ndarray) -> np.ndarray:
    """Returns the height of the ball, parabola by parabola."""
    a, e, v_min = 9.81, case.parameters["e"], 0.1
    begin, v, h = 0.0, 0.0, np.zeros_like(times)
    duration, start = math.sqrt(2 / a), 1.0
    while True:
        inside = (times >= begin) & (times < begin + duration)
        s = times[inside] - begin
        h[inside] = start + v * s - a / 2 * s * s
        v = e * (a * duration - v)
        begin, start = begin + duration, 0.0
        if v < v_min:
            return h[np.newaxis]
        duration = 2 * v / a


def dahlquist(case: Case, times: np.ndarray) -> np.ndarray:
    """Returns the exponential solution."""
    return np.exp(-case.parameters["k"] * times)[np.newaxis]


def van_der_pol(case: Case, times: np.ndarray) -> np.ndarray:
    from scipy.integrate import solve_ivp

    mu = case.parameters["mu"]
    result = solve_ivp(
        lambda t, x: [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]],
        (0, times[-1]), [2, 0], "DOP853", times, rtol=1e-13, atol=1e-14,
    )  # fmt: skip
    return result.y


def tightest(case: Case, times: np.ndarray) -> np.ndarray:
    """Returns the solution of our Radau5 at 1e-12, which stops at the kinks of inputs.

    CVode integrates across the kinks and is less accurate at every tolerance."""
    import pydfo

    model = pydfo.FMUModel(pydfo.example_fmu(case.model))
    for name, value in case.parameters.items():
        model.set(name, value)
    result = model.simulate(
        0, case.stop, times=times, input=case.inputs, output=case.outputs, relative_tolerance=1e-12, solver="radau5"
    )
    return np.stack([result[name] for name in case.outputs])


def recorded_voltages() -> dict[str, np.ndarray]:
    path = Path(__file__).resolve().parent.parent / "examples" / "data" / "quad_tank.csv"
    data = np.genfromtxt(path, delimiter=",", names=True)
    return {name: data[name] for name in ("time", "u1", "u2")}


def drive_cycle() -> dict[str, np.ndarray]:
    """Returns the inputs of examples/exhaust.py: a load that rises and falls in ramps moves all of them."""
    time = np.arange(301.0)
    load = np.interp(time, [0, 20, 50, 90, 120, 160, 200, 230, 300], [0.1, 0.1, 0.6, 0.4, 0.9, 0.2, 0.7, 0.3, 0.5])
    moved = {"T_in": 450 + 450 * load, "p_in": 1.1e5 + 1.2e5 * load}
    turbines = {"w_turb1": 2000 + 4000 * load, "w_turb2": 1500 + 3500 * load}
    return {"time": time, **moved, **turbines, "p_out": np.full_like(time, 1.013e5)}


CASES = [
    Case("furuta", 40.0, 801, ["armJoint.phi", "pendulumJoint.phi"],
         {"armFriction": 0.012, "pendulumFriction": 0.002}, None),
    Case("van_der_pol", 20.0, 401, ["x0", "x1"], {"mu": 1.0}, van_der_pol),
    Case("dahlquist", 10.0, 101, ["x"], {"k": 1.0}, dahlquist),
    Case("bouncing_ball", 3.0, 301, ["h"], {"e": 0.7}, bouncing_ball),
    Case("quad_tank", 60.0, 61, ["qt.x1", "qt.x2"], {"qt.a1": 2.66e-6, "qt.a2": 2.71e-6}, tightest, recorded_voltages()),
    Case("exhaust", 300.0, 301, ["T_out"], {"C1": 2500.0, "G1": 120.0}, tightest, drive_cycle()),
]  # fmt: skip


class Peer:
    """FMPy, with all reusable objects kept."""

    def __init__(self, case: Case, path: Path, scratch: Path):
        self.case, self.table, self.folder = case, case.table(), str(scratch / f"{case.model}-unpacked")
        fmpy.extract(path, self.folder)
        self.description = fmpy.read_model_description(self.folder)
        self.instance = fmpy.instantiate_fmu(self.folder, self.description, "ModelExchange")

    def run(self, rtol: float) -> np.ndarray:
        self.instance.reset()
        result = fmpy.simulate_fmu(
            self.folder, validate=False, start_time=0.0, stop_time=self.case.stop, solver="CVode",
            relative_tolerance=rtol, output_interval=self.case.stop / (self.case.rows - 1), record_events=False,
            fmi_type="ModelExchange", start_values=self.case.parameters, input=self.table, output=self.case.outputs,
            model_description=self.description, fmu_instance=self.instance,
        )  # fmt: skip
        return np.stack([result[name] for name in self.case.outputs])

    def close(self):
        self.instance.freeInstance()


class Ours:
    """pydfo: a model that is simulated repeatedly, and the cost of a calibration."""

    def __init__(self, case: Case, path: Path, truth: np.ndarray, rtol: float):
        import pydfo

        self.case, self.times = case, case.times()
        self.model = pydfo.FMUModel(path)
        columns = {f"y{i}": values for i, values in enumerate(truth)}
        self.calibration = pydfo.Calibration(
            path,
            data={**(case.inputs or {}), "time": self.times, **columns},
            inputs=[name for name in case.inputs or {} if name != "time"],
            outputs=dict(zip(case.outputs, columns)),
            parameters=[pydfo.Parameter(name, value, 0, 2 * value) for name, value in case.parameters.items()],
            relative_tolerance=rtol,
        )
        self.x = np.array(list(case.parameters.values()))
        self.calls = 0

    def run(self, rtol: float) -> np.ndarray:
        for name, value in self.case.parameters.items():
            self.model.set(name, value)
        result = self.model.simulate(
            final_time=self.case.stop, times=self.times, input=self.case.inputs, output=self.case.outputs,
            relative_tolerance=rtol,
        )
        return np.stack([result[name] for name in self.case.outputs])

    def cost(self) -> float:
        self.calls += 1  # a new point each time, so that no result can be cached
        return self.calibration.cost(self.x * (1 - 1e-13 * self.calls))


def with_binary(path: Path, scratch: Path) -> Path:
    """Returns the FMU if it has binaries, otherwise one built from its sources, because FMPy does not compile."""
    with zipfile.ZipFile(path) as archive:
        if any(name.startswith("binaries/") for name in archive.namelist()):
            return path
        archive.extractall(scratch / path.stem)
    import pydfo

    out = scratch / path.name
    pydfo.build_fmu(scratch / path.stem, out)
    return out


def distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max())


def equal_error(peer: Peer, truth: np.ndarray, error: float, rtol: float) -> float:
    """Returns FMPy's tolerance with the smallest error that is at least `error`."""
    errors = []
    for candidate in LADDER:
        try:
            errors.append((distance(peer.run(candidate), truth), candidate))
        except RuntimeError as failed:  # CVode fails at kinks of inputs at some tolerances
            print(f"  (FMPy at rtol {candidate:.1e}: {str(failed)[:21]})")
    return min((found for found in errors if found[0] >= error), default=(0.0, rtol))[1]


def alternate(contestants: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Returns the median time of a call of each contestant in seconds.

    Calls alternate for `TURN` seconds per round and contestant. The first round does not count."""
    taken: dict[str, list[float]] = {name: [] for name in contestants}
    counts_from = time.perf_counter() + TURN * len(contestants)
    ends_at = counts_from + TURN * len(contestants) * rounds
    while (begin := time.perf_counter()) < ends_at or not all(taken.values()):
        for name, run in contestants.items():
            start = time.perf_counter()
            run()
            if begin >= counts_from:
                taken[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in taken.items()}


def with_indicators(scratch: Path) -> Path:
    """Builds Van der Pol's oscillator with 24 event indicators that never cross zero, and sines for 0.5 us in each
    evaluation."""
    import pydfo

    folder = scratch / "indicators"
    with zipfile.ZipFile(pydfo.example_fmu("van_der_pol")) as archive:
        names = [name for name in archive.namelist() if not name.startswith("binaries/")]
        archive.extractall(folder, names)
    replaced = {
        "sources/model.c": [
            ('#include "model.h"', '#include "model.h"\n#include <math.h>'),
            ("    double mu;\n", "    double mu;\n    double indicators[24];\n"),
            (
                "    return MODEL_OK;",
                "    double load = x0;\n    for (int i = 0; i < 48; i++) {\n        load = sin(load + i);\n    }\n"
                "    for (int i = 0; i < 24; i++) {\n        memory->indicators[i] = 100 + i + x0 + 1e-9 * load;\n    }\n"
                "    return MODEL_OK;",
            ),
            (".n_states = 2,", ".n_states = 2,\n    .indicators = AT(indicators),\n    .n_indicators = 24,"),
        ],
        "modelDescription.xml": [('numberOfEventIndicators="0"', 'numberOfEventIndicators="24"')],
    }
    for name, pairs in replaced.items():
        text = (folder / name).read_text()
        for old, new in pairs:
            assert text.count(old) == 1, (name, old)
            text = text.replace(old, new)
        (folder / name).write_text(text)
    pydfo.build_fmu(folder, scratch / "indicators.fmu")
    return scratch / "indicators.fmu"


def beside_the_model(scratch: Path, rounds: int) -> float:
    """Prints and returns the time outside the model with 24 indicators as a fraction of the time inside."""
    import pydfo

    model = pydfo.FMUModel(with_indicators(scratch))
    times = np.linspace(0.0, 20.0, 401)
    shares, calls = [], []
    for _ in range(50 * rounds):
        stats = model.simulate(final_time=20, times=times, output=["x0", "x1"]).stats
        shares.append(stats.seconds / stats.seconds_in_model - 1)
        calls.append(1e6 * stats.seconds_in_model / (stats.right_hand_sides + stats.event_indicators))
    share = statistics.median(shares)
    print(
        f"\n24 event indicators, {statistics.median(calls):.2f} us per evaluation: time outside of the model is "
        f"{100 * share:.0f} % of that inside (at most 40 % are allowed)"
    )
    return share


def bench(case: Case, path: Path, arguments: argparse.Namespace, scratch: Path) -> float:
    """Prints the lines of a model and returns the ratio at equal error (infinite if only the peer ran)."""
    peer = Peer(case, with_binary(path, scratch), scratch)
    truth = peer.run(1e-13) if case.truth is None else case.truth(case, case.times())
    rtol, ours = arguments.rtol, None
    contestants: dict[str, Callable[[], object]] = {}
    errors, tolerances = {}, {}
    try:
        errors["FMPy, our tolerance"], tolerances["FMPy, our tolerance"] = distance(peer.run(rtol), truth), rtol
        contestants["FMPy, our tolerance"] = lambda: peer.run(rtol)
    except RuntimeError as failed:
        print(f"  (FMPy at rtol {rtol:.1e}: {str(failed)[:21]})")
    if not arguments.peer_only:
        ours = Ours(case, path, truth, rtol)
        errors["pydfo simulate"], tolerances["pydfo simulate"] = distance(ours.run(rtol), truth), rtol
        matched = equal_error(peer, truth, errors["pydfo simulate"], rtol)
        errors["FMPy, equal error"], tolerances["FMPy, equal error"] = distance(peer.run(matched), truth), matched
        contestants["FMPy, equal error"] = lambda: peer.run(matched)
        contestants["pydfo simulate"] = lambda: ours.run(rtol)
        contestants["pydfo cost()"] = ours.cost
    taken = alternate(contestants, arguments.rounds)
    base = taken.get("pydfo simulate", math.nan)
    print(f"\n{case.model}: 0 to {case.stop:g} s, {case.rows} times, {', '.join(case.outputs)}")
    if case.truth is None and ours is not None:
        print(f"  (pydfo at 1e-11 is within {distance(ours.run(1e-11), truth):.1e} of the reference)")
    print(f"  {'':<22}{'rtol':>9}{'error':>10}{'median':>12}{'times pydfo simulate':>22}")
    for name, seconds in taken.items():
        rtol_text = f"{tolerances[name]:.1e}" if name in tolerances else ""
        error_text = f"{errors[name]:.1e}" if name in errors else ""
        print(f"  {name:<22}{rtol_text:>9}{error_text:>10}{seconds * 1e3:>9.3f} ms{seconds / base:>22.2f}")
    peer.close()
    return math.inf if ours is None else taken["FMPy, equal error"] / base


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", default=",".join(case.model for case in CASES))
    parser.add_argument("--rtol", type=float, default=1e-6, help="our relative tolerance")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--rows", type=int, help="number of output times, first and last included")
    parser.add_argument("--require", type=float, default=0.0, help="fail if a ratio at equal error is smaller")
    parser.add_argument("--peer-only", action="store_true")
    parser.add_argument("--fmus", type=Path, help="folder with <model>.fmu; default: the bundled examples")
    arguments = parser.parse_args()

    if not arguments.peer_only:
        global pydfo
        import pydfo

    versions = [f"Python {platform.python_version()}", f"FMPy {importlib.metadata.version('fmpy')}"]
    if not arguments.peer_only:
        versions.append(f"pydfo {pydfo.__version__}")
    print(", ".join(versions), "on", platform.platform(), platform.machine())

    ratios = {}
    scratch = Path(tempfile.mkdtemp(prefix="against-fmpy-"))
    try:
        for case in CASES:
            if case.model not in arguments.models.split(","):
                continue
            if arguments.peer_only and case.truth is tightest:
                continue  # the reference would be our own result
            case.rows = arguments.rows or case.rows
            if arguments.fmus is not None:
                path = arguments.fmus / f"{case.model}.fmu"
            else:
                path = Path(pydfo.example_fmu(case.model))
            ratios[case.model] = bench(case, path, arguments, scratch)
        if not arguments.peer_only:
            beside_the_model(scratch, arguments.rounds)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    if not arguments.peer_only:
        path = pydfo.example_fmu("furuta")
        opened = alternate({"reopen": lambda: pydfo.FMUModel(path)}, arguments.rounds)["reopen"]
        print(f"\nopening an unchanged file again: {opened * 1e3:.3f} ms (at most 2 are allowed)")
    slow = {model: ratio for model, ratio in ratios.items() if ratio < arguments.require}
    for model, ratio in slow.items():
        print(f"{model}: {ratio:.1f} times, required are {arguments.require:g}", file=sys.stderr)
    return 1 if slow else 0


if __name__ == "__main__":
    sys.exit(main())
