//! Long work beside the interpreter.

use std::num::NonZero;
use std::ops::Range;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use slitpose_head::threads::{limit, on_all_cores};

use crate::error::raised;

/// Scenes are large, and a thread of Python may have half a megabyte.
const STACK_BYTES: usize = 16 << 20;

/// How long Ctrl-C may go unnoticed.
const MOMENT: Duration = Duration::from_millis(50);

/// Rows that one core takes at a time.
const ROWS: usize = 64;

/// Lets long calls work on `cores` cores at once, from now on and in all threads; as many as there are if never called.
/// Results do not depend on it.
#[pyfunction]
pub(crate) fn limit_cores(cores: usize) -> PyResult<()> {
    let cores = NonZero::new(cores).ok_or_else(|| PyValueError::new_err("cores = 0; give 1 or more"))?;
    limit(cores);
    Ok(())
}

/// Runs `work` on a thread of its own, without the interpreter's lock. It is to end soon once its flag is set, which
/// Ctrl-C does: then its result is lost.
pub(crate) fn beside<T: Send>(py: Python<'_>, work: impl FnOnce(&AtomicBool) -> T + Send) -> PyResult<T> {
    let stop = AtomicBool::new(false);
    py.detach(|| {
        thread::scope(|scope| {
            let (ended, end) = channel::<()>();
            let worker = thread::Builder::new().name("slitpose".to_owned()).stack_size(STACK_BYTES);
            let worker = worker.spawn_scoped(scope, || {
                let _ended = ended;
                work(&stop)
            });
            let worker = worker.map_err(raised)?;
            let mut interrupted = Ok(());
            while interrupted.is_ok() && end.recv_timeout(MOMENT) == Err(RecvTimeoutError::Timeout) {
                interrupted = Python::attach(|py| py.check_signals());
            }
            stop.store(interrupted.is_err(), Ordering::Relaxed);
            let result = worker.join().unwrap_or_else(|panic| resume_unwind(panic));
            interrupted.map(|()| result)
        })
    })
}

/// The results of `work` on each row of `rows`, in their order, on all cores.
pub(crate) fn each_row<R: Send>(py: Python<'_>, rows: usize, work: impl Fn(usize) -> R + Sync) -> PyResult<Vec<R>> {
    each_piece(py, rows, |piece| piece.map(&work).collect())
}

/// The results of `work` on pieces of `rows`, one for each row, in their order, on all cores.
pub(crate) fn each_piece<R: Send>(
    py: Python<'_>,
    rows: usize,
    work: impl Fn(Range<usize>) -> Vec<R> + Sync,
) -> PyResult<Vec<R>> {
    beside(py, |stop| {
        let pieces: Vec<Range<usize>> = (0..rows).step_by(ROWS).map(|from| from..(from + ROWS).min(rows)).collect();
        let found = on_all_cores(&pieces, |piece| match stop.load(Ordering::Relaxed) {
            true => Vec::new(),
            false => work(piece.clone()),
        });
        found.into_iter().flatten().collect()
    })
}
