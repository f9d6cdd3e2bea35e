"""Generates exhaust.csv: a drive cycle of a truck engine's exhaust pipe, like a measurement.

The pipe is the bundled model `exhaust` with different parameters and additional effects: conductances that grow with
the flow, losses that grow with the road speed, and a thermocouple with a lag. The best parameters of the model
therefore differ from the true ones.

    python generate_exhaust.py            writes exhaust.csv next to this file
    python generate_exhaust.py --check    compares the file with the generated data
"""

import csv
import sys
from pathlib import Path

import numpy as np

FILE = Path(__file__).with_name("exhaust.csv")
SEED = 2012
C1, G1, C2, G2 = 4300.0, 65.0, 17000.0, 150.0  # J/K, W/K: the true walls
NOISE = 2.0  # standard deviation, K
TIMES = np.arange(1201.0)  # 0 to 1200 s, every second
COLUMNS = ["T_in", "p_in", "w_turb1", "w_turb2", "p_out"]

# Constants of the model.
R, CP, T_AMB = 287.5, 1130.0, 293.15
GAMMA = R / CP
V1, V2, K1, K2, K3 = 0.006, 0.015, 5.8e-5, 9.5e-5, 2.5e-4
GA1, GA2, D1, D2, ETA1, ETA2, NU1, NU2, SMALLEST, DELTA = 6.0, 12.0, 0.086, 0.110, 0.74, 0.78, 0.66, 0.65, 10.0, 1e-4


def lagged(values, seconds):
    """Returns a first-order lag of samples with a spacing of one second."""
    out = np.array(values, dtype=float)
    for k in range(1, out.size):
        out[k] = out[k - 1] + (values[k] - out[k - 1]) * (1.0 - np.exp(-1.0 / seconds))
    return out


def profile(rng, low, high, longest):
    """Returns segments of random value and length joined by ramps; idle for the first 25 s."""
    times, values = [0.0, 25.0], [low, low]
    while times[-1] < TIMES[-1]:
        start = times[-1] + rng.uniform(1.0, 11.0)
        value = rng.uniform(low, high)
        times += [start, start + rng.uniform(5.0, longest)]
        values += [value, value]
    return np.interp(TIMES, times, values)


def drive_cycle(rng):
    """Returns the five inputs once per second, and the road speed."""
    speed = lagged(profile(rng, 650.0, 1650.0, 60.0), 2.0)  # 1/min
    load = lagged(profile(rng, 0.02, 1.0, 40.0), 1.5)
    flow = 0.36 * speed / 1650.0 * (0.2 + 0.8 * load)  # kg/s
    T_in = 500.0 + 380.0 * lagged(load, 6.0)
    p_out = 1.013e5 + 9e4 * flow**2
    p2 = np.sqrt(p_out**2 + flow**2 * 620.0 / K3**2)
    p1 = np.sqrt(p2**2 + flow**2 * 680.0 / K2**2)
    p_in = np.sqrt(p1**2 + flow**2 * T_in / K1**2)
    spouting = np.sqrt(2.0 * CP * T_in * (1.0 - (p1 / p_in) ** GAMMA) + SMALLEST**2)
    w_turb1 = lagged(2.0 * NU1 * spouting / D1, 2.5)
    w_turb2 = 31.0 * speed * np.pi / 30.0
    road = lagged(np.where(TIMES < 500.0, 0.0, profile(rng, 0.4, 1.3, 200.0)), 20.0)
    inputs = {"T_in": T_in, "p_in": p_in, "w_turb1": w_turb1, "w_turb2": w_turb2, "p_out": p_out}
    digits = {"T_in": 2, "p_in": 0, "w_turb1": 1, "w_turb2": 1, "p_out": 0}
    return {name: np.round(values, digits[name]) for name, values in inputs.items()}, road


def flow(K, p_up, T_up, p_down):
    X = 1.0 - (p_down / p_up) ** 2
    return K * p_up / np.sqrt(T_up) * X / np.sqrt(X + DELTA) if X > 0.0 else 0.0


def turbine(K, D, eta, nu, p_up, T_up, p_down, w):
    """Returns flow and exit temperature."""
    drop = 1.0 - min(p_down / p_up, 1.0) ** GAMMA
    ratio = D * w / 2.0 / (np.sqrt(2.0 * CP * T_up * drop + SMALLEST**2) * nu)
    return flow(K, p_up, T_up, p_down), T_up * (1.0 - eta * 2.0 * ratio / (1.0 + ratio**2) * drop)


def outlet_temperature(inputs, road):
    """Returns the temperature of a thermocouple in the outlet, without noise."""
    from pydfo import ode

    driven = np.array([inputs[name] for name in COLUMNS] + [road]).T

    def rhs(t, y):
        k = min(int(t), TIMES.size - 2)
        T_in, p_in, w1, w2, p_out, v = driven[k] + (t - k) * (driven[k + 1] - driven[k])
        p1, T1, W1, p2, T2, W2, shown = y
        m1, Ta = turbine(K1, D1, ETA1, NU1, p_in, T_in, p1, w1)
        m2, Tb = turbine(K2, D2, ETA2, NU2, p1, T1, p2, w2)
        m3 = flow(K3, p2, T2, p_out)
        Q1, Q2 = G1 * (m2 / 0.22) ** 0.2 * (T1 - W1), G2 * (m3 / 0.22) ** 0.2 * (T2 - W2)
        losses = 1.0 + 0.21 * v
        dp1 = R / ((CP - R) * V1) * (CP * (m1 * Ta - m2 * T1) - Q1)
        dp2 = R / ((CP - R) * V2) * (CP * (m2 * Tb - m3 * T2) - Q2)
        return [
            dp1,
            T1 / p1 * dp1 - R * T1**2 / (p1 * V1) * (m1 - m2),
            (Q1 - losses * GA1 * (W1 - T_AMB)) / C1,
            dp2,
            T2 / p2 * dp2 - R * T2**2 / (p2 * V2) * (m2 - m3),
            (Q2 - losses * GA2 * (W2 - T_AMB)) / C2,
            (T2 - shown) / 1.5,
        ]

    start = [1.05e5, 480.0, 430.0, 1.02e5, 450.0, 400.0, 450.0]
    solution = ode.solve(rhs, (0.0, TIMES[-1]), start, method="radau5", t_eval=TIMES, rtol=1e-7, atol=1e-6, max_step=1.0)
    if not solution.success:
        sys.exit(solution.message)
    return solution.y[6]


def make():
    rng = np.random.default_rng(SEED)
    inputs, road = drive_cycle(rng)
    shown = outlet_temperature(inputs, road)
    return {"time": TIMES, **inputs, "T_out": np.round(shown + rng.normal(0.0, NOISE, TIMES.size), 2)}


def main():
    made = make()
    if "--check" not in sys.argv[1:]:
        with open(FILE, "w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(made)
            writer.writerows([f"{value:g}" if value % 1 else f"{value:.0f}" for value in row] for row in zip(*made.values()))
        return
    stored = np.genfromtxt(FILE, delimiter=",", names=True)
    difference = max(np.abs(stored[name] - values).max() for name, values in made.items())
    print(f"largest difference {difference:.1e}")
    if difference > 0.02:
        sys.exit("exhaust.csv differs from the output of this script")


if __name__ == "__main__":
    main()
