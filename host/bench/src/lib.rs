//! A virtual bench: one head drawn from the tolerances of a scene, and what an instrument and a board measure on it.
//!
//! * [`DrawnHead`] is the head: parts off their places as `[tolerance]` says, and, if asked for, physics beyond the model;
//! * [`Session`] measures on it: tables for `calibrate` and `solve`, with the truth apart;
//! * [`write()`] makes a folder of them.
//!
//! Nothing here has been measured. A seed determines every byte.

#![forbid(unsafe_code)]

mod chance;
mod drawn;
mod session;

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use slitpose_calibration::{Knowledge, Parameter, values_of};
use slitpose_head::foreign::printable;
use slitpose_head::front_end::TimingError;
use slitpose_head::scene_file::SceneFileError;
use slitpose_head::table::{Output, OutputError, POSE_COLUMNS, TableWriter};
use slitpose_model::{Pose, SceneError};
use thiserror::Error;

use drawn::Beyond;

pub use drawn::{DrawnHead, Within};
pub use session::{Session, Settings, Table};

/// Writes everything into `folder`, which is made: the scene and the tables, and in `truth/` what they were made from.
pub fn write(folder: &Path, head: &DrawnHead, session: &Session) -> Result<(), BenchError> {
    let create =
        |path: &Path| fs::create_dir_all(path).map_err(|source| OutputError::Create { path: path.to_owned(), source });
    create(folder)?;
    if fs::read_dir(folder).is_ok_and(|mut files| files.next().is_some()) {
        return Err(BenchError::NotEmpty(folder.to_owned()));
    }
    let apart = folder.join("truth");
    create(&apart)?;
    Output::file(&folder.join("scene.toml"))?.write_text(&head.nominal.source)?;
    for table in &session.tables {
        let name = format!("{}.csv", table.name);
        write_readings(table, head.nominal.scene.cells.len(), Output::file(&folder.join(&name))?)?;
        let truths = table.rows.iter().map(|row| row.truth).enumerate();
        write_poses(Output::file(&apart.join(&name))?, "id", truths, |writer, id| writer.text(&id.to_string()))?;
    }
    if head.nominal.front_end.is_some() {
        let (output, path) = (Output::file(&folder.join("session.csv"))?, session.by_hand.iter().copied());
        write_poses(output, "time_s", path, TableWriter::number)?;
    }
    let mut truth = String::new();
    // Writing to a string cannot fail.
    let _ = write_truth(&mut truth, head, session);
    Output::file(&apart.join("truth.toml"))?.write_text(&truth)?;
    Ok(())
}

fn write_readings(table: &Table, cells: usize, output: Output) -> Result<(), OutputError> {
    let currents: Vec<String> = (0..cells).flat_map(|k| [format!("i_x1_{k}_a"), format!("i_x2_{k}_a")]).collect();
    let header = ["id"].into_iter().chain(table.columns.iter().copied());
    let header = header.chain(currents.iter().map(String::as_str)).chain(["frames"]);
    let mut writer = TableWriter::new(output, header)?;
    for (id, row) in table.rows.iter().enumerate() {
        writer.text(&id.to_string());
        match row.knowledge {
            Knowledge::Reported(pose) => writer.pose(&pose),
            Knowledge::Step(step_m) => writer.number(step_m * 1e3),
            Knowledge::Nothing => row.time_s.into_iter().for_each(|time_s| writer.number(time_s)),
        }
        for current_a in row.currents.iter().flat_map(|pair| [pair.i_x1_a, pair.i_x2_a]) {
            writer.number(current_a);
        }
        writer.text(&row.frames.to_string());
        writer.end_row()?;
    }
    writer.finish()
}

/// Poses, each after its key.
fn write_poses<K>(
    output: Output,
    key: &str,
    rows: impl Iterator<Item = (K, Pose)>,
    write_key: impl Fn(&mut TableWriter, K),
) -> Result<(), OutputError> {
    let mut writer = TableWriter::new(output, [key].into_iter().chain(POSE_COLUMNS))?;
    for (of_row, pose) in rows {
        write_key(&mut writer, of_row);
        writer.pose(&pose);
        writer.end_row()?;
    }
    writer.finish()
}

/// Why there is no bench.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum BenchError {
    #[error(transparent)]
    SceneFile(#[from] SceneFileError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Timing(#[from] TimingError),
    #[error(
        "seed {0}, {1}: none of {2} poses of the workspace has every spot on its detector and every current \
         within the converters' range; give another --seed, a smaller [workspace], or smaller tolerances"
    )]
    Dark(u64, &'static str, usize),
    #[error("{} holds files already, which may have been measured; give a new folder", printable(&.0.to_string_lossy()))]
    NotEmpty(PathBuf),
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// The truth as TOML: parameters in the shape of calibration files, SI units, transforms as translation and rotation
/// vector.
fn write_truth(out: &mut String, head: &DrawnHead, session: &Session) -> std::fmt::Result {
    let settings = &session.settings;
    writeln!(out, "# What a virtual bench simulated. SI units; transforms are translation and rotation vector.")?;
    writeln!(out, "seed = {}\nscene_hash = \"{:016x}\"", settings.seed, head.nominal.hash)?;
    let [sigma_m, sigma_rad] = settings.instrument;
    writeln!(out, "\n[instrument]\nsigma_m = {sigma_m:e}\nsigma_rad = {sigma_rad:e}")?;
    writeln!(out, "base_from_reference = {:?}", values_of(&session.base_from_reference))?;
    writeln!(out, "tool_from_marker = {:?}", values_of(&session.tool_from_marker))?;
    writeln!(out, "\n[pivot]\nin_tool_m = {:?}", session.pivot.in_tool_m.to_array())?;
    writeln!(out, "in_base_m = {:?}", session.pivot.in_base_m.to_array())?;
    writeln!(out, "\n[stage]\nstart = {:?}", values_of(&session.stage_start))?;
    writeln!(out, "direction = {:?}", session.stage_direction.to_array())?;
    writeln!(out, "\n[rest]\npose = {:?}", values_of(&session.rest))?;
    writeln!(out, "\n# Parameters: name, deviation from the scene, most probable one, its sigma, unit.")?;
    for number in 0..head.nominal.scene.cells.len() {
        writeln!(out, "[[cell]]")?;
        if let Some(beyond) = head.optics.beyond.get(number) {
            write_beyond(out, &beyond.of)?;
        }
        write_parameters(out, head, Some(number))?;
    }
    writeln!(out, "[converter]")?;
    write_parameters(out, head, None)
}

fn write_parameters(out: &mut String, head: &DrawnHead, cell: Option<usize>) -> std::fmt::Result {
    writeln!(out, "parameters = [")?;
    for entry in head.parameters.iter().filter(|entry| entry.cell == cell) {
        let Parameter { quantity, prior, prior_sigma, value, .. } = entry;
        writeln!(out, "[\"{quantity}\", {value:e}, {prior:e}, {prior_sigma:e}, \"{}\"],", quantity.unit())?;
    }
    writeln!(out, "]\n")
}

fn write_beyond(out: &mut String, beyond: &Beyond) -> std::fmt::Result {
    let Beyond { ripple_m, ripple_period_m, ripple_phase_rad, chip, slit_step_m, stray_a_per_rad } = beyond;
    writeln!(out, "ripple_m = {ripple_m:e}\nripple_period_m = {ripple_period_m:e}")?;
    writeln!(out, "ripple_phase_rad = {ripple_phase_rad:e}\nchip = {chip:?}\nslit_step_m = {slit_step_m:e}")?;
    writeln!(out, "stray_a_per_rad = {stray_a_per_rad:?}")
}
