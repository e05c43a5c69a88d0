//! `slitpose zero`: the present pose of a running daemon becomes the zero of its frame.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use serde_json::Value;
use slitpose_head::foreign::printable;
use slitpose_head::table::Output;

use super::options::parse_duration;
use super::{CommandError, Outcome, talk};
use crate::address::Address;
use crate::telemetry::{DEFAULT_STATUS_ADDRESS, fetch, request, status_address};

/// Makes the present pose of the tool the origin of the frame that a running daemon gives poses in.
///
/// Takes the mean of all poses of some time, of the tip if the daemon has one. From then on all outputs are in the new
/// frame, `zero`, until the daemon ends; captures stay in the frame of the head. With --output the frame is kept in a
/// file, for --frame of other commands. Asks the daemon that was started with `slitpose run --status ADDRESS`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose zero\n  slitpose zero --over 5s --output jig.toml\n  slitpose zero --undo"
)]
pub(super) struct Args {
    /// Where the daemon serves its status: HOST:PORT or unix:PATH
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_STATUS_ADDRESS, value_parser = status_address)]
    address: Address,
    /// Number of the board among those of the daemon
    #[arg(long, value_name = "N", default_value_t = 0)]
    board: usize,
    /// Take the mean over this much time of the board's clock, up to 60s
    #[arg(long, value_name = "TIME", value_parser = parse_duration, default_value = "1s")]
    over: f64,
    /// Go back to the frame that the daemon was started with
    #[arg(long, conflicts_with = "output")]
    undo: bool,
    /// Write the frame to this file
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

const LOOK_EVERY: Duration = Duration::from_millis(50);

/// A daemon with a board that sends scans answers sooner.
const PATIENCE: Duration = Duration::from_secs(5);

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let before = frame(args)?;
    let output = args.output.as_deref().map(Output::file).transpose()?;
    let milliseconds = if args.undo { 0 } else { (args.over * 1e3).round().max(1.0) as u32 };
    let (status, text) = request(&args.address, &format!("POST /zero/{}/{milliseconds}", args.board))?;
    if status != 202 {
        bail!("{} sets no zero: {}", args.address, printable(text.trim_end()));
    }
    let until = Instant::now() + Duration::from_millis(milliseconds.into()) + PATIENCE;
    let found = loop {
        std::thread::sleep(LOOK_EVERY);
        let now = frame(args)?;
        if now["zeros"] != before["zeros"] {
            break now;
        }
        if Instant::now() > until {
            bail!("no zero was set: the board sends too few scans; see `slitpose status`");
        }
    };
    let words = found["zero"].as_str().unwrap_or_default();
    if found["is_refused"] == true {
        bail!("{}", printable(words));
    }
    talk(format_args!("{}", printable(words)));
    if let (Some(output), Some(text)) = (output, found["text"].as_str()) {
        let target = output.target().to_owned();
        output.write_text(text)?;
        talk(format_args!("wrote {target}"));
    }
    Ok(Outcome::Done)
}

/// The frame of the board, as the daemon reports it.
fn frame(args: &Args) -> Result<Value, CommandError> {
    let (_, text) = fetch(&args.address, "/status")?;
    let report: Value = serde_json::from_str(&text).with_context(|| format!("{} gives no status", args.address))?;
    let boards = report["boards"].as_array().map_or(0, Vec::len);
    match report["boards"].get(args.board) {
        Some(board) => Ok(board["frame"].clone()),
        None => {
            bail!("the daemon follows {boards} boards, and the first is 0; give another --board than {}", args.board)
        }
    }
}
