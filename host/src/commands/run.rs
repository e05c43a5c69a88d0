//! `slitpose run`: poses of a board, live.

use std::io::Write;
use std::path::PathBuf;

use slitpose_protocol::Command;

use super::stream::{Pace, PoseOptions, Speed, Stream, StreamError, ToolOptions, open_scene, request};
use super::{CommandError, Outcome};
use crate::front_end;
use crate::pipeline::{Pipeline, SceneMatch};
use crate::simulator::SimulatedBoard;
use crate::table::Output;

/// Device time between two waits.
const WAIT_EVERY_S: f64 = 2e-3;

/// Follows the tool in front of a board.
///
/// Starts the board with the schedule of the scene and prints a pose for each scan: a summary on a
/// terminal, one JSON object a line otherwise. Simulated poses are marked and come with the truth.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose run --device sim --duration 10s\n  \
                        slitpose run --device sim --trajectory contact --record contact.capture > poses.ndjson")]
pub(super) struct Args {
    /// `sim`: a simulated board
    #[arg(long, value_name = "DEVICE")]
    device: String,
    /// Scene file, or the name of a shipped scene [default: wide]
    #[arg(long, value_name = "SCENE")]
    scene: Option<String>,
    #[command(flatten)]
    poses: PoseOptions,
    /// Keep the bytes as received in this file
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Device seconds a second a simulated board runs at, or max
    #[arg(long, value_name = "N", default_value_t = Speed::Times(1.0), allow_negative_numbers = true)]
    speed: Speed,
    #[command(flatten)]
    tool: ToolOptions,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    if args.device != "sim" {
        return Err(StreamError::Device(args.device.clone()).into());
    }
    let file = open_scene(args.scene.as_deref())?;
    let tier = args.poses.tier();
    let configuration = front_end::configuration(&file)?;
    let period_s = configuration.schedule.frame_rate_hz().recip();
    let horizon_s = args.poses.duration.unwrap_or(f64::INFINITY);
    let trajectory = args.tool.trajectory(horizon_s.min(LONGEST_PLAN_S))?;
    let mut board = SimulatedBoard::new(&file, trajectory, tier, args.tool.seed)?;
    let mut record = args.record.as_deref().map(Output::file).transpose()?;
    let mut stream = Stream::new(Pipeline::new(file, tier, SceneMatch::Required), &args.poses)?;

    let frames = (horizon_s / period_s - 1e-6).ceil();
    let frames = if frames.is_finite() { frames as u64 } else { u64::MAX };
    let frames_between_waits = (WAIT_EVERY_S / period_s).ceil() as u64;
    let pace = Pace::new(args.speed);
    let mut bytes = Vec::with_capacity(1 << 12);
    let mut pass_on = |bytes: &mut Vec<u8>, stream: &mut Stream<'_>| -> Result<(), CommandError> {
        if let Some(record) = &mut record {
            record.write_all(bytes).map_err(|source| record.error(source))?;
        }
        stream.push(bytes)?;
        bytes.clear();
        Ok(())
    };

    board.write(&request(1, Command::Configure(configuration)));
    board.write(&request(2, Command::Start));
    let mut follow = || -> Result<(), CommandError> {
        for frame in 1..=frames {
            board.step(&mut bytes);
            if frame % frames_between_waits == 0 || frame == frames {
                pass_on(&mut bytes, &mut stream)?;
                stream.tick()?;
                pace.wait(frame as f64 * period_s);
                if stream.is_over() {
                    break;
                }
            }
        }
        board.write(&request(3, Command::Stop));
        board.step(&mut bytes);
        pass_on(&mut bytes, &mut stream)
    };
    let followed = follow();
    // What has been recorded is kept even if nobody reads the poses any more.
    if let Some(record) = record {
        record.finish()?;
    }
    followed?;
    Ok(stream.finish()?.0)
}

/// A motion that plans ahead does so for an hour.
const LONGEST_PLAN_S: f64 = 3600.0;
