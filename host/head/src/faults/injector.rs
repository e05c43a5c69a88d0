//! Faults on the bytes between a board and its decoder.

use std::fmt::Write as _;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use slitpose_protocol::{
    Batch, DELIMITER, Decoder, Edge, Event, Hello, MAX_MESSAGE_BYTES, Message, Poses, Schedule, Severity, Status,
    encode,
};

use super::Faults;
use super::board::{WordFaults, WordScale};
use super::kinds::Layer;
use super::text::{Fault, FaultClock};

/// How the text of an event begins that announces a fault.
pub const ANNOUNCED: &str = "injected fault: ";

/// Longest text of a fault in its announcement; what is longer is cut.
const TEXT_BYTES: usize = 200;

/// The state of a link behind the injector.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "fields are named by what they are")]
pub enum Link {
    /// Bytes come.
    Open,
    /// The link broke; what had not been delivered is lost. The port is back after so many seconds.
    HungUp { for_s: f64 },
}

/// Injects faults into the bytes of one board.
///
/// Bytes may be cut anywhere: the result does not depend on it. A packet is passed on when it is whole.
#[derive(Debug, Default)]
pub struct Injector {
    announced: Vec<(Fault, u64)>,
    wire: Vec<WireFault>,
    words: Option<WordFaults>,
    clock: FaultClock,
    /// Device time of the latest batch, seconds; `None` before the first: until then nothing happens.
    time_s: Option<f64>,
    /// Device time since then in which the board has taken no scans, seconds.
    idle_s: f64,
    /// By how much the board's clock is ahead, ticks.
    ahead_ticks: f64,
    sampled: Option<(Schedule, WordScale)>,
    decoder: Box<Decoder<MAX_MESSAGE_BYTES>>,
    packet: Vec<u8>,
    samples: Vec<u8>,
    late: Vec<u8>,
    held: Vec<u8>,
}

impl Injector {
    /// Injects what `faults` do on the wire, and announces all of them, for a simulated board that has the others;
    /// `None` if there are none.
    pub fn of_link(faults: &Faults) -> Option<Self> {
        (!faults.is_empty()).then(|| Self::new(faults, None))
    }

    /// Injects what `faults` do on the wire and to words, into a recording; `None` if there are none.
    pub fn of_recording(faults: &Faults) -> Option<Self> {
        (!faults.is_empty()).then(|| Self::new(faults, WordFaults::of(faults)))
    }

    fn new(faults: &Faults, words: Option<WordFaults>) -> Self {
        let of_wire = faults.of(Layer::Wire).into_iter();
        Self {
            announced: faults.iter().map(|fault| (fault.clone(), 0)).collect(),
            wire: of_wire.map(|(fault, random)| WireFault::new(fault, random)).collect(),
            words,
            ..Self::default()
        }
    }

    /// Takes `bytes` of the board and appends what comes of them to `out`. After a hang-up the rest of `bytes` is lost.
    pub fn push(&mut self, bytes: &[u8], out: &mut Vec<u8>) -> Link {
        for part in bytes.split_inclusive(|&byte| byte == DELIMITER) {
            self.packet.extend_from_slice(part);
            let is_whole = part.last() == Some(&DELIMITER);
            if is_whole || self.packet.len() > 4 * MAX_MESSAGE_BYTES {
                let packet = std::mem::take(&mut self.packet);
                let link = self.pass(packet, out);
                if link != Link::Open {
                    return link;
                }
            }
        }
        Link::Open
    }

    /// Lets `seconds` of device time pass in which a board takes no scans: faults that have begun end meanwhile.
    pub fn idle(&mut self, seconds: f64) {
        self.idle_s += seconds;
    }

    /// Appends what was held back to `out`: the stream has ended.
    pub fn finish(&mut self, out: &mut Vec<u8>) {
        for bytes in [&mut self.held, &mut self.late, &mut self.packet] {
            out.append(bytes);
        }
    }

    /// Passes on one packet, or bytes that are none.
    fn pass(&mut self, mut packet: Vec<u8>, out: &mut Vec<u8>) -> Link {
        let mut decoder = std::mem::take(&mut self.decoder);
        let mut rest = packet.as_slice();
        let mut announcements = Vec::new();
        let mut edited = None;
        let is_truth = match decoder.next::<Message<'_>>(&mut rest) {
            Some(Ok(message)) => {
                edited = self.read(&message, &mut announcements);
                matches!(message, Message::Truth(_))
            }
            Some(Err(_)) | None => false,
        };
        decoder.reset();
        self.decoder = decoder;
        if let Some(edited) = edited {
            packet = edited;
        }
        out.append(&mut announcements);
        let Some(time_s) = self.time_s.filter(|_| !is_truth).map(|time_s| time_s + self.idle_s) else {
            out.append(&mut packet);
            return Link::Open;
        };
        let mut passage = Passage { bytes: packet, ..Passage::default() };
        for fault in &mut self.wire {
            let begun = fault.fault.window.begun(time_s);
            if fault.fault.kind.name == "hangup" && begun > fault.begun {
                fault.begun = begun;
                for lost in [&mut self.late, &mut self.held, &mut self.packet] {
                    lost.clear();
                }
                return Link::HungUp { for_s: fault.fault.window.for_s };
            }
            fault.act(time_s, &mut passage);
        }
        self.deliver(passage, out);
        Link::Open
    }

    fn deliver(&mut self, packet: Passage, out: &mut Vec<u8>) {
        let out = if packet.is_held {
            &mut self.held
        } else {
            out.append(&mut self.held);
            out
        };
        if packet.is_late && self.late.is_empty() {
            self.late = packet.bytes;
            return;
        }
        for _ in 0..=usize::from(packet.is_double) {
            out.extend_from_slice(&packet.bytes);
        }
        out.append(&mut self.late);
    }

    /// Takes note of a message; returns its packet if faults of words or of the clock change it.
    fn read(&mut self, message: &Message<'_>, announcements: &mut Vec<u8>) -> Option<Vec<u8>> {
        match message {
            Message::Hello(hello) => {
                self.meet(hello);
                None
            }
            Message::Batch(batch) => {
                self.advance(batch.tick, announcements);
                self.edit_batch(batch)
            }
            Message::Poses(poses) => {
                self.advance(poses.tick, announcements);
                self.shifted(poses.tick, |tick| Message::Poses(Poses { tick, ..*poses }))
            }
            Message::Status(status) => self.shifted(status.tick, |tick| Message::Status(Status { tick, ..*status })),
            Message::Event(event) => self.shifted(event.tick, |tick| Message::Event(Event { tick, ..*event })),
            Message::Pong(pong) => {
                let mut pong = *pong;
                self.shifted(pong.tick, |tick| {
                    pong.tick = tick;
                    Message::Pong(pong)
                })
            }
            Message::Edges(edges) => {
                let mut edges = edges.clone();
                let first = edges.edges.first()?.tick();
                self.shifted(first, |tick| {
                    for edge in &mut edges.edges {
                        *edge = Edge::new(edge.tick().wrapping_sub(first).wrapping_add(tick), edge.is_high());
                    }
                    Message::Edges(edges)
                })
            }
            Message::Reply(_) | Message::Truth(_) => None,
        }
    }

    fn meet(&mut self, hello: &Hello<'_>) {
        let schedule = &hello.schedule;
        if schedule.validate().is_ok() && hello.scaling.validate(schedule.oversampling).is_ok() {
            let scale =
                WordScale { scaling: hello.scaling, oversampling: schedule.oversampling, tick_hz: schedule.tick_hz };
            self.sampled = Some((schedule.clone(), scale));
        }
    }

    /// Device time goes on to that of the scan at `tick`: faults begin, and the clock drifts.
    fn advance(&mut self, tick: u64, announcements: &mut Vec<u8>) {
        let Some((schedule, _)) = &self.sampled else { return };
        let tick_hz = schedule.tick_hz;
        let time_s = self.clock.take(tick, tick_hz);
        self.idle_s = 0.0;
        let before_s = self.time_s.replace(time_s).unwrap_or(time_s);
        for fault in &mut self.wire {
            let begun = fault.fault.window.begun(time_s);
            let [amount, _] = fault.fault.values;
            match fault.fault.kind.name {
                "drift" if fault.fault.window.is_open(time_s) => {
                    self.ahead_ticks += (time_s - before_s) * f64::from(tick_hz) * amount * 1e-6;
                }
                "step" if begun > fault.begun => {
                    // A clock that steps back beyond its beginning goes on from there.
                    let ahead_ticks = amount * f64::from(tick_hz) * (begun - fault.begun) as f64 + self.ahead_ticks;
                    self.ahead_ticks = ahead_ticks.max(-(tick as f64));
                    fault.begun = begun;
                }
                _ => {}
            }
        }
        for (fault, told) in &mut self.announced {
            let begun = fault.window.begun(time_s);
            // Of many begins the first, second, fourth, eighth … are told.
            if begun > *told && begun.checked_ilog2() != told.checked_ilog2() {
                announce(fault, begun, shift(tick, self.ahead_ticks), announcements);
            }
            *told = begun;
        }
    }

    /// The packet that `make` makes of a tick by the clock that drifts; `None` if that goes right.
    fn shifted<'m>(&self, tick: u64, make: impl FnOnce(u64) -> Message<'m>) -> Option<Vec<u8>> {
        let shifted = shift(tick, self.ahead_ticks);
        if shifted == tick { None } else { packet_of(&make(shifted)) }
    }

    fn edit_batch(&mut self, batch: &Batch<'_>) -> Option<Vec<u8>> {
        let tick = shift(batch.tick, self.ahead_ticks);
        let mut samples = std::mem::take(&mut self.samples);
        samples.clear();
        if let (Some(words), Some((schedule, scale))) = (&mut self.words, &self.sampled)
            && let Ok(scans) = batch.scans(schedule)
        {
            for mut scan in scans {
                words.apply(&mut scan, scale);
                let pairs = scan.lit().iter().chain(scan.dark().into_iter().flatten());
                samples.extend(pairs.flatten().flat_map(|word| word.to_le_bytes()));
            }
        } else {
            samples.extend_from_slice(batch.samples);
        }
        let is_same = tick == batch.tick && samples == batch.samples;
        let edited = Batch { tick, samples: &samples, ..batch.clone() };
        let packet = if is_same { None } else { packet_of(&Message::Batch(edited)) };
        self.samples = samples;
        packet
    }
}

fn shift(tick: u64, ahead_ticks: f64) -> u64 {
    tick.saturating_add_signed(ahead_ticks.round() as i64)
}

/// `None` if the message has grown too long for a packet, which ticks of a clock near its end do.
fn packet_of(message: &Message<'_>) -> Option<Vec<u8>> {
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    encode(message, &mut buffer).ok().map(<[u8]>::to_vec)
}

fn announce(fault: &Fault, begun: u64, tick: u64, out: &mut Vec<u8>) {
    let mut text = String::from(ANNOUNCED);
    text.extend(fault.to_string().chars().take(TEXT_BYTES));
    if fault.window.every_s.is_some() {
        // A string takes everything.
        let _ = write!(text, " (number {begun})");
    }
    let event = Event { tick, severity: Severity::Warning, text: &text };
    out.extend(packet_of(&Message::Event(event)).into_iter().flatten());
}

#[derive(Clone, Debug)]
struct WireFault {
    fault: Fault,
    random: ChaCha8Rng,
    /// Bits to the next that is inverted.
    bits: Option<u64>,
    burst: usize,
    /// Spans whose begin has been acted on.
    begun: u64,
}

#[derive(Clone, Debug, Default)]
struct Passage {
    /// Its bytes, delimiter included; empty if it is lost.
    bytes: Vec<u8>,
    is_double: bool,
    /// It is delivered behind the next.
    is_late: bool,
    is_held: bool,
}

impl WireFault {
    fn new(fault: Fault, random: ChaCha8Rng) -> Self {
        Self { fault, random, bits: None, burst: 0, begun: 0 }
    }

    /// Does to the packet what the fault does at `time_s`.
    fn act(&mut self, time_s: f64, packet: &mut Passage) {
        // A burst that has begun goes on.
        if !self.fault.window.is_open(time_s) && self.burst == 0 {
            return;
        }
        let ([rate, bytes], name) = (self.fault.values, self.fault.kind.name);
        match name {
            "flip" => self.flip(rate, &mut packet.bytes),
            "drop" if self.happens(rate) => packet.bytes.clear(),
            "duplicate" => packet.is_double |= self.happens(rate),
            "reorder" => packet.is_late |= self.happens(rate),
            "truncate" if self.happens(rate) => {
                let kept = self.random.random_range(0..packet.bytes.len().max(1));
                packet.bytes.truncate(kept);
            }
            "burst" => {
                if self.burst == 0 && self.happens(rate) {
                    self.burst = bytes as usize;
                }
                let hit = self.burst.min(packet.bytes.len());
                packet.bytes[..hit].iter_mut().for_each(|byte| *byte = self.random.random());
                self.burst -= hit;
            }
            "stall" => packet.is_held = true,
            // Of the clock, of the link as a whole, or of other layers.
            _ => {}
        }
    }

    fn happens(&mut self, rate: f64) -> bool {
        self.random.random::<f64>() < rate
    }

    /// Inverts bits; the distance between two has the geometric distribution.
    fn flip(&mut self, rate: f64, bytes: &mut [u8]) {
        let length = 8 * bytes.len() as u64;
        let mut next = self.bits.take().unwrap_or_else(|| self.gap(rate));
        while next < length {
            bytes[(next / 8) as usize] ^= 1 << (next % 8);
            next += 1 + self.gap(rate);
        }
        self.bits = Some(next - length);
    }

    fn gap(&mut self, rate: f64) -> u64 {
        let uniform: f64 = self.random.random();
        // Of `rate` 1 the logarithm is infinite, and the gap zero.
        ((1.0 - uniform).ln() / (-rate).ln_1p()).min(1e15) as u64
    }
}

#[cfg(test)]
mod tests;
