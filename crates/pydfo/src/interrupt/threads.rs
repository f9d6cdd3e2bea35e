//! Threads with large stacks that native work is handed to; idle ones wait for the next piece, which is
//! faster than starting one for each simulation of a few microseconds.

use std::io;
use std::process;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

/// Stack of a thread: compiled models put large arrays there.
const STACK_SIZE: usize = 16 << 20;

/// Idle threads beyond this end.
const MOST_IDLE: usize = 4;

/// So long a thread looks for more before it sleeps: about as long as it takes to be woken, so that at most
/// twice the least time is spent. Who simulates in a loop has the next run ready by then.
const AWAKE: Duration = Duration::from_micros(250);

/// Looks between two readings of the clock, each of which offers the core to others.
const LOOKS: u32 = 16;

/// A piece of work. It returns what is to be done once its thread waits for more: the announcement that it is
/// done.
pub(crate) type Work = Box<dyn FnOnce() -> Box<dyn FnOnce()> + Send>;

struct Helper {
    /// The process that started the thread: a forked child has the value, but not the thread.
    process: u32,
    work: Sender<Work>,
}

static IDLE: Mutex<Vec<Helper>> = Mutex::new(Vec::new());

/// Runs `work` on a thread of its own. `work` must catch its panics.
pub(crate) fn run(mut work: Work) -> io::Result<()> {
    loop {
        let idle = lock(&IDLE).pop();
        match idle {
            Some(helper) if helper.process != process::id() => {}
            Some(helper) => match helper.work.send(work) {
                Ok(()) => return Ok(()),
                Err(refused) => work = refused.0,
            },
            None => return start(work),
        }
    }
}

fn start(work: Work) -> io::Result<()> {
    let (sender, queue) = channel::<Work>();
    let body = move || {
        let mut work = Some(work);
        while let Some(announce) = work.take().map(|work| work()) {
            let mut idle = lock(&IDLE);
            let stay = idle.len() < MOST_IDLE;
            if stay {
                idle.push(Helper { process: process::id(), work: sender.clone() });
            }
            drop(idle);
            announce();
            if stay {
                work = match soon(&queue) {
                    Err(TryRecvError::Empty) => queue.recv().ok(),
                    arrived => arrived.ok(),
                };
            }
        }
    };
    thread::Builder::new().name("pydfo-run".to_owned()).stack_size(STACK_SIZE).spawn(body).map(|_| ())
}

/// Value that arrives within `AWAKE`; the thread polls until then instead of sleeping.
pub(crate) fn soon<T>(queue: &Receiver<T>) -> Result<T, TryRecvError> {
    let asleep_from = Instant::now() + AWAKE;
    loop {
        for _ in 0..LOOKS {
            match queue.try_recv() {
                Err(TryRecvError::Empty) => std::hint::spin_loop(),
                arrived => return arrived,
            }
        }
        if Instant::now() >= asleep_from {
            return Err(TryRecvError::Empty);
        }
        thread::yield_now();
    }
}

/// A poisoned lock is no reason to fail: what we keep under locks is whole at every instant.
pub(crate) fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|e| e.into_inner())
}
