//! CSV in.

use std::fs::Metadata;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;
use std::sync::Arc;

use csv_core::ReadRecordResult;
use thiserror::Error;

use super::line_ends::LineFeeds;
use crate::foreign::printable;
use crate::text_file::{self, TextFileError};

/// Why a table cannot be used.
#[derive(Debug, Error)]
pub enum TableError {
    /// The file cannot be opened.
    #[error("cannot read {}; give a CSV file, or - for standard input", printable(file))]
    Open {
        /// The file.
        file: String,
        /// Why not.
        source: TextFileError,
    },
    /// Reading failed on the way.
    #[error("reading {file} failed after row {row}")]
    Read {
        /// The file.
        file: String,
        /// Data rows read before.
        row: u64,
        /// The system's error.
        source: io::Error,
    },
    /// A row without an end.
    #[error(
        "{file}, line {line}: a row of more than {MAX_ROW_BYTES} bytes; end each row with a line feed, and close quotes"
    )]
    LongRow {
        /// The file.
        file: String,
        /// Line of the file, from 1.
        line: u64,
    },
    /// More rows than are held in memory at once.
    #[error(
        "{file} has more than {max_rows} rows, which are needed in memory at once; give fewer, such as every tenth"
    )]
    TooManyRows {
        /// The file.
        file: String,
        /// The most rows that are read.
        max_rows: u64,
    },
    /// A file without a header row.
    #[error("{file} is empty; give a header row and at least one row of data")]
    Empty {
        /// The file.
        file: String,
    },
    /// A header row and nothing else.
    #[error("{file} has a header but no row of data; add at least one row")]
    NoRows {
        /// The file.
        file: String,
    },
    /// Columns that are separated by something else than commas.
    #[error(
        "{file}, line 1: columns are separated by {separator}; save the file with commas between columns, and points in \
         numbers"
    )]
    Separator {
        /// The file.
        file: String,
        /// What separates them, in a word.
        separator: &'static str,
    },
    /// A column that is needed and not there.
    #[error(
        "{file}, line 1: column `{}` is missing; the header has {}; {next_step}",
        printable(column),
        printable(present)
    )]
    MissingColumn {
        /// The file.
        file: String,
        /// The column's name.
        column: String,
        /// The names that are there.
        present: String,
        /// What to do.
        next_step: String,
    },
    /// Two columns of one name.
    #[error("{file}, line 1: column `{}` stands in the header twice; remove or rename one", printable(column))]
    DuplicateColumn {
        /// The file.
        file: String,
        /// The column's name.
        column: String,
    },
    /// A row that is longer or shorter than the header.
    #[error("{file}, row {row} (line {line}): {found} fields, but the header has {expected}; {next_step}")]
    UnequalRow {
        /// The file.
        file: String,
        /// Data row, from 1.
        row: u64,
        /// Line of the file, from 1.
        line: u64,
        /// Fields in the row.
        found: u64,
        /// Fields in the header.
        expected: u64,
        /// What to do.
        next_step: &'static str,
    },
    /// Bytes that are no text.
    #[error("{file}, row {row} (line {line}): not UTF-8 text; save the file as UTF-8")]
    NotText {
        /// The file.
        file: String,
        /// Data row, from 1; 0 for the header.
        row: u64,
        /// Line of the file, from 1.
        line: u64,
    },
    /// A field that should be a number.
    #[error(
        "{file}, row {row} (line {line}), column `{}`: `{}` is not a finite number; give one like -1.5 or 2e-6",
        printable(column),
        printable(text)
    )]
    NotANumber {
        /// The file.
        file: String,
        /// Data row, from 1.
        row: u64,
        /// Line of the file, from 1.
        line: u64,
        /// The column's name.
        column: String,
        /// What stands there.
        text: String,
    },
    /// A number outside what the column can mean.
    #[error("{file}, row {row} (line {line}), column `{}`: {value} is out of range; give {allowed}", printable(column))]
    OutOfRange {
        /// The file.
        file: String,
        /// Data row, from 1.
        row: u64,
        /// Line of the file, from 1.
        line: u64,
        /// The column's name.
        column: String,
        /// What stands there.
        value: f64,
        /// The allowed numbers, in words.
        allowed: &'static str,
    },
}

/// Longest row, bytes: the header of 16 cells has less than 2 kB.
const MAX_ROW_BYTES: usize = 1 << 20;

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

/// A CSV file that is read row by row, or many rows at a time.
pub struct TableReader {
    names: Arc<Names>,
    records: Records,
    /// Bytes of the file; `None` if it has no length.
    length: Option<u64>,
    /// The row that was read last.
    row: Rows,
    /// Whether [`TableReader::next_row`] has not given it out yet.
    waiting: bool,
    rows: u64,
    max_rows: u64,
    /// What [`TableReader::next_rows`] found after the rows that it gave out last.
    postponed: Option<TableError>,
}

/// CSV, record by record.
struct Records {
    source: BufReader<Box<dyn Read>>,
    /// Bytes of it that were parsed.
    parsed: u64,
    parser: Box<csv_core::Reader>,
    /// The fields of the record at hand one after another, with room behind them.
    text: Vec<u8>,
    /// Where each of them ends, with room behind.
    ends: Vec<usize>,
}

/// A record: its fields one after another, the end of each, and the line where it begins.
struct Record<'a> {
    text: &'a [u8],
    ends: &'a [usize],
    line: u64,
}

impl Records {
    fn of(source: impl Read + 'static) -> Self {
        Self {
            source: BufReader::with_capacity(READ_BYTES, Box::new(LineFeeds::of(source))),
            parsed: 0,
            parser: Box::new(csv_core::Reader::new()),
            text: vec![0; 1024],
            ends: vec![0; 64],
        }
    }

    /// The next one of the table `file`, behind `row`; `None` at the end.
    fn next(&mut self, file: &str, row: u64) -> Result<Option<Record<'_>>, TableError> {
        let line = self.parser.line();
        let (mut length, mut fields) = (0, 0);
        loop {
            let input = self.source.fill_buf();
            let input = input.map_err(|source| TableError::Read { file: file.to_owned(), row, source })?;
            let (result, read, written, ended) =
                self.parser.read_record(input, &mut self.text[length..], &mut self.ends[fields..]);
            self.source.consume(read);
            self.parsed += read as u64;
            (length, fields) = (length + written, fields + ended);
            if length + fields > MAX_ROW_BYTES {
                return Err(TableError::LongRow { file: file.to_owned(), line });
            }
            match result {
                ReadRecordResult::InputEmpty => {}
                ReadRecordResult::OutputFull => self.text.resize(2 * self.text.len(), 0),
                ReadRecordResult::OutputEndsFull => self.ends.resize(2 * self.ends.len(), 0),
                ReadRecordResult::Record => {
                    return Ok(Some(Record { text: &self.text[..length], ends: &self.ends[..fields], line }));
                }
                ReadRecordResult::End => return Ok(None),
            }
        }
    }
}

impl TableReader {
    /// Opens a file; `-` is standard input.
    pub fn open(file: &str) -> Result<Self, TableError> {
        if file == "-" {
            return Self::new("standard input", io::stdin().lock());
        }
        let opened = text_file::open(Path::new(file));
        let opened = opened.map_err(|source| TableError::Open { file: file.to_owned(), source })?;
        let length = opened.metadata().ok().filter(Metadata::is_file).map(|metadata| metadata.len());
        Ok(Self { length, ..Self::new(file, opened)? })
    }

    /// Reads from any source; `file` names it in messages. A table without any row is an error.
    pub fn new(file: &str, source: impl Read + 'static) -> Result<Self, TableError> {
        let mut records = Records::of(source);
        let header = loop {
            let Some(Record { text, ends, line }) = records.next(file, 0)? else {
                return Err(TableError::Empty { file: file.to_owned() });
            };
            let text =
                std::str::from_utf8(text).map_err(|_| TableError::NotText { file: file.to_owned(), row: 0, line })?;
            let header: Vec<_> = (0..ends.len()).map(|index| field(text, ends, index).trim().to_owned()).collect();
            // A line for spreadsheets alone: it says that commas separate the columns.
            if header != ["sep=", ""] {
                break header;
            }
        };
        if let [only] = &header[..]
            && !only.starts_with('#')
            && let Some((_, separator)) = SEPARATORS.into_iter().find(|(separator, _)| only.contains(*separator))
        {
            return Err(TableError::Separator { file: file.to_owned(), separator });
        }
        let names = Arc::new(Names { file: file.to_owned(), header });
        let row = Rows::none(&names, 1);
        let (length, max_rows) = (None, u64::MAX);
        let mut table = Self { names, records, length, row, waiting: false, rows: 0, max_rows, postponed: None };
        table.waiting = table.advance()?;
        if table.waiting { Ok(table) } else { Err(TableError::NoRows { file: file.to_owned() }) }
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

    /// Bytes of the file that were read; lines that end in `\r\n` count one byte less.
    pub fn position(&self) -> u64 {
        self.records.parsed
    }

    /// Finds a column that must be there.
    pub fn column(&self, name: &str) -> Result<Column, TableError> {
        self.optional_column(name)?.ok_or_else(|| TableError::MissingColumn {
            file: self.names.file.clone(),
            column: name.to_owned(),
            present: self.names.header.join(", "),
            next_step: next_step(name, &self.names.header),
        })
    }

    /// Finds a column that may be there.
    pub fn optional_column(&self, name: &str) -> Result<Option<Column>, TableError> {
        let header = &self.names.header;
        let mut found = (0..header.len()).filter(|index| header[*index] == name);
        match (found.next(), found.next()) {
            (first, None) => Ok(first.map(Column)),
            _ => Err(TableError::DuplicateColumn { file: self.names.file.clone(), column: name.to_owned() }),
        }
    }

    /// The next row; `None` at the end.
    pub fn next_row(&mut self) -> Result<Option<Row<'_>>, TableError> {
        let more = std::mem::take(&mut self.waiting) || self.advance()?;
        Ok(if more { self.row.iter().next() } else { None })
    }

    /// Up to `most` of the next rows, fewer long ones; none at the end. An error belongs to the row after those of the last call and before
    /// those of the next: rows that come before it are given out first.
    pub fn next_rows(&mut self, most: usize) -> Result<Rows, TableError> {
        if let Some(error) = self.postponed.take() {
            return Err(error);
        }
        let none = Rows::none(&self.names, self.rows + 1);
        let mut rows = if std::mem::take(&mut self.waiting) { std::mem::replace(&mut self.row, none) } else { none };
        while rows.len() < most && rows.text.len() < MAX_ROW_BYTES {
            match self.read_into(&mut rows) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) if rows.is_empty() => return Err(error),
                Err(error) => {
                    self.postponed = Some(error);
                    break;
                }
            }
        }
        Ok(rows)
    }

    fn advance(&mut self) -> Result<bool, TableError> {
        let mut row = std::mem::replace(&mut self.row, Rows::none(&self.names, 0));
        row.clear(self.rows + 1);
        let more = self.read_into(&mut row);
        self.row = row;
        more
    }

    /// Adds the next row to `rows`; `false` at the end.
    fn read_into(&mut self, rows: &mut Rows) -> Result<bool, TableError> {
        let file = || self.names.file.clone();
        let next = self.records.next(&self.names.file, self.rows)?;
        let Some(Record { text, ends, line }) = next else { return Ok(false) };
        let row = self.rows + 1;
        if row > self.max_rows {
            return Err(TableError::TooManyRows { file: file(), max_rows: self.max_rows });
        }
        let text = std::str::from_utf8(text).map_err(|_| TableError::NotText { file: file(), row, line })?;
        if ends.len() != self.names.header.len() {
            let [found, expected] = [ends.len(), self.names.header.len()].map(|fields| fields as u64);
            let next_step = if self.names.header[0].starts_with('#') {
                REMOVE_COMMENTS
            } else if found > expected {
                "correct this row: decimals begin with a point, and texts with commas stand in quotes"
            } else {
                "correct this row"
            };
            return Err(TableError::UnequalRow { file: file(), row, line, found, expected, next_step });
        }
        rows.begins.push(rows.text.len());
        rows.lines.push(line);
        rows.text.push_str(text);
        rows.ends.extend_from_slice(ends);
        self.rows = row;
        Ok(true)
    }
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

/// Field number `index` of a record.
fn field<'a>(text: &'a str, ends: &[usize], index: usize) -> &'a str {
    let begin = index.checked_sub(1).map_or(0, |before| ends[before]);
    // Between the ends of two fields there is no part of a character, unless the parser lied.
    text.get(begin..ends[index]).unwrap_or_default()
}

/// Rows of data that are no part of the reader any more, for another thread.
pub struct Rows {
    names: Arc<Names>,
    /// The fields of all rows, one after another, and where each row begins.
    text: String,
    begins: Vec<usize>,
    /// Where each field ends, in its row.
    ends: Vec<usize>,
    /// The line where each row begins.
    lines: Vec<u64>,
    /// Number of the first.
    first: u64,
}

impl Rows {
    /// No row, of which the first is to be number `first`.
    fn none(names: &Arc<Names>, first: u64) -> Self {
        let names = Arc::clone(names);
        Self { names, text: String::new(), begins: Vec::new(), ends: Vec::new(), lines: Vec::new(), first }
    }

    fn clear(&mut self, first: u64) {
        self.text.clear();
        self.begins.clear();
        self.ends.clear();
        self.lines.clear();
        self.first = first;
    }

    /// The rows in their order.
    pub fn iter(&self) -> impl Iterator<Item = Row<'_>> {
        let places = self.begins.iter().zip(&self.lines).zip(self.ends.chunks_exact(self.names.header.len()));
        places.zip(self.first..).map(|(((&begin, &line), ends), number)| Row {
            names: &self.names,
            text: &self.text[begin..],
            ends,
            line,
            number,
        })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.begins.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.begins.is_empty()
    }
}

/// One row of data.
#[derive(Clone, Copy)]
pub struct Row<'a> {
    names: &'a Names,
    /// Its fields one after another, and more behind them.
    text: &'a str,
    ends: &'a [usize],
    line: u64,
    /// From 1.
    number: u64,
}

impl<'a> Row<'a> {
    /// A field as it stands, without surrounding blanks.
    pub fn text(&self, column: Column) -> &'a str {
        field(self.text, self.ends, column.0).trim()
    }

    /// A field as a finite number.
    pub fn number(&self, column: Column) -> Result<f64, TableError> {
        let text = self.text(column);
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(TableError::NotANumber {
                file: self.names.file.clone(),
                row: self.number_of_row(),
                line: self.line,
                column: self.name(column),
                text: text.to_owned(),
            }),
        }
    }

    /// The error of a number that the caller cannot use.
    pub fn out_of_range(&self, column: Column, value: f64, allowed: &'static str) -> TableError {
        TableError::OutOfRange {
            file: self.names.file.clone(),
            row: self.number_of_row(),
            line: self.line,
            column: self.name(column),
            value,
            allowed,
        }
    }

    /// Number of this data row, from 1.
    pub(crate) fn number_of_row(&self) -> u64 {
        self.number
    }

    fn name(&self, column: Column) -> String {
        self.names.header[column.0].clone()
    }
}

#[cfg(test)]
mod tests;
