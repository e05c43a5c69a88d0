//! The independent reference numbers in `data/reference` (see its README for their origin).

use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};
use slitpose_model::{Cell, Detector, Emitter, Profile, Scene, Slit, Uncertainty};

use crate::table::{Row, Table};

const MM: f64 = 1e-3;

/// Path of a file in `data`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name)
}

/// The table in `data/<name>`.
///
/// # Panics
/// If it cannot be read.
pub fn table(name: &str) -> Table {
    Table::parse(&std::fs::read_to_string(data(name)).expect("reference table"))
}

fn vector_m(row: &Row<'_>, columns: [&str; 3]) -> DVec3 {
    DVec3::from(row.numbers(columns)) * MM
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
            thickness_m: row.number("slit_thickness_mm") * MM,
        },
        emitter: Emitter {
            position_tool_m: vector_m(row, ["ex_mm", "ey_mm", "ez_mm"]),
            axis_tool: row.numbers(["ux", "uy", "uz"]).into(),
            radiant_intensity_w_per_sr: row.number("radiant_intensity_w_per_sr"),
            profile: Profile::Cosine { exponent: row.number("profile_exponent") },
        },
        effects: slitpose_model::Effects::default(),
    };
    Scene { cells: [cell].into_iter().collect(), noise: None, uncertainty: Uncertainty::default() }
}

/// The same as a scene file.
pub fn single_cell_scene_file(row: &Row<'_>) -> String {
    let thickness = match row.number("slit_thickness_mm") {
        0.0 => String::new(),
        thickness => format!("thickness_mm = {thickness:?}\n"),
    };
    let value = |column: &str| format!("{:?}", row.number(column));
    format!(
        "[detector]\nlength_mm = {}\nwidth_mm = {}\nresponsivity_a_per_w = {}\ndark_current_a = {}\n\
         [slit]\ndistance_mm = {}\nwidth_mm = {}\nlength_mm = {}\noffset_mm = [{}, {}]\n{thickness}\
         [emitter]\nradiant_intensity_w_per_sr = {}\nprofile_exponent = {}\n\
         [[cell]]\ndetector_mm = [0.0, 0.0, 0.0]\nx_axis = [1.0, 0.0, 0.0]\nnormal = [0.0, 0.0, 1.0]\n\
         emitter_mm = [{}, {}, {}]\nemitter_axis = [{}, {}, {}]\n",
        value("length_mm"),
        value("width_mm"),
        value("responsivity_a_per_w"),
        value("dark_current_a"),
        value("slit_distance_mm"),
        value("slit_width_mm"),
        value("slit_length_mm"),
        value("slit_x_mm"),
        value("slit_y_mm"),
        value("radiant_intensity_w_per_sr"),
        value("profile_exponent"),
        value("ex_mm"),
        value("ey_mm"),
        value("ez_mm"),
        value("ux"),
        value("uy"),
        value("uz"),
    )
}
