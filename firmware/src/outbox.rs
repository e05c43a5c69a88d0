//! Packets waiting for the link.
//!
//! Scans have one queue, and all other messages another. When the scan queue is full its
//! oldest packets are dropped and counted, because a host that tracks a moving tool wants
//! the newest. The queue of answers holds answers to commands and a few events, so it fills
//! only if a host keeps commanding without reading.
//!
//! Packets leave in the order in which they arose, whatever their queue: each answer is
//! tagged with the number of scan packets that came before it. Therefore every batch of a
//! recording can be read by the last Hello before it.

use slitpose_protocol::{Batch, DELIMITER, Edges, MAX_MESSAGE_BYTES, Message, encode};

use crate::queue::{HEADER_BYTES, PacketQueue};

/// Room for answers and events: a hundred replies at least.
const ANSWER_BYTES: usize = 2048;

const MAX_ENTRY: usize = MAX_MESSAGE_BYTES + HEADER_BYTES;
const _: () = assert!(ANSWER_BYTES >= MAX_ENTRY);

/// Tag of a packet of poses.
const POSES: u32 = 0;

/// Tag of a packet of edges.
const EDGES: u32 = u32::MAX;

/// Packets that wait while the board is late with its poses: solving leaves the link little time, some 1.5 ms pass for each,
/// and newer poses are worth more.
#[cfg(feature = "pose")]
const LATE_PACKETS: u32 = 8;

#[derive(Debug)]
pub(crate) struct Outbox<M> {
    /// Tag: scans in the packet, [`POSES`] or [`EDGES`].
    batches: PacketQueue<M>,
    /// Tag: `arrived` when the packet was queued.
    answers: PacketQueue<[u8; ANSWER_BYTES]>,
    /// Batches ever queued, and batches ever sent or dropped.
    arrived: u32,
    left: u32,
    open: bool,
    /// A host has opened the link and no byte has been sent to it yet.
    fresh: bool,
    dropped: Dropped,
    scratch: [u8; MAX_MESSAGE_BYTES],
}

/// Numbers of scans, batches and answers dropped since reset.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Dropped {
    pub scans: u64,
    pub batches: u32,
    pub answers: u32,
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Outbox<M> {
    /// An empty outbox of a closed link; `memory` holds batches.
    pub fn new(memory: M) -> Self {
        Self {
            batches: PacketQueue::new(memory),
            answers: PacketQueue::new([0; ANSWER_BYTES]),
            arrived: 0,
            left: 0,
            open: false,
            fresh: false,
            dropped: Dropped::default(),
            scratch: [0; MAX_MESSAGE_BYTES],
        }
    }

    pub fn open(&mut self) {
        self.open = true;
        self.fresh = true;
    }

    /// No host listens any more: packets meant for the last host are dropped.
    pub fn close(&mut self) {
        self.open = false;
        self.fresh = false;
        while self.drop_batch() {}
        self.answers.clear();
    }

    /// Queues a batch, and drops the oldest batches if it needs their room. While no host
    /// listens the new batch itself is dropped.
    pub fn push_batch(&mut self, batch: Batch<'_>, scans: usize) {
        self.push(&Message::Batch(batch), scans as u32);
    }

    /// Queues poses, as batches are: they are as many. If the board `is_late` with them, they have few others in front.
    #[cfg(feature = "pose")]
    pub fn push_poses(&mut self, poses: slitpose_protocol::Poses<'_>, is_late: bool) {
        let waiting = |this: &Self| this.arrived.wrapping_sub(this.left);
        while is_late && waiting(self) >= LATE_PACKETS && self.batches.front().is_some_and(|front| front.tag == POSES) {
            self.drop_batch();
        }
        self.push(&Message::Poses(poses), POSES);
    }

    /// Queues edges, as batches are: they may be as many.
    pub fn push_edges(&mut self, edges: Edges) {
        self.push(&Message::Edges(edges), EDGES);
    }

    #[inline(always)]
    fn push(&mut self, message: &Message<'_>, tag: u32) {
        if !self.open {
            return self.count_dropped(tag);
        }
        let Ok(length) = encode(message, &mut self.scratch).map(<[u8]>::len) else {
            return self.count_dropped(tag);
        };
        while !self.batches.push(&self.scratch[..length], tag) {
            // A memory too small for even one packet keeps none.
            if !self.drop_batch() {
                return self.count_dropped(tag);
            }
        }
        self.arrived = self.arrived.wrapping_add(1);
    }

    pub fn push_answer(&mut self, message: &Message<'_>) {
        match encode(message, &mut self.scratch).map(<[u8]>::len) {
            Ok(length) => self.queue_answer(length),
            Err(_) => self.count_dropped_answer(),
        }
    }

    /// Moves as many whole packets as fit to the start of `out`, in the order they arose,
    /// and gives the bytes they take.
    pub fn take(&mut self, out: &mut [u8]) -> usize {
        let mut filled = 0;
        if self.fresh
            && let Some(first) = out.first_mut()
        {
            // Ends the part of a packet that the last host may have left in the link.
            *first = DELIMITER;
            self.fresh = false;
            filled = 1;
        }
        while let Some(length) = self.pop(&mut out[filled..]) {
            filled += length;
        }
        filled
    }

    /// Whether all packets have been handed out.
    pub fn is_empty(&self) -> bool {
        self.batches.front().is_none() && self.answers.front().is_none()
    }

    /// Numbers of scans, batches and answers dropped since reset.
    pub fn dropped(&self) -> Dropped {
        self.dropped
    }

    fn pop(&mut self, out: &mut [u8]) -> Option<usize> {
        // An answer is next once every batch queued before it has left, that is, once
        // `left` has reached or passed its tag. The counts wrap, so the comparison is
        // whether the tag lies beyond the batches that are still queued.
        let answer_is_next = self.answers.front().is_some_and(|answer| {
            let ahead = answer.tag.wrapping_sub(self.left);
            ahead == 0 || ahead > self.arrived.wrapping_sub(self.left)
        });
        if answer_is_next {
            return self.answers.pop(out);
        }
        let length = self.batches.pop(out)?;
        self.left = self.left.wrapping_add(1);
        Some(length)
    }

    /// Queues the answer whose `length` bytes are in the buffer.
    fn queue_answer(&mut self, length: usize) {
        // Ends because an empty queue takes any packet.
        while !self.answers.push(&self.scratch[..length], self.arrived) {
            self.count_dropped_answer();
            self.answers.discard();
        }
    }

    fn drop_batch(&mut self) -> bool {
        let Some(tag) = self.batches.discard() else {
            return false;
        };
        self.left = self.left.wrapping_add(1);
        self.count_dropped(tag);
        true
    }

    fn count_dropped_answer(&mut self) {
        self.dropped.answers = self.dropped.answers.saturating_add(1);
    }

    /// Poses and edges are not counted: the gap in their numbers shows, or the scans of poses are in batches.
    fn count_dropped(&mut self, scans: u32) {
        if matches!(scans, POSES | EDGES) {
            return;
        }
        self.dropped.scans = self.dropped.scans.saturating_add(scans.into());
        self.dropped.batches = self.dropped.batches.saturating_add(1);
    }
}
