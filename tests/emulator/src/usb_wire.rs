//! The full-speed USB between host and device: signals, packets, and how long they take.
//!
//! Section numbers are those of the Universal Serial Bus Specification, revision 2.0.

use crate::peripherals::Ticks;

/// Bytes of the largest bulk and control packet at full speed (sections 5.5.3 and 5.8.3).
pub const MAX_PACKET_BYTES: usize = 64;

/// One frame: 1 ms.
pub const FRAME_TICKS: Ticks = 170_000;

/// What a token or data packet carries besides its content, in bits: synchronisation (8), packet
/// identifier (8) and end of packet (3) (section 8.3).
const PACKET_FRAME_BITS: u64 = 8 + 8 + 3;

/// Address, endpoint number and CRC5 of a token, or number and CRC5 of a frame (section 8.4.1).
const TOKEN_BITS: u64 = PACKET_FRAME_BITS + 16;

/// CRC16 of a data packet (section 8.4.4).
const DATA_CRC_BITS: u64 = 16;

/// From one packet of a transaction to the next; both sides must begin within 2 to 7.5 bits
/// (section 7.1.18).
const TURNAROUND_BITS: u64 = 7;

/// What the host puts on the wire besides packets, and takes off it by doing so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusSignal {
    /// Both data lines go low, for longer than any packet does.
    ResetBegins,
    /// The bus is back at rest after a reset.
    ResetEnds,
    /// A new frame with this number, of 11 bits.
    StartOfFrame(u16),
    /// The host ends a suspension.
    ResumeBegins,
    /// Frames follow from now on.
    ResumeEnds,
}

/// What a device answers to an IN token, or to a data packet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    Data {
        /// DATA1 rather than DATA0.
        toggle: bool,
        bytes: Vec<u8>,
    },
    /// The data packet is taken.
    Ack,
    /// Nothing to send yet, or no room.
    Nak,
    Stall,
    Silence,
}

/// A packet from the host, with the token ahead of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutPacket<'a> {
    pub address: u8,
    pub endpoint: u8,
    /// A SETUP token rather than OUT.
    pub setup: bool,
    /// DATA1 rather than DATA0.
    pub toggle: bool,
    pub bytes: &'a [u8],
}

/// Ticks of `bits` at 12 Mbit/s: a bit has 170/12 of them.
pub fn bit_ticks(bits: u64) -> Ticks {
    (bits * 85).div_ceil(6)
}

/// Ticks of a start-of-frame packet and the gap behind it.
pub fn start_of_frame_ticks() -> Ticks {
    bit_ticks(TOKEN_BITS + TURNAROUND_BITS)
}

/// Ticks of a transaction that moves `bytes`, handshake and the gap behind it included.
pub fn data_ticks(bytes: &[u8]) -> Ticks {
    let data = PACKET_FRAME_BITS + 8 * bytes.len() as u64 + stuffed_bits(bytes) + DATA_CRC_BITS;
    bit_ticks(TOKEN_BITS + data + PACKET_FRAME_BITS + 3 * TURNAROUND_BITS)
}

/// Ticks of the longest transaction that moves up to `len` bytes.
pub fn longest_data_ticks(len: usize) -> Ticks {
    data_ticks(&[0xff; MAX_PACKET_BYTES][..len.min(MAX_PACKET_BYTES)])
}

/// Ticks of an IN token that is answered by a handshake alone, or by nothing.
pub fn refused_in_ticks() -> Ticks {
    bit_ticks(TOKEN_BITS + PACKET_FRAME_BITS + 2 * TURNAROUND_BITS)
}

/// Zeros inserted so that no more than six ones follow each other (section 7.1.9).
fn stuffed_bits(bytes: &[u8]) -> u64 {
    let (mut ones, mut stuffed) = (0, 0);
    for byte in bytes {
        for bit in 0..8 {
            ones = if byte >> bit & 1 == 1 { ones + 1 } else { 0 };
            if ones == 6 {
                stuffed += 1;
                ones = 0;
            }
        }
    }
    stuffed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_holds_nineteen_full_packets_and_no_more() {
        // Section 5.8.4, table 5-9.
        let packet = data_ticks(&[0; MAX_PACKET_BYTES]);
        assert_eq!((FRAME_TICKS - start_of_frame_ticks()) / packet, 19);
    }

    #[test]
    fn ones_are_stuffed() {
        assert_eq!(stuffed_bits(&[0xff; 6]), 8);
        assert_eq!(stuffed_bits(&[0x3f, 0x3f]), 2);
        assert_eq!(stuffed_bits(&[0x55; 64]), 0);
        // Six ones may straddle two bytes.
        assert_eq!(stuffed_bits(&[0xe0, 0x07]), 1);
    }
}
