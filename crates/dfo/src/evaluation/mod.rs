//! Points on their way to whoever evaluates them, and what is known of them: evaluators, the one store of
//! known points, the ledger of a run.

mod batch_function;
mod by_hand;
mod calling_thread;
mod context_poller;
mod evaluator;
mod guesses;
pub(crate) mod ledger;
pub(crate) mod round;
pub(crate) mod store;
mod threads;
mod timing;

pub use batch_function::BatchView;
pub(crate) use batch_function::{BatchFunction, Batches};
pub(crate) use by_hand::ByHand;
pub(crate) use calling_thread::CallingThread;
pub(crate) use context_poller::{ContextPoller, StopCause};
pub use evaluator::{CutoffUse, Evaluator, Polled, Wait};
pub(crate) use guesses::Guesses;
pub(crate) use guesses::Reached;
pub(crate) use threads::{MOST_WORKERS, OnCallingThread, Shared, Threads};
