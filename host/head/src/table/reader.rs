//! CSV in.

use std::fs::Metadata;
use std::io::{self, Read};
use std::path::Path;
use std::sync::Arc;

use csv::StringRecord;
use thiserror::Error;

use crate::foreign::printable;
use crate::text_file::{self, TextFileError};

/// Why a table cannot be used.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum TableError {
    #[error("cannot read {}; give a CSV file, or - for standard input", printable(.0))]
    Open(String, #[source] TextFileError),
    #[error("reading {0} failed after row {1}")]
    Read(String, u64, #[source] io::Error),
    #[error("{0} {1}")]
    Content(String, String),
    #[error("{} `{}` is not a finite number; give one like -1.5 or 2e-6", .0, printable(.1))]
    NotANumber(String, String),
}

/// Longest row, bytes: the header of 16 cells has less than 2 kB.
const MAX_ROW_BYTES: u64 = 1 << 20;

/// Bytes that are read at a time.
const READ_BYTES: usize = 1 << 16;

/// What programs write instead of commas, also where a comma begins the decimals.
const SEPARATORS: [(char, &str); 4] = [(';', "semicolons"), ('\t', "tabs"), ('|', "bars"), (' ', "blanks")];

/// A column of the table at hand, found by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column(usize);

/// What a table is called, and its columns.
struct Names {
    file: String,
    header: Vec<String>,
}

impl Names {
    fn in_header(&self, text: String) -> TableError {
        TableError::Content(format!("{}, line 1:", self.file), text)
    }

    fn in_row(&self, row: u64, line: u64, text: &str) -> TableError {
        TableError::Content(format!("{}, row {row} (line {line}):", self.file), text.to_owned())
    }
}

/// A CSV file that is read row by row, or many rows at a time.
///
/// ```
/// use slitpose_head::table::TableReader;
/// let mut table = TableReader::new("measured.csv", &b"time_s,tx_mm\n0,1.5\n0.1,oops\n"[..])?;
/// let tx = table.column("tx_mm")?;
/// assert_eq!(table.next_row()?.expect("a row").number(tx)?, 1.5);
/// let error = table.next_row()?.expect("a row").number(tx).unwrap_err().to_string();
/// assert!(error.contains("measured.csv") && error.contains("oops"), "{error}");
/// # Ok::<(), slitpose_head::table::TableError>(())
/// ```
pub struct TableReader {
    names: Arc<Names>,
    csv: csv::Reader<Lines>,
    /// Bytes of the file; `None` if it has no length.
    length: Option<u64>,
    record: StringRecord,
    /// Whether it has not been given out yet.
    waiting: bool,
    rows: u64,
    max_rows: u64,
    /// What [`TableReader::next_rows`] found after the rows that it gave out last.
    postponed: Option<TableError>,
}

impl TableReader {
    /// Opens a file; `-` is standard input.
    pub fn open(file: &str) -> Result<Self, TableError> {
        if file == "-" {
            return Self::new("standard input", io::stdin().lock());
        }
        let opened = text_file::open(Path::new(file));
        let opened = opened.map_err(|source| TableError::Open(file.to_owned(), source))?;
        let length = opened.metadata().ok().filter(Metadata::is_file).map(|metadata| metadata.len());
        Ok(Self { length, ..Self::new(file, opened)? })
    }

    /// Reads from any source; `file` names it in messages. A table without any row is an error.
    pub fn new(file: &str, source: impl Read + 'static) -> Result<Self, TableError> {
        let lines = Lines { source: Box::new(source), passed: 0, row_begin: 0, has_crlf: false };
        let csv =
            csv::ReaderBuilder::new().has_headers(false).flexible(true).buffer_capacity(READ_BYTES).from_reader(lines);
        let names = |header| Arc::new(Names { file: file.to_owned(), header });
        let mut table = Self {
            names: names(Vec::new()),
            csv,
            length: None,
            record: StringRecord::new(),
            waiting: false,
            rows: 0,
            max_rows: u64::MAX,
            postponed: None,
        };
        let whole = |text: &str| TableError::Content(file.to_owned(), text.to_owned());
        let header = loop {
            if !table.read_record()? {
                return Err(whole("is empty; give a header row and at least one row of data"));
            }
            let header: Vec<_> = table.record.iter().map(|name| name.trim().to_owned()).collect();
            // A line for spreadsheets alone: it says that commas separate the columns.
            if header != ["sep=", ""] {
                break header;
            }
        };
        table.names = names(header);
        if let [only] = &table.names.header[..]
            && !only.starts_with('#')
            && let Some((_, separator)) = SEPARATORS.into_iter().find(|(separator, _)| only.contains(*separator))
        {
            return Err(table.names.in_header(format!(
                "columns are separated by {separator}; save the file with commas between columns, and points in numbers"
            )));
        }
        table.waiting = table.advance()?;
        if table.waiting { Ok(table) } else { Err(whole("has a header but no row of data; add at least one row")) }
    }

    /// Refuses tables of more rows: for those who need all rows at once.
    #[must_use]
    pub fn of_at_most(self, max_rows: u64) -> Self {
        Self { max_rows, ..self }
    }

    /// The name of the table in messages.
    pub fn file(&self) -> &str {
        &self.names.file
    }

    /// Bytes of the file, if it has a length.
    pub fn length(&self) -> Option<u64> {
        self.length
    }

    /// Bytes of the file that were read.
    pub fn position(&self) -> u64 {
        self.csv.position().byte()
    }

    /// Finds a column that must be there.
    pub fn column(&self, name: &str) -> Result<Column, TableError> {
        let header = &self.names.header;
        self.optional_column(name)?.ok_or_else(|| {
            self.names.in_header(format!(
                "column `{}` is missing; the header has {}; {}",
                printable(name),
                printable(&header.join(", ")),
                next_step(name, header)
            ))
        })
    }

    /// Finds a column that may be there.
    pub fn optional_column(&self, name: &str) -> Result<Option<Column>, TableError> {
        let header = &self.names.header;
        let mut found = (0..header.len()).filter(|index| header[*index] == name);
        match (found.next(), found.next()) {
            (first, None) => Ok(first.map(Column)),
            _ => Err(self
                .names
                .in_header(format!("column `{}` stands in the header twice; remove or rename one", printable(name)))),
        }
    }

    /// The next row; `None` at the end.
    pub fn next_row(&mut self) -> Result<Option<Row<'_>>, TableError> {
        let more = std::mem::take(&mut self.waiting) || self.advance()?;
        Ok(more.then(|| Row { names: &self.names, record: &self.record, number: self.rows }))
    }

    /// Up to `most` of the next rows, fewer long ones; none at the end. An error belongs to the row after those of the last call and before
    /// those of the next: rows that come before it are given out first.
    pub fn next_rows(&mut self, most: usize) -> Result<Rows, TableError> {
        if let Some(error) = self.postponed.take() {
            return Err(error);
        }
        let mut rows = Rows { names: Arc::clone(&self.names), records: Vec::new(), first: 0 };
        let mut bytes = 0;
        while rows.len() < most && bytes < MAX_ROW_BYTES {
            match if std::mem::take(&mut self.waiting) { Ok(true) } else { self.advance() } {
                Ok(true) => {
                    let length = self.record.as_slice().len();
                    bytes += length as u64;
                    let next = StringRecord::with_capacity(length, self.record.len());
                    rows.records.push(std::mem::replace(&mut self.record, next));
                }
                Ok(false) => break,
                Err(error) if rows.is_empty() => return Err(error),
                Err(error) => {
                    self.postponed = Some(error);
                    break;
                }
            }
        }
        rows.first = self.rows + 1 - rows.len() as u64;
        Ok(rows)
    }

    /// Reads the next row of data; `false` at the end.
    fn advance(&mut self) -> Result<bool, TableError> {
        if !self.read_record()? {
            return Ok(false);
        }
        let row = self.rows + 1;
        if row > self.max_rows {
            let text = format!(
                "has more than {} rows, which are needed in memory at once; give fewer, such as every tenth",
                self.max_rows
            );
            return Err(TableError::Content(self.names.file.clone(), text));
        }
        let (found, expected) = (self.record.len(), self.names.header.len());
        if found != expected {
            let next_step = if self.names.header[0].starts_with('#') {
                REMOVE_COMMENTS
            } else if found > expected {
                "correct this row: decimals begin with a point, and texts with commas stand in quotes"
            } else {
                "correct this row"
            };
            let text = format!("{found} fields, but the header has {expected}; {next_step}");
            return Err(self.names.in_row(row, line_of(&self.record), &text));
        }
        self.rows = row;
        Ok(true)
    }

    fn read_record(&mut self) -> Result<bool, TableError> {
        let mut begin = self.csv.position().clone();
        self.csv.get_mut().row_begin = begin.byte();
        let read = self.csv.read_record(&mut self.record);
        // The parser leaves the line feed behind a carriage return to the next row, and counts lines by line feeds.
        begin.set_line(begin.line() + u64::from(begin.byte() > 0 && self.csv.get_ref().has_crlf));
        self.record.set_position(Some(begin.clone()));
        let length = self.record.as_slice().len() + self.record.len();
        if self.csv.get_ref().is_too_long() || length as u64 > MAX_ROW_BYTES {
            let text =
                format!("a row of more than {MAX_ROW_BYTES} bytes; end each row with a line feed, and close quotes");
            return Err(TableError::Content(format!("{}, line {}:", self.names.file, begin.line()), text));
        }
        read.map_err(|error| match error.into_kind() {
            csv::ErrorKind::Io(source) => TableError::Read(self.names.file.clone(), self.rows, source),
            // The header is row 0. No other error is left for a reader of texts.
            _ => {
                let row = if self.names.header.is_empty() { 0 } else { self.rows + 1 };
                self.names.in_row(row, begin.line(), "not UTF-8 text; save the file as UTF-8")
            }
        })
    }
}

fn line_of(record: &StringRecord) -> u64 {
    record.position().map_or(0, csv::Position::line)
}

const REMOVE_COMMENTS: &str = "remove lines of comments, and the # before the header";

/// What to do about a column `wanted` that is not in `header`.
fn next_step(wanted: &str, header: &[String]) -> String {
    let is_there = |name: &str| header.iter().any(|column| column.eq_ignore_ascii_case(name));
    if header.first().is_some_and(|first| first.starts_with('#')) {
        return REMOVE_COMMENTS.to_owned();
    }
    if header.iter().any(|column| column.parse::<f64>().is_ok()) {
        return "add a line with the names of the columns above the numbers".to_owned();
    }
    if wanted.ends_with("_rad") && ["qx", "qy", "qz", "qw"].into_iter().all(is_there) {
        return "turn quaternions into rotation vectors, axis times angle in radians, as rotation_vectors of the Python \
                package does"
            .to_owned();
    }
    // Without the unit, which stands behind the last underscore, or in brackets.
    let bare = |name: &str| {
        let name = name.split([' ', '(', '[']).next().unwrap_or_default().to_ascii_lowercase();
        name.rsplit_once('_').map_or(name.clone(), |(bare, _)| bare.to_owned())
    };
    match header.iter().find(|column| column.eq_ignore_ascii_case(wanted) || bare(column) == bare(wanted)) {
        Some(like) => format!("add the column, or rename {} if that is its name and unit", printable(like)),
        None => "add the column".to_owned(),
    }
}

/// Rows of data that are no part of the reader any more, for another thread.
pub struct Rows {
    names: Arc<Names>,
    records: Vec<StringRecord>,
    first: u64,
}

impl Rows {
    /// The rows in their order.
    pub fn iter(&self) -> impl Iterator<Item = Row<'_>> {
        self.records.iter().zip(self.first..).map(|(record, number)| Row { names: &self.names, record, number })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }
}

/// One row of data.
#[derive(Clone, Copy)]
pub struct Row<'a> {
    names: &'a Names,
    record: &'a StringRecord,
    /// From 1.
    pub(crate) number: u64,
}

impl<'a> Row<'a> {
    /// A field as it stands, without surrounding blanks.
    pub fn text(&self, column: Column) -> &'a str {
        self.record.get(column.0).unwrap_or_default().trim()
    }

    /// A field as a finite number.
    pub fn number(&self, column: Column) -> Result<f64, TableError> {
        let text = self.text(column);
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(TableError::NotANumber(self.place(column), text.to_owned())),
        }
    }

    /// The error of a number that the caller cannot use.
    pub fn out_of_range(&self, column: Column, value: f64, allowed: &'static str) -> TableError {
        TableError::Content(self.place(column), format!("{value} is out of range; give {allowed}"))
    }

    fn place(&self, column: Column) -> String {
        let Names { file, header } = self.names;
        let (row, line) = (self.number, line_of(self.record));
        format!("{file}, row {row} (line {line}), column `{}`:", printable(&header[column.0]))
    }
}

/// Passes text on, and fails once a row has more than [`MAX_ROW_BYTES`].
struct Lines {
    source: Box<dyn Read>,
    /// Bytes that were passed on, and how many of them came before the row at hand.
    passed: u64,
    row_begin: u64,
    /// Whether lines end in `\r\n`.
    has_crlf: bool,
}

impl Lines {
    fn is_too_long(&self) -> bool {
        self.passed > self.row_begin + MAX_ROW_BYTES + READ_BYTES as u64
    }
}

impl Read for Lines {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.is_too_long() {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        let count = self.source.read(out)?;
        self.passed += count as u64;
        self.has_crlf = self.has_crlf || out[..count].windows(2).any(|two| two == b"\r\n");
        Ok(count)
    }
}

#[cfg(test)]
mod tests;
