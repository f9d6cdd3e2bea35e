"""A hybrid system written in Python without an FMU: a room with a heater that a thermostat switches.

The temperature falls towards 5 degrees outside, and rises while the heater is on. The thermostat switches on below 19
degrees and off above 21 degrees. The second state is the heater's power, which changes only at events.
"""

import math

from pydfo import ode

OUTSIDE = 5.0
LOSS = 0.2  # 1/h
HEAT = 6.0  # degrees per hour


def rhs(t, y):
    temperature, power = y
    return [LOSS * (OUTSIDE - temperature) + power, 0.0]


def cold(t, y):
    return y[0] - 19.0


def warm(t, y):
    return y[0] - 21.0


cold.direction = -1
warm.direction = 1


def switch(t, y, which):
    return [y[0], HEAT if 0 in which else 0.0]


def main():
    """Simulates a day and checks the times of switching against the closed form."""
    res = ode.solve(rhs, (0, 24), [20.0, 0.0], events=[cold, warm], on_event=switch, rtol=1e-9, dense_output=True)
    on, off = res.t_events
    print(f"{res.message} {len(on)} times on, {len(off)} times off, {res.nfev} right-hand sides")
    print(f"first on at {on[0]:.6f} h, off at {off[0]:.6f} h; at noon {res.sol(12.0)[0]:.4f} degrees")
    # Exponentials between the switches: towards 5 degrees while the heater is off, towards 5 + 6 / 0.2 while it is
    # on.
    falls = math.log((20.0 - OUTSIDE) / (19.0 - OUTSIDE)) / LOSS
    rises = math.log((35.0 - 19.0) / (35.0 - 21.0)) / LOSS
    if abs(on[0] - falls) > 1e-7 or abs(off[0] - falls - rises) > 1e-7:
        raise SystemExit(f"expected {falls} and {falls + rises}")


if __name__ == "__main__":
    main()
