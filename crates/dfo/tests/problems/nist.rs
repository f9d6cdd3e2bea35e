//! Nonlinear regressions of the Statistical Reference Datasets (NIST StRD,
//! https://www.itl.nist.gov/div898/strd/): 27 models with two starts each. `data/nist_strd.txt` has four
//! lines per model: name, numbers per row and certified sum of squares; first start; second start; rows, with
//! y before x.

use std::f64::consts::{PI, TAU};

/// One model with its data.
pub struct Regression {
    pub name: &'static str,
    pub starts: [Vec<f64>; 2],
    /// Certified sum of squares.
    pub best: f64,
    rows: Vec<Vec<f64>>,
}

impl Regression {
    /// Returns measured minus modelled values.
    pub fn residuals(&self, p: &[f64]) -> Vec<f64> {
        let each = |row: &Vec<f64>| match self.name {
            "Nelson" => row[0].ln() - (p[0] - p[1] * row[1] * (-p[2] * row[2]).exp()),
            name => row[0] - model(name, p, row[1]),
        };
        self.rows.iter().map(each).collect()
    }

    pub fn cost(&self, p: &[f64]) -> f64 {
        self.residuals(p).iter().map(|r| r * r).sum()
    }
}

fn polynomial(p: &[f64], x: f64) -> f64 {
    p.iter().rev().fold(0.0, |sum, p| sum * x + p)
}

/// Returns a polynomial divided by another polynomial that is 1 at zero.
fn ratio(p: &[f64], split: usize, x: f64) -> f64 {
    polynomial(&p[..split], x) / (1.0 + x * polynomial(&p[split..], x))
}

fn model(name: &str, p: &[f64], x: f64) -> f64 {
    let bell = |height: f64, place: f64, width: f64| height * (-((x - place) / width).powi(2)).exp();
    let wave = |period: f64, a: f64, b: f64| a * (TAU * x / period).cos() + b * (TAU * x / period).sin();
    match name {
        "Bennett5" => p[0] * (p[1] + x).powf(-1.0 / p[2]),
        "BoxBOD" | "Misra1a" => p[0] * (1.0 - (-p[1] * x).exp()),
        "Chwirut1" | "Chwirut2" => (-p[0] * x).exp() / (p[1] + p[2] * x),
        "DanWood" => p[0] * x.powf(p[1]),
        "ENSO" => p[0] + wave(12.0, p[1], p[2]) + wave(p[3], p[4], p[5]) + wave(p[6], p[7], p[8]),
        "Eckerle4" => p[0] / p[1] * (-0.5 * ((x - p[2]) / p[1]).powi(2)).exp(),
        "Gauss1" | "Gauss2" | "Gauss3" => {
            p[0] * (-p[1] * x).exp() + bell(p[2], p[3], p[4]) + bell(p[5], p[6], p[7])
        }
        "Hahn1" | "Thurber" => ratio(p, 4, x),
        "Kirby2" => ratio(p, 3, x),
        "Lanczos1" | "Lanczos2" | "Lanczos3" => p.chunks(2).map(|p| p[0] * (-p[1] * x).exp()).sum(),
        "MGH09" => p[0] * (x * x + x * p[1]) / (x * x + x * p[2] + p[3]),
        "MGH10" => p[0] * (p[1] / (x + p[2])).exp(),
        "MGH17" => p[0] + p[1] * (-p[3] * x).exp() + p[2] * (-p[4] * x).exp(),
        "Misra1b" => p[0] * (1.0 - (1.0 + 0.5 * p[1] * x).powi(-2)),
        "Misra1c" => p[0] * (1.0 - (1.0 + 2.0 * p[1] * x).powf(-0.5)),
        "Misra1d" => p[0] * p[1] * x / (1.0 + p[1] * x),
        "Rat42" => p[0] / (1.0 + (p[1] - p[2] * x).exp()),
        "Rat43" => p[0] / (1.0 + (p[1] - p[2] * x).exp()).powf(1.0 / p[3]),
        "Roszman1" => p[0] - p[1] * x - (p[2] / (x - p[3])).atan() / PI,
        _ => panic!("there is no model {name}"),
    }
}

/// Returns all regressions.
pub fn regressions() -> Vec<Regression> {
    let lines: Vec<&'static str> = include_str!("../data/nist_strd.txt").lines().collect();
    let numbers = |line: &str| line.split(' ').map(|v| v.parse().unwrap()).collect::<Vec<f64>>();
    let each = |lines: &[&'static str]| {
        let head: Vec<&'static str> = lines[0].split(' ').collect();
        Regression {
            name: head[0],
            starts: [numbers(lines[1]), numbers(lines[2])],
            best: head[2].parse().unwrap(),
            rows: numbers(lines[3]).chunks(head[1].parse().unwrap()).map(<[f64]>::to_vec).collect(),
        }
    };
    lines.chunks(4).map(each).collect()
}
