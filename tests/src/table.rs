//! CSV tables, read without the product's own reader.

/// Columns of a pose.
pub const POSE: [&str; 6] = ["tx_mm", "ty_mm", "tz_mm", "rx_rad", "ry_rad", "rz_rad"];

/// Columns of its standard deviations.
pub const SIGMA: [&str; 6] =
    ["sigma_tx_mm", "sigma_ty_mm", "sigma_tz_mm", "sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad"];

/// A CSV text with a header row.
#[derive(Debug)]
pub struct Table {
    header: Vec<String>,
    rows: Vec<csv::StringRecord>,
}

/// One row of a [`Table`].
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    header: &'a [String],
    record: &'a csv::StringRecord,
}

impl Table {
    /// Reads a text.
    pub fn parse(text: &str) -> Self {
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let header = reader.headers().expect("header").iter().map(str::to_owned).collect();
        let rows = reader.records().map(|row| row.expect("row")).collect();
        Self { header, rows }
    }

    /// Names of its columns.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// Its rows, in order.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = Row<'_>> {
        self.rows.iter().map(|record| Row { header: &self.header, record })
    }
}

impl<'a> Row<'a> {
    /// The text in `column`.
    pub fn text(&self, column: &str) -> &'a str {
        let index = self.header.iter().position(|name| name == column).unwrap_or_else(|| panic!("no column {column}"));
        &self.record[index]
    }

    /// The number in `column`; `nan` is a number here.
    pub fn number(&self, column: &str) -> f64 {
        self.text(column).parse().unwrap_or_else(|_| panic!("{column} holds {:?}", self.text(column)))
    }

    /// The numbers in `columns`.
    pub fn numbers<const N: usize>(&self, columns: [&str; N]) -> [f64; N] {
        columns.map(|column| self.number(column))
    }
}
