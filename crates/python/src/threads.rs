//! The core's threads. They are started in a way that reports a failure as a Python exception.

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

/// Interval at which a running solve checks for signals such as Ctrl-C and reports progress. A person does
/// not notice the delay, and the checks cost nothing measurable.
const PATIENCE: Duration = Duration::from_millis(50);

/// The shared pool of one thread per core, and its process: a forked child has none of its parent's
/// threads.
static SHARED: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Bytes of a thread's stack, the default of Rust.
const STACK: usize = 2 << 20;
/// Bytes that the C library needs for a new thread besides its stack, rounded up. Where it cannot get them
/// it ends the process.
const BESIDE_STACK: usize = 1 << 20;

/// Fails if there is no memory for this many more threads.
fn check_memory(threads: usize) -> io::Result<()> {
    Vec::<u8>::new()
        .try_reserve_exact(threads.saturating_mul(STACK + BESIDE_STACK))
        .map_err(|_| io::ErrorKind::OutOfMemory.into())
}

/// Starts threads one after the other, so that no stack takes memory that the thread before still needs. If
/// there is no memory for all, none is started: the C library keeps the stacks of threads that ended, so no
/// memory would be left to raise the exception.
fn start(threads: usize) -> PyResult<Arc<ThreadPool>> {
    let refused = |why| PyOSError::new_err(format!("cannot start {threads} threads: {why}"));
    check_memory(threads).map_err(|error| refused(error.to_string()))?;
    let pool = ThreadPoolBuilder::new()
        .num_threads(threads)
        .spawn_handler(|thread| {
            check_memory(1)?;
            let (ready, begun) = mpsc::channel();
            let builder = std::thread::Builder::new().stack_size(STACK);
            builder.spawn(move || {
                // The receiver below is still waiting.
                let _ = ready.send(());
                thread.run();
            })?;
            // An error means that the thread has ended already.
            let _ = begun.recv();
            Ok(())
        })
        .build();
    pool.map(Arc::new).map_err(|error| {
        let why = error.source().map_or(error.to_string(), |e| e.to_string());
        refused(why)
    })
}

/// The shared pool. Rayon's global pool would panic if threads cannot start, and in every later call.
fn shared() -> PyResult<Arc<ThreadPool>> {
    let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    match &*shared {
        Some((owner, pool)) if *owner == process => Ok(pool.clone()),
        _ => {
            let pool = start(usual_threads())?;
            // Dropping a pool of the parent process would wait for its threads for ever.
            std::mem::forget(shared.replace((process, pool.clone())));
            Ok(pool)
        }
    }
}

/// The number of threads that RAYON_NUM_THREADS sets, or one per core.
fn usual_threads() -> usize {
    let variable = std::env::var("RAYON_NUM_THREADS").ok();
    let threads = variable.and_then(|text| text.parse::<usize>().ok());
    let threads = threads.filter(|&threads| threads > 0);
    threads
        .unwrap_or_else(|| thread_count(None))
        .min(MOST_THREADS)
}

/// The number of threads; None means one per core.
pub fn thread_count(threads: Option<usize>) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, NonZero::get);
    threads.unwrap_or_else(cores)
}

/// Runs `work` on all cores and releases the GIL meanwhile.
pub fn on_all_cores<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    let pool = shared()?;
    Ok(py.detach(|| pool.install(work)))
}

/// Solves `count` rows on other threads while this thread checks for signals and reports progress.
pub fn run_interruptibly<T: Send>(
    py: Python<'_>,
    count: usize,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    solve: impl FnOnce(&AtomicBool, &AtomicUsize) -> Option<T> + Send,
) -> PyResult<T> {
    let pool = match threads {
        None => shared()?,
        // A row is solved by one thread, so more threads than rows are useless.
        Some(threads) => start(threads.min(count.max(1)))?,
    };
    let (cancelled, finished) = (AtomicBool::new(false), AtomicUsize::new(0));
    let (sender, mut receiver) = mpsc::channel();
    let solved = pool.in_place_scope(|scope| {
        let (cancelled, finished) = (&cancelled, &finished);
        scope.spawn(move |_| {
            // The receiver is alive: this scope waits for it.
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
                // The solver panicked; the panic continues when the scope ends.
                Err(mpsc::RecvTimeoutError::Disconnected) => return outcome.map(|()| None),
            }
        }
    })?;
    Ok(solved.expect("cancelled only with an error"))
}
