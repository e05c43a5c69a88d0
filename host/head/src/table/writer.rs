//! CSV out.

use std::io::{self, Write};

use super::output::{Output, OutputError};
use crate::foreign::printable_lines;

/// A CSV table that is written field by field, or many rows at a time.
pub struct TableWriter {
    fields: Fields<Output>,
}

/// Rows of a table, written by any thread into memory for [`TableWriter::append`].
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

    /// What starts the rows for [`Self::append`].
    pub fn rows(&self) -> impl Fn() -> TableRows + Sync + use<> {
        let is_terminal = self.fields.is_terminal;
        move || TableRows { fields: Fields::of(Vec::new(), is_terminal) }
    }

    /// Adds whole rows. The writer is then another, which knows no number of fields yet.
    pub fn append(self, rows: TableRows) -> Result<Self, OutputError> {
        let is_terminal = self.fields.is_terminal;
        let target = self.fields.writer.get_ref().target().to_owned();
        let failed = |source| OutputError::Write { target, source };
        match (self.fields.writer.into_inner(), rows.fields.writer.into_inner()) {
            (Ok(mut output), Ok(text)) => {
                output.write_all(&text).map_err(failed)?;
                Ok(Self { fields: Fields::of(output, is_terminal) })
            }
            (Err(error), _) => Err(failed(error.into_error())),
            (_, Err(error)) => Err(failed(error.into_error())),
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
