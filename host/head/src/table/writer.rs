//! CSV out.

use std::io;

use super::output::{Output, OutputError};
use crate::foreign::printable_lines;

/// A CSV table that is written field by field.
pub struct TableWriter {
    writer: csv::Writer<Output>,
    number: String,
    is_terminal: bool,
}

impl TableWriter {
    /// Starts a table with its header row.
    pub fn new<'a>(output: Output, header: impl IntoIterator<Item = &'a str>) -> Result<Self, OutputError> {
        let is_terminal = output.is_terminal();
        let mut table = Self {
            // `Output` buffers; a second large buffer would only delay broken pipes.
            writer: csv::WriterBuilder::new().from_writer(output),
            number: String::new(),
            is_terminal,
        };
        for name in header {
            table.text(name)?;
        }
        table.end_row()?;
        Ok(table)
    }

    /// Adds a text field; on a terminal control characters are escaped.
    pub fn text(&mut self, text: &str) -> Result<(), OutputError> {
        let text = if self.is_terminal { printable_lines(text) } else { text.into() };
        let written = self.writer.write_field(&*text);
        written.map_err(|error| self.error(error))
    }

    /// Adds a number: the shortest text that reads back to the same bits.
    pub fn number(&mut self, value: f64) -> Result<(), OutputError> {
        use std::fmt::Write;
        self.number.clear();
        // Writing to a String cannot fail.
        let _ = write!(self.number, "{value:?}");
        let written = self.writer.write_field(&self.number);
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
        let written = self.writer.write_record(None::<&[u8]>);
        written.map_err(|error| self.error(error))
    }

    /// Ends the table; a file appears under its name now.
    pub fn finish(self) -> Result<(), OutputError> {
        let target = self.writer.get_ref().target().to_owned();
        match self.writer.into_inner() {
            Ok(output) => output.finish(),
            Err(error) => Err(OutputError::Write { target, source: error.into_error() }),
        }
    }

    fn error(&self, error: csv::Error) -> OutputError {
        let source = match error.into_kind() {
            csv::ErrorKind::Io(source) => source,
            // Rows of unequal length, which only a mistake in a command can write.
            other => io::Error::other(format!("{other:?}")),
        };
        self.writer.get_ref().error(source)
    }
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
