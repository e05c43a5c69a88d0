//! CSV out.

use std::io::{self, Write};

use super::output::{Output, OutputError};
use crate::foreign::printable_lines;

/// A CSV table that is written field by field.
pub struct TableWriter {
    fields: Fields<Output>,
}

/// A CSV table of which many rows come at a time.
pub struct ChunkedTable {
    output: Output,
    is_terminal: bool,
}

/// Rows of a table, written by any thread into memory for [`ChunkedTable::append`].
pub struct TableRows {
    fields: Fields<Vec<u8>>,
}

/// CSV into anything.
struct Fields<W: Write> {
    writer: csv::Writer<W>,
    number: String,
    is_terminal: bool,
}

impl<W: Write> Fields<W> {
    fn of(sink: W, is_terminal: bool) -> Self {
        // An output buffers; a second large buffer would only delay broken pipes.
        Self { writer: csv::WriterBuilder::new().from_writer(sink), number: String::new(), is_terminal }
    }

    fn text(&mut self, text: &str) -> csv::Result<()> {
        let text = if self.is_terminal { printable_lines(text) } else { text.into() };
        self.writer.write_field(&*text)
    }

    fn number(&mut self, value: f64) -> csv::Result<()> {
        use std::fmt::Write;
        self.number.clear();
        // Writing to a String cannot fail.
        let _ = write!(self.number, "{value:?}");
        self.writer.write_field(&self.number)
    }

    fn end_row(&mut self) -> csv::Result<()> {
        self.writer.write_record(None::<&[u8]>)
    }
}

impl TableWriter {
    /// Starts a table with its header row.
    pub fn new<'a>(output: Output, header: impl IntoIterator<Item = &'a str>) -> Result<Self, OutputError> {
        let is_terminal = output.is_terminal();
        let mut table = Self { fields: Fields::of(output, is_terminal) };
        for name in header {
            table.text(name)?;
        }
        table.end_row()?;
        Ok(table)
    }

    /// Adds a text field; on a terminal control characters are escaped.
    pub fn text(&mut self, text: &str) -> Result<(), OutputError> {
        let written = self.fields.text(text);
        written.map_err(|error| self.error(error))
    }

    /// Adds a number: the shortest text that reads back to the same bits.
    pub fn number(&mut self, value: f64) -> Result<(), OutputError> {
        let written = self.fields.number(value);
        written.map_err(|error| self.error(error))
    }

    /// Adds a number, or an empty field.
    pub fn optional(&mut self, value: Option<f64>) -> Result<(), OutputError> {
        match value {
            Some(value) => self.number(value),
            None => self.text(""),
        }
    }

    /// Ends the row.
    pub fn end_row(&mut self) -> Result<(), OutputError> {
        let written = self.fields.end_row();
        written.map_err(|error| self.error(error))
    }

    /// The same table, of which only whole rows are to follow.
    pub fn into_chunks(self) -> Result<ChunkedTable, OutputError> {
        let is_terminal = self.fields.is_terminal;
        let target = self.fields.writer.get_ref().target().to_owned();
        match self.fields.writer.into_inner() {
            Ok(output) => Ok(ChunkedTable { output, is_terminal }),
            Err(error) => Err(OutputError::Write { target, source: error.into_error() }),
        }
    }

    /// Ends the table; a file appears under its name now.
    pub fn finish(self) -> Result<(), OutputError> {
        let target = self.fields.writer.get_ref().target().to_owned();
        match self.fields.writer.into_inner() {
            Ok(output) => output.finish(),
            Err(error) => Err(OutputError::Write { target, source: error.into_error() }),
        }
    }

    fn error(&self, error: csv::Error) -> OutputError {
        self.fields.writer.get_ref().error(cause(error))
    }
}

impl ChunkedTable {
    /// What begins rows for [`Self::append`].
    pub fn starting(&self) -> impl Fn() -> TableRows + Sync + use<> {
        let is_terminal = self.is_terminal;
        move || TableRows { fields: Fields::of(Vec::new(), is_terminal) }
    }

    /// Adds whole rows.
    pub fn append(&mut self, rows: TableRows) -> Result<(), OutputError> {
        let text = rows.fields.writer.into_inner().map_err(|error| in_memory(error.into_error().into()))?;
        self.output.write_all(&text).map_err(|source| self.output.error(source))
    }

    /// Ends the table; a file appears under its name now.
    pub fn finish(self) -> Result<(), OutputError> {
        self.output.finish()
    }
}

impl TableRows {
    /// As [`TableWriter::text`].
    pub fn text(&mut self, text: &str) -> Result<(), OutputError> {
        self.fields.text(text).map_err(in_memory)
    }

    /// As [`TableWriter::number`].
    pub fn number(&mut self, value: f64) -> Result<(), OutputError> {
        self.fields.number(value).map_err(in_memory)
    }

    /// As [`TableWriter::optional`].
    pub fn optional(&mut self, value: Option<f64>) -> Result<(), OutputError> {
        match value {
            Some(value) => self.number(value),
            None => self.text(""),
        }
    }

    /// As [`TableWriter::end_row`].
    pub fn end_row(&mut self) -> Result<(), OutputError> {
        self.fields.end_row().map_err(in_memory)
    }
}

fn cause(error: csv::Error) -> io::Error {
    match error.into_kind() {
        csv::ErrorKind::Io(source) => source,
        // Rows of unequal length, which only a mistake in a command can write.
        other => io::Error::other(format!("{other:?}")),
    }
}

fn in_memory(error: csv::Error) -> OutputError {
    OutputError::Write { target: "memory".to_owned(), source: cause(error) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::TableReader;

    #[test]
    fn numbers_read_back_to_the_same_bits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("numbers.csv");
        let numbers = [0.1, -0.0, 1e-300, 1.0 / 3.0, f64::MAX, f64::MIN_POSITIVE, 5e-324, 1e21];
        let mut table = TableWriter::new(Output::file(&path).unwrap(), ["number", "none"]).unwrap();
        for number in numbers {
            table.number(number).unwrap();
            table.optional(None).unwrap();
            table.end_row().unwrap();
        }
        table.finish().unwrap();
        let mut table = TableReader::open(path.to_str().unwrap()).unwrap();
        let column = table.column("number").unwrap();
        for number in numbers {
            let back = table.next_row().unwrap().unwrap().number(column).unwrap();
            assert_eq!(back.to_bits(), number.to_bits(), "{number:?} became {back:?}");
        }
    }

    #[test]
    fn a_table_of_many_rows_at_a_time_is_that_of_one_row_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["rows.csv", "chunks.csv"].map(|name| folder.path().join(name));
        let numbers = [Some(0.1), None, Some(-2e-300), Some(4.0)];
        let start = |path| TableWriter::new(Output::file(path).unwrap(), ["id", "number"]).unwrap();
        let mut rows = start(&paths[0]);
        for number in numbers {
            rows.text("a, b").unwrap();
            rows.optional(number).unwrap();
            rows.end_row().unwrap();
        }
        rows.finish().unwrap();
        let mut chunks = start(&paths[1]).into_chunks().unwrap();
        let starting = chunks.starting();
        for numbers in numbers.chunks(3) {
            let mut rows = starting();
            for number in numbers {
                rows.text("a, b").unwrap();
                rows.optional(*number).unwrap();
                rows.end_row().unwrap();
            }
            chunks.append(rows).unwrap();
        }
        chunks.finish().unwrap();
        let [rows, chunks] = paths.map(|path| std::fs::read_to_string(path).unwrap());
        assert_eq!(rows, chunks);
    }

    #[test]
    fn text_with_commas_and_quotes_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text.csv");
        let mut table = TableWriter::new(Output::file(&path).unwrap(), ["id"]).unwrap();
        table.text("a, \"b\"").unwrap();
        table.end_row().unwrap();
        table.finish().unwrap();
        let mut table = TableReader::open(path.to_str().unwrap()).unwrap();
        let column = table.column("id").unwrap();
        assert_eq!(table.next_row().unwrap().unwrap().text(column), "a, \"b\"");
    }
}
