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
    use proptest::collection::vec;
    use proptest::option;
    use proptest::prelude::*;

    use super::*;

    fn instant() -> impl Strategy<Value = HostInstant> {
        (0..NO_TIME, any::<u64>()).prop_map(|(monotonic_ns, utc_ns)| HostInstant { monotonic_ns, utc_ns })
    }

    fn segment() -> impl Strategy<Value = Segment> {
        let reads = vec((vec(any::<u8>(), 0..70), option::of(instant())), 0..12);
        let asked = vec((any::<u32>(), instant()).prop_map(|(token, at)| Asked { token, at }), 0..4);
        (any::<bool>(), reads, asked).prop_map(|(opened, reads, asked)| {
            let mut segment = Segment { opened, asked, ..Segment::default() };
            for (bytes, at) in reads {
                segment.push(&bytes, at);
            }
            segment
        })
    }

    proptest! {
        #[test]
        fn segments_come_back_as_they_were(segment in segment()) {
            let mut bytes = vec![1, 2, 3];
            encode(&segment, &mut bytes);
            let mut back = Segment { opened: true, ..Segment::default() };
            back.push(b"old", None);
            prop_assert_eq!(decode(&bytes, &mut back), Some(()));
            prop_assert_eq!(back, segment);
        }

        #[test]
        fn a_message_cut_short_or_changed_is_no_segment_or_a_sound_one(
            segment in segment(),
            cut in any::<prop::sample::Index>(),
            flip in 1_u8..,
        ) {
            let mut bytes = Vec::new();
            encode(&segment, &mut bytes);
            let mut back = Segment::default();
            let at = cut.index(bytes.len());
            prop_assert_eq!(decode(&bytes[..at], &mut back), None);
            prop_assert!(back.is_empty());
            bytes[at] ^= flip;
            if decode(&bytes, &mut back).is_some() {
                let in_reads: usize = back.reads.iter().map(|read| read.bytes).sum();
                prop_assert_eq!(in_reads, back.bytes.len());
            }
        }
    }
}
