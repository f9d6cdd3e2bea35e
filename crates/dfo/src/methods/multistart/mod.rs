//! Local searches from several starts in a box: a sample of the box, clustering, and a search from the best
//! point of each cluster (multi-level single linkage: Rinnooy Kan and Timmer, Math. Program. 39, 1987, 57),
//! under one budget.
//!
//! An iteration of the algorithm samples `N` further points. Of all `kN` points so far the best fifth is
//! looked at, the best first. A point starts a search unless a better one lies within the critical distance
//! `r_k = pi^(-1/2) (Gamma(1 + n/2) sigma ln(kN) / (kN))^(1/n)`, sigma = 4, in units of the box (their
//! equation 7): then both are taken for one cluster, and one search is enough. Start points that the user
//! gave are always searched from, first. Several searches run side by side, and their points are one batch.
//! Once the first has ended and fewer run than may, the next sample is part of that batch where it is needed
//! whatever these searches find.
//!
//! The search ends when the minima found are probably all there are: with `w` of them in `t` trials the
//! expected number is `w (t - 1) / (t - w - 2)` (Boender and Rinnooy Kan, Math. Program. 37, 1987, 59), and
//! less than half a minimum is missing. Every point looked at counts as a trial, for it stands for the search
//! of its cluster. Before the end searches from three such points test that: where one of them ends in
//! another minimum, a cluster has several, and only searches count from then on.
//!
//! For costs without residuals, part of the budget goes to differential evolution before (`exploration`):
//! what it finds is the first start, and its first population is the first sample.
//!
//! The path goes through the searches in turn, a batch of each at a time. A search whose answers have come
//! does not wait for the others: a copy of it goes on ahead of the path, and so do the next searches in the
//! queue where there are workers for them. What they evaluate is what the path comes to, unless the run ends
//! before; so the number of workers changes nothing.
//!
//! Where the evaluations are limited, sample and searches side by side take at most half of them before the
//! first local search has ended; the others wait from then on. So a problem with one minimum is solved where
//! its local search needs less than the other half.

mod clusters;
mod look_ahead;
mod options;
mod speculative_searches;
mod state;

pub use options::{Multistart, Polish};
pub use state::MultistartState;

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup};
use crate::methods::shared::population::MAX_MEMBERS;
use crate::problem::memory;
use crate::problem::option_texts;

impl MethodOptions for Multistart {
    type Method = MultistartState;

    fn begin(&self, setup: &Setup) -> Result<MultistartState, Error> {
        setup.tolerances.check()?;
        self.check()?;
        let space = &setup.space;
        space.require_continuous("multistart")?;
        space.require_box("multistart")?;
        let sample = self.sample_of(space.n_free());
        if sample > MAX_MEMBERS {
            let range = "at least 1, at most a million";
            return Err(Error::Option { name: "sample", value: sample as f64, range });
        }
        memory::check(
            "a sample of so many points and parameters",
            &[3 * sample, space.n() + space.n_free()],
        )?;
        MultistartState::begin(self, setup)
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<MultistartState, Error> {
        MultistartState::restore(self, setup, state)
    }

    fn needs_start(&self) -> bool {
        false
    }

    fn needs_residuals(&self) -> bool {
        self.polish == Polish::LeastSquares
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    /// The exploration is planned with the budget, and until the first search has ended the others have half
    /// of it: a run that is continued with another limit would have taken another path.
    fn plans_with_budget(&self) -> bool {
        let explores = self.exploration.map_or(self.polish != Polish::LeastSquares, |share| share > 0.0);
        explores || self.side_by_side != Some(1)
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(1000usize.saturating_mul(n + 1)), None)
    }

    /// A search asks for its start once more.
    fn default_cache(&self) -> usize {
        1000
    }
}
