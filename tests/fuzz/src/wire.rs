//! Packets with the right checksum around wrong content, which mutations of whole packets would never hit; and the decoder
//! of the wire, in both directions.

use slitpose_protocol::{
    Batch, Decoder, DecoderCounters, FrameError, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, Request, Schedule,
    encode,
};

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

/// What decodes encodes again to a message that is equal; the same stream cut in two decodes to the same messages, errors
/// and counters; every byte is counted once. All of it with the checksums as they came, and put right.
pub(crate) fn decoder(bytes: &[u8]) {
    let (&cut, stream) = bytes.split_first().unwrap_or((&0, &[]));
    for stream in [stream, &repaired(stream)] {
        let at = stream.len() * usize::from(cut) / 256;
        let pieces = [&stream[..at], &stream[at..]];
        assert_eq!(messages(&[stream]), messages(&pieces), "cut at {at}");
        assert_eq!(requests(&[stream]), requests(&pieces), "cut at {at}");
    }
}

type Decoded = (Vec<Result<Vec<u8>, FrameError>>, DecoderCounters, u64);

fn messages(pieces: &[&[u8]]) -> Decoded {
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let mut results = Vec::new();
    let mut schedule = None;
    for mut input in pieces.iter().copied() {
        while let Some(result) = decoder.next::<Message<'_>>(&mut input) {
            results.push(result.map(|message| {
                read(&message, &mut schedule);
                again(&message)
            }));
        }
    }
    finished(results, decoder.counters(), decoder.pending_bytes(), pieces)
}

fn requests(pieces: &[&[u8]]) -> Decoded {
    let mut decoder = Decoder::<MAX_REQUEST_BYTES>::new();
    let mut results = Vec::new();
    for mut input in pieces.iter().copied() {
        while let Some(result) = decoder.next::<Request>(&mut input) {
            results.push(result.map(|request| {
                let mut buffer = [0; MAX_REQUEST_BYTES];
                let packet = encode(&request, &mut buffer).expect("what came in a packet fits one");
                let back = Decoder::<MAX_REQUEST_BYTES>::new().next::<Request>(&mut &*packet);
                assert_eq!(back, Some(Ok(request)));
                packet.to_vec()
            }));
        }
    }
    finished(results, decoder.counters(), decoder.pending_bytes(), pieces)
}

/// The packet of a message that was decoded. Compared as bytes: numbers may be NaN.
fn again(message: &Message<'_>) -> Vec<u8> {
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    let packet = encode(message, &mut buffer).expect("what came in a packet fits one").to_vec();
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let back = decoder.next::<Message<'_>>(&mut &*packet).expect("a whole packet").expect("of a message");
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    assert_eq!(encode(&back, &mut buffer).expect("the same"), packet);
    packet
}

/// Reads what a message holds by the schedule before it, as a host does.
fn read(message: &Message<'_>, schedule: &mut Option<Schedule>) {
    match message {
        Message::Hello(hello) => {
            *schedule = Some(hello.schedule.clone()).filter(|schedule| schedule.validate().is_ok());
            let _ = (hello.scaling.validate(hello.schedule.oversampling), hello.check_schemas());
        }
        Message::Batch(batch) => {
            if let Some(schedule) = schedule
                && let Ok(scans) = read_scans(batch, schedule)
            {
                assert_eq!(scans.0, scans.1, "scans announced and given");
            }
        }
        _ => {}
    }
}

fn read_scans(batch: &Batch<'_>, schedule: &Schedule) -> Result<(usize, usize), slitpose_protocol::BatchError> {
    let scans = batch.scans(schedule)?;
    Ok((scans.len(), scans.count()))
}

fn finished(
    results: Vec<Result<Vec<u8>, FrameError>>,
    counters: DecoderCounters,
    pending: u64,
    pieces: &[&[u8]],
) -> Decoded {
    let all = pieces.iter().map(|piece| piece.len() as u64).sum();
    assert_eq!(counters.bytes, all);
    let frames = counters.packets + counters.damaged() + counters.unknown + counters.malformed;
    assert_eq!(frames, results.len() as u64);
    assert!(counters.bytes_skipped + pending <= all);
    (results, counters, pending)
}
