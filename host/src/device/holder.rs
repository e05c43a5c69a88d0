//! Programs that have a port open.

use std::fs;
use std::path::Path;

use super::ports::real_path;

/// A program that has a port open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Holder {
    /// Number of its process.
    pub process: u32,
    /// Its name, as the system shortens it.
    pub program: String,
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} (process {})", self.program, self.process)
    }
}

/// The programs that have the port `name` open, on Linux only, and without those of other users, whose open files
/// are hidden. Reads every open file of the system.
pub(crate) fn holders(name: &str) -> Vec<Holder> {
    let port = real_path(name);
    let Ok(processes) = fs::read_dir("/proc") else {
        return Vec::new();
    };
    let number = |entry: fs::DirEntry| entry.file_name().to_str()?.parse().ok();
    let mut holders: Vec<_> = processes
        .flatten()
        .filter_map(number)
        .filter(|process| has_open(*process, &port))
        .map(|process| Holder { process, program: program(process) })
        .collect();
    holders.sort_by_key(|holder| holder.process);
    holders
}

fn has_open(process: u32, port: &Path) -> bool {
    let Ok(files) = fs::read_dir(format!("/proc/{process}/fd")) else {
        return false;
    };
    files.flatten().any(|file| fs::read_link(file.path()).is_ok_and(|target| target == port))
}

fn program(process: u32) -> String {
    let name = fs::read_to_string(format!("/proc/{process}/comm")).unwrap_or_default();
    name.trim_end().to_owned()
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn an_open_file_has_a_holder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("port");
        let name = path.to_str().unwrap();
        let file = fs::File::create(&path).unwrap();
        assert!(holders(name).iter().any(|holder| holder.process == std::process::id()));
        drop(file);
        assert_eq!(holders(name), []);
    }
}
