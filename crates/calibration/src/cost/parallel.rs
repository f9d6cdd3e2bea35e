//! Parallel execution of a task for many items, and of a task next to other work.

use base::RunContext;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread::Builder;
use std::time::Duration;

/// Stack size of a thread. Compiled models store large arrays on the stack.
const STACK_SIZE: usize = 16 << 20;

/// Interval between two checks of the context by the calling thread.
const POLL: Duration = Duration::from_millis(20);

/// Returns the results of `task` for the numbers below `n`, in their order. Runs up to `workers` threads, or
/// the calling thread if one is enough or no thread can be started. The calling thread checks the context. If
/// that context ends, the contexts of all tasks also end, and no further task begins. The result is `None` if
/// the task did not begin or panicked.
pub(crate) fn map<T: Send>(
    n: usize,
    workers: usize,
    context: &RunContext<'_>,
    task: &(dyn Fn(usize, &RunContext<'_>) -> T + Sync),
) -> Vec<Option<T>> {
    let mut results: Vec<Option<T>> = (0..n).map(|_| None).collect();
    let (next, is_over) = (AtomicUsize::new(0), AtomicBool::new(false));
    if n.min(workers) > 1 {
        let end = context.end();
        let (sender, receiver) = channel();
        std::thread::scope(|scope| {
            let spawn = |k: usize| {
                let (sender, next, is_over) = (sender.clone(), &next, &is_over);
                let work = move || {
                    let context = RunContext::new().flagged(is_over).until(end);
                    loop {
                        let item = next.fetch_add(1, Ordering::Relaxed);
                        if item >= n
                            || context.is_over()
                            || sender.send((item, task(item, &context))).is_err()
                        {
                            break;
                        }
                    }
                };
                let thread = Builder::new().name(format!("calibration-worker-{k}")).stack_size(STACK_SIZE);
                thread.spawn_scoped(scope, work).ok()
            };
            let threads: Vec<_> = (0..n.min(workers)).map_while(spawn).collect();
            drop(sender);
            loop {
                match receiver.recv_timeout(POLL) {
                    Ok((item, result)) => results[item] = Some(result),
                    Err(RecvTimeoutError::Timeout) if context.is_cancelled() => {
                        is_over.store(true, Ordering::Relaxed)
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => break,
                }
            }
            for thread in threads {
                // The results were already received. The result of a task that panicked is missing.
                let _ = thread.join();
            }
        });
    }
    for (item, result) in results.iter_mut().enumerate().skip(next.into_inner()) {
        if is_over.load(Ordering::Relaxed) || context.is_over() {
            break;
        }
        *result = Some(task(item, context));
    }
    results
}

/// Runs `work` on the calling thread and `task` on another thread. The context of the task ends with the
/// calling thread's context, or when the work fails. The result of the task is `None` if it panicked.
pub(crate) fn beside<T: Send, U, E>(
    context: &RunContext<'_>,
    task: impl FnOnce(&RunContext<'_>) -> T + Send,
    work: impl FnOnce() -> Result<U, E>,
) -> (Result<U, E>, Option<T>) {
    let (is_over, (sender, receiver)) = (AtomicBool::new(false), channel());
    std::thread::scope(|scope| {
        let is_over = &is_over;
        scope.spawn(move || sender.send(task(&RunContext::new().flagged(is_over))));
        let done = work();
        loop {
            if done.is_err() || context.is_over() {
                is_over.store(true, Ordering::Relaxed);
            }
            match receiver.recv_timeout(POLL) {
                Ok(result) => return (done, Some(result)),
                Err(RecvTimeoutError::Disconnected) => return (done, None),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn map_returns_results_in_item_order() {
        for workers in [1, 3, 100] {
            let squares = map(20, workers, &RunContext::new(), &|k, _| k * k);
            assert_eq!(squares, (0..20).map(|k| Some(k * k)).collect::<Vec<_>>());
        }
        assert!(map(0, 3, &RunContext::new(), &|k, _| k).is_empty());
    }

    #[test]
    fn map_begins_no_task_and_ends_running_ones_after_cancellation() {
        for workers in [1, 2] {
            let requested = std::cell::Cell::new(0);
            let cancelled = || {
                requested.set(requested.get() + 1);
                requested.get() > 2
            };
            let waited = map(100, workers, &RunContext::new().polling(&cancelled), &|_, context| {
                while !context.is_over() {
                    std::thread::yield_now();
                }
            });
            let n = waited.iter().flatten().count();
            assert!((1..=workers).contains(&n), "{n}");
        }
    }

    #[test]
    fn map_loses_one_result_when_a_task_panics() {
        let results = map(4, 2, &RunContext::new(), &|k, _| {
            assert_ne!(k, 2);
            k
        });
        assert_eq!(results, [Some(0), Some(1), None, Some(3)]);
    }
}
