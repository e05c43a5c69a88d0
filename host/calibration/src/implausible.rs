//! What data look like instead of what they are said to be.

use slitpose_model::SceneError;
use thiserror::Error;

/// What is wrong with the data.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Implausible {
    /// A scene that cannot be computed.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A cell without light, or with too much.
    #[error(
        "{file}: cell {cell} sees no light, or more than its saturation_a, in {dark} of {rows} rows; check that currents are in amperes, its emitter and its detector, or take it out of the scene"
    )]
    Dark {
        /// The file.
        file: String,
        /// The cell.
        cell: usize,
        /// Rows without a reading.
        dark: usize,
        /// All rows.
        rows: usize,
    },
    /// Both electrodes of a cell exchanged.
    #[error(
        "{file}: the electrodes of cell {cell} look exchanged: I_X1 behaves like I_X2; exchange the columns i_x1_{cell}_a and i_x2_{cell}_a, the wires, or turn the cell's x_axis"
    )]
    Electrodes {
        /// The file.
        file: String,
        /// The cell.
        cell: usize,
    },
    /// Columns of another cell.
    #[error("{file}: the currents of cell {cell} look like those of cell {like}; exchange the columns or the wires")]
    Cells {
        /// The file.
        file: String,
        /// The cell.
        cell: usize,
        /// The cell that it looks like.
        like: usize,
    },
    /// Lengths in another unit.
    #[error(
        "{file}: tx_mm, ty_mm and tz_mm are millimetres, but are these {unit}? Then the data fit {better:.0} times as well"
    )]
    Lengths {
        /// The file.
        file: String,
        /// What they look like.
        unit: &'static str,
        /// By how much smaller the spots' distances are then.
        better: f64,
    },
    /// Rotations in another form.
    #[error(
        "{file}: rx_rad, ry_rad and rz_rad are rotation vectors in radians, but are these {form}? Then the data fit {better:.1} times as well; convert them"
    )]
    Rotations {
        /// The file.
        file: String,
        /// What they look like.
        form: String,
        /// By how much smaller the spots' distances are then.
        better: f64,
    },
    /// Many poses far from where the light has the tool.
    #[error(
        "{file}: {count} of {rows} poses are not where the light has the tool: {named}; remove rows in which the instrument had lost its marker, check that each pose is of the same instant as its currents"
    )]
    Outliers {
        /// The file.
        file: String,
        /// So many.
        count: usize,
        /// All poses.
        rows: usize,
        /// The first of them.
        named: String,
    },
    /// Axes of another order, direction or handedness, or rotations of the other sense.
    #[error(
        "{file}: the axes of the poses look exchanged or reversed: the data fit {better:.0} times as well if tx_mm, ty_mm, tz_mm become ({translation}), and rx_rad, ry_rad, rz_rad ({rotation})"
    )]
    Axes {
        /// The file.
        file: String,
        /// What the translations become.
        translation: String,
        /// What the rotation vectors become.
        rotation: String,
        /// By how much smaller the spots' distances are then.
        better: f64,
    },
    /// tool_from_base instead of base_from_tool.
    #[error(
        "{file}: the poses look inverted, the base seen from the tool; give the tool seen from the base (base_from_tool)"
    )]
    Inverted {
        /// The file.
        file: String,
    },
    /// Poses of other rows.
    #[error(
        "{file}: the poses look shifted against the currents by {rows} rows; pair each pose with the currents of its own instant"
    )]
    Shifted {
        /// The file.
        file: String,
        /// By so many rows.
        rows: i64,
    },
    /// Not this head.
    #[error(
        "{file}: the currents do not belong to this scene: spots are {found_mm:.2} mm from where it has them at the instrument's poses, tolerances explain {expected_mm:.2} mm; check the scene and its [tolerance], the frames (--frames own if the instrument has its own) and the order of the cells"
    )]
    OtherScene {
        /// The file.
        file: String,
        /// Median distance, millimetres.
        found_mm: f64,
        /// What is usual, millimetres.
        expected_mm: f64,
    },
    /// More cells in the table than in the scene.
    #[error("{file} has currents of a cell {cells}, the scene has the cells 0 to {last}; give the scene of this head", last = cells - 1)]
    MoreCells {
        /// The file.
        file: String,
        /// Cells of the scene.
        cells: usize,
    },
    /// One measurement given twice.
    #[error(
        "{file}: row {row} repeats an earlier one, currents and pose, to the last digit; a measurement that stands twice counts twice: remove one"
    )]
    Repeated {
        /// The file.
        file: String,
        /// The row, from 1.
        row: usize,
    },
    /// A tool that hardly moves.
    #[error(
        "{file}: the tool moves by {found_mm:.3} mm and turns by {found_deg:.3} degrees (rms) only, too little to tell parts apart; use the whole workspace, a third of it at least"
    )]
    LittleMotion {
        /// The file.
        file: String,
        /// Root-mean-square translation, millimetres.
        found_mm: f64,
        /// Root-mean-square rotation, degrees.
        found_deg: f64,
    },
}
