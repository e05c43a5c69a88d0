//! The independent reference numbers in `data/reference` (see its README for their origin).

use std::path::{Path, PathBuf};

use crate::table::{Row, Table};

/// Path of a file in `data`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name)
}

/// The table in `data/<name>`.
pub fn table(name: &str) -> Table {
    Table::parse(&std::fs::read_to_string(data(name)).expect("reference table"))
}

/// The one-cell scene file of a row of `single_cell.csv`: cell frame, base frame and tool frame coincide.
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
