//! A simulated board with a moving tool.
//!
//! [`Trajectory`] moves the tool; the optics of the scene turn its pose at each instant into
//! photocurrents; the electronics settle, add noise, saturate and quantise; `SimulatedHardware`
//! delivers the words to the firmware's own core, as a board's converters do; [`SimulatedBoard`]
//! advances time and exchanges bytes. All results are determined by the seed. [`noisy_reading`] is the short way from
//! photocurrents to a reading, for tables.

mod electronics;
mod hardware;
mod trajectory;

use std::fmt::Debug;
use std::sync::Arc;

pub use electronics::{CellNoise, Electrode, Electronics};
use hardware::SimulatedHardware;
use slitpose_firmware::{Board, Identity, Link, TRANSMIT_BYTES, TransmitBuffer};
use slitpose_model::{CompiledScene, Detector, Noise, Pair, Pose, SceneError, Tier};
use slitpose_protocol::{
    BoardKind, ClockSource, Command, Configuration, Hashes, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, Rejection,
    Request, ResetCause, SettingsSource, encode,
};
use thiserror::Error;
pub use trajectory::{PathError, Trajectory, TrajectoryKind};

use crate::faults::{BoardFaults, FaultClock, Faults, LightFaults, Trouble, WordFaults};
use crate::front_end::{self, Stage, TimingError};
use crate::scene_file::SceneFile;

/// Optics of a head. [`CompiledScene`] has those of the model; a virtual bench may have more.
pub trait Light: Debug + Send + Sync {
    /// Number of cells.
    fn cell_count(&self) -> usize;

    /// Photocurrents of `cell` above dark, amperes, while the emitters `lit` shine, each at its level relative to
    /// nominal, with the tool at `pose`.
    ///
    /// # Panics
    /// If there is no such cell or emitter.
    fn photocurrents(&self, cell: usize, lit: &[(usize, f64)], pose: &Pose) -> Pair<f64>;
}

impl Light for CompiledScene<f64> {
    fn cell_count(&self) -> usize {
        self.cell_count()
    }

    fn photocurrents(&self, cell: usize, lit: &[(usize, f64)], pose: &Pose) -> Pair<f64> {
        self.photocurrents_of(cell, lit.iter().copied(), pose)
    }
}

/// The photocurrents `clean` of `detector` with `noise`; `normal` gives standard normal numbers, four for each reading.
///
/// Shot noise of a point spot is common to both electrodes and divides like the current; Johnson noise flows from one
/// to the other; that of the converter is each electrode's own.
pub fn noisy_reading(
    clean: Pair<f64>,
    detector: &Detector,
    noise: &Noise,
    mut normal: impl FnMut() -> f64,
) -> Pair<f64> {
    let total_a = clean.total_a();
    let variance_a2 = noise.shot_a() * total_a.abs() + noise.dark_shot_a2(detector);
    let shot = normal() * if total_a == 0.0 { 0.0 } else { variance_a2.sqrt() / total_a };
    let johnson_a = noise.johnson_a2(detector).sqrt() * normal();
    Pair {
        i_x1_a: clean.i_x1_a * (1.0 + shot) + johnson_a + noise.adc_a * normal(),
        i_x2_a: clean.i_x2_a * (1.0 + shot) - johnson_a + noise.adc_a * normal(),
    }
}

/// Noise of a row of a table: what the scene of `file` gives for tables, else that of its front end; `None` without
/// either.
///
/// # Errors
/// If the schedule of the front end cannot be run.
pub fn table_noise(file: &SceneFile) -> Result<Option<Noise>, TimingError> {
    match (&file.scene.noise, &file.front_end) {
        (None, Some(front_end)) => {
            let schedule = front_end::configuration(file)?.schedule;
            Ok(Stage::weighted_scene(file, &schedule, &electronics::scaling(front_end)).noise)
        }
        (noise, _) => Ok(*noise),
    }
}

/// Bytes of the queue for the link: 100 ms of six cells, lit and dark, at 4 kHz. The link is read after every
/// frame, so the queue holds a batch at the most.
const QUEUE_BYTES: usize = 25 * 1024;

/// The firmware's core over simulated hardware.
///
/// ```
/// use slitpose_head::{scene_file::WIDE, simulator::{SimulatedBoard, Trajectory, TrajectoryKind}};
/// use slitpose_model::Tier;
/// use slitpose_protocol::{Command, Decoder, MAX_MESSAGE_BYTES, Message};
///
/// let motion = Trajectory::of_kind(TrajectoryKind::Smooth, 1, 10.0);
/// let mut board = SimulatedBoard::new(&WIDE.read()?, motion, Tier::Paper, 1)?;
/// board.ask(1, Command::Start);
/// let mut bytes = Vec::new();
/// (0..8).for_each(|_| board.step(&mut bytes));
/// let (mut decoder, mut rest, mut batches) = (Decoder::<MAX_MESSAGE_BYTES>::new(), &bytes[..], 0);
/// while let Some(message) = decoder.next::<Message>(&mut rest) {
///     batches += usize::from(matches!(message, Ok(Message::Batch(_))));
/// }
/// assert_eq!(batches, 2, "of four scans each");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct SimulatedBoard {
    board: Box<Core>,
    frame_ticks: u64,
    /// With which it starts again.
    identity: Identity,
    configuration: Configuration,
    troubled: Option<Box<Troubled>>,
}

type Core = Board<SimulatedHardware, Box<[u8]>>;

#[derive(Debug)]
struct Troubled {
    faults: BoardFaults,
    clock: FaultClock,
    /// When the board last looked at its scans, seconds of device time.
    polled_s: f64,
    /// The board has no time to do anything.
    is_busy: bool,
    /// Ticks until the board has started.
    boots_for: u64,
    /// How long the board is without supply, seconds, until its host has noticed.
    off_s: Option<f64>,
}

/// Why a scene cannot be simulated.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum SimulatorError {
    #[error(transparent)]
    Timing(#[from] TimingError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("the simulated board refuses the scene's schedule")]
    Refused(#[source] Rejection),
}

impl SimulatedBoard {
    /// A board with the head of `file`, its tool on `trajectory`, optics of `tier`, noise drawn from
    /// `seed`. It is idle until started.
    pub fn new(file: &SceneFile, trajectory: Trajectory, tier: Tier, seed: u64) -> Result<Self, SimulatorError> {
        Self::numbered(0, file, trajectory, tier, seed)
    }

    /// As [`new`](Self::new), for one of several boards: its device id ends in `number`.
    pub fn numbered(
        number: u8,
        file: &SceneFile,
        trajectory: Trajectory,
        tier: Tier,
        seed: u64,
    ) -> Result<Self, SimulatorError> {
        Self::with_light(number, file, Arc::new(CompiledScene::compile(&file.scene, tier)?), trajectory, seed)
    }

    /// As [`numbered`](Self::numbered), with a head that `file` describes, but whose detectors get `light`.
    pub fn with_light(
        number: u8,
        file: &SceneFile,
        light: Arc<dyn Light>,
        trajectory: Trajectory,
        seed: u64,
    ) -> Result<Self, SimulatorError> {
        let configuration: Configuration = front_end::board_configuration(file)?;
        let front_end = file.front_end.as_ref().ok_or_else(|| TimingError::NoFrontEnd(file.name.clone()))?;
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
            full_scale_pa: None,
            clock: ClockSource::Crystal,
            // Its storage is empty at every start.
            settings: SettingsSource::Defaults,
        };
        let hardware = SimulatedHardware::new(light, trajectory, electronics, configuration.schedule.tick_hz, seed);
        let frame_ticks = u64::from(configuration.schedule.frame_ticks);
        let board = start(hardware, identity, &configuration).map_err(SimulatorError::Refused)?;
        Ok(Self { board: Box::new(board), frame_ticks, identity, configuration, troubled: None })
    }

    /// With these of the `faults`: in the board, and in the head of `file`, whose optics are those of `tier`. Those of the
    /// wire are for an [`Injector`](crate::faults::Injector).
    pub fn with_faults(mut self, faults: &Faults, file: &SceneFile, tier: Tier) -> Result<Self, SimulatorError> {
        let light = LightFaults::of(faults, &file.scene, tier)?;
        self.board.hardware_mut().inject(light, WordFaults::of(faults));
        let troubled = |faults| {
            let clock = FaultClock::default();
            Box::new(Troubled { faults, clock, polled_s: 0.0, is_busy: false, boots_for: 0, off_s: None })
        };
        self.troubled = BoardFaults::of(faults).map(troubled);
        Ok(self)
    }

    /// With a square wave of this frequency at its trigger input, which rises first.
    #[must_use]
    pub fn with_trigger(mut self, frequency_hz: f64) -> Self {
        let tick_hz = f64::from(self.configuration.schedule.tick_hz);
        self.board.hardware_mut().edge_ticks = (0.5 * tick_hz / frequency_hz).round() as u64;
        self
    }

    /// Sends bytes from the host to the board.
    pub fn write(&mut self, bytes: &[u8]) {
        self.board.receive(bytes);
    }

    /// Sends `command` from the host to the board, in a request of this number.
    pub fn ask(&mut self, number: u16, command: Command) {
        // Every request fits.
        if let Ok(request) = encode(&Request { number, command }, &mut [0; MAX_REQUEST_BYTES]) {
            self.write(request);
        }
    }

    /// Lets one frame period pass, then [`transmit`](Self::transmit)s.
    pub fn step(&mut self, bytes: &mut Vec<u8>) {
        self.board.hardware_mut().now_ticks += self.frame_ticks;
        let is_busy = self.begin_faults();
        if let Some(troubled) = &mut self.troubled {
            troubled.is_busy = is_busy;
        }
        self.transmit(bytes);
    }

    /// Whether the board lights and samples.
    pub fn is_acquiring(&self) -> bool {
        self.board.is_acquiring()
    }

    /// Lets one frame period pass with the link closed.
    pub fn step_closed(&mut self) {
        self.board.hardware_mut().now_ticks += self.frame_ticks;
        if let Some(troubled) = &mut self.troubled {
            (troubled.is_busy, troubled.boots_for) = (false, 0);
        }
        self.board.poll(Link::Closed);
    }

    /// How long the board is without supply since this was last asked, seconds of device time; `None` if it has not
    /// lost it. Its link is closed meanwhile.
    pub fn take_off_s(&mut self) -> Option<f64> {
        self.troubled.as_mut()?.off_s.take()
    }

    /// Lets faults of the board begin; whether they keep it from all it has to do.
    fn begin_faults(&mut self) -> bool {
        let Some(troubled) = &mut self.troubled else { return false };
        if troubled.boots_for > 0 {
            troubled.boots_for = troubled.boots_for.saturating_sub(self.frame_ticks);
            return troubled.boots_for > 0;
        }
        let hardware = self.board.hardware_mut();
        let (now, tick_hz) = (hardware.now_ticks, hardware.tick_hz);
        if let Some(run) = &hardware.run {
            troubled.clock.take(run.next_frame_ticks, tick_hz);
        }
        let Some(time_s) = troubled.clock.at(now, tick_hz) else { return false };
        let trouble = troubled.faults.begin(time_s);
        if let Some(Trouble::Reset(off_s) | Trouble::Restart(off_s)) = trouble {
            let identity = Identity { reset_cause: ResetCause::Watchdog, ..self.identity };
            let identity = match trouble {
                Some(Trouble::Restart(_)) => {
                    troubled.off_s = Some(off_s);
                    Identity { reset_cause: ResetCause::PowerOn, ..identity }
                }
                _ => {
                    troubled.boots_for = (off_s * f64::from(tick_hz)) as u64;
                    identity
                }
            };
            // The board has run this configuration.
            if let Ok(board) = start(hardware.reset(), identity, &self.configuration) {
                *self.board = board;
            }
            return true;
        }
        match trouble {
            Some(Trouble::Overrun(scans)) => hardware.overrun(scans),
            Some(Trouble::Stop) => hardware.fail(),
            _ => {}
        }
        let waits = troubled.faults.poll_s(time_s).is_some_and(|poll_s| time_s < troubled.polled_s + poll_s);
        if !waits {
            troubled.polled_s = time_s;
        }
        waits
    }

    /// Appends to `bytes` the data that the board sends over its open link: packets as on a wire, with
    /// the true pose of each scan ahead of it.
    pub fn transmit(&mut self, bytes: &mut Vec<u8>) {
        if self.troubled.as_ref().is_some_and(|troubled| troubled.is_busy) {
            return;
        }
        self.board.poll(Link::Open);
        let mut packet = [0; MAX_MESSAGE_BYTES];
        for truth in self.board.hardware_mut().truths.drain(..) {
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

fn start(hardware: SimulatedHardware, identity: Identity, configuration: &Configuration) -> Result<Core, Rejection> {
    Board::new(hardware, identity, configuration.clone(), vec![0; QUEUE_BYTES].into_boxed_slice())
}
