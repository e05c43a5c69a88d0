//! A byte ring of whole packets, first in, first out.
//!
//! Each packet is stored behind a header of [`HEADER_BYTES`]: its length (u16) and a tag
//! (u32) whose meaning is the owner's. Packets may wrap round the end of the ring. Each
//! packet is copied once in and once out.

/// Bytes that each packet takes in the ring besides its own.
pub(crate) const HEADER_BYTES: usize = 6;

/// A queue of packets in the ring `M`.
#[derive(Debug)]
pub(crate) struct PacketQueue<M> {
    ring: M,
    head: usize,
    /// Bytes in use from `head` on.
    used: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Front {
    pub length: usize,
    pub tag: u32,
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> PacketQueue<M> {
    /// An empty queue in `ring`, of any content.
    pub fn new(ring: M) -> Self {
        Self { ring, head: 0, used: 0 }
    }

    fn size(&self) -> usize {
        self.ring.as_ref().len()
    }

    /// Appends a packet; `false`, and nothing changed, if there is no room for it.
    #[must_use]
    pub fn push(&mut self, packet: &[u8], tag: u32) -> bool {
        let Ok(length) = u16::try_from(packet.len()) else {
            return false;
        };
        if HEADER_BYTES + packet.len() > self.size() - self.used {
            return false;
        }
        self.append(&length.to_le_bytes());
        self.append(&tag.to_le_bytes());
        self.append(packet);
        true
    }

    pub fn front(&self) -> Option<Front> {
        if self.used == 0 {
            return None;
        }
        let mut header = [0; HEADER_BYTES];
        self.copy_out(0, &mut header);
        let [l0, l1, tag @ ..] = header;
        Some(Front { length: u16::from_le_bytes([l0, l1]).into(), tag: u32::from_le_bytes(tag) })
    }

    /// Moves the oldest packet to the start of `out` and gives its length; `None`, and
    /// nothing changed, if the queue is empty or `out` is too small.
    pub fn pop(&mut self, out: &mut [u8]) -> Option<usize> {
        let length = self.front()?.length;
        self.copy_out(HEADER_BYTES, out.get_mut(..length)?);
        self.discard();
        Some(length)
    }

    /// Forgets the oldest packet and gives its tag.
    pub fn discard(&mut self) -> Option<u32> {
        let Front { length, tag } = self.front()?;
        self.head = (self.head + HEADER_BYTES + length) % self.size();
        self.used -= HEADER_BYTES + length;
        Some(tag)
    }

    pub fn clear(&mut self) {
        self.used = 0;
    }

    /// Appends `bytes`, which the caller has checked to fit.
    fn append(&mut self, bytes: &[u8]) {
        let at = (self.head + self.used) % self.size();
        let (until_end, rest) = bytes.split_at(bytes.len().min(self.size() - at));
        let ring = self.ring.as_mut();
        ring[at..at + until_end.len()].copy_from_slice(until_end);
        ring[..rest.len()].copy_from_slice(rest);
        self.used += bytes.len();
    }

    fn copy_out(&self, offset: usize, out: &mut [u8]) {
        let at = (self.head + offset) % self.size();
        let (until_end, rest) = out.split_at_mut(out.len().min(self.size() - at));
        let ring = self.ring.as_ref();
        until_end.copy_from_slice(&ring[at..at + until_end.len()]);
        rest.copy_from_slice(&ring[..rest.len()]);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;
    use std::vec::Vec;

    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;

    const ROOM: usize = 64;

    #[derive(Debug, Clone)]
    enum Step {
        Push(Vec<u8>, u32),
        Pop(usize),
        Discard,
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            4 => (vec(any::<u8>(), 0..70), any::<u32>()).prop_map(|(p, tag)| Step::Push(p, tag)),
            2 => (0..70_usize).prop_map(Step::Pop),
            1 => Just(Step::Discard),
        ]
    }

    proptest! {
        #[test]
        fn a_queue_of_limited_bytes_behaves_like_a_deque(steps in vec(step(), 1..200)) {
            let mut queue = PacketQueue::new([0; ROOM]);
            let mut model = VecDeque::<(Vec<u8>, u32)>::new();
            for step in steps {
                match step {
                    Step::Push(packet, tag) => {
                        let used: usize = model.iter().map(|(p, _)| p.len() + HEADER_BYTES).sum();
                        let fits = used + packet.len() + HEADER_BYTES <= ROOM;
                        prop_assert_eq!(queue.push(&packet, tag), fits);
                        if fits {
                            model.push_back((packet, tag));
                        }
                    }
                    Step::Pop(room) => {
                        let mut out = [0; 70];
                        let length = queue.pop(&mut out[..room]);
                        let popped = length.map(|length| out[..length].to_vec());
                        let fits = model.front().is_some_and(|(packet, _)| packet.len() <= room);
                        let expected = if fits { model.pop_front() } else { None };
                        prop_assert_eq!(popped, expected.map(|(packet, _)| packet));
                    }
                    Step::Discard => {
                        prop_assert_eq!(queue.discard(), model.pop_front().map(|(_, tag)| tag));
                    }
                }
                let front = model.front().map(|(p, tag)| Front { length: p.len(), tag: *tag });
                prop_assert_eq!(queue.front(), front);
            }
        }
    }
}
