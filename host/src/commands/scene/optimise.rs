//! `slitpose scene optimise`: the best head within bounds.

use std::path::PathBuf;

use clap::ValueEnum;

use super::{CommandError, Outcome};
use crate::commands::options::{Jobs, number, open_scene};
use crate::commands::{interrupt, options, talk};
use crate::terminal::{Amount, Progress};
use slitpose_design::optimise::{Demand, Excess, Free, Goal, Limit, Limits, Score, Search};
use slitpose_head::causes::with_causes;
use slitpose_head::front_end::configuration;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::Output;

/// Looks for the best head within bounds.
///
/// What is given by --free is searched, on all cores, for the least standard deviation of single frames over the workspace.
/// All spots stay on their detectors, parts do not collide, electrodes stay in scale, emitters of a slot do not shine on
/// each other's detectors; the limits are options. The scene that is found is printed, ready to use; a search that is given
/// it goes on from there, also after an interrupt.
///
/// Free may be: cells (a whole number), emitter_radius, emitter_distance (to the detector), slit_distance, slit_width,
/// slit_length, lift (of every other cell, against the next), all in mm; roll and emitter_tilt in degrees, their signs
/// alternating; full_scale of the converters in µA.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose scene optimise wide --free slit_distance --free slit_width --free roll > mine.toml\n  \
                  slitpose scene optimise wide --free emitter_radius=8..12 --free emitter_distance=12..20 --demand worst --output mine.toml"
)]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene, to begin with
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// What is free, within what: slit_width, or slit_width=0.3..1.2
    #[arg(long, value_name = "NAME[=FROM..TO]")]
    free: Vec<Free>,
    /// Which standard deviation is to be least
    #[arg(long, value_enum, default_value_t = DemandName::Median)]
    demand: DemandName,
    /// The point whose position counts: so far from the tool's centre, mm
    #[arg(long, value_name = "MM", default_value_t = 10.0, value_parser = length())]
    lever: f64,
    /// Share of the workspace in which all spots are on their detectors, percent
    #[arg(long, value_name = "PERCENT", default_value_t = 99.9, value_parser = number(|percent| (0.0..=100.0).contains(&percent), "give percent from 0 to 100, such as 99.9"))]
    lit: f64,
    /// Least distance of emitters from slits, mm
    #[arg(long, value_name = "MM", default_value_t = 1.0, value_parser = length())]
    clearance: f64,
    /// Largest radius of the head at the detectors' ends, mm
    #[arg(long, value_name = "MM", value_parser = length())]
    radius: Option<f64>,
    /// Share of the workspace in which all electrodes are below full scale, percent
    #[arg(long, value_name = "PERCENT", default_value_t = 99.5, value_parser = number(|percent| (0.0..=100.0).contains(&percent), "give percent from 0 to 100, such as 99.9"))]
    in_scale: f64,
    /// Seed of the candidates that are spread over the bounds
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Write the scene to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    jobs: Jobs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DemandName {
    /// That of half the workspace
    Median,
    /// The greatest of the workspace
    Worst,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    args.jobs.apply();
    // An impossible place is refused before the search.
    let output = Output::open(args.output.as_deref())?;
    let file = open_scene(&args.scene)?;
    let mut free: Vec<Free> = Vec::new();
    for one in &args.free {
        free.retain(|before| before.quantity != one.quantity);
        free.push(one.around(&file));
    }
    for outside in free.iter().filter(|free| !free.has(&file)) {
        let (quantity, [from, to]) = (outside.quantity, outside.bounds);
        talk(format_args!("{quantity} of the scene is outside {from}..{to}: the search begins at the nearer end"));
    }
    let demand = match args.demand {
        DemandName::Median => Demand::Median,
        DemandName::Worst => Demand::Worst,
    };
    let search = Search {
        file,
        free,
        goal: Goal { demand, lever_m: args.lever * 1e-3 },
        limits: Limits {
            lit: args.lit / 100.0,
            clearance_m: args.clearance * 1e-3,
            radius_m: args.radius.map_or(f64::INFINITY, |radius_mm| radius_mm * 1e-3),
            in_scale: args.in_scale / 100.0,
            ..Limits::default()
        },
        seed: args.seed,
    };
    let stop = interrupt()?;
    let total = search.evaluations() as u64;
    let mut progress = Progress::new("optimise", total, Amount::Of("heads"));
    let found =
        search.run(&mut |done, sigma_m| progress.step((done as u64).min(total), &sigma_text(sigma_m)), &stop)?;
    drop(progress);
    for (quantity, [before, after]) in &found.values {
        talk(format_args!("{quantity}: {before:.2} -> {after:.2} {}", quantity.unit()));
    }
    let said = |name: &str, file: &SceneFile, score: &Score| {
        let excesses: Vec<String> = score.excesses.iter().map(|excess| in_words(excess, file)).collect();
        let limits = match excesses.join("; ") {
            none if none.is_empty() => "all limits kept".to_owned(),
            excesses => format!("limits not kept: {excesses}"),
        };
        let at = format_args!("{} mm from the tool's centre", args.lever);
        talk(format_args!("{name}: σ {} of a point {at}, {limits}", sigma_text(score.sigma_m)));
    };
    said("before", &search.file, &found.before);
    said("after", &found.file, &found.after);
    talk(format_args!("{} heads looked at", found.evaluations));
    if found.is_interrupted {
        talk(format_args!("interrupted: this is the best so far; a search that is given it goes on from there"));
    }
    output.write_text(&found.file.source)?;
    Ok(if found.after.excesses.is_empty() { Outcome::Done } else { Outcome::Failed })
}

fn sigma_text(sigma_m: f64) -> String {
    if sigma_m.is_finite() { format!("{:.3} µm", sigma_m * 1e6) } else { "no σ".to_owned() }
}

/// An excess of the head in `file`, with the option that sets the limit, or with what the board cannot do.
fn in_words(excess: &Excess, file: &SceneFile) -> String {
    let option = match excess.limit {
        Limit::Lit => "--lit",
        Limit::Clearance => "--clearance",
        Limit::Radius => "--radius",
        Limit::InScale => "--in-scale",
        Limit::Board => {
            return configuration(file).err().map_or_else(|| excess.to_string(), |error| with_causes(&error));
        }
        Limit::Pose | Limit::DetectorPitch | Limit::EmitterPitch | Limit::Crosstalk => return excess.to_string(),
    };
    format!("{excess} ({option})")
}

fn length() -> impl Fn(&str) -> Result<f64, &'static str> + Clone + Send + Sync {
    number(|length_mm| length_mm >= 0.0 && length_mm.is_finite(), "give a length of zero or more in mm, such as 30")
}
