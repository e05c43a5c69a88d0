//! What `firmware/build` has made, and whether it is what the sources would make now.
//!
//! Beside an image lies `NAME.sources`: for each file the image was made from the line that POSIX
//! `cksum` prints. An image that is older than one of them would be tested in place of what is
//! written, so it is not run.

use std::path::{Path, PathBuf};

use crc::{CRC_32_CKSUM, Crc};
use thiserror::Error;

/// The root of the project, to which paths of sources are relative.
fn project() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Where `firmware/build` puts the image `name`: in the target directory of the environment, or that
/// of the sources this was built from.
pub(crate) fn image_path(name: &str) -> PathBuf {
    // Relative to the project, as for firmware/build.
    let target = std::env::var_os("CARGO_TARGET_DIR").filter(|target| !target.is_empty());
    let target = project().join(target.map_or_else(|| PathBuf::from("target"), PathBuf::from));
    target.join("firmware/thumbv7em-none-eabihf/firmware").join(name)
}

/// Why an image is not that of the sources.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("the image {} is out of date: {change}; run {build} again", image.display())]
pub struct StaleError {
    /// The image.
    image: PathBuf,
    change: Change,
    /// What makes it.
    build: &'static str,
}

#[derive(Debug, Error, PartialEq, Eq)]
enum Change {
    #[error("its last build did not end")]
    NoRecord,
    #[error("{0} has changed since")]
    Source(String),
}

/// Checks that `image`, which `build` has made, is not older than any of its sources.
///
/// # Errors
/// The first source that is not as it was.
pub(crate) fn check(image: &Path, build: &'static str) -> Result<(), StaleError> {
    changed_since(image, &project()).map_err(|change| StaleError { image: image.to_owned(), change, build })
}

fn changed_since(image: &Path, project: &Path) -> Result<(), Change> {
    let record = std::fs::read_to_string(image.with_extension("sources")).map_err(|_| Change::NoRecord)?;
    let mut sources = record.lines().peekable();
    // Never of nothing.
    sources.peek().ok_or(Change::NoRecord)?;
    for line in sources {
        let mut words = line.splitn(3, ' ');
        let (Some(sum), Some(_), Some(source)) = (words.next(), words.next(), words.next()) else {
            return Err(Change::NoRecord);
        };
        let is_same = std::fs::read(project.join(source)).is_ok_and(|bytes| cksum(&bytes).to_string() == sum);
        if !is_same {
            return Err(Change::Source(source.to_owned()));
        }
    }
    Ok(())
}

/// The checksum of POSIX `cksum`: a CRC of the bytes and of their number, least significant byte first,
/// without the zeros at its end.
fn cksum(bytes: &[u8]) -> u32 {
    static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_CKSUM);
    let length = bytes.len().to_le_bytes();
    let used = length.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
    let mut digest = CRC.digest();
    digest.update(bytes);
    digest.update(&length[..used]);
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    /// Against the system's own `cksum`, over files of every kind of length.
    #[test]
    fn an_image_is_refused_when_any_of_its_sources_has_changed() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let image = folder.path().join("image");
        assert_eq!(changed_since(&image, folder.path()), Err(Change::NoRecord));
        let sources = [("empty", 0), ("one byte", 1), ("a longer one", 300), ("longest", 70_000)];
        for (name, bytes) in sources {
            std::fs::write(folder.path().join(name), vec![0x5a; bytes]).expect("written");
        }
        let names = sources.map(|(name, _)| name);
        let record = Command::new("cksum").args(names).current_dir(folder.path()).output().expect("POSIX has it");
        std::fs::write(folder.path().join("image.sources"), record.stdout).expect("written");
        assert_eq!(changed_since(&image, folder.path()), Ok(()));
        for (name, bytes) in sources {
            let source = folder.path().join(name);
            let mut changed = vec![0x5a; bytes];
            changed.pop();
            changed.push(0x5b);
            let error = Err(Change::Source(name.to_owned()));
            std::fs::write(&source, &changed).expect("written");
            assert_eq!(changed_since(&image, folder.path()), error);
            std::fs::remove_file(&source).expect("removed");
            assert_eq!(changed_since(&image, folder.path()), error);
            std::fs::write(&source, vec![0x5a; bytes]).expect("written");
        }
        std::fs::write(folder.path().join("image.sources"), "").expect("written");
        assert_eq!(changed_since(&image, folder.path()), Err(Change::NoRecord));
    }

    #[test]
    fn the_error_names_what_changed_and_what_to_run() {
        let (image, change) = ("some/image".into(), Change::Source("firmware/src/board.rs".to_owned()));
        let text = StaleError { image, change, build: "firmware/build" }.to_string();
        for part in ["some/image", "firmware/src/board.rs", "run firmware/build"] {
            assert!(text.contains(part), "{text}");
        }
    }
}
