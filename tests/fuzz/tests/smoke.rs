//! Each target over its corpus, and over mutations of it: what a stranger could send breaks no invariant.
//!
//! `SLITPOSE_FUZZ_FACTOR` multiplies the number of mutations, `SLITPOSE_FUZZ_SEED` chooses others.

use std::fs;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_fuzz::{TARGETS, Target};

/// Longest input: that of libFuzzer by default.
const LONGEST: usize = 4096;

fn corpus(target: &Target) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target.name);
    let mut files: Vec<_> = fs::read_dir(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.expect("an entry").path())
        .collect();
    files.sort();
    files.into_iter().map(|path| (path.clone(), fs::read(path).expect("a file"))).collect()
}

fn asked(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is no number: {text}")))
}

/// One to four changes: bits, bytes, numbers at the edge, pieces left out, doubled, or from another input.
fn mutated(corpus: &[(PathBuf, Vec<u8>)], random: &mut impl Rng) -> Vec<u8> {
    let mut bytes = corpus[random.random_range(0..corpus.len())].1.clone();
    for _ in 0..random.random_range(1..=4) {
        let (from, to) = (random.random_range(0..=bytes.len()), random.random_range(0..=bytes.len()));
        let (from, to) = (from.min(to), from.max(to));
        match random.random_range(0..7) {
            0 if from < bytes.len() => bytes[from] ^= 1 << random.random_range(0..8),
            1 if from < bytes.len() => bytes[from] = random.random(),
            2 if from < bytes.len() => {
                bytes[from] = [0, 1, 0x7f, 0x80, 0xff, b'-', b'.', b'9'][random.random_range(0..8)];
            }
            3 => drop(bytes.drain(from..to)),
            4 => {
                let piece = bytes[from..to].to_vec();
                drop(bytes.splice(from..from, piece));
            }
            5 => {
                let other = &corpus[random.random_range(0..corpus.len())].1;
                let at = random.random_range(0..=other.len());
                let piece = other[at..(at + to - from).min(other.len())].to_vec();
                drop(bytes.splice(from..to, piece));
            }
            _ => bytes.truncate(to),
        }
    }
    bytes.truncate(LONGEST.max(corpus.iter().map(|(_, bytes)| bytes.len()).max().unwrap_or(0)));
    bytes
}

fn holds(name: &str) {
    let target = TARGETS.iter().find(|target| target.name == name).expect("a target");
    let corpus = corpus(target);
    assert!(!corpus.is_empty(), "{name} has no corpus");
    for (path, bytes) in &corpus {
        assert!(catch_unwind(|| (target.run)(bytes)).is_ok(), "{} breaks an invariant", path.display());
    }
    let seed = asked("SLITPOSE_FUZZ_SEED", 1);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for number in 0..target.smoke as u64 * asked("SLITPOSE_FUZZ_FACTOR", 1) {
        let bytes = mutated(&corpus, &mut random);
        if catch_unwind(|| (target.run)(&bytes)).is_err() {
            let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{seed}-{number}"));
            fs::write(&file, &bytes).expect("room for it");
            panic!("mutation {number} of seed {seed} breaks an invariant; it is in {}", file.display());
        }
    }
}

macro_rules! targets {
    ($($name:ident)*) => {
        $(#[test]
        fn $name() {
            holds(stringify!($name));
        })*

        #[test]
        fn every_target_is_run_here() {
            assert!(TARGETS.iter().map(|target| target.name).eq([$(stringify!($name)),*]));
        }
    };
}

targets! {
    board calibration capture configuration datagram decoder head http page pipeline scene table
}
