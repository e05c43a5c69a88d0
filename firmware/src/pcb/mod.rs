//! The board that the image is made for: a NUCLEO-G474RE with the analogue part beside it.
//!
//! [`wiring`] is the copper: cells, level lines, and how far emitters may be driven.
//! [`frame_plan`] turns a configuration into settings of timers, converters and DMA.
//! The defaults are the configuration, scaling and queue that the board starts with.

mod defaults;
pub mod frame_plan;
pub mod wiring;

use slitpose_protocol::Configuration;

pub use defaults::{QUEUE_BYTES, TICK_HZ, default_configuration, default_scaling};

use crate::validate::check;
use frame_plan::FramePlan;

/// Whether this board can run `configuration`.
pub fn can_run(configuration: &Configuration) -> bool {
    check(configuration, TICK_HZ).is_ok() && FramePlan::new(configuration).is_ok()
}
