//! Parquet: a typed column for each of CSV, and for what CSV lacks.

use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::{Compression, Encoding, LogicalType, Repetition, ZstdLevel};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type};

use super::columns::{Device, Get, Getter, PoseColumn, PoseRow, columns, more_columns};
use super::{Accounts, Sink};
use slitpose_tracking::pipeline::Record;

/// Rows that are held until they are written: some 30 MB.
const GROUP: usize = 1 << 16;

/// A column, and its values that are not written yet; rows may have none.
struct Typed<T: DataType> {
    name: String,
    encoding: Option<Encoding>,
    meaning: Option<LogicalType>,
    get: Getter<Option<T::T>>,
    values: Vec<T::T>,
    /// Of each row, 1 with a value and 0 without.
    levels: Vec<i16>,
}

trait Stored<W: Write + Send> {
    fn push(&mut self, row: &PoseRow<'_>);
    fn field(&self) -> Result<Type, ParquetError>;
    fn encoding(&self) -> Option<(ColumnPath, Encoding)>;
    fn write(&mut self, group: &mut SerializedRowGroupWriter<'_, W>) -> Result<(), ParquetError>;
}

impl<T: DataType, W: Write + Send> Stored<W> for Typed<T> {
    fn push(&mut self, row: &PoseRow<'_>) {
        let value = (self.get)(row);
        self.levels.push(value.is_some().into());
        self.values.extend(value);
    }

    fn field(&self) -> Result<Type, ParquetError> {
        let field = Type::primitive_type_builder(&self.name, T::get_physical_type());
        field.with_repetition(Repetition::OPTIONAL).with_logical_type(self.meaning.clone()).build()
    }

    fn encoding(&self) -> Option<(ColumnPath, Encoding)> {
        Some((ColumnPath::from(self.name.as_str()), self.encoding?))
    }

    fn write(&mut self, group: &mut SerializedRowGroupWriter<'_, W>) -> Result<(), ParquetError> {
        if let Some(mut writer) = group.next_column()? {
            writer.typed::<T>().write_batch(&self.values, Some(&self.levels), None)?;
            writer.close()?;
        }
        self.values.clear();
        self.levels.clear();
        Ok(())
    }
}

fn typed<T: DataType, W: Write + Send>(
    name: String,
    encoding: Option<Encoding>,
    meaning: Option<LogicalType>,
    get: impl Fn(&PoseRow<'_>) -> Option<T::T> + Send + Sync + 'static,
) -> Box<dyn Stored<W> + Send> {
    Box::new(Typed::<T> { name, encoding, meaning, get: Box::new(get), values: Vec::new(), levels: Vec::new() })
}

/// Numbers that hardly repeat are stored byte by byte: half the size of dictionaries.
fn stored<W: Write + Send>((name, get): PoseColumn) -> Box<dyn Stored<W> + Send> {
    match get {
        // Times and counts stay far below 2⁶³.
        Get::Integer(get) => typed::<Int64Type, W>(name, Some(Encoding::DELTA_BINARY_PACKED), None, move |row| {
            get(row).map(|value| value as i64)
        }),
        Get::Number(get) => typed::<DoubleType, W>(name, Some(Encoding::BYTE_STREAM_SPLIT), None, get),
        Get::Word(get) => typed::<ByteArrayType, W>(name, None, Some(LogicalType::String), move |row| {
            Some(get(row)).filter(|word| !word.is_empty()).map(|word| ByteArray::from(&*word))
        }),
        Get::Flag(get) => typed::<BoolType, W>(name, None, None, move |row| Some(get(row))),
    }
}

pub(super) struct Parquet<W: Write + Send> {
    output: Output<W>,
    rows: usize,
    columns: Vec<Box<dyn Stored<W> + Send>>,
    device: Device,
}

/// The file begins with the first rows, or at its end.
enum Output<W: Write + Send> {
    Waiting(Option<W>),
    Begun(SerializedFileWriter<W>),
}

impl<W: Write + Send> Parquet<W> {
    pub(super) fn new(output: W) -> Self {
        let columns = columns().into_iter().chain(more_columns()).map(stored).collect();
        Self { output: Output::Waiting(Some(output)), rows: 0, columns, device: Device::default() }
    }

    fn begin(&self, output: W) -> Result<SerializedFileWriter<W>, ParquetError> {
        let fields = self.columns.iter().map(|column| column.field().map(Arc::new)).collect::<Result<_, _>>()?;
        let mut properties = WriterProperties::builder()
            .set_created_by(concat!("slitpose ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_compression(Compression::ZSTD(ZstdLevel::default()));
        for (path, encoding) in self.columns.iter().filter_map(|column| column.encoding()) {
            properties =
                properties.set_column_dictionary_enabled(path.clone(), false).set_column_encoding(path, encoding);
        }
        let schema = Type::group_type_builder("poses").with_fields(fields).build()?;
        SerializedFileWriter::new(output, Arc::new(schema), Arc::new(properties.build()))
    }

    fn write(&mut self) -> Result<(), ParquetError> {
        if let Output::Waiting(output) = &mut self.output
            && let Some(output) = output.take()
        {
            self.output = Output::Begun(self.begin(output)?);
        }
        let Output::Begun(writer) = &mut self.output else { return Ok(()) };
        if std::mem::take(&mut self.rows) == 0 {
            return Ok(());
        }
        let mut group = writer.next_row_group()?;
        self.columns.iter_mut().try_for_each(|column| column.write(&mut group))?;
        group.close().map(drop)
    }
}

impl<W: Write + Send> Sink for Parquet<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        let row = self.device.row(record);
        self.columns.iter_mut().for_each(|column| column.push(&row));
        self.rows += 1;
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
