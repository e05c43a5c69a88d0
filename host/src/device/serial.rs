//! Boards as devices: on a serial port (USB CDC-ACM, a UART, or a pseudo-terminal), and simulated.

use std::io::{ErrorKind, Read, Write};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use std::{fs, io};

use serialport::{DataBits, FlowControl, Parity, SerialPort, StopBits};
use slitpose_model::Tier;

use super::Device;
use super::error::DeviceError;
use super::listed::is_path;
use super::orders::KeepAlive;
use super::ports::is_listed;
use crate::platform::{ANY_BAUD, is_port_name};
use slitpose_head::faults::{Injector, Link};
use slitpose_head::front_end;
use slitpose_head::pace::{Pace, Speed};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{SimulatedBoard, SimulatorError, Trajectory, TrajectoryKind};
use slitpose_head::threads::lock;

/// Baud rate, enough for a board at 7 kHz behind a UART; USB and pseudo-terminals ignore it.
const BAUD: u32 = 3_000_000;

/// One wait for bytes: short enough that an interrupt is answered at once.
const WAIT: Duration = Duration::from_millis(20);

/// Timeout of writing: the longest command takes 1 ms.
const SEND_WITHIN: Duration = Duration::from_secs(1);

/// Bytes fetched at once: 17 ms of a board at 4 kHz, as many as a pseudo-terminal holds.
const CHUNK_BYTES: usize = 4096;

#[derive(Debug)]
pub struct SerialDevice {
    name: String,
    port: Box<dyn SerialPort>,
    chunk: [u8; CHUNK_BYTES],
}

impl SerialDevice {
    /// Opens the port at `path`: raw, 8N1, DTR set if there is one.
    pub fn open(path: &str) -> Result<Self, DeviceError> {
        let name = path.to_owned();
        match (!is_port_name(path)).then(|| fs::metadata(path)).transpose() {
            Ok(Some(found)) if found.is_dir() => return Err(DeviceError::NotAPort { name, what: "folder" }),
            Ok(Some(found)) if found.is_file() => return Err(DeviceError::NotAPort { name, what: "file" }),
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
                .timeout(WAIT)
                .open()
        };
        let port = open(BAUD).or_else(|error| match (error.kind, ANY_BAUD) {
            (serialport::ErrorKind::Unknown, Some(any)) => open(any),
            _ => Err(error),
        });
        match port {
            Ok(port) => Ok(Self { name, port, chunk: [0; CHUNK_BYTES] }),
            Err(source) => Err(match source.kind {
                serialport::ErrorKind::NoDevice if is_port_name(path) && !is_listed(path) => {
                    DeviceError::Missing { name }
                }
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
        KeepAlive::new(self.port.try_clone()?).map(Some)
    }
}

fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock)
}

impl Drop for SerialDevice {
    fn drop(&mut self) {
        // A port that keeps its lines when closed would leave the board waiting for a host.
        let _ = self.port.write_data_terminal_ready(false);
    }
}

// The simulated board: device time passes while its host waits for bytes.

const NAME: &str = "sim";

/// Device time that passes between two waits.
const WAIT_EVERY_S: f64 = 2e-3;

/// Most device time caught up at once. On a host that is too slow the device lags permanently, and does not keep time.
const CATCH_UP_S: f64 = 0.5;

/// Duration of the tool's motion in front of a board for trials, seconds.
const MOTION_S: f64 = 60.0;

/// A simulated board for a number of frames.
#[derive(Debug)]
pub(crate) struct SimulatedDevice {
    board: SimulatedBoard,
    frame_s: f64,
    pace: Pace,
    frames_at_once: u64,
    frames_passed: u64,
    frames: u64,
    /// Bytes sent while catching up, not fetched yet.
    said: Vec<u8>,
    wire: Option<Box<FaultyWire>>,
    was_opened: bool,
}

/// A link on which faults are injected.
#[derive(Debug)]
struct FaultyWire {
    injector: Injector,
    /// Bytes of the board, ahead of the injector.
    sent: Vec<u8>,
    /// The link is broken, and the port is back after so many seconds of device time.
    hung_up_s: Option<f64>,
}

impl SimulatedDevice {
    /// A board for trials, without end and in real time: the head of `file`, a tool that moves so.
    pub(crate) fn for_trials(file: &SceneFile, motion: TrajectoryKind) -> Result<Self, SimulatorError> {
        let trajectory = Trajectory::of_kind(motion, 1, MOTION_S).within(&file.workspace);
        let frame_s = front_end::configuration(file)?.schedule.frame_rate_hz().recip();
        let board = SimulatedBoard::new(file, trajectory, Tier::Exact { tolerance: 1e-6 }, 1)?;
        Ok(Self::new(board, frame_s, f64::INFINITY, Speed::Times(1.0)))
    }

    /// `board` for all frames of `frame_s` that begin within `duration_s`, which may be infinite.
    pub(crate) fn new(board: SimulatedBoard, frame_s: f64, duration_s: f64, speed: Speed) -> Self {
        // The number of frames must not depend on rounding of either argument. Saturates.
        let frames = (duration_s / frame_s - 1e-6).ceil() as u64;
        let frames_at_once = (WAIT_EVERY_S / frame_s).ceil() as u64;
        Self {
            board,
            frame_s,
            pace: Pace::new(speed),
            frames_at_once,
            frames_passed: 0,
            frames,
            said: Vec::new(),
            wire: None,
            was_opened: false,
        }
    }

    #[must_use]
    pub(crate) fn with_faults(mut self, injector: Option<Injector>) -> Self {
        self.wire = injector.map(|injector| Box::new(FaultyWire { injector, sent: Vec::new(), hung_up_s: None }));
        self
    }

    fn passed_s(&self) -> f64 {
        self.frames_passed as f64 * self.frame_s
    }

    fn is_hung_up(&self) -> bool {
        self.wire.as_ref().is_some_and(|wire| wire.hung_up_s.is_some())
    }

    /// Opens the port, also again after the link was lost, once it is back; `false` if faults have not broken it.
    pub(crate) fn open(&mut self) -> bool {
        if !std::mem::replace(&mut self.was_opened, true) {
            return true;
        }
        let Some(wire) = &mut self.wire else { return false };
        // A port that is closed for a moment only is still seen to be closed.
        let away = ((wire.hung_up_s.take().unwrap_or(0.0) / self.frame_s).ceil() as u64).max(1);
        for _ in 0..away {
            self.board.step_closed();
            self.pass_frame();
        }
        self.said.clear();
        true
    }

    /// A frame has passed. A board that a fault has stopped is to be started again, however late its host notices.
    fn pass_frame(&mut self) {
        self.frames_passed += 1;
        if let Some(wire) = self.wire.as_mut().filter(|_| !self.board.is_acquiring()) {
            self.frames = self.frames.saturating_add(1);
            wire.injector.idle(self.frame_s);
        }
    }

    /// Passes on bytes of the board from `start` of `bytes` on as a faulty link does.
    fn inject(&mut self, bytes: &mut Vec<u8>, start: usize) {
        let Some(wire) = &mut self.wire else { return };
        wire.sent.clear();
        wire.sent.extend(bytes.drain(start..));
        let link = wire.injector.push(&wire.sent, bytes);
        let off_s = self.board.take_off_s();
        wire.hung_up_s = match (link, off_s) {
            (Link::HungUp { for_s }, _) => Some(for_s),
            (Link::Open, off_s) => off_s,
        };
        if self.frames_passed >= self.frames && wire.hung_up_s.is_none() {
            wire.injector.finish(bytes);
        }
    }
}

impl Device for SimulatedDevice {
    fn name(&self) -> &str {
        NAME
    }

    /// A board in real time first catches up with its host.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.is_hung_up() {
            return Err(ErrorKind::ConnectionReset.into());
        }
        if self.pace.is_real_time() && self.frames_passed > 0 {
            let due = (self.pace.elapsed_s() / self.frame_s).ceil() as u64;
            let within = self.frames_passed + (CATCH_UP_S / self.frame_s).ceil() as u64;
            while self.frames_passed < due.min(within).min(self.frames) {
                self.board.step(&mut self.said);
                self.frames_passed += 1;
            }
        }
        self.board.write(bytes);
        Ok(())
    }

    fn keeps_time(&self) -> bool {
        self.pace.is_real_time()
    }

    /// Commands are answered at once: replies come before time passes.
    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool> {
        // The bytes before the break have been fetched.
        if self.is_hung_up() {
            return Err(ErrorKind::ConnectionReset.into());
        }
        let before = bytes.len();
        bytes.append(&mut self.said);
        self.board.transmit(bytes);
        if bytes.len() > before {
            self.inject(bytes, before);
            self.pace.wait(self.passed_s());
            return Ok(true);
        }
        if self.frames_passed == 0 {
            // Time does not pass before: what was asked until now was asked at device time 0, which catching up would contradict.
            self.pace = Pace::new(self.pace.speed());
        }
        let until = self.frames.min(self.frames_passed.saturating_add(self.frames_at_once));
        while self.frames_passed < until {
            self.board.step(bytes);
            self.pass_frame();
        }
        self.inject(bytes, before);
        self.pace.wait(self.passed_s());
        Ok(bytes.len() > before || self.frames_passed < self.frames)
    }
}

/// A port that may be opened again, and its name: one of several boards has a number.
#[derive(Clone, Debug)]
pub(crate) struct SimulatedPort {
    pub(crate) name: String,
    pub(crate) device: Arc<Mutex<SimulatedDevice>>,
}

impl SimulatedPort {
    /// That of `device`, which its user calls `name`.
    pub(crate) fn new(device: SimulatedDevice, name: String) -> Self {
        Self { name, device: Arc::new(Mutex::new(device)) }
    }
}

impl Device for SimulatedPort {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        lock(&self.device).send(bytes)
    }

    fn keeps_time(&self) -> bool {
        lock(&self.device).keeps_time()
    }

    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool> {
        lock(&self.device).receive(bytes)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use slitpose_head::scene_file::WIDE;

    use super::*;

    /// A host whose first ping is answered long before the first frame would see the board's clock run away from its own.
    #[test]
    fn the_time_of_a_simulated_board_begins_with_its_first_frame() {
        let mut device = SimulatedDevice::for_trials(&WIDE.read().unwrap(), TrajectoryKind::Still).unwrap();
        std::thread::sleep(Duration::from_millis(20));
        let begun = Instant::now();
        while device.frames_passed == 0 {
            device.receive(&mut Vec::new()).unwrap();
        }
        let (passed, device_s) = (begun.elapsed().as_secs_f64(), device.passed_s());
        assert!(passed >= device_s, "{device_s} s of the board in {passed} s");
    }
}
