//! One set of colours for every picture.

/// A colour as SVG writes it.
pub type Colour = &'static str;

/// Text and the axes of charts.
pub(crate) const INK: Colour = "#222222";
/// Secondary text, dimension lines.
pub const SOFT_INK: Colour = "#666666";
/// Grid lines, outlines of secondary objects.
pub(crate) const PALE: Colour = "#d4d4d4";
/// Grid lines between numbered ones.
pub(crate) const FAINT: Colour = "#ededed";
/// The tool's body.
pub(crate) const TOOL: Colour = "#9a9a9a";
/// Masks.
pub(crate) const MASK: Colour = "#3c3c3c";
/// Where a picture must warn.
pub(crate) const ALERT: Colour = "#c1121f";
/// Paper.
pub(crate) const WHITE: Colour = "#ffffff";

/// Colours of cells, in order; distinguishable with the common forms of colour blindness
/// (Okabe and Ito 2008, the yellow left out for want of contrast on white).
const CELLS: [Colour; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#5a5a5a"];

/// The colour of a cell in every picture.
pub fn cell_colour(cell: usize) -> Colour {
    CELLS[cell % CELLS.len()]
}

/// Bands of a value, ascending: lightness grows steadily, for all eyes and in print (cividis; Nuñez, Anderton, Renslow
/// 2018).
pub(crate) const BANDS: [Colour; 8] =
    ["#00224e", "#213b6e", "#4c556c", "#6c6e72", "#8e8978", "#b1a570", "#d9c55c", "#fee838"];
