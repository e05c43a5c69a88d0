//! The board: its state, and the steps that commands and polls are made of.
//!
//! `commands` carries out requests of the host; `polling` does what is due and gives the
//! bytes to send. Both act on the state here, and `polling` uses `commands` for its replies.

mod commands;
mod polling;

pub(crate) use commands::check;

use core::borrow::BorrowMut;
use core::fmt::{self, Write};
use core::num::NonZeroU32;

use heapless::String;
use slitpose_protocol::schema::SchemaKeys;
use slitpose_protocol::{
    AdcScaling, BoardKind, BootTarget, ClockSource, Configuration, Decoder, Event, Exposure, HardwareFault, Hashes,
    Hello, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, PROTOCOL, Pulse, Rejection, ResetCause, SettingsSource,
    Severity, Stream,
};

use crate::collector::Collector;
use crate::exposure::AutomaticExposure;
use crate::hardware::{Hardware, Health, Indicator};
use crate::outbox::Outbox;
#[cfg(feature = "pose")]
use crate::pose::HeadError;
use crate::pose::Poser;

/// After this many milliseconds with its link closed a board stops and goes dark. Long
/// enough for a program on the host to close and reopen its port.
pub const HOST_GONE_MS: u64 = 500;

/// A status is sent this often, in milliseconds.
pub const STATUS_MS: u64 = 500;

/// Bytes handed to the link at once: any packet fits, and sixteen of full-speed USB's 64
/// bytes are filled.
pub const TRANSMIT_BYTES: usize = MAX_MESSAGE_BYTES;

/// Buffer for [`Board::transmit`].
pub type TransmitBuffer = [u8; TRANSMIT_BYTES];

/// Bytes of the longest event text; longer texts are cut.
const EVENT_TEXT_BYTES: usize = 128;

/// Whether a host listens (on USB serial: DTR).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// A host has the port open.
    Open,
    /// No host has the port open.
    Closed,
}

/// What a board says of itself in [`Hello`], besides its schedule, and of its start in
/// [`Status`](slitpose_protocol::Status).
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
    /// What a word is worth in amperes, unless a full scale is set.
    pub scaling: AdcScaling,
    /// The full scale that is set, in picoamperes.
    pub full_scale_pa: Option<NonZeroU32>,
    /// What the hardware's ticks are counted by.
    pub clock: ClockSource,
    /// Where the first configuration came from.
    pub settings: SettingsSource,
}

/// State of the emitters, as far as the hardware has confirmed it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Emitters {
    /// The hardware has confirmed that the emitters are off.
    Off,
    /// The hardware has been told to light them.
    Lit,
    /// The emitters should be off, but the hardware has not confirmed it.
    Unconfirmed,
}

/// A board over its hardware. Its memory `M` holds packets that the link has not taken yet; `P` is what solves poses, or where
/// it lies.
///
/// The owner calls [`poll`](Self::poll) at least once a millisecond,
/// [`receive`](Self::receive) when bytes come in, and [`transmit`](Self::transmit) when
/// the link can take more. No call waits.
#[derive(Debug)]
pub struct Board<H, M, P = Poser> {
    hardware: H,
    identity: Identity,
    configuration: Configuration,
    configuration_number: u16,
    collector: Collector,
    outbox: Outbox<M>,
    poser: P,
    decoder: Decoder<MAX_REQUEST_BYTES>,
    acquiring: bool,
    emitters: Emitters,
    faulty: bool,
    link: Link,
    /// When the host last gave a sign of life.
    host_tick: u64,
    /// When acquisition was stopped because the host gave no sign of life.
    host_gone: Option<u64>,
    status_tick: u64,
    status_due: bool,
    indicator: Indicator,
    health: Health,
    identify_until: u64,
    commands_damaged: u32,
    commands_rejected: u32,
    /// Number of the next edge of the trigger input.
    next_edge: u32,
    /// At work while the configuration asks for it.
    exposure: AutomaticExposure,
    storing: Option<Storing>,
    reboot: Option<Reboot>,
    /// Why the head that the board has kept is not in force, and what to do.
    lost_head: Option<&'static str>,
}

/// A Store or Forget that has not been answered yet.
#[derive(Debug, Clone, Copy)]
struct Storing {
    /// Number of the request to reply to; `None` if its host has gone.
    number: Option<u16>,
    /// What a Store keeps; `None` for a Forget.
    hashes: Option<Hashes>,
}

/// A reboot that waits for its reply to be sent.
#[derive(Debug, Clone, Copy)]
struct Reboot {
    target: BootTarget,
    /// When the board reboots even if the host has not taken the reply.
    latest: u64,
}

// The memory comes on top.
const _: () = assert!(size_of::<Board<(), &mut [u8], &mut Poser>>() <= 6 * 1024);

impl<H: Hardware, M: AsRef<[u8]> + AsMut<[u8]>> Board<H, M> {
    /// An idle board that holds all it needs: see [`with_poser`](Self::with_poser).
    ///
    /// # Errors
    /// If no board could run the configuration.
    pub fn new(hardware: H, identity: Identity, configuration: Configuration, memory: M) -> Result<Self, Rejection> {
        Self::with_poser(hardware, identity, configuration, memory, Poser::default())
    }
}

impl<H: Hardware, M: AsRef<[u8]> + AsMut<[u8]>, P: BorrowMut<Poser>> Board<H, M, P> {
    /// An idle board with its link closed. `configuration` is in force until the host
    /// sends another, and fixes the tick rate for good. `memory` is the queue of scans:
    /// when it is full, the oldest scans go.
    ///
    /// # Errors
    /// If no board could run the configuration.
    pub fn with_poser(
        mut hardware: H,
        identity: Identity,
        configuration: Configuration,
        memory: M,
        poser: P,
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
            poser,
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
            next_edge: 0,
            exposure: AutomaticExposure::new(identity.scaling),
            storing: None,
            reboot: None,
            lost_head: None,
        })
    }

    /// Puts the head in `bytes`, which the board has kept, in force.
    #[cfg(feature = "pose")]
    pub fn restore_head(&mut self, bytes: &[u8]) {
        self.lost_head =
            self.poser.borrow_mut().restore(bytes, &self.configuration.schedule).err().map(|error| match error {
                HeadError::Version { .. } => "no poses: the head that was stored is of another version; store it anew",
                HeadError::Damaged | HeadError::TooLong => {
                    "no poses: the head that was stored cannot be read; store it anew"
                }
            });
    }

    /// Scans until there is something to do: until a batch is full, or, on a board that solves poses, one; none if
    /// there is something now.
    pub fn scans_to_poll(&self) -> usize {
        match (self.poser.borrow().is_behind(), self.poser.borrow().is_at_work()) {
            (true, _) => 0,
            (false, true) => 1,
            (false, false) => self.collector.scans_to_batch(),
        }
    }

    /// Whether the board lights and samples.
    pub fn is_acquiring(&self) -> bool {
        self.acquiring
    }

    /// The hardware, for a caller that drives a simulated one.
    pub fn hardware_mut(&mut self) -> &mut H {
        &mut self.hardware
    }

    /// Ticks of a number of milliseconds.
    fn ticks(&self, milliseconds: u64) -> u64 {
        u64::from(self.configuration.schedule.tick_hz).saturating_mul(milliseconds) / 1_000
    }

    /// Collects finished scans; a contradiction in their counters ends acquisition.
    fn collect(&mut self) {
        let exposure = match self.configuration.exposure {
            Exposure::Fixed => None,
            Exposure::Automatic => Some(&mut self.exposure),
        };
        if let Err(fault) =
            self.collector.collect(&mut self.hardware, &mut self.outbox, self.poser.borrow_mut(), exposure)
        {
            self.fail(fault);
        }
    }

    /// Sends these of the scans and poses from now on.
    fn set_stream(&mut self, stream: Stream) {
        self.flush();
        self.collector.set_stream(stream);
        self.poser.borrow_mut().set_stream(stream);
    }

    /// Ends acquisition in good order. The next host may not know of poses.
    fn stop(&mut self) -> Result<(), HardwareFault> {
        let was_acquiring = self.acquiring;
        if was_acquiring {
            self.collect();
            self.acquiring = false;
        }
        // Dark first: encoding a batch takes so long that another scan would finish.
        let outcome = if self.emitters == Emitters::Off { Ok(()) } else { self.darken() };
        // Of scans that were taken the poses are sent, too. Each takes a frame at most.
        while was_acquiring && self.solve_next() {}
        self.set_stream(Stream::SCANS);
        self.collector.set_most(u8::MAX);
        let _ = self.hardware.set_pulse(Pulse::NONE, &self.configuration.schedule);
        outcome
    }

    /// Solves a scan that waits; `false` if none does.
    fn solve_next(&mut self) -> bool {
        self.poser.borrow_mut().work(&mut self.hardware, &mut self.outbox, self.collector.batch_scans())
    }

    /// Sends what is under way, full or not.
    fn flush(&mut self) {
        self.collector.flush(&mut self.outbox);
        self.poser.borrow_mut().flush(&mut self.outbox);
    }

    /// Ends acquisition because of a hardware fault, and sends an event.
    fn fail(&mut self, fault: HardwareFault) {
        self.flush();
        self.acquiring = false;
        self.faulty = true;
        let tick = self.hardware.now_ticks();
        self.tell(tick, Severity::Error, format_args!("acquisition stopped: {fault}"));
        // A failure is tried again at every poll.
        let _ = self.darken();
    }

    /// Switches the emitters off and stops sampling.
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
                // One event, although every poll tries again.
                if before != Emitters::Unconfirmed {
                    self.tell(tick, Severity::Error, format_args!("emitters may still be lit: {fault}"));
                }
            }
        }
        result
    }

    fn tell(&mut self, tick: u64, severity: Severity, text: fmt::Arguments<'_>) {
        let mut cut = String::<EVENT_TEXT_BYTES>::new();
        // The end of a longer text is cut off.
        let _ = cut.write_fmt(text);
        self.outbox.push_answer(&Message::Event(Event { tick, severity, text: &cut }));
    }

    /// Queues a warning for each part of the start that failed: a host that opens the link later
    /// hears of it, too.
    fn warn_of_start(&mut self, now: u64) {
        if self.identity.clock == ClockSource::CrystalFailed {
            let text = format_args!("the crystal did not start: running from the internal oscillator");
            self.tell(now, Severity::Warning, text);
        }
        if self.identity.settings == SettingsSource::PassedOver {
            let text = format_args!(
                "three starts in a row failed: stored settings were passed over; store them again, or forget them"
            );
            self.tell(now, Severity::Warning, text);
        }
    }

    /// Queues a warning if the head on the board is for another schedule, or was lost.
    fn warn_of_head(&mut self) {
        let text = match self.lost_head.filter(|_| !self.poser.borrow().is_at_work()) {
            _ if self.poser.borrow().is_unfit() => "no poses: the head was compiled for another schedule; send it anew",
            Some(text) => text,
            None => return,
        };
        let now = self.hardware.now_ticks();
        self.tell(now, Severity::Warning, format_args!("{text}"));
    }

    /// Queues a hello for the configuration in force.
    fn introduce(&mut self) {
        let scaling = self.identity.scaling;
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
            scaling: self
                .identity
                .full_scale_pa
                .map_or(scaling, |full_scale_pa| scaling.with_full_scale(full_scale_pa)),
            configuration: self.configuration_number,
            schedule: self.configuration.schedule.clone(),
        }));
    }
}
