//! What differs between operating systems: sockets in the file system, shared memory, serial ports, priorities, the service manager, and
//! what `doctor` reads of the machine.
//!
//! Every item exists on Unix and on Windows, with one signature, so that no other module of this crate names a system.
//! Interrupts, clocks and files are in the room of the same name in `slitpose-head`.

#[cfg(unix)]
#[path = "unix.rs"]
mod system;
#[cfg(windows)]
#[path = "windows.rs"]
mod system;

#[cfg(target_os = "linux")]
mod memory;
#[cfg(not(target_os = "linux"))]
#[path = "no_memory.rs"]
mod memory;

pub(crate) use memory::SharedMemory;
#[cfg(unix)]
pub use system::UnixClient;
pub(crate) use system::*;

/// What this program has to notify a service manager of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Notice {
    Ready,
    Alive,
    Stopping,
}
