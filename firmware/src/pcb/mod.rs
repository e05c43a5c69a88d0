//! The board that the image is made for: a NUCLEO-G474RE with the analogue part beside it.
//!
//! [`pins`] is the wiring table, [`wiring`] what it means for configurations: cells, level lines, and how far emitters
//! may be driven.
//! [`frame_plan`] turns a configuration into settings of timers, converters and DMA.
//! The defaults are the configuration, scaling and queue that the board starts with.

pub mod frame_plan;
pub mod pins;
pub mod wiring;

use slitpose_protocol::{AdcScaling, Configuration, EmitterSet, Exposure, Level, MAX_CELLS, Schedule};

use crate::board::check;
use crate::collector::BATCH_SCANS;
use crate::queue::HEADER_BYTES;
use frame_plan::FramePlan;

/// Whether this board can run `configuration`.
pub fn can_run(configuration: &Configuration) -> bool {
    check(configuration, TICK_HZ).is_ok() && FramePlan::new(configuration).is_ok()
}

/// Device ticks a second: the MCU's clock.
pub const TICK_HZ: u32 = 170_000_000;

/// Bytes of the queue of packets for the link: 100 ms of the default configuration.
pub const QUEUE_BYTES: usize = 25 * 1024;

// 100 ms at 4 kHz are 400 scans or 100 batches. A packet of four scans of six cells, lit
// and dark, has 4 · 6 · 8 = 192 bytes of samples; around them at most 1 (kind), 3
// (configuration), 10 (sequence), 10 (tick), 1 + 6 · 3 (levels) and 2 (length) bytes, 4 of
// checksum and 2 of framing: 243 bytes, and the queue's own header.
const PACKET_BYTES: usize = BATCH_SCANS * 6 * 8 + 1 + 3 + 10 + 10 + (1 + 6 * 3) + 2 + 4 + 2;
const _: () = assert!(QUEUE_BYTES >= 400 / BATCH_SCANS * (PACKET_BYTES + HEADER_BYTES));

/// Six cells in three slots of opposite pairs and a dark one, 4 000 frames a second, four
/// conversions a word, nominal levels, in ticks of [`TICK_HZ`].
///
/// | | ticks | from |
/// |---|---|---|
/// | settling | 2 210 | 13 µs: 9.6 time constants of a front end of 1.36 µs |
/// | conversion | 148 | 24.5 + 12.5 cycles of the converters' 42.5 MHz clock |
/// | slot | 5 800 | settling and 24 conversions take 5 762; 38 ticks in hand |
/// | frame | 42 500 | four slots take 23 200; the rest is idle |
pub fn default_configuration() -> Configuration {
    let slots = [EmitterSet::of(&[0, 3]), EmitterSet::of(&[1, 4]), EmitterSet::of(&[2, 5]), EmitterSet::DARK];
    Configuration {
        schedule: Schedule {
            tick_hz: TICK_HZ,
            frame_ticks: 42_500,
            slots: slots.into_iter().collect(),
            slot_ticks: 5_800,
            settling_ticks: 2_210,
            conversion_ticks: 148,
            oversampling: 4,
            cells: 6,
        },
        levels: [Level::NOMINAL; MAX_CELLS].into_iter().take(6).collect(),
        exposure: Exposure::Fixed,
    }
}

/// Scaling of the board's own front end, unless another full scale is stored on it: 10 µA
/// from the code at zero current, 64 codes below the top, down to code 0. The last 32 codes,
/// 26 mV, count as saturated: an amplifier does not swing to the very end of its supply.
pub fn default_scaling() -> AdcScaling {
    let zero_code = 4095.0 - 64.0;
    AdcScaling { zero_code, amperes_per_code: -FULL_SCALE_A / zero_code, bits: 12, saturation_code: 32 }
}

/// Photocurrent of an electrode at code 0, in amperes.
const FULL_SCALE_A: f64 = 10e-6;

#[cfg(test)]
mod tests {
    use slitpose_protocol::{Batch, MAX_MESSAGE_BYTES, Message, encode};

    use super::*;

    /// By the table of the analogue front end (README.md): the reference at code 4031, 10 µA at code 0.
    #[test]
    fn the_default_scaling_is_that_of_the_front_end() {
        let AdcScaling { zero_code, amperes_per_code, bits, saturation_code } = default_scaling();
        assert_eq!((zero_code, bits, saturation_code), (4031.0, 12, 32));
        assert!((amperes_per_code + 2.480774e-9).abs() < 1e-15, "{amperes_per_code}");
    }

    #[test]
    fn the_longest_default_packet_takes_the_bytes_the_queue_counts_on() {
        let samples = [0xff; BATCH_SCANS * 6 * 8];
        let batch = Message::Batch(Batch {
            configuration: u16::MAX,
            sequence: u64::MAX,
            tick: u64::MAX,
            levels: [Level(u16::MAX); 6].into_iter().collect(),
            samples: &samples,
        });
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        assert_eq!(encode(&batch, &mut buffer).unwrap().len(), PACKET_BYTES);
    }
}
