//! What differs between operating systems: interrupts, a clock, folders, and files beyond the standard library.
//!
//! Every function exists on Unix, on Windows and in a browser, with one signature, so that no other module of this crate
//! or of `slitpose-tracking` names a system; the room of the same name in `slitpose` has what only boards and servers
//! need. A browser has neither files nor signals: its files fail when they are opened.

#[cfg(not(any(unix, windows)))]
#[path = "browser.rs"]
mod system;
#[cfg(unix)]
#[path = "unix.rs"]
mod system;
#[cfg(windows)]
#[path = "windows.rs"]
mod system;

pub use system::{
    default_permissions, hold, is_gone, is_special, machine_folder, monotonic_ns, on_interrupt, open_special,
    special_kind, standard_output, user_folder,
};

/// The folder that the environment variable `name` holds, if it is set and not empty.
#[cfg_attr(not(any(unix, windows)), expect(dead_code, reason = "a browser has no folders"))]
fn folder(name: &str) -> Option<std::path::PathBuf> {
    std::env::var_os(name).filter(|value| !value.is_empty()).map(Into::into)
}
