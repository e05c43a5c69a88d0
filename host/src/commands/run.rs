//! `slitpose run`: poses of a board, live.

use std::io::Write;
use std::path::PathBuf;

use super::stream::{PoseOptions, Stream, ToolOptions, open_scene, talk};
use super::{CommandError, Outcome};
use crate::device::{Conversation, Device, DeviceError, Keep, SerialDevice};
use crate::front_end;
use crate::pace::Speed;
use crate::pipeline::{Pipeline, SceneMatch};
use crate::table::Output;

/// The name of the simulated board.
const SIM: &str = "sim";

/// Follows the tool in front of a board.
///
/// Starts the board with the schedule of the scene and prints a pose for each scan: a summary on a
/// terminal, one JSON object a line otherwise. Simulated poses are marked and come with the truth.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose run --device /dev/ttyACM0 --scene head.toml\n  \
                  slitpose run --device sim --duration 10s\n  \
                  slitpose run --device sim --trajectory contact --record contact.capture > poses.ndjson")]
pub(super) struct Args {
    /// Path of the board's serial port, or `sim`: a simulated board
    #[arg(long, value_name = "DEVICE")]
    device: String,
    /// Scene file, or the name of a shipped scene [default: wide]
    #[arg(long, value_name = "SCENE")]
    scene: Option<String>,
    #[command(flatten)]
    poses: PoseOptions,
    /// Keep the bytes as received, from the accepted schedule on, in this file
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Device seconds a second a simulated board runs at, or max [default: 1]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    speed: Option<Speed>,
    #[command(flatten)]
    tool: ToolOptions,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let file = open_scene(args.scene.as_deref())?;
    let tier = args.poses.tier();
    let configuration = front_end::configuration(&file)?;
    let device: Box<dyn Device> = if args.device == SIM {
        let duration_s = args.poses.duration.unwrap_or(f64::INFINITY);
        Box::new(args.tool.device(&file, tier, duration_s, args.speed.unwrap_or(Speed::Times(1.0)))?)
    } else {
        if let Some(option) = args.tool.given().or(args.speed.map(|_| "--speed")) {
            return Err(CommandError::OnlySimulated { option, device: args.device.clone() });
        }
        Box::new(SerialDevice::open(&args.device)?)
    };
    let record = args.record.as_deref().map(Output::file).transpose()?;
    let name = file.name.clone();
    let full_scale_a = file.front_end.map(|front_end| front_end.full_scale_a);
    let pipeline =
        Pipeline::new(file, tier, SceneMatch::Required).until(args.poses.duration).following(args.poses.following());

    let mut board = Conversation::open(device)?;
    let mut greeted = None;
    board.greet(|hello| {
        pipeline.check(hello)?;
        greeted.get_or_insert_with(|| (hello.hashes.scene.is_some(), hello.scaling.full_scale_a()));
        Ok::<_, CommandError>(())
    })?;
    if let (Some((_, board_a)), Some(scene_a)) = (greeted, full_scale_a)
        && (board_a / scene_a - 1.0).abs() > FULL_SCALE_SLACK
    {
        talk(format_args!(
            "the board on {} measures up to {:.3} uA, the front end of `{name}` up to {:.3} uA: the board's is taken; \
             correct front_end.full_scale_a, or flash the firmware of this front end",
            args.device,
            board_a * 1e6,
            scene_a * 1e6
        ));
    }
    if greeted.is_some_and(|(has_scene, _)| !has_scene) {
        talk(format_args!(
            "the board on {} has no scene stored; taking `{name}` for the scene of its head: give another with --scene",
            args.device
        ));
    }
    board.configure(configuration)?;
    let stream = Stream::new(pipeline, &args.poses)?;
    board.start()?;
    let mut session = Session { board, stream, record };
    let followed = session.follow();
    session.end(followed)
}

/// Full scales that differ by more are not those of one front end: resistors are better than that.
const FULL_SCALE_SLACK: f64 = 0.01;

/// A board that has been started, and where its poses go.
struct Session<'a> {
    board: Conversation,
    stream: Stream<'a>,
    record: Option<Output>,
}

impl Session<'_> {
    /// Until the end asked for, an interrupt, or an error.
    fn follow(&mut self) -> Result<(), CommandError> {
        self.pass_on()?;
        // A status from before the start tells nothing.
        let idle = self.stream.board_status().map(|status| status.tick);
        while !self.stream.is_over() && self.board.listen()? {
            self.pass_on()?;
            if let Some(status) = self.stream.board_status()
                && !status.acquiring
                && Some(status.tick) != idle
            {
                let reason = self.stream.complaint().unwrap_or("it gives no reason; reset the board").to_owned();
                return Err(DeviceError::Stopped { name: self.board.name(), reason }.into());
            }
        }
        Ok(())
    }

    /// Stops the board, prints what was still under way, and closes everything.
    fn end(mut self, followed: Result<(), CommandError>) -> Result<Outcome, CommandError> {
        let keep = if self.stream.is_complete() { Keep::Replies } else { Keep::All };
        let stopped = match self.board.stop(keep) {
            Err(error @ DeviceError::NoReply { .. }) => {
                talk(format_args!("the emitters of the board may still be lit; it goes dark when its port is closed"));
                Err(error.into())
            }
            stopped => stopped.map_err(CommandError::from),
        };
        let passed_on = self.pass_on();
        // What has been recorded is kept even if nobody reads the poses any more.
        if let Some(record) = self.record {
            record.finish()?;
        }
        match followed.and(stopped).and(passed_on) {
            Ok(()) => Ok(self.stream.finish()?.0),
            Err(error @ CommandError::Output(_)) => Err(error),
            Err(error) => {
                self.stream.finish()?;
                Err(error)
            }
        }
    }

    fn pass_on(&mut self) -> Result<(), CommandError> {
        let bytes = self.board.inbox();
        let pushed = self.stream.push(bytes);
        if let Some(record) = &mut self.record {
            let taken = pushed.as_ref().map_or(bytes.len(), |taken| *taken);
            record.write_all(&bytes[..taken]).map_err(|source| record.error(source))?;
        }
        pushed?;
        Ok(self.stream.tick()?)
    }
}
