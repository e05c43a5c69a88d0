//! The bytes of a link as messages: the stream of one board divided into [`Segment`]s of whole packets, each without loss as
//! `slitpose_msgs/msg/LinkBytes`.

use slitpose_protocol::{DELIMITER, Decoder, MAX_MESSAGE_BYTES, Message};

use crate::clock::HostInstant;
use crate::link::{Asked, Read, Segment};
use crate::ros::cdr;

const MAX_LINK_BYTES: usize = 1 << 20;

/// First byte of a hello: its payload begins with a zero, which byte stuffing encodes as this.
const FIRST_BYTE_OF_HELLO: u8 = 1;

/// Holds back an incomplete packet, so that a capture can be split between any two messages.
#[derive(Debug, Default)]
pub(super) struct Packets {
    pending: Segment,
}

impl Packets {
    /// Whether the bytes held back must be [taken incomplete](Self::take_rest) before `segment` is pushed.
    pub(super) fn must_end_before(&self, segment: &Segment) -> bool {
        segment.opened && !self.pending.is_empty()
    }

    /// Appends a segment; not if a message [must end](Self::must_end_before) first.
    pub(super) fn push(&mut self, segment: &Segment) {
        self.pending.append(segment);
    }

    /// Moves the next whole packets to `message`. `false` if there are neither packets nor pings.
    pub(super) fn next(&mut self, message: &mut Segment) -> bool {
        let bytes = &self.pending.bytes;
        let within = &bytes[..bytes.len().min(MAX_LINK_BYTES)];
        let length = match within.iter().rposition(|&byte| byte == DELIMITER) {
            Some(last) => last + 1,
            // Too long for a packet.
            None if bytes.len() >= MAX_MESSAGE_BYTES => within.len(),
            None => 0,
        };
        if length == 0 && self.pending.asked.is_empty() {
            return false;
        }
        self.split(length, message);
        true
    }

    /// Moves all bytes held back to `message`; `false` if there are none.
    pub(super) fn take_rest(&mut self, message: &mut Segment) -> bool {
        let is_something = !self.pending.is_empty();
        self.split(self.pending.bytes.len(), message);
        is_something
    }

    /// Moves the first `length` bytes, and everything without bytes. Both parts of a split read have its
    /// time.
    fn split(&mut self, length: usize, message: &mut Segment) {
        message.clear();
        message.append(&self.pending);
        message.truncate(length);
        self.pending.skip(length);
        self.pending.opened = false;
        self.pending.asked.clear();
    }
}

/// The last hello among the whole packets of `bytes`, its delimiter included.
pub(super) fn last_hello(bytes: &[u8]) -> Option<&[u8]> {
    let packets = bytes.split_inclusive(|&byte| byte == DELIMITER);
    packets.filter(|packet| packet.first() == Some(&FIRST_BYTE_OF_HELLO)).rfind(|packet| is_hello(packet))
}

fn is_hello(mut packet: &[u8]) -> bool {
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    matches!(decoder.next::<Message<'_>>(&mut packet), Some(Ok(Message::Hello(_))))
}

/// Time of a read without time: a clock reaches it after 584 years.
const NO_TIME: u64 = u64::MAX;

/// Writes `segment` into `bytes`, which is cleared first.
pub(super) fn encode(segment: &Segment, bytes: &mut Vec<u8>) {
    let mut encoder = cdr::Encoder::new(bytes);
    encoder.bool(segment.opened);
    encoder.bytes(&segment.bytes);
    encoder.length(segment.reads.len());
    for read in &segment.reads {
        encoder.u32(u32::try_from(read.bytes).unwrap_or(u32::MAX));
    }
    instants(&mut encoder, segment.reads.iter().map(|read| read.at));
    encoder.length(segment.asked.len());
    for asked in &segment.asked {
        encoder.u32(asked.token);
    }
    instants(&mut encoder, segment.asked.iter().map(|asked| Some(asked.at)));
}

/// UTC is stored as its difference from the monotonic clock, which is nearly constant and compresses well.
fn instants(encoder: &mut cdr::Encoder<'_>, all: impl ExactSizeIterator<Item = Option<HostInstant>> + Clone) {
    encoder.length(all.len());
    for at in all.clone() {
        encoder.u64(at.map_or(NO_TIME, |at| at.monotonic_ns));
    }
    encoder.length(all.len());
    for at in all {
        encoder.u64(at.map_or(0, |at| at.utc_ns.wrapping_sub(at.monotonic_ns)));
    }
}

/// Reads a message into `segment`; `None` if `bytes` are not a message, and `segment` is then empty.
pub(super) fn decode(bytes: &[u8], segment: &mut Segment) -> Option<()> {
    segment.clear();
    let decoded = fill(bytes, segment);
    if decoded.is_none() {
        segment.clear();
    }
    decoded
}

fn fill(bytes: &[u8], segment: &mut Segment) -> Option<()> {
    let Segment { opened, bytes: data, reads, asked } = segment;
    let mut decoder = cdr::Decoder::new(bytes)?;
    *opened = decoder.bool()?;
    data.extend_from_slice(decoder.bytes()?);
    decoder.each_u32(|bytes| reads.push(Read { bytes: bytes as usize, at: None }))?;
    let monotonic = decoder.each_u64(|index, monotonic_ns| {
        if let Some(read) = reads.get_mut(index) {
            read.at = (monotonic_ns != NO_TIME).then_some(HostInstant { monotonic_ns, utc_ns: monotonic_ns });
        }
    })?;
    let utc = decoder.each_u64(|index, distance_ns| {
        if let Some(at) = reads.get_mut(index).and_then(|read| read.at.as_mut()) {
            at.utc_ns = at.monotonic_ns.wrapping_add(distance_ns);
        }
    })?;
    decoder.each_u32(|token| asked.push(Asked { token, at: HostInstant::default() }))?;
    let asked_monotonic = decoder.each_u64(|index, monotonic_ns| {
        if let Some(asked) = asked.get_mut(index) {
            asked.at = HostInstant { monotonic_ns, utc_ns: monotonic_ns };
        }
    })?;
    let asked_utc = decoder.each_u64(|index, distance_ns| {
        if let Some(asked) = asked.get_mut(index) {
            asked.at.utc_ns = asked.at.monotonic_ns.wrapping_add(distance_ns);
        }
    })?;
    let agree = [monotonic, utc] == [reads.len(); 2] && [asked_monotonic, asked_utc] == [asked.len(); 2];
    let in_reads = reads.iter().try_fold(0_usize, |sum, read| sum.checked_add(read.bytes));
    (agree && in_reads == Some(data.len())).then_some(())
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn at(monotonic_ns: u64) -> HostInstant {
        HostInstant { monotonic_ns, utc_ns: 7 }
    }

    fn read(bytes: &[u8], monotonic_ns: u64) -> Segment {
        let mut segment = Segment::default();
        segment.push(bytes, Some(at(monotonic_ns)));
        segment
    }

    #[test]
    fn messages_end_with_packets() {
        let (mut packets, mut message) = (Packets::default(), Segment::default());
        packets.push(&read(b"ab", 1));
        assert!(!packets.next(&mut message));
        packets.push(&read(b"c\0d\0ef", 2));
        assert!(packets.next(&mut message));
        assert_eq!(message.chunks().collect::<Vec<_>>(), [(&b"ab"[..], Some(at(1))), (&b"c\0d\0"[..], Some(at(2)))]);
        assert!(!packets.next(&mut message));

        let anew = Segment { opened: true, ..read(b"gh", 3) };
        assert!(packets.must_end_before(&anew));
        assert!(packets.take_rest(&mut message));
        assert_eq!(message, read(b"ef", 2));
        assert!(!packets.must_end_before(&anew));
        packets.push(&anew);
        assert!(!packets.next(&mut message));
        assert!(packets.take_rest(&mut message));
        assert_eq!(message, anew);
        assert!(!packets.take_rest(&mut message));
    }

    #[test]
    fn pings_do_not_wait_for_packets() {
        let (mut packets, mut message) = (Packets::default(), Segment::default());
        let asked = vec![Asked { token: 3, at: at(1) }];
        packets.push(&Segment { asked: asked.clone(), ..read(b"ab", 1) });
        assert!(packets.next(&mut message));
        assert_eq!(message, Segment { asked, ..Segment::default() });
        assert!(packets.take_rest(&mut message));
        assert_eq!(message, read(b"ab", 1));
    }

    #[test]
    fn an_endless_packet_is_passed_on_at_once() {
        let (mut packets, mut message) = (Packets::default(), Segment::default());
        let noise = [7; 3 * MAX_LINK_BYTES / 2];
        packets.push(&read(&noise, 1));
        assert!(packets.next(&mut message));
        assert_eq!(message.bytes.len(), MAX_LINK_BYTES);
        assert!(packets.next(&mut message));
        assert_eq!(message.bytes.len(), MAX_LINK_BYTES / 2);
        assert!(!packets.next(&mut message));
    }

    #[test]
    fn a_message_comes_back_and_one_cut_short_or_changed_is_no_segment_or_a_sound_one() {
        let mut random = ChaCha8Rng::seed_from_u64(17);
        let (mut bytes, mut back) = (vec![1, 2, 3], Segment { opened: true, ..Segment::default() });
        back.push(b"old", None);
        for round in 0..1000 {
            let mut segment = Segment { opened: random.random(), ..Segment::default() };
            for token in 0..random.random_range(0..12) {
                let read: Vec<u8> = (0..random.random_range(0..70)).map(|_| random.random()).collect();
                let at = HostInstant { monotonic_ns: random.random_range(0..NO_TIME), utc_ns: random.random() };
                segment.push(&read, random.random_bool(0.7).then_some(at));
                segment.asked.extend(random.random_bool(0.2).then_some(Asked { token, at }));
            }
            encode(&segment, &mut bytes);
            assert_eq!((decode(&bytes, &mut back), &back), (Some(()), &segment), "seed 17, round {round}");
            let at = random.random_range(0..bytes.len());
            assert!(decode(&bytes[..at], &mut back).is_none() && back.is_empty(), "seed 17, round {round}");
            bytes[at] ^= random.random_range(1..=u8::MAX);
            if decode(&bytes, &mut back).is_some() {
                let in_reads: usize = back.reads.iter().map(|read| read.bytes).sum();
                assert_eq!(in_reads, back.bytes.len(), "seed 17, round {round}");
            }
        }
    }
}
