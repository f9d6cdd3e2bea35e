//! The simplex search that continues if points fail around the best one.

use super::points::{Evaluated, distance, sum_of_squares};
use super::state::{LeastSquaresState, Phase, simplex_method};
use crate::error::Error;
use crate::method_interface::interface::{Method, Status};
use crate::method_interface::tolerances::{TestedSet, ToleranceTests};
use crate::methods::nelder_mead::SimplexSearch;
use crate::outcome::answer::{Answers, Outcome};
use crate::outcome::termination::Termination;

/// Relative excess over the best cost above which the result of a simplex search counts as unsuccessful.
const WORSE: f64 = 1e-3;

impl LeastSquaresState {
    /// Starts a simplex search from the best point that is at least the first radius away from all failed
    /// points. A model cannot represent failures, but a simplex search avoids them. A simplex that starts
    /// next to failed points collapses.
    pub(super) fn begin_simplex(&mut self) {
        let is_away = |k: &usize| {
            let near = |failed: &Vec<f64>| distance(failed, &self.points[*k].z) < self.options.radius;
            !self.failed.iter().any(near)
        };
        let from = self.best_of((0..self.points.len()).filter(is_away)).unwrap_or_else(|| self.base());
        let Evaluated { x, cost, .. } = &self.points[from];
        self.begin_simplex_at(&x.clone(), Some(*cost));
    }

    fn begin_simplex_at(&mut self, x: &[f64], cost: Option<f64>) {
        self.phase =
            match SimplexSearch::new(&simplex_method(), &self.setup, x, self.n_batches, self.n_points) {
                Ok(mut simplex) => {
                    if let Some(cost) = cost {
                        simplex.state.set_start_cost(cost, self.f_0);
                    }
                    Phase::Simplex(Box::new(simplex))
                }
                Err(_) => Phase::Ended(Termination::Collapsed),
            };
    }

    /// Starts another simplex search from the start point if the first one ended at a worse point than the
    /// best one. Returns false if no other search is started.
    fn begin_again(&mut self) -> bool {
        let Phase::Simplex(simplex) = &self.phase else { return false };
        let x0 = self.setup.space.x0().to_vec();
        let found = simplex.state.best().map_or(f64::INFINITY, |(_, cost)| cost);
        let best = self.best_of(0..self.points.len()).map(|k| self.points[k].cost);
        if simplex.start == x0 || best.is_none_or(|best| found <= (1.0 + WORSE) * best) {
            return false;
        }
        self.n_iterations += simplex.state.details().n_iterations;
        self.n_batches += simplex.state.n_batches();
        self.n_points += simplex.state.n_points();
        let cost = self.points.iter().find(|point| point.x == x0).map(|point| point.cost);
        self.begin_simplex_at(&x0, cost);
        true
    }

    /// Processes the answers to the points of the simplex search, which also minimises the sum of squares.
    /// These points also contribute to the model of the result.
    pub(super) fn tell_simplex(&mut self, answers: &Answers) -> Result<(), Error> {
        let Phase::Simplex(simplex) = &mut self.phase else { return Ok(()) };
        let mut squares = Answers::default();
        for (k, outcome) in answers.outcomes().iter().enumerate() {
            let sum = outcome.value().and(answers.residuals(k)).map(sum_of_squares);
            squares.push(sum.map_or_else(|| outcome.clone(), Outcome::Value), &[]);
        }
        simplex.state.tell(&squares)?;
        let status = simplex.state.status();
        for (k, x) in std::mem::take(&mut self.simplex_points).into_iter().enumerate().take(answers.len()) {
            if let Some((cost, residuals)) = answers.outcomes()[k].value().zip(answers.residuals(k)) {
                let mut z = vec![0.0; self.n()];
                self.setup.space.to_working(&x, &mut z);
                z.iter_mut().enumerate().for_each(|(k, z)| *z = self.scaled(k, *z));
                self.keep(z, x, cost, residuals.to_vec());
            }
        }
        if let Some(best) = self.best_of(0..self.points.len()) {
            (self.set, self.model) = (vec![best], None);
        }
        self.forget();
        match status {
            Status::Running => {}
            _ if self.begin_again() => {}
            Status::Ended(termination) => self.end(termination),
            Status::NoStart => self.end(Termination::Collapsed),
        }
        Ok(())
    }

    /// Ends the run, with the tests of the simplex search if it was active.
    fn end(&mut self, mut termination: Termination) {
        if let Phase::Simplex(simplex) = &self.phase {
            let details = simplex.state.details();
            let is_of_squares = self.has_other_cost;
            self.tests = details.tests.map(|tests| ToleranceTests { is_of_squares, ..tests });
            self.operation = details.operation;
            self.n_iterations += details.n_iterations;
        }
        if let Some(tests) = self.of_plateau().filter(|_| termination == Termination::Converged) {
            (self.tests, termination) = (Some(tests), Termination::Noise);
        }
        self.phase = Phase::Ended(termination);
    }

    /// Returns the tests for a simplex whose points all have the same cost. The size of such a simplex is
    /// unrelated to the accuracy of the minimum. The extent of the points with identical residuals (rounded
    /// ones, for example) determines the accuracy.
    fn of_plateau(&self) -> Option<ToleranceTests> {
        let best = &self.points[self.base()];
        let spread = self.tests?.f_spread?;
        let far = |point: &Evaluated| distance(&point.z, &best.z);
        let equal = self.points.iter().filter(|point| point.residuals == best.residuals);
        let tests = self.judge(equal.map(far).fold(0.0, f64::max), spread, best.cost);
        (spread == 0.0 && best.cost > 0.0).then_some(ToleranceTests { extent: TestedSet::Plateau, ..tests })
    }
}
