//! What the decoder makes of streams: whole, cut anywhere, and damaged.

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;
use slitpose_protocol::{
    Batch, Decoder, DecoderCounters, EncodeError, Event, FrameError, Level, MAX_CELLS, MAX_MESSAGE_BYTES, Message,
    PROTOCOL, Packet, PayloadError, Pong, ProtocolVersion, Request, Severity, encode,
};

type HostDecoder = Decoder<MAX_MESSAGE_BYTES>;

fn packet<'p>(value: &impl Packet<'p>) -> Vec<u8> {
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    encode(value, &mut buffer).expect("every message fits its limit").to_vec()
}

/// Packets of messages of fixed length, of text and of any bytes.
fn packets() -> impl Strategy<Value = Vec<u8>> {
    let (levels, samples) = (vec(any::<u16>(), 0..=MAX_CELLS), vec(any::<u8>(), 0..600));
    prop_oneof![
        any::<(u32, u64)>().prop_map(|(token, tick)| packet(&Message::Pong(Pong { token, tick }))),
        (any::<u64>(), "\\PC{0,40}").prop_map(|(tick, text)| packet(&Message::Event(Event {
            tick,
            severity: Severity::Error,
            text: &text
        }))),
        (any::<(u16, u64, u64)>(), levels, samples).prop_map(|(n, levels, samples)| {
            let levels = levels.into_iter().map(Level).collect();
            let (configuration, sequence, tick) = n;
            packet(&Message::Batch(Batch { configuration, sequence, tick, levels, samples: &samples }))
        }),
    ]
}

/// Decodes `pieces` one after the other; what comes out is given as re-encoded packets,
/// because messages only live until the next call.
fn decode(pieces: &[&[u8]]) -> (Vec<Result<Vec<u8>, FrameError>>, HostDecoder) {
    let mut decoder = HostDecoder::new();
    let mut results = Vec::new();
    for piece in pieces {
        let mut input = *piece;
        while let Some(result) = decoder.next::<Message>(&mut input) {
            results.push(result.map(|message| packet(&message)));
        }
        assert!(input.is_empty());
    }
    (results, decoder)
}

/// A payload with its checksum and stuffing, whatever it holds.
fn packet_of_payload(payload: &[u8]) -> Vec<u8> {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(payload);
    let framed = [payload, &crc.to_le_bytes()].concat();
    let mut out = vec![0; cobs::max_encoding_length(framed.len()) + 1];
    let length = cobs::encode(&framed, &mut out);
    out.truncate(length + 1);
    out
}

/// One thing that goes wrong with one packet on its way.
#[derive(Debug, Clone)]
enum Damage {
    None,
    Flip(Index, u8),
    Cut(Index, Index),
    Insert(Index, Vec<u8>),
    Before(Vec<u8>),
    Flood(u16),
}

impl Damage {
    fn any() -> impl Strategy<Value = Self> {
        prop_oneof![
            6 => Just(Self::None),
            2 => (any::<Index>(), 1..=u8::MAX).prop_map(|(at, bits)| Self::Flip(at, bits)),
            2 => any::<(Index, Index)>().prop_map(|(from, to)| Self::Cut(from, to)),
            1 => (any::<Index>(), vec(any::<u8>(), 1..9)).prop_map(|(at, b)| Self::Insert(at, b)),
            1 => vec(any::<u8>(), 1..99).prop_map(Self::Before),
            1 => (1..4_000_u16).prop_map(Self::Flood),
        ]
    }

    fn send(&self, packet: &[u8], stream: &mut Vec<u8>) {
        let mut sent = packet.to_vec();
        match self {
            Self::None => {}
            Self::Flip(at, bits) => sent[at.index(packet.len())] ^= bits,
            Self::Cut(from, to) => {
                let (from, to) = (from.index(packet.len()), to.index(packet.len()));
                sent.drain(from.min(to)..=from.max(to));
            }
            Self::Insert(at, bytes) => {
                let at = at.index(packet.len());
                sent.splice(at..at, bytes.iter().copied());
            }
            Self::Before(bytes) => stream.extend(bytes),
            Self::Flood(bytes) => stream.extend((0..*bytes).map(|i| (i % 255) as u8 + 1)),
        }
        stream.extend(sent);
    }
}

fn assert_adds_up(stream: &[u8], recovered: &[&[u8]], decoder: &HostDecoder) {
    let counters = decoder.counters();
    let mut frames: Vec<&[u8]> = stream.split(|&byte| byte == 0).collect();
    let pending = frames.pop().expect("split gives one part at least");
    let idle = frames.iter().filter(|frame| frame.is_empty()).count();
    assert_eq!(decoder.pending_bytes(), pending.len() as u64);
    assert_eq!(counters.packets, recovered.len() as u64);
    assert_eq!(
        counters.packets + counters.damaged() + counters.unknown + counters.malformed,
        (frames.len() - idle) as u64
    );
    let good: usize = recovered.iter().map(|packet| packet.len()).sum();
    assert_eq!(counters.bytes, stream.len() as u64);
    assert_eq!(counters.bytes, (good + idle) as u64 + counters.bytes_skipped + decoder.pending_bytes());
}

proptest! {
    #[test]
    fn whatever_arrives_whole_after_a_delimiter_is_recovered(
        sent in vec((packets(), Damage::any()), 1..12),
        cuts in vec(any::<Index>(), 0..6),
    ) {
        let mut stream = Vec::new();
        sent.iter().for_each(|(packet, damage)| damage.send(packet, &mut stream));
        // A packet arrives whole if its bytes, and no others, stand between delimiters.
        let recoverable: Vec<&[u8]> = stream
            .split_inclusive(|&byte| byte == 0)
            .filter(|frame| sent.iter().any(|(packet, _)| packet == frame))
            .collect();

        let mut ends: Vec<usize> = cuts.iter().map(|cut| cut.index(stream.len() + 1)).collect();
        ends.extend([0, stream.len()]);
        ends.sort_unstable();
        let pieces: Vec<&[u8]> = ends.windows(2).map(|w| &stream[w[0]..w[1]]).collect();
        let (results, decoder) = decode(&pieces);

        let recovered: Vec<&[u8]> = results.iter().flatten().map(Vec::as_slice).collect();
        prop_assert_eq!(&recovered, &recoverable);
        assert_adds_up(&stream, &recovered, &decoder);
    }
}

#[test]
fn no_one_or_two_flipped_bits_pass() {
    let packet = packet(&Message::Pong(Pong { token: 7, tick: 170_000_000 }));
    let bits = packet.len() * 8;
    for first in 0..bits {
        for second in first..bits {
            let mut damaged = packet.clone();
            damaged[first / 8] ^= 1 << (first % 8);
            if second != first {
                damaged[second / 8] ^= 1 << (second % 8);
            }
            let (results, _) = decode(&[&damaged]);
            assert!(results.iter().all(Result::is_err), "bits {first}, {second}");
        }
    }
}

fn refuse(by_a_board: bool, mut stream: &[u8]) -> (Option<FrameError>, DecoderCounters) {
    let mut decoder = HostDecoder::new();
    let error = if by_a_board {
        decoder.next::<Request>(&mut stream).and_then(Result::err)
    } else {
        decoder.next::<Message>(&mut stream).and_then(Result::err)
    };
    (error, decoder.counters())
}

/// Every reason for which a frame gives no value: its name, with the numbers that disagree, and the
/// one counter it is counted by.
#[test]
fn what_cannot_be_read_is_named_and_counted_by_its_kind() {
    let (overlong, misframed, bad_checksum, unknown, malformed) = {
        let none = DecoderCounters::default();
        (
            DecoderCounters { overlong: 1, ..none },
            DecoderCounters { misframed: 1, ..none },
            DecoderCounters { bad_checksum: 1, ..none },
            DecoderCounters { unknown: 1, ..none },
            DecoderCounters { malformed: 1, ..none },
        )
    };
    // The checksum of these digits is the check value that CRC catalogues print for CRC-32/ISO-HDLC.
    let wrong_sum = [b"\x0e123456789".as_slice(), &0xcbf4_3927_u32.to_le_bytes(), &[0]].concat();
    let checksum = FrameError::Checksum { computed: 0xcbf4_3926, received: 0xcbf4_3927 };
    let limit = MAX_MESSAGE_BYTES - 1;
    let version = |major, minor| PayloadError::Version { theirs: ProtocolVersion { major, minor }, ours: PROTOCOL };
    let payload = |bytes: &[u8], error: PayloadError| (packet_of_payload(bytes), FrameError::Payload(error));
    let frames = [
        (([[1; MAX_MESSAGE_BYTES].as_slice(), &[0]].concat(), FrameError::Overlong { bytes: 1024, limit }), overlong),
        ((vec![9, 1, 2, 0], FrameError::Stuffing { bytes: 3 }), misframed),
        ((packet_of_payload(&[]), FrameError::Short { bytes: 4 }), misframed),
        ((vec![4, 1, 2, 3, 0], FrameError::Short { bytes: 3 }), misframed),
        ((wrong_sum, checksum), bad_checksum),
    ];
    let messages = [
        (payload(&[0x80], PayloadError::NoKind { bytes: 1 }), malformed),
        (payload(&[9, 1, 2], PayloadError::UnknownMessage { kind: 9 }), unknown),
        (payload(&[99], PayloadError::UnknownMessage { kind: 99 }), unknown),
        // Of another major version no field is read; of this one all are.
        (payload(&[0, 1, 9, 0xff], version(1, 9)), unknown),
        (payload(&[0, 3, 4], version(3, 4)), unknown),
        (payload(&[0, 2, 9, 0xff], PayloadError::MalformedMessage { kind: 0 }), malformed),
        (payload(&[5, 7], PayloadError::MalformedMessage { kind: 5 }), malformed),
        (payload(&[5, 7, 9, 0], PayloadError::MalformedMessage { kind: 5 }), malformed),
    ];
    let requests = [
        (payload(&[3], PayloadError::NoKind { bytes: 1 }), malformed),
        (payload(&[0x81, 4, 14, 1], PayloadError::UnknownCommand { number: 513, kind: 14 }), unknown),
        // A full scale of zero.
        (payload(&[3, 11, 0], PayloadError::MalformedCommand { number: 3, kind: 11 }), malformed),
        (payload(&[3, 4], PayloadError::MalformedCommand { number: 3, kind: 4 }), malformed),
        (payload(&[0x81, 4, 2, 0], PayloadError::MalformedCommand { number: 513, kind: 2 }), malformed),
    ];
    let refused = |by_a_board: bool, cases: &[((Vec<u8>, FrameError), DecoderCounters)]| {
        for ((stream, error), counter) in cases {
            let bytes = stream.len() as u64;
            let counters = DecoderCounters { bytes, bytes_skipped: bytes, ..*counter };
            assert_eq!(refuse(by_a_board, stream), (Some(*error), counters), "{stream:02x?}");
        }
    };
    refused(false, &frames);
    refused(true, &frames);
    refused(false, &messages);
    refused(true, &requests);
}

#[test]
fn the_longest_frame_passes_and_one_more_does_not() {
    for (length, fits) in [(MAX_MESSAGE_BYTES - 1, true), (MAX_MESSAGE_BYTES, false)] {
        let mut stream = vec![1; length];
        stream.push(0);
        let (results, decoder) = decode(&[&stream]);
        let overlong = FrameError::Overlong { bytes: length as u64, limit: MAX_MESSAGE_BYTES - 1 };
        assert_eq!(results[0] != Err(overlong), fits);
        assert_eq!(decoder.counters().overlong, u64::from(!fits));
    }
}

#[test]
fn reset_forgets_half_a_frame() {
    let pong = packet(&Message::Pong(Pong { token: 1, tick: 2 }));
    let mut decoder = HostDecoder::new();
    assert_eq!(decoder.next::<Message>(&mut &pong[..3]), None);
    decoder.reset();
    assert_eq!(decoder.counters().bytes_skipped, 3);
    assert!(matches!(decoder.next::<Message>(&mut pong.as_slice()), Some(Ok(_))));
}

#[test]
fn a_packet_needs_its_own_length_and_no_less() {
    let pong = Message::Pong(Pong { token: 7, tick: 170_000_000 });
    let whole = packet(&pong);
    for available in 0..3 * whole.len() {
        let mut buffer = vec![0; available];
        let fits = if available < whole.len() { Err(EncodeError { available }) } else { Ok(whole.as_slice()) };
        assert_eq!(encode(&pong, &mut buffer), fits);
    }
}
