//! A host computer's USB port with a driver for serial devices behind it.
//!
//! It finds a device by its pull-up, resets it, reads and checks its descriptors, configures it,
//! opens it as a CDC-ACM serial port, and then moves bytes. It acts on machine time: [`UsbHost::advance`]
//! at [`UsbHost::next_event`]. Each transaction takes the time it takes on the wire.
//!
//! ```text
//! port ─▶ enumeration ─▶ transfer ─▶ transaction ─▶ FullSpeedDevice
//!                        pipes   ───┘
//! ```
//! `enumeration` says what to ask next and `descriptors` whether the answers agree; `transfer` is
//! one control transfer, `pipe` one bulk or interrupt endpoint, `traffic` has the frames and the
//! choice of the next transaction. This module has the port, and what a user of the host may do.

mod attempt;
mod descriptors;
mod enumeration;
mod pipe;
mod traffic;
mod transfer;

use std::collections::VecDeque;

use crate::peripherals::{TICKS_PER_SECOND, Ticks};
use crate::usb_wire::{BusSignal, FullSpeedDevice};

pub use enumeration::DeviceDescription;

use enumeration::Enumeration;
use pipe::Pipes;
use traffic::InFlight;
use transfer::Transfer;

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

/// A packet that the device has sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Received {
    /// When its acknowledgement was over.
    pub at: Ticks,
    /// Content.
    pub bytes: Vec<u8>,
}

/// Something a device should not have done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Complaint {
    /// When it was noticed.
    pub at: Ticks,
    /// What it was.
    pub text: String,
}

/// The host.
#[derive(Debug)]
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
    pipes: Option<Pipes>,
    dtr: bool,
    reading: bool,
    outgoing: VecDeque<u8>,
    received: Vec<Received>,
    complaints: Vec<Complaint>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Port {
    /// No cable.
    Open,
    /// Waiting for a pull-up.
    Watching,
    Debouncing {
        until: Ticks,
    },
    Resetting {
        until: Ticks,
    },
    /// Frames are sent.
    Active,
    Suspended,
    Resuming {
        until: Ticks,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    Suspend,
    Resume,
    Reset,
}

impl Default for UsbHost {
    fn default() -> Self {
        Self::new()
    }
}

impl UsbHost {
    /// A host that reads, with the cable in its port and DTR off.
    pub fn new() -> Self {
        Self {
            port: Port::Watching,
            cable: true,
            pulled: false,
            order: None,
            due: 0,
            next_frame: Ticks::MAX,
            frame_number: 0,
            quiet_until: 0,
            in_flight: None,
            transfer: None,
            enumeration: Enumeration::default(),
            pipes: None,
            dtr: false,
            reading: true,
            outgoing: VecDeque::new(),
            received: Vec::new(),
            complaints: Vec::new(),
        }
    }

    /// Pulls the cable.
    pub fn detach(&mut self, now: Ticks) {
        (self.cable, self.pulled) = (false, true);
        self.due = now;
    }

    /// Plugs the cable in.
    pub fn attach(&mut self, now: Ticks) {
        if !self.cable {
            self.cable = true;
            self.due = now;
        }
    }

    /// Stops all traffic, as when the computer sleeps.
    pub fn suspend(&mut self, now: Ticks) {
        self.order = Some(Order::Suspend);
        self.hurry(now);
    }

    /// Wakes the device and goes on.
    pub fn resume(&mut self, now: Ticks) {
        self.order = Some(Order::Resume);
        self.hurry(now);
    }

    /// Resets the bus in the middle of what goes on; the device is then enumerated anew.
    pub fn reset_bus(&mut self, now: Ticks) {
        self.order = Some(Order::Reset);
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
        self.enumeration.dtr()
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

    /// Bytes that have not left yet.
    pub fn unsent(&self) -> usize {
        self.outgoing.len()
    }

    /// Packets received since the last call, in order.
    pub fn take_received(&mut self) -> Vec<Received> {
        std::mem::take(&mut self.received)
    }

    /// Whether the device is configured and its serial port set up.
    pub fn is_configured(&self) -> bool {
        self.enumeration.is_ready()
    }

    /// What the device has said of itself so far.
    pub fn device(&self) -> &DeviceDescription {
        self.enumeration.description()
    }

    /// What the device should not have done, in order.
    pub fn complaints(&self) -> &[Complaint] {
        &self.complaints
    }

    /// When [`Self::advance`] is to be called.
    pub fn next_event(&self) -> Ticks {
        self.due
    }

    /// Does what is due at `now`.
    pub fn advance(&mut self, now: Ticks, device: &mut impl FullSpeedDevice) {
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

    fn start_frames(&mut self, now: Ticks, device: &mut impl FullSpeedDevice) {
        self.port = Port::Active;
        self.next_frame = now;
        self.quiet_until = now + RECOVERY_TICKS;
        self.run(now, device);
    }

    fn complain(&mut self, now: Ticks, text: impl Into<String>) {
        self.complaints.push(Complaint { at: now, text: text.into() });
    }

    fn lose_device(&mut self) {
        self.in_flight = None;
        self.transfer = None;
        self.pipes = None;
        self.order = None;
        self.enumeration.lose();
    }

    /// The pull-up is gone.
    fn disconnect(&mut self, now: Ticks, device: &mut impl FullSpeedDevice) {
        self.leave(Port::Watching, device);
        self.due = now + WATCH_TICKS;
    }

    /// Ends whatever goes on with a device; lines that are held down for it come back to rest.
    fn leave(&mut self, port: Port, device: &mut impl FullSpeedDevice) {
        if matches!(self.port, Port::Resetting { .. } | Port::Resuming { .. }) {
            device.signal(BusSignal::ResetEnds);
        }
        self.lose_device();
        self.port = port;
    }

    fn sleep(&mut self, now: Ticks, device: &mut impl FullSpeedDevice) {
        match self.order.take() {
            Some(Order::Resume) => {
                device.signal(BusSignal::ResumeBegins);
                self.enter(Port::Resuming { until: now + RESUME_TICKS });
            }
            _ if !device.is_pulled_up() => self.disconnect(now, device),
            _ => self.due = now + WATCH_TICKS,
        }
    }
}

#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_with_block;
