//! Room and speed of the disk for recordings.

use std::io::{self, Write};
use std::path::Path;
use std::time::Instant;

use nix::sys::statvfs::statvfs;

use slitpose_head::finding::Finding;

/// Boards that one host records at once.
const BOARDS: f64 = 4.0;

/// Room for less than an hour is little; for less than a minute, none.
const LITTLE_S: f64 = 3600.0;
const NOTHING_S: f64 = 60.0;

/// Factor by which the rate must exceed the need: a disk that other programs use has slow moments.
const MARGIN: f64 = 5.0;

/// Bytes written as a trial.
const TRIAL_BYTES: usize = 4 << 20;
const CHUNK_BYTES: usize = 64 << 10;

/// Checks the folder for recordings of boards with `bytes_per_s` each. The findings do not name it because reports are
/// shown to others.
pub(super) fn checks(folder: &Path, bytes_per_s: f64) -> [Finding; 2] {
    let needed = BOARDS * bytes_per_s;
    let room = match statvfs(folder) {
        Ok(disk) => of_room(disk.blocks_available() as f64 * disk.fragment_size() as f64, needed),
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
    let finding = format!("{:.1} GB free for recordings: {:.1} hours of four boards", free / 1e9, seconds / 3600.0);
    if seconds >= LITTLE_S {
        Finding::ok("disk space", finding)
    } else if seconds >= NOTHING_S {
        Finding::warning("disk space", finding, "make room, or record elsewhere")
    } else {
        Finding::failed("disk space", finding, "make room, or record elsewhere")
    }
}

fn of_rate(rate: f64, needed: f64) -> Finding {
    let finding = format!("{:.1} MB/s written, four boards need {:.2} MB/s", rate / 1e6, needed / 1e6);
    if rate >= MARGIN * needed {
        Finding::ok("disk rate", finding)
    } else if rate >= needed {
        Finding::warning("disk rate", finding, "record to a faster disk, or fewer boards")
    } else {
        Finding::failed("disk rate", finding, "record to a faster disk, or fewer boards")
    }
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
    use super::*;
    use slitpose_head::finding::Grade::{Failed, Ok, Warning};

    #[test]
    fn room_and_rate_are_compared_with_the_need_of_four_boards() {
        let needed = 1e6;
        assert_eq!([3.7e9, 3.5e9, 59e6].map(|free| of_room(free, needed).grade), [Ok, Warning, Failed]);
        assert_eq!([5.1e6, 4.9e6, 0.9e6].map(|rate| of_rate(rate, needed).grade), [Ok, Warning, Failed]);
    }

    #[test]
    fn a_folder_that_is_not_there_takes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let [room, _] = checks(folder.path(), 1.0);
        assert_eq!(room.grade, Ok, "{room}");
        assert!(write_rate(folder.path()).unwrap() > 0.0);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "left behind");
        let gone = folder.path().join("gone");
        assert_eq!(checks(&gone, 1.0).map(|check| check.grade), [Failed, Failed]);
    }
}
