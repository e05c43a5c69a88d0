//! A board that a daemon on another machine publishes.

use std::io;
use std::time::{Duration, Instant};

use ::zenoh::Wait;
use ::zenoh::pubsub::Subscriber;
use ::zenoh::sample::Sample;
use crossbeam_channel::{Receiver, Sender, bounded};
use slitpose_protocol::{
    Configuration, DELIMITER, Decoder, FrameError, Hello, MAX_MESSAGE_BYTES, Message, PayloadError, Stream,
};

use super::{Attachment, Type, ZenohSession, topic_key};
use crate::daemon::{BoardError, Feed, Opener};
use crate::device::DeviceError;
use slitpose_tracking::capture::decode_link_bytes;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::{Segment, Versions};

/// Timeout of a hello, which comes each second.
const HELLO_WITHIN: Duration = Duration::from_millis(2500);

/// Longest time without bytes: a board sends its status at least, several times a second.
const QUIET: Duration = Duration::from_secs(1);

/// Longest wait for bytes at once.
const MOMENT: Duration = Duration::from_millis(20);

/// Bytes that are passed on together, or a little more.
const TOGETHER: usize = 1 << 15;

/// Most messages that wait to be solved, half a second; others are missed, as their numbers show.
const WAITING: usize = 256;

/// Opens a board that another daemon publishes.
pub(super) struct FarBoardOpener {
    pub(super) session: ZenohSession,
    /// What the topics of the board begin with.
    pub(super) topic: String,
}

impl Opener for FarBoardOpener {
    fn name(&self) -> String {
        format!("zenoh:{}", self.topic)
    }

    fn open(&mut self) -> Result<Box<dyn Feed>, DeviceError> {
        let name = self.name();
        let gone = |source: Box<dyn std::error::Error + Send + Sync>| DeviceError::Gone {
            name: name.clone(),
            source: io::Error::other(source),
        };
        let session = self.session.get().map_err(|error| gone(error.into()))?;
        let (tell, messages) = bounded(WAITING);
        let subscribe = |topic: &str, taken: fn(&Sample) -> Option<Arrived>, tell: Sender<Arrived>| {
            let key = topic_key(self.session.domain, &format!("/{}/{topic}", self.topic), Type::LINK_BYTES);
            let hear = move |sample: Sample| {
                // What finds no room is missed.
                taken(&sample).map(|arrived| tell.try_send(arrived));
            };
            session.declare_subscriber(key).callback(hear).wait()
        };
        let subscribed = subscribe("hello", Arrived::hello, tell.clone())
            .and_then(|hellos| Ok(vec![hellos, subscribe("bytes", Arrived::bytes, tell)?]));
        let subscribers = subscribed.map_err(gone)?;
        Ok(Box::new(FarBoard::new(name, messages, subscribers)))
    }
}

enum Arrived {
    Hello(Vec<u8>),
    /// Bytes of the board, and the number of the message.
    Bytes(i64, Segment),
}

impl Arrived {
    fn hello(sample: &Sample) -> Option<Self> {
        let mut segment = Segment::default();
        decode_link_bytes(&sample.payload().to_bytes(), &mut segment)?;
        Some(Self::Hello(segment.bytes))
    }

    fn bytes(sample: &Sample) -> Option<Self> {
        let attachment = Attachment::decode(&sample.attachment()?.to_bytes())?;
        let mut segment = Segment::default();
        decode_link_bytes(&sample.payload().to_bytes(), &mut segment)?;
        Some(Self::Bytes(attachment.sequence, segment))
    }
}

struct FarBoard {
    name: String,
    messages: Receiver<Arrived>,
    _subscribers: Vec<Subscriber<()>>,
    hello: Vec<u8>,
    sequence: Option<i64>,
    clock: DistantClock,
    /// What came since it was last fetched, and what does not continue it.
    pending: Segment,
    held: Option<(i64, Segment)>,
    heard_at: Instant,
}

impl FarBoard {
    fn new(name: String, messages: Receiver<Arrived>, subscribers: Vec<Subscriber<()>>) -> Self {
        Self {
            name,
            messages,
            _subscribers: subscribers,
            hello: Vec::new(),
            sequence: None,
            clock: DistantClock::default(),
            pending: Segment::default(),
            held: None,
            heard_at: Instant::now(),
        }
    }

    /// The next message, within `timeout`.
    fn next(&mut self, timeout: Duration) -> Option<(i64, Segment)> {
        let until = Instant::now() + timeout;
        loop {
            match self.messages.recv_deadline(until).ok()? {
                Arrived::Hello(hello) => self.hello = hello,
                Arrived::Bytes(sequence, segment) => return Some((sequence, segment)),
            }
        }
    }

    /// Adds a message that continues the stream; gives one back that does not, unless it is the first.
    fn add(&mut self, (sequence, mut segment): (i64, Segment)) -> Option<(i64, Segment)> {
        let continues = self.sequence.is_some_and(|last| sequence == last.wrapping_add(1)) && !segment.opened;
        if !continues {
            if !self.pending.is_empty() {
                return Some((sequence, segment));
            }
            if !segment.opened {
                // It may begin within a packet.
                segment.skip(segment.bytes.iter().position(|&byte| byte == DELIMITER).map_or(0, |at| at + 1));
            }
            segment.opened = false;
            self.pending.opened = true;
            // Bytes that are missing may have had another hello.
            self.pending.push(&self.hello, segment.reads.first().and_then(|read| read.at));
        }
        self.sequence = Some(sequence);
        self.pending.append(&segment);
        None
    }
}

impl Feed for FarBoard {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn greet(&mut self, admit: &mut dyn FnMut(&Hello<'_>) -> Result<(), BoardError>) -> Result<(), BoardError> {
        let (asked, name) = (Instant::now(), || self.name.clone());
        let hello = loop {
            let timeout = HELLO_WITHIN.saturating_sub(asked.elapsed());
            match self.messages.recv_timeout(timeout) {
                Ok(Arrived::Hello(hello)) => break hello,
                Ok(Arrived::Bytes(..)) => {}
                Err(_) => {
                    let seconds = HELLO_WITHIN.as_secs_f64();
                    return Err(DeviceError::NotPublished { name: name(), what: "hello", seconds }.into());
                }
            }
        };
        match Decoder::<MAX_MESSAGE_BYTES>::new().next::<Message<'_>>(&mut &hello[..]) {
            Some(Ok(Message::Hello(hello))) => admit(&hello)?,
            Some(Err(FrameError::Payload(PayloadError::Version { theirs: board, .. }))) => {
                return Err(DeviceError::Version { name: name(), versions: Versions { board } }.into());
            }
            _ => {
                let (seconds, bytes) = (asked.elapsed().as_secs_f64(), hello.len() as u64);
                return Err(DeviceError::NoHello { name: name(), seconds, bytes, packets: 0 }.into());
            }
        }
        self.hello = hello;
        Ok(())
    }

    /// The host with the board has started it, by its own scene.
    fn start(&mut self, _: &Configuration, _: Stream, _: Option<&[u8]>) -> Result<(), DeviceError> {
        self.heard_at = Instant::now();
        Ok(())
    }

    fn listen(&mut self) -> Result<bool, DeviceError> {
        self.pending.clear();
        let first = match self.held.take() {
            Some(message) => Some(message),
            None => self.next(MOMENT),
        };
        let Some(first) = first else {
            if self.heard_at.elapsed() >= QUIET {
                let (name, seconds) = (self.name.clone(), QUIET.as_secs_f64());
                return Err(DeviceError::NotPublished { name, what: "bytes", seconds });
            }
            return Ok(true);
        };
        self.heard_at = Instant::now();
        self.held = self.add(first);
        while self.held.is_none()
            && self.pending.bytes.len() < TOGETHER
            && let Some(message) = self.next(Duration::ZERO)
        {
            self.held = self.add(message);
        }
        self.clock.here(&mut self.pending, HostInstant::now());
        Ok(true)
    }

    fn fill(&mut self, segment: &mut Segment) {
        segment.append(&self.pending);
        self.pending.clear();
    }

    /// The board goes on: another host follows it.
    fn stop(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// The least delay is sought within this time, nanoseconds.
const WINDOW_NS: i64 = 5_000_000_000;

/// Most by which times are shifted from one window to the next, nanoseconds: two clocks run apart by 200 ppm at most.
const STEP_NS: i64 = 1_000_000;

/// Shifts the times of another host so that its quickest message came at once. UTC stays that of the other host.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DistantClock(Option<Shift>);

#[derive(Clone, Copy, Debug)]
struct Shift {
    ns: i64,
    /// The least delay of the window, and its end by the clock here.
    least_ns: i64,
    ends_ns: i64,
}

impl DistantClock {
    /// Shifts the times of `segment`, which came at `now`.
    pub(super) fn here(&mut self, segment: &mut Segment, now: HostInstant) {
        let Some(sent) = segment.reads.last().and_then(|read| read.at) else { return };
        let (here_ns, there_ns) = (now.monotonic_ns.cast_signed(), sent.monotonic_ns.cast_signed());
        let apart_ns = here_ns.wrapping_sub(there_ns);
        let fresh = Shift { ns: apart_ns, least_ns: i64::MAX, ends_ns: here_ns.saturating_add(WINDOW_NS) };
        let shift = self.0.get_or_insert(fresh);
        shift.least_ns = shift.least_ns.min(apart_ns.wrapping_sub(shift.ns));
        if here_ns >= shift.ends_ns {
            *shift = Shift { ns: shift.ns.wrapping_add(shift.least_ns.clamp(-STEP_NS, STEP_NS)), ..fresh };
        }
        let ns = shift.ns;
        let times = segment.reads.iter_mut().filter_map(|read| read.at.as_mut());
        for at in times.chain(segment.asked.iter_mut().map(|asked| &mut asked.at)) {
            at.monotonic_ns = at.monotonic_ns.wrapping_add_signed(ns);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(sequence: i64, opened: bool, bytes: &[u8]) -> Arrived {
        let mut segment = Segment { opened, ..Segment::default() };
        segment.push(bytes, None);
        Arrived::Bytes(sequence, segment)
    }

    #[test]
    fn what_is_missed_begins_anew_behind_half_a_packet() {
        let (tell, messages) = bounded(WAITING);
        let mut board = FarBoard::new("far".to_owned(), messages, Vec::new());
        board.hello = b"hello\0".to_vec();
        let mut next = || {
            board.listen().unwrap();
            let mut segment = Segment::default();
            board.fill(&mut segment);
            (segment.opened, String::from_utf8(segment.bytes).unwrap())
        };
        for arrived in [
            message(3, false, b"f a packet\0packet\0hal"),
            message(4, false, b"f\0"),
            // Two are missed.
            message(7, false, b"f\0whole\0"),
            // The board was opened anew: no half packet.
            message(8, true, b"first\0"),
            // The daemon there was started anew.
            message(1, true, b"again\0"),
        ] {
            tell.send(arrived).unwrap();
        }
        assert_eq!(next(), (true, "hello\0packet\0half\0".to_owned()));
        assert_eq!(next(), (true, "hello\0whole\0".to_owned()));
        assert_eq!(next(), (true, "hello\0first\0".to_owned()));
        assert_eq!(next(), (true, "hello\0again\0".to_owned()));
    }

    #[test]
    fn delays_are_seen_and_clocks_that_run_apart_are_followed() {
        // 100 ppm apart; a message each 10 ms for a minute, up to 4 ms late.
        let mut clock = DistantClock::default();
        for number in 0..6_000_u64 {
            let there = HostInstant { monotonic_ns: 77_000_000_000 + number * 10_000_000, utc_ns: number };
            let late_ns = number % 5 * 1_000_000;
            let here_ns = 3_000_000_000 + number * 10_001_000 + late_ns;
            let mut segment = Segment::default();
            segment.push(b"x", Some(there));
            clock.here(&mut segment, HostInstant { monotonic_ns: here_ns, utc_ns: 0 });
            let at = segment.reads[0].at.unwrap();
            assert_eq!(at.utc_ns, number);
            let seen_ns = here_ns.wrapping_sub(at.monotonic_ns).cast_signed();
            assert!((seen_ns - late_ns.cast_signed()).abs() <= 1_000_000, "message {number}: {seen_ns} for {late_ns}");
        }
    }
}
