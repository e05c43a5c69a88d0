//! `slitpose scene plot`: a scene as a picture.

use std::path::PathBuf;

use slitpose_model::{Plan, Pose, Tier};

use super::{CommandError, Outcome};
use crate::commands::options;
use crate::commands::options::{CalibrationOption, open_scene, parse_pose};
use slitpose_design::plot::{cell_picture, scene_picture};
use slitpose_head::table::Output;

const TOLERANCE: f64 = 1e-6;

/// Draws a scene as SVG: three views with slits, emitters and beams, and the light on each detector.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose scene plot wide --pose 2,0,-3,0,5,10 --output wide.svg\n  \
                        slitpose scene plot bench --cell 0 --pose 3,0,0,0,0,0 --output cell.svg")]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// Pose of the tool: translation in mm, rotation vector in degrees
    #[arg(long, value_name = "TX,TY,TZ,RX,RY,RZ", allow_hyphen_values = true, value_parser = parse_pose)]
    pose: Option<Pose>,
    /// Draw this cell only, from the side, with its dimensions
    #[arg(long, value_name = "K")]
    cell: Option<usize>,
    /// The picture
    #[arg(long, value_name = "FILE.svg")]
    output: PathBuf,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let file = args.calibration.head_as_drawn(open_scene(&args.scene)?)?.file;
    let plan = Plan::<f64>::compile(&file.scene, Tier::Exact { tolerance: TOLERANCE })?;
    let pose = args.pose.unwrap_or(Pose::HOME);
    let picture = match args.cell {
        None => scene_picture(&file.name, &file.scene, &plan, &pose)?,
        Some(number) => {
            let last = file.scene.cells.len() - 1;
            let cell = file.scene.cells.get(number).ok_or(CommandError::NoSuchCell { number, last })?;
            cell_picture(&file.name, number, cell, &plan, &pose)?
        }
    };
    Output::open(Some(&args.output))?.write_text(&picture)?;
    Ok(Outcome::Done)
}
