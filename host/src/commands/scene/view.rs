//! `slitpose scene view`: a scene on a page, with a tool to drag.

use std::sync::atomic::Ordering;
use std::time::Duration;

use super::{CommandError, Outcome};
use crate::commands::live::AccessOptions;
use crate::commands::options::{CalibrationOption, open_scene};
use crate::commands::{interrupt, options};
use crate::live::{Control, DEFAULT_LIVE_ADDRESS, LiveAddress, LiveBoard, LivePlan, Order, Refusal, SceneView};

/// Shows a scene on a page: drag the tool, and see the light on each detector and the accuracy of a frame there.
///
/// Accuracy is the Cramér–Rao bound of one frame; a scene without front end and noise has none. Runs until it is
/// interrupted.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose scene view wide --open\n  \
                        slitpose scene view head.toml --calibration calibration.toml --live 127.0.0.1:8000")]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// Where the page is served
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_LIVE_ADDRESS)]
    live: LiveAddress,
    #[command(flatten)]
    access: AccessOptions,
}

/// Nothing of a scene can be changed.
struct Still;

impl Control for Still {
    fn order(&self, order: Order) -> Result<(), Refusal> {
        Err(match order {
            Order::Record(_) => Refusal::NO_RECORDER,
            Order::Zero => Refusal::NO_MOUSE,
            Order::Player(_) => Refusal::NO_PLAYER,
        })
    }
}

/// Longest time until an interrupt is answered.
const MOMENT: Duration = Duration::from_millis(50);

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let head = args.calibration.head_as_drawn(open_scene(&args.scene)?)?;
    let stop = interrupt()?;
    let _server = args.access.start(LivePlan {
        access: args.access.at(args.live)?,
        source: "scene",
        has_zero: false,
        scene: Some(SceneView::of(&head)?),
        boards: vec![LiveBoard { name: head.file.name.clone(), head: Some(head) }],
        control: Box::new(Still),
        report: None,
    })?;
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(MOMENT);
    }
    Ok(Outcome::Done)
}
