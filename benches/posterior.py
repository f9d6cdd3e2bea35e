"""Effective draws per simulation of `Fit.sample` and of emcee (stretch move), on the same log density.

    python benches/posterior.py

Each row is a fit of a bundled model to simulated measurements with noise. Both samplers start from the same covariance,
use the same number of walkers, and discard the same part. The autocorrelation time is computed by emcee for both.
"""

import emcee
import numpy as np
import pydfo

STEPS, WARMUP = 4000, 1000


def decay(parameters, seed):
    """Returns a fit of `x' = -k x` from an unknown initial value, with known noise."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 3.0, 31)
    x = np.exp(-1.5 * t) + 0.02 * rng.standard_normal(t.size)
    return pydfo.Calibration(pydfo.example_fmu("dahlquist"), {"time": t, "x": x}, ["x"], parameters, sigma={"x": 0.02}).fit()


def oscillator(seed):
    """Returns a fit of van der Pol's oscillator: damping and both initial states, with known noise."""
    rng = np.random.default_rng(seed)
    model = pydfo.FMUModel(pydfo.example_fmu("van_der_pol"))
    t = np.linspace(0.0, 10.0, 101)
    run = model.simulate(times=t)
    x = run["x0"] + 0.1 * rng.standard_normal(t.size)
    parameters = [pydfo.Parameter("mu", 1.1, 0.1, 5), pydfo.Parameter("x0", 2.1, -5, 5), pydfo.Parameter("x1", 0.1, -5, 5)]
    return pydfo.Calibration(pydfo.example_fmu("van_der_pol"), {"time": t, "x": x}, {"x0": "x"}, parameters, sigma={"x0": 0.1}).fit()


def by_emcee(fit, walkers, seed):
    """Returns the chain of emcee and its number of evaluations inside the bounds."""
    calibration = fit._calibration
    bounds = np.array([[p.lower, p.upper] for p in calibration.parameters])
    counts = [0]

    def log_density(x):
        if not ((bounds[:, 0] <= x) & (x <= bounds[:, 1])).all():
            return -np.inf
        counts[0] += 1
        return -0.5 * calibration.cost(x)

    rng = np.random.default_rng(seed)
    start = rng.multivariate_normal(fit.x, fit.covariance, size=walkers)
    sampler = emcee.EnsembleSampler(walkers, len(fit.x), log_density)
    sampler.random_state = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(start, STEPS)
    return sampler.get_chain(discard=WARMUP), counts[0]


def effective(chain):
    """Returns the smallest number of effective draws of the parameters."""
    return chain.shape[0] * chain.shape[1] / emcee.autocorr.integrated_time(chain, tol=0).max()


def main():
    """Prints one row for each fit."""
    k, x = pydfo.Parameter("k", 1.2, 0.1, 10), pydfo.Parameter("x", 0.9, 0.1, 3)
    cases = {"decay, 1 parameter": decay([k], 1), "decay, 2 parameters": decay([k, x], 2), "van der Pol, 3 parameters": oscillator(3)}
    print("| fit | draws per 1000 simulations, pydfo | emcee | ratio | means differ by (Monte Carlo errors) | ratio of sd |")
    print("|---|---|---|---|---|---|")
    for name, fit in cases.items():
        ours = fit.sample(STEPS, warmup=WARMUP, rng=1, disp=False)
        theirs, n = by_emcee(fit, ours.chain.shape[1], 1)
        a, b = effective(ours.chain) / ours.n_simulations, effective(theirs) / n
        mean, sd = (np.array([getattr(c.reshape(-1, c.shape[2]), f)(axis=0) for c in (ours.chain, theirs)]) for f in ("mean", "std"))
        error = np.hypot(sd[0] / np.sqrt(effective(ours.chain)), sd[1] / np.sqrt(effective(theirs)))
        apart, wider = np.abs((mean[0] - mean[1]) / error).max(), sd[0] / sd[1]
        print(f"| {name} | {1000 * a:.1f} | {1000 * b:.1f} | {a / b:.1f} | {apart:.1f} | {wider.min():.3f} to {wider.max():.3f} |")


if __name__ == "__main__":
    main()
