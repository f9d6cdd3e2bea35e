//! Evaluation of points: evaluators, the store of known points, and the ledger of a run.

mod batch_function;
mod by_hand;
mod calling_thread;
mod context_poller;
pub(crate) mod counted_batch;
mod evaluator;
pub(crate) mod ledger;
mod speculative_evaluations;
pub(crate) mod store;
mod threads;
mod timing;

pub use batch_function::BatchView;
pub(crate) use batch_function::{BatchFunction, Batches};
pub(crate) use by_hand::ByHand;
pub(crate) use calling_thread::CallingThread;
pub(crate) use context_poller::{ContextPoller, StopCause};
pub use evaluator::{CutoffUse, Evaluator, PollResult, Wait};
pub(crate) use speculative_evaluations::Reached;
pub(crate) use speculative_evaluations::SpeculativeEvaluations;
pub(crate) use threads::{MOST_WORKERS, OnCallingThread, Shared, pools};
