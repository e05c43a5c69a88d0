//! The independent reference numbers in `data/reference` (see its README for their origin).

use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};
use slitpose_model::{Cell, Detector, Emitter, Profile, Scene, Slit, Uncertainty};

const MM: f64 = 1e-3;

/// Path of a file in `data`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name)
}

/// A CSV file with a header row.
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
    /// Reads `data/<name>`.
    ///
    /// # Panics
    /// If the file cannot be read.
    pub fn read(name: &str) -> Self {
        let mut reader = csv::Reader::from_path(data(name)).expect("reference table");
        let header = reader.headers().expect("header").iter().map(str::to_owned).collect();
        let rows = reader.records().map(|row| row.expect("row")).collect();
        Self { header, rows }
    }

    /// Its rows, in order.
    pub fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        self.rows.iter().map(|record| Row { header: &self.header, record })
    }
}

impl<'a> Row<'a> {
    /// The text in `column`.
    ///
    /// # Panics
    /// If there is no such column.
    pub fn text(&self, column: &str) -> &'a str {
        let index = self.header.iter().position(|name| name == column).unwrap_or_else(|| panic!("no column {column}"));
        &self.record[index]
    }

    /// The number in `column`; `nan` is a number here.
    ///
    /// # Panics
    /// If there is none.
    pub fn number(&self, column: &str) -> f64 {
        self.text(column).parse().unwrap_or_else(|_| panic!("{column} holds {:?}", self.text(column)))
    }

    fn vector_m(&self, columns: [&str; 3]) -> DVec3 {
        DVec3::from(columns.map(|column| self.number(column))) * MM
    }
}

/// The one-cell scene of a row of `single_cell.csv`: cell frame, base frame and tool frame coincide.
pub fn single_cell_scene(row: &Row<'_>) -> Scene {
    let cell = Cell {
        detector: Detector {
            centre_base_m: DVec3::ZERO,
            x_axis_base: DVec3::X,
            normal_base: DVec3::Z,
            length_m: row.number("length_mm") * MM,
            width_m: row.number("width_mm") * MM,
            responsivity_a_per_w: row.number("responsivity_a_per_w"),
            dark_current_a: row.number("dark_current_a"),
            interelectrode_ohm: None,
            saturation_a: None,
            faint_a: 0.0,
        },
        slit: Slit {
            distance_m: row.number("slit_distance_mm") * MM,
            width_m: row.number("slit_width_mm") * MM,
            length_m: row.number("slit_length_mm") * MM,
            offset_m: DVec2::new(row.number("slit_x_mm"), row.number("slit_y_mm")) * MM,
            tilt_rad: DVec3::ZERO,
            thickness_m: if row.text("slit_is_thick") == "1" { row.number("slit_thickness_mm") * MM } else { 0.0 },
        },
        emitter: Emitter {
            position_tool_m: row.vector_m(["ex_mm", "ey_mm", "ez_mm"]),
            axis_tool: DVec3::new(row.number("ux"), row.number("uy"), row.number("uz")),
            radiant_intensity_w_per_sr: row.number("radiant_intensity_w_per_sr"),
            profile: Profile::Cosine { exponent: row.number("profile_exponent") },
        },
    };
    Scene { cells: [cell].into_iter().collect(), noise: None, uncertainty: Uncertainty::default() }
}
