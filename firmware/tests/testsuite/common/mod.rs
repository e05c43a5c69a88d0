//! A scripted board: hardware that follows a script, and a host that reads all packets.

use std::collections::VecDeque;

use slitpose_firmware::settings::Settings;
use slitpose_firmware::{
    Acquisition, Board, Health, Identity, Indicator, Link, STATUS_MS, ScanError, Storage, StorageError, System,
    TRANSMIT_BYTES,
};
use slitpose_protocol::{
    AdcScaling, Batch, BoardKind, BootTarget, ClockSource, Command, Configuration, Decoder, Edge, Edges, EmitterSet,
    Exposure, HardwareFault, Hashes, Hello, Level, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, Pong, Pulse, RawScan,
    Reply, Request, ResetCause, Schedule, SettingsSource, Severity, Status, encode,
};

/// Ticks per second of the scripted board.
pub const TICK_HZ: u32 = 1_000_000;

#[derive(Debug, Clone)]
pub enum Finished {
    Scan(RawScan),
    Overrun,
    Fault(HardwareFault),
}

#[derive(Debug, Default)]
pub struct Fake {
    pub now: u64,
    /// The configuration under way; `None`: emitters off.
    pub running: Option<Configuration>,
    pub sampled: u64,
    /// The fault of the next attempt to light.
    pub refuse_light: Option<HardwareFault>,
    /// How many attempts to go dark will fail.
    pub refuse_dark: u32,
    /// Whether the last attempt has.
    pub refused_dark: bool,
    /// The next attempt to stop goes dark, but the converters do not answer.
    pub deaf_converters: bool,
    /// How often the core asked to switch the emitters off.
    pub asked_dark: u32,
    pub indicator: Option<Indicator>,
    /// Readings of the sensors: volts, kelvin, thousandths.
    pub health: (f32, f32, u16),
    pub finished: VecDeque<Finished>,
    /// The settings kept, and how many polls the next Store or Forget takes.
    pub kept: Option<Settings>,
    pub storing_polls: u32,
    pub refuse_store: bool,
    pub rebooted: Option<BootTarget>,
    pub pulse: Option<Pulse>,
    pub edges: VecDeque<Edge>,
}

impl Fake {
    /// Samples `count` frames, one frame apart, if anything is running.
    pub fn sample(&mut self, count: u64) {
        let Some(running) = &self.running else { return };
        for _ in 0..count {
            let mut scan = RawScan::new(running.schedule.cells.into(), running.schedule.dark_slot().is_some());
            self.now += u64::from(running.schedule.frame_ticks);
            scan.sequence = self.sampled;
            scan.tick = self.now;
            scan.levels_mut().copy_from_slice(&running.levels);
            for (cell, pair) in scan.lit_mut().iter_mut().enumerate() {
                *pair = words(self.sampled, cell);
            }
            self.sampled += 1;
            self.finished.push_back(Finished::Scan(scan));
        }
    }

    /// Samples `count` frames and overwrites them before anyone collects them.
    pub fn overrun(&mut self, count: u64) {
        let Some(running) = &self.running else { return };
        self.now += count * u64::from(running.schedule.frame_ticks);
        self.sampled += count;
        self.finished.push_back(Finished::Overrun);
    }

    /// Drives the emitters at another level from the next frame on.
    pub fn set_level(&mut self, level: Level) {
        if let Some(running) = &mut self.running {
            running.levels.fill(level);
        }
    }
}

/// Words that tell which scan and cell they are from.
pub fn words(sequence: u64, cell: usize) -> [u16; 2] {
    [sequence as u16, !(sequence as u16).rotate_left(cell as u32)]
}

impl Acquisition for Fake {
    fn check(&self, configuration: &Configuration) -> Result<(), HardwareFault> {
        if configuration.schedule.oversampling == 3 {
            return Err(HardwareFault::Oversampling { oversampling: 3 });
        }
        Ok(())
    }

    fn limit_levels(&self, _: &Schedule, _: &mut [Level]) {}

    fn acquire(&mut self, configuration: Option<&Configuration>) -> Result<(), HardwareFault> {
        if configuration.is_some() {
            if let Some(fault) = self.refuse_light.take() {
                // A board that fails half-way may well have switched something on.
                self.running = configuration.cloned();
                return Err(fault);
            }
        } else {
            self.asked_dark += 1;
            self.refused_dark = self.refuse_dark > 0;
            if self.refused_dark {
                self.refuse_dark -= 1;
                return Err(HardwareFault::Emitters);
            }
            if std::mem::take(&mut self.deaf_converters) {
                self.running = None;
                return Err(HardwareFault::Converters);
            }
        }
        self.finished.clear();
        self.running = configuration.cloned();
        Ok(())
    }

    fn set_pulse(&mut self, pulse: Pulse, _: &Schedule) -> Result<(), HardwareFault> {
        self.pulse = Some(pulse);
        Ok(())
    }

    fn next_scan(&mut self, scan: &mut RawScan) -> Result<bool, ScanError> {
        match self.finished.pop_front() {
            Some(Finished::Scan(finished)) => {
                *scan = finished;
                Ok(true)
            }
            Some(Finished::Overrun) => Err(ScanError::Overrun),
            Some(Finished::Fault(fault)) => Err(ScanError::Fault(fault)),
            None => Ok(false),
        }
    }
}

impl Storage for Fake {
    fn store(&mut self, settings: Option<&Settings>, _: &[u8]) {
        if !self.refuse_store {
            self.kept = settings.cloned();
        }
    }

    fn stored(&mut self) -> Option<Result<(), StorageError>> {
        if self.storing_polls > 0 {
            self.storing_polls -= 1;
            return None;
        }
        Some(if std::mem::take(&mut self.refuse_store) { Err(StorageError) } else { Ok(()) })
    }
}

impl System for Fake {
    fn next_edge(&mut self) -> Option<Edge> {
        self.edges.pop_front()
    }

    fn now_ticks(&mut self) -> u64 {
        self.now
    }

    fn housekeeping(&mut self, indicator: Indicator) -> Health {
        self.indicator = Some(indicator);
        let (supply_v, temperature_k, cpu_load_permille) = self.health;
        Health { supply_v, temperature_k, cpu_load_permille }
    }

    fn reboot(&mut self, target: BootTarget) {
        assert!(self.running.is_none() || self.refused_dark, "rebooted with emitters lit");
        self.rebooted = Some(target);
    }
}

/// Two cells and a dark slot at 4 kHz.
pub fn configuration() -> Configuration {
    Configuration {
        schedule: Schedule {
            tick_hz: TICK_HZ,
            frame_ticks: 250,
            slots: [EmitterSet::of(&[0]), EmitterSet::of(&[1]), EmitterSet::DARK].into_iter().collect(),
            slot_ticks: 50,
            settling_ticks: 13,
            conversion_ticks: 1,
            oversampling: 4,
            cells: 2,
        },
        levels: [Level::NOMINAL; 2].into_iter().collect(),
        exposure: Exposure::Fixed,
    }
}

pub fn without_dark() -> Configuration {
    let mut configuration = configuration();
    configuration.schedule.slots.pop();
    configuration
}

pub fn identity() -> Identity {
    Identity {
        device_id: *b"scripted 001",
        kind: BoardKind::Simulated,
        board: "scripted",
        reset_cause: ResetCause::PowerOn,
        hashes: Hashes::default(),
        scaling: AdcScaling { zero_code: 0.0, amperes_per_code: 1e-9, bits: 12, saturation_code: 4_000 },
        full_scale_pa: None,
        clock: ClockSource::Internal,
        settings: SettingsSource::Defaults,
    }
}

/// A board with room for some twenty batches, so that it fills soon.
pub fn board(fake: Fake) -> Board<Fake, [u8; 2_048]> {
    Board::new(fake, identity(), configuration(), [0; 2_048]).expect("the configuration is valid")
}

pub fn request(number: u16, command: Command) -> Vec<u8> {
    let mut buffer = [0; MAX_REQUEST_BYTES];
    encode(&Request { number, command }, &mut buffer).expect("every command fits").to_vec()
}

#[derive(Debug, Clone, PartialEq)]
pub enum Heard {
    Edges(Edges),
    Hello { configuration: u16, schedule: Schedule, hashes: Hashes },
    Scan { configuration: u16, scan: RawScan },
    Status(Status),
    Event { severity: Severity, text: String },
    Reply(Reply),
    Pong(Pong),
}

/// The other end of the link: reads scans by the last hello before them, as a player of
/// recordings does.
struct Listener {
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    configuration: u16,
    schedule: Schedule,
}

impl Default for Listener {
    fn default() -> Self {
        Self { decoder: Decoder::new(), configuration: 0, schedule: configuration().schedule }
    }
}

impl Listener {
    /// All messages that the board has to send now.
    fn listen<const QUEUE: usize>(&mut self, board: &mut Board<Fake, [u8; QUEUE]>) -> Vec<Heard> {
        let mut heard = Vec::new();
        let mut buffer = [0; TRANSMIT_BYTES];
        loop {
            let mut bytes = board.transmit(&mut buffer);
            if bytes.is_empty() {
                assert_eq!(self.decoder.pending_bytes(), 0, "the bytes end with a whole packet");
                return heard;
            }
            while let Some(message) = self.decoder.next::<Message>(&mut bytes) {
                match message.expect("a board sends nothing damaged") {
                    Message::Hello(Hello { configuration, schedule, hashes, .. }) => {
                        self.configuration = configuration;
                        self.schedule = schedule.clone();
                        heard.push(Heard::Hello { configuration, schedule, hashes });
                    }
                    Message::Batch(batch) => {
                        assert_eq!(batch.configuration, self.configuration, "read by the wrong schedule");
                        heard.extend(scans(&batch, &self.schedule));
                    }
                    Message::Status(status) => heard.push(Heard::Status(status)),
                    Message::Event(event) => {
                        heard.push(Heard::Event { severity: event.severity, text: event.text.into() });
                    }
                    Message::Reply(reply) => heard.push(Heard::Reply(reply)),
                    Message::Pong(pong) => heard.push(Heard::Pong(pong)),
                    Message::Truth(truth) => panic!("a board knows no truth: {truth:?}"),
                    Message::Edges(edges) => heard.push(Heard::Edges(edges)),
                    Message::Poses(poses) => panic!("a board without a head solved {poses:?}"),
                }
            }
        }
    }
}

fn scans(batch: &Batch, schedule: &Schedule) -> Vec<Heard> {
    let scans = batch.scans(schedule).expect("the batch was made by this schedule");
    scans.map(|scan| Heard::Scan { configuration: batch.configuration, scan }).collect()
}

/// A board and its host.
pub struct Bench<const QUEUE: usize = 2_048> {
    pub board: Board<Fake, [u8; QUEUE]>,
    listener: Listener,
}

impl Default for Bench {
    fn default() -> Self {
        Self::of(board(Fake::default()))
    }
}

impl<const QUEUE: usize> Bench<QUEUE> {
    pub fn of(board: Board<Fake, [u8; QUEUE]>) -> Self {
        Self { board, listener: Listener::default() }
    }

    pub fn hardware(&mut self) -> &mut Fake {
        self.board.hardware_mut()
    }

    /// Says a command and does not listen.
    pub fn say(&mut self, number: u16, command: Command) {
        self.board.receive(&request(number, command));
    }

    pub fn listen(&mut self) -> Vec<Heard> {
        self.listener.listen(&mut self.board)
    }

    /// Polls with the link open, and listens.
    pub fn turn(&mut self) -> Vec<Heard> {
        self.board.poll(Link::Open);
        self.listen()
    }

    /// Says a command, and listens behind a poll.
    pub fn ask(&mut self, number: u16, command: Command) -> Vec<Heard> {
        self.say(number, command);
        self.turn()
    }

    /// The next status, behind whatever is heard ahead of it.
    pub fn status(&mut self) -> Status {
        self.hardware().now += STATUS_MS * u64::from(TICK_HZ) / 1_000;
        match self.turn().pop() {
            Some(Heard::Status(status)) => status,
            other => panic!("no status but {other:?}"),
        }
    }
}

/// The sequence numbers of the scans heard.
pub fn sequences(heard: &[Heard]) -> Vec<u64> {
    let scans = heard.iter().filter_map(|heard| match heard {
        Heard::Scan { scan, .. } => Some(scan.sequence),
        _ => None,
    });
    scans.collect()
}
