//! What an active port does: frames, and the transactions in them, one after another.

use super::attempt::Outcome;
use super::pipe::{self, Pipe, Pipes};
use super::transfer::{Progress, Transfer};
use super::{Order, Port, RESET_TICKS, Received, UsbHost, WATCH_TICKS};
use crate::peripherals::Ticks;
use crate::usb_wire::{self, BusSignal, FRAME_TICKS, FullSpeedDevice, InAnswer, OutPacket};

/// Whom a transaction is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purpose {
    Control,
    Notification,
    BulkIn,
    BulkOut,
}

/// A transaction on the wire.
#[derive(Debug)]
pub(super) struct InFlight {
    end: Ticks,
    purpose: Purpose,
    kind: Kind,
}

#[derive(Debug)]
enum Kind {
    In { endpoint: u8, answer: InAnswer },
    Out { endpoint: u8, setup: bool, toggle: bool, bytes: Vec<u8> },
}

impl UsbHost {
    /// An active port: ends a transaction, begins a frame, begins a transaction.
    pub(super) fn run(&mut self, now: Ticks, device: &mut impl FullSpeedDevice) {
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
    fn begin_transaction(&mut self, now: Ticks, device: &mut impl FullSpeedDevice) {
        self.next_transfer(now);
        let ready = |at: Ticks| at <= now;
        let purpose = if self.transfer.as_ref().is_some_and(|transfer| ready(transfer.ready_at)) {
            Purpose::Control
        } else if let Some(pipes) = &self.pipes {
            let out = !self.outgoing.is_empty() && ready(pipes.bulk_out.ready_at);
            let read = self.reading && ready(pipes.bulk_in.ready_at);
            // Both directions take turns.
            if ready(pipes.notification.ready_at) {
                Purpose::Notification
            } else if out && !(read && pipes.last_was_out) {
                Purpose::BulkOut
            } else if read {
                Purpose::BulkIn
            } else {
                self.wait_for_pipes();
                return;
            }
        } else {
            self.wait_for_pipes();
            return;
        };
        let Some((kind, ticks)) = self.transaction(purpose, now, device) else {
            // The frame has no room left.
            return;
        };
        let end = now + ticks;
        self.due = end;
        self.in_flight = Some(InFlight { end, purpose, kind });
    }

    /// Sleeps until a transfer or a pipe may be asked again, or the next frame.
    fn wait_for_pipes(&mut self) {
        let transfer = self.transfer.as_ref().map(|transfer| transfer.ready_at);
        let pipes = self.pipes.as_ref().map(|pipes| {
            let out = if self.outgoing.is_empty() { Ticks::MAX } else { pipes.bulk_out.ready_at };
            let read = if self.reading { pipes.bulk_in.ready_at } else { Ticks::MAX };
            pipes.notification.ready_at.min(out).min(read)
        });
        self.due = [transfer, pipes].into_iter().flatten().fold(self.next_frame, Ticks::min);
    }

    /// The request that is next in the life of the device, if none is under way.
    fn next_transfer(&mut self, now: Ticks) {
        if self.transfer.is_none()
            && let Some(request) = self.enumeration.next_request(self.dtr)
        {
            self.transfer = Some(Transfer::new(request, self.enumeration.control_packet_bytes(), now));
        }
    }

    /// Puts a transaction for `purpose` on the wire: its token, and the time until its end.
    fn transaction(
        &mut self,
        purpose: Purpose,
        now: Ticks,
        device: &mut impl FullSpeedDevice,
    ) -> Option<(Kind, Ticks)> {
        let address = self.enumeration.address();
        let (endpoint, room) = match (purpose, &self.transfer, &mut self.pipes) {
            (Purpose::Control, Some(transfer), _) => match transfer.packet() {
                Some((setup, toggle, bytes)) => {
                    let ticks = usb_wire::data_ticks(&bytes);
                    let fits = now + ticks <= self.next_frame;
                    return fits.then_some((Kind::Out { endpoint: 0, setup, toggle, bytes }, ticks));
                }
                None => (0, usb_wire::MAX_PACKET_BYTES),
            },
            (Purpose::BulkOut, _, Some(pipes)) => {
                let Pipe { endpoint, toggle, packet_bytes, .. } = pipes.bulk_out;
                let bytes: Vec<u8> = self.outgoing.iter().copied().take(packet_bytes).collect();
                let ticks = usb_wire::data_ticks(&bytes);
                pipes.last_was_out = true;
                let fits = now + ticks <= self.next_frame;
                return fits.then_some((Kind::Out { endpoint, setup: false, toggle, bytes }, ticks));
            }
            (Purpose::BulkIn, _, Some(pipes)) => {
                pipes.last_was_out = false;
                (pipes.bulk_in.endpoint, pipes.bulk_in.packet_bytes)
            }
            (Purpose::Notification, _, Some(pipes)) => (pipes.notification.endpoint, pipes.notification.packet_bytes),
            _ => return None,
        };
        if now + usb_wire::longest_data_ticks(room) > self.next_frame {
            return None;
        }
        let answer = device.token_in(address, endpoint);
        let ticks = match &answer {
            InAnswer::Data { bytes, .. } => usb_wire::data_ticks(bytes),
            InAnswer::Nak | InAnswer::Stall | InAnswer::Silence => usb_wire::refused_in_ticks(),
        };
        Some((Kind::In { endpoint, answer }, ticks))
    }

    /// The end of a transaction.
    fn complete(&mut self, in_flight: InFlight, now: Ticks, device: &mut impl FullSpeedDevice) {
        let address = self.enumeration.address();
        let outcome = match in_flight.kind {
            Kind::In { endpoint, answer } => {
                if let InAnswer::Data { .. } = answer {
                    device.acknowledged(address, endpoint);
                }
                Outcome::of_in(answer)
            }
            Kind::Out { endpoint, setup, toggle, bytes } => {
                let packet = OutPacket { address, endpoint, setup, toggle, bytes: &bytes };
                Outcome::of_out(device.packet_out(packet), bytes.len())
            }
        };
        if outcome == Outcome::Silence && !device.is_pulled_up() {
            // The device is leaving; the next frame will find the port empty.
            return;
        }
        match in_flight.purpose {
            Purpose::Control => self.complete_control(outcome, now),
            purpose => self.complete_pipe(purpose, outcome, now),
        }
    }

    fn complete_control(&mut self, outcome: Outcome, now: Ticks) {
        let Some(mut transfer) = self.transfer.take() else {
            return;
        };
        match transfer.progress(outcome, now) {
            Progress::GoesOn => self.transfer = Some(transfer),
            Progress::Done(data) => {
                let mut complaints = Vec::new();
                if let Some(pipes) = self.enumeration.answered(&data, &mut complaints) {
                    self.pipes = Some(Pipes::new(&pipes, now));
                }
                for text in complaints {
                    self.complain(now, text);
                }
                self.quiet_until = now + self.enumeration.recovery_ticks();
            }
            Progress::Failed(reason) => {
                let text = format!("{}: {reason}", self.enumeration.current_name());
                self.complain(now, text);
                self.enumeration.failed();
            }
        }
    }

    fn complete_pipe(&mut self, purpose: Purpose, outcome: Outcome, now: Ticks) {
        let Some(pipes) = &mut self.pipes else {
            return;
        };
        let (pipe, name) = match purpose {
            Purpose::BulkIn => (&mut pipes.bulk_in, "bulk IN"),
            Purpose::BulkOut => (&mut pipes.bulk_out, "bulk OUT"),
            Purpose::Notification | Purpose::Control => (&mut pipes.notification, "notification"),
        };
        match pipe.progress(outcome, now) {
            pipe::Progress::Nothing => {}
            pipe::Progress::Sent(len) => drop(self.outgoing.drain(..len)),
            pipe::Progress::Received(bytes) if purpose == Purpose::BulkIn => {
                self.received.push(Received { at: now, bytes });
            }
            // Changes of serial state concern nobody here.
            pipe::Progress::Received(_) => {}
            pipe::Progress::Fault(fault) => {
                let text = format!("{name}: {fault}");
                self.complain(now, text);
            }
        }
    }
}
