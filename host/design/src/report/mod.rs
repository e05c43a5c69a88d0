//! Error against run time, and numerically difficult cases: `slitpose report`.
//!
//! [`study`] measures one scene and gives a [`Report`]: sections with tables and pictures. Each
//! section has its own file; a [`Folder`] stores the report. Errors are reproducible
//! to the last digit for a seed, times are what the machine gave.
//!
//! * `head` and `noise` supply poses, currents and their noise; `method` the ways to solve;
//!   `attainable` is the best accuracy of a pose at all;
//! * `forward`, `solver`, `economy` and `stiff` are the sections;
//! * `calibration` is the report on a calibration, `map` that on accuracy over the workspace,
//!   `comparison` that on several heads, `pareto` that on their size;
//! * `section` has their parts; `page`, `markdown`, `folder` write it.

mod accuracy;
mod attainable;
mod calibration;
mod comparison;
mod conditions;
mod economy;
mod error;
mod folder;
mod forward;
mod head;
mod map;
mod markdown;
mod method;
mod noise;
mod page;
mod pareto;
mod section;
mod sheet;
mod solver;
mod stiff;
mod stopwatch;

pub use calibration::calibration_report;
pub use comparison::comparison;
pub(crate) use conditions::{program, scene};
pub use error::ReportError;
pub use folder::Folder;
pub use map::map_report;
pub use pareto::{pareto, scene_name};
pub use section::{Column, Report, Section, Table, Value};
pub(crate) use section::{Picture, column};

use head::Head;
pub(crate) use head::frame_scene;
use slitpose_head::scene_file::SceneFile;

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
    /// Rounds of timing.
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

/// Makes a section.
type Measure = fn(&Head<'_>, &Settings) -> Result<Section, ReportError>;

/// Studies `file`. `progress` gets the title of each section before it begins.
///
/// # Errors
/// If the scene gives no poses to study.
pub fn study(file: &SceneFile, settings: &Settings, mut progress: impl FnMut(&str)) -> Result<Report, ReportError> {
    let head = Head::of(file, settings)?;
    let mut measure = |title: &str, section: Measure| {
        progress(title);
        section(&head, settings)
    };
    let sections = vec![
        measure(forward::TITLE, forward::section)?,
        measure(solver::TITLE, solver::section)?,
        measure(economy::TITLE, economy::section)?,
        measure(stiff::TITLE, stiff::section)?,
    ];
    Ok(Report {
        title: "Error against run time",
        scene: file.name.clone(),
        conditions: conditions::conditions(file, settings),
        warnings: conditions::warnings(),
        sections,
        leading: 1,
        data: Vec::new(),
    })
}
