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
    written: bool,
    messages: Vec<Segment>,
}

/// Records `chunks` chunks of three messages, with a flush after each, to a disk with `room`.
fn on_disk(room: usize, chunks: usize) -> OnDisk {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut messages = Vec::new();
    let disk = Disk::of(room);
    let mut file = disk.begin();
    let mut flushes = Vec::new();
    let mut write = |file: &mut CaptureFile| {
        let channels = file.add_device(&setup(FIRST), &[], 0)?;
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
    let (length, bytes) = (file.cut_back(), disk.bytes());
    assert_eq!(length, bytes.len() as u64);
    OnDisk { bytes, flushes, written, messages }
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
    // Copies of scene and metadata follow the last flush.
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

/// A capture of two boards in chunks, and what it holds of each.
struct Chunked {
    bytes: Vec<u8>,
    /// Ends of the regions of the file: what comes ahead of the first chunk with scans, each chunk with the
    /// copies ahead of it, and what stands behind the last.
    ends: Vec<usize>,
    /// Scans by board and number, with the region each is in.
    rows: BTreeMap<(DeviceId, u64), (RawScan, usize)>,
    setups: BTreeMap<DeviceId, Setup>,
}

impl Chunked {
    /// With the shortest scene, so that every byte can be tried.
    fn new(chunks: usize) -> Self {
        let file = BENCH.read().unwrap();
        let frames = stream(&WIDE.read().unwrap(), 8 * chunks, false);
        let disk = Disk::of(usize::MAX);
        let mut capture = disk.begin();
        let setups = BTreeMap::from(
            [FIRST, SECOND].map(|device| (device, Setup::new(device, &file.clone().into(), settings()))),
        );
        let boards: Vec<Channels> = setups.values().map(|setup| capture.add_device(setup, &[], 0).unwrap()).collect();
        capture.flush().unwrap();
        let (mut ends, mut rows) = (vec![capture.bytes() as usize], BTreeMap::new());
        let mut decoders = [(); 2].map(|()| Rows::default());
        for frames in frames.chunks(8) {
            for ((channels, device), decoder) in boards.iter().zip(setups.keys()).zip(&mut decoders) {
                let mut segment = Segment::default();
                segment.push(&frames.concat(), Some(BEGIN));
                capture.link(*channels, &segment, BEGIN.utc_ns).unwrap();
                if let Some(hello) = link_bytes::last_hello(&segment.bytes) {
                    capture.set_hello(*device, hello);
                }
                for scan in decoder.take(&segment) {
                    rows.insert((*device, scan.sequence), (scan, ends.len()));
                }
            }
            capture.flush().unwrap();
            ends.push(capture.bytes() as usize);
        }
        assert_eq!(rows.len(), 2 * frames.len());
        capture.finish().unwrap();
        let bytes = disk.bytes();
        ends.push(bytes.len());
        Self { bytes, ends, rows, setups }
    }

    /// Reads `damaged`, in which the bytes of `hit` differ, and gives how many rows are missing: some of
    /// those in the regions that were hit, while all others are there, bit for bit, with their settings.
    fn lost(&self, damaged: &[u8], hit: std::ops::Range<usize>, what: &str) -> usize {
        let region = |at: usize| self.ends.partition_point(|end| *end <= at);
        let hit = region(hit.start)..=region(hit.end - 1);
        let mut reader = CaptureReader::new(Path::new("memory"), io::Cursor::new(damaged)).unwrap();
        let mut segment = Segment::default();
        let (mut setups, mut decoders) = (BTreeMap::new(), BTreeMap::<_, Rows>::new());
        let mut found = BTreeMap::new();
        while let Some(entry) = reader.next(&mut segment).unwrap() {
            match entry {
                Entry::Setup(setup) => drop(setups.insert(setup.device, setup)),
                Entry::Note { .. } => panic!("{what}: a note that nobody wrote"),
                Entry::Hello { device, .. } => drop(decoders.entry(device).or_default().take(&segment)),
                Entry::Link { device, .. } => {
                    let device = device.unwrap_or_else(|| panic!("{what}: taken for the bytes of a port"));
                    assert!(setups.contains_key(&device), "{what}: bytes ahead of their settings");
                    for scan in decoders.entry(device).or_default().take(&segment) {
                        let before = found.insert((device, scan.sequence), scan);
                        assert!(before.is_none(), "{what}: a scan came twice");
                    }
                }
            }
        }
        assert!(setups.values().all(|setup| **setup == self.setups[&setup.device]), "{what}: other settings");
        for (key, scan) in &found {
            assert!(self.rows.get(key).is_some_and(|(written, _)| written == scan), "{what}: {key:?} is another");
        }
        let lost: Vec<_> = self.rows.iter().filter(|(key, _)| !found.contains_key(key)).collect();
        for (key, (_, region)) in &lost {
            assert!(hit.contains(region), "{what}: {key:?} is lost from region {region}, not {hit:?}");
        }
        let end = reader.end();
        assert!(end.has_loss(), "{what}: nothing is told: {end:?}");
        assert!(end.damaged_records == 0 || end.lost_bytes > 0, "{what}: damage of no bytes: {end:?}");
        lost.len()
    }
}

#[derive(Default)]
struct Rows {
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    schedule: Option<Schedule>,
}

impl Rows {
    fn take(&mut self, segment: &Segment) -> Vec<RawScan> {
        let (mut bytes, mut rows) = (&segment.bytes[..], Vec::new());
        while let Some(message) = self.decoder.next::<Message<'_>>(&mut bytes) {
            match message {
                Ok(Message::Hello(hello)) => self.schedule = Some(hello.schedule),
                Ok(Message::Batch(batch)) => {
                    if let Some(schedule) = &self.schedule {
                        rows.extend(batch.scans(schedule).unwrap());
                    }
                }
                _ => {}
            }
        }
        rows
    }
}

/// Every byte of all chunks in turn, and many of what stands ahead of them and behind: one bit, all bits, or zero.
#[test]
fn a_changed_byte_costs_the_chunk_it_is_in() {
    let whole = Chunked::new(3);
    let a_chunk = whole.rows.len() / 3;
    let (begin, index) = (whole.ends[0], whole.ends[3]);
    let (mut tried, mut lost, mut costly) = (0, 0, 0);
    for at in (0..begin).step_by(2).chain(begin..index).chain((index..whole.bytes.len()).step_by(7)) {
        let mask = [1 << (at / 6 % 8), 0xff, whole.bytes[at]][at % 3];
        if mask == 0 {
            continue;
        }
        let mut damaged = whole.bytes.clone();
        damaged[at] ^= mask;
        let rows = whole.lost(&damaged, at..at + 1, &format!("byte {at} ^ {mask:#04x}"));
        assert!(rows <= a_chunk, "byte {at} ^ {mask:#04x} costs {rows} rows");
        (tried, lost, costly) = (tried + 1, lost + rows, costly + usize::from(rows > 0));
    }
    let each = lost as f64 / costly as f64;
    println!("{tried} bytes changed, one at a time: {costly} cost {each:.1} rows each, of {a_chunk} in a chunk");
    // The others are copies, indexes, and what says what the file is.
    assert!(costly > tried / 10 && costly < tried / 2, "{costly} of {tried}");
}

/// Sectors that a disk could not keep, lengths that lie, and holes.
#[test]
fn damage_of_any_kind_stays_in_its_place() {
    let whole = Chunked::new(12);
    let seed = 13;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let sector = 512;
    for begin in (0..whole.bytes.len()).step_by(sector / 4) {
        let hit = begin..(begin + sector).min(whole.bytes.len());
        for kind in ["zeros", "ones", "noise"] {
            let mut damaged = whole.bytes.clone();
            match kind {
                "zeros" => damaged[hit.clone()].fill(0),
                "ones" => damaged[hit.clone()].fill(0xff),
                _ => random.fill_bytes(&mut damaged[hit.clone()]),
            }
            whole.lost(&damaged, hit.clone(), &format!("{kind} in {hit:?}, seed {seed}"));
        }
    }
    // Each record outside chunks has its length behind its opcode.
    let mut at = mcap::MAGIC.len();
    while at + 9 < whole.bytes.len() - mcap::MAGIC.len() {
        let length = u64::from_le_bytes(whole.bytes[at + 1..at + 9].try_into().unwrap());
        for lie in [0, length - 1, length + 1, length + 256, 1 << 20, 1 << 40, u64::MAX] {
            let mut damaged = whole.bytes.clone();
            damaged[at + 1..at + 9].copy_from_slice(&lie.to_le_bytes());
            whole.lost(&damaged, at..at + 9, &format!("record at {at}: length {lie} for {length}"));
        }
        at += 9 + length as usize;
    }
    assert_eq!(at, whole.bytes.len() - mcap::MAGIC.len());
    for round in 0..1000 {
        let begin = random.random_range(0..whole.bytes.len());
        let hit = begin..random.random_range(begin + 1..whole.bytes.len().min(begin + 1000) + 1);
        let mut damaged = whole.bytes.clone();
        let what = if round % 2 == 0 { "cut out" } else { "put in" };
        if round % 2 == 0 {
            damaged.drain(hit.clone());
        } else {
            let mut noise = vec![0; hit.len()];
            random.fill_bytes(&mut noise);
            damaged.splice(begin..begin, noise);
        }
        whole.lost(&damaged, hit.clone(), &format!("{hit:?} {what}, seed {seed}, round {round}"));
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
