//! Bytes in, values out.
//!
//! The decoder does no input of its own: it is handed whatever bytes have arrived, cut
//! anywhere, and gives one result for each delimiter that ends a frame. After damage
//! of any kind it is back in step at the next delimiter.

use crate::frame::{DELIMITER, FrameError, Packet, PayloadError, open};

/// Decoder for one direction of a link; `N` is the longest packet it takes, delimiter
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
    /// Bytes since the last delimiter. Those beyond `N - 1` are counted, not kept.
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

    /// A decoder that has seen nothing.
    pub const fn new() -> Self {
        Self { frame: [0; N], bytes: 0, counters: DecoderCounters::new() }
    }

    /// Takes bytes from the front of `input` up to the end of the next frame and gives
    /// what the frame held; `None` once all input is taken and no frame has ended.
    /// Call it until it gives `None`.
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

    /// Forgets the frame under way, as when a link is opened anew; its bytes count as
    /// skipped.
    pub fn reset(&mut self) {
        self.counters.bytes_skipped += core::mem::take(&mut self.bytes);
    }

    /// What has come in so far.
    pub fn counters(&self) -> DecoderCounters {
        self.counters
    }

    /// Bytes of the frame under way, which has not ended yet.
    pub fn pending_bytes(&self) -> u64 {
        self.bytes
    }

    /// Moves input into `frame` and gives the number of bytes of a frame that ended.
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

/// What a [`Decoder`] has seen. Every frame is counted in exactly one of the frame
/// counters, and every byte belongs to a packet, to `bytes_skipped`, to the frame under
/// way ([`Decoder::pending_bytes`]) or is a delimiter on its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderCounters {
    /// Bytes taken in.
    pub bytes: u64,
    /// Bytes of frames that gave no value, their delimiters included.
    pub bytes_skipped: u64,
    /// Frames that gave a value.
    pub packets: u64,
    /// Frames with more bytes than any packet has.
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
    const fn new() -> Self {
        Self {
            bytes: 0,
            bytes_skipped: 0,
            packets: 0,
            overlong: 0,
            misframed: 0,
            bad_checksum: 0,
            unknown: 0,
            malformed: 0,
        }
    }

    /// Frames that were damaged on their way. Unknown and malformed ones arrived as
    /// they were sent and are not among them.
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
