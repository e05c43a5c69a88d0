//! Decodes values from bytes.
//!
//! The decoder does no I/O: it receives bytes, cut anywhere, and returns one result for
//! each delimiter that ends a frame. After any damage it resynchronises at the next
//! delimiter.

use crate::frame::{DELIMITER, FrameError, Packet, PayloadError, open};

/// Decoder for one direction of a link; `N` is the length of the longest packet, delimiter
/// included: [`MAX_MESSAGE_BYTES`](crate::MAX_MESSAGE_BYTES) on a host,
/// [`MAX_REQUEST_BYTES`](crate::MAX_REQUEST_BYTES) on a board.
///
/// ```
/// use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message, Pong, encode};
///
/// let pong = Message::Pong(Pong { token: 7, tick: 170_000 });
/// let mut buffer = [0; 32];
/// let mut bytes = encode(&pong, &mut buffer)?;
/// let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
/// while let Some(result) = decoder.next::<Message>(&mut bytes) {
///     assert_eq!(result, Ok(pong.clone()));
/// }
/// # Ok::<(), slitpose_protocol::EncodeError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Decoder<const N: usize> {
    frame: [u8; N],
    /// Number of bytes since the last delimiter. Bytes beyond `N - 1` are only counted.
    bytes: u64,
    counters: DecoderCounters,
}

impl<const N: usize> Default for Decoder<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Decoder<N> {
    /// Longest frame, that is, packet without its delimiter.
    const LIMIT: usize = N - 1;

    /// A decoder without input.
    pub fn new() -> Self {
        Self { frame: [0; N], bytes: 0, counters: DecoderCounters::default() }
    }

    /// Consumes bytes from the front of `input` up to the end of the next frame and
    /// returns the frame's value; `None` if all input is consumed and no frame has
    /// ended. To be called until it returns `None`.
    ///
    /// # Errors
    /// If the frame is damaged or unknown. The decoder has counted it and is ready for
    /// the next one.
    pub fn next<'d, P: Packet<'d>>(&'d mut self, input: &mut &[u8]) -> Option<Result<P, FrameError>> {
        let bytes = self.fill(input)?;
        let result = match usize::try_from(bytes) {
            Ok(length) if length <= Self::LIMIT => open(&mut self.frame[..length])
                .and_then(|payload| P::from_payload(payload).map_err(FrameError::Payload)),
            _ => Err(FrameError::Overlong { bytes, limit: Self::LIMIT }),
        };
        self.counters.count(bytes + 1, result.as_ref().err());
        Some(result)
    }

    /// Drops the incomplete frame, for a link that is reopened; its bytes count as
    /// skipped.
    pub fn reset(&mut self) {
        self.counters.bytes_skipped += core::mem::take(&mut self.bytes);
    }

    /// The counters so far.
    pub fn counters(&self) -> DecoderCounters {
        self.counters
    }

    /// Number of bytes of the incomplete frame.
    pub fn pending_bytes(&self) -> u64 {
        self.bytes
    }

    /// Moves input into `frame`; returns the number of bytes of a frame that ended.
    fn fill(&mut self, input: &mut &[u8]) -> Option<u64> {
        loop {
            let end = input.iter().position(|&byte| byte == DELIMITER);
            let (part, rest) = input.split_at(end.unwrap_or(input.len()));
            let start = usize::try_from(self.bytes).map_or(Self::LIMIT, |b| b.min(Self::LIMIT));
            let kept = part.len().min(Self::LIMIT - start);
            self.frame[start..start + kept].copy_from_slice(&part[..kept]);
            self.bytes += part.len() as u64;
            self.counters.bytes += part.len() as u64;
            *input = rest;
            // `rest` starts with the delimiter, if there was one.
            let (_, rest) = input.split_first()?;
            *input = rest;
            self.counters.bytes += 1;
            // Delimiters in a row are idle filling, not empty frames.
            if self.bytes > 0 {
                return Some(core::mem::take(&mut self.bytes));
            }
        }
    }
}

/// Counters of a [`Decoder`]. Every frame is counted in exactly one of the frame
/// counters, and every byte belongs to a packet, to `bytes_skipped`, to the incomplete
/// frame ([`Decoder::pending_bytes`]) or is a single delimiter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderCounters {
    /// Bytes received.
    pub bytes: u64,
    /// Bytes of frames without a value, delimiters included.
    pub bytes_skipped: u64,
    /// Frames with a value.
    pub packets: u64,
    /// Frames longer than the longest packet.
    pub overlong: u64,
    /// Frames with broken stuffing or without payload.
    pub misframed: u64,
    /// Frames with a wrong checksum.
    pub bad_checksum: u64,
    /// Undamaged frames of a kind or version this crate does not know.
    pub unknown: u64,
    /// Undamaged frames of a known kind with unreadable fields.
    pub malformed: u64,
}

impl DecoderCounters {
    /// Frames damaged on the link. Unknown and malformed ones arrived as sent and do not
    /// count.
    pub fn damaged(&self) -> u64 {
        self.overlong + self.misframed + self.bad_checksum
    }

    fn count(&mut self, bytes: u64, error: Option<&FrameError>) {
        let Some(error) = error else {
            self.packets += 1;
            return;
        };
        self.bytes_skipped += bytes;
        *match error {
            FrameError::Overlong { .. } => &mut self.overlong,
            FrameError::Stuffing { .. } | FrameError::Short { .. } => &mut self.misframed,
            FrameError::Checksum { .. } => &mut self.bad_checksum,
            FrameError::Payload(
                PayloadError::UnknownMessage { .. }
                | PayloadError::UnknownCommand { .. }
                | PayloadError::Version { .. },
            ) => &mut self.unknown,
            FrameError::Payload(
                PayloadError::NoKind { .. }
                | PayloadError::MalformedMessage { .. }
                | PayloadError::MalformedCommand { .. },
            ) => &mut self.malformed,
        } += 1;
    }
}
