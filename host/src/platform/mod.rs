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
/// Systems on which this program shares no memory with others: asking for it names what serves instead.
#[cfg(not(target_os = "linux"))]
mod memory {
    use std::path::Path;
    use std::sync::atomic::AtomicU64;

    use crate::address::Address;

    #[derive(Debug)]
    pub(crate) enum SharedMemory {}

    impl SharedMemory {
        pub(crate) fn open(path: &Path, _: [u8; 8], _: usize) -> anyhow::Result<Self> {
            let address = Address::Memory(path.to_owned());
            anyhow::bail!("{address} is shared memory, which this program has on Linux only; give udp:127.0.0.1:PORT")
        }

        pub(crate) fn word(&self, _: usize) -> &AtomicU64 {
            match *self {}
        }
    }
}

pub(crate) use memory::SharedMemory;
#[cfg(unix)]
pub use system::UnixClient;
pub(crate) use system::*;
