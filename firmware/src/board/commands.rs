//! Commands: every one is valid in every state and gets exactly one reply, after
//! everything else it yields.
//!
//! | command | idle | acquiring |
//! |---|---|---|
//! | Hello | a hello | a hello |
//! | Start | acquiring, or rejected by the hardware | accepted, nothing changes |
//! | Stop | accepted, nothing changes | idle |
//! | Configure | replaced, and a hello | replaced from the next frame on, new batch, and a hello; if the hardware fails: idle, the old configuration stays |
//! | Ping | a pong | a pong |
//! | Identify | the indicator | the indicator |
//! | Store, Forget | kept, with the head in force, or forgotten beyond a reset, then a hello | the same; sampling goes on |
//! | Reboot | the reply, then a reset | idle, the reply, then a reset |
//! | Head | a part taken; with the last one the head is in force | the same, poses from the next scan on |
//! | Stream | in force until the next Stop | the same; what is under way goes out |
//! | FullScale | as a Configure that changes nothing else; no head is in force | the same |
//! | Packet | in force until the next Stop | the same; what is under way goes out |
//! | Pulse | in force from the next Start until the next Stop or Configure | the same |
//!
//! A Configure changes nothing in either state if its schedule contradicts itself or is in
//! other ticks than the board's, if its number of levels is wrong, or if the hardware
//! cannot run it.

use core::borrow::BorrowMut;

use heapless::Vec;
use slitpose_protocol::{
    Command, Configuration, FrameError, HardwareFault, Hashes, HeadPart, Message, PayloadError, Pong, Pulse, Rejection,
    Reply, Request, SettingsSource,
};

use super::{Board, Emitters, Reboot, Storing};
use crate::hardware::{Hardware, StorageError};
use crate::pose::Poser;
use crate::settings::Settings;

/// A reboot waits this long for its reply to be taken, and for settings to be stored.
const REBOOT_MS: u64 = 200;

impl<H: Hardware, M: AsRef<[u8]> + AsMut<[u8]>, P: BorrowMut<Poser>> Board<H, M, P> {
    /// Takes bytes from the host, cut anywhere, and carries out the commands that are
    /// complete. Gives the number of commands, carried out or not. Every command is a sign
    /// of life, also while the link counts as closed.
    pub fn receive(&mut self, mut bytes: &[u8]) -> usize {
        let mut commands = 0;
        while let Some(result) = self.decoder.next::<Request>(&mut bytes) {
            let (number, outcome) = match result {
                Ok(Request { number, command }) => (number, self.carry_out(number, command)),
                Err(FrameError::Payload(PayloadError::UnknownCommand { number, kind })) => {
                    (number, Err(Rejection::Unsupported { kind }))
                }
                Err(FrameError::Payload(PayloadError::MalformedCommand { number, kind })) => {
                    (number, Err(Rejection::Malformed { kind }))
                }
                Err(_) => {
                    self.commands_damaged = self.commands_damaged.saturating_add(1);
                    continue;
                }
            };
            commands += 1;
            self.host_tick = self.hardware.now_ticks();
            match outcome {
                Ok(Done::Now) => self.reply(number, Ok(())),
                Ok(Done::Later) => {}
                Err(rejection) => self.reply(number, Err(rejection)),
            }
        }
        commands
    }

    fn reply(&mut self, number: u16, outcome: Result<(), Rejection>) {
        if outcome.is_err() {
            self.commands_rejected = self.commands_rejected.saturating_add(1);
        }
        self.outbox.push_answer(&Message::Reply(Reply { number, outcome }));
    }

    fn carry_out(&mut self, number: u16, command: Command) -> Result<Done, Rejection> {
        match command {
            Command::Hello => self.introduce(),
            Command::Start => self.start()?,
            Command::Stop => self.stop().map_err(Rejection::Hardware)?,
            Command::Configure(configuration) => self.configure(configuration)?,
            Command::Ping { token } => {
                let tick = self.hardware.now_ticks();
                self.outbox.push_answer(&Message::Pong(Pong { token, tick }));
            }
            Command::Identify { seconds } => {
                let ticks = self.ticks(1_000 * u64::from(seconds));
                self.identify_until = self.hardware.now_ticks().saturating_add(ticks);
            }
            Command::Store(hashes) => return self.store(number, Some(hashes)),
            Command::Forget => return self.store(number, None),
            Command::Reboot(target) => {
                // A reset is dark in any case, so hardware that does not stop is no reason
                // to refuse the command.
                let _ = self.stop();
                let latest = self.hardware.now_ticks().saturating_add(self.ticks(REBOOT_MS));
                self.reboot = Some(Reboot { target, latest });
            }
            Command::Head(part) => {
                // Poses of the head before say that they are its.
                self.poser.borrow_mut().flush(&mut self.outbox);
                if self.poser.borrow_mut().take_part(&part, &self.configuration.schedule)? {
                    self.warn_of_head();
                }
            }
            Command::Stream(stream) => self.set_stream(stream),
            Command::Packet { scans } => {
                self.flush();
                self.collector.set_most(scans);
            }
            Command::Pulse(pulse) => {
                let schedule = &self.configuration.schedule;
                if usize::from(pulse.slot) >= schedule.slots.len() {
                    return Err(Rejection::Unsuited(HardwareFault::Timing));
                }
                self.hardware.set_pulse(pulse, schedule).map_err(Rejection::Unsuited)?;
            }
            Command::FullScale { full_scale_pa } => {
                let before = self.identity.full_scale_pa.replace(full_scale_pa);
                if let Err(rejection) = self.configure(self.configuration.clone()) {
                    self.identity.full_scale_pa = before;
                    return Err(rejection);
                }
                // A board that solves no poses has none to forget.
                let none = HeadPart { offset: 0, total: 0, bytes: Vec::new() };
                let _ = self.poser.borrow_mut().take_part(&none, &self.configuration.schedule);
            }
        }
        Ok(Done::Now)
    }

    fn store(&mut self, number: u16, hashes: Option<Hashes>) -> Result<Done, Rejection> {
        if self.storing.is_some() {
            return Err(Rejection::Storing);
        }
        let settings = hashes.map(|hashes| Settings {
            configuration: self.configuration.clone(),
            hashes,
            head: None,
            full_scale_pa: self.identity.full_scale_pa,
        });
        self.hardware.store(settings.as_ref(), self.poser.borrow().bytes()?);
        self.storing = Some(Storing { number: Some(number), hashes });
        Ok(Done::Later)
    }

    /// Answers a Store or Forget once it is done.
    pub(super) fn answer_storing(&mut self) {
        let Some(Storing { number, hashes }) = self.storing else {
            return;
        };
        let Some(result) = self.hardware.stored() else {
            return;
        };
        self.storing = None;
        if result.is_ok() {
            self.identity.hashes = hashes.unwrap_or_default();
            self.identity.settings = if hashes.is_some() { SettingsSource::Stored } else { SettingsSource::Defaults };
            self.introduce();
        }
        if let Some(number) = number {
            self.reply(number, result.map_err(|StorageError| Rejection::Storage));
        }
    }

    fn start(&mut self) -> Result<(), Rejection> {
        if self.acquiring {
            return Ok(());
        }
        self.emitters = Emitters::Lit;
        if let Err(fault) = self.hardware.acquire(Some(&self.configuration)) {
            self.fail(fault);
            return Err(Rejection::Hardware(fault));
        }
        self.acquiring = true;
        self.faulty = false;
        let now = self.hardware.now_ticks();
        self.exposure.begin(now, &self.configuration.schedule);
        Ok(())
    }

    fn configure(&mut self, new: Configuration) -> Result<(), Rejection> {
        check(&new, self.configuration.schedule.tick_hz)?;
        self.hardware.check(&new).map_err(Rejection::Unsuited)?;
        if self.acquiring {
            // Scans that have finished belong to the old configuration. If collecting them
            // ends in a fault, the board is idle and the new one is taken as by an idle board.
            self.collect();
        }
        let _ = self.hardware.set_pulse(Pulse::NONE, &new.schedule);
        if self.acquiring
            && let Err(fault) = self.hardware.acquire(Some(&new))
        {
            self.fail(fault);
            return Err(Rejection::Hardware(fault));
        }
        while self.solve_next() {}
        self.flush();
        self.configuration = new;
        self.configuration_number = self.configuration_number.wrapping_add(1);
        self.collector.configure(self.configuration_number, &self.configuration.schedule);
        self.poser.borrow_mut().configure(self.configuration_number, &self.configuration.schedule);
        self.warn_of_head();
        let now = self.hardware.now_ticks();
        self.exposure.begin(now, &self.configuration.schedule);
        self.introduce();
        Ok(())
    }
}

/// When the reply to a command is due.
enum Done {
    Now,
    Later,
}

/// Checks that a board of `board_hz` ticks a second could run `configuration`, apart from
/// the limits of its hardware.
///
/// # Errors
/// If the schedule contradicts itself or is in other ticks, or if there is not one level
/// for each cell.
pub(crate) fn check(configuration: &Configuration, board_hz: u32) -> Result<(), Rejection> {
    let Configuration { schedule, levels, .. } = configuration;
    schedule.validate().map_err(Rejection::Schedule)?;
    if schedule.tick_hz != board_hz {
        return Err(Rejection::TickRate { asked_hz: schedule.tick_hz, board_hz });
    }
    if levels.len() != usize::from(schedule.cells) {
        return Err(Rejection::Levels { levels: levels.len() as u8, cells: schedule.cells });
    }
    Ok(())
}
