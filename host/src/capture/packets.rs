//! The byte stream of one board on its way into a capture: whole packets at a time.

use slitpose_protocol::{DELIMITER, Decoder, MAX_MESSAGE_BYTES, Message};

use crate::link::{Read, Segment};

/// Most bytes in a message.
const MAX_LINK_BYTES: usize = 1 << 20;

/// A hello's payload begins with a zero, which stuffing turns into this.
const FIRST_BYTE_OF_HELLO: u8 = 1;

/// Holds back a packet that has not ended, so that a capture can be split between any two messages.
#[derive(Debug, Default)]
pub(super) struct Packets {
    pending: Segment,
}

impl Packets {
    /// Whether `segment` must wait until what is held back has been [taken as it is](Self::take_rest).
    pub(super) fn must_end_before(&self, segment: &Segment) -> bool {
        segment.opened && !self.pending.is_empty()
    }

    /// Appends a segment; not if a message [must end](Self::must_end_before) first.
    pub(super) fn push(&mut self, segment: &Segment) {
        self.pending.append(segment);
    }

    /// Moves the next whole packets to `message`. `false` if there are none, nor anything else to say.
    pub(super) fn next(&mut self, message: &mut Segment) -> bool {
        let bytes = &self.pending.bytes;
        let within = &bytes[..bytes.len().min(MAX_LINK_BYTES)];
        let length = match within.iter().rposition(|&byte| byte == DELIMITER) {
            Some(last) => last + 1,
            // Not a packet any more.
            None if bytes.len() >= MAX_MESSAGE_BYTES => within.len(),
            None => 0,
        };
        if length == 0 && self.pending.asked.is_empty() {
            return false;
        }
        self.split(length, message);
        true
    }

    /// Moves all that is held back to `message`; `false` if that is nothing.
    pub(super) fn take_rest(&mut self, message: &mut Segment) -> bool {
        let is_something = !self.pending.is_empty();
        self.split(self.pending.bytes.len(), message);
        is_something
    }

    /// Moves the first `length` bytes, and all that has no bytes. A read that is cut has its time in
    /// both parts.
    fn split(&mut self, length: usize, message: &mut Segment) {
        message.clear();
        let Segment { opened, bytes, reads, asked } = &mut self.pending;
        message.opened = std::mem::take(opened);
        message.asked.append(asked);
        message.bytes.extend(bytes.drain(..length));
        let mut left = length;
        reads.retain_mut(|read| {
            let taken = read.bytes.min(left);
            if taken == read.bytes || taken > 0 {
                message.reads.push(Read { bytes: taken, at: read.at });
            }
            left -= taken;
            read.bytes -= taken;
            read.bytes > 0
        });
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::HostInstant;
    use crate::link::Asked;

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
}
