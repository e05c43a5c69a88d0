//! What the tests of the whole board share.

pub mod chain;
pub mod light;
pub mod talk;

use slitpose_emulator::silicon::Silicon;

/// The variable that gives the silicon its faults: names, or `all`. Without it there are none.
const SILICON: &str = "SLITPOSE_SILICON";

/// The silicon that the tests run on.
pub fn silicon() -> Silicon {
    match std::env::var(SILICON) {
        Ok(faults) if !faults.is_empty() => faults.parse().unwrap_or_else(|error| panic!("{SILICON}: {error}")),
        _ => Silicon::default(),
    }
}
