//! The packet memory: buffers, and the table that says where they are (RM0440, "Buffer
//! descriptor table").
//!
//! An entry of the table has four halfwords: address and count of the transmission buffer, address
//! and count of the reception buffer. The upper bits of the latter hold the buffer's size.

use std::ops::Range;

pub(super) const BYTES: usize = 1024;

const COUNT: usize = 0x3ff;

/// Blocks of 32 bytes rather than 2.
const BLOCK_SIZE: usize = 1 << 15;

/// 1 KB of memory beside the bus.
#[derive(Clone, Debug)]
pub(super) struct PacketMemory([u8; BYTES]);

impl Default for PacketMemory {
    fn default() -> Self {
        Self::new()
    }
}

impl PacketMemory {
    pub(super) fn new() -> Self {
        Self([0; BYTES])
    }

    /// A little-endian number of up to four bytes. Beyond the memory there is nothing.
    pub(super) fn read(&self, range: Range<usize>) -> u32 {
        self.bytes(range).iter().rev().fold(0, |value, &byte| value << 8 | u32::from(byte))
    }

    pub(super) fn write(&mut self, range: Range<usize>, value: u32) {
        if let Some(bytes) = self.0.get_mut(range) {
            let len = bytes.len();
            bytes.copy_from_slice(&value.to_le_bytes()[..len]);
        }
    }

    /// The part of `range` that exists.
    pub(super) fn bytes(&self, range: Range<usize>) -> &[u8] {
        let end = range.end.min(BYTES);
        &self.0[range.start.min(end)..end]
    }

    /// What the entry at `entry` says is to be sent.
    pub(super) fn tx_buffer(&self, entry: usize) -> Range<usize> {
        let start = self.half(entry) & !1;
        start..start + (self.half(entry + 2) & COUNT)
    }

    /// Where the entry at `entry` has room for a packet.
    pub(super) fn rx_buffer(&self, entry: usize) -> Range<usize> {
        let start = self.half(entry + 4) & !1;
        let size = self.half(entry + 6);
        let blocks = size >> 10 & 0x1f;
        start..start + if size & BLOCK_SIZE != 0 { 32 * (blocks + 1) } else { 2 * blocks }
    }

    /// Puts a packet into the reception buffer of the entry at `entry`, and its length into the
    /// entry.
    pub(super) fn receive(&mut self, entry: usize, packet: &[u8]) {
        let start = self.rx_buffer(entry).start;
        if let Some(buffer) = self.0.get_mut(start..start + packet.len()) {
            buffer.copy_from_slice(packet);
        }
        let count = self.half(entry + 6) & !COUNT | packet.len();
        self.write(entry + 6..entry + 8, count as u32);
    }

    fn half(&self, offset: usize) -> usize {
        self.read(offset..offset + 2) as usize
    }
}
