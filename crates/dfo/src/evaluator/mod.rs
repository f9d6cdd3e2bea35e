//! Who computes: the calling thread, a pool of our own threads, or a function of the user's that takes whole batches.

mod batch_function;
mod calling_thread;
mod calls;
mod pool;

pub use batch_function::BatchView;
pub(crate) use batch_function::{BatchFunction, Batches};
pub(crate) use calling_thread::CallingThread;
pub(crate) use calls::{Evaluator, GivesUp, Polled, Wait};
pub use pool::WorkerPool;
pub(crate) use pool::{Job, Shared, Threads};
