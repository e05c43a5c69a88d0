//! Parquet: a typed column for each of CSV, and for what CSV lacks: velocities, filtered poses and true poses.

use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::{Compression, Encoding, LogicalType, Repetition, ZstdLevel};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type};
use slitpose_head::table::{SOLUTION_COLUMNS, SolutionRow};
use slitpose_model::{AXES, Pose, TwistEstimate};

use super::{Accounts, Sink};
use slitpose_tracking::pipeline::Record;

/// Rows that are held until they are written: some 30 MB.
const GROUP: usize = 1 << 16;

const INTEGERS: [&str; 6] =
    ["seq", "iterations", "cells_used", "host_monotonic_ns", "host_utc_ns", "host_uncertainty_ns"];
const WORDS: [&str; 6] = ["status", "reason", "verified", "free_directions", "excluded_cells", "device"];
/// Those of `SolutionRow::numbers`.
const SOLUTION_NUMBERS: usize = 14;

/// Values of a column that are not written yet; cells may be empty.
struct Column<T: DataType> {
    name: String,
    values: Vec<T::T>,
    /// Of each row, 1 with a value and 0 without.
    levels: Vec<i16>,
}

impl<T: DataType> Column<T> {
    fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), values: Vec::new(), levels: Vec::new() }
    }

    fn push(&mut self, value: Option<T::T>) {
        self.levels.push(value.is_some().into());
        self.values.extend(value);
    }

    fn schema(&self, meaning: Option<LogicalType>) -> Result<Arc<Type>, ParquetError> {
        let column = Type::primitive_type_builder(&self.name, T::get_physical_type());
        Ok(Arc::new(column.with_repetition(Repetition::OPTIONAL).with_logical_type(meaning).build()?))
    }

    fn write(&mut self, group: &mut SerializedRowGroupWriter<'_, impl Write + Send>) -> Result<(), ParquetError> {
        if let Some(mut writer) = group.next_column()? {
            writer.typed::<T>().write_batch(&self.values, Some(&self.levels), None)?;
            writer.close()?;
        }
        self.values.clear();
        self.levels.clear();
        Ok(())
    }
}

pub(super) struct Parquet<W: Write + Send> {
    output: Output<W>,
    rows: usize,
    integers: [Column<Int64Type>; INTEGERS.len()],
    numbers: Vec<Column<DoubleType>>,
    words: [Column<ByteArrayType>; WORDS.len()],
    simulated: Column<BoolType>,
}

/// The file begins with the first rows, or at its end.
enum Output<W: Write + Send> {
    Waiting(Option<W>),
    Begun(SerializedFileWriter<W>),
}

impl<W: Write + Send> Parquet<W> {
    pub(super) fn new(output: W) -> Self {
        Self {
            output: Output::Waiting(Some(output)),
            rows: 0,
            integers: INTEGERS.map(Column::new),
            numbers: number_names().map(Column::new).collect(),
            words: WORDS.map(Column::new),
            simulated: Column::new("simulated"),
        }
    }

    fn push(&mut self, record: &Record) {
        let row = SolutionRow::of(&record.solution);
        let time = record.host_time;
        // Times and counts stay far below 2⁶³.
        let integers = [
            Some(record.sequence),
            Some(row.iterations as u64),
            Some(row.cells_used as u64),
            time.map(|time| time.monotonic_ns),
            time.map(|time| time.utc_ns),
            time.map(|time| time.uncertainty_ns),
        ];
        for (column, value) in self.integers.iter_mut().zip(integers) {
            column.push(value.map(|value| value as i64));
        }
        let filtered = record.filtered;
        let estimate = filtered.map(|filtered| filtered.estimate);
        let numbers = std::iter::once(Some(record.device_time_s))
            .chain(row.numbers)
            .chain(motion(record.twist))
            .chain(pose(estimate.map(|estimate| estimate.pose)))
            .chain(scaled(estimate.map(|estimate| estimate.sigma())))
            .chain(pose(record.truth));
        for (column, value) in self.numbers.iter_mut().zip(numbers) {
            column.push(value);
        }
        let device = record.device.to_string();
        let words = [row.status, row.reason, row.verified, &row.free_directions, &row.excluded_cells, &device];
        for (column, word) in self.words.iter_mut().zip(words) {
            column.push((!word.is_empty()).then(|| ByteArray::from(word)));
        }
        self.simulated.push(Some(record.simulated));
        self.rows += 1;
    }

    fn begin(&self, output: W) -> Result<SerializedFileWriter<W>, ParquetError> {
        let mut columns = Vec::new();
        // Numbers that hardly repeat, byte by byte: half the size of dictionaries.
        let mut properties = WriterProperties::builder()
            .set_created_by(concat!("slitpose ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_compression(Compression::ZSTD(ZstdLevel::default()));
        let mut encoded = |name: &str, encoding| {
            let column = ColumnPath::from(name);
            properties = std::mem::take(&mut properties)
                .set_column_dictionary_enabled(column.clone(), false)
                .set_column_encoding(column, encoding);
        };
        for column in &self.integers {
            columns.push(column.schema(None)?);
            encoded(&column.name, Encoding::DELTA_BINARY_PACKED);
        }
        for column in &self.numbers {
            columns.push(column.schema(None)?);
            encoded(&column.name, Encoding::BYTE_STREAM_SPLIT);
        }
        for column in &self.words {
            columns.push(column.schema(Some(LogicalType::String))?);
        }
        columns.push(self.simulated.schema(None)?);
        let schema = Type::group_type_builder("poses").with_fields(columns).build()?;
        SerializedFileWriter::new(output, Arc::new(schema), Arc::new(properties.build()))
    }

    fn write(&mut self) -> Result<(), ParquetError> {
        if let Output::Waiting(output) = &mut self.output
            && let Some(output) = output.take()
        {
            self.output = Output::Begun(self.begin(output)?);
        }
        let Output::Begun(writer) = &mut self.output else { return Ok(()) };
        if self.rows == 0 {
            return Ok(());
        }
        let mut group = writer.next_row_group()?;
        self.integers.iter_mut().try_for_each(|column| column.write(&mut group))?;
        self.numbers.iter_mut().try_for_each(|column| column.write(&mut group))?;
        self.words.iter_mut().try_for_each(|column| column.write(&mut group))?;
        self.simulated.write(&mut group)?;
        group.close()?;
        self.rows = 0;
        Ok(())
    }
}

impl<W: Write + Send> Sink for Parquet<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        self.push(record);
        if self.rows >= GROUP { self.write().map_err(system) } else { Ok(()) }
    }

    fn finish(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.write().map_err(system)?;
        if let Output::Begun(writer) = &mut self.output {
            writer.finish().map_err(system)?;
            writer.inner_mut().flush()?;
        }
        Ok(())
    }
}

/// The system's error, if it is one.
fn system(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(source) => match source.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(source) => io::Error::other(source),
        },
        error => io::Error::other(error),
    }
}

fn number_names() -> impl Iterator<Item = String> {
    let pose = |prefix: &'static str| {
        AXES.into_iter().map(move |axis| format!("{prefix}{axis}_{}", if axis.starts_with('t') { "mm" } else { "rad" }))
    };
    let motion = |prefix: &'static str| {
        let axes = ["vx", "vy", "vz", "wx", "wy", "wz"].into_iter();
        axes.map(move |axis| format!("{prefix}{axis}_{}", if axis.starts_with('v') { "m_per_s" } else { "rad_per_s" }))
    };
    std::iter::once("device_time_s".to_owned())
        .chain(SOLUTION_COLUMNS[1..=SOLUTION_NUMBERS].iter().map(|&name| name.to_owned()))
        .chain(motion(""))
        .chain(motion("sigma_"))
        .chain(pose("filtered_"))
        .chain(pose("filtered_sigma_"))
        .chain(pose("truth_"))
}

/// Translations in millimetres, rotation vectors in radians.
fn pose(pose: Option<Pose>) -> [Option<f64>; 6] {
    scaled(pose.map(|pose| {
        let (t, r) = (pose.translation_m, pose.rotation_rad());
        [t.x, t.y, t.z, r.x, r.y, r.z]
    }))
}

fn scaled(values: Option<[f64; 6]>) -> [Option<f64>; 6] {
    std::array::from_fn(|axis| values.map(|values| if axis < 3 { values[axis] * 1e3 } else { values[axis] }))
}

fn motion(estimate: Option<TwistEstimate>) -> [Option<f64>; 12] {
    std::array::from_fn(|k| {
        let TwistEstimate { twist, covariance } = estimate?;
        Some(match k {
            0..3 => twist.linear_m_per_s[k],
            3..6 => twist.angular_rad_per_s[k - 3],
            _ => covariance[k - 6][k - 6].sqrt(),
        })
    })
}
