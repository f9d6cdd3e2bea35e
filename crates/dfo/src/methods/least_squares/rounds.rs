//! Rounds of several points: trial points of a Gauss-Newton model at several radii, and differences around
//! the first of them. Its Jacobian is then known in the same round, so each round is one iteration.
//!
//! If another trial point is the best one, its Jacobian is interpolated between the last two centres of
//! differences. The difference step follows the noise of the residuals (Shi, Xuan, Oztoprak and Nocedal,
//! Optim. Methods Softw. 38, 2023), which a second difference at the first centre shows. The rounds end where
//! the model predicts no decrease that matters, and where they make no progress, points fail or residuals are
//! noisy. Steps on interpolation models continue from there, with their tests (`trust_region.rs`).

use super::points::{Evaluated, axpy, difference, distance, dot, norm, sum};
use super::state::{Candidate, Differences, LeastSquaresState, Phase, PointStatus, Role, Rounds};
use super::subproblem::{Cancelled, Linear, Subproblem};
use crate::method_interface::interface::Operation;
use base::RunContext;

/// Difference step for residuals with rounding errors only, in units of the parameters.
const STEP: f64 = 1e-7;
/// Largest useful difference step. With more noise, regressions on many points are better.
const LONGEST: f64 = 1e-2;
/// Second difference relative to the first one above which the step is too short for the noise.
const NOISY: f64 = 1e-2;
/// Maximum number of consecutive rounds without a better point.
const MOST_WITHOUT_PROGRESS: usize = 4;
/// Radii of the trial points, in units of the trust-region radius, most promising first. Measured in
/// `benches/dfo/results/rounds.md`: with three more radii, fewer curves are solved.
const RADII: [f64; 4] = [1.0, 3.0, 0.3, 0.1];

impl LeastSquaresState {
    /// Returns the phase after the start: rounds if the plan has several points and all neighbours of the
    /// start are known.
    pub(super) fn first_phase(&self) -> Phase {
        if self.options.batch.width(self.n()) < 2 {
            return Phase::Descending;
        }
        let mut neighbours = vec![None; self.n()];
        for (place, point) in self.points.iter().enumerate().skip(1) {
            let mut others = (0..self.n()).filter(|k| point.z[*k] != self.points[0].z[*k]);
            if let (Some(k), None) = (others.next(), others.next()) {
                neighbours[k] = Some(place);
            }
        }
        match neighbours.into_iter().collect() {
            Some(neighbours) => Phase::Rounds(Rounds {
                differences: vec![Differences { centre: 0, neighbours, is_fine: false }],
                step: STEP,
                is_checked: false,
                n_without_progress: 0,
                base: 0,
                around: None,
            }),
            None => Phase::Descending,
        }
    }

    /// Returns the best point. The points of fine differences count as their centre.
    fn base_of_rounds(&self, rounds: &Rounds) -> usize {
        let best = self.best_of(0..self.points.len()).unwrap_or(0);
        let fine = rounds.differences.iter().rev().filter(|d| d.is_fine);
        fine.into_iter().find(|d| d.neighbours.contains(&best)).map_or(best, |d| d.centre)
    }

    /// Returns the product of the differences with a step.
    fn along(&self, d: &Differences, step: &[f64]) -> Vec<f64> {
        let centre = &self.points[d.centre];
        let mut product = vec![0.0; centre.residuals.len()];
        for (k, place) in d.neighbours.iter().enumerate() {
            let share = step[k] / (self.points[*place].z[k] - centre.z[k]);
            axpy(share, &self.points[*place].residuals, &mut product);
            axpy(-share, &centre.residuals, &mut product);
        }
        product
    }

    /// Returns the model at a point from the differences at its own centre, between two centres, or from the
    /// nearest centre.
    fn linear_of_rounds(
        &self,
        rounds: &Rounds,
        base: usize,
        context: &RunContext<'_>,
    ) -> Result<Linear, Cancelled> {
        let Evaluated { z, residuals, .. } = &self.points[base];
        let (m, n) = (residuals.len(), self.n());
        let far = |d: &&Differences| distance(&self.points[d.centre].z, z);
        let nearest = rounds
            .fine_at(base)
            .or_else(|| rounds.differences.iter().min_by(|a, b| far(a).total_cmp(&far(b))));
        let Some(nearest) = nearest else { return Ok(Linear::nothing()) };
        let way = difference(z, &self.points[nearest.centre].z);
        let other = rounds.differences.iter().find(|d| d.centre != nearest.centre && nearest.centre != base);
        let share = other.map_or(0.0, |other| {
            let whole = difference(&self.points[other.centre].z, &self.points[nearest.centre].z);
            dot(&way, &whole) / dot(&whole, &whole)
        });
        // Between two centres, the Jacobian of quadratic residuals is interpolated exactly. Beyond them, the
        // change of the residuals since the nearest centre determines the Jacobian along the way.
        let is_between = share > 0.0 && share < 1.0;
        let other = other.filter(|_| is_between).unwrap_or(nearest);
        let share = if is_between { share } else { 0.0 };
        let mut rest = vec![0.0; m];
        let length = dot(&way, &way);
        if !is_between && length > 0.0 {
            rest = difference(residuals, &self.points[nearest.centre].residuals);
            axpy(-1.0, &self.along(nearest, &way), &mut rest);
        }
        let turn: Vec<f64> = way.iter().map(|w| if length > 0.0 { 2.0 * w / length } else { 0.0 }).collect();
        let of = |d: &Differences, i: usize, k: usize| {
            let (centre, place) = (&self.points[d.centre], &self.points[d.neighbours[k]]);
            (place.residuals[i] - centre.residuals[i]) / (place.z[k] - centre.z[k])
        };
        let jacobian = |i: usize, k: usize| match is_between {
            true => (1.0 - share) * of(nearest, i, k) + share * of(other, i, k),
            false => of(nearest, i, k) + rest[i] * turn[k],
        };
        Linear::new(m, n, |i| residuals[i], jacobian, context)
    }

    /// Fills the round, or continues with steps on interpolation models.
    pub(super) fn ask_round(&mut self, context: &RunContext<'_>) -> Result<(), Cancelled> {
        let Phase::Rounds(rounds) = &self.phase else { return Ok(()) };
        let mut rounds = rounds.clone();
        let base = self.base_of_rounds(&rounds);
        let linear = self.linear_of_rounds(&rounds, base, context)?;
        let Evaluated { z, cost, residuals, .. } = &self.points[base];
        let (z, f, m) = (z.clone(), *cost, residuals.len());
        let room = self.room_around(&z);
        let best = |radius: f64| Subproblem { linear: &linear, radius, room: &room }.solve();
        let (step, predicted) = best(self.delta);
        let length = norm(&step);
        let tests = self.judge(length, predicted, f);
        self.tests = Some(tests);
        let nothing = (4.0 * m as f64 * f64::EPSILON * f).max(1e-7 * tests.f_limit);
        let is_fine = rounds.fine_at(base).is_some();
        let is_finite = linear.factor.iter().all(|v| v.is_finite());
        let gains = predicted > nothing && !tests.passed;
        if self.is_zero(f)
            || !is_finite
            || !self.failed.is_empty()
            || rounds.n_without_progress > MOST_WITHOUT_PROGRESS
            || (is_fine && !gains)
        {
            self.leave_rounds(&rounds, base);
            return Ok(());
        }
        rounds.base = base;
        rounds.around = (!is_fine && (rounds.n_without_progress > 0 || !gains)).then_some(base);
        let n = self.n();
        let n_others = n + usize::from(!rounds.is_checked);
        // Further trial points fill the last part of the round.
        let width = self.options.batch.width(n);
        let n_trials = ((n_others + 1).next_multiple_of(width) - n_others).min(RADII.len());
        if gains {
            self.ask_for(sum(&z, &step), Role::Trial { predicted, radius: self.delta });
            let unit = if length < 0.99 * self.delta { length } else { self.delta };
            for radius in RADII[1..n_trials].iter().map(|share| share * unit) {
                let (other, predicted) = best(radius);
                if predicted > 0.0 && distance(&other, &step) > 0.05 * norm(&other) {
                    self.ask_for(sum(&z, &other), Role::Trial { predicted, radius });
                }
            }
        }
        let centre = if rounds.around.is_some() { z } else { self.round[0].z.clone() };
        if self.ask_differences(&rounds, &centre) {
            self.phase = Phase::Rounds(rounds);
        } else {
            self.round.clear();
            self.leave_rounds(&rounds, base);
        }
        Ok(())
    }

    /// Requests the neighbours of a centre, and a point beyond the first neighbour if the noise has not been
    /// checked. Returns false if linear inequalities block a coordinate on both sides.
    fn ask_differences(&mut self, rounds: &Rounds, centre: &[f64]) -> bool {
        let n = self.n();
        let room = self.room_around(centre);
        for (k, by) in (0..n).map(|k| (k, 1.0)).chain((!rounds.is_checked).then_some((0, 2.0))) {
            let unit: Vec<f64> = (0..n).map(|j| if j == k { 1.0 } else { 0.0 }).collect();
            let length = by * rounds.step * self.magnitude(centre, k).max(1.0);
            let step = room.along(&unit, length);
            if (0..n).any(|j| j != k && step[j] != 0.0) {
                return false;
            }
            self.ask_for(sum(centre, &step), if by == 1.0 { Role::Difference } else { Role::Check });
        }
        true
    }

    /// Continues with steps on interpolation models.
    fn leave_rounds(&mut self, rounds: &Rounds, base: usize) {
        match rounds.fine_at(base) {
            Some(fine) => (self.set, self.model) = (fine.points().collect(), None),
            None => self.choose_set(base),
        }
        self.rho = self.rho.min(self.delta);
        self.phase = Phase::Descending;
    }

    /// Updates the state after a round.
    pub(super) fn rounded(&mut self, round: &[Candidate]) {
        let Phase::Rounds(rounds) = &self.phase else { return };
        let mut rounds = rounds.clone();
        self.n_iterations += 1;
        self.operation = Some(Operation::TrustRegionStep);
        let index_of = |candidate: &Candidate| match candidate.status {
            PointStatus::Point(k) => Some(k),
            _ => None,
        };
        let (f, z) = (self.points[rounds.base].cost, self.points[rounds.base].z.clone());
        let before = rounds.fine_at(rounds.base).cloned();
        let of_role = |role: Role| round.iter().filter(move |candidate| candidate.role == role);
        let neighbours: Option<Vec<usize>> = of_role(Role::Difference).map(index_of).collect();
        let centre = rounds.around.or_else(|| index_of(&round[0]));
        let differences = centre.zip(neighbours).map(|(centre, neighbours)| Differences {
            centre,
            neighbours,
            is_fine: true,
        });
        let is_apart = |d: &Differences| {
            let centre = &self.points[d.centre].z;
            d.neighbours.iter().enumerate().all(|(k, place)| self.points[*place].z[k] != centre[k])
        };
        if let Some(differences) = differences.filter(is_apart) {
            let check = of_role(Role::Check).filter_map(index_of).next();
            let noise = check.map(|check| self.noise(&differences, check));
            rounds.is_checked |= check.is_some();
            match noise.filter(|noise| *noise > NOISY) {
                // Noise relative to the slope, times the step. The best step is its root.
                Some(noise) => {
                    rounds.step = (noise * rounds.step).sqrt();
                    if rounds.step > LONGEST {
                        self.phase = Phase::Descending;
                        self.drop_points(&differences.neighbours, check);
                        return;
                    }
                    rounds.is_checked = false;
                }
                None => {
                    if rounds.differences.len() > 1 {
                        rounds.differences.remove(0);
                    }
                    rounds.differences.push(differences);
                }
            }
        }
        let trials = round.iter().filter_map(|candidate| match (&candidate.role, candidate.status) {
            (Role::Trial { predicted, radius }, PointStatus::Point(k)) => Some((k, *predicted, *radius)),
            _ => None,
        });
        let best = trials.min_by(|a, b| self.points[a.0].cost.total_cmp(&self.points[b.0].cost));
        if let Some((k, predicted, radius)) = best {
            let step = difference(&self.points[k].z, &z);
            let (length, ratio) = (norm(&step), (f - self.points[k].cost) / predicted);
            if ratio <= 0.0 {
                let shortest = round.iter().filter(|c| matches!(c.role, Role::Trial { .. }));
                let shortest = shortest.map(|c| distance(&c.z, &z)).fold(f64::INFINITY, f64::min);
                self.delta = 0.3 * shortest.min(self.delta);
                rounds.n_without_progress += 1;
            } else {
                self.delta = match ratio {
                    ratio if ratio < 0.1 => (0.5 * radius).min(length),
                    ratio if ratio < 0.7 => (0.5 * radius).max(length),
                    _ => (2.0 * radius).min((0.5 * radius).max(4.0 * length)).max(radius),
                };
                rounds.n_without_progress = 0;
            }
            self.curvature = before.filter(|_| ratio >= 0.3).map(|before| {
                let mut rest = difference(&self.points[k].residuals, &self.points[rounds.base].residuals);
                axpy(-1.0, &self.along(&before, &step), &mut rest);
                norm(&rest) / (length * length)
            });
        }
        let base = self.base_of_rounds(&rounds);
        rounds.base = base;
        rounds.around = None;
        if let Some(fine) = rounds.fine_at(base) {
            (self.set, self.model) = (fine.points().collect(), None);
        }
        self.look_for_progress(base);
        self.phase = Phase::Rounds(rounds);
    }

    /// Returns the second difference of the residuals relative to the first one, along the first coordinate.
    fn noise(&self, differences: &Differences, beyond: usize) -> f64 {
        let [a, b, c] =
            [differences.centre, differences.neighbours[0], beyond].map(|k| &self.points[k].residuals);
        let second = a.iter().zip(b).zip(c).map(|((a, b), c)| (a - 2.0 * b + c).powi(2)).sum::<f64>().sqrt();
        let first = differences.neighbours.iter().map(|k| distance(&self.points[*k].residuals, a));
        let first = first.fold(0.0, f64::max);
        if second > 0.0 { second / first } else { 0.0 }
    }

    /// Removes points whose differences are noise, and chooses the set again.
    fn drop_points(&mut self, neighbours: &[usize], check: Option<usize>) {
        let mut place = 0..;
        self.points.retain(|_| place.next().is_none_or(|k| !neighbours.contains(&k) && Some(k) != check));
        if let Some(best) = self.best_of(0..self.points.len()) {
            self.choose_set(best);
        }
        self.rho = self.rho.min(self.delta);
    }
}
