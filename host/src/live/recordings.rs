//! Captures in the folder of the recordings, which pages list, fetch, rename and play.

use std::collections::VecDeque;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, Weak};
use std::thread::{self, JoinHandle};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Serialize;
use slitpose_head::causes::with_causes;
use slitpose_head::threads::lock;
use slitpose_tracking::capture::contents;
use slitpose_tracking::measurements::Measurements;
use slitpose_tracking::page::{CalibrationState, Refusal};
use tokio::sync::mpsc::{Receiver, WeakSender};

use super::control::Control;
use super::hub::{Input, LiveInput};
use super::server::Shared;

const ENDING: &str = ".mcap";

/// Most captures that are listed, the newest.
const MAX_LISTED: usize = 100;

/// Most captures that are played at a time: each takes some per cent of a processor at its own speed.
const MAX_PLAYED: usize = 4;

/// Most downloads that have been asked for and may begin.
const MAX_TICKETS: usize = 64;

/// Plays a capture to the pages of the input until that is closed; returns what takes their orders.
pub(crate) type Play = Box<dyn Fn(PathBuf, LiveInput) -> io::Result<Control> + Send + Sync>;

/// Calibrates a head from measurements and writes the result to a new file. While it runs it reports its progress, in per
/// cent and in words; at the end it returns its findings, a sentence each.
pub(crate) type Calibrate =
    Arc<dyn Fn(&Measurements, &Path, &mut dyn FnMut(u64, String)) -> anyhow::Result<Vec<String>> + Send + Sync>;

pub(crate) struct Recordings {
    folder: PathBuf,
    play: Play,
    calibrate: Calibrate,
    /// The calibration under way, or the last one.
    calibration: Mutex<Option<JoinHandle<()>>>,
    /// Paths that may be fetched, once each, by the secret beside them.
    tickets: Mutex<VecDeque<(String, PathBuf)>>,
    played: Mutex<Vec<Played>>,
}

/// A capture being played.
struct Played {
    path: PathBuf,
    /// What its pages share.
    shared: Weak<Shared>,
    /// Gone when the player has ended.
    input: WeakSender<Input>,
}

/// A capture as it is listed.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Recording {
    name: String,
    bytes: u64,
    /// Seconds since 1970.
    modified_s: Option<f64>,
    is_recorded: bool,
    /// What follows is known of captures that were ended.
    length_s: Option<f64>,
    boards: Vec<String>,
    notes: u64,
}

impl Recordings {
    pub(crate) fn new(folder: PathBuf, play: Play, calibrate: Calibrate) -> Self {
        let folder = if folder.as_os_str().is_empty() { PathBuf::from(".") } else { folder };
        let (calibration, tickets, played) = (Mutex::default(), Mutex::default(), Mutex::default());
        Self { folder, play, calibrate, calibration, tickets, played }
    }

    /// Begins to calibrate the head from captures, by what each is of, on a thread of its own that tells `shared`.
    pub(super) fn calibrate(&self, shared: &Arc<Shared>, captures: [&[String]; 4]) -> Result<(), Refusal> {
        let paths = |names: &[String]| {
            let path = |name: &String| Ok(self.path(name)?.to_string_lossy().into_owned());
            names.iter().map(path).collect::<Result<Vec<_>, Refusal>>()
        };
        let [free, pivot, stage, rest] = captures.map(paths);
        let measurements =
            Measurements { free: free?, pivot: pivot?, stage: stage?, rest: rest?, ..Measurements::default() };
        let mut calibration = lock(&self.calibration);
        if calibration.as_ref().is_some_and(|thread| !thread.is_finished()) {
            return Err(refused("a calibration is under way already; wait until it has ended".to_owned()));
        }
        let path = self.folder.join(format!("calibration-{}.toml", now_in_a_name()));
        let file = path.display().to_string();
        let (shared, calibrate) = (Arc::clone(shared), Arc::clone(&self.calibrate));
        let tell = move |state, done, file: &str, said| {
            let file = file.to_owned();
            shared.hub.accept(Input::Calibration(CalibrationState { state, done, file, said }));
        };
        let run = move || {
            tell("running", 0, "", vec!["reading the recordings".to_owned()]);
            match calibrate(&measurements, &path, &mut |done, text| tell("running", done, "", vec![text])) {
                Ok(found) => tell("done", 100, &file, found),
                Err(error) => tell("failed", 100, "", vec![with_causes(error.as_ref()).to_string()]),
            }
        };
        let begun = thread::Builder::new().name("calibrate".to_owned()).spawn(run);
        *calibration =
            Some(begun.map_err(|error| refused(format!("no thread for the calibration: {error}; try again")))?);
        Ok(())
    }

    /// The folder, as far as it can be told.
    pub(super) fn folder(&self) -> String {
        fs::canonicalize(&self.folder).as_ref().unwrap_or(&self.folder).display().to_string()
    }

    /// The newest captures first. Reads the end of each.
    pub(super) fn list(&self) -> Result<Vec<Recording>, Refusal> {
        let mut found = Vec::new();
        for entry in fs::read_dir(&self.folder).map_err(|error| unusable(&self.folder, &error))?.flatten() {
            let name = entry.file_name().into_string().unwrap_or_default();
            if let (true, Ok(metadata)) = (is_name(&name), entry.metadata())
                && metadata.is_file()
            {
                let modified = metadata.modified().ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok());
                found.push((modified, name, metadata.len()));
            }
        }
        found.sort_by(|one, other| other.cmp(one));
        found.truncate(MAX_LISTED);
        let recording = |(modified, name, bytes): (Option<Duration>, String, u64)| {
            let path = self.folder.join(&name);
            let known = contents(&path).ok().flatten();
            let known = known.as_ref();
            Recording {
                bytes,
                modified_s: modified.map(|at| at.as_secs_f64()),
                is_recorded: known.is_none() && is_recorded(&path),
                length_s: known.map(|known| known.length_s),
                boards: known.map_or(Vec::new(), |known| known.boards.iter().map(ToString::to_string).collect()),
                notes: known.map_or(0, |known| known.notes),
                name,
            }
        };
        Ok(found.into_iter().map(recording).collect())
    }

    /// The capture called `name`, which is there.
    fn path(&self, name: &str) -> Result<PathBuf, Refusal> {
        let path = self.folder.join(check(name)?);
        match fs::symlink_metadata(&path) {
            Ok(metadata) if metadata.is_file() => Ok(path),
            Ok(_) => Err(refused(format!("{name} is no regular file"))),
            Err(error) => Err(unusable(&path, &error)),
        }
    }

    pub(super) fn rename(&self, name: &str, to: &str) -> Result<(), Refusal> {
        let (from, to) = (self.path(name)?, self.folder.join(check(to)?));
        if is_recorded(&from) {
            return Err(refused(format!("{name} is being recorded; end the recording first")));
        }
        if fs::symlink_metadata(&to).is_ok() {
            return Err(refused(format!("{} is there already; choose another name", to.display())));
        }
        fs::rename(&from, &to).map_err(|error| unusable(&from, &error))?;
        // Another file may get the old name.
        lock(&self.tickets).retain(|(_, path)| *path != from);
        lock(&self.played).iter_mut().filter(|played| played.path == from).for_each(|played| {
            played.shared = Weak::new();
        });
        Ok(())
    }

    /// Lets the capture called `name` be fetched; returns the path of its address.
    pub(super) fn ticket(&self, name: &str) -> Result<String, Refusal> {
        let path = self.path(name)?;
        let mut secret = [0; 16];
        getrandom::fill(&mut secret).map_err(|error| refused(format!("the system gives no random number: {error}")))?;
        let secret: String = secret.iter().map(|byte| format!("{byte:02x}")).collect();
        let mut tickets = lock(&self.tickets);
        if tickets.len() == MAX_TICKETS {
            tickets.pop_front();
        }
        tickets.push_back((secret.clone(), path));
        Ok(format!("/recordings/{secret}"))
    }

    /// The path that may be fetched by `secret`.
    pub(super) fn fetched_by(&self, secret: &str) -> Option<PathBuf> {
        let mut tickets = lock(&self.tickets);
        let at = tickets.iter().position(|(own, _)| own == secret)?;
        tickets.remove(at).map(|(_, path)| path)
    }

    /// The state that all pages of the capture called `name` share. The first page starts the player, and `begin` makes the
    /// state of what takes its orders and of what it shows.
    pub(super) fn played(
        &self,
        name: &str,
        begin: impl FnOnce(Control, Receiver<Input>) -> Arc<Shared>,
    ) -> Result<Arc<Shared>, Refusal> {
        let path = self.path(name)?;
        let mut played = lock(&self.played);
        played.retain(|played| played.input.strong_count() > 0);
        if let Some(shared) = played.iter().filter(|of| of.path == path).find_map(|of| of.shared.upgrade()) {
            return Ok(shared);
        }
        if played.len() >= MAX_PLAYED {
            return Err(refused(format!("{MAX_PLAYED} captures are being played already; close the page of one")));
        }
        let (input, inputs) = LiveInput::new();
        let weak = input.downgrade();
        let control = (self.play)(path.clone(), input).map_err(|error| unusable(&path, &error))?;
        let shared = begin(control, inputs);
        played.push(Played { path, shared: Arc::downgrade(&shared), input: weak });
        Ok(shared)
    }
}

/// The time as it stands in names of files: UTC, to the second.
pub(crate) fn now_in_a_name() -> String {
    humantime::format_rfc3339_seconds(SystemTime::now()).to_string().replace(':', "")
}

fn refused(reason: String) -> Refusal {
    Refusal::Recording { reason }
}

fn unusable(path: &Path, error: &io::Error) -> Refusal {
    refused(format!("{}: {error}; list the recordings again", path.display()))
}

/// Whether captures have such names: those of files in the folder itself.
fn is_name(name: &str) -> bool {
    // Nor letters that hide, or turn the writing round.
    let is_hidden = |letter: char| letter.is_control() || ('\u{200b}'..='\u{206f}').contains(&letter);
    let is_plain = |letter: char| !is_hidden(letter) && !r#"/\:*?"<>|"#.contains(letter);
    name.len() > ENDING.len()
        && name.len() <= 200
        && name.ends_with(ENDING)
        && !name.starts_with(['.', ' '])
        && name.chars().all(is_plain)
}

fn check(name: &str) -> Result<&str, Refusal> {
    let hint = "give the name of a file that ends in .mcap, without a folder";
    is_name(name).then_some(name).ok_or_else(|| refused(format!("`{name}` is no name of a capture; {hint}")))
}

fn is_recorded(path: &Path) -> bool {
    File::open(path).is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_captures_of_the_folder_are_listed_fetched_and_renamed() {
        let outer = tempfile::tempdir().unwrap();
        let folder = outer.path().join("captures");
        fs::create_dir(&folder).unwrap();
        fs::create_dir(folder.join("folder.mcap")).unwrap();
        for name in ["captures/a.mcap", "captures/b.mcap", "captures/notes.txt", "captures/.hidden.mcap", "secret.mcap"]
        {
            fs::write(outer.path().join(name), "no capture").unwrap();
        }
        let recordings = Recordings::new(
            folder.clone(),
            Box::new(|_, _| Err(io::ErrorKind::Unsupported.into())),
            Arc::new(|_, _, _| Ok(Vec::new())),
        );
        let names = || {
            let mut names: Vec<_> = recordings.list().unwrap().into_iter().map(|of| of.name).collect();
            names.sort();
            names
        };
        assert_eq!(names(), ["a.mcap", "b.mcap"]);
        let list = recordings.list().unwrap();
        assert!(list.iter().all(|of| of.length_s.is_none() && !of.is_recorded && of.bytes == 10), "{list:?}");
        for name in [
            "../secret.mcap",
            "/etc/passwd",
            "notes.txt",
            ".hidden.mcap",
            "folder.mcap",
            "c.mcap",
            "",
            ".mcap",
            "\u{202e}.mcap",
        ] {
            assert!(recordings.ticket(name).is_err(), "{name}");
            assert!(recordings.rename(name, "d.mcap").is_err(), "{name}");
        }
        for to in ["b.mcap", "../d.mcap", "d", "a/d.mcap", "d\n.mcap", "folder.mcap"] {
            assert!(recordings.rename("a.mcap", to).is_err(), "{to}");
        }
        let locked = File::options().write(true).open(folder.join("b.mcap")).unwrap();
        locked.lock().unwrap();
        let refused = recordings.rename("b.mcap", "d.mcap").unwrap_err().to_string();
        assert!(refused.contains("b.mcap is being recorded"), "{refused}");
        assert!(recordings.list().unwrap().iter().all(|of| of.is_recorded == (of.name == "b.mcap")));
        recordings.rename("a.mcap", "steps 2.mcap").unwrap();
        assert_eq!(names(), ["b.mcap", "steps 2.mcap"]);
        let address = recordings.ticket("steps 2.mcap").unwrap();
        let secret = address.strip_prefix("/recordings/").unwrap();
        assert_eq!(recordings.fetched_by(secret), Some(folder.join("steps 2.mcap")));
        assert_eq!(recordings.fetched_by(secret), None, "it is used up");
        let address = recordings.ticket("steps 2.mcap").unwrap();
        recordings.rename("steps 2.mcap", "steps.mcap").unwrap();
        assert_eq!(recordings.fetched_by(address.strip_prefix("/recordings/").unwrap()), None, "it has another name");
    }
}
