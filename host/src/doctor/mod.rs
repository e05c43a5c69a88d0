//! Checks everything between a board and its poses, one part after the other.
//!
//! `link` finds and opens the board, `head` compares it with its scene, `measurement` lets it measure for a while,
//! `host` and `disk` check the machine. `bring_up` walks through the steps for a new board. A [`Bundle`] packs the findings for a report of a fault. Only the schedule of
//! the board is changed, and nothing is stored on it.

mod bring_up;
mod bundle;
mod disk;
mod head;
mod host;
mod link;
mod measurement;

use std::path::Path;

pub(crate) use bring_up::{BringUp, Step, scene as scene_of_bring_up};
pub(crate) use bundle::Bundle;

use crate::device::{BoardInfo, Search, Selector};
use slitpose_head::causes::with_causes;
use slitpose_head::finding::Finding;
use slitpose_head::scene_file::{SceneFile, WIDE};

/// Bytes per second assumed for a board that was not measured: 4 000 scans of 60 bytes.
const USUAL_BYTES_PER_S: f64 = 240e3;

/// The subject of an examination.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    /// The board.
    pub device: &'a Selector,
    /// Additional places to search for it.
    pub search: &'a [Search],
    /// The scene of its head, if given by the user.
    pub scene: Option<&'a SceneFile>,
    /// The folder for recordings.
    pub folder: &'a Path,
    /// Duration of the measurement, device seconds.
    pub duration_s: f64,
}

/// The findings.
#[derive(Clone, Debug, Default)]
pub(crate) struct Examination {
    /// The findings in the order of the checks.
    pub checks: Vec<Finding>,
    /// The board's hello.
    pub board: Option<BoardInfo>,
    /// The scene of the measurement.
    pub scene: Option<SceneFile>,
    /// The bytes that the board sent during the measurement.
    pub bytes: Vec<u8>,
}

impl Examination {
    /// The findings for people: one line per check, and one for the next step if there is one.
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

/// Checks the board as far as possible; returns the bytes that it sends per second.
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
            let finding = with_causes(&error);
            checks.push(Finding::failed("measurement", finding, "reset the board and try again"));
            None
        }
    }
}

/// The default scene, for a simulated board without a given scene.
fn default_scene() -> Option<SceneFile> {
    WIDE.read().ok()
}
