//! `slitpose identify`: an emitter's profile from measured currents, by equation (6).

use std::path::PathBuf;

use anyhow::Context;
use clap::ValueEnum;
use slitpose_calibration::{
    CalibrateError, Constraint, Data, Implausible, Knowledge, Row, check_poses, tables, uncalibrated,
};
use slitpose_design::identification::{Identified, identify as profile_point, profile_table};
use slitpose_model::{CompiledScene, Tier};

use super::options::{number, open_scene};
use super::{CommandError, Outcome, options, talk};
use slitpose_head::foreign::printable;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::{CurrentColumns, Output, PoseColumns, TableReader, TableWriter};

/// Finds an emitter's profile from measured currents.
///
/// I_rel(γ) = I_Om/(S·Ω·I_e), equation (6) of De La Cruz et al. 2018, for every lit cell of every row.
/// Columns in: those of `model` for the pose, and i_x1_k_a, i_x2_k_a for every cell k. Out: a table
/// of id, cell, gamma_deg, relative_intensity, solid_angle_sr, i_o_a; or, with --format profile, a
/// `profile` line for each cell's emitter. Poses that the currents show to be in other units, axes or
/// rows are refused.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose identify bench --currents measured.csv --format profile --step 5")]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// Table of poses and currents; - is standard input
    #[arg(long, value_name = "CSV")]
    currents: String,
    /// One row a point, or lines for a scene file
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
    // A profile has at most 64 knots from 0 to 90 degrees.
    /// Distance of the knots of --format profile
    #[arg(long, value_name = "DEG", default_value_t = 5.0, value_parser = number(|step| (1.5..=45.0).contains(&step), "give degrees from 1.5 to 45"))]
    step: f64,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Csv,
    Profile,
}

/// Most rows of the table: all points are held in memory.
const MAX_ROWS: u64 = 1 << 20;
/// Greatest intensity relative to the axis that is no slip.
const MAX_RELATIVE: f64 = 2.0;

/// A point and where it came from.
struct Found {
    id: String,
    cell: usize,
    i_o_a: f64,
    point: Identified,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let file = open_scene(&args.scene)?;
    let scene = &file.scene;
    // The solid angle and γ of the equations as printed: the profile is for use with them.
    let plan = CompiledScene::<f64>::compile(scene, Tier::Paper)?;
    let mut rows = TableReader::open(&args.currents)?.of_at_most(MAX_ROWS);
    let poses = PoseColumns::find(&rows)?;
    let currents = CurrentColumns::find(&rows, plan.cell_count())?;
    let output = Output::open(args.output.as_deref())?;
    let (mut found, mut measured) = (Vec::new(), Vec::new());
    while let Some(row) = rows.next_row()? {
        let pose = poses.pose(&row)?;
        let mut readings = Vec::new();
        for (cell, description) in scene.cells.iter().enumerate() {
            let pair = currents.pair(&row, cell)?;
            let i_o_a = pair.total_a();
            readings.push(tables::above_dark(&description.detector, &pair));
            if let Some(point) = profile_point(description, &plan, cell, &pose, i_o_a) {
                found.push(Found { id: poses.id(&row).to_owned(), cell, i_o_a, point });
            }
        }
        let (id, knowledge) = (poses.id(&row).to_owned(), Knowledge::Reported(pose));
        measured.push(Row { id, readings, frames: 1.0, time_s: None, knowledge });
    }
    check(&file, &args.currents, measured)?;
    let brightest = found.iter().max_by(|a, b| a.point.relative_intensity.total_cmp(&b.point.relative_intensity));
    if let Some(Found { id, cell, point, .. }) = brightest.filter(|found| found.point.relative_intensity > MAX_RELATIVE)
    {
        talk(format_args!(
            "{}, id {}, cell {cell}: {:.3e} times the emitter's radiant_intensity_w_per_sr, at {:.1}° from its axis; check \
             that currents are amperes, the pose, and the scene",
            args.currents,
            printable(id),
            point.relative_intensity,
            point.gamma_rad.to_degrees()
        ));
    }
    match args.format {
        Format::Csv => write_points(&found, output)?,
        Format::Profile => output.write_text(&profile_lines(&found, plan.cell_count(), args.step)?)?,
    }
    Ok(Outcome::Done)
}

/// Refuses poses that the currents show to be of other units, axes or rows, and says what else they contradict.
fn check(file: &SceneFile, table: &str, rows: Vec<Row>) -> Result<(), CommandError> {
    let mut data = Data::default();
    data.add(table, Constraint::Known, [0.0; 2], rows);
    match check_poses(&uncalibrated(file)?, &data) {
        // A profile takes no motion, and the sum of both electrodes.
        Ok(()) | Err(Implausible::LittleMotion { .. }) => Ok(()),
        Err(remark @ (Implausible::Electrodes { .. } | Implausible::OtherScene { .. } | Implausible::Dark { .. })) => {
            talk(format_args!("{remark}"));
            Ok(())
        }
        Err(error) => Err(CalibrateError::from(error).into()),
    }
}

fn write_points(found: &[Found], output: Output) -> Result<(), CommandError> {
    let header = ["id", "cell", "gamma_deg", "relative_intensity", "solid_angle_sr", "i_o_a"];
    let mut table = TableWriter::new(output, header)?;
    for Found { id, cell, i_o_a, point } in found {
        table.text(id);
        table.text(&cell.to_string());
        table.number(point.gamma_rad.to_degrees());
        table.number(point.relative_intensity);
        table.number(point.solid_angle_sr);
        table.number(*i_o_a);
        table.end_row()?;
    }
    Ok(table.finish()?)
}

fn profile_lines(found: &[Found], cells: usize, step_deg: f64) -> Result<String, CommandError> {
    let line = |cell: usize| {
        let points: Vec<_> = found.iter().filter(|found| found.cell == cell).map(|found| found.point).collect();
        let knots = profile_table(&points, step_deg).with_context(|| format!("cell {cell}"))?;
        let knots: Vec<_> = knots.iter().map(|[deg, relative]| format!("[{deg:.4}, {relative:.6}]")).collect();
        Ok(format!("# cell {cell}\nprofile = [{}]\n", knots.join(", ")))
    };
    (0..cells).map(line).collect()
}
