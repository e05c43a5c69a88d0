//! A [`Segment`] as the message `slitpose_msgs/msg/LinkBytes`, without loss.

use crate::clock::HostInstant;
use crate::link::{Asked, Read, Segment};
use crate::ros::cdr::{Decoder, Encoder};

/// Time of a read without time: a clock reaches it after 584 years.
const NO_TIME: u64 = u64::MAX;

/// Writes `segment` into `bytes`, which is cleared first.
pub fn encode(segment: &Segment, bytes: &mut Vec<u8>) {
    let mut encoder = Encoder::new(bytes);
    encoder.bool(segment.opened);
    encoder.bytes(&segment.bytes);
    encoder.length(segment.reads.len());
    for read in &segment.reads {
        encoder.u32(u32::try_from(read.bytes).unwrap_or(u32::MAX));
    }
    instants(&mut encoder, segment.reads.iter().map(|read| read.at));
    encoder.length(segment.asked.len());
    for asked in &segment.asked {
        encoder.u32(asked.token);
    }
    instants(&mut encoder, segment.asked.iter().map(|asked| Some(asked.at)));
}

/// UTC is stored as its difference from the monotonic clock, which is nearly constant and compresses well.
fn instants(encoder: &mut Encoder<'_>, all: impl ExactSizeIterator<Item = Option<HostInstant>> + Clone) {
    encoder.length(all.len());
    for at in all.clone() {
        encoder.u64(at.map_or(NO_TIME, |at| at.monotonic_ns));
    }
    encoder.length(all.len());
    for at in all {
        encoder.u64(at.map_or(0, |at| at.utc_ns.wrapping_sub(at.monotonic_ns)));
    }
}

/// Reads a message into `segment`; `None` if `bytes` are not a message, and `segment` is then empty.
pub fn decode(bytes: &[u8], segment: &mut Segment) -> Option<()> {
    segment.clear();
    let decoded = fill(bytes, segment);
    if decoded.is_none() {
        segment.clear();
    }
    decoded
}

fn fill(bytes: &[u8], segment: &mut Segment) -> Option<()> {
    let Segment { opened, bytes: data, reads, asked } = segment;
    let mut decoder = Decoder::new(bytes)?;
    *opened = decoder.bool()?;
    data.extend_from_slice(decoder.bytes()?);
    decoder.each_u32(|bytes| reads.push(Read { bytes: bytes as usize, at: None }))?;
    let monotonic = decoder.each_u64(|index, monotonic_ns| {
        if let Some(read) = reads.get_mut(index) {
            read.at = (monotonic_ns != NO_TIME).then_some(HostInstant { monotonic_ns, utc_ns: monotonic_ns });
        }
    })?;
    let utc = decoder.each_u64(|index, distance_ns| {
        if let Some(at) = reads.get_mut(index).and_then(|read| read.at.as_mut()) {
            at.utc_ns = at.monotonic_ns.wrapping_add(distance_ns);
        }
    })?;
    decoder.each_u32(|token| asked.push(Asked { token, at: HostInstant::default() }))?;
    let asked_monotonic = decoder.each_u64(|index, monotonic_ns| {
        if let Some(asked) = asked.get_mut(index) {
            asked.at = HostInstant { monotonic_ns, utc_ns: monotonic_ns };
        }
    })?;
    let asked_utc = decoder.each_u64(|index, distance_ns| {
        if let Some(asked) = asked.get_mut(index) {
            asked.at.utc_ns = asked.at.monotonic_ns.wrapping_add(distance_ns);
        }
    })?;
    let agree = [monotonic, utc] == [reads.len(); 2] && [asked_monotonic, asked_utc] == [asked.len(); 2];
    let in_reads = reads.iter().try_fold(0_usize, |sum, read| sum.checked_add(read.bytes));
    (agree && in_reads == Some(data.len())).then_some(())
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn a_message_comes_back_and_one_cut_short_or_changed_is_no_segment_or_a_sound_one() {
        let mut random = ChaCha8Rng::seed_from_u64(17);
        let (mut bytes, mut back) = (vec![1, 2, 3], Segment { opened: true, ..Segment::default() });
        back.push(b"old", None);
        for round in 0..1000 {
            let mut segment = Segment { opened: random.random(), ..Segment::default() };
            for token in 0..random.random_range(0..12) {
                let read: Vec<u8> = (0..random.random_range(0..70)).map(|_| random.random()).collect();
                let at = HostInstant { monotonic_ns: random.random_range(0..NO_TIME), utc_ns: random.random() };
                segment.push(&read, random.random_bool(0.7).then_some(at));
                segment.asked.extend(random.random_bool(0.2).then_some(Asked { token, at }));
            }
            encode(&segment, &mut bytes);
            assert_eq!((decode(&bytes, &mut back), &back), (Some(()), &segment), "seed 17, round {round}");
            let at = random.random_range(0..bytes.len());
            assert!(decode(&bytes[..at], &mut back).is_none() && back.is_empty(), "seed 17, round {round}");
            bytes[at] ^= random.random_range(1..=u8::MAX);
            if decode(&bytes, &mut back).is_some() {
                let in_reads: usize = back.reads.iter().map(|read| read.bytes).sum();
                assert_eq!(in_reads, back.bytes.len(), "seed 17, round {round}");
            }
        }
    }
}
