//! Between counts and currents: the one place where board and optics meet.
//!
//! [`Timing`] turns a scene's lighting and electronics into the schedule a board runs;
//! [`settling`] says what a first-order front end makes of light that is switched; [`noise`] what
//! its noise does to a lit-minus-dark current; [`Stage`] converts scans.

mod noise;
mod settling;
mod stage;
mod timing;

pub use noise::ROOM_TEMPERATURE_K;
pub use settling::Settling;
pub use stage::Stage;
pub use timing::{TICK_HZ, TimingError, configuration};
