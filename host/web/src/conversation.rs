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
        "nothing answers: not a byte came within 2.5 s; choose the port of the board, and check that it has its firmware and power"
    )]
    Silent,
    #[error(
        "no board answers: {bytes} bytes came within 2.5 s, {packets} readable packets and no hello among them; choose the port of the board, or reset it"
    )]
    NoHello { bytes: u64, packets: u64 },
    #[error("the board cannot be used: {0}")]
    Version(Versions),
    #[error("the board did not reply to {command} within 2 s; reset the board")]
    NoReply { command: &'static str },
    #[error("the board refused {command}: {source}; check that scene and board belong together")]
    Refused { command: &'static str, source: Rejection },
    #[error("no data for 2 s from the board; reset the board")]
    Quiet,
    #[error("the board has stopped sampling: {reason}")]
    Stopped { reason: String },
    #[error("the board has gone ({reason}); plug it in again")]
    Gone { reason: String },
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Greet { is_admitted: bool, is_answered: bool },
    Configure { has_hello: bool },
    Start,
    Run,
}

impl Step {
    fn command(self) -> &'static str {
        match self {
            Self::Greet { .. } => "Hello",
            Self::Configure { .. } => "Configure",
            Self::Start => "Start",
            Self::Run => "Stop",
        }
    }
}

/// A conversation with one board over one link.
pub(crate) struct Conversation {
    configuration: Configuration,
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    step: Step,
    /// Number of the last command.
    number: u16,
    began_ns: u64,
    heard_ns: u64,
    due_ns: u64,
    token: u32,
    /// Bytes of the configuration in force that came before the board ran.
    inbox: Vec<u8>,
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
            outgoing: Vec::new(),
        }
    }

    /// Whether the board sends scans.
    pub(crate) fn is_running(&self) -> bool {
        self.step == Step::Run
    }

    /// What is to be sent to the board now.
    pub(crate) fn take_outgoing(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.outgoing)
    }

    /// Blinks the board's indicator for so many seconds.
    pub(crate) fn identify(&mut self, seconds: u8) {
        self.command(Command::Identify { seconds });
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
                let counters = self.decoder.counters();
                return Err(match counters.bytes {
                    0 => ConversationError::Silent,
                    bytes => ConversationError::NoHello { bytes, packets: counters.packets },
                });
            }
            Step::Greet { .. } if now_ns >= self.due_ns => {
                self.due_ns = now_ns + HELLO_EVERY_NS;
                self.command(Command::Hello);
            }
            Step::Configure { .. } | Step::Start if waited_ns > REPLY_WITHIN_NS => {
                return Err(ConversationError::NoReply { command: self.step.command() });
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
        let mut whole = at_byte;
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
                self.greeted();
                // What came before is of another configuration.
                self.inbox.drain(..whole);
                at_byte -= whole;
            }
            whole = at_byte;
            if let Some((number, outcome)) = reply {
                self.answered(number, outcome, at)?;
            }
        }
        match self.step {
            Step::Greet { .. } => self.inbox.clear(),
            Step::Run => segment.push(&std::mem::take(&mut self.inbox), Some(at)),
            Step::Configure { .. } | Step::Start => {}
        }
        Ok(())
    }

    fn greeted(&mut self) {
        match &mut self.step {
            Step::Greet { is_admitted: has_hello, .. } | Step::Configure { has_hello } => *has_hello = true,
            Step::Start | Step::Run => {}
        }
    }

    fn answered(
        &mut self,
        number: u16,
        outcome: Result<(), Rejection>,
        at: HostInstant,
    ) -> Result<(), ConversationError> {
        if let Step::Greet { is_answered, .. } = &mut self.step {
            *is_answered |= number != PING;
        } else if number != self.number {
            return Ok(());
        }
        outcome.map_err(|source| ConversationError::Refused { command: self.step.command(), source })?;
        match self.step {
            // A hello alone may be an earlier one.
            Step::Greet { is_admitted: true, is_answered: true } => {
                let configure = Command::Configure(self.configuration.clone());
                self.go_on(Step::Configure { has_hello: false }, configure, at);
            }
            Step::Configure { has_hello: true } => self.go_on(Step::Start, Command::Start, at),
            // Its hello was damaged, and without it no scan can be read.
            Step::Configure { has_hello: false } => {
                self.command(Command::Hello);
            }
            Step::Start => (self.step, self.due_ns) = (Step::Run, at.monotonic_ns),
            Step::Greet { .. } | Step::Run => {}
        }
        Ok(())
    }

    fn go_on(&mut self, step: Step, command: Command, now: HostInstant) {
        (self.step, self.began_ns) = (step, now.monotonic_ns);
        self.command(command);
    }

    fn command(&mut self, command: Command) {
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
