//! The page of threats names tests that exist, and the supply chain is what the page says.

use std::fs;
use std::path::{Path, PathBuf};

/// The project's folder.
fn project() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The text of all sources.
fn sources() -> String {
    let (mut text, mut folders) = (String::new(), vec![project()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let is_ours = !path.ends_with("target") && !path.ends_with(".git");
            if path.is_dir() && is_ours {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                text += &fs::read_to_string(path).expect("a text");
            }
        }
    }
    text
}

#[test]
fn every_threat_names_tests_that_exist() {
    let (sources, page) = (sources(), fs::read_to_string(project().join(".github/SECURITY.md")).expect("the page"));
    let rows: Vec<Vec<&str>> =
        page.lines().filter(|line| line.starts_with('|')).skip(2).map(|row| row.split('|').collect()).collect();
    assert!(rows.len() > 10, "{} threats", rows.len());
    for row in rows {
        let [_, _, threat, _, tests, targets, _] = row[..] else { panic!("a row of {} columns: {row:?}", row.len()) };
        let names = |column: &'static str, text: &str| -> Vec<String> {
            let names: Vec<_> = text.split('`').skip(1).step_by(2).map(str::to_owned).collect();
            assert!(!names.is_empty() || column == "targets", "no test against `{threat}`");
            names
        };
        for name in names("tests", tests) {
            assert!(sources.contains(&format!("fn {name}(")), "there is no test {name}");
        }
        for name in names("targets", targets) {
            assert!(slitpose_fuzz::TARGETS.iter().any(|target| target.name == name), "there is no target {name}");
        }
    }
}

#[test]
fn every_dependency_comes_from_the_registry() {
    for lock in ["Cargo.lock", "tests/fuzz/libfuzzer/Cargo.lock"] {
        let text = fs::read_to_string(project().join(lock)).expect(lock);
        let sources = text.lines().filter_map(|line| line.strip_prefix("source = "));
        for source in sources {
            assert_eq!(source, "\"registry+https://github.com/rust-lang/crates.io-index\"", "{lock}");
        }
        let packages: Vec<&str> = text.split("[[package]]").skip(1).collect();
        let unpinned =
            packages.iter().filter(|package| package.contains("source = ") && !package.contains("checksum = "));
        assert_eq!(unpinned.count(), 0, "{lock} has packages without a checksum");
    }
}
