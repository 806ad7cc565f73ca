//! The threads that the core works on, started where a failure can still be said.

use crate::input::MOST_THREADS;
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::error::Error;
use std::io;
use std::num::NonZero;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{mpsc, Arc, Mutex, PoisonError};
use std::time::Duration;

/// How long a signal such as Ctrl-C may wait, and how often progress is reported.
const PATIENCE: Duration = Duration::from_millis(50);

/// One thread a core, shared by all calls, and the process they run in: a forked child has none of
/// its parent's threads.
static SHARED: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// What a thread takes as it starts: its stack, and what the system's library keeps for it, without
/// which it would end the process.
const STACK: usize = 2 << 20;
const BESIDE_STACK: usize = 1 << 20;

/// Whether there is memory for so many more threads.
fn room(threads: usize) -> io::Result<()> {
    Vec::<u8>::new()
        .try_reserve_exact(threads.saturating_mul(STACK + BESIDE_STACK))
        .map_err(|_| io::ErrorKind::OutOfMemory.into())
}

/// Threads started one after the other, so that no stack takes the room that the thread before
/// still needs. None starts where there is no room for all: the system's library keeps the stacks
/// of those that ended, and nothing would be left to say so with.
fn start(threads: usize) -> PyResult<Arc<ThreadPool>> {
    let refused = |why| PyOSError::new_err(format!("cannot start {threads} threads: {why}"));
    room(threads).map_err(|error| refused(error.to_string()))?;
    let pool = ThreadPoolBuilder::new()
        .num_threads(threads)
        .spawn_handler(|thread| {
            room(1)?;
            let (ready, begun) = mpsc::channel();
            let builder = std::thread::Builder::new().stack_size(STACK);
            builder.spawn(move || {
                // Nobody has stopped waiting for it.
                let _ = ready.send(());
                thread.run();
            })?;
            // Disconnected without a word, it has ended already.
            let _ = begun.recv();
            Ok(())
        })
        .build();
    pool.map(Arc::new).map_err(|error| {
        let why = error.source().map_or(error.to_string(), |e| e.to_string());
        refused(why)
    })
}

/// The shared threads. Rayon's own would panic where they cannot start, then and ever after.
fn shared() -> PyResult<Arc<ThreadPool>> {
    let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    match &*shared {
        Some((owner, pool)) if *owner == process => Ok(pool.clone()),
        _ => {
            let pool = start(usual_threads())?;
            // To end the threads of another process is to wait for them for ever.
            std::mem::forget(shared.replace((process, pool.clone())));
            Ok(pool)
        }
    }
}

/// One thread a core, or as many as the environment asks for, within reason.
fn usual_threads() -> usize {
    let asked = std::env::var("RAYON_NUM_THREADS").ok();
    let asked = asked.and_then(|text| text.parse::<usize>().ok());
    let threads = asked.filter(|&threads| threads > 0);
    threads.unwrap_or_else(|| count_of(None)).min(MOST_THREADS)
}

/// How many threads None or a number of them stands for.
pub fn count_of(threads: Option<usize>) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, NonZero::get);
    threads.unwrap_or_else(cores)
}

/// Works on all cores while other Python threads run.
pub fn on_all_cores<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    let pool = shared()?;
    Ok(py.detach(|| pool.install(work)))
}

/// Solves `count` rows on other threads while this one listens for signals and reports progress.
/// None takes one thread a core.
pub fn run_interruptibly<T: Send>(
    py: Python<'_>,
    count: usize,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    solve: impl FnOnce(&AtomicBool, &AtomicUsize) -> Option<T> + Send,
) -> PyResult<T> {
    let pool = match threads {
        None => shared()?,
        // A row is solved by one thread: more than there are rows would have nothing to do.
        Some(threads) => start(threads.min(count.max(1)))?,
    };
    let (cancelled, finished) = (AtomicBool::new(false), AtomicUsize::new(0));
    let (sender, mut receiver) = mpsc::channel();
    let solved = pool.in_place_scope(|scope| {
        let (cancelled, finished) = (&cancelled, &finished);
        scope.spawn(move |_| {
            // Nobody has stopped listening: this scope waits.
            let _ = sender.send(solve(cancelled, finished));
        });
        let mut outcome = Ok(());
        loop {
            let received;
            (receiver, received) = py.detach(move || {
                let received = receiver.recv_timeout(PATIENCE);
                (receiver, received)
            });
            if outcome.is_ok() {
                outcome = py.check_signals();
                if let (Ok(()), Some(progress)) = (&outcome, progress) {
                    let done = finished.load(Ordering::Relaxed);
                    outcome = progress.call1((done, count)).map(|_| ());
                }
                if outcome.is_err() {
                    cancelled.store(true, Ordering::Relaxed);
                }
            }
            match received {
                Ok(solved) => return outcome.map(|()| solved),
                Err(mpsc::RecvTimeoutError::Timeout) => {}
                // A panic, which goes on when the scope ends.
                Err(mpsc::RecvTimeoutError::Disconnected) => return outcome.map(|()| None),
            }
        }
    })?;
    Ok(solved.expect("cancelled only with an error"))
}
