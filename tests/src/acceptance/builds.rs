//! Whether two builds of the command give the same poses, bit for bit, on one machine. Between machines
//! that is not promised: their mathematical functions round otherwise.

use std::fmt;
use std::hash::{DefaultHasher, Hasher};

use super::daemon::name_in;
use crate::process::Slitpose;

/// What a build makes of the same two seconds.
#[derive(Clone, Debug)]
pub struct Build {
    /// Where it is.
    pub path: String,
    /// A hash of what a simulated board sends.
    pub bytes: u64,
    /// A hash of its poses, as CSV.
    pub csv: u64,
    /// A hash of its poses, filtered, as NDJSON.
    pub filtered: u64,
}

impl Build {
    /// Lets `slitpose` simulate and solve.
    ///
    /// # Panics
    /// If it fails.
    pub fn of(slitpose: Slitpose) -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let bytes = name_in(folder.path(), "bytes");
        let run = |arguments: &[&str]| {
            let finished = slitpose.run(arguments);
            assert_eq!((finished.code, finished.stderr.as_str()), (0, ""), "{arguments:?}");
            finished.stdout
        };
        run(&["simulate", "--duration", "2s", "--seed", "5", "--raw", "--output", &bytes]);
        Self {
            path: slitpose.path().to_owned(),
            bytes: hash(&std::fs::read(&bytes).expect("written")),
            csv: hash(&run(&["replay", &bytes, "--format", "csv"])),
            filtered: hash(&run(&["replay", &bytes, "--format", "ndjson", "--filter", "5ms"])),
        }
    }

    /// Whether it gives what `other` gives.
    pub fn equals(&self, other: &Self) -> bool {
        (self.bytes, self.csv, self.filtered) == (other.bytes, other.csv, other.filtered)
    }
}

impl fmt::Display for Build {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, bytes, csv, filtered } = self;
        write!(f, "bytes {bytes:016x}, poses {csv:016x}, filtered poses {filtered:016x}: {path}")
    }
}

/// Of one program it is the same in each run.
fn hash(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write(bytes);
    hasher.finish()
}
