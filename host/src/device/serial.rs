//! A board on a serial port: USB CDC-ACM, a UART, or a pseudo-terminal.

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use serialport::{DataBits, FlowControl, Parity, SerialPort, StopBits};

use super::discovery::is_path;
use super::ports::real_path;
use super::{Device, DeviceError, KeepAlive};

/// Baud rate, enough for a board at 7 kHz behind a UART; USB and pseudo-terminals ignore it.
const BAUD: u32 = 3_000_000;

/// One wait for bytes: short enough that an interrupt is answered at once.
const WAIT: Duration = Duration::from_millis(20);

/// Timeout of writing: the longest command takes 1 ms.
const SEND_WITHIN: Duration = Duration::from_secs(1);

/// Bytes fetched at once: 17 ms of a board at 4 kHz, as many as a pseudo-terminal holds.
const CHUNK_BYTES: usize = 4096;

/// An open serial port, held exclusively.
#[derive(Debug)]
pub struct SerialDevice {
    name: String,
    port: Box<dyn SerialPort>,
    chunk: [u8; CHUNK_BYTES],
}

impl SerialDevice {
    /// Opens the port at `path`: raw, 8N1, DTR set if there is one.
    ///
    /// # Errors
    /// If `path` is not a port, or cannot be opened.
    pub fn open(path: &str) -> Result<Self, DeviceError> {
        let name = path.to_owned();
        match fs::metadata(path) {
            Ok(found) if found.is_dir() => return Err(DeviceError::NotAPort { name, what: "folder" }),
            Ok(found) if found.is_file() => return Err(DeviceError::NotAPort { name, what: "file" }),
            Err(_) if !is_path(path) => return Err(DeviceError::NotAPath { name }),
            // Ports of some systems are not in the file system: try to open.
            _ => {}
        }
        let open = |baud| {
            serialport::new(path, baud)
                .data_bits(DataBits::Eight)
                .parity(Parity::None)
                .stop_bits(StopBits::One)
                .flow_control(FlowControl::None)
                .dtr_on_open(true)
                .exclusive(true)
                .timeout(WAIT)
                .open()
        };
        // The pseudo-terminals of macOS refuse every rate; zero leaves it alone there.
        let port = open(BAUD).or_else(|error| match error.kind {
            serialport::ErrorKind::Unknown if cfg!(target_os = "macos") => open(0),
            _ => Err(error),
        });
        match port {
            Ok(port) => Ok(Self { name, port, chunk: [0; CHUNK_BYTES] }),
            Err(source) => Err(match source.kind {
                serialport::ErrorKind::NoDevice => DeviceError::Busy { name },
                serialport::ErrorKind::Io(ErrorKind::NotFound) => DeviceError::Missing { name },
                serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => DeviceError::Forbidden { name },
                _ => DeviceError::Open { name, source },
            }),
        }
    }
}

impl Device for SerialDevice {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        let until = Instant::now() + SEND_WITHIN;
        while !bytes.is_empty() {
            match self.port.write(bytes) {
                Ok(count) => bytes = &bytes[count..],
                Err(error) if is_passing(&error) && Instant::now() < until => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool> {
        match self.port.read(&mut self.chunk) {
            // Readable but without bytes: the other end has hung up.
            Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => bytes.extend_from_slice(&self.chunk[..count]),
            Err(error) if is_passing(&error) => {}
            Err(error) => return Err(error),
        }
        Ok(true)
    }

    fn keep_alive(&self) -> io::Result<Option<KeepAlive>> {
        Ok(Some(KeepAlive::new(self.port.try_clone()?)))
    }
}

/// Whether another attempt may succeed.
fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock)
}

impl Drop for SerialDevice {
    fn drop(&mut self) {
        // A port that keeps its lines when closed would leave the board waiting for a host.
        let _ = self.port.write_data_terminal_ready(false);
    }
}

/// A program that has a port open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Holder {
    /// Number of its process.
    pub process: u32,
    /// Its name, as the system shortens it.
    pub program: String,
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} (process {})", self.program, self.process)
    }
}

/// The programs that have the port `name` open, on Linux only, and without those of other users, whose open files
/// are hidden. Reads every open file of the system.
pub(crate) fn holders(name: &str) -> Vec<Holder> {
    let port = real_path(name);
    let Ok(processes) = fs::read_dir("/proc") else {
        return Vec::new();
    };
    let number = |entry: fs::DirEntry| entry.file_name().to_str()?.parse().ok();
    let mut holders: Vec<_> = processes
        .flatten()
        .filter_map(number)
        .filter(|process| has_open(*process, &port))
        .map(|process| Holder { process, program: program(process) })
        .collect();
    holders.sort_by_key(|holder| holder.process);
    holders
}

fn has_open(process: u32, port: &Path) -> bool {
    let Ok(files) = fs::read_dir(format!("/proc/{process}/fd")) else {
        return false;
    };
    files.flatten().any(|file| fs::read_link(file.path()).is_ok_and(|target| target == port))
}

fn program(process: u32) -> String {
    let name = fs::read_to_string(format!("/proc/{process}/comm")).unwrap_or_default();
    name.trim_end().to_owned()
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn an_open_file_has_a_holder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("port");
        let name = path.to_str().unwrap();
        let file = fs::File::create(&path).unwrap();
        assert!(holders(name).iter().any(|holder| holder.process == std::process::id()));
        drop(file);
        assert_eq!(holders(name), []);
    }
}
