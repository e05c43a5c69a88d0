//! Packets with the right checksum around wrong content, which mutations of whole packets would never hit.

use slitpose_protocol::MAX_MESSAGE_BYTES;

/// A step of a script: an operation and its bytes.
pub struct Step<'a> {
    /// What to do.
    pub operation: u8,
    /// With these.
    pub bytes: &'a [u8],
}

/// The steps in `script`: an operation, a count and as many bytes, or what is left of them.
pub fn steps(mut script: &[u8]) -> impl Iterator<Item = Step<'_>> {
    std::iter::from_fn(move || {
        let (&[operation, count], rest) = script.split_first_chunk()?;
        let (bytes, rest) = rest.split_at(usize::from(count).min(rest.len()));
        script = rest;
        Some(Step { operation, bytes })
    })
}

/// The packet of a payload.
pub fn packet(payload: &[u8]) -> Vec<u8> {
    let framed = [payload, &crc32fast::hash(payload).to_le_bytes()].concat();
    // And the zero after it.
    let mut packet = vec![0; cobs::max_encoding_length(framed.len()) + 1];
    let length = cobs::encode(&framed, &mut packet);
    packet.truncate(length + 1);
    packet
}

/// The payload of a frame without its zero, whatever its checksum.
pub fn payload(stuffed: &[u8]) -> Option<Vec<u8>> {
    let mut framed = vec![0; stuffed.len()];
    let length = cobs::decode(stuffed, &mut framed).ok()?.frame_size();
    framed.truncate(length.checked_sub(4)?);
    Some(framed)
}

/// All frames of `bytes`, cut at its zeros, each with the right checksum if it can have one.
pub fn repaired(bytes: &[u8]) -> Vec<u8> {
    let mut stream = Vec::new();
    for frame in bytes.split_inclusive(|&byte| byte == 0) {
        match frame.strip_suffix(&[0]).and_then(payload) {
            Some(payload) if payload.len() < MAX_MESSAGE_BYTES => stream.extend(packet(&payload)),
            _ => stream.extend(frame),
        }
    }
    stream
}
