//! Parquet: the columns of CSV, with types.

use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::{Compression, Encoding, LogicalType, Repetition, Type as PhysicalType, ZstdLevel};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type};

use super::{Accounts, Sink};
use slitpose_tracking::columns::{Column, Field, Get, Row, of_tables};
use slitpose_tracking::pipeline::Record;

/// Rows that are held until they are written: some 60 MB.
const GROUP: usize = 1 << 16;

/// The values of a column that are not written yet; rows may have none.
enum Values {
    Integer(Vec<i64>),
    Number(Vec<f64>),
    Word(Vec<ByteArray>),
    Flag(Vec<bool>),
}

struct Stored {
    name: String,
    values: Values,
    /// Of each row, 1 with a value and 0 without.
    levels: Vec<i16>,
}

impl Stored {
    fn of(column: &Column) -> impl Iterator<Item = Self> {
        let get = column.get;
        column.names().into_iter().map(move |name| {
            let values = match get {
                Get::Integer(_) | Get::Count(_) => Values::Integer(Vec::new()),
                Get::Flag(_) => Values::Flag(Vec::new()),
                Get::Word(..) | Get::Device(_) | Get::Directions(_) | Get::Cells(_) => Values::Word(Vec::new()),
                _ => Values::Number(Vec::new()),
            };
            Self { name, values, levels: Vec::new() }
        })
    }

    fn push(&mut self, field: Field<'_>) {
        match (&mut self.values, field) {
            // Times and counts stay far below 2⁶³.
            (Values::Integer(values), Field::Integer(Some(value))) => values.push(value as i64),
            (Values::Number(values), Field::Number(Some(value))) => values.push(value),
            (Values::Word(values), Field::Word(word)) if !word.is_empty() => values.push(ByteArray::from(word)),
            (Values::Flag(values), Field::Flag(flag)) => values.push(flag),
            _ => return self.levels.push(0),
        }
        self.levels.push(1);
    }

    /// Its type, and its encoding if that is not a dictionary: numbers that hardly repeat are stored byte by byte, in half
    /// the size.
    fn kind(&self) -> (PhysicalType, Option<LogicalType>, Option<Encoding>) {
        match self.values {
            Values::Integer(_) => (PhysicalType::INT64, None, Some(Encoding::DELTA_BINARY_PACKED)),
            Values::Number(_) => (PhysicalType::DOUBLE, None, Some(Encoding::BYTE_STREAM_SPLIT)),
            Values::Word(_) => (PhysicalType::BYTE_ARRAY, Some(LogicalType::String), None),
            Values::Flag(_) => (PhysicalType::BOOLEAN, None, None),
        }
    }

    fn write<W: Write + Send>(&mut self, group: &mut SerializedRowGroupWriter<'_, W>) -> Result<(), ParquetError> {
        fn batch<T: DataType>(
            writer: &mut SerializedColumnWriter<'_>,
            values: &mut Vec<T::T>,
            levels: &[i16],
        ) -> Result<(), ParquetError> {
            writer.typed::<T>().write_batch(values, Some(levels), None)?;
            values.clear();
            Ok(())
        }
        if let Some(mut writer) = group.next_column()? {
            match &mut self.values {
                Values::Integer(values) => batch::<Int64Type>(&mut writer, values, &self.levels)?,
                Values::Number(values) => batch::<DoubleType>(&mut writer, values, &self.levels)?,
                Values::Word(values) => batch::<ByteArrayType>(&mut writer, values, &self.levels)?,
                Values::Flag(values) => batch::<BoolType>(&mut writer, values, &self.levels)?,
            }
            writer.close()?;
        }
        self.levels.clear();
        Ok(())
    }
}

pub(super) struct Parquet<W: Write + Send> {
    output: Output<W>,
    rows: usize,
    table: Vec<&'static Column>,
    columns: Vec<Stored>,
}

/// The file begins with the first rows, or at its end.
enum Output<W: Write + Send> {
    Waiting(Option<W>),
    Begun(SerializedFileWriter<W>),
}

impl<W: Write + Send> Parquet<W> {
    pub(super) fn new(output: W) -> Self {
        let table = of_tables(true);
        let columns = table.iter().flat_map(|column| Stored::of(column)).collect();
        Self { output: Output::Waiting(Some(output)), rows: 0, table, columns }
    }

    fn begin(&self, output: W) -> Result<SerializedFileWriter<W>, ParquetError> {
        let mut fields = Vec::new();
        let mut properties = WriterProperties::builder()
            .set_created_by(concat!("slitpose ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_compression(Compression::ZSTD(ZstdLevel::default()));
        for column in &self.columns {
            let (kind, meaning, encoding) = column.kind();
            let field = Type::primitive_type_builder(&column.name, kind).with_repetition(Repetition::OPTIONAL);
            fields.push(Arc::new(field.with_logical_type(meaning).build()?));
            if let Some(encoding) = encoding {
                let path = ColumnPath::from(column.name.as_str());
                properties =
                    properties.set_column_dictionary_enabled(path.clone(), false).set_column_encoding(path, encoding);
            }
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
        let mut places = self.columns.iter_mut();
        let mut put = |field: Field<'_>| places.next().into_iter().for_each(|place| place.push(field));
        self.table.iter().for_each(|column| column.put(&Row::from(record), &mut put));
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
