//! The host's side of the protocol as a state machine: bytes and time in, bytes out.
//!
//! A board is greeted, configured and started, and then sends scans until it is stopped. The daemon does the same with a
//! thread that waits; in a browser nothing may wait.

use slitpose_protocol::{
    Command, Configuration, DELIMITER, Decoder, FrameError, Hello, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message,
    PayloadError, Rejection, Request, encode,
};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::{Asked, Segment, Versions};
use slitpose_tracking::pipeline::PipelineError;
use thiserror::Error;

/// Timeout of a hello: a board that was asked by its other port is free again 2 s later.
const HELLO_WITHIN_NS: u64 = 2_500_000_000;

/// Interval of requests for a hello, as a board may not listen yet.
const HELLO_EVERY_NS: u64 = 250_000_000;

/// Timeout of a reply: a board answers within a millisecond, behind the scans of a tenth of a second.
const REPLY_WITHIN_NS: u64 = 2_000_000_000;

/// Longest time without bytes from a board that samples: it sends its status twice a second, and the page that reads the
/// port may be busy for a while.
const QUIET_NS: u64 = 2_000_000_000;

/// Interval of pings: a board goes dark after 2 s without a command.
const PING_EVERY_NS: u64 = 500_000_000;

/// Number of the pings; other commands are counted from 1.
const PING: u16 = 0;

/// Why a board cannot be followed, or no longer.
#[derive(Debug, Error)]
pub(crate) enum ConversationError {
    #[error(
        "no board answers: {bytes} bytes came within 2.5 s, and no hello; choose the port of the board, and check its \
         firmware and power"
    )]
    NoHello { bytes: u64 },
    #[error("the board cannot be used: {0}")]
    Version(Versions),
    #[error("the board did not reply within 2 s; reset the board")]
    NoReply,
    #[error("the board refused to be configured or started; check that scene and board belong together")]
    Refused(#[source] Rejection),
    #[error("no data for 2 s from the board; reset the board")]
    Quiet,
    #[error("the board has stopped sampling: {reason}")]
    Stopped { reason: String },
    #[error("the board has gone: {reason}; plug it in again")]
    Gone { reason: String },
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Greet { is_admitted: bool, is_answered: bool },
    Start { has_hello: bool },
    Run,
}

/// A conversation with one board over one link.
pub(crate) struct Conversation {
    configuration: Configuration,
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    step: Step,
    number: u16,
    began_ns: u64,
    heard_ns: u64,
    due_ns: u64,
    token: u32,
    /// Bytes of the configuration in force that came before the board ran; the first so many are whole packets.
    inbox: Vec<u8>,
    whole: usize,
    outgoing: Vec<u8>,
}

impl Conversation {
    /// Asks the board behind a link that was opened at `now` for its hello.
    pub(crate) fn open(configuration: Configuration, now: HostInstant) -> Self {
        let now_ns = now.monotonic_ns;
        Self {
            configuration,
            decoder: Decoder::new(),
            step: Step::Greet { is_admitted: false, is_answered: false },
            number: 0,
            began_ns: now_ns,
            heard_ns: now_ns,
            due_ns: now_ns,
            token: 0,
            inbox: Vec::new(),
            whole: 0,
            outgoing: Vec::new(),
        }
    }

    pub(crate) fn is_running(&self) -> bool {
        self.step == Step::Run
    }

    /// What is to be sent to the board now.
    pub(crate) fn take_outgoing(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.outgoing)
    }

    /// Tells the board to stop. Its reply is not waited for: a board whose port is closed goes dark by itself.
    pub(crate) fn stop(&mut self) {
        self.command(Command::Stop);
    }

    /// Sends what is due `now`; a ping is also noted in `segment`.
    ///
    /// # Errors
    /// A board that did not answer in time, or sends nothing any more.
    pub(crate) fn tick(&mut self, now: HostInstant, segment: &mut Segment) -> Result<(), ConversationError> {
        let now_ns = now.monotonic_ns;
        let waited_ns = now_ns.saturating_sub(self.began_ns);
        match self.step {
            Step::Greet { .. } if waited_ns > HELLO_WITHIN_NS => {
                return Err(ConversationError::NoHello { bytes: self.decoder.counters().bytes });
            }
            Step::Greet { .. } if now_ns >= self.due_ns => {
                self.due_ns = now_ns + HELLO_EVERY_NS;
                self.command(Command::Hello);
            }
            Step::Start { .. } if waited_ns > REPLY_WITHIN_NS => {
                return Err(ConversationError::NoReply);
            }
            Step::Run if now_ns.saturating_sub(self.heard_ns) > QUIET_NS => return Err(ConversationError::Quiet),
            Step::Run if now_ns >= self.due_ns => {
                self.due_ns = now_ns + PING_EVERY_NS;
                self.token = self.token.wrapping_add(1);
                self.send(PING, Command::Ping { token: self.token });
                segment.asked.push(Asked { token: self.token, at: now });
            }
            _ => {}
        }
        Ok(())
    }

    /// Takes bytes that were read at `at`, and moves those of a running board to `segment`. `admit` accepts or refuses
    /// the board by its hello.
    ///
    /// # Errors
    /// A board that is refused, or refuses.
    pub(crate) fn receive(
        &mut self,
        bytes: &[u8],
        at: HostInstant,
        segment: &mut Segment,
        admit: impl Fn(&Hello<'_>) -> Result<(), PipelineError>,
    ) -> Result<(), ConversationError> {
        self.heard_ns = at.monotonic_ns;
        if self.step == Step::Run {
            segment.push(bytes, Some(at));
            return Ok(());
        }
        let mut at_byte = self.inbox.len();
        self.inbox.extend_from_slice(bytes);
        loop {
            // Each message borrows the inbox: what it says is taken from it first.
            let mut rest = &self.inbox[at_byte..];
            let Some(message) = self.decoder.next::<Message<'_>>(&mut rest) else { break };
            let mut reply = None;
            let mut is_hello = false;
            match &message {
                Ok(Message::Hello(hello)) => {
                    admit(hello)?;
                    is_hello = true;
                }
                Ok(Message::Reply(answer)) => reply = Some((answer.number, answer.outcome)),
                Err(FrameError::Payload(PayloadError::Version { theirs: board, .. })) => {
                    return Err(ConversationError::Version(Versions { board: *board }));
                }
                _ => {}
            }
            at_byte = self.inbox.len() - rest.len();
            if is_hello {
                if let Step::Greet { is_admitted: has_hello, .. } | Step::Start { has_hello } = &mut self.step {
                    *has_hello = true;
                }
                // What came before is of another configuration.
                at_byte -= self.inbox.drain(..self.whole).len();
            }
            self.whole = at_byte;
            if let Some((number, outcome)) = reply {
                self.answered(number, outcome, at)?;
            }
        }
        match self.step {
            Step::Greet { .. } => {
                self.inbox.clear();
                self.whole = 0;
            }
            Step::Start { .. } => {}
            Step::Run => segment.push(&std::mem::take(&mut self.inbox), Some(at)),
        }
        Ok(())
    }

    fn answered(
        &mut self,
        number: u16,
        outcome: Result<(), Rejection>,
        at: HostInstant,
    ) -> Result<(), ConversationError> {
        outcome.map_err(ConversationError::Refused)?;
        match &mut self.step {
            Step::Greet { is_answered, .. } => *is_answered |= number != PING,
            // Behind the hello of the new configuration; if that was damaged, behind another one.
            Step::Start { has_hello: true } if number == self.number => {
                (self.step, self.due_ns) = (Step::Run, at.monotonic_ns);
            }
            Step::Start { has_hello: false } if number == self.number => self.command(Command::Hello),
            Step::Start { .. } | Step::Run => {}
        }
        // A hello alone may be an earlier one.
        if self.step == (Step::Greet { is_admitted: true, is_answered: true }) {
            (self.step, self.began_ns) = (Step::Start { has_hello: false }, at.monotonic_ns);
            self.command(Command::Configure(self.configuration.clone()));
            self.command(Command::Start);
        }
        Ok(())
    }

    pub(crate) fn command(&mut self, command: Command) {
        self.number += 1;
        self.send(self.number, command);
    }

    /// Sends a request behind a delimiter, which ends any incomplete packet of an earlier host.
    fn send(&mut self, number: u16, command: Command) {
        let mut buffer = [0; MAX_REQUEST_BYTES];
        // Every request fits.
        if let Ok(packet) = encode(&Request { number, command }, &mut buffer) {
            self.outgoing.push(DELIMITER);
            self.outgoing.extend_from_slice(packet);
        }
    }
}
