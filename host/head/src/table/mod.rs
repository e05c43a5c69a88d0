//! Tables in and out: CSV with a header row, columns found by name.
//!
//! Reading ignores column order and extra columns; every error names file, row, column,
//! the text that stands there and what to do. Numbers are written so that they read back to the
//! same bits. [`Output`] writes the result of every command.

mod columns;
mod output;
mod reader;
mod writer;

pub use columns::{CurrentColumns, POSE_COLUMNS, PoseColumns, PoseSizes, SOLUTION_COLUMNS, SolutionRow};
pub use output::{CAPTURE_MAGIC, Output, OutputError, Replace, is_capture, refuse_twice};
pub use reader::{Column, Row, Rows, TableError, TableReader};
pub use writer::{ChunkedTable, TableRows, TableWriter};
