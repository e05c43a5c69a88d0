//! `slitpose-cycles`: what a pose costs on the board's core.

use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use slitpose_emulator::image::Image;
use slitpose_emulator::memory::RAM_BYTES;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::profile::Profile;
use slitpose_emulator::solver_cost::{CostError, Start, Trial, measure};
use slitpose_emulator::stopwatch::{Stopwatch, StopwatchError, open_stopwatch_image};
use slitpose_emulator::talk::{ended, talk};
use slitpose_head::scene_file::{SceneFile, SceneFileError};
use slitpose_model::Tier;
use thiserror::Error;

/// Of the table.
const COLUMNS: [&str; 10] = [
    "scene",
    "tier",
    "start",
    "cells",
    "poses",
    "median_cycles",
    "max_cycles",
    "median_us_at_170mhz",
    "rms_error_um",
    "rms_error_urad",
];

/// Dearest functions in a profile.
const FUNCTIONS: usize = 20;

/// The pose solver of the board's core in f32: cycles, time and error, as CSV.
///
/// Solves noise-free poses of the scene's workspace on an emulated Cortex-M4F that runs nothing
/// else, and compares each with the host's solution. What follows a tool
/// in the paper tier runs as code in CCM SRAM, which has no wait states; what does not fit there (the
/// exact tier, and part of what finds a lost tool) runs from flash, with the wait states of 170 MHz.
#[derive(Debug, Parser)]
#[command(name = "slitpose-cycles", version, after_help = "Example:\n  slitpose-cycles wide --poses 20 --profile")]
struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(default_value = "wide")]
    scene: String,
    /// Poses for each row
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    poses: u32,
    /// Seed of the poses
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// The image [default: what firmware/build --stopwatch made last]
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// Show on standard error in which functions the cycles go
    #[arg(long)]
    profile: bool,
}

#[derive(Debug, Error)]
enum Failure {
    #[error(transparent)]
    Scene(#[from] SceneFileError),
    #[error(transparent)]
    Stopwatch(#[from] StopwatchError),
    #[error(transparent)]
    Cost(#[from] CostError),
    #[error("cannot write to standard output")]
    Flush(#[from] io::Error),
    #[error("cannot write to standard output")]
    Output(#[from] csv::Error),
}

/// The name this program talks under.
const NAME: &str = "slitpose-cycles";

fn main() -> ExitCode {
    ended(NAME, run(&Args::parse()))
}

fn run(args: &Args) -> Result<(), Failure> {
    let file = SceneFile::open(&args.scene)?;
    let image = open_stopwatch_image(args.elf.as_deref())?;
    let mut out = csv::Writer::from_writer(io::stdout());
    out.write_record(COLUMNS)?;
    for tier in [Tier::Paper, Tier::Exact { tolerance: 1e-4 }, Tier::Exact { tolerance: 1e-6 }] {
        let trial = Trial::new(&file, tier, args.poses as usize, args.seed)?;
        let mut stopwatch = Stopwatch::boot(&image, &file.scene, tier)?;
        for start in [Start::Cold, Start::Warm] {
            if args.profile {
                stopwatch.start_profile();
            }
            let cost = measure(&mut stopwatch, &trial, start)?;
            out.write_record(&[
                file.origin.clone(),
                label(tier),
                start.as_str().to_owned(),
                file.scene.cells.len().to_string(),
                args.poses.to_string(),
                cost.median_cycles.to_string(),
                cost.max_cycles.to_string(),
                format!("{:.1}", f64::from(cost.median_cycles) * 1e6 / TICKS_PER_SECOND as f64),
                format!("{:.5}", cost.rms_error_m * 1e6),
                format!("{:.4}", cost.rms_error_rad * 1e6),
            ])?;
            out.flush()?;
            if let Some(profile) = stopwatch.take_profile() {
                talk(NAME, format_args!("{} {}, without the callees:", label(tier), start.as_str()));
                show(f64::from(args.poses), &profile, &image);
            }
            talk(
                NAME,
                format_args!(
                    "{} {}: {:.2} steps of refinement on average",
                    label(tier),
                    start.as_str(),
                    cost.mean_iterations
                ),
            );
        }
        talk(
            NAME,
            format_args!(
                "{}: solver and scene need {} of a board's {RAM_BYTES} bytes of RAM, {} of them for code in CCM SRAM",
                label(tier),
                stopwatch.ram_bytes(),
                stopwatch.ccm_bytes()
            ),
        );
    }
    Ok(())
}

/// The tier in one word.
fn label(tier: Tier) -> String {
    match tier {
        Tier::Paper => "paper".to_owned(),
        Tier::Exact { tolerance } => format!("exact:{tolerance:e}"),
    }
}

/// The dearest functions of so many solves, per solve.
fn show(solves: f64, profile: &Profile, image: &Image) {
    let total = profile.total() as f64;
    talk(NAME, format_args!("{:>8} {:>6} {:>8}  function", "cycles", "share", "calls"));
    let line = |name: &str, cycles: Ticks, calls: u64| {
        let (cycles, calls) = (cycles as f64, calls as f64 / solves);
        talk(NAME, format_args!("{:8.0} {:5.1}% {calls:8.1}  {name}", cycles / solves, 100.0 * cycles / total));
    };
    let functions = profile.functions(image);
    for function in functions.iter().take(FUNCTIONS) {
        line(&function.name, function.cycles, function.calls);
    }
    line("(others)", functions.iter().skip(FUNCTIONS).map(|function| function.cycles).sum(), 0);
    line("(all)", profile.total(), 0);
}
