//! Chain of an ensemble of walkers whose densities are simulated.

use super::density::LogDensity;
use super::options::{PosteriorOptions, WalkerStart};
use super::saved::SavedChain;
use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::parameter::{Scale, inner, outer};
use dfo::{EnsembleSampler, draw_seed, standard_normals, uniforms};
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Maximum number of times that the walkers without a density are drawn again.
const MOST_DRAWS: usize = 20;

/// Spread of the walkers of a parameter without a standard error, as a fraction of its typical size.
const SPREAD: f64 = 0.01;

/// A chain under way. Points are in the coordinates of the search, and contain only the free parameters.
pub(super) struct Chain<'a> {
    pub(super) calibration: &'a Calibration,
    pub(super) density: LogDensity,
    /// Values of all parameters; the values of free parameters are replaced.
    pub(super) x: Vec<f64>,
    pub(super) free: Vec<usize>,
    pub(super) simulations: Simulations<'a>,
    pub(super) saved: SavedChain,
}

impl Chain<'_> {
    /// Returns the log densities of points. A failed simulation has the density zero, and so has a point that
    /// violates a constraint.
    fn log_densities(&mut self, points: &[&[f64]]) -> Result<Vec<f64>, CalibrationError> {
        let parameters = self.calibration.parameters();
        let whole: Vec<Point> = (points.iter())
            .map(|point| {
                let mut x = self.x.clone();
                self.free.iter().zip(*point).for_each(|(i, u)| x[*i] = outer(&parameters[*i], *u));
                Point::new(x)
            })
            .collect();
        let constraints = self.calibration.constraints();
        let (places, allowed): (Vec<usize>, Vec<Point>) =
            whole.into_iter().enumerate().filter(|(_, point)| constraints.hold_at(&point.x)).unzip();
        let answers = self.simulations.residuals(&allowed)?;
        self.saved.n_simulations += answers.len();
        let mut found = vec![f64::NEG_INFINITY; points.len()];
        for ((answer, point), place) in answers.iter().zip(&allowed).zip(places) {
            match answer {
                Ok(residuals) => found[place] = self.density.at(parameters, &point.x, residuals),
                Err(_) => self.saved.n_failed += 1,
            }
        }
        Ok(found)
    }

    /// Draws the walkers and evaluates them. Walkers without a finite density are drawn again.
    pub(super) fn begin(
        &mut self,
        fit: &Fit,
        n_walkers: usize,
        options: &PosteriorOptions,
    ) -> Result<EnsembleSampler, CalibrationError> {
        let seed = options.seed.unwrap_or_else(draw_seed);
        let parameters = self.calibration.parameters();
        let bounds: (Vec<f64>, Vec<f64>) = self
            .free
            .iter()
            .map(|i| (&parameters[*i], fit.x[*i]))
            .map(|(p, x)| match p.cycle() {
                // One period around the fit contains each value once.
                Some(cycle) => (x - 0.5 * cycle.period(), x + 0.5 * cycle.period()),
                None => (inner(p, p.lower()), inner(p, p.upper())),
            })
            .unzip();
        let (lower, upper) = &bounds;
        if options.start == WalkerStart::Box
            && let Some(k) = (0..lower.len()).find(|&k| !(upper[k] - lower[k]).is_finite())
        {
            let name = parameters[self.free[k]].name().to_owned();
            let message =
                "it has no finite bounds, so walkers cannot start in the whole box. Set both bounds"
                    .to_owned();
            return Err(CalibrationError::Parameter { name, message });
        }
        let center = DVector::from_iterator(
            self.free.len(),
            self.free.iter().map(|i| inner(&parameters[*i], fit.x[*i])),
        );
        let root = self.root_of_covariance(fit);
        let draw = |index: usize| -> Vec<f64> {
            let n = lower.len();
            match options.start {
                WalkerStart::Box => {
                    let of_unit = uniforms(seed, index, n);
                    (0..n)
                        .map(|k| (lower[k] + (upper[k] - lower[k]) * of_unit[k]).clamp(lower[k], upper[k]))
                        .collect()
                }
                WalkerStart::Fit => {
                    let deviates = DVector::from_vec(standard_normals(seed, index, n));
                    let point = &center + &root * deviates;
                    // Points beyond a bound are mirrored at it, so that walkers do not start at equal values.
                    (0..n).map(|k| mirrored(point[k], lower[k], upper[k])).collect()
                }
            }
        };
        let (mut walkers, mut log_densities): (Vec<Vec<f64>>, Vec<f64>) = (Vec::new(), Vec::new());
        for round in 0..MOST_DRAWS {
            let missing = n_walkers - walkers.len();
            if missing == 0 {
                break;
            }
            let points: Vec<Vec<f64>> = (0..missing).map(|k| draw(round * n_walkers + k)).collect();
            let answers = self.log_densities(&points.iter().map(Vec::as_slice).collect::<Vec<_>>())?;
            for (point, log_density) in points.into_iter().zip(answers).filter(|(_, value)| value.is_finite())
            {
                walkers.push(point);
                log_densities.push(log_density);
            }
        }
        if walkers.len() < n_walkers {
            return Err(CalibrationError::Setup(format!(
                "only {} of {} points at the start could be simulated. Narrow the bounds, or start the walkers at the fit",
                walkers.len(),
                MOST_DRAWS * n_walkers
            )));
        }
        Ok(EnsembleSampler::new(&walkers, &log_densities, bounds, Some(seed))?)
    }

    /// Returns a square root of the covariance of the fit, in the coordinates of the search. Parameters
    /// without a finite standard error are independent and have a small fraction of their size.
    fn root_of_covariance(&self, fit: &Fit) -> DMatrix<f64> {
        let (n_all, parameters) = (fit.x.len(), self.calibration.parameters());
        let uncertainty = fit.uncertainty.as_ref();
        let sd = |i: usize| -> f64 {
            let p = &parameters[i];
            let (x, size) = (fit.x[i], self.calibration.size_of(p, fit.x[i]));
            let found = uncertainty.map_or(f64::NAN, |u| u.standard_errors[i]);
            let found = if found.is_finite() && found > 0.0 { found } else { SPREAD * size };
            // The derivative of the logarithm.
            if p.scale_kind() == Scale::Log { found / x } else { found }
        };
        let correlation = |i: usize, k: usize| match uncertainty.map(|u| u.correlation[i * n_all + k]) {
            _ if i == k => 1.0,
            Some(found) if found.is_finite() => found,
            _ => 0.0,
        };
        let n = self.free.len();
        let of_free = DMatrix::from_fn(n, n, |a, b| correlation(self.free[a], self.free[b]));
        let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(of_free);
        let roots = eigenvalues.map(|value: f64| value.max(0.0).sqrt());
        let mut root = eigenvectors * DMatrix::from_diagonal(&roots);
        for (a, mut row) in root.row_iter_mut().enumerate() {
            row *= sd(self.free[a]);
        }
        root
    }

    /// Moves the walkers until the chain has this number of steps. Returns true if it was interrupted.
    pub(super) fn advance(
        &mut self,
        sampler: &mut EnsembleSampler,
        n_steps: usize,
        progress: &mut dyn FnMut(usize),
    ) -> Result<bool, CalibrationError> {
        let mut is_interrupted = false;
        while sampler.n_steps() < n_steps && !is_interrupted {
            match self.log_densities(&sampler.ask()) {
                Ok(answers) => sampler.tell(&answers)?,
                Err(CalibrationError::Cancelled) => is_interrupted = true,
                Err(e) => return Err(e),
            }
            if !is_interrupted && sampler.is_at_step() {
                self.record(sampler);
                progress(sampler.n_steps());
                self.saved.write_at_times(sampler);
            }
        }
        self.saved.write(sampler);
        Ok(is_interrupted)
    }

    /// Appends the walkers to the chain, in the user's units.
    fn record(&mut self, sampler: &EnsembleSampler) {
        let parameters = self.calibration.parameters();
        for walker in sampler.walkers() {
            let x = self.free.iter().zip(walker).map(|(i, u)| outer(&parameters[*i], *u));
            self.saved.draws.extend(x);
        }
        self.saved.log_densities.extend_from_slice(sampler.log_densities());
    }
}

/// Mirrors a value at the bounds. A value that is still outside moves to the nearest bound.
fn mirrored(value: f64, lower: f64, upper: f64) -> f64 {
    let inside = if value < lower { 2.0 * lower - value } else { value };
    let inside = if inside > upper { 2.0 * upper - inside } else { inside };
    inside.clamp(lower, upper)
}
