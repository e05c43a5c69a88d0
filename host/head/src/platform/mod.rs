//! What differs between operating systems: interrupts, a clock, folders, and files beyond the standard library.
//!
//! Every function exists on Unix, on Windows and in a browser, with one signature, so that no other module of this crate
//! or of `slitpose-tracking` names a system; the room of the same name in `slitpose` has what only boards and servers
//! need. A browser has neither files nor signals: its files fail when they are opened.

#[cfg(not(any(unix, windows)))]
mod browser;
#[cfg(not(unix))]
mod plain;
#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

#[cfg(not(any(unix, windows)))]
pub use browser::*;
#[cfg(not(unix))]
pub use plain::*;
#[cfg(unix)]
pub use unix::*;
#[cfg(windows)]
pub use windows::*;

/// Why a program is to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interrupt {
    /// Ctrl-C, or a service manager.
    Asked,
    /// The same, of a program that was started to ignore it, as a shell starts those in the background.
    Unheeded,
    /// Its terminal was closed.
    TerminalClosed,
}

/// The folder that the environment variable `name` holds, if it is set and not empty.
fn folder(name: &str) -> Option<std::path::PathBuf> {
    std::env::var_os(name).filter(|value| !value.is_empty()).map(Into::into)
}
