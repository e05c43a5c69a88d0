//! Checks everything between a board and its poses, one part after the other.
//!
//! `link` finds and opens the board and compares it with its scene, `measurement` lets it measure for a while, `host`
//! checks the machine. `bring_up` walks through the steps for a new board. A [`Bundle`] packs the findings for a report of
//! a fault. Only the schedule of the board is changed, and nothing is stored on it.

mod bring_up;
mod host;
mod link;
mod measurement;

use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use flate2::Compression;
use flate2::write::GzEncoder;
use serde::Serialize;
use slitpose_head::causes::with_causes;
use slitpose_head::finding::Finding;
use slitpose_head::scene_file::{SceneFile, WIDE};

pub(crate) use bring_up::{BringUp, Step, scene as scene_of_bring_up};

use crate::device::{BoardInfo, Search, Selector};
use slitpose_tracking::clock::HostInstant;

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
    examination.checks.extend(host::checks());
    examination.checks.extend(host::disk_checks(subject.folder, bytes_per_s));
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
    let scene = link::scene(subject.scene, &info, checks);
    examination.board = Some(info.clone());
    let Some(scene) = scene else {
        checks.push(Finding::skipped("measurement", "the board belongs to another scene"));
        return None;
    };
    checks.push(link::full_scale(&scene, &info));
    let measured = measurement::measure(&mut board, &scene, subject.duration_s, &mut examination.bytes);
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

/// The findings, as files, without environment variables or names of users or hosts.
#[derive(Debug)]
pub(crate) struct Bundle {
    files: Vec<(&'static str, &'static str, Vec<u8>)>,
    utc_ns: u64,
}

#[derive(Serialize)]
struct Report<'a> {
    slitpose: &'a str,
    utc_ns: u64,
    checks: &'a [Finding],
}

impl Bundle {
    /// The files of `examination`; those without content are left out.
    pub(crate) fn of(examination: &Examination) -> io::Result<Self> {
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
        Ok(Self { files, utc_ns })
    }

    /// Name and meaning of each file, for the user who sends the bundle.
    pub(crate) fn contents(&self) -> impl Iterator<Item = (&'static str, &'static str)> + '_ {
        self.files.iter().map(|(name, meaning, _)| (*name, *meaning))
    }

    /// Writes all to `output`: a tar archive, compressed by gzip.
    pub(crate) fn write<W: Write>(&self, output: W) -> io::Result<W> {
        let mut archive = tar::Builder::new(GzEncoder::new(output, Compression::default()));
        for (name, _, bytes) in &self.files {
            let mut header = tar::Header::new_gnu();
            header.set_size(bytes.len() as u64);
            header.set_mode(0o644);
            header.set_mtime(self.utc_ns / 1_000_000_000);
            archive.append_data(&mut header, format!("slitpose-doctor/{name}"), &bytes[..])?;
        }
        archive.into_inner()?.finish()
    }
}

fn system() -> String {
    let release = fs::read_to_string("/etc/os-release").unwrap_or_else(|_| "no /etc/os-release\n".to_owned());
    // Without -n: the name of the host is private.
    let kernel = Command::new("uname").args(["-s", "-r", "-v", "-m"]).stdin(Stdio::null()).output();
    let kernel = kernel.map_or_else(
        |error| format!("no uname: {error}\n"),
        |kernel| String::from_utf8_lossy(&kernel.stdout).into_owned(),
    );
    format!("{kernel}{release}")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::io::Read;

    use flate2::read::GzDecoder;
    use slitpose_head::scene_file::WIDE;

    use super::*;

    fn unpacked(examination: &Examination) -> BTreeMap<String, Vec<u8>> {
        let packed = Bundle::of(examination).unwrap().write(Vec::new()).unwrap();
        let mut files = BTreeMap::new();
        for entry in tar::Archive::new(GzDecoder::new(&packed[..])).entries().unwrap() {
            let mut entry = entry.unwrap();
            let name = entry.path().unwrap().display().to_string();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            files.insert(name.trim_start_matches("slitpose-doctor/").to_owned(), bytes);
        }
        files
    }

    #[test]
    fn a_bundle_holds_the_findings_and_no_other_file() {
        let names = |examination| unpacked(examination).into_keys().collect::<Vec<_>>();
        let mut examination = Examination { checks: vec![Finding::ok("scene", "fits")], ..Examination::default() };
        assert_eq!(names(&examination), ["report.json", "report.txt", "system.txt"]);
        examination.scene = WIDE.read().ok();
        examination.bytes = vec![1, 2, 0, 3];
        let files = unpacked(&examination);
        assert_eq!(files["scene.toml"], WIDE.text.as_bytes());
        assert_eq!(files["stream.bin"], [1, 2, 0, 3]);
        let report: serde_json::Value = serde_json::from_slice(&files["report.json"]).unwrap();
        assert_eq!((&report["checks"][0]["name"], &report["checks"][0]["verdict"]), (&"scene".into(), &"ok".into()));
        assert_eq!(report["slitpose"], env!("CARGO_PKG_VERSION"));
    }
}
