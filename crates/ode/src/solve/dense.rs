//! Dense output: stored values of the solution inside each step.

use crate::observer::StepView;

/// The solution as a function of time, as accurate as the steps themselves.
///
/// Each step is stored as its states at Chebyshev's extreme points. The barycentric formula interpolates
/// between them (J.-P. Berrut, L. N. Trefethen, Barycentric Lagrange interpolation, SIAM Review 46 (2004)
/// 501-517, eq. 4.2 and 5.4).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DenseOutput {
    n_states: usize,
    /// Start and end of each step.
    spans: Vec<f64>,
    /// States step by step, node by node.
    values: Vec<f64>,
}

impl DenseOutput {
    /// Nodes per step: enough for a polynomial of degree 8.
    pub const NODES: usize = 9;

    /// Creates an output without steps.
    pub fn new(n_states: usize) -> Self {
        Self { n_states, ..Self::default() }
    }

    /// Position of node `k` of a step, from -1 (its start) to 1 (its end).
    fn node(k: usize) -> f64 {
        -(std::f64::consts::PI * k as f64 / (Self::NODES - 1) as f64).cos()
    }

    /// Stores a step.
    pub fn push(&mut self, step: &StepView<'_>) {
        let (middle, half) = (0.5 * (step.start + step.end), 0.5 * (step.end - step.start));
        self.spans.extend([step.start, step.end]);
        for k in 0..Self::NODES {
            let from = self.values.len();
            self.values.resize(from + self.n_states, 0.0);
            step.states_at(middle + half * Self::node(k), &mut self.values[from..]);
        }
    }

    /// Start and end of each step, one step after the other.
    pub fn spans(&self) -> &[f64] {
        &self.spans
    }

    /// States at the [`NODES`](Self::NODES) of each step: step by step, node by node.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// States at a given time. At an event, returns the states after the event. `None` if the time is outside
    /// the steps.
    pub fn at(&self, time: f64) -> Option<Vec<f64>> {
        let steps = self.spans.chunks_exact(2);
        let forward = self.spans.first() <= self.spans.last();
        let lies_in =
            |s: &[f64]| if forward { s[0] <= time && time <= s[1] } else { s[1] <= time && time <= s[0] };
        let last = steps.clone().next_back();
        // At the boundary of two steps, the later one is used.
        let begun =
            self.spans.chunks_exact(2).rposition(|s| if forward { s[0] <= time } else { s[0] >= time })?;
        let span = steps.clone().nth(begun).filter(|s| lies_in(s)).or(last.filter(|s| lies_in(s)))?;
        let (start, end) = (span[0], span[1]);
        let s = if start == end { 1.0 } else { (2.0 * time - start - end) / (end - start) };
        let n = self.n_states;
        let step = &self.values[begun * Self::NODES * n..(begun + 1) * Self::NODES * n];
        let (mut x, mut total) = (vec![0.0; n], 0.0);
        for k in 0..Self::NODES {
            let (values, distance) = (&step[k * n..(k + 1) * n], s - Self::node(k));
            if distance == 0.0 {
                return Some(values.to_vec());
            }
            let weight = if k == 0 || k == Self::NODES - 1 { 0.5 } else { 1.0 };
            let share = if k % 2 == 0 { weight / distance } else { -weight / distance };
            total += share;
            x.iter_mut().zip(values).for_each(|(x, v)| *x += share * v);
        }
        x.iter_mut().for_each(|x| *x /= total);
        Some(x)
    }
}
