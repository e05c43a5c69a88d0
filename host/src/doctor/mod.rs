//! Checks everything between a board and its poses, one part after the other.
//!
//! `link` finds and opens the board, `head` compares it with its scene, `measurement` lets it measure for a while,
//! `host` and `disk` check the machine. A [`Bundle`] packs the findings for a report of a fault. Only the schedule of
//! the board is changed, and nothing is stored on it.

mod bundle;
mod disk;
mod head;
mod host;
mod link;
mod measurement;

use std::path::Path;

pub(crate) use bundle::Bundle;

use crate::device::{BoardInfo, Search, Selector};
use slitpose_head::finding::{Finding, Grade};
use slitpose_head::scene_file::{SceneFile, WIDE};

/// What a board sends a second until it has been measured: 4 000 scans of 60 bytes.
const USUAL_BYTES_PER_S: f64 = 240e3;

/// What is to be checked.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    /// Which board.
    pub device: &'a Selector,
    /// Where to look for it, too.
    pub search: &'a [Search],
    /// The scene of its head, if the user says so.
    pub scene: Option<&'a SceneFile>,
    /// Where recordings go.
    pub folder: &'a Path,
    /// How long it measures, device seconds.
    pub duration_s: f64,
}

/// The findings.
#[derive(Clone, Debug, Default)]
pub(crate) struct Examination {
    /// In the order they were made.
    pub checks: Vec<Finding>,
    /// The board's hello.
    pub board: Option<BoardInfo>,
    /// The scene it was measured by.
    pub scene: Option<SceneFile>,
    /// The bytes it sent while it measured.
    pub bytes: Vec<u8>,
}

impl Examination {
    /// How many findings are of `grade`.
    pub(crate) fn count(&self, grade: Grade) -> usize {
        self.checks.iter().filter(|check| check.grade == grade).count()
    }

    /// For people: a line a check, and a line for the next step where there is one.
    pub(crate) fn text(&self) -> String {
        self.checks.iter().map(|check| format!("{check:#}\n")).collect()
    }
}

/// Checks everything.
pub(crate) fn examine(subject: &Subject<'_>) -> Examination {
    let mut examination = Examination::default();
    let bytes_per_s = board(subject, &mut examination).unwrap_or(USUAL_BYTES_PER_S);
    examination.checks.extend(host::checks());
    examination.checks.extend(disk::checks(subject.folder, bytes_per_s));
    examination
}

/// Checks the board as far as possible; gives the bytes that it sends in a second.
fn board(subject: &Subject<'_>, examination: &mut Examination) -> Option<f64> {
    let checks = &mut examination.checks;
    let reached = link::reach(subject, checks);
    let Some((mut board, info)) = reached else {
        checks.extend(["scene", "measurement"].map(|name| Finding::skipped(name, "no board to be asked")));
        return None;
    };
    let scene = head::scene(subject.scene, &info, checks);
    examination.board = Some(info.clone());
    let Some(scene) = scene else {
        checks.push(Finding::skipped("measurement", "the board belongs to another scene"));
        return None;
    };
    checks.push(head::full_scale(&scene, &info));
    let measured = measurement::measure(&mut board, &scene, subject.duration_s, &mut examination.bytes);
    examination.scene = Some(scene);
    match measured {
        Ok(measurement) => {
            checks.extend(measurement.checks());
            measurement.bytes_per_s()
        }
        Err(error) => {
            let finding = link::in_full(&error);
            checks.push(Finding::failed("measurement", finding, "reset the board and try again"));
            None
        }
    }
}

/// The default scene, for a board made of it.
fn default_scene() -> Option<SceneFile> {
    WIDE.read().ok()
}
