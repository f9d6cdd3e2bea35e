//! Designs: the points at which a function is evaluated, and the estimates from its values.

use super::bootstrap::Bootstrap;
use super::evaluations::Evaluations;
use super::listed_points::ListedPoints;
use super::method::SensitivityMethod;
use super::morris::{self, MorrisEffects, Step};
use super::result::{Effects, IntervalOptions, OutputEffects, Sensitivity};
use super::sobol::{self, SobolIndices};
use crate::error::Error;
use crate::method_interface::rng::draw_seed;
use crate::problem::space::{Bounds, Space};
use crate::run::minimize::Minimize;
use crate::run::report::Report;
use crate::values::choices::{ParameterKind, Transform};

/// Maximum number of coordinates of all points, which take 2 GiB.
const MOST_COORDINATES: usize = 1 << 28;

/// The points of a sensitivity analysis. Parameters are sampled uniformly on their scale, linear or
/// logarithmic. Discrete parameters are rounded so that each integer has an equal share.
///
/// ```
/// use dfo::{Bounds, Effects, SensitivityDesign, SensitivityMethod, IntervalOptions, minimize, residuals};
///
/// // Two values: a sum, whose variance is a quarter of each square, and a product.
/// let function = |x: &[f64], out: &mut Vec<f64>| out.extend([x[0] + 2.0 * x[1], x[0] * x[1]]);
/// let bounds = Bounds::new(&[0.0, 0.0], &[1.0, 1.0])?;
/// let design = SensitivityDesign::new(bounds, &[], &[], SensitivityMethod::SOBOL, Some(1))?;
/// let evaluations = design.evaluate(minimize(residuals(function)).workers(2))?;
/// let names = (&["a", "b"], &["sum", "product"]);
/// let found = design.analyze(&evaluations, names.0, names.1, IntervalOptions::default())?;
/// let Effects::Sobol(sum) = &found.outputs[0].effects else { unreachable!() };
/// assert!((sum.s1[0] - 0.2).abs() < sum.s1_conf[0] && (sum.s1[1] - 0.8).abs() < sum.s1_conf[1]);
/// assert_eq!(found.n_evaluations, 1024 * 4);
/// println!("{found}");
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SensitivityDesign {
    method: SensitivityMethod,
    space: Space,
    seed: u64,
    points: Vec<f64>,
    /// Steps of all trajectories; empty for Sobol' indices.
    steps: Vec<Step>,
}

impl SensitivityDesign {
    /// Creates the points. `transforms` and `kinds` may be empty: all linear, all continuous. Without a seed,
    /// it draws one; see [`seed`](Self::seed).
    ///
    /// # Errors
    /// Returns an error if a bound is infinite, if a logarithmic parameter is not positive, or if lengths
    /// differ. Also returns an error if no parameter is free, if a free parameter has a single value, or if
    /// the numbers of the method are out of range. Morris screening does not support categorical parameters.
    pub fn new(
        bounds: Bounds,
        transforms: &[Transform],
        kinds: &[ParameterKind],
        method: SensitivityMethod,
        seed: Option<u64>,
    ) -> Result<Self, Error> {
        let space = space(bounds, transforms, kinds, method.name())?;
        let (SensitivityMethod::Morris { n, .. } | SensitivityMethod::Sobol { n, .. }) = method;
        if n < 2 {
            return Err(Error::Option { name: "n", value: n as f64, range: "at least 2" });
        }
        if n > MOST_COORDINATES / (method.row_length(space.n_free()) * space.n()) {
            let range = "smaller: all points have at most 2^28 coordinates";
            return Err(Error::Option { name: "n", value: n as f64, range });
        }
        let seed = seed.unwrap_or_else(draw_seed);
        let (points, steps) = match method {
            SensitivityMethod::Morris { n, levels } => morris::trajectories(&space, n, levels, seed)?,
            SensitivityMethod::Sobol { n, second_order } => {
                (sobol::rows(&space, n, second_order, seed)?, Vec::new())
            }
        };
        Ok(Self { method, space, seed, points, steps })
    }

    /// Returns the method.
    pub fn method(&self) -> SensitivityMethod {
        self.method
    }

    /// Returns the seed of the random numbers.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Returns the points, in the user's units.
    pub fn points(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.points.chunks_exact(self.space.n())
    }

    /// Returns the indices of the free parameters.
    pub fn free(&self) -> &[usize] {
        self.space.free()
    }

    /// Evaluates all points in a run, which provides the function, the workers, the context, a time limit and
    /// the checkpoint. The function is an objective with residuals, which are the values. A point at which it
    /// fails has no values. A value that is not finite is missing. Neither is replaced.
    ///
    /// A run that is interrupted or out of time returns the values so far; see [`Evaluations::termination`].
    ///
    /// # Errors
    /// Returns an error if the checkpoint cannot be used, or if the number of values changes.
    pub fn evaluate<M>(&self, run: Minimize<'_, M>) -> Result<Evaluations, Error> {
        let (lower, upper) = (self.space.bounds().lower(), self.space.bounds().upper());
        let run = run.bounds(lower, upper)?.method(self.listed()).unlimited().trace_residuals();
        self.evaluations(run.run())
    }

    /// Returns the method of a run that evaluates all points. Its trace must contain the residuals.
    pub fn listed(&self) -> ListedPoints {
        ListedPoints::new(self.points.clone(), self.space.n())
    }

    /// Reads the values at the points from the result of a run with [`listed`](Self::listed).
    ///
    /// # Errors
    /// Returns the error of the run, unless it ended before any point had all values.
    pub fn evaluations(&self, run: Result<Report, Error>) -> Result<Evaluations, Error> {
        Evaluations::of(run, self.points())
    }

    /// Estimates the effects of the parameters from the values at the points. `parameters` are the names of
    /// all parameters, `outputs` the names of the values.
    ///
    /// A trajectory or row in which a value is missing is left out of the estimates of this value.
    ///
    /// # Errors
    /// Returns an error if names or values have the wrong number, or if an option is out of range. Also
    /// returns an error if fewer than two complete trajectories or rows remain for every value.
    pub fn analyze(
        &self,
        evaluations: &Evaluations,
        parameters: &[impl AsRef<str>],
        outputs: &[impl AsRef<str>],
        options: IntervalOptions,
    ) -> Result<Sensitivity, Error> {
        options.check()?;
        let length = |what, expected, got| Err(Error::Length { what, expected, got });
        if parameters.len() != self.space.n() {
            return length("names of the parameters", self.space.n(), parameters.len());
        }
        let values = &evaluations.values;
        if values.len() != self.points().len() {
            let range = "the number of points";
            return Err(Error::Option { name: "number of values", value: values.len() as f64, range });
        }
        if let Some(other) = values.iter().find(|row| !row.is_empty() && row.len() != outputs.len()) {
            let range = "the number of names";
            return Err(Error::Option {
                name: "number of values of a point",
                value: other.len() as f64,
                range,
            });
        }
        let bootstrap = Bootstrap { level: options.level, n_resamples: options.n_resamples, seed: self.seed };
        let of_output = |(k, name)| self.effects(values, k, name, &bootstrap);
        let outputs: Vec<OutputEffects> =
            outputs.iter().map(|name| name.as_ref().to_owned()).enumerate().map(of_output).collect();
        if outputs.iter().all(|output| output.n_used < 2) {
            let left = outputs.iter().map(|output| output.n_used).max().unwrap_or(0);
            let reason = evaluations.failures.first().map(|(reason, _)| reason.clone());
            return Err(Error::TooFewValues { rows: self.method.rows(), left, reason });
        }
        Ok(Sensitivity {
            method: self.method,
            parameters: self.free().iter().map(|&i| parameters[i].as_ref().to_owned()).collect(),
            outputs,
            level: options.level,
            seed: self.seed,
            n_evaluations: evaluations.n_evaluations,
            n_failed: evaluations.n_failed,
            n_missing: evaluations.n_missing,
            failures: evaluations.failures.clone(),
            points: self.points().map(<[f64]>::to_vec).collect(),
            values: evaluations.values.clone(),
        })
    }

    /// Estimates the effects on value `k`.
    fn effects(&self, values: &[Vec<f64>], k: usize, name: String, bootstrap: &Bootstrap) -> OutputEffects {
        let d = self.free().len();
        let length = self.method.row_length(d);
        let column: Vec<f64> = values.iter().map(|row| row.get(k).copied().unwrap_or(f64::NAN)).collect();
        let is_complete = |row: &[f64]| row.iter().all(|value| value.is_finite());
        let rows = || column.chunks_exact(length);
        let n_rows = rows().len();
        let n_used = rows().filter(|row| is_complete(row)).count();
        let too_few = (n_used < 2).then(|| {
            let rows = self.method.rows();
            format!("{n_used} of {n_rows} {rows} have all values; at least 2 are required")
        });
        let (effects, reason) = match self.method {
            SensitivityMethod::Morris { .. } if too_few.is_some() => {
                (Effects::Morris(MorrisEffects::undefined(d)), too_few)
            }
            SensitivityMethod::Morris { .. } => {
                let complete = rows().zip(self.steps.chunks_exact(d)).filter(|(row, _)| is_complete(row));
                (Effects::Morris(morris::effects(complete, d, bootstrap)), None)
            }
            SensitivityMethod::Sobol { second_order, .. } => {
                let complete = rows().filter(|row| is_complete(row)).flatten().copied().collect();
                let found = match too_few {
                    Some(_) => None,
                    None => sobol::indices(complete, d, second_order, bootstrap),
                };
                let constant = || "the value is the same at all points, so it has no variance".to_owned();
                let reason = found.is_none().then(|| too_few.unwrap_or_else(constant));
                (Effects::Sobol(found.unwrap_or_else(|| SobolIndices::undefined(d, second_order))), reason)
            }
        };
        OutputEffects { name, n_used, n_left_out: n_rows - n_used, reason, effects }
    }
}

/// Returns the space of the parameters, all of which have finite bounds and two values or more.
fn space(
    bounds: Bounds,
    transforms: &[Transform],
    kinds: &[ParameterKind],
    method: &'static str,
) -> Result<Space, Error> {
    let ends: Vec<(f64, f64)> = bounds.lower().iter().copied().zip(bounds.upper().iter().copied()).collect();
    for (index, (lower, upper)) in ends.iter().copied().enumerate() {
        if lower != upper && !(upper - lower).is_finite() {
            return Err(Error::NeedsBox { method, index, lower, upper });
        }
    }
    let is_discrete = |i: usize| kinds.get(i).is_some_and(|kind| *kind != ParameterKind::Continuous);
    let start = |(i, (lower, upper)): (usize, &(f64, f64))| {
        if lower != upper && is_discrete(i) { lower.ceil().min(*upper) } else { *lower }
    };
    let x0: Vec<f64> = ends.iter().enumerate().map(start).collect();
    let mut space = Space::new(&x0, bounds, transforms, &[])?;
    if !kinds.is_empty() {
        space = space.with_kinds(kinds)?;
    }
    for &index in space.free() {
        let (lower, upper) = ends[index];
        if is_discrete(index) && lower.ceil() == upper.floor() {
            let range = "more than one integer, unless the parameter is fixed";
            let value = upper.floor() - lower.ceil() + 1.0;
            return Err(Error::ParameterOption { name: "number of integers", index, value, range });
        }
    }
    if space.n_free() == 0 {
        let range = "at least 1. Set different lower and upper bounds";
        return Err(Error::Option { name: "number of free parameters", value: 0.0, range });
    }
    Ok(space)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method_interface::sampling::SOBOL_DIMENSIONS;
    use crate::outcome::answer::Outcome;
    use crate::outcome::termination::Termination;
    use crate::problem::objective::{Query, ResidualFunction, residuals};
    use crate::run::checkpoint::Checkpoint;
    use crate::run::minimize::{minimize, minimize_batches};
    use std::f64::consts::PI;
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

    fn design(lower: &[f64], upper: &[f64], method: SensitivityMethod, seed: u64) -> SensitivityDesign {
        SensitivityDesign::new(Bounds::new(lower, upper).unwrap(), &[], &[], method, Some(seed)).unwrap()
    }

    fn names(n: usize) -> Vec<String> {
        (0..n).map(|i| format!("x{i}")).collect()
    }

    /// Evaluates the values of a function and returns the effects.
    fn found(design: &SensitivityDesign, function: impl ResidualFunction, n_values: usize) -> Sensitivity {
        let evaluations = design.evaluate(minimize(residuals(function))).unwrap();
        analyzed(design, &evaluations, n_values).unwrap()
    }

    fn analyzed(
        design: &SensitivityDesign,
        evaluations: &Evaluations,
        n_values: usize,
    ) -> Result<Sensitivity, Error> {
        let parameters = names(design.space.n());
        design.analyze(evaluations, &parameters, &names(n_values), IntervalOptions::default())
    }

    fn indices(found: &Sensitivity, k: usize) -> &SobolIndices {
        match &found.outputs[k].effects {
            Effects::Sobol(indices) => indices,
            Effects::Morris(_) => panic!("not Sobol' indices"),
        }
    }

    fn effects(found: &Sensitivity, k: usize) -> &MorrisEffects {
        match &found.outputs[k].effects {
            Effects::Morris(effects) => effects,
            Effects::Sobol(_) => panic!("not Morris effects"),
        }
    }

    fn linear(x: &[f64], out: &mut Vec<f64>) {
        out.extend([2.0 * x[0] - 3.0 * x[1] + 0.0 * x[2], x[2] * x[2]]);
    }

    /// Ishigami's function with a = 7, b = 0.1 (Ishigami and Homma, ISUMA 1990).
    fn ishigami(x: &[f64], out: &mut Vec<f64>) {
        out.push(x[0].sin() + 7.0 * x[1].sin().powi(2) + 0.1 * x[2].powi(4) * x[0].sin());
    }

    /// Closed forms of Ishigami's function: first, total and second order (of the pairs 0-1, 0-2, 1-2).
    fn ishigami_indices() -> [[f64; 3]; 3] {
        let (a, b) = (7.0f64, 0.1f64);
        let v1 = 0.5 * (1.0 + b * PI.powi(4) / 5.0).powi(2);
        let v2 = a * a / 8.0;
        let v13 = 8.0 * b * b * PI.powi(8) / 225.0;
        let v = v1 + v2 + v13;
        [[v1 / v, v2 / v, 0.0], [(v1 + v13) / v, v2 / v, v13 / v], [0.0, v13 / v, 0.0]]
    }

    const G: [f64; 8] = [0.0, 1.0, 4.5, 9.0, 99.0, 99.0, 99.0, 99.0];

    /// Sobol's g-function (Saltelli and Sobol', Mat. Model. 7, 1995).
    fn g_function(x: &[f64], out: &mut Vec<f64>) {
        out.push(x.iter().zip(G).map(|(x, a)| ((4.0 * x - 2.0).abs() + a) / (1.0 + a)).product());
    }

    /// Closed forms of the g-function: first and total order.
    fn g_indices() -> [Vec<f64>; 2] {
        let parts = G.map(|a| 1.0 / 3.0 / (1.0 + a).powi(2));
        let all: f64 = parts.iter().map(|v| 1.0 + v).product();
        let total = |v: &f64| v * all / (1.0 + v) / (all - 1.0);
        [parts.iter().map(|v| v / (all - 1.0)).collect(), parts.iter().map(total).collect()]
    }

    /// Counts the indices within their intervals, and all indices.
    fn covered(counts: &mut (usize, usize), found: &[f64], widths: &[f64], expected: &[f64]) {
        for ((found, width), expected) in found.iter().zip(widths).zip(expected) {
            counts.0 += usize::from((found - expected).abs() <= *width);
            counts.1 += 1;
        }
    }

    /// The bootstrap assumes independent points. Sobol points are more even, so the indices are nearer to the
    /// closed forms than the intervals state.
    #[test]
    fn sobol_intervals_contain_closed_forms_of_ishigami() {
        let [first, total, second] = ishigami_indices();
        let mut counts = (0, 0);
        for seed in 0..20 {
            let method = SensitivityMethod::Sobol { n: 512, second_order: true };
            let found = found(&design(&[-PI; 3], &[PI; 3], method, seed), ishigami, 1);
            let found = indices(&found, 0);
            let pairs = |matrix: &[f64]| [matrix[1], matrix[2], matrix[5]];
            covered(&mut counts, &found.s1, &found.s1_conf, &first);
            covered(&mut counts, &found.st, &found.st_conf, &total);
            covered(&mut counts, &pairs(&found.s2), &pairs(&found.s2_conf), &second);
        }
        assert!(counts.0 as f64 >= 0.95 * counts.1 as f64, "{counts:?}");
    }

    #[test]
    fn sobol_intervals_contain_closed_forms_of_the_g_function() {
        let [first, total] = g_indices();
        let mut counts = (0, 0);
        for seed in 0..20 {
            let method = SensitivityMethod::Sobol { n: 512, second_order: false };
            let found = found(&design(&[0.0; 8], &[1.0; 8], method, seed), g_function, 1);
            let found = indices(&found, 0);
            covered(&mut counts, &found.s1, &found.s1_conf, &first);
            covered(&mut counts, &found.st, &found.st_conf, &total);
        }
        assert!(counts.0 as f64 >= 0.95 * counts.1 as f64, "{counts:?}");
    }

    #[test]
    fn morris_effects_of_a_linear_function_are_its_slopes() {
        let method = SensitivityMethod::Morris { n: 8, levels: 4 };
        let found = found(&design(&[0.0; 3], &[3.0; 3], method, 1), linear, 2);
        assert_eq!((found.n_evaluations, found.outputs[0].n_used), (8 * 4, 8));
        let linear = effects(&found, 0);
        for (mu, slope) in linear.mu.iter().zip([6.0, -9.0, 0.0]) {
            assert!((mu - slope).abs() <= 4.0 * f64::EPSILON * slope.abs(), "{found}");
        }
        assert!(linear.sigma.iter().chain(&linear.mu_star_conf).all(|width| *width < 1e-14), "{found}");
        let square = effects(&found, 1);
        assert!(square.mu[2] > 0.0 && square.sigma[2] > 0.0 && square.mu_star_conf[2] > 0.0, "{found}");
    }

    #[test]
    fn designs_have_the_numbers_of_points_of_salib() {
        let count = |method| design(&[0.0; 5], &[1.0; 5], method, 1).points().len();
        assert_eq!(count(SensitivityMethod::Morris { n: 7, levels: 4 }), 7 * 6);
        assert_eq!(count(SensitivityMethod::Sobol { n: 16, second_order: false }), 16 * 7);
        assert_eq!(count(SensitivityMethod::Sobol { n: 16, second_order: true }), 16 * 12);
    }

    #[test]
    fn trajectories_change_every_parameter_once_by_the_step_of_the_grid() {
        let design = design(&[0.0; 4], &[1.0; 4], SensitivityMethod::Morris { n: 50, levels: 6 }, 1);
        let points: Vec<&[f64]> = design.points().collect();
        for trajectory in points.chunks(5) {
            let mut changed = [0; 4];
            for pair in trajectory.windows(2) {
                for k in (0..4).filter(|&k| pair[0][k] != pair[1][k]) {
                    changed[k] += 1;
                    assert!(((pair[1][k] - pair[0][k]).abs() - 0.6).abs() < 1e-15);
                }
            }
            assert_eq!(changed, [1; 4]);
            assert!(
                trajectory.iter().copied().flatten().all(|x| ((5.0 * x).round() - 5.0 * x).abs() < 1e-15)
            );
        }
    }

    #[test]
    fn results_are_identical_for_any_number_of_workers() {
        for method in [
            SensitivityMethod::Morris { n: 20, levels: 4 },
            SensitivityMethod::Sobol { n: 64, second_order: true },
        ] {
            let design = design(&[0.0; 3], &[1.0; 3], method, 3);
            let results = [1, 4].map(|workers| {
                let evaluations = design.evaluate(minimize(residuals(linear)).workers(workers)).unwrap();
                analyzed(&design, &evaluations, 2).unwrap()
            });
            // NaN differs from itself.
            assert_eq!(format!("{:?}", results[0]), format!("{:?}", results[1]));
        }
    }

    #[test]
    fn logarithmic_and_discrete_parameters_are_sampled_on_their_scale() {
        let bounds = Bounds::new(&[1e-3, 0.5], &[1e3, 3.5]).unwrap();
        let (scales, kinds) =
            ([Transform::Log, Transform::Linear], [ParameterKind::Continuous, ParameterKind::Integer]);
        for method in [
            SensitivityMethod::Morris { n: 30, levels: 4 },
            SensitivityMethod::Sobol { n: 256, second_order: false },
        ] {
            let design = SensitivityDesign::new(bounds.clone(), &scales, &kinds, method, Some(1)).unwrap();
            let below = design.points().filter(|x| x[0] < 1.0).count() as f64 / design.points().len() as f64;
            assert!((below - 0.5).abs() < 0.1, "{below}");
            assert!(design.points().all(|x| x[1] == x[1].round() && (1.0..=3.0).contains(&x[1])));
            let function = |x: &[f64], out: &mut Vec<f64>| out.push(x[0].log10() + 3.0 * x[1]);
            let found = found(&design, function, 1);
            match &found.outputs[0].effects {
                // Both effects are 6 over the range.
                Effects::Morris(found) => {
                    assert!(found.mu.iter().all(|mu| (mu - 6.0).abs() < 1e-13), "{found:?}")
                }
                // The variances are 6^2 / 12 and, of three equally likely values, 6.
                Effects::Sobol(found) => {
                    assert!((found.st[0] - 1.0 / 3.0).abs() < found.st_conf[0], "{found:?}");
                    assert!((found.st[1] - 2.0 / 3.0).abs() < found.st_conf[1], "{found:?}");
                }
            }
        }
    }

    #[test]
    fn fixed_parameters_have_no_effect_and_no_points() {
        let design =
            design(&[0.0, 2.0, 0.0], &[1.0, 2.0, 1.0], SensitivityMethod::Morris { n: 4, levels: 4 }, 1);
        assert!(design.points().all(|x| x[1] == 2.0));
        let found = found(&design, linear, 2);
        assert_eq!(
            (found.parameters.as_slice(), found.n_evaluations),
            (&["x0".to_owned(), "x2".to_owned()][..], 4 * 3)
        );
        assert_eq!(effects(&found, 0).mu.len(), 2);
    }

    #[test]
    fn constant_value_has_nan_indices_with_a_reason() {
        let design = design(&[0.0; 2], &[1.0; 2], SensitivityMethod::Sobol { n: 8, second_order: true }, 1);
        let found = found(&design, |x: &[f64], out: &mut Vec<f64>| out.extend([0.1, x[0]]), 2);
        let constant = indices(&found, 0);
        assert!(constant.s1.iter().chain(&constant.st_conf).chain(&constant.s2).all(|v| v.is_nan()));
        assert!(found.outputs[0].reason.as_ref().unwrap().contains("no variance"), "{found}");
        assert!(found.outputs[1].reason.is_none() && indices(&found, 1).s1[0] > 0.5, "{found}");
    }

    /// Fails in a part of the box, and lacks the second value in another part.
    struct Failing;

    impl ResidualFunction for Failing {
        fn residuals(&self, x: &[f64], _: &Query<'_>, out: &mut Vec<f64>) -> Result<(), Outcome> {
            if x[0] > 0.9 {
                return Err(Outcome::failed("diverged"));
            }
            out.extend([x[0] + x[1], if x[1] > 0.8 { f64::NAN } else { x[1] }]);
            Ok(())
        }
    }

    #[test]
    fn rows_with_missing_values_are_left_out_and_counted() {
        let design =
            design(&[0.0; 2], &[1.0; 2], SensitivityMethod::Sobol { n: 256, second_order: false }, 1);
        let found = found(&design, Failing, 2);
        let [sum, second] = &found.outputs[..] else { panic!("{found}") };
        // A row contains two values of each coordinate.
        let expected = |part: f64| (256.0 * part).round();
        assert!((sum.n_used as f64 - expected(0.81)).abs() < 8.0, "{found}");
        assert!((second.n_used as f64 - expected(0.81 * 0.64)).abs() < 8.0, "{found}");
        assert_eq!(sum.n_used + sum.n_left_out, 256);
        assert!(found.failures.iter().any(|(reason, _)| reason == "diverged"), "{found}");
        assert!(found.failures.iter().any(|(reason, _)| reason == "value 1 is NaN"), "{found}");
        assert_eq!(found.failures.iter().map(|(_, count)| count).sum::<usize>(), found.n_failed);
        assert!(indices(&found, 1).s1[0].abs() < 0.1 && indices(&found, 1).s1[1] > 0.9, "{found}");
    }

    #[test]
    fn too_few_rows_are_an_error_with_the_reason() {
        let design = design(&[0.0; 2], &[1.0; 2], SensitivityMethod::MORRIS, 1);
        let evaluations = design
            .evaluate(minimize_batches(|batch| vec![Outcome::failed("diverged"); batch.len()]))
            .unwrap();
        assert_eq!((evaluations.n_failed, evaluations.n_missing), (30, 0));
        let error = analyzed(&design, &evaluations, 1).unwrap_err().to_string();
        assert!(error.contains("0 complete trajectories") && error.contains("diverged"), "{error}");
    }

    #[test]
    fn invalid_designs_are_rejected() {
        let new = |lower: &[f64], upper: &[f64], kinds: &[ParameterKind], method| {
            let bounds = Bounds::new(lower, upper).unwrap();
            SensitivityDesign::new(bounds, &[], kinds, method, Some(1)).unwrap_err().to_string()
        };
        let morris = SensitivityMethod::MORRIS;
        assert!(new(&[0.0], &[f64::INFINITY], &[], morris).contains("morris requires finite bounds"));
        assert!(new(&[1.0], &[1.0], &[], morris).contains("free parameters"));
        assert!(new(&[0.0], &[1.0], &[], SensitivityMethod::Morris { n: 4, levels: 5 }).contains("levels"));
        assert!(new(&[0.0], &[1.0], &[], SensitivityMethod::Morris { n: 1, levels: 4 }).contains("n = 1"));
        assert!(new(&[0.5], &[1.5], &[ParameterKind::Integer], morris).contains("number of integers"));
        assert!(new(&[0.0], &[3.0], &[ParameterKind::Categorical], morris).contains("categorical"));
        let n = SOBOL_DIMENSIONS / 2 + 1;
        assert!(new(&vec![0.0; n], &vec![1.0; n], &[], SensitivityMethod::SOBOL).contains("at most 20"));
    }

    #[test]
    fn interrupted_evaluations_are_kept_and_resumed() {
        let folder = tempfile::tempdir().unwrap();
        let file = || Checkpoint::new(folder.path().join("sensitivity"));
        let design = design(&[0.0; 2], &[1.0; 2], SensitivityMethod::Sobol { n: 16, second_order: false }, 1);
        let (count, is_over) = (AtomicUsize::new(0), AtomicBool::new(false));
        let function = |x: &[f64], out: &mut Vec<f64>| {
            out.push(x[0] - x[1]);
            if count.fetch_add(1, Ordering::Relaxed) == 20 {
                is_over.store(true, Ordering::Relaxed);
            }
        };
        let context = base::RunContext::new().flagged(&is_over);
        let first =
            design.evaluate(minimize(residuals(function)).context(context).checkpoint(file())).unwrap();
        assert_eq!(
            (first.termination.clone(), first.n_missing),
            (Termination::Interrupted, 64 - 21),
            "{first:?}"
        );
        let partial = analyzed(&design, &first, 1).unwrap();
        assert_eq!((partial.outputs[0].n_used, partial.n_missing), (5, 43), "{partial}");
        is_over.store(false, Ordering::Relaxed);
        let second = design.evaluate(minimize(residuals(function)).checkpoint(file())).unwrap();
        assert_eq!((count.load(Ordering::Relaxed), second.n_missing), (64, 0));
        let whole = design.evaluate(minimize(residuals(function))).unwrap();
        assert_eq!(whole.values, second.values);
        // A finished file returns its values.
        let third = design.evaluate(minimize(residuals(function)).checkpoint(file())).unwrap();
        assert_eq!((third.values, count.load(Ordering::Relaxed)), (whole.values, 128));
    }
}
