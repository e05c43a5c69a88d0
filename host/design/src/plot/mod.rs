//! Pictures, as SVG.
//!
//! [`Canvas`] draws lines, areas and labels; [`Chart`] draws curves over axes on a canvas;
//! [`scene_picture`] and [`cell_picture`] draw a sensor head. A canvas has its origin at the top
//! left, y down, in pixels at 96 per inch; pictures of things are in millimetres and degrees.

mod canvas;
mod chart;
mod close_up;
mod heat;
mod scene;
mod shape;
mod strips;
mod style;

pub use canvas::{Anchor, Canvas};
pub(crate) use canvas::{Stroke, TextStyle};
pub(crate) use chart::curve;
pub use chart::{Axis, Chart, Curve, CurveStyle, Note, Scale};
pub use close_up::cell_picture;
pub(crate) use heat::{Heat, heat_picture};
pub use scene::scene_picture;
pub use shape::{MaskFrame, mask_half_extents_m};
pub use style::PlotError;
pub(crate) use style::three_digits;
pub use style::{Colour, SOFT_INK, cell_colour};

#[cfg(test)]
mod tests;
