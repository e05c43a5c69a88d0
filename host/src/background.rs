//! Threads that end with what they serve.

use std::io;
use std::thread::JoinHandle;

/// A thread that runs until its owner drops this, and with it `end`, by which the thread notices.
#[derive(Debug)]
pub(crate) struct Background<E> {
    end: Option<E>,
    thread: Option<JoinHandle<()>>,
}

impl<E> Background<E> {
    pub(crate) fn spawn(name: &str, end: E, run: impl FnOnce() + Send + 'static) -> io::Result<Self> {
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(run)?;
        Ok(Self { end: Some(end), thread: Some(thread) })
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
