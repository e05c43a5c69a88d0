//! `slitpose simulate`: a capture of a simulated board, without solving it.

use std::io::Write;
use std::path::PathBuf;

use super::options::TierOptions;
use super::stream::{DEFAULT_TOLERANCE, ToolOptions, open_scene, parse_duration};
use super::{CommandError, Outcome};
use crate::device::{Conversation, DeviceError, Keep};
use crate::front_end;
use crate::pace::Speed;
use crate::simulator::Trajectory;
use crate::table::{Output, POSE_COLUMNS, TableWriter};

/// Writes what a simulated board would send: a capture for `replay`.
///
/// The truth of each scan is in the capture; --truth writes it as a table, too.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  slitpose simulate --trajectory fast --duration 2s --output fast.capture --truth fast.csv"
)]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene [default: wide]
    #[arg(long, value_name = "SCENE")]
    scene: Option<String>,
    /// Device time to simulate, such as 10s
    #[arg(long, value_name = "TIME", value_parser = parse_duration, default_value = "10s")]
    duration: f64,
    /// Capture to write; - is standard output
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    /// Table of true poses to write: seq, device_time_s and the columns of a pose
    #[arg(long, value_name = "CSV")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    tool: ToolOptions,
    #[command(flatten)]
    tier: TierOptions,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let file = open_scene(args.scene.as_deref())?;
    let configuration = front_end::configuration(&file)?;
    let schedule = configuration.schedule.clone();
    let frames = (args.duration * schedule.frame_rate_hz() - 1e-6).ceil() as u64;
    let tier = args.tier.tier(DEFAULT_TOLERANCE);
    let device = args.tool.device(&file, tier, args.duration, Speed::Max)?;
    let mut output = Output::open(Some(&args.output))?;
    let truth = args.truth.as_deref().map(Output::file).transpose()?;

    let mut board = Conversation::open(Box::new(device))?;
    board.greet(|_| Ok::<_, DeviceError>(()))?;
    board.configure(configuration)?;
    board.start()?;
    let mut write = |bytes: &[u8]| output.write_all(bytes).map_err(|source| output.error(source));
    write(board.inbox())?;
    while board.listen()? {
        write(board.inbox())?;
    }
    board.stop(Keep::All)?;
    write(board.inbox())?;
    output.finish()?;

    if let Some(truth) = truth {
        let instants = (0..frames).map(|frame| {
            (frame as f64 * f64::from(schedule.frame_ticks) + schedule.reference_ticks()) / f64::from(schedule.tick_hz)
        });
        write_truth(truth, &args.tool.trajectory(args.duration)?, instants)?;
    }
    Ok(Outcome::Done)
}

fn write_truth(
    output: Output,
    trajectory: &Trajectory,
    instants: impl Iterator<Item = f64>,
) -> Result<(), CommandError> {
    let header = ["seq", "device_time_s"].into_iter().chain(POSE_COLUMNS);
    let mut table = TableWriter::new(output, header)?;
    for (sequence, time_s) in instants.enumerate() {
        let pose = trajectory.pose(time_s);
        let (t, r) = (pose.translation_m * 1e3, pose.rotation_rad());
        table.text(&sequence.to_string())?;
        for number in [time_s, t.x, t.y, t.z, r.x, r.y, r.z] {
            table.number(number)?;
        }
        table.end_row()?;
    }
    Ok(table.finish()?)
}
