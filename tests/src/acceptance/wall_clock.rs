//! A wall clock that can be set: a library for `LD_PRELOAD`, made here by the C compiler, and the file that it reads.

use std::fs;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::process::Command;

use tempfile::TempDir;

const SOURCE: &str = include_str!("wall_clock.c");

/// The wall clock of the processes that it is preloaded into.
#[derive(Debug)]
pub struct WallClock {
    folder: TempDir,
    file: fs::File,
}

impl WallClock {
    /// One that goes right.
    ///
    /// # Panics
    /// Without a C compiler.
    pub fn make() -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let [source, library, ahead] = ["wall_clock.c", "wall_clock.so", "ahead"].map(|name| folder.path().join(name));
        fs::write(&source, SOURCE).expect("room");
        let made = Command::new("cc").args(["-shared", "-fPIC", "-O2", "-o"]).arg(&library).arg(&source).status();
        assert!(made.is_ok_and(|status| status.success()), "cc makes {}", library.display());
        fs::write(&ahead, 0_i64.to_ne_bytes()).expect("room");
        let file = fs::OpenOptions::new().write(true).open(&ahead).expect("just written");
        Self { folder, file }
    }

    /// The environment of a process that goes by it.
    pub fn environment(&self) -> [(&'static str, PathBuf); 2] {
        let path = |name| self.folder.path().join(name);
        [("LD_PRELOAD", path("wall_clock.so")), ("SLITPOSE_WALL_CLOCK", path("ahead"))]
    }

    /// Sets it ahead of the right time, or behind it.
    ///
    /// # Panics
    /// If its file is gone.
    pub fn set_ahead(&self, nanoseconds: i64) {
        self.file.write_all_at(&nanoseconds.to_ne_bytes(), 0).expect("a file of eight bytes");
    }
}
