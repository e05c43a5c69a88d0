//! The findings in one file, for a report of a fault.

use std::fs;
use std::io::{self, Write};
use std::process::{Command, Stdio};

use flate2::Compression;
use flate2::write::GzEncoder;
use serde::Serialize;

use super::Examination;
use crate::clock::HostInstant;
use slitpose_head::finding::Finding;

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
    ///
    /// # Errors
    /// If the findings cannot be written as JSON, which does not happen.
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
    ///
    /// # Errors
    /// Errors of `output`.
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

/// Operating system and kernel.
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

    use super::*;
    use slitpose_head::scene_file::WIDE;

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
