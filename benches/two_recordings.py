"""Compares a fit to two recordings with FMPy and SciPy, each in a separate process that also opens the FMU.

    python benches/two_recordings.py [--rtol 1e-6] [--rounds 3] [--cpu] [--require 20]

The Furuta pendulum swings twice, from different angles with different speeds. Two frictions and an inertia are shared
by both recordings. Angle and speed of the pendulum at the start are local to each (seven numbers in all). The
recordings come from our Radau5 at 1e-12 with known values and seeded noise. Both sides use least squares, at equal
relative tolerances, from equal starts, with parameters in units of their sizes. As in `against_fmpy_fit.py`, FMPy
keeps all reusable objects. SciPy's forward differences use several relative steps, and the fastest counts. The time
runs to the first evaluation whose cost is within 1e-6 of the best cost of the same tool in any of its runs.
"""

import argparse
import importlib.metadata
import platform
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from against_fmpy import with_binary
from against_fmpy_fit import CASES, STEPS, WITHIN, Peer, Reached, alone

CASE = CASES["furuta"]
#: Local to each recording: true values, starts, sizes.
LOCAL = {"pendulumJoint.phi": ((0.50, 0.60), (0.52, 0.58), (1.0, 1.0)), "pendulumJoint.w": ((0.10, -0.10), (0.0, 0.0), (1.0, 1.0))}
RECORDINGS = 2


def parameters(k: int) -> np.ndarray:
    """Returns the shared parameters, then the local ones of each recording: true values (0), starts (1) or sizes
    (2)."""
    local = [[values[k][recording] for values in LOCAL.values()] for recording in range(RECORDINGS)]
    return np.concatenate([CASE.column(k), *local])


def values_of(x: np.ndarray, recording: int) -> dict[str, float]:
    """Returns the values set in a recording."""
    n = len(CASE.parameters)
    local = x[n + recording * len(LOCAL) : n + (recording + 1) * len(LOCAL)]
    return dict(zip([*CASE.parameters, *LOCAL], [*x[:n], *local]))


class PeerOfTwo(Peer):
    """FMPy's simulations of both recordings as residuals."""

    def residuals(self, z: np.ndarray) -> np.ndarray:
        self.calls += 1
        parts = []
        for recording in range(RECORDINGS):
            self.instance.reset()
            result = self.fmpy.simulate_fmu(
                self.folder, validate=False, start_time=0.0, stop_time=CASE.stop, solver="CVode",
                relative_tolerance=self.rtol, output_interval=CASE.stop / (CASE.rows - 1), record_events=False,
                fmi_type="ModelExchange", start_values=values_of(z * parameters(2), recording),
                output=CASE.outputs, model_description=self.description, fmu_instance=self.instance,
            )  # fmt: skip
            parts += [result[name] - self.data[recording][k] for k, name in enumerate(CASE.outputs)]
        residuals = np.concatenate(parts)
        self.best = min(self.best, float(residuals @ residuals))
        if self.best <= self.target:
            raise Reached
        return residuals


def by_fmpy(clock, path: Path, data: np.ndarray, rtol: float, target: float, step: float | None):
    import fmpy  # noqa: F401  (before the clock)
    from scipy.optimize import least_squares

    begin = clock()
    peer = PeerOfTwo(CASE, path, data, rtol, target)
    try:
        start = parameters(1) / parameters(2)
        least_squares(peer.residuals, start, diff_step=step, xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=60)
    except Reached:
        pass
    taken = clock() - begin
    peer.close()
    return taken, peer.best, peer.calls


def by_pydfo(clock, path: Path, data: np.ndarray, rtol: float, target: float, _: None):
    import numpy.ma  # noqa: F401  (NumPy loads it at its first use)
    import pydfo

    names = [f"y{i}" for i in range(len(CASE.outputs))]
    begin = clock()
    experiments = [
        pydfo.Experiment(
            {"time": CASE.times(), **dict(zip(names, data[recording]))},
            dict(zip(CASE.outputs, names)),
            start_values={name: values[1][recording] for name, values in LOCAL.items()},
        )
        for recording in range(RECORDINGS)
    ]
    shared = [pydfo.Parameter(name, start, nominal=size) for name, (_, start, size) in CASE.parameters.items()]
    local = [pydfo.Parameter(name, values[1][0], nominal=values[2][0], local=True) for name, values in LOCAL.items()]
    calibration = pydfo.Calibration(path, experiments, [*shared, *local], relative_tolerance=rtol)
    fit = calibration.fit("least-squares", target=target, x_tol=1e-6, f_tol=1e-9, covariance=None)
    return clock() - begin, fit.cost, fit.nfev


def recordings(path: Path) -> np.ndarray:
    """Returns the recordings to fit: true values with noise, one row per output for each recording."""
    import pydfo

    rng, rows = np.random.default_rng(2012), []
    for recording in range(RECORDINGS):
        model = pydfo.FMUModel(path)
        found = values_of(parameters(0), recording)
        model.set(list(found), list(found.values()))
        result = model.simulate(0, CASE.stop, times=CASE.times(), outputs=CASE.outputs, relative_tolerance=1e-12, solver="radau5")
        rows.append([result[name] + rng.normal(0.0, CASE.noise, CASE.rows) for name in CASE.outputs])
    return np.array(rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rtol", type=float, default=1e-6)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cpu", action="store_true", help="time of the processor instead of the clock on the wall")
    parser.add_argument("--require", type=float, default=0.0, help="fail if the fastest of FMPy's takes less than this multiple")
    arguments = parser.parse_args()
    import pydfo

    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("fmpy", "scipy"))
    print(f"Python {platform.python_version()}, {versions}, pydfo {pydfo.__version__} on {platform.platform()} {platform.machine()}")
    clock = time.process_time if arguments.cpu else time.perf_counter
    scratch = Path(tempfile.mkdtemp(prefix="two-recordings-"))
    try:
        path = with_binary(Path(pydfo.example_fmu(CASE.model)), scratch)
        setup = (clock, path, recordings(path), arguments.rtol)
        ours = {"pydfo, least squares": (by_pydfo, None)}
        peers = {f"FMPy, least_squares, step {step or 'default'}": (by_fmpy, step) for step in STEPS}
        targets = {}
        for runs in (ours, peers):
            ends = [alone(function, *setup, -np.inf, how) for function, how in runs.values()]
            targets |= dict.fromkeys(runs, min(cost for _, cost, _ in ends) * (1 + WITHIN))
        print(f"{RECORDINGS} recordings of {CASE.model}: {len(CASE.parameters)} shared and {len(LOCAL)} local parameters")
        print(f"  {'':<38}{'seconds':>10}{'cost':>14}{'evaluations':>13}{'times ours':>12}")
        base, fastest = np.inf, np.inf
        for name, (function, how) in (ours | peers).items():
            found = [alone(function, *setup, targets[name], how) for _ in range(arguments.rounds)]
            seconds, (_, cost, calls) = statistics.median(taken for taken, _, _ in found), found[0]
            has_reached = cost <= targets[name]
            if name in ours:
                base = seconds
            elif has_reached:
                fastest = min(fastest, seconds / base)
            mark = "" if has_reached else ">"
            print(f"  {name:<38}{mark + f'{seconds:.4f}':>10}{cost:>14.7g}{calls:>13}{seconds / base:>12.1f}")
        print(f"  the fastest of FMPy's that comes so far takes {fastest:.1f} times as long")
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return 0 if fastest >= arguments.require else 1


if __name__ == "__main__":
    sys.exit(main())
