//! Tables in and out: CSV with a header row, columns found by name.
//!
//! Reading ignores column order and extra columns; every error names file, row, column,
//! the text that stands there and what to do. Numbers are written so that they read back to the
//! same bits. [`Output`] writes the result of every command.

mod current_columns;
mod line_ends;
mod output;
mod pose_columns;
mod reader;
mod solution_columns;
mod writer;

pub use current_columns::CurrentColumns;
pub use output::{CAPTURE_MAGIC, Output, OutputError, Replace, is_capture, refuse_twice};
pub use pose_columns::{POSE_COLUMNS, PoseColumns, PoseSizes};
pub use reader::{Column, Row, Rows, TableError, TableReader};
pub use solution_columns::{SOLUTION_COLUMNS, SolutionRow};
pub use writer::{ChunkedTable, TableRows, TableWriter};
