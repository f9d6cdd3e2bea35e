"""Measures the cost of a fit outside its search, in right-hand sides and seconds, phase by phase.

    python benches/whole_fits.py [--models van_der_pol,...] [--rounds 5] [--check]

Whole fits with one worker: bundled models with their recordings, and small models (`small_models.py`) fitted to noisy
simulations, several starts each. A line shows for each fit the evaluations of its search, and the simulations and
right-hand sides of the search, of the standard errors and of everything else. Everything else includes the fresh
process and the tests of resets, which `check_right_hand_sides` counts. The line also shows the wall-clock times of
all phases (medians). "/search" divides everything else by the search. "sims" expresses it in mean simulations of the
search. `--check` fails if a limit is exceeded: standard errors at most two simulations for each parameter, everything
else at most 0.3 of the search and 4 simulations. The last line is the median of the whole time divided by the time of
search and standard errors.
"""

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import pydfo
from small_models import MODELS, build

DATA = Path(__file__).resolve().parents[1] / "examples" / "data"
#: Phases of the fit itself; all others are additional.
OWN = ("search", "uncertainty")


@dataclass
class Case:
    """A fit: a function that creates its calibration, and the starts."""

    name: str
    calibration: Callable[[Path], pydfo.Calibration]
    starts: list[dict[str, float]]
    options: dict = field(default_factory=dict)


def noisy(path: Path, truth: dict[str, float], times: np.ndarray, outputs: list[str], noise: float, seed: int = 1) -> dict[str, np.ndarray]:
    """Returns a recording of a model with these parameters."""
    model = pydfo.FMUModel(path)
    model.set(list(truth), list(truth.values()))
    result = model.simulate(times[0], times[-1], times=times, outputs=outputs, relative_tolerance=1e-11)
    random = np.random.default_rng(seed)
    return {"time": times} | {name: result[name] + noise * random.normal(size=len(times)) for name in outputs}


def small(name: str, outputs: list[str], truth: dict[str, float], starts: list[dict[str, float]], rows: int, noise: float, **settings):
    """Returns a fit of a small or a bundled model to a noisy simulation; all parameters are positive or free."""

    def calibration(folder: Path) -> pydfo.Calibration:
        path = build(name, folder) if name in MODELS else Path(pydfo.example_fmu(name))
        stop = MODELS[name].stop if name in MODELS else settings.get("stop", 10.0)
        data = noisy(path, truth, np.linspace(0.0, stop, rows), outputs, noise)
        parameters = [pydfo.Parameter(key, value, nominal=abs(value) or 1.0) for key, value in starts[0].items()]
        return pydfo.Calibration(path, data=data, outputs=outputs, parameters=parameters)

    return Case(name, calibration, starts)


def furuta(folder: Path) -> pydfo.Calibration:
    nominal = {"armFriction": 0.012, "pendulumFriction": 0.002}
    return pydfo.Calibration(
        pydfo.example_fmu("furuta"),
        data=DATA / "furuta.csv",
        outputs={"armJoint.phi": "phi", "pendulumJoint.phi": "theta"},
        parameters=[pydfo.Parameter(name, start, 0.0, start + 0.01) for name, start in nominal.items()],
    )


def quad_tank(outlets: list[int]) -> Callable[[Path], pydfo.Calibration]:
    return lambda folder: pydfo.Calibration(
        pydfo.example_fmu("quad_tank"),
        data=DATA / "quad_tank.csv",
        inputs=["u1", "u2"],
        outputs={f"qt.x{i}": f"x{i}" for i in outlets},
        parameters=[pydfo.Parameter(f"qt.a{i}", 3e-6, 2e-6, 4e-6) for i in outlets],
    )


def exhaust(names: list[str]) -> Callable[[Path], pydfo.Calibration]:
    nominal = {"C1": 2500.0, "G1": 120.0, "C2": 9000.0, "G2": 80.0}
    largest = {"C": 5e4, "G": 500.0}
    return lambda folder: pydfo.Calibration(
        pydfo.example_fmu("exhaust"),
        data=DATA / "exhaust.csv",
        inputs=["T_in", "p_in", "w_turb1", "w_turb2", "p_out"],
        outputs=["T_out"],
        window=(0, 500),
        parameters=[pydfo.Parameter(name, nominal[name], 1e-4 * nominal[name], largest[name[0]]) for name in names],
    )


def points(names: str, *values: tuple[float, ...]) -> list[dict[str, float]]:
    return [dict(zip(names.split(), value)) for value in values]


CASES = [
    small("van_der_pol", ["x0", "x1"], dict(mu=1.7, x0=1.5, x1=0.5), points("mu x0 x1", (1, 2, 0), (3, 1, 1), (1.5, 1.4, 0.4)), 401, 0.05, stop=20.0),
    small("dahlquist", ["x"], dict(k=1.3), points("k", (1.0,), (3.0,), (0.2,)), 101, 0.01, stop=5.0),
    Case("furuta", furuta, points("armFriction pendulumFriction", (0.012, 0.002), (0.008, 0.0005), (0.015, 0.004))),
    Case("quad_tank 2", quad_tank([1, 2]), [{}]),
    Case("quad_tank 4", quad_tank([1, 2, 3, 4]), [{}]),
    Case("exhaust 2", exhaust(["C2", "G2"]), [{}]),
    Case("exhaust 4", exhaust(["C1", "G1", "C2", "G2"]), [{}]),
    small("spring_pendulum", ["r", "phi"], dict(k=45.0, l0=0.95, d=0.15), points("k l0 d", (40, 1, 0.1), (50, 0.9, 0.3), (43, 1.02, 0.05)),
          201, 0.01),
    small("friction_pendulum", ["phi"], dict(mu=0.4, c=0.08, g_l=9.5), points("mu c g_l", (0.3, 0.05, 9.81), (0.5, 0.02, 9.3), (0.2, 0.1, 9.7)),
          301, 0.01),
    small("lotka_volterra", ["prey", "predators"], dict(a=1.2, b=0.35, c=0.12), points("a b c", (1.1, 0.4, 0.1), (1.0, 0.3, 0.15)), 61, 0.3),
    small("one_compartment", ["blood"], dict(ka=1.5, ke=0.25, V=15.0), points("ka ke V", (1.0, 0.2, 20.0), (3.0, 0.1, 10.0)), 25, 0.05),
    small("robertson", ["A", "C"], dict(k1=0.05, k3=1.2e4), points("k1 k3", (0.04, 1e4), (0.1, 5e3)), 101, 0.005),
]  # fmt: skip


def fits(cases: list[Case], rounds: int, folder: Path) -> Iterator[tuple[str, list[tuple[float, pydfo.Fit]]]]:
    """Yields each fit of each case, repeated with separate calibrations: wall-clock seconds and the result."""
    for case in cases:
        for start in case.starts:
            runs = []
            for _ in range(rounds):
                calibration = case.calibration(folder)
                begin = time.perf_counter()
                fit = calibration.fit(start=start or None, workers=1, **case.options)
                runs.append((time.perf_counter() - begin, fit))
            yield f"{case.name} {', '.join(f'{value:g}' for value in start.values())}", runs


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", default="", help="beginnings of names, separated by commas; default: all")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    wanted = tuple(arguments.models.split(","))
    cases = [case for case in CASES if case.name.startswith(wanted)]
    clock, missed = [], []
    print(f"{'fit':<40}{'nfev':>5}{'search':>16}{'errors':>14}{'else':>14}{'/search':>8}{'sims':>6}  checks  phases in ms")
    with tempfile.TemporaryDirectory(prefix="whole-fits-") as scratch:
        for name, runs in fits(cases, arguments.rounds, Path(scratch)):
            fit = runs[0][1]
            phases = fit.stats.phases
            counts = {key: (phase["simulations"], phase["right_hand_sides"]) for key, phase in phases.items()}
            search, errors = counts["search"], counts.get("uncertainty", (0, 0))
            rest = [sum(count[k] for key, count in counts.items() if key not in OWN) for k in (0, 1)]
            rest[1] += fit.stats.check_right_hand_sides
            n = sum(np.isfinite(fit.stderr) & (fit.stderr > 0)) if fit.stderr is not None else 0
            mean = search[1] / max(search[0], 1)
            times = {key: statistics.median(run.stats.phases.get(key, {"seconds": 0.0})["seconds"] for _, run in runs) for key in phases}
            whole = statistics.median(seconds for seconds, _ in runs)
            clock.append(whole / sum(times.get(key, 0.0) for key in OWN))
            share, sims = rest[1] / search[1], rest[1] / mean
            shown = " ".join(f"{key} {1e3 * seconds:.1f}" for key, seconds in times.items())
            show = lambda count: f"{count[0]}/{count[1]}"  # noqa: E731
            print(
                f"{name:<40}{fit.nfev:>5}{show(search):>16}{show(errors):>14}{show(rest):>14}{share:>8.2f}{sims:>6.1f}"
                f"  {fit.stats.check_runs}/{fit.stats.check_right_hand_sides}  whole {1e3 * whole:.1f} ({clock[-1]:.2f}) {shown}"
                f" skipped {len(fit.skipped)} {fit.solver}"
            )
            if share > 0.3 or sims > 4 or errors[0] > 2 * n:
                missed.append(f"{name}: {share:.2f} of the search, {sims:.1f} simulations; standard errors {errors[0]} for {n}")
    print(f"\n{len(clock)} fits; whole time over search and standard errors: median {statistics.median(clock):.2f}")
    for line in missed:
        print(line)
    return 1 if missed and arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
