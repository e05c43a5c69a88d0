//! Checks everything between a board and its poses, one part after the other.
//!
//! `link` finds and opens the board and compares it with its scene, `measurement` lets it measure for a while. `bring_up` walks through the steps for a new board. [`pack`] packs the findings for a report of
//! a fault. Only the schedule of the board is changed, and nothing is stored on it.

use std::io;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant, UNIX_EPOCH};

pub(crate) use bring_up::{BringUp, Step, continuity};
use flate2::Compression;
use flate2::write::GzEncoder;
use serde::Serialize;

use crate::device::{BoardInfo, Search, Selector};
use crate::platform::{SET_CLOCK, priority, synchronised, system};
use slitpose_head::causes::with_causes;
use slitpose_head::finding::Finding;
use slitpose_head::finding::Grade::{self, Failed, Warning};
use slitpose_head::front_end;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_tracking::clock::HostInstant;

mod bring_up;
mod link;
mod measurement;

/// Bytes per second assumed for a board that was not measured: 4 000 scans of 60 bytes.
const USUAL_BYTES_PER_S: f64 = 240e3;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    pub device: &'a Selector,
    pub search: &'a [Search],
    /// The scene of its head, if given by the user.
    pub scene: Option<&'a SceneFile>,
    pub folder: &'a Path,
    /// Duration of the measurement, device seconds.
    pub duration_s: f64,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Examination {
    /// The findings in the order of the checks.
    pub checks: Vec<Finding>,
    pub board: Option<BoardInfo>,
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

pub(crate) fn examine(subject: &Subject<'_>) -> Examination {
    let mut examination = Examination::default();
    let bytes_per_s = board(subject, &mut examination).unwrap_or(USUAL_BYTES_PER_S);
    examination.checks.extend(host_checks());
    examination.checks.extend(disk_checks(subject.folder, bytes_per_s));
    examination
}

/// Checks the board as far as possible; returns the bytes that it sends per second.
fn board(subject: &Subject<'_>, examination: &mut Examination) -> Option<f64> {
    let checks = &mut examination.checks;
    let reached = link::reach(subject, checks).unwrap_or_else(|finding| {
        checks.push(finding);
        None
    });
    let Some((mut board, info)) = reached else {
        checks.extend(["scene", "measurement"].map(|name| Finding::skipped(name, "no board to be asked")));
        return None;
    };
    let scene = link::scene(subject.scene, &info, checks);
    examination.board = Some(info.clone());
    let Some(scene) = scene else {
        checks.push(Finding::skipped("measurement", "the board belongs to another scene"));
        return None;
    };
    checks.push(link::full_scale(&scene, &info));
    let measured = front_end::configuration(&scene).map_err(anyhow::Error::from).and_then(|configuration| {
        measurement::measure(&mut board, &scene, configuration, subject.duration_s, &mut examination.bytes)
    });
    examination.scene = Some(scene);
    match measured {
        Ok(measurement) => {
            checks.extend(measurement.checks());
            measurement.bytes_per_s()
        }
        Err(error) => {
            let finding = with_causes(error.as_ref());
            checks.push(Finding::failed("measurement", finding, "reset the board and try again"));
            None
        }
    }
}

/// The default scene, for a simulated board without a given scene.
fn default_scene() -> Option<SceneFile> {
    WIDE.read().ok()
}

#[derive(Serialize)]
struct Report<'a> {
    slitpose: &'a str,
    utc_ns: u64,
    checks: &'a [Finding],
}

type Packed = (&'static str, &'static str);

/// Packs `examination` into `output`: a tar archive, compressed by gzip, without environment variables or names of users
/// or hosts. Returns what is in it, for the user who sends it.
pub(crate) fn pack<W: Write>(examination: &Examination, output: W) -> io::Result<(W, Vec<Packed>)> {
    let utc_ns = HostInstant::now().utc_ns;
    let report = Report { slitpose: env!("CARGO_PKG_VERSION"), utc_ns, checks: &examination.checks };
    let mut files = vec![
        ("report.txt", "the findings, as printed", examination.text().into_bytes()),
        ("report.json", "the same for programs, with the version of slitpose", serde_json::to_vec_pretty(&report)?),
        ("system.txt", "kind and version of this operating system and its kernel", system().into_bytes()),
    ];
    if let Some(board) = &examination.board {
        let hello = serde_json::to_vec_pretty(board)?;
        files.push(("hello.json", "what the board says of itself, with its serial number", hello));
    }
    if let Some(scene) = &examination.scene {
        files.push(("scene.toml", "the scene that was used, as a whole", scene.source.clone().into_bytes()));
    }
    if !examination.bytes.is_empty() {
        files.push(("stream.bin", "what the board sent while it measured", examination.bytes.clone()));
    }
    let mut archive = tar::Builder::new(GzEncoder::new(output, Compression::default()));
    for (name, _, bytes) in &files {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        header.set_mtime(utc_ns / 1_000_000_000);
        archive.append_data(&mut header, format!("slitpose-doctor/{name}"), &bytes[..])?;
    }
    let output = archive.into_inner()?.finish()?;
    Ok((output, files.into_iter().map(|(name, meaning, _)| (name, meaning)).collect()))
}

// The machine: its clock, permitted priorities, and the disk for recordings.

/// Start of 2026, before the first build: an earlier time is wrong.
const EARLIEST_UTC_NS: u64 = 1_767_225_600_000_000_000;

fn host_checks() -> [Finding; 3] {
    [of_date(HostInstant::now().utc_ns), of_synchronisation(synchronised().as_deref()), priority()]
}

/// A finding with the grade and the next step of the first of `faults` that is there; without one it is as it should be.
fn judged<const N: usize>(place: &'static str, text: String, faults: [(bool, Grade, &'static str); N]) -> Finding {
    named(place, text, &faults.map(|(is_there, grade, next_step)| (is_there, grade, "", next_step)))
}

/// As [`judged`], of faults with a name, which the text ends with.
fn named(place: &'static str, text: String, faults: &[(bool, Grade, &str, &'static str)]) -> Finding {
    match faults.iter().find(|(is_there, ..)| *is_there) {
        Some((_, grade, name, next_step)) => {
            let text = if name.is_empty() { text } else { format!("{text}: {name}") };
            Finding { next_step: Some((*next_step).into()), ..Finding::new(*grade, place, text) }
        }
        None => Finding::ok(place, text),
    }
}

/// The `findings` on parts that are not as they should be; if all are, one with `text`.
fn faulty_or(mut findings: Vec<Finding>, place: &'static str, text: impl FnOnce() -> String) -> Vec<Finding> {
    findings.retain(|finding| finding.grade != Grade::Ok);
    if findings.is_empty() { vec![Finding::ok(place, text())] } else { findings }
}

fn of_date(utc_ns: u64) -> Finding {
    let date = humantime::format_rfc3339_seconds(UNIX_EPOCH + Duration::from_nanos(utc_ns));
    let is_wrong = utc_ns < EARLIEST_UTC_NS;
    let wrong = if is_wrong { "the clock of this host is wrong: it says " } else { "" };
    judged("date", format!("{wrong}{date} (UTC)"), [(is_wrong, Warning, SET_CLOCK)])
}

fn of_synchronisation(said: Option<&str>) -> Finding {
    match said {
        Some("yes") => Finding::ok("clock", "synchronised to UTC"),
        Some("no") => Finding::warning(
            "clock",
            "not synchronised to UTC: dates of poses are as wrong as the clock; intervals are right",
            SET_CLOCK,
        ),
        _ => Finding::skipped("clock", "this system does not say whether its clock is synchronised"),
    }
}

/// Boards that one host records at once.
const BOARDS: f64 = 4.0;

/// Room for less than an hour is little; for less than a minute, none.
const LITTLE_S: f64 = 3600.0;
const NOTHING_S: f64 = 60.0;

/// Factor by which the rate must exceed the need: a disk that other programs use has slow moments.
const MARGIN: f64 = 5.0;

const TRIAL_BYTES: usize = 4 << 20;
const CHUNK_BYTES: usize = 64 << 10;

/// Checks the folder for recordings of boards with `bytes_per_s` each. The findings do not name it because reports are
/// shown to others.
fn disk_checks(folder: &Path, bytes_per_s: f64) -> [Finding; 2] {
    let needed = BOARDS * bytes_per_s;
    let room = match fs4::available_space(folder) {
        Ok(bytes) => of_room(bytes as f64, needed),
        Err(error) => Finding::failed("disk space", error.to_string(), "give a folder that exists with --folder"),
    };
    let rate = match write_rate(folder) {
        Ok(rate) => of_rate(rate, needed),
        Err(error) => {
            Finding::failed("disk rate", error.to_string(), "give a folder that may be written to with --folder")
        }
    };
    [room, rate]
}

fn of_room(free: f64, needed: f64) -> Finding {
    let seconds = free / needed;
    let text = format!("{:.1} GB free for recordings: {:.1} hours of four boards", free / 1e9, seconds / 3600.0);
    let next_step = "make room, or record elsewhere";
    judged("disk space", text, [(seconds < NOTHING_S, Failed, next_step), (seconds < LITTLE_S, Warning, next_step)])
}

fn of_rate(rate: f64, needed: f64) -> Finding {
    let text = format!("{:.1} MB/s written, four boards need {:.2} MB/s", rate / 1e6, needed / 1e6);
    let next_step = "record to a faster disk, or fewer boards";
    judged("disk rate", text, [(rate < needed, Failed, next_step), (rate < MARGIN * needed, Warning, next_step)])
}

/// Write rate of the disk, bytes per second.
fn write_rate(folder: &Path) -> io::Result<f64> {
    let mut file = tempfile::tempfile_in(folder)?;
    // Zeros could be written as a hole.
    let chunk = [0xa5; CHUNK_BYTES];
    let begun = Instant::now();
    for _ in 0..TRIAL_BYTES / CHUNK_BYTES {
        file.write_all(&chunk)?;
    }
    file.sync_all()?;
    Ok(TRIAL_BYTES as f64 / begun.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use slitpose_head::finding::Grade;
    use slitpose_head::finding::Grade::{Failed, Ok, Warning};

    #[test]
    fn a_clock_that_starts_in_1970_is_not_believed() {
        let wrong = of_date(86_399_000_000_000);
        assert_eq!(wrong.grade, Warning);
        assert_eq!(wrong.text, "the clock of this host is wrong: it says 1970-01-01T23:59:59Z (UTC)");
        let right = of_date(EARLIEST_UTC_NS);
        assert_eq!((right.grade, right.text.as_str()), (Ok, "2026-01-01T00:00:00Z (UTC)"));
        let verdicts = [Some("yes"), Some("no"), Some(""), None].map(|said| of_synchronisation(said).grade);
        assert_eq!(verdicts, [Ok, Warning, Grade::Skipped, Grade::Skipped]);
    }

    #[test]
    fn room_and_rate_are_compared_with_the_need_of_four_boards() {
        let needed = 1e6;
        assert_eq!([3.7e9, 3.5e9, 59e6].map(|free| of_room(free, needed).grade), [Ok, Warning, Failed]);
        assert_eq!([5.1e6, 4.9e6, 0.9e6].map(|rate| of_rate(rate, needed).grade), [Ok, Warning, Failed]);
    }

    #[test]
    fn a_folder_that_is_not_there_takes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let [room, _] = disk_checks(folder.path(), 1.0);
        assert_eq!(room.grade, Ok, "{room}");
        assert!(write_rate(folder.path()).unwrap() > 0.0);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "left behind");
        let gone = folder.path().join("gone");
        assert_eq!(disk_checks(&gone, 1.0).map(|check| check.grade), [Failed, Failed]);
    }
}
