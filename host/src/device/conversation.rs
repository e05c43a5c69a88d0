//! The host's side of the protocol: sends commands, checks replies, keeps all other bytes.

use std::time::{Duration, Instant};

use slitpose_protocol::{
    Command, Configuration, DELIMITER, Decoder, FrameError, HeadPart, Hello, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES,
    Message, PayloadError, Pulse, Rejection, Request, Schedule, Stream, encode,
};

use super::Device;
use super::error::DeviceError;
use super::listed::BoardInfo;
use super::orders::{self, KeepAlive, ping};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::{Asked, Segment, Versions};

/// Timeout of a hello: a board that was asked by its other port is free again 2 s later; one that has
/// just been plugged in needs less.
pub(crate) const HELLO_WITHIN: Duration = Duration::from_millis(2500);

/// Interval of requests for a hello, as a board may not listen yet.
const HELLO_EVERY: Duration = Duration::from_millis(250);

/// Timeout of a reply: a board answers within a millisecond; the scans before its answer may take a tenth of a
/// second.
pub(super) const REPLY_WITHIN: Duration = Duration::from_secs(2);

/// As [`REPLY_WITHIN`], while the user waits for the program to end.
const STOP_WITHIN: Duration = Duration::from_millis(500);

/// Longest time without bytes from a board that samples: it sends at least its status.
const QUIET: Duration = Duration::from_millis(450);

/// A conversation with a board. When dropped it stops the board.
pub(crate) struct Conversation {
    device: Box<dyn Device>,
    pub(super) decoder: Decoder<MAX_MESSAGE_BYTES>,
    pub(super) inbox: Vec<u8>,
    number: u16,
    keep_alive: Option<KeepAlive>,
    /// Time and token of the next ping, if the device does not ping by itself.
    ping_at: Instant,
    token: u32,
    started: bool,
    heard_at: Option<HostInstant>,
    quiet: Duration,
    quiet_limit: Duration,
}

impl Conversation {
    /// Opens the conversation; ends any incomplete command that an earlier host has left on the link.
    pub(crate) fn open(device: Box<dyn Device>) -> Result<Self, DeviceError> {
        let mut conversation = Self {
            device,
            decoder: Decoder::new(),
            inbox: Vec::with_capacity(1 << 13),
            number: 0,
            keep_alive: None,
            ping_at: Instant::now(),
            token: 0,
            started: false,
            heard_at: None,
            quiet: Duration::ZERO,
            quiet_limit: QUIET,
        };
        match conversation.device.send(&[DELIMITER]) {
            Ok(()) => Ok(conversation),
            Err(source) => Err(conversation.gone(source)),
        }
    }

    /// Opens the conversation, and asks the board who it is.
    pub(crate) fn introduced(device: Box<dyn Device>) -> Result<(Self, BoardInfo), DeviceError> {
        let mut board = Self::open(device)?;
        let info = board.introduce(HELLO_WITHIN)?;
        Ok((board, info))
    }

    /// Requests the board's hello, which `admit` accepts or refuses. Also waits for the reply, because a hello alone
    /// may be an earlier one. Bytes received until then are dropped.
    pub(crate) fn greet<E: From<DeviceError>>(
        &mut self,
        within: Duration,
        mut admit: impl FnMut(&Hello<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let asked = Instant::now();
        let mut ask_at = asked;
        let first = self.number + 1;
        let (mut admitted, mut replied, mut answered) = (false, false, false);
        while !answered {
            let now = Instant::now();
            if now >= asked + within {
                return Err(self.no_hello(within).into());
            }
            if now >= ask_at {
                self.command(Command::Hello)?;
                ask_at = now + HELLO_EVERY;
            }
            let more = self.hear()?;
            let mut bytes = &self.inbox[..];
            while let Some(message) = self.decoder.next::<Message<'_>>(&mut bytes) {
                match message {
                    Ok(Message::Hello(hello)) => {
                        admit(&hello)?;
                        admitted = true;
                    }
                    Ok(Message::Reply(reply)) => replied |= (first..=self.number).contains(&reply.number),
                    Err(FrameError::Payload(PayloadError::Version { theirs: board, .. })) => {
                        return Err(DeviceError::Version { name: self.name(), versions: Versions { board } }.into());
                    }
                    _ => {}
                }
            }
            self.inbox.clear();
            answered = admitted && replied;
            if !more && !answered {
                return Err(self.no_hello(within).into());
            }
        }
        Ok(())
    }

    /// Replaces the configuration of the board. The inbox then starts with the hello of that configuration.
    pub(crate) fn configure(&mut self, configuration: Configuration) -> Result<(), DeviceError> {
        // At low frame rates a board is quiet between frames.
        let frame = Duration::from_secs_f64(configuration.schedule.frame_rate_hz().recip());
        self.quiet_limit = QUIET.max(3 * frame);
        self.inbox.clear();
        self.ask(Command::Configure(configuration), REPLY_WITHIN)?;
        if !self.drop_before_hello() {
            // The hello was damaged. Without it no scan can be read.
            self.ask(Command::Hello, REPLY_WITHIN)?;
            self.drop_before_hello();
        }
        Ok(())
    }

    /// Drops the bytes before the last hello of the inbox: they belong to an older configuration. `false` if there is none.
    fn drop_before_hello(&mut self) -> bool {
        let (mut decoder, mut rest) = (Decoder::<MAX_MESSAGE_BYTES>::new(), &self.inbox[..]);
        let (mut begin, mut hello) = (0, None);
        while let Some(message) = decoder.next::<Message<'_>>(&mut rest) {
            if let Ok(Message::Hello(_)) = message {
                hello = Some(begin);
            }
            begin = self.inbox.len() - rest.len();
        }
        hello.map(|begin| drop(self.inbox.drain(..begin))).is_some()
    }

    /// Sends a compiled head, by which the board then solves poses. Received bytes are appended to the inbox.
    pub(crate) fn send_head(&mut self, head: &[u8]) -> Result<(), DeviceError> {
        HeadPart::all(head).try_for_each(|part| self.ask(Command::Head(part), REPLY_WITHIN))
    }

    /// Chooses what the board sends once it is started. Received bytes are appended to the inbox.
    pub(crate) fn stream(&mut self, stream: Stream) -> Result<(), DeviceError> {
        // So it does without being told.
        if stream == Stream::SCANS { Ok(()) } else { self.ask(Command::Stream(stream), REPLY_WITHIN) }
    }

    /// Has scans by `schedule` sent as soon as USB carries them: with as few in a packet.
    pub(crate) fn send_soon(&mut self, schedule: &Schedule) -> Result<(), DeviceError> {
        self.ask(Command::Packet { scans: packet_scans(schedule) }, REPLY_WITHIN)
    }

    /// Has the board make pulses at its frames once it is started.
    pub(crate) fn pulse(&mut self, pulse: Pulse) -> Result<(), DeviceError> {
        self.ask(Command::Pulse(pulse), REPLY_WITHIN)
    }

    /// Starts acquisition. Received bytes are appended to the inbox.
    pub(crate) fn start(&mut self) -> Result<(), DeviceError> {
        self.started = true;
        self.ask(Command::Start, REPLY_WITHIN)?;
        self.keep_alive = self.device.keep_alive().map_err(|source| self.gone(source))?;
        Ok(())
    }

    /// Waits for bytes of the board, a few hundredths of a second at most; the inbox then holds only these. `false` if
    /// the stream has ended.
    pub(crate) fn listen(&mut self) -> Result<bool, DeviceError> {
        self.inbox.clear();
        let since = Instant::now();
        let more = self.hear()?;
        // Only waiting counts: while poses are written, bytes may be waiting unread.
        self.quiet = if self.inbox.is_empty() { self.quiet + since.elapsed() } else { Duration::ZERO };
        if self.quiet >= self.quiet_limit {
            return Err(DeviceError::Quiet { name: self.name(), seconds: self.quiet_limit.as_secs_f64() });
        }
        Ok(more)
    }

    /// Stops acquisition. The inbox then holds the bytes up to the reply.
    pub(crate) fn stop(&mut self) -> Result<(), DeviceError> {
        self.keep_alive = None;
        self.started = false;
        self.inbox.clear();
        self.decoder.reset();
        match self.ask(Command::Stop, STOP_WITHIN) {
            // Once more: the command may have been damaged on its way.
            Err(DeviceError::NoReply { .. }) => self.ask(Command::Stop, STOP_WITHIN),
            outcome => outcome,
        }
    }

    /// Appends to `segment` the bytes received last with their instant, and the pings sent since the last call.
    pub(crate) fn fill(&mut self, segment: &mut Segment) {
        if !self.inbox.is_empty() {
            segment.push(&self.inbox, self.heard_at);
        }
        match &self.keep_alive {
            Some(keep_alive) => segment.asked.extend(std::iter::from_fn(|| keep_alive.asked())),
            None => segment.asked.extend(self.ping()),
        }
    }

    pub(crate) fn received(&self) -> &[u8] {
        &self.inbox
    }

    /// Closes the conversation without a Stop, as a program does that is killed.
    pub(crate) fn abandon(mut self) {
        self.started = false;
    }

    pub(crate) fn name(&self) -> String {
        self.device.name().to_owned()
    }

    /// Sends a command and waits for its reply. Received bytes are appended to the inbox.
    pub(super) fn ask(&mut self, command: Command, within: Duration) -> Result<(), DeviceError> {
        let name = name_of(&command);
        let number = self.command(command)?;
        let until = Instant::now() + within;
        let mut more = true;
        while more && Instant::now() < until {
            let decoded = self.inbox.len();
            more = self.hear()?;
            match self.reply_to(number, decoded) {
                None => {}
                Some(Ok(())) => return Ok(()),
                Some(Err(source)) => {
                    let next_step = next_step_of(&name, &source);
                    return Err(DeviceError::Refused { name: self.name(), command: name, next_step, source });
                }
            }
        }
        Err(DeviceError::NoReply { name: self.name(), command: name, seconds: within.as_secs_f64() })
    }

    /// Decodes the inbox from `at` on; returns the reply to `number`, if any.
    fn reply_to(&mut self, number: u16, at: usize) -> Option<Result<(), Rejection>> {
        let (mut bytes, mut answer) = (&self.inbox[at..], None);
        while let Some(message) = self.decoder.next::<Message<'_>>(&mut bytes) {
            if let Ok(Message::Reply(reply)) = message
                && reply.number == number
            {
                answer = Some(reply.outcome);
            }
        }
        answer
    }

    /// Sends a ping, if one is due and the device runs in real time.
    fn ping(&mut self) -> Option<Asked> {
        let now = Instant::now();
        if !self.started || !self.device.keeps_time() || now < self.ping_at {
            return None;
        }
        self.ping_at = now + orders::INTERVAL;
        self.token = self.token.wrapping_add(1);
        let mut buffer = [0; MAX_REQUEST_BYTES];
        let (packet, asked) = ping(self.token, &mut buffer)?;
        // The loss of a device is detected when listening.
        self.device.send(packet).is_ok().then_some(asked)
    }

    fn command(&mut self, command: Command) -> Result<u16, DeviceError> {
        self.number += 1;
        // After a delimiter, which ends any incomplete packet before.
        let mut buffer = [DELIMITER; MAX_REQUEST_BYTES + 1];
        let request = Request { number: self.number, command };
        let packet = encode(&request, &mut buffer[1..]).expect("no request is longer than MAX_REQUEST_BYTES");
        let length = 1 + packet.len();
        self.device.send(&buffer[..length]).map_err(|source| self.gone(source))?;
        Ok(self.number)
    }

    pub(super) fn hear(&mut self) -> Result<bool, DeviceError> {
        let more = self.device.receive(&mut self.inbox).map_err(|source| self.gone(source))?;
        self.heard_at = self.device.keeps_time().then(HostInstant::now);
        Ok(more)
    }

    fn gone(&self, source: std::io::Error) -> DeviceError {
        DeviceError::Gone { name: self.name(), source }
    }

    fn no_hello(&self, within: Duration) -> DeviceError {
        let (name, seconds) = (self.name(), within.as_secs_f64());
        let counters = self.decoder.counters();
        match counters.bytes {
            0 => DeviceError::Silent { name, seconds },
            bytes => DeviceError::NoHello { name, seconds, bytes, packets: counters.packets },
        }
    }
}

impl Drop for Conversation {
    fn drop(&mut self) {
        self.keep_alive = None;
        if self.started {
            // An error is ignored: without a host the board goes dark by itself.
            let _ = self.command(Command::Stop);
        }
    }
}

/// Bytes a second that a board sends over USB while packets wait, by its image in the emulator: 537 000, in packets of 64.
const USB_BYTES_PER_S: f64 = 530e3;

/// Bytes of a packet besides its samples, with six levels.
const PACKET_BYTES: f64 = 36.0;

/// The least number of scans in a packet with which USB carries all; the board never takes more than by default.
fn packet_scans(schedule: &Schedule) -> u8 {
    let samples = 2.0 * schedule.words_per_scan() as f64;
    let is_carried =
        |scans: &u8| schedule.frame_rate_hz() * (samples + PACKET_BYTES / f64::from(*scans)) < USB_BYTES_PER_S;
    (1..u8::MAX).find(is_carried).unwrap_or(u8::MAX)
}

/// The name of a command is that of its variant.
fn name_of(command: &Command) -> String {
    format!("{command:?}").chars().take_while(char::is_ascii_alphabetic).collect()
}

fn next_step_of(command: &str, rejection: &Rejection) -> &'static str {
    match rejection {
        Rejection::Unsupported { .. } if command == "Head" => {
            "flash the image that solves poses, slitpose-board-pose, or let this program solve them: --stream raw"
        }
        Rejection::Unsuited(_) if command == "Pulse" => {
            "choose a slot of the schedule, and so few frames that their slots are at most 65536"
        }
        Rejection::Unsupported { .. } | Rejection::Malformed { .. } => {
            "build firmware and program from the same source"
        }
        Rejection::Schedule(_) | Rejection::Levels { .. } | Rejection::TickRate { .. } | Rejection::Unsuited(_) => {
            "change [lighting] or [front_end] of the scene to what this board can do"
        }
        Rejection::Storing => "wait until the settings are stored",
        Rejection::Storage => "try again; if it stays so, the board's memory is worn out",
        Rejection::Hardware(_) => "change [lighting] or [front_end] of the scene, or reset the board",
    }
}

#[cfg(test)]
mod tests;
