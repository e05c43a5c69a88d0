//! Pictures, as SVG.
//!
//! [`Canvas`] draws lines, areas and labels; [`Chart`] draws curves over axes on a canvas;
//! [`scene_picture`] and [`cell_picture`] draw a sensor head. A canvas has its origin at the top
//! left, y down, in pixels at 96 per inch; pictures of things are in millimetres and degrees.

mod canvas;
mod chart;
mod close_up;
mod heat;
mod label;
mod palette;
mod projection;
mod scene;
mod size;
mod strips;
mod ticks;

pub use canvas::{Anchor, Canvas};
pub(crate) use canvas::{Stroke, TextStyle};
pub use chart::{Axis, Chart, Curve, CurveStyle, Note, Scale};
pub use close_up::cell_picture;
pub(crate) use heat::{Heat, heat_picture};
pub use palette::{Colour, SOFT_INK, cell_colour};
pub use scene::scene_picture;
pub use size::PlotError;
pub(crate) use ticks::three_digits;

#[cfg(test)]
mod tests;
