//! Polls and bytes to send: what a board does and says without being asked.

use core::borrow::BorrowMut;

use heapless::Vec;
use slitpose_protocol::{Edge, Edges, Exposure, Level, MAX_EDGES, Message, Schedule, Severity, Status, encode};

use super::{Board, Emitters, HOST_GONE_MS, Link, STATUS_MS, TRANSMIT_BYTES, TransmitBuffer};
use crate::hardware::{Hardware, Indicator};
use crate::pose::Poser;

/// Milliseconds after which bytes handed to the link have surely been sent, if the host
/// takes them: a UART of 3 Mbaud takes 3.4 ms for a kilobyte.
const SENDING_MS: u64 = 10;

/// No packet with a status is longer: 80 bytes of payload, every number at its longest, 4
/// of checksum, 2 of framing, and 10 in hand.
const STATUS_BYTES: usize = 96;

/// Most messages of edges at a poll: 30 000 edges a second at the least.
const EDGE_MESSAGES: usize = 4;

impl<H: Hardware, M: AsRef<[u8]> + AsMut<[u8]>, P: BorrowMut<Poser>> Board<H, M, P> {
    /// Does what is due: follows the link, collects finished scans, makes a status.
    pub fn poll(&mut self, link: Link) {
        let now = self.hardware.now_ticks();
        self.follow(link, now);
        if self.acquiring {
            // A scan is solved at the poll after the one that has collected it: in between the link has its turn.
            let has_solved = self.solve_next();
            if !has_solved || self.poser.borrow().is_behind() {
                self.collect();
            }
            self.expose();
        } else if self.emitters != Emitters::Off {
            // A failure is tried again at the next poll.
            let _ = self.darken();
        }
        self.pass_edges();
        self.answer_storing();
        self.report(now);
        self.reboot_if_due(now);
    }

    /// Fills `buffer` with whole packets, oldest first, and gives the bytes to send;
    /// none if there is nothing to say. Bytes that have been given count as sent.
    pub fn transmit<'b>(&mut self, buffer: &'b mut TransmitBuffer) -> &'b [u8] {
        let reserved = if self.status_due { STATUS_BYTES } else { 0 };
        let mut filled = self.outbox.take(&mut buffer[..TRANSMIT_BYTES - reserved]);
        // Made only now, so that it is never stale and takes no room while no host reads.
        if self.status_due {
            let status = Message::Status(self.status());
            filled += encode(&status, &mut buffer[filled..]).map_or(0, <[u8]>::len);
            self.status_due = false;
        }
        &buffer[..filled]
    }

    /// Queues new edges of the trigger input; those of a poll are at most so many.
    fn pass_edges(&mut self) {
        for _ in 0..EDGE_MESSAGES {
            let Some(first) = self.hardware.next_edge() else { return };
            self.pass_on(first);
        }
    }

    /// Queues an edge and those behind it.
    fn pass_on(&mut self, first: Edge) {
        let rest = core::iter::from_fn(|| self.hardware.next_edge());
        let edges: Vec<Edge, MAX_EDGES> = core::iter::once(first).chain(rest).take(MAX_EDGES).collect();
        let number = self.next_edge;
        self.next_edge = number.wrapping_add(edges.len() as u32);
        self.outbox.push_edges(Edges { number, missed: self.hardware.missed_edges(), edges });
    }

    fn follow(&mut self, link: Link, now: u64) {
        match (self.link, link) {
            (Link::Closed, Link::Open) => {
                self.outbox.open();
                self.status_tick = now;
                self.introduce();
                self.warn_of_start(now);
                self.warn_of_head();
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

    /// Lights with other levels from the next frame on, if automatic exposure asks for them.
    fn expose(&mut self) {
        if !self.acquiring || self.configuration.exposure == Exposure::Fixed {
            return;
        }
        let now = self.hardware.now_ticks();
        let limit = |schedule: &Schedule, levels: &mut [Level]| self.hardware.limit_levels(schedule, levels);
        let Some(levels) = self.exposure.levels(now, &self.configuration, limit) else {
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
            // The host may have started acquisition meanwhile.
            let _ = self.stop();
            self.hardware.reboot(target);
        }
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
            clock: self.identity.clock,
            settings: self.identity.settings,
        }
    }
}

#[cfg(test)]
mod tests {
    use slitpose_protocol::{ClockSource, SettingsSource};

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
            clock: ClockSource::CrystalFailed,
            settings: SettingsSource::PassedOver,
        });
        assert_eq!(encode(&status, &mut [0; STATUS_BYTES]).map(<[u8]>::len), Ok(STATUS_BYTES - 10));
    }
}
