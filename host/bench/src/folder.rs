//! A folder of tables, with the truth apart.

use std::fs;
use std::path::{Path, PathBuf};

use slitpose_head::table::{Output, OutputError, POSE_COLUMNS, TableWriter};
use slitpose_model::Pose;

use crate::BenchError;
use crate::drawn::DrawnHead;
use crate::session::{Row, Says, Session, Table};
use crate::truth;

/// Writes everything into `folder`, which is made: the scene and the tables, and in `truth/` what they were made from.
/// Returns the files.
///
/// # Errors
/// A folder with files in it, or that cannot be written.
pub fn write(folder: &Path, head: &DrawnHead, session: &Session) -> Result<Vec<PathBuf>, BenchError> {
    let create =
        |path: &Path| fs::create_dir_all(path).map_err(|source| OutputError::Create { path: path.to_owned(), source });
    create(folder)?;
    if fs::read_dir(folder).is_ok_and(|mut files| files.next().is_some()) {
        return Err(BenchError::NotEmpty { folder: folder.to_owned() });
    }
    let apart = folder.join("truth");
    create(&apart)?;
    let mut written = Vec::new();
    let mut file = |path: PathBuf| {
        let output = Output::file(&path)?;
        written.push(path);
        Ok::<_, OutputError>(output)
    };
    file(folder.join("scene.toml"))?.write_text(&head.nominal.source)?;
    for table in &session.tables {
        let name = format!("{}.csv", table.name);
        write_readings(table, head.nominal.scene.cells.len(), file(folder.join(&name))?)?;
        write_poses(table, file(apart.join(&name))?)?;
    }
    if head.nominal.front_end.is_some() {
        write_tracked(&session.tracked, file(folder.join("tracked.csv"))?)?;
    }
    file(apart.join("truth.toml"))?.write_text(&truth::text(head, session))?;
    Ok(written)
}

fn write_readings(table: &Table, cells: usize, output: Output) -> Result<(), OutputError> {
    let currents: Vec<String> = (0..cells).flat_map(|k| [format!("i_x1_{k}_a"), format!("i_x2_{k}_a")]).collect();
    let header = ["id"].into_iter().chain(table.columns.iter().copied());
    let header = header.chain(currents.iter().map(String::as_str)).chain(["frames"]);
    let mut writer = TableWriter::new(output, header)?;
    for (id, row) in table.rows.iter().enumerate() {
        writer.text(&id.to_string());
        match row.says {
            Says::Pose(pose) => write_pose(&mut writer, &pose),
            Says::StepM(step_m) => writer.number(step_m * 1e3),
            Says::TimeS(time_s) => writer.number(time_s),
            Says::Nothing => {}
        }
        for current_a in row.currents.iter().flat_map(|pair| [pair.i_x1_a, pair.i_x2_a]) {
            writer.number(current_a);
        }
        writer.text(&row.frames.to_string());
        writer.end_row()?;
    }
    writer.finish()
}

fn write_poses(table: &Table, output: Output) -> Result<(), OutputError> {
    let mut writer = TableWriter::new(output, ["id"].into_iter().chain(POSE_COLUMNS))?;
    for (id, Row { truth, .. }) in table.rows.iter().enumerate() {
        writer.text(&id.to_string());
        write_pose(&mut writer, truth);
        writer.end_row()?;
    }
    writer.finish()
}

/// The poses that belong to the capture of the free motion.
fn write_tracked(tracked: &[(f64, Pose)], output: Output) -> Result<(), OutputError> {
    let mut writer = TableWriter::new(output, ["time_s"].into_iter().chain(POSE_COLUMNS))?;
    for (time_s, pose) in tracked {
        writer.number(*time_s);
        write_pose(&mut writer, pose);
        writer.end_row()?;
    }
    writer.finish()
}

fn write_pose(writer: &mut TableWriter, pose: &Pose) {
    let (t, r) = (pose.translation_m * 1e3, pose.rotation_rad());
    [t.x, t.y, t.z, r.x, r.y, r.z].into_iter().for_each(|number| writer.number(number));
}
