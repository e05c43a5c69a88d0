//! CSV out.

use std::borrow::Cow;
use std::io::Write;

use slitpose_model::Pose;

use super::output::{Output, OutputError};
use crate::foreign::printable_lines;

/// A CSV table that is written row by row, or many rows at a time.
pub struct TableWriter {
    output: Output,
    row: TableRows,
}

/// Rows of a table, written by any thread into memory for [`TableWriter::append`].
pub struct TableRows {
    text: Vec<u8>,
    begin: usize,
    is_terminal: bool,
}

impl TableRows {
    fn starting(is_terminal: bool) -> Self {
        Self { text: Vec::new(), begin: 0, is_terminal }
    }

    /// Adds a text field; on a terminal control characters are escaped.
    pub fn text(&mut self, text: &str) {
        let text = if self.is_terminal { printable_lines(text) } else { Cow::Borrowed(text) };
        if text.bytes().any(|byte| matches!(byte, b',' | b'"' | b'\n' | b'\r')) {
            self.text.push(b'"');
            self.text.extend_from_slice(text.replace('"', "\"\"").as_bytes());
            self.text.push(b'"');
        } else {
            self.text.extend_from_slice(text.as_bytes());
        }
        self.text.push(b',');
    }

    /// Adds a number: the shortest text that reads back to the same bits.
    pub fn number(&mut self, value: f64) {
        self.text.extend_from_slice(zmij::Buffer::new().format(value).as_bytes());
        self.text.push(b',');
    }

    /// Adds a whole number.
    pub fn integer(&mut self, value: usize) {
        // Writing to memory cannot fail.
        let _ = write!(self.text, "{value},");
    }

    /// Adds a number, or an empty field.
    pub fn optional(&mut self, value: Option<f64>) {
        match value {
            Some(value) => self.number(value),
            None => self.text.push(b','),
        }
    }

    /// Ends the row.
    pub fn end_row(&mut self) {
        // Nothing but an empty field would be no row.
        if self.text[self.begin..] == *b"," {
            self.text.splice(self.begin.., *b"\"\",");
        }
        if let Some(last) = self.text[self.begin..].last_mut() {
            *last = b'\n';
        }
        self.begin = self.text.len();
    }
}

impl TableWriter {
    /// Starts a table with its header row.
    pub fn new<'a>(output: Output, header: impl IntoIterator<Item = &'a str>) -> Result<Self, OutputError> {
        let row = TableRows::starting(output.is_terminal());
        let mut table = Self { output, row };
        header.into_iter().for_each(|name| table.text(name));
        table.end_row()?;
        Ok(table)
    }

    /// As [`TableRows::text`].
    pub fn text(&mut self, text: &str) {
        self.row.text(text);
    }

    /// As [`TableRows::number`].
    pub fn number(&mut self, value: f64) {
        self.row.number(value);
    }

    /// As [`TableRows::optional`].
    pub fn optional(&mut self, value: Option<f64>) {
        self.row.optional(value);
    }

    /// Adds a pose, for its columns.
    pub fn pose(&mut self, pose: &Pose) {
        let (t, r) = (pose.translation_m * 1e3, pose.rotation_rad());
        [t.x, t.y, t.z, r.x, r.y, r.z].into_iter().for_each(|number| self.number(number));
    }

    /// Ends the row, and writes it.
    pub fn end_row(&mut self) -> Result<(), OutputError> {
        self.row.end_row();
        self.output.write_all(&self.row.text).map_err(|source| self.output.error(source))?;
        self.row.text.clear();
        self.row.begin = 0;
        Ok(())
    }

    /// Whether it goes to a terminal.
    pub fn is_terminal(&self) -> bool {
        self.row.is_terminal
    }

    /// What begins rows for [`Self::append`].
    pub fn starting(&self) -> impl Fn() -> TableRows + Sync + use<> {
        let is_terminal = self.row.is_terminal;
        move || TableRows::starting(is_terminal)
    }

    /// Adds whole rows.
    pub fn append(&mut self, rows: &TableRows) -> Result<(), OutputError> {
        self.output.write_all(&rows.text).map_err(|source| self.output.error(source))
    }

    /// Ends the table; a file appears under its name now.
    pub fn finish(self) -> Result<(), OutputError> {
        self.output.finish()
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
            table.number(number);
            table.optional(None);
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
    fn text_of_any_kind_is_kept_also_where_it_is_all_of_a_row() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text.csv");
        let texts = ["a, \"b\"", "", "\"", "two\nlines", "plain"];
        let mut table = TableWriter::new(Output::file(&path).unwrap(), ["id"]).unwrap();
        for text in texts {
            table.text(text);
            table.end_row().unwrap();
        }
        table.finish().unwrap();
        let mut table = TableReader::open(path.to_str().unwrap()).unwrap();
        let column = table.column("id").unwrap();
        for text in texts {
            assert_eq!(table.next_row().unwrap().unwrap().text(column), text);
        }
        assert!(table.next_row().unwrap().is_none());
    }

    #[test]
    fn whole_numbers_have_no_point() {
        let mut rows = TableRows::starting(false);
        rows.integer(0);
        rows.integer(12_345);
        rows.number(12_345.0);
        rows.end_row();
        assert_eq!(rows.text, b"0,12345,12345.0\n");
    }
}
