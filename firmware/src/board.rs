//! The board: its state, its link, and what it says unasked.

use core::fmt::{self, Write};

use heapless::String;
use slitpose_protocol::schema::SchemaKeys;
use slitpose_protocol::{
    AdcScaling, BoardKind, BootTarget, Configuration, Decoder, Event, Exposure, HardwareFault, Hashes, Hello,
    MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, PROTOCOL, Rejection, ResetCause, Severity, Status, encode,
};

use crate::collector::Collector;
use crate::exposure::AutomaticExposure;
use crate::hardware::{Hardware, Health, Indicator};
use crate::outbox::Outbox;
use crate::validate::check;

/// After this many milliseconds with its link closed a board stops and goes dark. Long
/// enough for a program to close and reopen its port.
pub const HOST_GONE_MS: u64 = 500;

/// A status is sent this often, in milliseconds.
pub const STATUS_MS: u64 = 500;

/// What has been handed to the transport is surely sent this many milliseconds later, if the
/// host takes it: a kilobyte takes a UART of 3 Mbaud 3.4.
const SENDING_MS: u64 = 10;

/// Bytes handed to the transport at once: any packet fits, and sixteen of full-speed
/// USB's 64 are filled.
pub const TRANSFER_BYTES: usize = MAX_MESSAGE_BYTES;

/// Buffer for [`Board::transmit`].
pub type Transfer = [u8; TRANSFER_BYTES];

/// No packet with a status is longer: 78 bytes of payload, every number at its longest, 4
/// of checksum, 2 of framing, and 12 in hand.
const STATUS_BYTES: usize = 96;

/// Bytes of the longest event text; longer ones are cut.
const EVENT_TEXT_BYTES: usize = 128;

/// Whether somebody listens (on USB serial: DTR).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// Somebody has the port open.
    Open,
    /// Nobody has.
    Closed,
}

/// What a board says of itself in [`Hello`], besides its schedule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Identity {
    /// Unique number of the device.
    pub device_id: [u8; 12],
    /// Whether photocurrents are measured or computed.
    pub kind: BoardKind,
    /// Name of the board.
    pub board: &'static str,
    /// Why the board last started.
    pub reset_cause: ResetCause,
    /// Hashes stored on the board.
    pub hashes: Hashes,
    /// What a word is worth in amperes.
    pub scaling: AdcScaling,
}

/// What is known of the emitters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Emitters {
    /// The hardware has confirmed that they are off.
    Off,
    /// They have been told to light.
    Lit,
    /// They should be off, but the hardware has not confirmed it.
    Unconfirmed,
}

/// A board over its hardware. Its memory `M` holds packets that the link has not taken yet.
///
/// The owner calls [`poll`](Self::poll) at least once a millisecond,
/// [`receive`](Self::receive) when bytes come in, and [`transmit`](Self::transmit) when
/// the transport can take more. Nothing here waits.
#[derive(Debug)]
pub struct Board<H, M> {
    pub(crate) hardware: H,
    pub(crate) identity: Identity,
    pub(crate) configuration: Configuration,
    pub(crate) configuration_number: u16,
    pub(crate) collector: Collector,
    pub(crate) outbox: Outbox<M>,
    pub(crate) decoder: Decoder<MAX_REQUEST_BYTES>,
    pub(crate) acquiring: bool,
    pub(crate) emitters: Emitters,
    pub(crate) faulty: bool,
    link: Link,
    /// When the host last gave a sign of life.
    pub(crate) host_tick: u64,
    /// When acquisition was stopped because it gave none.
    host_gone: Option<u64>,
    status_tick: u64,
    status_due: bool,
    indicator: Indicator,
    health: Health,
    pub(crate) identify_until: u64,
    pub(crate) commands_damaged: u32,
    pub(crate) commands_rejected: u32,
    /// At work while the configuration asks for it.
    pub(crate) exposure: AutomaticExposure,
    pub(crate) storing: Option<Storing>,
    pub(crate) reboot: Option<Reboot>,
}

/// A Store or Forget that has not been answered yet.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Storing {
    /// The number to answer; `None` if whoever asked has gone.
    pub number: Option<u16>,
    pub hashes: Hashes,
}

/// A reboot that waits for its reply to be sent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reboot {
    pub target: BootTarget,
    /// When it happens even if nobody takes the reply.
    pub latest: u64,
}

// The memory comes on top.
const _: () = assert!(size_of::<Board<(), &mut [u8]>>() <= 6 * 1024);

impl<H: Hardware, M: AsRef<[u8]> + AsMut<[u8]>> Board<H, M> {
    /// An idle board with its link closed. `configuration` is in force until the host
    /// sends another, and fixes the tick rate for good. `memory` has
    /// [`DEFAULT_QUEUE_BYTES`](crate::DEFAULT_QUEUE_BYTES), or what the board can spare.
    ///
    /// # Errors
    /// If the configuration cannot be run.
    pub fn new(
        mut hardware: H,
        identity: Identity,
        configuration: Configuration,
        memory: M,
    ) -> Result<Self, Rejection> {
        check(&configuration, configuration.schedule.tick_hz)?;
        let now = hardware.now_ticks();
        let health = hardware.housekeeping(Indicator::Idle);
        Ok(Self {
            hardware,
            identity,
            collector: Collector::new(0, &configuration.schedule),
            configuration,
            configuration_number: 0,
            outbox: Outbox::new(memory),
            decoder: Decoder::new(),
            acquiring: false,
            // The first poll makes sure.
            emitters: Emitters::Unconfirmed,
            faulty: false,
            link: Link::Closed,
            host_tick: now,
            host_gone: None,
            status_tick: now,
            status_due: false,
            indicator: Indicator::Idle,
            health,
            identify_until: now,
            commands_damaged: 0,
            commands_rejected: 0,
            exposure: AutomaticExposure::new(identity.scaling),
            storing: None,
            reboot: None,
        })
    }

    /// Does what is due: follows the link, collects finished scans, makes a status.
    pub fn poll(&mut self, link: Link) {
        let now = self.hardware.now_ticks();
        self.follow(link, now);
        if self.acquiring {
            self.collect();
            self.expose();
        } else if self.emitters != Emitters::Off {
            // Tried again at the next poll if it fails.
            let _ = self.darken();
        }
        self.answer_storing();
        self.report(now);
        self.reboot_if_due(now);
    }

    /// Fills `transfer` with whole packets, oldest first, and gives the bytes to send;
    /// none if there is nothing to say. What has been given counts as sent.
    pub fn transmit<'t>(&mut self, transfer: &'t mut Transfer) -> &'t [u8] {
        let reserved = if self.status_due { STATUS_BYTES } else { 0 };
        let mut filled = self.outbox.take(&mut transfer[..TRANSFER_BYTES - reserved]);
        // Made only now, so that it is never stale and takes no room while nobody reads.
        if self.status_due {
            let status = Message::Status(self.status());
            filled += encode(&status, &mut transfer[filled..]).map_or(0, <[u8]>::len);
            self.status_due = false;
        }
        &transfer[..filled]
    }

    /// Scans until the batch under way is full: there is nothing to poll for before.
    pub fn scans_to_batch(&self) -> usize {
        self.collector.scans_to_batch()
    }

    /// Whether the board lights and samples.
    pub fn is_acquiring(&self) -> bool {
        self.acquiring
    }

    /// The hardware, for whoever drives a simulated one.
    pub fn hardware_mut(&mut self) -> &mut H {
        &mut self.hardware
    }

    fn follow(&mut self, link: Link, now: u64) {
        match (self.link, link) {
            (Link::Closed, Link::Open) => {
                self.outbox.open();
                self.status_tick = now;
                self.introduce();
                if let Some(tick) = self.host_gone.take() {
                    self.tell(
                        tick,
                        Severity::Warning,
                        format_args!("acquisition stopped: the link had been closed for {HOST_GONE_MS} ms"),
                    );
                }
            }
            (Link::Open, Link::Closed) => {
                self.outbox.close();
                self.decoder.reset();
                self.status_due = false;
                if let Some(storing) = &mut self.storing {
                    storing.number = None;
                }
            }
            _ => {}
        }
        self.link = link;
        if link == Link::Open {
            self.host_tick = now;
        } else if self.acquiring && now.saturating_sub(self.host_tick) >= self.ticks(HOST_GONE_MS) {
            self.host_gone = Some(now);
            // A failure to go dark is tried again at every poll.
            let _ = self.stop();
        }
    }

    fn report(&mut self, now: u64) {
        let indicator = if now < self.identify_until {
            Indicator::Identify
        } else if self.faulty {
            Indicator::Fault
        } else if self.acquiring {
            Indicator::Acquiring
        } else {
            Indicator::Idle
        };
        let due = now.saturating_sub(self.status_tick) >= self.ticks(STATUS_MS);
        if due || indicator != self.indicator {
            self.indicator = indicator;
            self.health = self.hardware.housekeeping(indicator);
        }
        if due {
            self.status_tick = now;
            self.status_due = self.link == Link::Open;
        }
    }

    /// Ticks of a number of milliseconds.
    pub(crate) fn ticks(&self, milliseconds: u64) -> u64 {
        u64::from(self.configuration.schedule.tick_hz).saturating_mul(milliseconds) / 1_000
    }

    /// Collects finished scans; a contradiction in them ends acquisition.
    pub(crate) fn collect(&mut self) {
        let exposure = match self.configuration.exposure {
            Exposure::Fixed => None,
            Exposure::Automatic => Some(&mut self.exposure),
        };
        if let Err(fault) = self.collector.collect(&mut self.hardware, &mut self.outbox, exposure) {
            self.fail(fault);
        }
    }

    /// Lights with other levels from the next frame on, if exposure asks for them.
    fn expose(&mut self) {
        if !self.acquiring || self.configuration.exposure == Exposure::Fixed {
            return;
        }
        let now = self.hardware.now_ticks();
        let Some(levels) = self.exposure.levels(now, &self.configuration) else {
            return;
        };
        self.configuration.levels = levels;
        if let Err(fault) = self.hardware.acquire(Some(&self.configuration)) {
            self.fail(fault);
        }
    }

    fn reboot_if_due(&mut self, now: u64) {
        let sent = now.saturating_add(self.ticks(SENDING_MS));
        let is_done = self.outbox.is_empty() && self.storing.is_none();
        let Some(reboot) = &mut self.reboot else {
            return;
        };
        if is_done {
            reboot.latest = reboot.latest.min(sent);
        }
        if now >= reboot.latest {
            let target = reboot.target;
            self.reboot = None;
            // Whatever has been started in the meantime.
            let _ = self.stop();
            self.hardware.reboot(target);
        }
    }

    /// Ends acquisition in good order.
    pub(crate) fn stop(&mut self) -> Result<(), HardwareFault> {
        let was_acquiring = self.acquiring;
        if was_acquiring {
            self.collect();
            self.acquiring = false;
        }
        // Dark first: making a batch takes its time, in which another scan would be taken.
        let outcome = if self.emitters == Emitters::Off { Ok(()) } else { self.darken() };
        if was_acquiring {
            self.collector.flush(&mut self.outbox);
        }
        outcome
    }

    /// Ends acquisition because the hardware failed, and says so.
    pub(crate) fn fail(&mut self, fault: HardwareFault) {
        self.collector.flush(&mut self.outbox);
        self.acquiring = false;
        self.faulty = true;
        let tick = self.hardware.now_ticks();
        self.tell(tick, Severity::Error, format_args!("acquisition stopped: {fault}"));
        // Tried again at every poll if it fails.
        let _ = self.darken();
    }

    fn darken(&mut self) -> Result<(), HardwareFault> {
        let result = self.hardware.acquire(None);
        let before = self.emitters;
        self.emitters = Emitters::Off;
        if let Err(fault) = result {
            self.faulty = true;
            let tick = self.hardware.now_ticks();
            if fault != HardwareFault::Emitters {
                self.tell(tick, Severity::Error, format_args!("sampling may not have stopped: {fault}"));
            } else {
                self.emitters = Emitters::Unconfirmed;
                // Once: it is tried again at every poll.
                if before != Emitters::Unconfirmed {
                    self.tell(tick, Severity::Error, format_args!("emitters may still be lit: {fault}"));
                }
            }
        }
        result
    }

    fn tell(&mut self, tick: u64, severity: Severity, text: fmt::Arguments<'_>) {
        let mut cut = String::<EVENT_TEXT_BYTES>::new();
        // What does not fit is cut off.
        let _ = cut.write_fmt(text);
        self.outbox.push_answer(&Message::Event(Event { tick, severity, text: &cut }));
    }

    /// Queues a hello for the configuration in force.
    pub(crate) fn introduce(&mut self) {
        self.outbox.push_answer(&Message::Hello(Hello {
            protocol: PROTOCOL,
            message_keys: SchemaKeys::messages(),
            command_keys: SchemaKeys::commands(),
            device_id: self.identity.device_id,
            kind: self.identity.kind,
            board: self.identity.board,
            firmware: env!("CARGO_PKG_VERSION"),
            reset_cause: self.identity.reset_cause,
            hashes: self.identity.hashes,
            scaling: self.identity.scaling,
            configuration: self.configuration_number,
            schedule: self.configuration.schedule.clone(),
        }));
    }

    fn status(&mut self) -> Status {
        let dropped = self.outbox.dropped();
        Status {
            tick: self.hardware.now_ticks(),
            acquiring: self.acquiring,
            scans_taken: self.collector.taken(),
            scans_dropped: dropped.scans,
            batches_dropped: dropped.batches,
            scans_lost: self.collector.lost(),
            adc_overruns: self.collector.overruns(),
            replies_dropped: dropped.answers,
            commands_damaged: self.commands_damaged,
            commands_rejected: self.commands_rejected,
            supply_v: self.health.supply_v,
            temperature_k: self.health.temperature_k,
            cpu_load_permille: self.health.cpu_load_permille,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_status_fits_its_reserve() {
        let status = Message::Status(Status {
            tick: u64::MAX,
            acquiring: true,
            scans_taken: u64::MAX,
            scans_dropped: u64::MAX,
            batches_dropped: u32::MAX,
            scans_lost: u64::MAX,
            adc_overruns: u32::MAX,
            replies_dropped: u32::MAX,
            commands_damaged: u32::MAX,
            commands_rejected: u32::MAX,
            supply_v: f32::MIN,
            temperature_k: f32::MIN,
            cpu_load_permille: u16::MAX,
        });
        assert_eq!(encode(&status, &mut [0; STATUS_BYTES]).map(<[u8]>::len), Ok(STATUS_BYTES - 12));
    }
}
