//! Between counts and currents: the one place where board and optics meet.
//!
//! [`configuration`] turns a scene's lighting and electronics into the schedule a board runs;
//! [`Settling`] says what a first-order front end makes of light that is switched; [`Stage`] knows
//! what its noise does to a lit-minus-dark current, and converts scans.

mod noise;
mod settling;
mod stage;
mod timing;

pub use noise::ROOM_TEMPERATURE_K;
pub use settling::Settling;
pub use stage::Stage;
pub use timing::{TimingError, configuration};
