//! Differential-algebraic problems `F(t, x, x') = 0` of the IVP test set (F. Mazzia, C. Magherini, Test Set
//! for Initial Value Problem Solvers, release 2.4, University of Bari, 2008), with the published solutions.

/// A problem: residual, start, end, and the solution at the end.
#[derive(Clone, Copy)]
pub(crate) struct Dae {
    pub(crate) name: &'static str,
    pub(crate) residual: fn(f64, &[f64], &[f64], &mut [f64]),
    pub(crate) x0: &'static [f64],
    pub(crate) end: f64,
    pub(crate) reference: &'static [f64],
    /// Absolute tolerance, as a fraction of the relative tolerance.
    pub(crate) atol: f64,
}

impl Dae {
    /// Returns the number of correct digits: minus the logarithm of the largest relative error.
    pub(crate) fn digits(&self, x: &[f64]) -> f64 {
        let error = |(x, e): (&f64, &f64)| ((x - e) / e).abs();
        -x.iter().zip(self.reference).map(error).fold(0.0, f64::max).log10()
    }
}

fn robertson_residual(_: f64, y: &[f64], d: &[f64], r: &mut [f64]) {
    let (a, b, c) = (0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] * y[1]);
    r[0] = d[0] + a - b;
    r[1] = d[1] - a + b + c;
    r[2] = y[0] + y[1] + y[2] - 1.0;
}

/// Robertson's reaction with the last equation replaced by conservation (II-10).
pub(crate) const ROBERTSON: Dae = Dae {
    name: "Robertson",
    residual: robertson_residual,
    x0: &[1.0, 0.0, 0.0],
    end: 40.0,
    reference: &[7.158270687194050905e-1, 9.185534764557763904e-6, 2.841637457458303518e-1],
    atol: 1e-4,
};

fn akzo_residual(_: f64, y: &[f64], d: &[f64], out: &mut [f64]) {
    let r = [
        18.7 * y[0].powi(4) * y[1].sqrt(),
        0.58 * y[2] * y[3],
        0.58 / 34.4 * y[0] * y[4],
        0.09 * y[0] * y[3] * y[3],
        0.42 * y[5] * y[5] * y[1].sqrt(),
    ];
    let inflow = 3.3 * (0.9 / 737.0 - y[1]);
    let f = [
        -2.0 * r[0] + r[1] - r[2] - r[3],
        -0.5 * r[0] - r[3] - 0.5 * r[4] + inflow,
        r[0] - r[1] + r[2],
        -r[1] + r[2] - 2.0 * r[3],
        r[1] - r[2] + r[4],
    ];
    for i in 0..5 {
        out[i] = d[i] - f[i];
    }
    out[5] = 115.83 * y[0] * y[3] - y[5];
}

/// Chemical Akzo Nobel (II-1): an equilibrium determines the last concentration.
pub(crate) const AKZO: Dae = Dae {
    name: "Akzo Nobel",
    residual: akzo_residual,
    x0: &[0.444, 0.00123, 0.0, 0.007, 0.0, 115.83 * 0.444 * 0.007],
    end: 180.0,
    reference: &[
        1.150_794_920_661_702e-1,
        1.203_831_471_567_715e-3,
        1.611_562_887_407_974e-1,
        3.656_156_421_249_283e-4,
        1.708_010_885_264_404e-2,
        4.873_531_310_307_455e-3,
    ],
    atol: 1e-4,
};

fn amplifier_residual(t: f64, y: &[f64], d: &[f64], r: &mut [f64]) {
    let (ub, uf, alpha, beta, r0, rk) = (6.0, 0.026, 0.99, 1e-6, 1e3, 9e3);
    let ue = 0.1 * (200.0 * std::f64::consts::PI * t).sin();
    let g = |v: f64| beta * ((v / uf).exp() - 1.0);
    let (g23, g56) = (g(y[1] - y[2]), g(y[4] - y[5]));
    let i = [
        (y[0] - ue) / r0,
        -ub / rk + 2.0 * y[1] / rk - (alpha - 1.0) * g23,
        -g23 + y[2] / rk,
        -ub / rk + y[3] / rk + alpha * g23,
        -ub / rk + 2.0 * y[4] / rk - (alpha - 1.0) * g56,
        -g56 + y[5] / rk,
        -ub / rk + y[6] / rk + alpha * g56,
        y[7] / rk,
    ];
    let c = |k: u32| f64::from(k) * 1e-6;
    let q = [
        c(1) * (d[1] - d[0]),
        c(1) * (d[0] - d[1]),
        -c(2) * d[2],
        c(3) * (d[4] - d[3]),
        c(3) * (d[3] - d[4]),
        -c(4) * d[5],
        c(5) * (d[7] - d[6]),
        c(5) * (d[6] - d[7]),
    ];
    for k in 0..8 {
        r[k] = q[k] - i[k];
    }
}

/// The transistor amplifier (II-5): no single state is algebraic, but sums of equations are.
pub(crate) const AMPLIFIER: Dae = Dae {
    name: "amplifier",
    residual: amplifier_residual,
    x0: &[0.0, 3.0, 3.0, 6.0, 3.0, 3.0, 6.0, 0.0],
    end: 0.2,
    reference: &[
        -5.562_145_012_262_709e-3,
        3.006_522_471_903_042,
        2.849_958_788_608_128,
        2.926_422_536_206_241,
        2.704_617_865_010_554,
        2.761_837_778_393_145,
        4.770_927_631_616_772,
        1.236_995_868_091_548,
    ],
    atol: 1.0,
};

pub(crate) const ALL: [Dae; 3] = [ROBERTSON, AKZO, AMPLIFIER];
