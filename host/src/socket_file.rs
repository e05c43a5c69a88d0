//! Unix sockets in the file system: bound anew over one that a killed program left behind, and removed at the end.

use std::fs::{self, Permissions};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

use thiserror::Error;

#[derive(Debug, Error)]
pub(crate) enum SocketFileError {
    #[error("another program serves unix:{}; give another path, or end that program", path.display())]
    InUse { path: PathBuf },
    #[error("{} is no socket and is left alone; give another path", path.display())]
    NotASocket { path: PathBuf },
    #[error("cannot listen on unix:{}", path.display())]
    Bind { path: PathBuf, source: io::Error },
}

/// A bound socket; its file is removed when this is dropped, unless it has been replaced.
#[derive(Debug)]
pub(crate) struct SocketFile {
    path: PathBuf,
    file: [u64; 2],
}

impl SocketFile {
    /// Binds a socket at `path` by `bind`, with the permissions `mode`.
    pub(crate) fn bind<T>(
        path: &Path,
        mode: u32,
        bind: impl FnOnce(&Path) -> io::Result<T>,
    ) -> Result<(T, Self), SocketFileError> {
        let failed = |source| SocketFileError::Bind { path: path.to_owned(), source };
        match fs::symlink_metadata(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(source) => return Err(failed(source)),
            Ok(found) if !found.file_type().is_socket() => {
                return Err(SocketFileError::NotASocket { path: path.to_owned() });
            }
            Ok(_) => match UnixStream::connect(path) {
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => fs::remove_file(path).map_err(failed)?,
                Err(source) => return Err(failed(source)),
                Ok(_) => return Err(SocketFileError::InUse { path: path.to_owned() }),
            },
        }
        let socket = bind(path).map_err(failed)?;
        fs::set_permissions(path, Permissions::from_mode(mode)).map_err(failed)?;
        let file = identity(path).map_err(failed)?;
        Ok((socket, Self { path: path.to_owned(), file }))
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        if identity(&self.path).is_ok_and(|found| found == self.file) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

fn identity(path: &Path) -> io::Result<[u64; 2]> {
    fs::symlink_metadata(path).map(|found| [found.dev(), found.ino()])
}
