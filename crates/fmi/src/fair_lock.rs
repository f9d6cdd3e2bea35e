//! The lock of a loaded library: one thread at a time, first come, first served.

use std::collections::VecDeque;
use std::fmt;
use std::marker::PhantomData;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};
use std::time::Duration;

/// Time between two calls of the function that decides whether a thread continues to wait.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

type Task = Box<dyn FnOnce() + Send>;

/// A fair reentrant lock. A thread that holds the lock may enter again. Its turns may end in any order, and
/// the last one releases the lock.
#[derive(Default)]
pub(crate) struct FairLock {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// Thread that holds the lock, and its number of turns.
    owner: Option<ThreadId>,
    turns: usize,
    /// Waiting threads, by the order of arrival.
    waiting: VecDeque<u64>,
    last_number: u64,
    /// Tasks that other threads have left for the thread that holds the lock.
    left: Vec<Task>,
}

impl fmt::Debug for FairLock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Gate")
    }
}

impl FairLock {
    /// Enters as soon as no other thread holds the lock.
    pub(crate) fn enter(self: &Arc<Self>) -> Turn {
        match self.enter_while(&mut || true) {
            Some(turn) => turn,
            None => unreachable!("it waits for as long as it takes"),
        }
    }

    /// Enters the lock if `wait` (called every 20 ms while another thread holds it) returns true until the
    /// lock is free.
    pub(crate) fn enter_while(self: &Arc<Self>, wait: &mut dyn FnMut() -> bool) -> Option<Turn> {
        let me = thread::current().id();
        let mut state = self.state();
        if state.owner != Some(me) && (state.owner.is_some() || !state.waiting.is_empty()) {
            state.last_number += 1;
            let number = state.last_number;
            state.waiting.push_back(number);
            // Removes the entry even if `wait` panics.
            let _waiting = Waiting { lock: self, number };
            loop {
                let is_next = |state: &State| state.owner.is_none() && state.waiting.front() == Some(&number);
                state = match self.changed.wait_timeout_while(state, POLL_INTERVAL, |state| !is_next(state)) {
                    Ok((state, _)) => state,
                    Err(poisoned) => poisoned.into_inner().0,
                };
                if is_next(&state) {
                    break;
                }
                drop(state);
                if !wait() {
                    return None;
                }
                state = self.state();
            }
            state.owner = Some(me);
            state.turns = 1;
            drop(state);
        } else {
            state.owner = Some(me);
            state.turns += 1;
        }
        Some(Turn { lock: Arc::clone(self), _of_thread: PhantomData })
    }

    /// Runs a task with the lock held. If no other thread holds the lock, the task runs immediately.
    /// Otherwise, the thread that holds the lock runs the task when it leaves. Never blocks.
    pub(crate) fn when_free(self: &Arc<Self>, task: impl FnOnce() + Send + 'static) {
        let mut state = self.state();
        let me = thread::current().id();
        if state.owner.is_some_and(|owner| owner != me) {
            state.left.push(Box::new(task));
            return;
        }
        state.owner = Some(me);
        state.turns += 1;
        drop(state);
        let _turn = Turn { lock: Arc::clone(self), _of_thread: PhantomData };
        task();
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// An entry in the queue.
struct Waiting<'a> {
    lock: &'a FairLock,
    number: u64,
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.lock.state().waiting.retain(|number| *number != self.number);
        self.lock.changed.notify_all();
    }
}

/// A turn of this thread.
pub(crate) struct Turn {
    lock: Arc<FairLock>,
    _of_thread: PhantomData<*const ()>,
}

impl Drop for Turn {
    fn drop(&mut self) {
        loop {
            let mut state = self.lock.state();
            if state.turns > 1 || state.left.is_empty() {
                state.turns -= 1;
                if state.turns == 0 {
                    state.owner = None;
                    if !state.waiting.is_empty() {
                        self.lock.changed.notify_all();
                    }
                }
                return;
            }
            let left = std::mem::take(&mut state.left);
            drop(state);
            left.into_iter().for_each(|task| task());
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::mpsc;

    #[test]
    fn fair_lock_admits_one_thread_and_is_reentrant() {
        let (lock, inside) = (Arc::new(FairLock::default()), AtomicU64::new(0));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..1000 {
                        let _turn = lock.enter();
                        let _again = lock.enter();
                        assert_eq!(inside.fetch_add(1, Ordering::SeqCst), 0);
                        inside.fetch_sub(1, Ordering::SeqCst);
                    }
                });
            }
        });
    }

    #[test]
    fn fair_lock_runs_left_task_after_abandoned_wait() {
        let lock = Arc::new(FairLock::default());
        let turn = lock.enter();
        let (done, seen) = mpsc::channel();
        std::thread::scope(|scope| {
            let other = scope.spawn(|| {
                assert!(lock.enter_while(&mut || false).is_none());
                lock.when_free(move || done.send(()).unwrap());
            });
            other.join().unwrap();
            assert!(seen.try_recv().is_err());
            drop(turn);
            seen.try_recv().unwrap();
            scope.spawn(|| drop(lock.enter()));
        });
        lock.when_free(|| ());
        assert!(lock.state().owner.is_none() && lock.state().waiting.is_empty());
    }

    /// A thread that leaves and immediately enters again is queued after the waiting threads.
    #[test]
    fn fair_lock_queues_reentering_thread_after_waiting_one() {
        let lock = Arc::new(FairLock::default());
        let turn = lock.enter();
        std::thread::scope(|scope| {
            let other = scope.spawn(|| drop(lock.enter()));
            while lock.state().waiting.is_empty() {
                std::thread::yield_now();
            }
            drop(turn);
            // This thread is queued after the other one, which has had its turn when this call returns.
            drop(lock.enter());
            assert!(lock.state().last_number >= 1);
            other.join().unwrap();
        });
    }
}
