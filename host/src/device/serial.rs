//! A board on a serial port: USB CDC-ACM, a UART, or a pseudo-terminal.

use std::io::{self, ErrorKind, Read, Write};
use std::time::{Duration, Instant};

use serialport::{DataBits, FlowControl, Parity, SerialPort, StopBits};

use super::selector::is_path;
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
        match std::fs::metadata(path) {
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
