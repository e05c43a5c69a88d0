//! CSV tables, read without the product's own reader, and the independent reference numbers in `data/reference` (see its
//! README for their origin).

use std::path::{Path, PathBuf};

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

#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    header: &'a [String],
    record: &'a csv::StringRecord,
}

impl Table {
    pub fn parse(text: &str) -> Self {
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let header = reader.headers().expect("header").iter().map(str::to_owned).collect();
        let rows = reader.records().map(|row| row.expect("row")).collect();
        Self { header, rows }
    }

    pub fn rows(&self) -> impl ExactSizeIterator<Item = Row<'_>> {
        self.rows.iter().map(|record| Row { header: &self.header, record })
    }
}

/// The CSV text `table` with the numbers changed of the columns that are `chosen` by name.
pub fn with_changed(table: &str, chosen: impl Fn(&str) -> bool, change: impl Fn(f64) -> f64) -> String {
    let (header, rows) = table.split_once('\n').expect("a header");
    let chosen: Vec<bool> = header.split(',').map(chosen).collect();
    let row = |row: &str| {
        let fields = row.split(',').zip(&chosen).map(|(field, chosen)| match chosen {
            true => change(field.parse().expect("a number")).to_string(),
            false => field.to_owned(),
        });
        fields.collect::<Vec<_>>().join(",") + "\n"
    };
    format!("{header}\n{}", rows.lines().map(row).collect::<String>())
}

impl<'a> Row<'a> {
    pub fn text(&self, column: &str) -> &'a str {
        let index = self.header.iter().position(|name| name == column).unwrap_or_else(|| panic!("no column {column}"));
        &self.record[index]
    }

    pub fn number(&self, column: &str) -> f64 {
        self.text(column).parse().unwrap_or_else(|_| panic!("{column} holds {:?}", self.text(column)))
    }

    pub fn numbers<const N: usize>(&self, columns: [&str; N]) -> [f64; N] {
        columns.map(|column| self.number(column))
    }
}

pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name)
}

pub fn reference(name: &str) -> Table {
    Table::parse(&std::fs::read_to_string(data(name)).expect("reference table"))
}

/// The one-cell scene file of a row of `single_cell.csv`: cell frame, base frame and tool frame coincide.
pub fn single_cell_scene_file(row: &Row<'_>) -> String {
    let thickness = match row.number("slit_thickness_mm") {
        0.0 => String::new(),
        thickness => format!("thickness_mm = {thickness:?}\n"),
    };
    let text = "[detector]\nlength_mm = {length_mm}\nwidth_mm = {width_mm}\n\
         responsivity_a_per_w = {responsivity_a_per_w}\ndark_current_a = {dark_current_a}\n\
         [slit]\ndistance_mm = {slit_distance_mm}\nwidth_mm = {slit_width_mm}\nlength_mm = {slit_length_mm}\n\
         offset_mm = [{slit_x_mm}, {slit_y_mm}]\n{thickness}\
         [emitter]\nradiant_intensity_w_per_sr = {radiant_intensity_w_per_sr}\nprofile_exponent = {profile_exponent}\n\
         [[cell]]\ndetector_mm = [0.0, 0.0, 0.0]\nx_axis = [1.0, 0.0, 0.0]\nnormal = [0.0, 0.0, 1.0]\n\
         emitter_mm = [{ex_mm}, {ey_mm}, {ez_mm}]\nemitter_axis = [{ux}, {uy}, {uz}]\n";
    let fill = |text: String, column: &String| text.replace(&format!("{{{column}}}"), row.text(column));
    row.header.iter().fold(text.replace("{thickness}", &thickness), fill)
}
