//! Elementary effects (Morris, Technometrics 33, 1991).
//!
//! A trajectory starts at a random point of a grid with `p` levels per parameter and changes each parameter
//! once, in random order, by `p / (2 (p - 1))` of its range. The elementary effect of a parameter is the
//! change of the value divided by the change of the parameter, relative to its range on its scale.

use super::bootstrap::{Bootstrap, Spread};
use crate::error::Error;
use crate::method_interface::rng::{Purpose, Stream};
use crate::problem::space::Space;
use crate::values::choices::{ParameterKind, Transform};
use serde::{Deserialize, Serialize};

/// Generation of the random numbers of the trajectories.
const GENERATION: u64 = 3;

/// Step of a trajectory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    /// Free parameter that changes.
    parameter: usize,
    /// Change relative to the range of the parameter.
    change: f64,
}

/// Effects of the parameters on one value, in the order of the free parameters. They are in units of the
/// value, for a change of the parameter over its whole range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MorrisEffects {
    /// Means of the elementary effects.
    pub mu: Vec<f64>,
    /// Means of the absolute elementary effects (Campolongo, Cariboni and Saltelli, Environ. Modell. Softw.
    /// 22, 2007). They rank the parameters.
    pub mu_star: Vec<f64>,
    /// Standard deviations of the elementary effects. A large value relative to `mu_star` indicates a
    /// nonlinear effect or an interaction.
    pub sigma: Vec<f64>,
    /// Half widths of the confidence intervals of `mu_star`.
    pub mu_star_conf: Vec<f64>,
}

/// Maximum number of levels of a parameter.
const MOST_LEVELS: usize = 1_000_000;

/// Returns the points of `n` trajectories, one after the other, and the steps between them.
pub(super) fn trajectories(
    space: &Space,
    n: usize,
    levels: usize,
    seed: u64,
) -> Result<(Vec<f64>, Vec<Step>), Error> {
    if !(2..=MOST_LEVELS).contains(&levels) || !levels.is_multiple_of(2) {
        let range = "an even number from 2 to 1000000";
        return Err(Error::Option { name: "levels", value: levels as f64, range });
    }
    space.forbid_categorical("morris")?;
    let d = space.n_free();
    let (mut points, mut steps) = (Vec::with_capacity(n * (d + 1) * space.n()), Vec::with_capacity(n * d));
    let (mut u, mut x, mut before) = (vec![0.0; d], vec![0.0; space.n()], vec![0.0; space.n()]);
    for trajectory in 0..n {
        let mut stream = Stream::new(seed, Purpose::Sampling, GENERATION, trajectory);
        let mut ends: Vec<[usize; 2]> = (0..d).map(|_| ends(&mut stream, levels)).collect();
        let mut order: Vec<usize> = (0..d).collect();
        stream.shuffle(&mut order);
        for changed in [None].into_iter().chain(order.into_iter().map(Some)) {
            if let Some(k) = changed {
                ends[k].swap(0, 1);
            }
            for (k, u) in u.iter_mut().enumerate() {
                let (lower, upper) = space.working_bounds(k);
                let level = ends[k][0] as f64 / (levels - 1) as f64;
                *u = (lower + level * (upper - lower)).clamp(lower, upper);
            }
            space.to_user(&u, &mut x);
            if let Some(parameter) = changed {
                let i = space.free()[parameter];
                steps.push(Step { parameter, change: relative_change(space, parameter, before[i], x[i]) });
            }
            points.extend_from_slice(&x);
            before.clone_from(&x);
        }
    }
    Ok((points, steps))
}

/// Draws the first and the last level of a parameter.
fn ends(stream: &mut Stream, levels: usize) -> [usize; 2] {
    let low = stream.below(levels / 2);
    let mut ends = [low, low + levels / 2];
    if stream.chance(0.5) {
        ends.swap(0, 1);
    }
    ends
}

/// Returns the change of free parameter `k` relative to its range, on its scale. The values of a discrete
/// parameter are rounded, so the change may differ from the step of the grid.
fn relative_change(space: &Space, k: usize, before: f64, after: f64) -> f64 {
    let i = space.free()[k];
    let (mut lower, mut upper) = (space.bounds().lower()[i], space.bounds().upper()[i]);
    if space.kind(k) != ParameterKind::Continuous {
        (lower, upper) = (lower.ceil(), upper.floor());
    }
    match space.transform(k) {
        Transform::Linear => (after - before) / (upper - lower),
        Transform::Log => (after / before).ln() / (upper / lower).ln(),
    }
}

/// Returns the elementary effects of a trajectory with these values, by free parameter.
fn elementary_effects(values: &[f64], steps: &[Step]) -> Vec<f64> {
    let mut effects = vec![f64::NAN; steps.len()];
    for (pair, step) in values.windows(2).zip(steps) {
        effects[step.parameter] = (pair[1] - pair[0]) / step.change;
    }
    effects
}

/// Returns the effects of `d` parameters on the values at the points of the complete trajectories.
pub(super) fn effects<'a>(
    trajectories: impl Iterator<Item = (&'a [f64], &'a [Step])>,
    d: usize,
    bootstrap: &Bootstrap,
) -> MorrisEffects {
    let rows: Vec<Vec<f64>> = trajectories.map(|(values, steps)| elementary_effects(values, steps)).collect();
    let spread = |k: usize| Spread::of(rows.iter().map(|row| row[k]));
    let n = rows.len() as f64;
    let mean_size = |k: usize| rows.iter().map(|row| row[k].abs()).sum::<f64>() / n;
    MorrisEffects {
        mu: (0..d).map(|k| rows.iter().map(|row| row[k]).sum::<f64>() / n).collect(),
        mu_star: (0..d).map(mean_size).collect(),
        sigma: (0..d).map(|k| spread(k).deviation()).collect(),
        mu_star_conf: bootstrap.half_widths(rows.len(), d, |resampled, mu_star| {
            for (k, mean) in mu_star.iter_mut().enumerate() {
                *mean = resampled.iter().map(|&row| rows[row][k].abs()).sum::<f64>() / n;
            }
        }),
    }
}

impl MorrisEffects {
    /// Returns NaN effects of a value with too few complete trajectories.
    pub(super) fn undefined(d: usize) -> Self {
        let nan = vec![f64::NAN; d];
        Self { mu: nan.clone(), mu_star: nan.clone(), sigma: nan.clone(), mu_star_conf: nan }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten trajectories on four levels from `SALib.sample.morris.sample` of SALib 1.6.0.
    #[rustfmt::skip]
    const LEVELS: [[u8; 3]; 40] = [
        [3, 3, 3], [3, 3, 1], [3, 1, 1], [1, 1, 1], [2, 2, 0], [2, 0, 0], [0, 0, 0], [0, 0, 2], [2, 3, 3], [0, 3, 3],
        [0, 1, 3], [0, 1, 1], [1, 1, 3], [1, 1, 1], [3, 1, 1], [3, 3, 1], [3, 1, 0], [3, 1, 2], [3, 3, 2], [1, 3, 2],
        [2, 0, 0], [0, 0, 0], [0, 0, 2], [0, 2, 2], [0, 3, 2], [2, 3, 2], [2, 3, 0], [2, 1, 0], [0, 0, 3], [2, 0, 3],
        [2, 2, 3], [2, 2, 1], [1, 1, 2], [1, 1, 0], [3, 1, 0], [3, 3, 0], [2, 0, 1], [2, 2, 1], [2, 2, 3], [0, 2, 3],
    ];

    /// The references come from `SALib.analyze.morris.analyze` with `num_resamples=20000`.
    #[test]
    fn morris_effects_equal_those_of_salib() {
        let points: Vec<[f64; 3]> = LEVELS.iter().map(|x| x.map(|level| f64::from(level) / 3.0)).collect();
        let values: Vec<f64> = points.iter().map(|x| x[0] * x[0] + x[0] * x[1] - 3.0 * x[2]).collect();
        let step = |pair: &[[f64; 3]]| {
            let change = |k: usize| pair[1][k] - pair[0][k];
            let parameter = (0..3).find(|&k| change(k) != 0.0).unwrap();
            Step { parameter, change: change(parameter) }
        };
        let steps: Vec<Step> = points.chunks(4).flat_map(|t| t.windows(2).map(step)).collect();
        let bootstrap = Bootstrap { level: 0.95, n_resamples: 20_000, seed: 1 };
        let found = effects(values.chunks(4).zip(steps.chunks(3)), 3, &bootstrap);
        let close = |found: &[f64], expected: [f64; 3], tolerance: f64| {
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() <= tolerance)
        };
        assert!(close(&found.mu, [1.4, 0.6666666666666666, -3.0], 1e-14), "{found:?}");
        assert!(close(&found.mu_star, [1.4, 0.6666666666666666, 3.0], 1e-14), "{found:?}");
        assert!(close(&found.sigma, [0.5621826951410451, 0.3849001794597504, 0.0], 1e-14), "{found:?}");
        // Five standard errors of the difference of two standard deviations from 20 000 draws: 2.5 %.
        assert!(
            close(&found.mu_star_conf, [0.3328394396606799, 0.2248747368607977, 0.0], 0.025 * 0.33),
            "{found:?}"
        );
    }
}
