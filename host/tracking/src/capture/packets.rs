//! Divides the byte stream of one board into messages of whole packets.

use slitpose_protocol::{DELIMITER, Decoder, MAX_MESSAGE_BYTES, Message};

use crate::link::Segment;

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
