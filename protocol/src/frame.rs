//! Packets: a value, its checksum, and the bytes that mark its end.
//!
//! `COBS( postcard value ‖ CRC-32 of it, little endian ) ‖ 0x00`

use crc::{CRC_32_ISO_HDLC, Crc};
use serde::Serialize;
use thiserror::Error;

use crate::ProtocolVersion;

/// The byte that ends a packet; occurs nowhere else.
pub const DELIMITER: u8 = 0;

/// Length of the longest packet from a board, delimiter included. It holds 20 scans of
/// six cells with a dark slot, or 7 of sixteen cells.
pub const MAX_MESSAGE_BYTES: usize = 1024;

/// Length of the longest packet from a host, delimiter included. The largest, a
/// [`Configure`](crate::Command::Configure) of 16 cells in 17 slots, takes 140.
pub const MAX_REQUEST_BYTES: usize = 160;

pub(crate) static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
const CRC_BYTES: usize = size_of::<u32>();

/// The value of a packet: a [`Message`](crate::Message) or a
/// [`Request`](crate::Request).
pub trait Packet<'p>: Serialize + Sized {
    /// Reads the value from a payload with a correct checksum.
    ///
    /// # Errors
    /// If the payload is not such a value, or has extra bytes.
    fn from_payload(payload: &'p [u8]) -> Result<Self, PayloadError>;
}

/// Length of the longest run of one code byte of the stuffing.
const RUN_BYTES: usize = 254;

/// Writes `value` as a packet to the start of `out` and returns the packet, delimiter
/// included. Works in place: value and checksum are written a little after the start,
/// and move forward as they are stuffed.
///
/// ```
/// use slitpose_protocol::*;
/// let mut out = [0; MAX_REQUEST_BYTES];
/// let packet = encode(&Request { number: 7, command: Command::Start }, &mut out)?;
/// let mut decoder = Decoder::<MAX_REQUEST_BYTES>::new();
/// let received = decoder.next::<Request>(&mut &packet[..]).expect("a whole packet");
/// assert_eq!(received, Ok(Request { number: 7, command: Command::Start }));
/// # Ok::<(), EncodeError>(())
/// ```
///
/// # Errors
/// If `out` is too small; its contents are then undefined.
// Of a message whose kind is known where it is encoded, only that kind's part is left.
#[inline(always)]
pub fn encode<'o, 'p>(value: &impl Packet<'p>, out: &'o mut [u8]) -> Result<&'o [u8], EncodeError> {
    let available = out.len();
    let too_small = EncodeError { available };
    // Stuffing adds one byte at the start, and one after each full run.
    let start = 1 + available / RUN_BYTES;
    let place = out.get_mut(start..).ok_or(too_small)?;
    let length = postcard::to_slice(value, place).map_err(|_| too_small)?.len();
    close(out, start, length).ok_or(too_small)
}

/// Makes a packet of the payload of `length` bytes at `start`.
#[inline(never)]
fn close(out: &mut [u8], start: usize, length: usize) -> Option<&[u8]> {
    let end = start + length;
    let checksum = CRC.checksum(&out[start..end]).to_le_bytes();
    out.get_mut(end..end + CRC_BYTES)?.copy_from_slice(&checksum);
    let stuffed = stuff(out, start, end + CRC_BYTES);
    *out.get_mut(stuffed)? = DELIMITER;
    Some(&out[..=stuffed])
}

/// Stuffs the bytes from `start` to `end`, moves them to the start of `bytes`, and returns
/// their number. `start` is large enough that no byte is overwritten before it has been
/// moved.
fn stuff(bytes: &mut [u8], start: usize, end: usize) -> usize {
    let (mut from, mut to) = (start, 0);
    loop {
        let rest = &bytes[from..end];
        let limit = rest.len().min(RUN_BYTES);
        let run = rest[..limit].iter().position(|&byte| byte == 0).unwrap_or(limit);
        let is_last = run == rest.len();
        bytes[to] = run as u8 + 1;
        bytes.copy_within(from..from + run, to + 1);
        to += run + 1;
        // A full run is sent as it is; after any other run a zero is omitted.
        from += if run == RUN_BYTES { run } else { run + 1 };
        if is_last {
            return to;
        }
    }
}

/// Undoes stuffing and checksum of a frame (a packet without its delimiter) in place and
/// returns the payload.
pub(crate) fn open(frame: &mut [u8]) -> Result<&[u8], FrameError> {
    let stuffed_bytes = frame.len();
    let bytes = cobs::decode_in_place(frame).map_err(|_| FrameError::Stuffing { bytes: stuffed_bytes })?;
    match frame[..bytes].split_last_chunk::<CRC_BYTES>() {
        Some((payload, &received)) if !payload.is_empty() => {
            let received = u32::from_le_bytes(received);
            let computed = CRC.checksum(payload);
            if computed == received { Ok(payload) } else { Err(FrameError::Checksum { computed, received }) }
        }
        _ => Err(FrameError::Short { bytes }),
    }
}

/// The buffer given to [`encode`] is too small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the packet does not fit {available} bytes")]
pub struct EncodeError {
    /// Bytes the buffer has.
    pub available: usize,
}

/// Why a frame has no value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum FrameError {
    #[error("{bytes} bytes without a delimiter, no packet has more than {limit}")]
    Overlong { bytes: u64, limit: usize },
    #[error("the stuffing of a frame of {bytes} bytes is broken")]
    Stuffing { bytes: usize },
    #[error("a frame of {bytes} bytes holds no payload")]
    Short { bytes: usize },
    #[error("checksum {received:#010x} received, {computed:#010x} computed")]
    Checksum { computed: u32, received: u32 },
    #[error(transparent)]
    Payload(#[from] PayloadError),
}

/// Why an undamaged payload cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum PayloadError {
    #[error("a payload of {bytes} bytes does not say what it is")]
    NoKind { bytes: usize },
    #[error("message kind {kind} is unknown: the board is newer than this program")]
    UnknownMessage { kind: u32 },
    #[error("the fields of message kind {kind} cannot be read: compare schema keys")]
    MalformedMessage { kind: u32 },
    #[error("the board speaks protocol {theirs}, this program {ours}: update the older one")]
    Version { theirs: ProtocolVersion, ours: ProtocolVersion },
    #[error("command {number} is of unknown kind {kind}: the host is newer than the board")]
    UnknownCommand { number: u16, kind: u32 },
    #[error("the fields of command {number}, kind {kind}, cannot be read: compare schema keys")]
    MalformedCommand { number: u16, kind: u32 },
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;

    /// Against the COBS crate, an implementation of its own.
    fn check(payload: &[u8]) {
        let start = 1 + (payload.len() + 8) / RUN_BYTES;
        let mut bytes = std::vec![0xee; start];
        bytes.extend(payload);
        let stuffed = stuff(&mut bytes, start, start + payload.len());
        let mut expected = std::vec![0; cobs::max_encoding_length(payload.len())];
        let length = cobs::encode(payload, &mut expected);
        let mut back: Vec<u8> = bytes[..stuffed].to_vec();
        let unstuffed = cobs::decode_in_place(&mut back).expect("well stuffed");
        assert_eq!(&back[..unstuffed], payload);
        assert_eq!(bytes[..stuffed], expected[..length]);
    }

    #[test]
    fn runs_of_all_lengths_are_stuffed() {
        for length in 1..1_000 {
            check(&std::vec![7; length]);
            let mut ended = std::vec![7; length];
            ended.push(0);
            check(&ended);
        }
    }
}
