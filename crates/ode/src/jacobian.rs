//! The Jacobian of the right-hand side: from the model, from directional derivatives, or from coloured finite
//! differences.

use crate::lu;
use crate::sparsity::{Groups, JacobianPattern};
use crate::stepper::{Equations, Point};
use crate::system::{CallError, CallResult, HybridSystem};

/// Multiples of the usual increment, tried in this order until the model can be evaluated.
const LADDER: [f64; 8] = [1.0, -1.0, 0.1, -0.1, 0.01, -0.01, 0.001, -0.001];

/// Source of the Jacobian, determined at the first evaluation of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Source {
    /// [`HybridSystem::jacobian_entries`].
    #[default]
    Entries,
    /// [`HybridSystem::jacobian`].
    Whole,
    Directional,
    Differences,
}

/// A Jacobian by columns, with the work space to update it without allocation.
#[derive(Debug, Default)]
pub(crate) struct Jacobian {
    n: usize,
    source: Source,
    /// True if the system provides a whole matrix.
    has_whole: bool,
    pattern: Option<JacobianPattern>,
    /// Positions in `values` of the entries of the pattern.
    places: Vec<usize>,
    groups: Groups,
    is_sparse: bool,
    /// `values[i + n * k]` is the derivative of `f_i` with respect to `x_k`. If the matrix is sparse, only
    /// the entries of the pattern and of the diagonal are stored, one after the other. This is the layout of
    /// a sparse decomposition.
    pub(crate) values: Vec<f64>,
    /// Buffer for the system to fill in if its layout differs from `values`: the entries of the pattern, or a
    /// whole matrix.
    given: Vec<f64>,
    point: Vec<f64>,
    column: Vec<f64>,
}

impl Jacobian {
    /// Allocates the work space for the system and colours its pattern. A pattern of the wrong size is
    /// ignored.
    ///
    /// # Errors
    /// Returns an error if memory is insufficient for a dense matrix of this size.
    pub(crate) fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        let n = system.n_states();
        let pattern = system.jacobian_pattern().filter(|p| p.n_states() == n);
        self.has_whole = system.has_jacobian();
        self.source = if pattern.is_some() { Source::Entries } else { Source::Whole };
        self.point.resize(n, 0.0);
        self.column.resize(n, 0.0);
        // The mass matrix has entries outside the pattern.
        let is_sparse = pattern.is_some_and(lu::is_sparse) && system.mass_matrix().is_none();
        if (n, pattern, is_sparse) != (self.n, self.pattern.as_ref(), self.is_sparse) {
            // If the allocation fails, the previous state is invalid.
            self.n = usize::MAX;
            (self.pattern, self.is_sparse) = (pattern.cloned(), is_sparse);
            self.groups = pattern.map_or_else(|| Groups::single(n), Groups::new);
            let kept = pattern.filter(|_| is_sparse).map(JacobianPattern::with_diagonal);
            self.places.clear();
            self.places.extend(pattern.into_iter().flat_map(JacobianPattern::entries).map(
                |(i, k)| match &kept {
                    Some(kept) => kept.place(i, k),
                    None => i + n * k,
                },
            ));
            match kept {
                Some(kept) => self.values = vec![0.0; kept.n_entries()],
                None => lu::resize_matrix(&mut self.values, n, 0.0)?,
            }
            self.n = n;
        }
        Ok(())
    }

    /// Sparsity pattern, if known.
    pub(crate) fn pattern(&self) -> Option<&JacobianPattern> {
        self.pattern.as_ref()
    }

    /// True if only the entries of the pattern and of the diagonal are stored.
    pub(crate) fn is_sparse(&self) -> bool {
        self.is_sparse
    }

    /// Calls `f(i, k, value)` for every entry that may be nonzero, column by column.
    pub(crate) fn each(&self, mut f: impl FnMut(usize, usize, f64)) {
        match &self.pattern {
            Some(pattern) => {
                pattern.entries().zip(&self.places).for_each(|((i, k), p)| f(i, k, self.values[*p]));
            }
            None => {
                for (k, column) in self.values.chunks_exact(self.n.max(1)).enumerate() {
                    column.iter().enumerate().for_each(|(i, value)| f(i, k, *value));
                }
            }
        }
    }

    /// Fills in a column: `value(i)` in row `i`.
    fn fill(&mut self, k: usize, value: impl Fn(&[f64], usize) -> f64) {
        let Self { n, pattern, places, values, column, .. } = self;
        match pattern {
            Some(pattern) => {
                let places = &places[pattern.starts[k]..pattern.starts[k + 1]];
                pattern.column(k).iter().zip(places).for_each(|(&i, p)| values[*p] = value(column, i));
            }
            None => {
                let into = &mut values[*n * k..*n * (k + 1)];
                into.iter_mut().enumerate().for_each(|(i, j)| *j = value(column, i));
            }
        }
    }

    /// Number of evaluations of the Jacobian.
    pub(crate) fn cost(&self) -> usize {
        match self.source {
            Source::Entries | Source::Whole => 1,
            Source::Directional | Source::Differences => self.groups.len(),
        }
    }

    /// Evaluates the Jacobian at a point where the slopes are the right-hand side. Returns
    /// [`CallError::Discard`] if it cannot be evaluated there.
    pub(crate) fn evaluate(&mut self, equations: &mut Equations<'_>, point: Point<'_>) -> CallResult<()> {
        let Point { t, x, .. } = point;
        equations.stats.jacobians += 1;
        self.values.fill(0.0);
        if self.source == Source::Entries && !self.take_entries(equations.system, t, x)? {
            self.source = Source::Whole;
        }
        if self.source == Source::Whole && !(self.has_whole && self.take_whole(equations.system, t, x)?) {
            self.source = Source::Directional;
        }
        if matches!(self.source, Source::Entries | Source::Whole) {
            return if all_finite(&self.values) { Ok(()) } else { Err(CallError::Discard) };
        }
        for g in 0..self.groups.len() {
            if self.source == Source::Directional && !self.directional(equations, t, x, g)? {
                self.source = Source::Differences;
            }
            if self.source == Source::Differences {
                self.difference(equations, point, g)?;
            }
        }
        Ok(())
    }

    /// Reads the entries of the pattern from the system. Returns `false` if the system provides none.
    fn take_entries(&mut self, system: &mut dyn HybridSystem, t: f64, x: &[f64]) -> CallResult<bool> {
        self.given.clear();
        self.given.resize(self.places.len(), 0.0);
        let is_there = system.jacobian_entries(t, x, &mut self.given)?;
        if is_there {
            self.places.iter().zip(&self.given).for_each(|(p, value)| self.values[*p] = *value);
        }
        Ok(is_there)
    }

    /// Reads the whole matrix from the system. Returns `false` if the system provides none.
    fn take_whole(&mut self, system: &mut dyn HybridSystem, t: f64, x: &[f64]) -> CallResult<bool> {
        if !self.is_sparse {
            return system.jacobian(t, x, &mut self.values);
        }
        lu::resize_matrix(&mut self.given, self.n, 0.0)?;
        let is_there = system.jacobian(t, x, &mut self.given)?;
        if let Some(pattern) = &self.pattern {
            let entries = pattern.entries().map(|(i, k)| self.given[i + self.n * k]);
            self.places.iter().zip(entries).for_each(|(p, value)| self.values[*p] = value);
        }
        Ok(is_there)
    }

    /// Computes a group of columns from one directional derivative. Returns `false` if the model has none.
    fn directional(
        &mut self,
        equations: &mut Equations<'_>,
        t: f64,
        x: &[f64],
        g: usize,
    ) -> CallResult<bool> {
        let columns = self.groups.range(g);
        self.point.fill(0.0);
        for place in columns.clone() {
            let k = self.groups.columns[place];
            self.point[k] = 1.0;
        }
        if !equations.system.directional_derivative(t, x, &self.point, &mut self.column)? {
            return Ok(false);
        }
        equations.stats.directional_derivatives += 1;
        if !all_finite(&self.column) {
            return Err(CallError::Discard);
        }
        for place in columns {
            self.fill(self.groups.columns[place], |column, i| column[i]);
        }
        Ok(true)
    }

    /// Computes a group of columns from one finite difference. The difference is forward along the flow, so
    /// that the point stays in the domain of the model. If the model refuses that point, the difference is
    /// backward or shorter.
    fn difference(&mut self, equations: &mut Equations<'_>, point: Point<'_>, g: usize) -> CallResult<()> {
        let Point { t, x, slopes: f } = point;
        let columns = self.groups.range(g);
        for share in LADDER {
            self.point.copy_from_slice(x);
            for place in columns.clone() {
                let k = self.groups.columns[place];
                let delta = (f64::EPSILON / 2.0).sqrt() * x[k].abs().max(equations.weights.scale(k));
                self.point[k] += share * if f[k] < 0.0 { -delta } else { delta };
            }
            match equations.derivatives(t, &self.point, &mut self.column) {
                Ok(()) if all_finite(&self.column) => {}
                Ok(()) | Err(CallError::Discard) => continue,
                Err(failed) => return Err(failed),
            }
            for place in columns {
                let k = self.groups.columns[place];
                // The difference of the stored points is exact.
                let delta = self.point[k] - x[k];
                self.fill(k, |column, i| (column[i] - f[i]) / delta);
            }
            return Ok(());
        }
        Err(CallError::Discard)
    }
}

fn all_finite(values: &[f64]) -> bool {
    values.iter().all(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error_norm::ErrorWeights;
    use crate::options::Options;
    use crate::stats::Stats;
    use crate::system::EventOutcome;

    /// `f_i = x_{i-1} x_i - 2 x_i^2 + 3 x_{i+1}`, refused if a state is above its limit.
    struct Chain {
        n: usize,
        pattern: Option<JacobianPattern>,
        limit: f64,
        has_jacobian: bool,
        directional: bool,
    }

    impl Chain {
        fn exact(&self, x: &[f64]) -> Vec<f64> {
            let n = self.n;
            let mut j = vec![0.0; n * n];
            for i in 0..n {
                let left = if i > 0 { x[i - 1] } else { 0.0 };
                j[i + n * i] = left - 4.0 * x[i];
                if i > 0 {
                    j[i + n * (i - 1)] = x[i];
                }
                if i + 1 < n {
                    j[i + n * (i + 1)] = 3.0;
                }
            }
            j
        }
    }

    impl HybridSystem for Chain {
        fn n_states(&self) -> usize {
            self.n
        }
        fn start(&mut self, _: f64, _: &mut [f64]) -> CallResult<EventOutcome> {
            Ok(EventOutcome::default())
        }
        fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
            if x.iter().any(|x| *x > self.limit) {
                return Err(CallError::Discard);
            }
            for i in 0..self.n {
                let left = if i > 0 { x[i - 1] } else { 0.0 };
                let right = if i + 1 < self.n { x[i + 1] } else { 0.0 };
                dx[i] = left * x[i] - 2.0 * x[i] * x[i] + 3.0 * right;
            }
            Ok(())
        }
        fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
            self.pattern.as_ref()
        }
        fn has_jacobian(&self) -> bool {
            true
        }
        fn jacobian(&mut self, _: f64, x: &[f64], j: &mut [f64]) -> CallResult<bool> {
            if self.has_jacobian {
                j.copy_from_slice(&self.exact(x));
            }
            Ok(self.has_jacobian)
        }
        fn directional_derivative(
            &mut self,
            _: f64,
            x: &[f64],
            seed: &[f64],
            derivative: &mut [f64],
        ) -> CallResult<bool> {
            let j = self.exact(x);
            for (i, d) in derivative.iter_mut().enumerate() {
                *d = (0..self.n).map(|k| j[i + self.n * k] * seed[k]).sum();
            }
            Ok(self.directional)
        }
    }

    fn tridiagonal(n: usize) -> JacobianPattern {
        let entries = (0..n).flat_map(|k| (k.saturating_sub(1)..(k + 2).min(n)).map(move |i| (i, k)));
        JacobianPattern::new(n, entries).unwrap()
    }

    fn evaluated(chain: &mut Chain, x: &[f64]) -> (CallResult<()>, f64, Stats) {
        let mut weights = ErrorWeights::default();
        weights.set(&Options::default(), &vec![1.0; chain.n], |_| false);
        let mut f = vec![0.0; chain.n];
        chain.derivatives(0.0, x, &mut f).unwrap();
        let (mut jacobian, mut stats) = (Jacobian::default(), Stats::default());
        jacobian.begin(chain).unwrap();
        let mut equations = Equations { system: chain, weights: &weights, stats: &mut stats };
        let result = jacobian.evaluate(&mut equations, Point { t: 0.0, x, slopes: &f });
        let exact = chain.exact(x);
        let worst = exact.iter().zip(&jacobian.values).map(|(e, j)| (e - j).abs()).fold(0.0, f64::max);
        (result, worst, stats)
    }

    #[test]
    fn differences_need_one_evaluation_per_colour() {
        let x: Vec<f64> = (0..10).map(|i| 0.3 + 0.1 * f64::from(i)).collect();
        let mut chain =
            Chain { n: 10, pattern: None, limit: f64::INFINITY, has_jacobian: false, directional: false };
        let (result, worst, stats) = evaluated(&mut chain, &x);
        assert!(result.is_ok() && worst < 1e-6, "{worst:e}");
        assert_eq!((stats.right_hand_sides, stats.jacobians), (10, 1));
        chain.pattern = Some(tridiagonal(10));
        let (result, worst, stats) = evaluated(&mut chain, &x);
        assert!(result.is_ok() && worst < 1e-6, "{worst:e}");
        assert_eq!(stats.right_hand_sides, 3);
    }

    #[test]
    fn model_derivatives_take_precedence() {
        let x = [0.5, 0.6, 0.7, 0.8];
        let pattern = Some(tridiagonal(4));
        let mut chain = Chain { n: 4, pattern, limit: f64::INFINITY, has_jacobian: true, directional: true };
        let (_, worst, stats) = evaluated(&mut chain, &x);
        assert_eq!((worst, stats.right_hand_sides, stats.directional_derivatives), (0.0, 0, 0));
        chain.has_jacobian = false;
        let (_, worst, stats) = evaluated(&mut chain, &x);
        assert_eq!((worst, stats.right_hand_sides, stats.directional_derivatives), (0.0, 0, 3));
        chain.pattern = None;
        let (_, worst, stats) = evaluated(&mut chain, &x);
        assert_eq!((worst, stats.directional_derivatives), (0.0, 4));
    }

    #[test]
    fn differences_go_backward_at_refused_points() {
        // All states increase (f > 0) and are at the limit, so every forward difference is rejected.
        let x = [0.5; 3];
        let mut chain = Chain { n: 3, pattern: None, limit: 0.5, has_jacobian: false, directional: false };
        let (result, worst, stats) = evaluated(&mut chain, &x);
        assert!(result.is_ok() && worst < 1e-6, "{worst:e}");
        // The last state decreases and needs one evaluation; the others need two.
        assert_eq!(stats.right_hand_sides, 5);
    }
}
