//! Commands: every one is valid in every state and gets exactly one reply, after
//! everything else it yields.
//!
//! | command | idle | acquiring |
//! |---|---|---|
//! | Hello | a hello | a hello |
//! | Start | acquiring, or rejected by the hardware | accepted, nothing changes |
//! | Stop | accepted, nothing changes | idle |
//! | Configure | replaced, and a hello; the hardware sees it at Start | replaced from the next frame on, new batch, and a hello; if the hardware refuses: idle, the old one stays |
//! | Ping | a pong | a pong |
//! | Identify | the indicator | the indicator |
//!
//! A Configure with a schedule that contradicts itself, in other ticks than the board's,
//! or with the wrong number of levels changes nothing in either state.

use slitpose_protocol::{Command, Configuration, FrameError, Message, PayloadError, Pong, Rejection, Reply, Request};

use crate::board::{Board, Emitters};
use crate::hardware::Hardware;

impl<H: Hardware, const QUEUE: usize> Board<H, QUEUE> {
    /// Takes bytes from the host, cut anywhere, and carries out the commands that are
    /// complete. A command is a sign of life, whatever the link is said to be.
    pub fn receive(&mut self, mut bytes: &[u8]) {
        while let Some(result) = self.decoder.next::<Request>(&mut bytes) {
            let (number, outcome) = match result {
                Ok(Request { number, command }) => (number, self.carry_out(command)),
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
            self.host_tick = self.hardware.now_ticks();
            if outcome.is_err() {
                self.commands_rejected = self.commands_rejected.saturating_add(1);
            }
            self.outbox.push_answer(&Message::Reply(Reply { number, outcome }));
        }
    }

    fn carry_out(&mut self, command: Command) -> Result<(), Rejection> {
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
        }
        Ok(())
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
        Ok(())
    }

    fn configure(&mut self, new: Configuration) -> Result<(), Rejection> {
        check(&new, self.configuration.schedule.tick_hz)?;
        if self.acquiring {
            // What the old configuration has finished still belongs to it. Should that
            // end in a fault, the board is idle and the rest is as for an idle one.
            self.collect();
            self.collector.flush(&mut self.outbox);
        }
        if self.acquiring
            && let Err(fault) = self.hardware.acquire(Some(&new))
        {
            self.fail(fault);
            return Err(Rejection::Hardware(fault));
        }
        self.configuration = new;
        self.configuration_number = self.configuration_number.wrapping_add(1);
        self.collector.configure(self.configuration_number, &self.configuration.schedule);
        self.introduce();
        Ok(())
    }
}

/// Whether a board of `board_hz` ticks a second could run `configuration`, hardware aside.
pub(crate) fn check(configuration: &Configuration, board_hz: u32) -> Result<(), Rejection> {
    let Configuration { schedule, levels } = configuration;
    schedule.validate().map_err(Rejection::Schedule)?;
    if schedule.tick_hz != board_hz {
        return Err(Rejection::TickRate { asked_hz: schedule.tick_hz, board_hz });
    }
    if levels.len() != usize::from(schedule.cells) {
        return Err(Rejection::Levels { levels: levels.len() as u8, cells: schedule.cells });
    }
    Ok(())
}
