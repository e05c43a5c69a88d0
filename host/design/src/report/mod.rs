//! Error against run time, and numerically difficult cases: `slitpose report`.
//!
//! [`study`] measures one scene and gives a [`Report`]: sections with tables and pictures. Each
//! section has its own file; a [`Folder`] stores the report. Errors are reproducible
//! to the last digit for a seed, times are what the machine gave.
//!
//! * `head` supplies poses, currents and their noise; `solver` the ways to solve;
//! * `forward`, `solver`, `economy` and `stiff` are the sections;
//! * `calibration` is the report on a calibration, `map` that on accuracy over the workspace,
//!   `heads` those on several heads;
//! * `section` has their parts; `write` makes files of them.

mod calibration;
mod economy;
mod forward;
mod head;
mod heads;
mod map;
mod section;
mod solver;
mod stiff;
mod write;

use std::fs;

use slitpose_head::front_end::TimingError;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::SceneError;
use thiserror::Error;

pub use calibration::calibration_report;
pub(crate) use head::frame_scene;
pub use heads::{comparison, pareto, scene_name};
pub use map::map_report;
pub use section::{Column, Picture, Report, Section, Table, Value};
pub(crate) use section::{column, program, scene};
pub use write::Folder;

use head::Head;

/// Why a scene cannot be studied.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum ReportError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("{0}")]
    Poses(String),
    #[error(transparent)]
    Timing(#[from] TimingError),
}

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
pub const SECTIONS: u64 = 4;

type Measure = fn(&Head<'_>, &Settings) -> Result<Section, ReportError>;

/// Studies `file`. `progress` gets the title of each section before it begins.
pub fn study(file: &SceneFile, settings: &Settings, mut progress: impl FnMut(&str)) -> Result<Report, ReportError> {
    let head = Head::of(file, settings)?;
    let mut sections = Vec::new();
    let measures: [(&str, Measure); SECTIONS as usize] = [
        (forward::TITLE, forward::section),
        (solver::TITLE, solver::section),
        (economy::TITLE, economy::section),
        (stiff::TITLE, stiff::section),
    ];
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
        leading: 1,
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

fn processor() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let name = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| model_name(&text));
    format!("{}, {cores} of its cores usable", name.as_deref().unwrap_or("unknown"))
}

fn model_name(cpuinfo: &str) -> Option<String> {
    let value = |key: &str| {
        let line = cpuinfo.lines().find(|line| line.starts_with(key))?;
        Some(line.split_once(':')?.1.trim().to_owned()).filter(|value| !value.is_empty())
    };
    value("model name").or_else(|| value("Model")).or_else(|| value("CPU part"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_processor_is_called_what_the_system_calls_it() {
        let x86 = "processor\t: 0\nvendor_id\t: A\nmodel name\t: Some CPU @ 2 GHz\n";
        assert_eq!(model_name(x86).as_deref(), Some("Some CPU @ 2 GHz"));
        assert_eq!(model_name("CPU part\t: 0xd0b\n").as_deref(), Some("0xd0b"));
        assert_eq!(model_name("nothing"), None);
        assert!(!processor().is_empty());
    }
}
