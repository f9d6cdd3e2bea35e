"""Tunes a PI controller of the quadruple tank: fast, with an overshoot below 5 %.

Reference of the left tank: a step from 12.26 cm to 14 cm. The right controller keeps its level.
"""

from pydfo import Design, Parameter, Scenario, example_fmu

design = Design(
    example_fmu("tank_control"),
    parameters=[
        Parameter("K1", 3.0, 0.5, 20.0),  # gain in V/cm
        Parameter("T1", 30.0, 5.0, 200.0),  # integral time in s
    ],
    objective="itae(e1)",
    scenarios=Scenario(400, start_values={"r2": 12.783158403008972}),
    constraints=["overshoot(x1, r1) <= 5"],
)
result = design.optimize()
print(result)
assert result.success and result.violation <= 1e-6
try:
    result.plot(["x1", "u1"]).savefig("tank_control.png")
except ImportError as reason:
    print(reason)
