//! Fits of engineering models without bounds and without noise: closed-form curves and ordinary differential
//! equations. Parameters have sizes from 1e-6 to 1e6, and each fit has three starts. Even numbers are for
//! tuning the constants of the simplex (`benches/simplex.rs`), odd numbers for their assessment
//! (`tests/all/simplex_quality.rs`).

type Model = Box<dyn Fn(&[f64]) -> Vec<f64> + Send + Sync>;

/// A model with the parameters that generated its data.
pub struct Fit {
    pub name: &'static str,
    pub truth: Vec<f64>,
    model: Model,
    data: Vec<f64>,
}

impl Fit {
    /// Returns the sum of squares relative to the sum of squares of the data about their mean.
    pub fn cost(&self, p: &[f64]) -> f64 {
        let mean = self.data.iter().sum::<f64>() / self.data.len() as f64;
        let scale: f64 = self.data.iter().map(|y| (y - mean).powi(2)).sum();
        let sum: f64 = (self.model)(p).iter().zip(&self.data).map(|(a, b)| (a - b).powi(2)).sum();
        sum / scale
    }

    /// Returns the residuals in the same scaling as the cost.
    pub fn residuals(&self, p: &[f64]) -> Vec<f64> {
        let mean = self.data.iter().sum::<f64>() / self.data.len() as f64;
        let scale: f64 = self.data.iter().map(|y| (y - mean).powi(2)).sum::<f64>().sqrt();
        (self.model)(p).iter().zip(&self.data).map(|(a, b)| (a - b) / scale).collect()
    }

    /// Returns three starts: alternately too high and too low by factors up to 2.5, all too low, and all too
    /// high by smaller factors.
    pub fn starts(&self) -> [Vec<f64>; 3] {
        let by = |factors: [f64; 4]| {
            self.truth.iter().zip(factors.into_iter().cycle()).map(|(p, f)| p * f).collect()
        };
        [by([2.0, 0.5, 1.5, 0.7]), by([0.5, 1.8, 0.7, 1.4]), by([1.5, 1.3, 0.6, 0.8])]
    }
}

fn fit(name: &'static str, truth: &[f64], model: impl Fn(&[f64]) -> Vec<f64> + Send + Sync + 'static) -> Fit {
    let data = model(truth);
    Fit { name, truth: truth.to_vec(), model: Box::new(model), data }
}

/// A formula evaluated at 40 points.
fn curve(name: &'static str, truth: &[f64], (from, to): (f64, f64), f: fn(&[f64], f64) -> f64) -> Fit {
    fit(name, truth, move |p| (0..40).map(|i| f(p, from + (to - from) * f64::from(i) / 39.0)).collect())
}

type Rhs<const N: usize> = fn(&[f64], f64, &[f64; N]) -> [f64; N];

/// All states of a system at 40 times, by 20 classical Runge-Kutta steps each. Each state is divided by its
/// `unit`.
fn system<const N: usize>(
    name: &'static str,
    truth: &[f64],
    end: f64,
    (start, unit): ([f64; N], [f64; N]),
    rhs: Rhs<N>,
) -> Fit {
    fit(name, truth, move |p| {
        let (mut y, mut t, h) = (start, 0.0, end / 800.0);
        let mut out = Vec::new();
        let add = |y: &[f64; N], k: &[f64; N], h: f64| std::array::from_fn(|i| y[i] + h * k[i]);
        for step in 1..=800 {
            let k1 = rhs(p, t, &y);
            let k2 = rhs(p, t + 0.5 * h, &add(&y, &k1, 0.5 * h));
            let k3 = rhs(p, t + 0.5 * h, &add(&y, &k2, 0.5 * h));
            let k4 = rhs(p, t + h, &add(&y, &k3, h));
            y = std::array::from_fn(|i| y[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
            t += h;
            if step % 20 == 0 {
                out.extend(y.iter().zip(&unit).map(|(y, unit)| y / unit));
            }
        }
        out
    })
}

/// Returns all fits.
pub fn fits() -> Vec<Fit> {
    vec![
        curve("logistic growth", &[1e6, 1e-2, 400.0], (0.0, 1000.0), |p, t| {
            p[0] / (1.0 + (-p[1] * (t - p[2])).exp())
        }),
        curve("logistic dose", &[3e-6, 2.0, 3.0], (0.0, 6.0), |p, t| {
            p[0] / (1.0 + (-p[1] * (t - p[2])).exp())
        }),
        curve("Gompertz growth", &[5e4, 4.0, 0.05], (0.0, 100.0), |p, t| {
            p[0] * (-p[1] * (-p[2] * t).exp()).exp()
        }),
        curve("decay", &[2e5, 3e-4], (0.0, 1e4), |p, t| p[0] * (-p[1] * t).exp()),
        curve("decay to a level", &[40.0, 0.12, 3.0], (0.0, 40.0), |p, t| p[0] * (-p[1] * t).exp() + p[2]),
        curve("two decays", &[10.0, 1.2, 4.0, 0.05], (0.0, 30.0), |p, t| {
            p[0] * (-p[1] * t).exp() + p[2] * (-p[3] * t).exp()
        }),
        curve("two fast decays", &[2e-6, 5e3, 8e-7, 200.0], (0.0, 0.01), |p, t| {
            p[0] * (-p[1] * t).exp() + p[2] * (-p[3] * t).exp()
        }),
        curve("Michaelis and Menten", &[3e-6, 2e-4], (0.0, 1e-3), |p, s| p[0] * s / (p[1] + s)),
        curve("substrate inhibition", &[120.0, 0.3, 8.0], (0.0, 30.0), |p, s| {
            p[0] * s / (p[1] + s + s * s / p[2])
        }),
        curve("Hill", &[90.0, 1e-5, 2.2], (1e-7, 4e-5), |p, c| p[0] / (1.0 + (p[1] / c).powf(p[2]))),
        curve("damped oscillation", &[0.2, 0.4, 6.0], (0.0, 4.0), |p, t| {
            p[0] * (-p[1] * t).exp() * (p[2] * t).cos()
        }),
        curve("ringing", &[1e-3, 50.0, 900.0, 0.3], (0.0, 0.01), |p, t| {
            p[0] * (-p[1] * t).exp() * (p[2] * t + p[3]).cos()
        }),
        curve("Arrhenius", &[1e-3, 6e4], (300.0, 400.0), |p, t| {
            p[0] * (p[1] / 8.314 * (1.0 / 350.0 - 1.0 / t)).exp()
        }),
        curve("Antoine", &[8.0, 1700.0, 230.0], (0.0, 100.0), |p, t| p[0] - p[1] / (p[2] + t)),
        fit("RC charging", &[1e4, 1e-6, 5.0], |p| {
            let e = |i: i32| (-f64::from(i) * 1e-3 / (p[0] * p[1])).exp();
            (0..40).flat_map(|i| [p[2] * (1.0 - e(i)), 1e4 * p[2] / p[0] * e(i)]).collect()
        }),
        system("RLC step", &[10.0, 1e-3, 1e-6], 1e-3, ([0.0, 0.0], [1.0, 0.03]), |p, _, y| {
            [y[1] / p[2], (1.0 - y[0] - p[0] * y[1]) / p[1]]
        }),
        curve("cooling", &[12.0, 5e3, 293.0], (0.0, 2000.0), |p, t| {
            p[2] + (370.0 - p[2]) * (-p[0] / p[1] * t).exp()
        }),
        curve("first order with delay", &[2.5, 30.0, 5.0], (0.0, 150.0), |p, t| {
            if t > p[2] { p[0] * (1.0 - (-(t - p[2]) / p[1]).exp()) } else { 0.0 }
        }),
        system("second order step", &[1e3, 0.05, 0.3], 300.0, ([0.0, 0.0], [1e3, 50.0]), |p, _, y| {
            [y[1], p[1] * p[1] * (p[0] - y[0]) - 2.0 * p[2] * p[1] * y[1]]
        }),
        curve("Stribeck friction", &[10.0, 14.0, 0.05, 30.0], (0.001, 0.4), |p, v| {
            p[0] + (p[1] - p[0]) * (-(v / p[2]).powi(2)).exp() + p[3] * v
        }),
        curve("tyre", &[4e3, 1.4, 12.0, -0.5], (0.0, 0.5), |p, s| {
            let b = p[2] * s;
            p[0] * (p[1] * (b - p[3] * (b - b.atan())).atan()).sin()
        }),
        curve("Langmuir", &[2e-3, 5e4], (0.0, 1e-4), |p, c| p[0] * p[1] * c / (1.0 + p[1] * c)),
        curve("Freundlich", &[0.4, 2.6], (1.0, 300.0), |p, c| p[0] * c.powf(1.0 / p[1])),
        curve("Weibull", &[3e4, 1.8], (1e2, 1e5), |p, t| 1.0 - (-(t / p[0]).powf(p[1])).exp()),
        curve("peak", &[1e3, 520.0, 120.0, 50.0], (0.0, 1000.0), |p, t| {
            p[0] * (-((t - p[1]) / p[2]).powi(2)).exp() + p[3]
        }),
        curve("two peaks", &[8.0, 3.0, 1.0, 5.0, 7.0, 1.5], (0.0, 12.0), |p, t| {
            p[0] * (-((t - p[1]) / p[2]).powi(2)).exp() + p[3] * (-((t - p[4]) / p[5]).powi(2)).exp()
        }),
        curve("resonance", &[2e-4, 2.4e3, 600.0], (1e3, 4e3), |p, f| {
            p[0] / (1.0 + ((f - p[1]) / p[2]).powi(2))
        }),
        curve("diode", &[1e-6, 1.6], (0.1, 0.6), |p, v| (p[0] * ((v / (p[1] * 0.02585)).exp() - 1.0)).ln()),
        curve("van Genuchten", &[0.05, 0.43, 0.036, 1.56], (1.0, 500.0), |p, h| {
            p[0] + (p[1] - p[0]) * (1.0 + (p[2] * h).powf(p[3])).powf(1.0 / p[3] - 1.0)
        }),
        curve("pump", &[42.0, 150.0, 9e4], (0.0, 0.02), |p, q| p[0] - p[1] * q - p[2] * q * q),
        curve("thermistor", &[1.1e-3, 2.3e-4, 9e-8], (1e3, 3e4), |p, r| {
            let l = r.ln();
            1.0 / (p[0] + p[1] * l + p[2] * l.powi(3))
        }),
        curve("power law", &[3e-5, 2.7], (10.0, 100.0), |p, t| p[0] * t.powf(p[1])),
        curve("one compartment", &[1.2, 0.15, 3e4], (0.0, 24.0), |p, t| {
            5e5 / p[2] * p[0] / (p[0] - p[1]) * ((-p[1] * t).exp() - (-p[0] * t).exp())
        }),
        curve("Swift hardening", &[6e5, 2e-3, 0.2], (0.0, 0.2), |p, e| p[0] * (p[1] + e).powf(p[2])),
        curve("stretched decay", &[7.0, 2e4, 0.6], (1.0, 1e5), |p, t| p[0] * (-(t / p[1]).powf(p[2])).exp()),
        system(
            "Lotka and Volterra",
            &[0.6, 0.025, 0.8, 0.02],
            15.0,
            ([30.0, 10.0], [30.0, 30.0]),
            |p, _, y| [p[0] * y[0] - p[1] * y[0] * y[1], p[3] * y[0] * y[1] - p[2] * y[1]],
        ),
        system("epidemic", &[4e-7, 0.1], 80.0, ([1e6, 10.0], [1e6, 1e6]), |p, _, y| {
            [-p[0] * y[0] * y[1], p[0] * y[0] * y[1] - p[1] * y[1]]
        }),
        system("chain of reactions", &[0.8, 0.2], 15.0, ([1.0, 0.0], [1.0, 1.0]), |p, _, y| {
            [-p[0] * y[0], p[0] * y[0] - p[1] * y[1]]
        }),
        system("pendulum with friction", &[9e-3, 2e-3, 0.21], 6.0, ([1.2, 0.0], [1.0, 5.0]), |p, _, y| {
            [y[1], -9.81 / p[2] * y[0].sin() - 20.0 * (p[0] * y[1] + p[1] * (y[1] / 0.05).tanh())]
        }),
        system("two tanks", &[7e-6, 5e-6, 3e-5], 600.0, ([0.3, 0.1], [0.1, 0.1]), |p, t, y| {
            let out = |a: f64, h: f64| a * (2.0 * 9.81 * h.max(0.0)).sqrt();
            let pumped = if t < 300.0 { p[2] } else { 0.3 * p[2] };
            [(pumped - out(p[0], y[0])) / 2.8e-3, (out(p[0], y[0]) - out(p[1], y[1])) / 2.8e-3]
        }),
        system("van der Pol", &[1.5, 2.0], 8.0, ([1.0, 0.0], [1.0, 2.0]), |p, _, y| {
            [y[1], p[0] * (1.0 - y[0] * y[0]) * y[1] - p[1] * y[0]]
        }),
        system("Monod growth", &[0.4, 0.05, 0.5], 12.0, ([0.05, 2.0], [1.0, 1.0]), |p, _, y| {
            let rate = p[0] * y[1] / (p[1] + y[1]) * y[0];
            [rate, -rate / p[2]]
        }),
        system("two thermal masses", &[1e5, 2e4, 30.0, 5.0], 6e4, ([20.0, 20.0], [10.0, 10.0]), |p, t, y| {
            let heat = if t < 3e4 { 200.0 } else { 0.0 };
            [(p[2] * (y[1] - y[0]) - p[3] * (y[0] - 20.0)) / p[0], (heat - p[2] * (y[1] - y[0])) / p[1]]
        }),
        system("motor", &[1.0, 1e-3, 0.05, 1e-5, 1e-5], 0.03, ([0.0, 0.0], [5.0, 100.0]), |p, _, y| {
            [(6.0 - p[0] * y[0] - p[2] * y[1]) / p[1], (p[2] * y[0] - p[4] * y[1]) / p[3]]
        }),
        system("hardening spring", &[0.3, 40.0, 2e4], 3.0, ([0.05, 0.0], [0.05, 0.3]), |p, _, y| {
            [y[1], -p[0] * y[1] - p[1] * y[0] - p[2] * y[0].powi(3)]
        }),
        system("FitzHugh and Nagumo", &[0.2, 0.25, 3.0], 12.0, ([-1.0, 1.0], [1.0, 1.0]), |p, _, y| {
            [p[2] * (y[0] - y[0].powi(3) / 3.0 + y[1]), -(y[0] - p[0] + p[1] * y[1]) / p[2]]
        }),
        system("Brusselator", &[1.0, 2.5], 10.0, ([1.0, 1.5], [1.0, 1.0]), |p, _, y| {
            let r = y[0] * y[0] * y[1];
            [p[0] + r - (p[1] + 1.0) * y[0], p[1] * y[0] - r]
        }),
        system("quarter car", &[15e3, 1e3, 3e5], 2.0, ([0.0; 4], [0.05, 1.0, 0.05, 1.0]), |p, _, y| {
            let spring = p[0] * (y[2] - y[0]) + p[1] * (y[3] - y[1]);
            [y[1], spring / 300.0, y[3], (p[2] * (0.05 - y[2]) - spring) / 40.0]
        }),
    ]
}
