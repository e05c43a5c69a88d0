//! Tables in and out: CSV with a header row, columns found by name.
//!
//! Reading ignores column order and extra columns; every error names file, row, column,
//! the text that stands there and what to do. Numbers are written so that they read back to the
//! same bits. [`Output`] writes the result of every command.

mod output;
mod reader;
mod writer;

use std::f64::consts::{PI, TAU};

use glam::DVec3;
pub use output::{CAPTURE_MAGIC, Output, OutputError, Replace, is_capture, refuse_twice};
pub use reader::{Column, Row, Rows, TableError, TableReader};
use slitpose_model::{Pair, Pose};
pub use writer::{TableRows, TableWriter};

use crate::finding::Finding;
use crate::scene_file::Workspace;

/// Where a table keeps the two currents of each cell.
#[derive(Clone, Debug)]
pub struct CurrentColumns {
    cells: Vec<[Column; 2]>,
}

impl CurrentColumns {
    /// Finds the columns of all cells by name.
    pub fn find(table: &TableReader, cells: usize) -> Result<Self, TableError> {
        let pair =
            |cell: usize| Ok([table.column(&format!("i_x1_{cell}_a"))?, table.column(&format!("i_x2_{cell}_a"))?]);
        Ok(Self { cells: (0..cells).map(pair).collect::<Result<_, _>>()? })
    }

    /// The currents of one cell in a row.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn pair(&self, row: &Row<'_>, cell: usize) -> Result<Pair<f64>, TableError> {
        let [i_x1, i_x2] = self.cells[cell];
        Ok(Pair { i_x1_a: row.number(i_x1)?, i_x2_a: row.number(i_x2)? })
    }
}

/// Names of the six columns of a pose.
pub const POSE_COLUMNS: [&str; 6] = ["tx_mm", "ty_mm", "tz_mm", "rx_rad", "ry_rad", "rz_rad"];

/// A line of each of `rows`, for people: columns are as wide as they need to be, and numbers end at one place.
pub fn aligned(rows: &[Vec<String>], is_number: impl Fn(usize) -> bool) -> impl Iterator<Item = String> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let length = |row: &Vec<String>, column| row.get(column).map_or(0, |field: &String| field.chars().count());
    let widths: Vec<usize> =
        (0..columns).map(|column| rows.iter().map(|row| length(row, column)).max().unwrap_or(0)).collect();
    rows.iter().map(move |row| {
        let fields = row.iter().zip(&widths).enumerate().map(|(column, (field, width))| {
            if is_number(column) { format!("{field:>width$}") } else { format!("{field:<width$}") }
        });
        fields.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    })
}

/// A translation beyond this is a slip of units, not a pose: 1000 km.
const MAX_MM: f64 = 1e9;

/// Half a turn as tables round it, relative.
const ROUNDING: f64 = 1e-3;

/// Share of the workspace that translations leave unused only if they are metres, or the tool only turns.
const TINY: f64 = 2e-3;

/// Where a table keeps its poses.
#[derive(Clone, Copy, Debug)]
pub struct PoseColumns {
    id: Column,
    components: [Column; 6],
}

impl PoseColumns {
    /// Finds the columns by name.
    pub fn find(table: &TableReader) -> Result<Self, TableError> {
        Self::keyed(table, "id")
    }

    /// Finds the columns by name, in a table whose rows are told apart by the column `key`.
    pub fn keyed(table: &TableReader, key: &str) -> Result<Self, TableError> {
        let id = table.column(key)?;
        let mut components = [id; 6];
        for (column, name) in components.iter_mut().zip(POSE_COLUMNS) {
            *column = table.column(name)?;
        }
        Ok(Self { id, components })
    }

    /// The first column of the pose.
    pub fn first(&self) -> Column {
        self.components[0]
    }

    /// The row's identifier, of any kind.
    pub fn id<'a>(&self, row: &Row<'a>) -> &'a str {
        row.text(self.id)
    }

    /// The row's pose.
    pub fn pose(&self, row: &Row<'_>) -> Result<Pose, TableError> {
        PoseSizes::default().pose(self, row)
    }
}

/// The least and the greatest number of each column of poses: whether they can be millimetres and radians.
#[derive(Clone, Copy, Debug)]
pub struct PoseSizes {
    extremes: [[(f64, u64); 2]; 6],
}

impl Default for PoseSizes {
    fn default() -> Self {
        Self { extremes: [[(f64::INFINITY, 0), (f64::NEG_INFINITY, 0)]; 6] }
    }
}

impl PoseSizes {
    /// The pose of a row, whose numbers are counted in.
    pub fn pose(&mut self, columns: &PoseColumns, row: &Row<'_>) -> Result<Pose, TableError> {
        let mut numbers = [0.0; 6];
        for (index, (number, column)) in numbers.iter_mut().zip(columns.components).enumerate() {
            *number = row.number(column)?;
            if index < 3 && number.abs() > MAX_MM {
                return Err(row.out_of_range(column, *number, "millimetres, at most 1e9"));
            }
            if index >= 3 && number.abs() > TAU {
                return Err(row.out_of_range(
                    column,
                    *number,
                    "the rotation vector in radians, at most a turn of 6.28; are these degrees?",
                ));
            }
            self.include(index, [(*number, row.number); 2]);
        }
        let [tx, ty, tz, rx, ry, rz] = numbers;
        Ok(Pose::from_vectors(DVec3::new(tx, ty, tz) * 1e-3, DVec3::new(rx, ry, rz)))
    }

    /// Counts the rows of `other` in.
    pub fn merge(&mut self, other: &Self) {
        other.extremes.into_iter().enumerate().for_each(|(index, extremes)| self.include(index, extremes));
    }

    fn include(&mut self, index: usize, [least, greatest]: [(f64, u64); 2]) {
        let [low, high] = &mut self.extremes[index];
        if least.0 < low.0 {
            *low = least;
        }
        if greatest.0 > high.0 {
            *high = greatest;
        }
    }

    /// The number of column `index` that is farthest from zero, and its row.
    fn largest(&self, index: usize) -> (f64, u64) {
        let [low, high] = self.extremes[index];
        if low.0.abs() > high.0.abs() { low } else { high }
    }

    /// What makes other units likely in the table `file` of poses for a head with this workspace, if anything does: `far` is how
    /// many times as far out as that poses may lead.
    pub fn finding(&self, file: &str, workspace: &Workspace, far: f64) -> Option<Finding> {
        let (half_m, half_rad) = (workspace.half_extent_m, workspace.half_extent_rad);
        let half = [half_m.x * 1e3, half_m.y * 1e3, half_m.z * 1e3, half_rad.x, half_rad.y, half_rad.z];
        let times = |index: usize| self.largest(index).0.abs() / half[index];
        let finite = (0..6).map(|index| (index, times(index))).filter(|(_, times)| times.is_finite());
        let (farthest, times) = finite.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let turned = (3..6).find(|&index| self.largest(index).0.abs() > PI * (1.0 + ROUNDING));
        let extent = |index: usize| {
            let [low, high] = self.extremes[index];
            0.5 * (high.0 - low.0) / half[index]
        };
        // Of no extent in a workspace of none is NaN, which `max` leaves out.
        let [translations, rotations] = [0..3, 3..6].map(|axes| axes.map(extent).fold(0.0, f64::max));
        let is_tiny = translations > 0.0 && translations < TINY && (rotations == 0.0 || rotations > TINY);
        let degrees = "are these degrees? rotations are radians";
        let (index, what, next_step) = if times > far {
            let what = format!(
                "leads {times:.0} times as far out as the scene's workspace, where there may be no light and no pose"
            );
            let units = if farthest < 3 { "are these micrometres? translations are millimetres" } else { degrees };
            (farthest, what, units)
        } else if let Some(index) = turned {
            (index, "is more than half a turn, which no rotation vector takes".to_owned(), degrees)
        } else if is_tiny {
            let index = (0..3).max_by(|a, b| self.largest(*a).0.abs().total_cmp(&self.largest(*b).0.abs()))?;
            let what = format!(
                "is the largest translation, and all of them move by {translations:.0e} of the scene's workspace only"
            );
            (index, what, "are these metres? translations are millimetres")
        } else {
            return None;
        };
        let (value, row) = self.largest(index);
        let place = format!("{file}, row {row}, column `{}`", POSE_COLUMNS[index]);
        Some(Finding::warning(place, format!("{value} {what}"), next_step))
    }
}
