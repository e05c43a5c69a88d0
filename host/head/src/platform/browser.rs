//! A browser, which has neither files nor signals.

use std::fs::{File, FileType, Permissions};
use std::io;
use std::path::{Path, PathBuf};

/// Does nothing: nobody interrupts.
pub fn on_interrupt(_: impl Fn(bool) + Send + 'static) -> io::Result<()> {
    Ok(())
}

/// There is no clock; who follows boards in a browser has one.
pub fn monotonic_ns() -> u64 {
    0
}

/// There is none.
pub fn user_folder() -> Option<PathBuf> {
    None
}

/// There is none.
pub fn machine_folder() -> Option<PathBuf> {
    None
}

/// There are none.
pub fn default_permissions() -> Option<Permissions> {
    None
}

/// There is none.
pub fn is_special(_: &Path) -> bool {
    false
}

/// There is none.
pub fn special_kind(_: FileType) -> &'static str {
    "device"
}

/// Fails.
pub fn open_special(_: &Path) -> io::Result<Option<File>> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Fails.
pub fn standard_output() -> io::Result<File> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Fails.
pub fn hold(_: File, _: &Path) -> io::Result<File> {
    Err(io::ErrorKind::Unsupported.into())
}

/// No file is lost.
pub fn is_gone(_: &File, _: &Path) -> bool {
    false
}
