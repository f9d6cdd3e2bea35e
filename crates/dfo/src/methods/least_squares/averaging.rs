//! Steps on regression models of all nearby points, for residuals with noise. With more points, less noise
//! remains in the model.

use super::model::Regression;
use super::points::{difference, distance, norm, sum};
use super::state::{Averaging, Candidate, LeastSquaresState, Phase, PointStatus, Role};
use crate::method_interface::interface::Operation;
use crate::outcome::termination::Termination;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Maximum radius in units of the first one, and minimum radius.
const WIDEST: f64 = 10.0;
const SMALLEST: f64 = 1e-15;
/// Minimum initial radius, in units of the first one.
const SMALLEST_SHARE: f64 = 1e-9;
/// F statistics of the second-degree terms. Above `BENT`, the radius shrinks; below `STRAIGHT`, it may grow.
const BENT: f64 = 4.0;
const STRAIGHT: f64 = 1.5;
/// Predicted decrease up to which the run may end, in units of the best cost.
const LITTLE: f64 = 0.05;
/// Minimum number of points requested after noise was found before the run may end, in units of n + 1.
const FEWEST: usize = 5;
/// Number of points without a better one after which the run always ends, in units of n + 1. Residuals may
/// jump, for example if a simulation selects its steps again. Jumps are not noise about a model, and the
/// predictions then never become small.
const MOST_WITHOUT_GAIN: usize = 50;
/// Maximum number of sweeps per eigenvalue. A few are enough.
const MOST_SWEEPS: usize = 100;

impl LeastSquaresState {
    /// Returns the points around the centre with their weights, nearest first. These are all points within
    /// two radii, and more if a model needs them.
    fn around(&self, averaging: &Averaging) -> Vec<(usize, f64)> {
        let far = |k: usize| distance(&self.points[k].z, &averaging.centre) / (2.0 * averaging.radius);
        let mut near: Vec<(usize, f64)> = (0..self.points.len()).map(|k| (k, far(k))).collect();
        near.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let inside = near.iter().filter(|(_, far)| *far < 1.0).count();
        near.truncate(inside.max(3 * (self.n() + 1)));
        let reach = near.last().map_or(1.0, |(_, far)| far.max(1.0) * 1.05);
        // Weights of local regression (Cleveland 1979).
        near.iter_mut().for_each(|(_, far)| *far = (1.0 - (*far / reach).powi(3)).powf(1.5));
        near
    }

    /// Starts with the largest radius within which the points do not contradict a linear model.
    pub(super) fn begin_averaging(&mut self) {
        let centre = self.points[self.base()].z.clone();
        let mut averaging = Averaging::new(&centre, self.options.radius);
        loop {
            let near = self.around(&averaging);
            let enough = near.len() > 3 * (self.n() + 1);
            let bent = self.regression(&averaging, &near).and_then(|regression| regression.bent);
            let is_least = averaging.radius < SMALLEST_SHARE * self.options.radius;
            if !enough || is_least || bent.is_some_and(|bent| bent < BENT) {
                break;
            }
            averaging.radius *= 0.7;
        }
        (self.halt, self.phase) = (None, Phase::Averaging(averaging));
    }

    fn weighted<'a>(
        &'a self,
        averaging: &Averaging,
        near: &[(usize, f64)],
    ) -> Vec<(Vec<f64>, f64, &'a [f64])> {
        let weighted = near.iter().map(|(k, weight)| {
            let point = &self.points[*k];
            (difference(&point.z, &averaging.centre), *weight, &point.residuals[..])
        });
        weighted.collect()
    }

    fn regression(&self, averaging: &Averaging, near: &[(usize, f64)]) -> Option<Regression> {
        Regression::new(&self.weighted(averaging, near))
    }

    /// Fills the round, or ends.
    pub(super) fn average(&mut self) {
        let Phase::Averaging(mut averaging) = self.phase.clone() else { return };
        let n = self.n();
        let near = self.around(&averaging);
        let weighted = self.weighted(&averaging, &near);
        let mut coverage = Coverage::new(n, averaging.radius);
        weighted.iter().for_each(|(w, weight, _)| coverage.add(w, *weight));
        let regression = Regression::new(&weighted);
        let mut trial = None;
        if let Some(regression) = &regression {
            match regression.bent {
                Some(bent) if bent > BENT && !regression.is_quadratic && near.len() > 3 * (n + 1) => {
                    averaging.radius *= 0.7;
                }
                Some(bent) if bent < STRAIGHT && averaging.n_requested % 2 == 1 => {
                    averaging.radius = (1.5 * averaging.radius).min(WIDEST * self.options.radius);
                }
                _ => {}
            }
            let room = self.room_around(&averaging.centre);
            let (step, predicted) = regression.minimise(averaging.radius, &room);
            averaging.centre = sum(&averaging.centre, &step);
            let best_point = self.best_of(0..self.points.len()).unwrap_or(0);
            let best = self.points[best_point].cost;
            // The noise limits the accuracy of the minimum, even if the points around it are spread widely.
            let x_size = averaging.radius.min(norm(&step) + regression.uncertainty(&step));
            self.tests = Some(self.judge(x_size, predicted, best));
            let tolerances = &self.setup.tolerances;
            let may_end = tolerances.x_tol > 0.0 || tolerances.f_tol > 0.0;
            let is_straight = regression.is_quadratic || regression.bent.is_some_and(|bent| bent < BENT);
            let most = (3.0 * regression.excess).min(LITTLE * best);
            // Include decreases beyond the radius.
            let wide = averaging.radius.max(self.options.radius);
            let is_reliable = is_straight && averaging.n_requested >= FEWEST * (n + 1) && predicted <= most;
            let ends = is_reliable && regression.minimise(wide, &room).1 <= most;
            if may_end && (ends || self.is_halted(MOST_WITHOUT_GAIN)) {
                self.phase = Phase::Ended(self.end_in_noise(best_point));
                return;
            }
            trial = Some(Role::Trial { predicted, radius: averaging.radius });
        }
        if averaging.radius < SMALLEST {
            self.phase = Phase::Ended(Termination::Collapsed);
            return;
        }
        // Alternate between the trial point and a point that improves the model. Several points at once would
        // be requested before the first one gives information on the noise.
        match trial.filter(|_| averaging.n_requested.is_multiple_of(2)) {
            Some(role) => self.ask_for(averaging.centre.clone(), role),
            None => {
                let v = self.fitted(&averaging.centre, &coverage.least(), averaging.radius);
                self.ask_for(sum(&averaging.centre, &v), Role::Near);
            }
        }
        averaging.n_requested += 1;
        self.phase = Phase::Averaging(averaging);
    }

    /// Updates the state after a round.
    pub(super) fn averaged(&mut self, round: &[Candidate]) {
        self.n_iterations += 1;
        self.operation = Some(Operation::TrustRegionStep);
        let failed = round.iter().any(|candidate| candidate.status == PointStatus::Failed);
        let Some(best) = self.best_of(0..self.points.len()) else { return };
        self.look_for_progress(best);
        if let (Phase::Averaging(averaging), true) = (&mut self.phase, failed) {
            averaging.radius *= 0.5;
            averaging.centre.clone_from(&self.points[best].z);
        }
    }
}

/// Moments of the distribution of points around a centre.
struct Coverage {
    spread: DMatrix<f64>,
    mean: DVector<f64>,
    radius: f64,
}

impl Coverage {
    fn new(n: usize, radius: f64) -> Self {
        Self { spread: DMatrix::zeros(n, n), mean: DVector::zeros(n), radius }
    }

    fn add(&mut self, w: &[f64], weight: f64) {
        let w = DVector::from_column_slice(w) * (weight / self.radius);
        self.spread.ger(1.0, &w, &w, 1.0);
        self.mean.axpy(weight, &w, 1.0);
    }

    /// Returns the direction least covered by the points, pointing away from their mean.
    fn least(&self) -> Vec<f64> {
        let n = self.mean.len();
        let eigen = SymmetricEigen::try_new(self.spread.clone(), f64::EPSILON, MOST_SWEEPS * n);
        let direction = eigen.map(|eigen| eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned());
        let direction = direction.filter(|d| d.iter().all(|d| d.is_finite()));
        let direction =
            direction.unwrap_or_else(|| DVector::from_fn(n, |k, _| if k == 0 { 1.0 } else { 0.0 }));
        let sign = if direction.dot(&self.mean) > 0.0 { -1.0 } else { 1.0 };
        direction.iter().map(|d| sign * d).collect()
    }
}
