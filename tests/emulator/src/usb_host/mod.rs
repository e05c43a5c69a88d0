//! A host computer's USB port with a driver for serial devices behind it.
//!
//! It finds a device by its pull-up, resets it, reads its descriptors, configures it, opens it as a CDC-ACM serial port, and
//! then moves bytes. It acts on machine time: [`UsbHost::advance`] at [`UsbHost::next_event`]. Each transaction takes the time
//! it takes on the wire. A request or an endpoint that the device refuses, or does not answer, is reported and not retried;
//! repeated data are ignored.
//!
//! ```text
//! port ─▶ enumeration ─▶ transfer ─▶ transaction ─▶ UsbPort
//!                        pipes   ───┘
//! ```
//! `enumeration` says what to ask next, `transfer` has a control transfer and the pipes of bulk and interrupt
//! endpoints. This module has the port, the frames, the choice of the next transaction, and what a user of the host may do.

mod enumeration;
mod transfer;

use std::collections::VecDeque;

use crate::peripherals::usb::UsbPort;
use crate::peripherals::{TICKS_PER_SECOND, Ticks};
use crate::usb_wire::{self, Answer, BusSignal, FRAME_TICKS, OutPacket};

pub use enumeration::DeviceDescription;

use enumeration::Enumeration;
use transfer::{Pipe, Transfer};

const MS: Ticks = TICKS_PER_SECOND / 1_000;

/// How often the port is looked at for a pull-up.
const WATCH_TICKS: Ticks = MS;

/// For how long the pull-up must have been there (TATTDB, USB 2.0 section 7.1.7.3).
const DEBOUNCE_TICKS: Ticks = 100 * MS;

/// Reset by a root port (TDRSTR, section 7.1.7.5).
const RESET_TICKS: Ticks = 50 * MS;

/// What a device may take before it answers after a reset or a resumption (TRSTRCY, TRSMRCY,
/// section 7.1.7).
const RECOVERY_TICKS: Ticks = 10 * MS;

/// For how long resumption is signalled (TDRSMDN, section 7.1.7.7).
const RESUME_TICKS: Ticks = 20 * MS;

#[derive(Debug, Default)]
pub struct UsbHost {
    port: Port,
    cable: bool,
    /// The cable was pulled since the port was last looked at.
    pulled: bool,
    /// What to do with the port when the bus is free.
    order: Option<Order>,
    /// When something is to be done next.
    due: Ticks,
    next_frame: Ticks,
    frame_number: u16,
    /// No transaction begins earlier.
    quiet_until: Ticks,
    in_flight: Option<InFlight>,
    transfer: Option<Transfer>,
    enumeration: Enumeration,
    /// Notification, bulk IN and bulk OUT.
    pipes: Option<[Pipe; 3]>,
    last_was_out: bool,
    dtr: bool,
    reading: bool,
    outgoing: VecDeque<u8>,
    received: Vec<(Ticks, Vec<u8>)>,
    complaints: Vec<String>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Port {
    Open,
    #[default]
    Watching,
    Debouncing {
        until: Ticks,
    },
    Resetting {
        until: Ticks,
    },
    Active,
    Suspended,
    Resuming {
        until: Ticks,
    },
}

/// What the computer does to its port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Stops all traffic, as when it sleeps.
    Suspend,
    Resume,
    /// Resets the bus in the middle of what goes on; the device is then enumerated anew.
    Reset,
}

/// Whom a transaction is for; pipes by their place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purpose {
    Control,
    Pipe(usize),
}

const NOTIFICATION: usize = 0;
const BULK_IN: usize = 1;
const BULK_OUT: usize = 2;

#[derive(Debug)]
struct InFlight {
    end: Ticks,
    purpose: Purpose,
    endpoint: u8,
    kind: Kind,
}

#[derive(Debug)]
enum Kind {
    In(Answer),
    Out { setup: bool, toggle: bool, bytes: Vec<u8> },
}

impl UsbHost {
    /// A host that reads, with the cable in its port and DTR off.
    pub fn new() -> Self {
        Self { cable: true, next_frame: Ticks::MAX, reading: true, ..Self::default() }
    }

    pub fn detach(&mut self, now: Ticks) {
        (self.cable, self.pulled) = (false, true);
        self.due = now;
    }

    pub fn attach(&mut self, now: Ticks) {
        if !self.cable {
            self.cable = true;
            self.due = now;
        }
    }

    pub fn order(&mut self, order: Order, now: Ticks) {
        self.order = Some(order);
        self.hurry(now);
    }

    /// Whether traffic is stopped, or about to be.
    pub fn is_suspended(&self) -> bool {
        self.port == Port::Suspended || self.order == Some(Order::Suspend)
    }

    /// Opens (`true`) or closes the serial port: sets DTR as soon as the device is configured.
    pub fn set_dtr(&mut self, dtr: bool, now: Ticks) {
        self.dtr = dtr;
        self.hurry(now);
    }

    /// Whether DTR has been set and acknowledged by the device.
    pub fn dtr(&self) -> bool {
        self.enumeration.dtr
    }

    /// Stops (`true`) or resumes asking for bytes, as when no program reads the port.
    pub fn stop_reading(&mut self, stop: bool, now: Ticks) {
        self.reading = !stop;
        self.hurry(now);
    }

    /// Bytes for the device. They leave once it is configured.
    pub fn send(&mut self, bytes: &[u8], now: Ticks) {
        self.outgoing.extend(bytes);
        self.hurry(now);
    }

    /// Packets received since the last call, in order, each with the tick at which it was over.
    pub fn take_received(&mut self) -> Vec<(Ticks, Vec<u8>)> {
        std::mem::take(&mut self.received)
    }

    /// Whether the device is configured and its serial port set up.
    pub fn is_configured(&self) -> bool {
        self.enumeration.is_ready()
    }

    /// What the device has said of itself so far.
    pub fn device(&self) -> &DeviceDescription {
        &self.enumeration.description
    }

    /// What the device should not have done, in order.
    pub fn complaints(&self) -> &[String] {
        &self.complaints
    }

    pub fn next_event(&self) -> Ticks {
        self.due
    }

    pub fn advance(&mut self, now: Ticks, device: &mut UsbPort<'_>) {
        if now < self.due {
            return;
        }
        if std::mem::take(&mut self.pulled) {
            self.leave(Port::Open, device);
        }
        match self.port {
            Port::Open if !self.cable => self.due = Ticks::MAX,
            Port::Open => self.disconnect(now, device),
            Port::Watching if device.is_pulled_up() => self.enter(Port::Debouncing { until: now + DEBOUNCE_TICKS }),
            Port::Watching => self.due = now + WATCH_TICKS,
            Port::Debouncing { .. } | Port::Resetting { .. } | Port::Resuming { .. } if !device.is_pulled_up() => {
                self.disconnect(now, device);
            }
            Port::Debouncing { until } | Port::Resetting { until } | Port::Resuming { until } if now < until => {
                self.due = until;
            }
            Port::Debouncing { .. } => {
                device.signal(BusSignal::ResetBegins);
                self.enter(Port::Resetting { until: now + RESET_TICKS });
            }
            Port::Resetting { .. } => {
                device.signal(BusSignal::ResetEnds);
                self.enumeration = Enumeration::begin();
                self.transfer = None;
                self.pipes = None;
                self.start_frames(now, device);
            }
            Port::Resuming { .. } => {
                device.signal(BusSignal::ResumeEnds);
                self.start_frames(now, device);
            }
            Port::Suspended => self.sleep(now, device),
            Port::Active => self.run(now, device),
        }
    }

    fn enter(&mut self, port: Port) {
        self.port = port;
        if let Port::Debouncing { until } | Port::Resetting { until } | Port::Resuming { until } = port {
            self.due = until;
        }
    }

    /// Something has changed that may be acted on at once.
    fn hurry(&mut self, now: Ticks) {
        if matches!(self.port, Port::Active | Port::Suspended) && self.in_flight.is_none() {
            self.due = now;
        }
    }

    fn start_frames(&mut self, now: Ticks, device: &mut UsbPort<'_>) {
        self.port = Port::Active;
        self.next_frame = now;
        self.quiet_until = now + RECOVERY_TICKS;
        self.run(now, device);
    }

    fn lose_device(&mut self) {
        self.in_flight = None;
        self.transfer = None;
        self.pipes = None;
        self.order = None;
        self.enumeration.lose();
    }

    fn disconnect(&mut self, now: Ticks, device: &mut UsbPort<'_>) {
        self.leave(Port::Watching, device);
        self.due = now + WATCH_TICKS;
    }

    /// Ends whatever goes on with a device; lines that are held down for it come back to rest.
    fn leave(&mut self, port: Port, device: &mut UsbPort<'_>) {
        if matches!(self.port, Port::Resetting { .. } | Port::Resuming { .. }) {
            device.signal(BusSignal::ResetEnds);
        }
        self.lose_device();
        self.port = port;
    }

    fn sleep(&mut self, now: Ticks, device: &mut UsbPort<'_>) {
        match self.order.take() {
            Some(Order::Resume) => {
                device.signal(BusSignal::ResumeBegins);
                self.enter(Port::Resuming { until: now + RESUME_TICKS });
            }
            _ if !device.is_pulled_up() => self.disconnect(now, device),
            _ => self.due = now + WATCH_TICKS,
        }
    }

    /// An active port: ends a transaction, begins a frame, begins a transaction.
    fn run(&mut self, now: Ticks, device: &mut UsbPort<'_>) {
        if let Some(in_flight) = self.in_flight.take() {
            if now < in_flight.end {
                self.due = in_flight.end;
                self.in_flight = Some(in_flight);
                return;
            }
            self.complete(in_flight, now, device);
        }
        match self.order.take() {
            Some(Order::Suspend) => {
                self.port = Port::Suspended;
                self.due = now + WATCH_TICKS;
                return;
            }
            Some(Order::Reset) => {
                self.lose_device();
                device.signal(BusSignal::ResetBegins);
                self.enter(Port::Resetting { until: now + RESET_TICKS });
                return;
            }
            Some(Order::Resume) | None => {}
        }
        if now >= self.next_frame {
            if !device.is_pulled_up() {
                self.disconnect(now, device);
                return;
            }
            device.signal(BusSignal::StartOfFrame(self.frame_number));
            self.frame_number = (self.frame_number + 1) & 0x7ff;
            self.next_frame += FRAME_TICKS;
            self.quiet_until = self.quiet_until.max(now + usb_wire::start_of_frame_ticks());
        }
        self.due = self.next_frame;
        if now >= self.quiet_until {
            self.begin_transaction(now, device);
        } else {
            self.due = self.due.min(self.quiet_until);
        }
    }

    /// Begins the transaction that is next in turn, if there is one and the frame has room for it.
    fn begin_transaction(&mut self, now: Ticks, device: &mut UsbPort<'_>) {
        if self.transfer.is_none()
            && let Some(request) = self.enumeration.next_request(self.dtr)
        {
            self.transfer = Some(Transfer::new(request, self.enumeration.control_packet_bytes(), now));
        }
        let control_at = self.transfer.as_ref().map_or(Ticks::MAX, |transfer| transfer.pipe.ready_at);
        let mut pipes_at = [Ticks::MAX; 3];
        if let Some(pipes) = &self.pipes {
            let is_used = [true, self.reading, !self.outgoing.is_empty()];
            for (at, (pipe, is_used)) in pipes_at.iter_mut().zip(pipes.iter().zip(is_used)) {
                *at = if is_used { pipe.ready_at } else { Ticks::MAX };
            }
        }
        let is_ready = pipes_at.map(|at| at <= now);
        let purpose = match is_ready {
            _ if control_at <= now => Purpose::Control,
            [true, ..] => Purpose::Pipe(NOTIFICATION),
            // Both directions take turns.
            [_, reads, true] if !(reads && self.last_was_out) => Purpose::Pipe(BULK_OUT),
            [_, true, _] => Purpose::Pipe(BULK_IN),
            _ => {
                self.due = pipes_at.into_iter().fold(self.next_frame.min(control_at), Ticks::min);
                return;
            }
        };
        if let Some((endpoint, kind, ticks)) = self.transaction(purpose, now, device) {
            let end = now + ticks;
            self.due = end;
            self.in_flight = Some(InFlight { end, purpose, endpoint, kind });
        }
    }

    /// Puts a transaction for `purpose` on the wire: its endpoint, its token, and the time until its end. `None`: the frame
    /// has no room left.
    fn transaction(&mut self, purpose: Purpose, now: Ticks, device: &mut UsbPort<'_>) -> Option<(u8, Kind, Ticks)> {
        let (endpoint, room, out) = match purpose {
            Purpose::Control => (0, usb_wire::MAX_PACKET_BYTES, self.transfer.as_ref()?.packet()),
            Purpose::Pipe(place) => {
                let pipe = &self.pipes.as_ref()?[place];
                let (number, room) = (pipe.endpoint.number, pipe.endpoint.packet_bytes);
                if place != NOTIFICATION {
                    self.last_was_out = place == BULK_OUT;
                }
                let bytes = || self.outgoing.iter().copied().take(room).collect();
                (number, room, (place == BULK_OUT).then(|| (false, pipe.toggle, bytes())))
            }
        };
        if let Some((setup, toggle, bytes)) = out {
            let ticks = usb_wire::data_ticks(&bytes);
            return (now + ticks <= self.next_frame).then_some((endpoint, Kind::Out { setup, toggle, bytes }, ticks));
        }
        if now + usb_wire::longest_data_ticks(room) > self.next_frame {
            return None;
        }
        let answer = device.token_in(self.enumeration.address, endpoint);
        let ticks = match &answer {
            Answer::Data { bytes, .. } => usb_wire::data_ticks(bytes),
            _ => usb_wire::refused_in_ticks(),
        };
        Some((endpoint, Kind::In(answer), ticks))
    }

    fn complete(&mut self, in_flight: InFlight, now: Ticks, device: &mut UsbPort<'_>) {
        let InFlight { purpose, endpoint, kind, .. } = in_flight;
        let address = self.enumeration.address;
        let (answer, sent) = match kind {
            Kind::In(answer) => {
                if let Answer::Data { .. } = answer {
                    device.acknowledged(address, endpoint);
                }
                (answer, 0)
            }
            Kind::Out { setup, toggle, bytes } => {
                let packet = OutPacket { address, endpoint, setup, toggle, bytes: &bytes };
                (device.packet_out(packet), bytes.len())
            }
        };
        if answer == Answer::Silence && !device.is_pulled_up() {
            // The device is leaving; the next frame will find the port empty.
            return;
        }
        let fault = match purpose {
            Purpose::Control => self.complete_control(answer, sent, now),
            Purpose::Pipe(place) => self.complete_pipe(place, answer, sent, now),
        };
        self.complaints.extend(fault.err());
    }

    fn complete_control(&mut self, answer: Answer, sent: usize, now: Ticks) -> Result<(), String> {
        let Some(mut transfer) = self.transfer.take() else { return Ok(()) };
        let endpoints = match transfer.progress(answer, sent, now) {
            Ok(None) => {
                self.transfer = Some(transfer);
                return Ok(());
            }
            Ok(Some(data)) => self.enumeration.answered(&data),
            Err(fault) => Err(fault),
        };
        let endpoints = endpoints.map_err(|fault| format!("{}: {fault}", self.enumeration.fail()))?;
        if let Some(endpoints) = endpoints {
            self.pipes = Some(endpoints.map(|endpoint| Pipe::new(endpoint, now)));
            self.last_was_out = false;
        }
        self.quiet_until = now + self.enumeration.recovery;
        Ok(())
    }

    fn complete_pipe(&mut self, place: usize, answer: Answer, sent: usize, now: Ticks) -> Result<(), String> {
        let Some(pipes) = &mut self.pipes else { return Ok(()) };
        if answer == Answer::Ack {
            self.outgoing.drain(..sent);
        }
        let name = ["notification", "bulk IN", "bulk OUT"][place];
        let data = pipes[place].progress(answer, now).map_err(|fault| format!("{name}: {fault}"))?;
        // Changes of serial state concern nobody here.
        if place == BULK_IN {
            self.received.extend(data.map(|bytes| (now, bytes)));
        }
        Ok(())
    }
}
