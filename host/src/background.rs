//! Starts threads, some of which end with what they serve.

use std::io;
use std::thread::{self, JoinHandle};

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

/// What a user can do when the system gives no thread.
pub(crate) const NO_THREAD: &str = "cannot start a thread; close other programs, or raise the limit of threads";

/// The stack size of the main thread: scenes and pipelines take tens of kilobytes, and are moved during construction.
const STACK_BYTES: usize = 8 << 20;

/// Starts a thread of this name.
pub(crate) fn spawn<T: Send + 'static>(
    name: String,
    run: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    thread::Builder::new().name(name).stack_size(STACK_BYTES).spawn(run)
}
