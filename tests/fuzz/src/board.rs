//! The core of a board, over hardware that fails when the script says so.

use std::collections::VecDeque;

use slitpose_firmware::pcb::{default_configuration, default_scaling};
use slitpose_firmware::settings::Settings;
use slitpose_firmware::{
    Acquisition, Board, Health, Identity, Indicator, Link, ScanError, Storage, StorageError, System, TRANSMIT_BYTES,
};
use slitpose_protocol::{
    BoardKind, BootTarget, ClockSource, Configuration, Decoder, HardwareFault, Hashes, Level, MAX_MESSAGE_BYTES,
    Message, RawScan, ResetCause, Schedule, SettingsSource,
};

use crate::wire::{packet, steps};

/// Most scans that wait in the hardware: more is an overrun.
const RING: usize = 64;

/// Runs the script: bytes of the link as they are or as payloads with the right checksum, scans, faults, time. Emitters
/// are dark whenever the board does not acquire and the hardware obeys; whatever the board sends is a packet.
pub(crate) fn any_link_and_any_fault(script: &[u8]) {
    let identity = Identity {
        device_id: *b"any hardware",
        kind: BoardKind::Simulated,
        board: "any",
        reset_cause: ResetCause::Unknown,
        hashes: Hashes::default(),
        scaling: default_scaling(),
        full_scale_pa: None,
        clock: ClockSource::Internal,
        settings: SettingsSource::Defaults,
    };
    let board = Board::new(Faulty::default(), identity, default_configuration(), vec![0; 2_048]);
    let mut board = board.expect("the default runs");
    let (mut decoder, mut sent) = (Decoder::<MAX_MESSAGE_BYTES>::new(), [0; TRANSMIT_BYTES]);
    for step in steps(script) {
        let first = step.bytes.first().copied().unwrap_or_default();
        let mut link = Link::Open;
        match step.operation % 8 {
            0 => drop(board.receive(step.bytes)),
            1 => drop(board.receive(&packet(step.bytes))),
            2 => board.hardware_mut().sample(step.bytes),
            3 => board.hardware_mut().now += u64::from(first) << 14,
            4 => link = Link::Closed,
            5 => board.hardware_mut().faults.push_back(first),
            6 => board.restore_head(step.bytes),
            _ => board.hardware_mut().is_storing = first % 2 == 1,
        }
        board.poll(link);
        let obeys = !std::mem::take(&mut board.hardware_mut().has_refused_dark);
        let is_acquiring = board.is_acquiring();
        let is_lit = board.hardware_mut().running.is_some();
        assert!(is_acquiring || !is_lit || !obeys, "lit without acquisition");
        if link == Link::Closed {
            continue;
        }
        let mut bytes = board.transmit(&mut sent);
        while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
            assert!(message.is_ok(), "the board sent {message:?}");
        }
    }
    // Whatever happened: hardware that obeys is dark when the host is gone for long.
    board.hardware_mut().faults.clear();
    for _ in 0..3 {
        board.hardware_mut().now += u64::from(default_configuration().schedule.tick_hz);
        board.poll(Link::Closed);
    }
    assert!(board.hardware_mut().running.is_none() && !board.is_acquiring(), "lit though the host is gone");
}

#[derive(Default)]
struct Faulty {
    now: u64,
    running: Option<Configuration>,
    sampled: u64,
    finished: VecDeque<RawScan>,
    is_overrun: bool,
    is_storing: bool,
    has_refused_dark: bool,
    /// Of the calls that come, each of one kind.
    faults: VecDeque<u8>,
}

impl Faulty {
    /// Whether the next fault is of this kind; then it is over.
    fn fails(&mut self, kind: u8) -> bool {
        let fails = self.faults.front().is_some_and(|fault| fault % 6 == kind);
        if fails {
            self.faults.pop_front();
        }
        fails
    }

    /// A frame for each byte, whose words are that byte.
    fn sample(&mut self, words: &[u8]) {
        let Some(running) = &self.running else { return };
        for &word in words {
            let mut scan = RawScan::new(running.schedule.cells.into(), running.schedule.dark_slot().is_some());
            self.now += u64::from(running.schedule.frame_ticks);
            (scan.sequence, scan.tick) = (self.sampled, self.now);
            scan.levels_mut().copy_from_slice(&running.levels);
            scan.lit_mut().fill([u16::from(word) << 8, u16::from(word) << 7]);
            self.sampled += 1;
            if self.finished.len() < RING {
                self.finished.push_back(scan);
            } else {
                self.is_overrun = true;
            }
        }
    }
}

impl Acquisition for Faulty {
    fn check(&self, configuration: &Configuration) -> Result<(), HardwareFault> {
        match configuration.schedule.oversampling {
            3 => Err(HardwareFault::Oversampling { oversampling: 3 }),
            _ => Ok(()),
        }
    }

    fn limit_levels(&self, _: &Schedule, _: &mut [Level]) {}

    fn acquire(&mut self, configuration: Option<&Configuration>) -> Result<(), HardwareFault> {
        if configuration.is_some() && self.fails(0) {
            // Half-way: something is lit.
            self.running = configuration.cloned();
            return Err(HardwareFault::Converters);
        }
        if configuration.is_none() && self.fails(1) {
            self.has_refused_dark = true;
            return Err(HardwareFault::Emitters);
        }
        let is_deaf = configuration.is_none() && self.fails(2);
        self.finished.clear();
        self.running = configuration.cloned();
        if is_deaf { Err(HardwareFault::Converters) } else { Ok(()) }
    }

    fn next_scan(&mut self, scan: &mut RawScan) -> Result<bool, ScanError> {
        if std::mem::take(&mut self.is_overrun) {
            return Err(ScanError::Overrun);
        }
        if self.fails(3) {
            self.running = None;
            return Err(ScanError::Fault(HardwareFault::Converters));
        }
        let Some(finished) = self.finished.pop_front() else { return Ok(false) };
        *scan = finished;
        Ok(true)
    }
}

impl Storage for Faulty {
    fn store(&mut self, _: Option<&Settings>, _: &[u8]) {}

    fn stored(&mut self) -> Option<Result<(), StorageError>> {
        if self.is_storing {
            return None;
        }
        Some(if self.fails(4) { Err(StorageError) } else { Ok(()) })
    }
}

impl System for Faulty {
    fn now_ticks(&mut self) -> u64 {
        self.now
    }

    fn housekeeping(&mut self, _: Indicator) -> Health {
        Health { supply_v: 3.3, temperature_k: 298.0, cpu_load_permille: 0 }
    }

    fn reboot(&mut self, _: BootTarget) {
        assert!(self.running.is_none() || self.has_refused_dark, "rebooted with emitters lit");
    }
}
