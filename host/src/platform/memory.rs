//! Memory that this program shares with others on Linux: a mapped file, which one program writes and others read.

use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::Path;
use std::sync::atomic::AtomicU64;

use anyhow::{Result, bail};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;
use nix::unistd::geteuid;
use vm_memory::{FileOffset, MmapRegion, VolatileMemory};

use crate::address::{Address, cannot_listen, in_use};

/// Its owner writes, its group may read. So no other user can shorten the file, which would end a program that has mapped it.
const MEMORY_MODE: u32 = 0o640;

/// Bytes at the beginning of the file that say what it is: four of its kind, then its version.
type Head = [u8; 8];

/// A mapped file. Its open file holds a lock for writing, which the kernel releases when this program ends, however it ends.
///
/// It is mapped by a library, whose references to atomics are safe, as no crate of the host may be unsafe. `pwrite` would be
/// safe, too, but takes locks of the kernel that a reader's page fault can hold, and the kernel promises no order in which a
/// reader of the mapped file sees what it writes.
#[derive(Debug)]
pub(crate) struct SharedMemory(MmapRegion);

impl SharedMemory {
    /// Maps the file of `bytes` bytes at `path`. One that an ended program has left is taken over with all that it holds, or
    /// replaced if its version or length is another; a new one is zero behind its `head`.
    pub(crate) fn open(path: &Path, head: Head, bytes: usize) -> Result<Self> {
        let address = Address::Memory(path.to_owned());
        let failed = |source| cannot_listen(&address, source);
        let (mut file, found, mut length) = claim(path, head)?;
        if length > 0 && (length != bytes as u64 || found != head) {
            fs::remove_file(path).map_err(failed)?;
            (file, _, length) = claim(path, head)?;
        }
        if length == 0 {
            // Written, not only lengthened: memory that is missing is an error here, and no SIGBUS later.
            let mut image = vec![0; bytes];
            image[..head.len()].copy_from_slice(&head);
            file.write_all(&image).map_err(failed)?;
        }
        let (access, populated) = (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_SHARED | libc::MAP_POPULATE);
        let region = MmapRegion::build(Some(FileOffset::new(file, 0)), bytes, access, populated);
        region.map(Self).map_err(|error| failed(io::Error::other(error)))
    }

    /// The word with this number, from the beginning of the file.
    ///
    /// # Panics
    /// If the file has no such word.
    pub(crate) fn word(&self, number: usize) -> &AtomicU64 {
        self.0.get_atomic_ref(number * size_of::<u64>()).expect("a word of the file")
    }
}

/// Opens and locks the file at `path`; also returns its beginning and its length.
fn claim(path: &Path, head: Head) -> Result<(File, Head, u64)> {
    let address = Address::Memory(path.to_owned());
    let failed = |source| cannot_listen(&address, source);
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false).mode(MEMORY_MODE).custom_flags(libc::O_NOFOLLOW);
    let file = options.open(path).map_err(failed)?;
    let metadata = file.metadata().map_err(failed)?;
    let mut found = Head::default();
    let is_poses = metadata.len() == 0 || file.read_exact_at(&mut found, 0).is_ok() && found[..4] == head[..4];
    if !metadata.is_file() || metadata.uid() != geteuid().as_raw() || !is_poses {
        bail!("{} is no memory of poses of this user and is left alone; give another name or path", path.display());
    }
    let whole = libc::flock { l_type: libc::F_WRLCK as i16, l_whence: 0, l_start: 0, l_len: 0, l_pid: 0 };
    match fcntl(&file, FcntlArg::F_OFD_SETLK(&whole)) {
        Ok(_) => {}
        Err(Errno::EAGAIN | Errno::EACCES) => return Err(in_use(&address)),
        Err(error) => return Err(failed(error.into())),
    }
    // Whatever the umask.
    file.set_permissions(Permissions::from_mode(MEMORY_MODE)).map_err(failed)?;
    Ok((file, found, metadata.len()))
}
