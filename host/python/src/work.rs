//! Long work beside the interpreter, arguments that it is given, and errors as exceptions.

use std::error::Error;
use std::num::NonZero;
use std::ops::Range;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;
use pyo3::{PyErr, create_exception};
use slitpose_head::causes::with_causes;
use slitpose_head::threads::{limit, on_all_cores};
use slitpose_tracking::solving::{TierChoice, is_tolerance};

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

/// Between two reads of memory that other programs write: keeps their order.
#[pyfunction]
pub(crate) fn fence() {
    std::sync::atomic::fence(Ordering::Acquire);
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

create_exception!(slitpose, SlitposeError, PyException, "What cannot be done, why, and the next step.");

/// The exception of an error, with the errors behind it.
pub(crate) fn raised(error: impl Error) -> PyErr {
    SlitposeError::new_err(with_causes(&error))
}

/// The tier by its name and tolerance.
pub(crate) fn tier_choice(tier: Option<&str>, tolerance: Option<f64>) -> Result<TierChoice, PyErr> {
    if let Some(other) = tolerance.filter(|tolerance| !is_tolerance(*tolerance)) {
        let text = format!("tolerance = {other}; give a number between 0 and 1, such as 1e-10");
        return Err(PyValueError::new_err(text));
    }
    match tier {
        None if tolerance.is_none() => Ok(TierChoice::Usual),
        None | Some("exact") => Ok(TierChoice::Exact(tolerance)),
        Some("paper") => Ok(TierChoice::Paper),
        Some(other) => Err(PyValueError::new_err(format!("tier = {other:?}; give \"paper\" or \"exact\""))),
    }
}

/// A number of seconds that is not below zero.
pub(crate) fn seconds(name: &str, value: Option<f64>) -> Result<(), PyErr> {
    match value.filter(|value| !(*value >= 0.0 && value.is_finite())) {
        Some(other) => Err(PyValueError::new_err(format!("{name} = {other}; give seconds, 0 or more"))),
        None => Ok(()),
    }
}
