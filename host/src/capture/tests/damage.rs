//! Captures that were cut, damaged, or met a full disk.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

/// A message of some packets of arbitrary bytes.
fn arbitrary(random: &mut impl Rng, at: HostInstant) -> Segment {
    let mut segment = Segment::default();
    for read in 0..random.random_range(1..5) {
        let bytes: Vec<u8> = (0..random.random_range(1..60)).map(|_| random.random_range(1..=255)).collect();
        segment.push(&bytes, Some(later(at, read * MS)));
    }
    segment.push(&[DELIMITER], None);
    segment
}

/// A capture of links on a disk.
struct OnDisk {
    bytes: Vec<u8>,
    /// Lengths of the file at each flush, and how many messages it held.
    flushes: Vec<(u64, usize)>,
    /// Whether nothing failed.
    written: bool,
    messages: Vec<Segment>,
}

/// Records `chunks` chunks of three messages, with a flush after each, to a disk with `room`.
fn on_disk(room: usize, chunks: usize) -> OnDisk {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut messages = Vec::new();
    let mut file = CaptureFile::create(Disk { bytes: Vec::new(), room }, &About::default()).unwrap();
    let mut flushes = Vec::new();
    let mut write = |file: &mut CaptureFile<Disk>| {
        let channels = file.add_device(&setup(FIRST), 0)?;
        file.flush()?;
        flushes.push((file.bytes(), 0));
        for chunk in 1..=chunks {
            for message in 0..3 {
                let segment = arbitrary(&mut random, later(BEGIN, (3 * chunk as u64 + message) * 20 * MS));
                file.link(channels, &segment, chunk as u64)?;
                messages.push(segment);
            }
            file.flush()?;
            flushes.push((file.bytes(), messages.len()));
        }
        file.finish()
    };
    let written = write(&mut file).is_ok();
    let (length, disk) = file.cut_back();
    assert_eq!(length, disk.bytes.len() as u64);
    OnDisk { bytes: disk.bytes, flushes, written, messages }
}

#[test]
fn wherever_a_capture_is_cut_all_that_was_flushed_is_read() {
    let OnDisk { bytes: whole, flushes, messages, .. } = on_disk(usize::MAX, 6);
    let (content, end) = read(&whole);
    assert_eq!(segments(content), messages);
    assert_eq!((end.finished, end.has_loss()), (true, false), "{end:?}");

    let last_chunk = flushes[flushes.len() - 2].0 as usize;
    let mut random = ChaCha8Rng::seed_from_u64(12);
    let anywhere: Vec<usize> = (0..200).map(|_| random.random_range(1..last_chunk)).collect();
    for length in (last_chunk..whole.len()).chain(anywhere) {
        let (content, end) = read(&whole[..length]);
        let flushed = flushes.iter().rev().find(|(flushed, _)| *flushed as usize <= length);
        let kept = flushed.map_or(0, |(_, messages)| *messages);
        let found = segments(content);
        // A cut behind the chunk, in its index, costs nothing.
        assert!(found.len() >= kept && found[..] == messages[..found.len()], "cut at {length}: {}", found.len());
        if !end.finished {
            let behind_flush = length as u64 - flushed.map_or(0, |(flushed, _)| *flushed);
            assert!(end.lost_bytes <= behind_flush, "cut at {length}: {end:?}");
            assert_eq!(end.whole_bytes + end.lost_bytes, length as u64, "cut at {length}: {end:?}");
        }
    }
}

#[test]
fn a_full_disk_keeps_what_was_flushed() {
    let OnDisk { bytes: whole, flushes, messages, .. } = on_disk(usize::MAX, 4);
    for room in (flushes[0].0 as usize..whole.len()).step_by(7) {
        let OnDisk { bytes: kept, flushes, written, .. } = on_disk(room, 4);
        assert!(!written, "room for {room}");
        let (length, count) = *flushes.last().unwrap();
        assert_eq!(kept.len() as u64, length, "room for {room}");
        let (content, end) = read(&kept);
        assert_eq!(segments(content), messages[..count]);
        assert_eq!((end.finished, end.whole_bytes, end.lost_bytes), (false, length, 0));
    }
}

#[test]
fn a_changed_byte_costs_a_chunk_or_is_told() {
    let OnDisk { bytes: whole, messages, .. } = on_disk(usize::MAX, 6);
    let seed = 13;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for round in 0..3000 {
        let mut damaged = whole.clone();
        let at = random.random_range(0..whole.len());
        damaged[at] ^= random.random_range(1..=255_u8);
        let (content, end) = read(&damaged);
        let found = segments(content);
        if at >= mcap::MAGIC.len() {
            assert!(found.iter().all(|segment| messages.contains(segment)), "seed {seed}, round {round}, byte {at}");
            assert!(found == messages || end.has_loss(), "seed {seed}, round {round}, byte {at}: {end:?}");
        }
    }
}

#[test]
fn a_damaged_chunk_is_passed_over() {
    let OnDisk { bytes: whole, flushes, messages, .. } = on_disk(usize::MAX, 6);
    // The chunk of the channels, then one of links.
    for (chunk, lost) in [(0, 0..0), (3, 6..9)] {
        let mut damaged = whole.clone();
        let begin = if chunk == 0 { 9 } else { flushes[chunk - 1].0 as usize };
        let at = if chunk == 0 { whole.windows(4).position(|four| four == b"zstd").unwrap() + 20 } else { begin + 120 };
        damaged[at] ^= 0x55;
        let (content, end) = read(&damaged);
        let mut expected = messages.clone();
        expected.drain(lost);
        assert_eq!(segments(content), expected);
        assert_eq!((end.finished, end.damaged_records), (true, 1), "{end:?}");
        assert!(end.has_loss() && end.lost_bytes > 0 && end.checksum_failed, "{end:?}");
    }
}

#[test]
fn noise_is_no_capture_and_does_no_harm() {
    let seed = 14;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for round in 0..300 {
        let mut noise = vec![0; random.random_range(0..20_000)];
        random.fill_bytes(&mut noise);
        let (content, end) = read(&noise);
        assert_eq!(joined(content), noise, "seed {seed}, round {round}");
        assert!(!end.has_loss());
        let (content, end) = read(&[mcap::MAGIC, &noise].concat());
        assert_eq!(content, Content::default(), "seed {seed}, round {round}");
        assert!(end.has_loss());
    }
}
