"""Design of the PI controllers of the tank model: simulations until within 1 % of the best criterion.

The reference is a grid of controllers around the best design found. `Design.optimize` from several starts is compared with
SciPy's differential evolution on the same criteria (its constraint is a NonlinearConstraint) and with COBYLA, which starts
from the same points. All counts are evaluations, each of which simulates the scenario once. Run: python benches/design.py
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy import optimize

from pydfo import Design, Parameter, Scenario, example_fmu

LIMIT = 5.0  # overshoot in percent
CASES = {
    "one loop": (["K1", "T1"], [0.5, 5.0], [20.0, 200.0], {"r2": 12.783158403008972}, "itae(e1) + 2*energy(u1 - 3)", ["overshoot(x1, r1)"]),
    "two loops": (
        ["K1", "T1", "K2", "T2"],
        [0.5, 5.0, 0.5, 5.0],
        [20.0, 200.0, 20.0, 200.0],
        {},
        "itae(e1) + itae(e2) + 2*energy(u1 - 3) + 2*energy(u2 - 3)",
        ["overshoot(x1, r1)", "overshoot(x2, r2)"],
    ),
}


class Counted:
    """Criteria of a design, with the number of evaluations until a target was reached."""

    def __init__(self, design: Design, target: float = -np.inf) -> None:
        self.design, self.target = design, target
        self.known: dict[bytes, tuple[float, list[float]]] = {}
        self.n, self.reached = 0, None

    def at(self, x: np.ndarray) -> tuple[float, list[float]]:
        key = np.asarray(x, float).tobytes()
        if key not in self.known:
            self.n += 1
            point = self.design.evaluate(np.asarray(x, float))
            violations = [limited.value for limited in point.constraints]
            self.known[key] = point.objectives[0], violations
            if self.reached is None and point.objectives[0] <= self.target and max(violations) <= LIMIT + 1e-6:
                self.reached = self.n
        return self.known[key]


def main() -> None:
    print("| case | start or seed | fmufit | COBYLA | SciPy DE |\n|---|---|---|---|---|")
    for name, (names, lower, upper, start_values, objective, overshoots) in CASES.items():
        lower, upper = np.array(lower), np.array(upper)
        scenario = Scenario(400, start_values=start_values)
        constraints = [f"{overshoot} <= {LIMIT}" for overshoot in overshoots]

        def designed(begin: np.ndarray) -> Design:
            parameters = [Parameter(n, b, lo, up) for n, b, lo, up in zip(names, begin, lower, upper)]
            return Design(example_fmu("tank_control"), parameters, objective, scenario, constraints=constraints)

        rng = np.random.default_rng(5)
        starts = [lower + rng.uniform(0.05, 0.95, len(lower)) * (upper - lower) for _ in range(5)]
        results = [designed(begin).optimize() for begin in starts]
        best = min(result.value for result in results if result.success)
        grid = Counted(designed(starts[0]))
        centre = min((r for r in results if r.success), key=lambda r: r.value).x
        side = 41 if len(lower) == 2 else 9
        axes = [np.clip(c * np.linspace(0.9, 1.1, side), lo, up) for c, lo, up in zip(centre, lower, upper)]
        values = [grid.at(np.array(x)) for x in np.stack(np.meshgrid(*axes), -1).reshape(-1, len(lower))]
        brute = min(value for value, violations in values if max(violations) <= LIMIT)
        print(f"<!-- {name}: best {best:.6g}, grid of {len(values)} around it {brute:.6g} -->")
        target = min(best, brute) * 1.01
        for seed, (begin, result) in enumerate(zip(starts, results)):
            ours = designed(begin)
            counted = Counted(ours, target)
            for x in result.search.trace.x:
                counted.at(x)
                if counted.reached:
                    break
            local, population = Counted(ours, target), Counted(ours, target)

            def inside(z: np.ndarray) -> np.ndarray:
                return np.clip(lower + z * (upper - lower), lower, upper)

            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                limits = [{"type": "ineq", "fun": lambda z, k=k: LIMIT - local.at(inside(z))[1][k]} for k in range(len(overshoots))]
                limits += [{"type": "ineq", "fun": lambda z: np.min(z)}, {"type": "ineq", "fun": lambda z: 1 - np.max(z)}]
                z0 = (begin - lower) / (upper - lower)
                optimize.minimize(lambda z: local.at(inside(z))[0], z0, method="COBYLA", constraints=limits, options={"maxiter": 500})
                nonlinear = optimize.NonlinearConstraint(lambda x: population.at(x)[1], -np.inf, LIMIT)
                optimize.differential_evolution(
                    lambda x: population.at(x)[0], list(zip(lower, upper)), constraints=nonlinear, seed=seed, maxiter=60, polish=False
                )
            print(f"| {name} | {seed} | {counted.reached} | {local.reached} | {population.reached} |")


if __name__ == "__main__":
    main()
