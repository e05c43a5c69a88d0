//! Fuzz targets: what strangers can send to slitpose, and what must hold whatever they send.
//!
//! A [`Target`] takes bytes and panics if slitpose breaks one of its invariants. The same functions run under libFuzzer
//! (`tests/fuzz/libfuzzer`) and in the test of this crate, over the corpora in `tests/fuzz/corpus` and over mutations of
//! them. `tests/fuzz/README.md` has the commands and what was found.

mod board;
#[cfg(feature = "host")]
mod capture;
mod files;
pub mod framing;
mod head;
#[cfg(feature = "host")]
mod network;
#[cfg(feature = "host")]
mod pipeline;
mod precision;
#[cfg(feature = "host")]
mod settings;
#[cfg(feature = "host")]
mod usb;
mod wire;

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
    Target { name: "board_pose", smoke: 200, run: precision::board_and_host_agree },
    #[cfg(feature = "host")]
    Target { name: "calibration", smoke: 200, run: settings::calibration },
    #[cfg(feature = "host")]
    Target { name: "capture", smoke: 1000, run: capture::capture },
    #[cfg(feature = "host")]
    Target { name: "configuration", smoke: 100, run: settings::configuration },
    #[cfg(feature = "host")]
    Target { name: "datagram", smoke: 4000, run: network::datagram },
    Target { name: "decoder", smoke: 2000, run: wire::decoder },
    Target { name: "head", smoke: 1000, run: head::head },
    #[cfg(feature = "host")]
    Target { name: "http", smoke: 4000, run: network::http },
    Target { name: "optics", smoke: 1000, run: precision::single_and_double_agree },
    #[cfg(feature = "host")]
    Target { name: "page", smoke: 4000, run: network::page },
    #[cfg(feature = "host")]
    Target { name: "pipeline", smoke: 100, run: pipeline::hostile_board },
    Target { name: "scene", smoke: 300, run: files::scene },
    Target { name: "table", smoke: 1000, run: files::table },
    #[cfg(feature = "host")]
    Target { name: "usb", smoke: 100, run: usb::hostile_host },
];

/// Runs the target of this name.
///
/// # Panics
/// If there is none, or if an invariant does not hold.
pub fn run(name: &str, bytes: &[u8]) {
    let target = TARGETS.iter().find(|target| target.name == name).expect("a target of TARGETS");
    (target.run)(bytes);
}
