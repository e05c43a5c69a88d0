//! A simulated board as seen by its host: bytes in, bytes out, and time.

use slitpose_firmware::{Board, Identity, Link, TRANSMIT_BYTES, TransmitBuffer};
use slitpose_model::{Plan, SceneError, Tier};
use slitpose_protocol::{
    BoardKind, ClockSource, Configuration, Hashes, MAX_MESSAGE_BYTES, Message, Rejection, ResetCause, SettingsSource,
    encode,
};
use thiserror::Error;

use super::electronics::Electronics;
use super::hardware::SimulatedHardware;
use super::light::Light;
use super::trajectory::Trajectory;
use crate::front_end::{self, TimingError};
use crate::scene_file::SceneFile;

/// Bytes of the queue for the link: 100 ms of six cells, lit and dark, at 4 kHz. The link is read after every
/// frame, so the queue holds a batch at the most.
const QUEUE_BYTES: usize = 25 * 1024;

/// The firmware's core over simulated hardware.
#[derive(Debug)]
pub struct SimulatedBoard {
    board: Box<Board<SimulatedHardware, Box<[u8]>>>,
    frame_ticks: u64,
}

/// Why a scene cannot be simulated.
#[derive(Debug, Error)]
pub enum SimulatorError {
    /// The schedule.
    #[error(transparent)]
    Timing(#[from] TimingError),
    /// The optics.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The firmware's core refuses the configuration.
    #[error("the simulated board refuses the scene's schedule")]
    Refused(#[source] Rejection),
}

impl SimulatedBoard {
    /// A board with the head of `file`, its tool on `trajectory`, optics of `tier`, noise drawn from
    /// `seed`. It is idle until started.
    ///
    /// # Errors
    /// If a board cannot run the scene.
    pub fn new(file: &SceneFile, trajectory: Trajectory, tier: Tier, seed: u64) -> Result<Self, SimulatorError> {
        Self::numbered(0, file, trajectory, tier, seed)
    }

    /// As [`new`](Self::new), for one of several boards: its device id ends in `number`.
    ///
    /// # Errors
    /// If a board cannot run the scene.
    pub fn numbered(
        number: u8,
        file: &SceneFile,
        trajectory: Trajectory,
        tier: Tier,
        seed: u64,
    ) -> Result<Self, SimulatorError> {
        Self::with_light(number, file, Box::new(Plan::compile(&file.scene, tier)?), trajectory, seed)
    }

    /// As [`numbered`](Self::numbered), with a head that `file` describes, but whose detectors get `light`.
    ///
    /// # Errors
    /// If a board cannot run the scene.
    pub fn with_light(
        number: u8,
        file: &SceneFile,
        light: Box<dyn Light>,
        trajectory: Trajectory,
        seed: u64,
    ) -> Result<Self, SimulatorError> {
        let configuration: Configuration = front_end::configuration(file)?;
        let front_end = file.front_end.as_ref().ok_or_else(|| TimingError::NoFrontEnd { scene: file.name.clone() })?;
        let electronics = Electronics::new(&file.scene, front_end);
        let mut device_id = *b"simulated\0\0\0";
        device_id[11] = number;
        let identity = Identity {
            device_id,
            kind: BoardKind::Simulated,
            board: "simulated",
            reset_cause: ResetCause::PowerOn,
            hashes: Hashes { scene: Some(file.hash), calibration: None },
            scaling: electronics.scaling(),
            clock: ClockSource::Crystal,
            // Its storage is empty at every start.
            settings: SettingsSource::Defaults,
        };
        let hardware = SimulatedHardware::new(light, trajectory, electronics, configuration.schedule.tick_hz, seed);
        let frame_ticks = u64::from(configuration.schedule.frame_ticks);
        let memory = vec![0; QUEUE_BYTES].into_boxed_slice();
        let board = Board::new(hardware, identity, configuration, memory).map_err(SimulatorError::Refused)?;
        Ok(Self { board: Box::new(board), frame_ticks })
    }

    /// Sends bytes from the host to the board.
    pub fn write(&mut self, bytes: &[u8]) {
        self.board.receive(bytes);
    }

    /// Lets one frame period pass, then [`transmit`](Self::transmit)s.
    pub fn step(&mut self, bytes: &mut Vec<u8>) {
        self.board.hardware_mut().advance(self.frame_ticks);
        self.transmit(bytes);
    }

    /// Appends to `bytes` the data that the board sends over its open link: packets as on a wire, with
    /// the true pose of each scan ahead of it.
    pub fn transmit(&mut self, bytes: &mut Vec<u8>) {
        self.board.poll(Link::Open);
        let mut packet = [0; MAX_MESSAGE_BYTES];
        for truth in self.board.hardware_mut().take_truths() {
            if let Ok(packet) = encode(&Message::Truth(truth), &mut packet) {
                bytes.extend_from_slice(packet);
            }
        }
        let mut buffer: TransmitBuffer = [0; TRANSMIT_BYTES];
        loop {
            let sent = self.board.transmit(&mut buffer);
            if sent.is_empty() {
                break;
            }
            bytes.extend_from_slice(sent);
        }
    }
}
