//! Starts threads, some of which end with what they serve.

use std::io;
use std::thread::{self, JoinHandle};

use anyhow::{Context, Result};
use tokio::runtime::Runtime;
use tokio::sync::oneshot;

/// A thread that runs until its owner drops this, and with it `end`, by which the thread notices.
#[derive(Debug)]
pub(crate) struct Background<E> {
    end: Option<E>,
    thread: Option<JoinHandle<()>>,
}

impl<E> Background<E> {
    pub(crate) fn spawn(name: &str, end: E, run: impl FnOnce() + Send + 'static) -> io::Result<Self> {
        Ok(Self { end: Some(end), thread: Some(spawn(name.to_owned(), run)?) })
    }
}

impl<E> Drop for Background<E> {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has already been reported on standard error.
            let _ = thread.join();
        }
    }
}

/// A thread that drives the tasks of `runtime` until its owner drops it. The tasks end with the runtime: to end them
/// gracefully would mean to wait for connections that hang.
pub(crate) fn drive(name: &str, runtime: Runtime) -> Result<Background<oneshot::Sender<()>>> {
    let (end, ended) = oneshot::channel();
    // Either way its other end has been dropped.
    Background::spawn(name, end, move || drop(runtime.block_on(ended))).context(NO_THREAD)
}

/// What a user can do when the system gives no thread.
pub(crate) const NO_THREAD: &str = "cannot start a thread; close other programs, or raise the limit of threads";

/// The stack size of the main thread: scenes and pipelines take tens of kilobytes, and are moved during construction.
const STACK_BYTES: usize = 8 << 20;

pub(crate) fn spawn<T: Send + 'static>(
    name: String,
    run: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    thread::Builder::new().name(name).stack_size(STACK_BYTES).spawn(run)
}
