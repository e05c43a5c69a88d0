//! What the tests of the whole board share.

pub mod chain;
pub mod light;
pub mod pins;
pub mod solving;
pub mod talk;
pub mod trial;
pub mod wiring;

use slitpose_emulator::faults::{Fault, Faults};

/// The variable that gives the silicon its faults: names, or `all`. Without it there are none.
const SILICON: &str = "SLITPOSE_SILICON";

/// Whether an event follows from a fault of the silicon that the tests run on.
pub fn is_of_silicon(text: &str) -> bool {
    silicon().has(Fault::HseDead) && text.contains("crystal")
}

/// Ticks by which a DMA transfer may come late: behind three others of its controller.
pub fn dma_ticks() -> u64 {
    if silicon().has(Fault::DmaLatency) { 4 * 60 } else { 0 }
}

/// Ticks by which the converters may see a trigger late: three to their clock's edge, and an eighth of a clock.
pub fn trigger_ticks() -> u64 {
    if silicon().has(Fault::TriggerPhase) { 4 } else { 0 }
}

/// The silicon that the tests run on.
pub fn silicon() -> Faults {
    match std::env::var(SILICON) {
        Ok(faults) if !faults.is_empty() => {
            Faults::of_silicon(&faults).unwrap_or_else(|error| panic!("{SILICON}: {error}"))
        }
        _ => Faults::default(),
    }
}
