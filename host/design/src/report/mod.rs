//! Error against run time, and numerically difficult cases: `slitpose report`.
//!
//! [`study`] measures one scene and gives a [`Report`]: sections with tables and pictures. Each
//! section has its own file; a [`Folder`] stores the report. Errors are reproducible
//! to the last digit for a seed, times are what the machine gave.
//!
//! * `head` supplies poses, currents and their noise; `solver` the ways to solve;
//! * `solver`, `economy` and `stiff` are the sections;
//! * `calibration` is the report on a calibration, `map` those on accuracy over the workspace;
//! * `section` has their parts; `write` makes files of them.

mod calibration;
mod economy;
mod head;
mod map;
mod section;
mod solver;
mod stiff;
mod write;

use std::fs;

use slitpose_head::scene_file::SceneFile;

use crate::DesignError;

pub use calibration::calibration_report;
pub(crate) use head::{currents, frame_scene};
pub use map::{comparison, map_report};
pub(crate) use section::{Picture, Section, Sheet, Value, program, scene};
pub use section::{Report, Table};
pub use write::Folder;

use head::Head;

/// Default number of poses of a full study: rms errors are known to 1 % or so.
pub const POSES: usize = 1000;

/// Poses of a quick one: to 4 %.
pub const QUICK_POSES: usize = 100;

/// Settings of a study.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Poses of the workspace.
    pub poses: usize,
    /// Seed of the noise.
    pub seed: u64,
    /// Fewer rounds and frames.
    pub quick: bool,
}

impl Settings {
    fn rounds(&self) -> usize {
        if self.quick { 5 } else { 21 }
    }

    /// How many poses are timed, from the first on.
    fn timed_poses(&self) -> usize {
        self.poses.min(if self.quick { 50 } else { 200 })
    }
}

/// Sections of a study.
pub const SECTIONS: u64 = 3;

type Measure = fn(&Head, &Settings) -> Result<Section, DesignError>;

/// Studies `file`. `progress` gets the title of each section before it begins.
pub fn study(file: &SceneFile, settings: &Settings, mut progress: impl FnMut(&str)) -> Result<Report, DesignError> {
    let head = Head::of(file, settings)?;
    let mut sections = Vec::new();
    let measures: [(&str, Measure); SECTIONS as usize] =
        [(solver::TITLE, solver::section), (economy::TITLE, economy::section), (stiff::TITLE, stiff::section)];
    for (title, section) in measures {
        progress(title);
        sections.push(section(&head, settings)?);
    }
    Ok(Report {
        title: "Error against run time",
        scene: file.name.clone(),
        conditions: conditions(file, settings),
        warnings: warnings(),
        sections,
        data: Vec::new(),
    })
}

fn conditions(file: &SceneFile, settings: &Settings) -> Vec<(&'static str, String)> {
    let checks = if cfg!(debug_assertions) { "debug" } else { "release" };
    let counts = format!(
        "{} poses spread evenly over the workspace with every cell lit, the same ones every time; {} rounds of \
         timing, least and median shown",
        settings.poses,
        settings.rounds()
    );
    vec![
        program(),
        scene(file),
        ("processor", processor()),
        ("build", format!("{checks}, {} {}", std::env::consts::ARCH, std::env::consts::OS)),
        ("threads", "one".to_owned()),
        ("seed", settings.seed.to_string()),
        ("counts", counts),
        ("data", "computed by the model and disturbed by computed noise; nothing was measured".to_owned()),
    ]
}

fn warnings() -> Vec<String> {
    let slow = "This program was built with debug checks: its times say little. Build it with `cargo build --release`.";
    cfg!(debug_assertions).then(|| slow.to_owned()).into_iter().collect()
}

/// As the system calls it, where it does.
fn processor() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let text = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let line =
        ["model name", "Model", "CPU part"].iter().find_map(|key| text.lines().find(|line| line.starts_with(key)));
    let name = line.and_then(|line| line.split_once(':')).map_or("unknown", |(_, name)| name.trim());
    format!("{name}, {cores} of its cores usable")
}
