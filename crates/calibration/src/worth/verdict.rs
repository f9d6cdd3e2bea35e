//! What the numbers say, in words: parameters that the data cannot tell, alone, in pairs or in combinations of more.

use super::covariance::{Factors, Noise};
use super::differences::Differences;
use super::digits::digits;
use super::result::{Worth, errors_and_correlation};
use nalgebra::DMatrix;
use std::ops::Range;

/// Parameters with a correlation of this size or more move the outputs the same way: less than a fifth of the variance of either is
/// its own.
const CONFOUNDED: f64 = 0.9;

/// Condition index of the Jacobian with columns of length one from which on a dependency among its columns harms, and the share of a
/// parameter's variance that makes it a part of that (Belsley, Kuh and Welsch, Regression Diagnostics, 1980, section 3.2).
const CONDITION_INDEX: f64 = 10.0;
const VARIANCE_SHARE: f64 = 0.5;

/// A standard error above this part of its parameter says that the data hardly tell it.
const RELATIVE_ERROR: f64 = 0.5;

/// A parameter moves an output if it moves it by more than this part of what the strongest does, each moved by its size.
const MOVES: f64 = 1e-8;

/// The data do not move a parameter off its prior whose derivatives are below this part of that of the prior.
const PRIOR_ALONE: f64 = 1e-3;

impl Worth {
    fn n(&self) -> usize {
        self.x.len()
    }

    /// The standard error relative to the parameter.
    fn relative_error(&self, i: usize) -> f64 {
        self.standard_errors[i] / self.x[i].abs()
    }

    /// Length of a parameter's column of the Jacobian within these rows.
    fn length(&self, i: usize, rows: Range<usize>) -> f64 {
        rows.map(|r| self.jacobian[r * self.n() + i].powi(2)).sum::<f64>().sqrt()
    }

    fn moves(&self, i: usize, rows: &Range<usize>) -> bool {
        // What is zero has no size: any effect counts.
        let effect = |k: usize| self.length(k, rows.clone()) * self.x[k].abs();
        let most = (0..self.n()).map(effect).fold(0.0, f64::max);
        let own = if self.x[i] == 0.0 { f64::INFINITY } else { effect(i) };
        self.length(i, rows.clone()) > 0.0 && own > MOVES * most
    }

    /// The rows of each output of each experiment.
    fn rows(&self) -> Vec<Range<usize>> {
        let ends = self.residual_checks.iter().scan(0, |end, check| {
            *end += check.n;
            Some(*end - check.n..*end)
        });
        ends.collect()
    }

    /// Parameters that have a prior and that the data do not move off it.
    fn known_from_prior(&self) -> Vec<usize> {
        let measured = 0..self.rows().last().map_or(0, |rows| rows.end);
        let is_prior_alone = |i: &usize| {
            let of_prior = self.length(*i, measured.end..self.residuals.len());
            let of_data = self.length(*i, measured.clone());
            of_prior > 0.0 && (of_data <= PRIOR_ALONE * of_prior || !self.moves(*i, &measured))
        };
        (0..self.n()).filter(|i| !self.held.contains(i)).filter(is_prior_alone).collect()
    }

    /// Pairs with a high correlation, of those that move an output both: that of independent residuals, for how alike they move the
    /// outputs has nothing to do with the noise.
    pub(super) fn find_confounded(&mut self) {
        let n = self.n();
        let correlation = match &self.uncorrected_covariance {
            Some(covariance) => errors_and_correlation(covariance, n).1,
            None => self.correlation.clone(),
        };
        let rows = self.rows();
        let share = |i, j| rows.iter().any(|rows| self.moves(i, rows) && self.moves(j, rows));
        let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
        let mut found: Vec<(usize, usize, f64)> = pairs
            .map(|(i, j)| (i, j, correlation[i * n + j]))
            .filter(|(i, j, correlation)| correlation.abs() >= CONFOUNDED && share(*i, *j))
            .collect();
        found.sort_by(|a, b| b.2.abs().total_cmp(&a.2.abs()));
        self.confounded = found;
    }

    /// The combination of parameters that the data determine worst, by the singular values of the Jacobian (m x p) with columns of
    /// length one.
    pub(super) fn find_weakest(&mut self, jacobian: &DMatrix<f64>, free: &[usize]) {
        let told: Vec<usize> = (0..free.len()).filter(|k| !self.undetermined.contains(&free[*k])).collect();
        let p = told.len();
        if p < 3 || jacobian.nrows() < p {
            return;
        }
        let mut columns = jacobian.select_columns(&told);
        columns.column_iter_mut().for_each(|mut column| {
            column.try_normalize_mut(0.0);
        });
        let Some(svd) = columns.qr().r().try_svd(false, true, f64::EPSILON, 10_000) else { return };
        let Some(v_t) = svd.v_t else { return };
        let values = svd.singular_values;
        if values[0] < CONDITION_INDEX * values[p - 1] {
            return;
        }
        let part = |a: usize, k: usize| (v_t[(k, a)] / values[k]).powi(2);
        let share = |a: usize| part(a, p - 1) / (0..p).map(|k| part(a, k)).sum::<f64>();
        let weakest: Vec<usize> =
            (0..p).filter(|a| share(*a) > VARIANCE_SHARE).map(|a| free[told[a]]).collect();
        if weakest.len() > 2 {
            self.weakest = weakest;
        }
    }

    pub(super) fn find_identifiable(
        &mut self,
        (differences, noise): (&Differences, &Noise),
        free: &[usize],
        sizes: &[f64],
    ) {
        if noise.degrees_of_freedom == 0 {
            return;
        }
        let jacobian = differences.jacobian();
        // Coordinates of the search are relative already where they are logarithms.
        let size = |k: usize| match (self.is_log[free[k]], self.x[free[k]].abs()) {
            (true, _) => 1.0,
            (false, 0.0) => sizes[k],
            (false, x) => x,
        };
        let scaled = DMatrix::from_fn(jacobian.nrows(), free.len(), |r, k| jacobian[(r, k)] * size(k));
        let mut chosen: Vec<usize> = Vec::new();
        for k in pivots(scaled.clone()) {
            chosen.push(k);
            let p = chosen.len();
            let part = Differences {
                changes: scaled.select_columns(&chosen),
                steps: DMatrix::identity(p, p),
                noise: differences.noise,
            };
            let covariance = Factors::new(&part).covariance(noise);
            let error = |a: usize| covariance[(a, a)].sqrt();
            let correlation = |a: usize, b: usize| covariance[(a, b)] / (error(a) * error(b));
            let is_told = (0..p)
                .all(|a| error(a) < RELATIVE_ERROR && (0..a).all(|b| correlation(a, b).abs() < CONFOUNDED));
            // A combination below the noise has no variance there.
            let is_whole = !Factors::new(&part).is_undetermined.contains(&true);
            if !(is_told && is_whole) {
                chosen.pop();
                break;
            }
        }
        self.identifiable = chosen.iter().map(|k| free[*k]).collect();
        self.identifiable.sort_unstable();
    }

    /// "C1, G1 and C2"
    fn list(&self, parameters: &[usize]) -> String {
        let names: Vec<&str> = parameters.iter().map(|i| self.names[*i].as_str()).collect();
        match names.split_last() {
            Some((last, [])) => (*last).to_owned(),
            Some((last, others)) => format!("{} and {last}", others.join(", ")),
            None => String::new(),
        }
    }

    pub(super) fn undetermined_sentences(&self) -> Vec<String> {
        let mut said = Vec::new();
        if self.degrees_of_freedom == 0 && self.held.len() < self.n() {
            said.push(
                "there are no more residuals than parameters: nothing is known of their errors".to_owned(),
            );
        }
        let inert = &self.without_effect;
        if !inert.is_empty() {
            let moves = if inert.len() == 1 { "it moves" } else { "they move" };
            said.push(format!(
                "the data do not determine {}: {moves} no output that was measured",
                self.list(inert)
            ));
        }
        let together: Vec<usize> = self.undetermined.iter().copied().filter(|i| !inert.contains(i)).collect();
        match together.len() {
            0 => {}
            1 => said.push(format!("the data do not determine {}: other values fit as well", self.list(&together))),
            _ => said.push(format!(
                "the data do not determine {}: other values of them together fit as well; fix all but one, or combine them",
                self.list(&together)
            )),
        }
        said
    }

    pub(super) fn confounded_sentences(&self) -> Vec<String> {
        let pair = |(i, j, correlation): &(usize, usize, f64)| {
            let names = self.list(&[*i, *j]);
            format!(
                "{names} move the outputs the same way: correlation {correlation:.2}; fix one or fit in two stages"
            )
        };
        self.confounded.iter().map(pair).collect()
    }

    /// A cost that another accuracy of the simulations changes by more than counts; not one that is all error of the simulations.
    pub(super) fn accuracy_sentence(&self, f_tol: f64) -> Option<String> {
        let accurate = self.accurate_cost?;
        let difference = (accurate - self.cost).abs();
        (difference > f_tol * self.cost.abs().max(accurate.abs()) && !self.is_exact).then(|| {
            format!(
                "the cost is {} with a hundredth of the relative tolerance, {} with that of the fit: give a smaller \
                 relative_tolerance",
                digits(accurate),
                digits(self.cost)
            )
        })
    }

    /// All sentences.
    pub(super) fn sentences(&self, are_several: bool, f_tol: f64) -> Vec<String> {
        let mut said = self.undetermined_sentences();
        for i in self.known_from_prior() {
            said.push(format!("{} is known from its prior alone: the data do not move it", self.names[i]));
        }
        said.extend(self.confounded_sentences());
        if !self.weakest.is_empty() {
            let names = self.list(&self.weakest);
            said.push(format!("{names} together can be moved with little change of the outputs"));
        }
        for i in (0..self.n()).filter(|i| self.standard_errors[*i].is_finite() && self.x[*i] != 0.0) {
            let error = self.relative_error(i);
            if error > RELATIVE_ERROR {
                let percent = digits((100.0 * error).round());
                said.push(format!("the standard error of {} is {percent} % of its value", self.names[i]));
            }
        }
        let n_free = self.n() - self.held.len();
        if self.identifiable.len() < n_free && self.degrees_of_freedom > 0 {
            said.push(match self.identifiable.is_empty() {
                true => "the data tell none of the parameters to half of its value".to_owned(),
                false => format!(
                    "with the others held the data tell {} (standard errors below half of their values, no correlation of 0.9)",
                    self.list(&self.identifiable)
                ),
            });
        }
        if self.is_exact {
            said.push(
                "the measurements are reproduced to the accuracy of the simulations: standard errors say little"
                    .to_owned(),
            );
        }
        for check in self.residual_checks.iter().filter(|_| !self.is_exact) {
            let name = match are_several {
                true => format!("{} of {}", check.variable, check.experiment),
                false => check.variable.clone(),
            };
            said.extend(check.sentences(&name));
        }
        said.extend(self.accuracy_sentence(f_tol));
        said
    }
}

/// The order in which the columns are most independent of those before (QR with column pivoting).
fn pivots(mut columns: DMatrix<f64>) -> Vec<usize> {
    let p = columns.ncols();
    let mut order: Vec<usize> = Vec::with_capacity(p);
    while order.len() < p {
        let left = (0..p).filter(|k| !order.contains(k));
        let longest = left.map(|k| (k, columns.column(k).norm())).fold(
            None,
            |best: Option<(usize, f64)>, (k, norm)| match best {
                Some((_, longest)) if longest >= norm => best,
                _ => Some((k, norm)),
            },
        );
        let Some((k, norm)) = longest else { break };
        order.push(k);
        if norm > 0.0 {
            let direction = columns.column(k) / norm;
            for other in (0..p).filter(|other| !order.contains(other)) {
                let along = direction.dot(&columns.column(other));
                columns.column_mut(other).axpy(-along, &direction, 1.0);
            }
        }
    }
    order
}
