//! A browser, which has neither files nor signals.

use std::fs::File;
use std::io;
use std::path::Path;

use super::Interrupt;

/// Does nothing: nobody interrupts.
pub fn on_interrupt(_: impl Fn(Interrupt) + Send + 'static) -> io::Result<()> {
    Ok(())
}

/// Fails.
pub fn standard_output() -> io::Result<File> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Fails.
pub fn hold(_: File, _: &Path) -> io::Result<File> {
    Err(io::ErrorKind::Unsupported.into())
}
