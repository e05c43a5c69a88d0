//! Fuzz targets: what strangers can send to slitpose, and what must hold whatever they send.
//!
//! A [`Target`] takes bytes and panics if slitpose breaks one of its invariants. The same functions run under libFuzzer
//! (`tests/fuzz/libfuzzer`) and in the test of this crate, over the corpora in `tests/fuzz/corpus` and over mutations of
//! them. `tests/fuzz/README.md` has the commands and what was found.

mod board;
mod files;
mod head;
#[cfg(feature = "host")]
mod host;
pub mod wire;

/// A function of bytes from strangers.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Also that of the folder with its corpus.
    pub name: &'static str,
    /// Mutations of the corpus in the smoke test: a second or two of them.
    pub smoke: usize,
    /// Panics if an invariant does not hold.
    pub run: fn(&[u8]),
}

/// All targets.
pub const TARGETS: &[Target] = &[
    Target { name: "board", smoke: 1000, run: board::any_link_and_any_fault },
    #[cfg(feature = "host")]
    Target { name: "calibration", smoke: 200, run: host::calibration },
    #[cfg(feature = "host")]
    Target { name: "capture", smoke: 1000, run: host::capture },
    #[cfg(feature = "host")]
    Target { name: "configuration", smoke: 100, run: host::configuration },
    #[cfg(feature = "host")]
    Target { name: "datagram", smoke: 4000, run: host::datagram },
    Target { name: "decoder", smoke: 2000, run: wire::decoder },
    Target { name: "head", smoke: 1000, run: head::head },
    #[cfg(feature = "host")]
    Target { name: "http", smoke: 4000, run: host::http },
    #[cfg(feature = "host")]
    Target { name: "page", smoke: 4000, run: host::page },
    #[cfg(feature = "host")]
    Target { name: "pipeline", smoke: 100, run: host::hostile_board },
    Target { name: "scene", smoke: 300, run: files::scene },
    Target { name: "table", smoke: 1000, run: files::table },
];

/// Runs the target of this name.
pub fn run(name: &str, bytes: &[u8]) {
    let target = TARGETS.iter().find(|target| target.name == name).expect("a target of TARGETS");
    (target.run)(bytes);
}
