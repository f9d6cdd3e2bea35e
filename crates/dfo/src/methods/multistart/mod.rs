//! Local searches from several starts in a box. The method samples the box, clusters the sample, and starts a
//! search from the best point of each cluster (multi-level single linkage: Rinnooy Kan and Timmer, Math.
//! Program. 39, 1987, 57). All parts share one budget.
//!
//! Each iteration of the algorithm adds `N` points to the sample. The best fifth of all `kN` points is
//! considered, best first. A point starts a search unless a better point is within the critical distance
//! (their equation 7, in units of the box, with sigma = 4): `r_k = pi^(-1/2) (Gamma(1 + n/2) sigma ln(kN) /
//! (kN))^(1/n)`. Points within this distance count as one cluster, for which one search is enough. Start
//! points given by the user always start a search, before all others. Several searches run in parallel, and
//! their points form one batch. After the first search has ended, fewer searches than allowed may be running.
//! Then the batch also contains the next sample, if this sample is needed regardless of the results.
//!
//! The search ends if probably all minima have been found. With `w` minima in `t` trials, the expected number
//! of minima is `w (t - 1) / (t - w - 2)` (Boender and Rinnooy Kan, Math. Program. 37, 1987, 59). The search
//! ends if less than half a minimum is missing. Every considered point counts as a trial, because it
//! represents the search of its cluster. Before the end, searches from three such points test this
//! assumption. If one of them ends in another minimum, a cluster contains several minima, and only searches
//! count from then on.
//!
//! For costs without residuals, a fraction of the budget is first used for differential evolution
//! (`exploration`). Its result is the first start, and its first population is the first sample.
//!
//! The path processes the searches in turn, one batch of each at a time. A search whose answers are available
//! does not wait for the others. A copy of the search continues ahead of the path. If workers are idle, the
//! next searches in the queue also start. The path later requests the points that these copies evaluate,
//! unless the run ends before. Therefore the number of workers does not change the result.
//!
//! The gain was measured with a simulated clock at 4 and 16 workers: the time without a mechanism divided by
//! the time with it, as the median over 20 problems with 2 to 10 parameters and at most 150 (n + 1)
//! evaluations. If all evaluations take equally long, the copies of running searches gain nothing. If one in
//! ten takes ten times as long, they gain 1.4 and 1.6 with least squares. Without residuals, they gain 1.1
//! and 1.2, and nothing after an exploration. An early start of the next searches gains nothing in the
//! median, because few searches are queued. In long runs it gains more: `tests/all/flow.rs` has 5000
//! evaluations and 16 workers. Their useful share is above 0.6, and 0.39 without early starts.
//!
//! If the number of evaluations is limited, half of them are reserved until the first local search has ended.
//! The sample and the parallel searches use at most the other half, and then wait. A problem with one minimum
//! is thus solved if its local search needs less than the reserved half.

mod clusters;
mod look_ahead;
mod options;
mod speculative_searches;
mod state;

pub use options::{Multistart, Polish};
pub use state::MultistartState;

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup};
use crate::methods::least_squares::LeastSquares;
use crate::methods::nelder_mead::NelderMead;
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
            "a sample of this many points and parameters",
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

    fn supports_linear(&self) -> bool {
        match self.polish {
            Polish::LeastSquares => LeastSquares::default().supports_linear(),
            Polish::NelderMead | Polish::Auto | Polish::CmaEs => true,
        }
    }

    fn supports_nonlinear(&self) -> bool {
        match self.polish {
            Polish::LeastSquares => LeastSquares::default().supports_nonlinear(),
            Polish::NelderMead => NelderMead::default().supports_nonlinear(),
            Polish::Auto | Polish::CmaEs => true,
        }
    }

    fn needs_residuals(&self) -> bool {
        self.polish == Polish::LeastSquares
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    /// Returns true if the exploration or the parallel searches are planned with the budget. Until the first
    /// search has ended, the others have half of the budget. A run continued with another limit would differ
    /// from a run with this limit.
    fn plans_with_budget(&self) -> bool {
        let explores = self.exploration.map_or(self.polish != Polish::LeastSquares, |share| share > 0.0);
        explores || self.side_by_side != Some(1)
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(1000usize.saturating_mul(n + 1)), None)
    }

    /// Caches points, because a search requests its start again.
    fn default_cache(&self) -> usize {
        1000
    }
}
