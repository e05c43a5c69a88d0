//! The columns that hold a pose: `id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad`.

use std::f64::consts::TAU;

use glam::DVec3;
use slitpose_model::Pose;

use super::reader::{Column, Row, TableError, TableReader};

/// Names of the six columns of a pose.
pub const POSE_COLUMNS: [&str; 6] = ["tx_mm", "ty_mm", "tz_mm", "rx_rad", "ry_rad", "rz_rad"];

/// A translation beyond this is a slip of units, not a pose: 1000 km.
const LONGEST_MM: f64 = 1e9;

/// A rotation vector beyond this has lost its angle to rounding.
const MOST_RAD: f64 = 1e6;

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

    /// The row's pose as an instrument reports it: rotations of more than a turn are refused.
    pub fn reported_pose(&self, row: &Row<'_>) -> Result<Pose, TableError> {
        self.pose_within(row, TAU, "radians, at most a turn of 6.28; are these degrees?")
    }

    /// The row's pose.
    pub fn pose(&self, row: &Row<'_>) -> Result<Pose, TableError> {
        self.pose_within(row, MOST_RAD, "radians, at most 1e6")
    }

    fn pose_within(&self, row: &Row<'_>, most_rad: f64, rotations: &'static str) -> Result<Pose, TableError> {
        let mut numbers = [0.0; 6];
        for (index, (number, column)) in numbers.iter_mut().zip(self.components).enumerate() {
            *number = row.number(column)?;
            if index < 3 && number.abs() > LONGEST_MM {
                return Err(row.out_of_range(column, *number, "millimetres, at most 1e9"));
            }
            if index >= 3 && number.abs() > most_rad {
                return Err(row.out_of_range(column, *number, rotations));
            }
        }
        let [tx, ty, tz, rx, ry, rz] = numbers;
        Ok(Pose::from_vectors(DVec3::new(tx, ty, tz) * 1e-3, DVec3::new(rx, ry, rz)))
    }
}
