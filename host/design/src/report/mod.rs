//! Error against run time, and what happens where numbers get difficult: `slitpose report`.
//!
//! [`study`] measures one scene and gives a [`Report`]: sections with tables and pictures. What a
//! section says stands in its own file; a [`Folder`] takes it. Errors are reproducible
//! to the last digit for a seed, times are what the machine gave.
//!
//! * `head` and `noise` supply poses, currents and their noise; `method` the ways to solve;
//!   `attainable` says how exact a pose can be at all;
//! * `forward`, `solver`, `cycles`, `economy`, `motion` and `stiff` are the sections;
//! * `section` is what they are made of; `page`, `markdown`, `folder` write it.

mod accuracy;
mod attainable;
mod conditions;
mod cycles;
mod economy;
mod error;
mod folder;
mod forward;
mod head;
mod markdown;
mod method;
mod motion;
mod noise;
mod page;
mod section;
mod sheet;
mod singular;
mod solver;
mod stiff;
mod stopwatch;

use std::path::PathBuf;

pub use error::ReportError;
pub use folder::Folder;
pub use section::{Column, Report, Section, Table, Value};

use head::Head;
use slitpose_head::scene_file::SceneFile;

/// Poses of a full study unless told otherwise: rms errors are known to 1 % or so.
pub const POSES: usize = 1000;

/// Poses of a quick one: to 4 %.
pub const QUICK_POSES: usize = 100;

/// What a study is asked for.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Poses of the workspace.
    pub poses: usize,
    /// Seed of the noise.
    pub seed: u64,
    /// Fewer rounds and frames.
    pub quick: bool,
    /// Table of cycles on the board; `None`: the program that makes it is looked for.
    pub cycles: Option<PathBuf>,
}

impl Settings {
    /// Rounds of timing.
    fn rounds(&self) -> usize {
        if self.quick { 5 } else { 21 }
    }

    /// Poses that are timed: the first so many.
    fn timed_poses(&self) -> usize {
        self.poses.min(if self.quick { 50 } else { 200 })
    }
}

/// Sections of a study.
pub const SECTIONS: u64 = 6;

/// What makes a section.
type Measure = fn(&Head<'_>, &Settings) -> Result<Section, ReportError>;

/// Studies `file`. `progress` is told the title of each section before it begins.
///
/// # Errors
/// If the scene gives no poses to study, or a table of cycles cannot be read.
pub fn study(file: &SceneFile, settings: &Settings, mut progress: impl FnMut(&str)) -> Result<Report, ReportError> {
    let head = Head::of(file, settings)?;
    // What somebody else has counted is read first: nothing is measured in vain if it is damaged.
    progress(cycles::TITLE);
    let cycles = cycles::section(&head, settings)?;
    let mut measure = |title: &str, section: Measure| {
        progress(title);
        section(&head, settings)
    };
    let mut sections = vec![measure(forward::TITLE, forward::section)?, measure(solver::TITLE, solver::section)?];
    sections.push(cycles);
    sections.push(measure(economy::TITLE, economy::section)?);
    sections.push(measure(motion::TITLE, motion::section)?);
    sections.push(measure(stiff::TITLE, stiff::section)?);
    Ok(Report {
        scene: file.name.clone(),
        conditions: conditions::conditions(file, settings),
        warnings: conditions::warnings(),
        sections,
    })
}
