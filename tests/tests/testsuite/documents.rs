//! Documents point to what is there: links lead to files and headings, what the page of the architecture names can be
//! found by searching, threats have tests, pictures are what the program draws; and dependencies come from the registry.

use std::fs;
use std::path::{Path, PathBuf};

use slitpose_tests::process::name_in;
use slitpose_tests::reference::data;
use slitpose_tests::slitpose;

/// All files of the project whose names end so.
fn files(endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![fs::canonicalize(data("../..")).expect("the project")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
            if path.is_dir() {
                if name != "target" && name != ".git" {
                    folders.push(path);
                }
            } else if endings.iter().any(|ending| name.ends_with(ending)) {
                found.push(path);
            }
        }
    }
    found
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Lines of a page outside its blocks of code, with their numbers.
fn prose(page: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut is_code = false;
    (1..).zip(page.lines()).filter(move |(_, line)| {
        let is_fence = line.starts_with("```");
        is_code ^= is_fence;
        !is_code && !is_fence
    })
}

/// The anchor that a heading gets: letters and digits in lower case, hyphens for spaces.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.flat_map(char::to_lowercase).map(|c| if c == ' ' { '-' } else { c }).collect()
}

#[test]
fn links_lead_somewhere() {
    let mut links = 0;
    let mut wrong = Vec::new();
    for page in files(&[".md"]) {
        let text = read(&page);
        for (line, words) in prose(&text) {
            for target in words.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
                if target.contains("://") {
                    continue;
                }
                links += 1;
                let (file, heading) = target.split_once('#').unwrap_or((target, ""));
                let leads_to = if file.is_empty() { page.clone() } else { page.with_file_name(file) };
                let is_there = leads_to.exists()
                    && (heading.is_empty()
                        || prose(&read(&leads_to))
                            .any(|(_, line)| line.starts_with('#') && anchor(line.trim_start_matches('#')) == heading));
                if !is_there {
                    wrong.push(format!("{}:{line}: {target}", page.display()));
                }
            }
        }
    }
    assert!(links > 50, "only {links} links found");
    assert!(wrong.is_empty(), "nothing is there:\n{}", wrong.join("\n"));
}

#[test]
fn the_architecture_names_what_can_be_found() {
    let sources: Vec<_> =
        files(&[".rs", ".h", ".toml"]).into_iter().map(|path| (path.display().to_string(), read(&path))).collect();
    let page = read(&data("../../.github/ARCHITECTURE.md"));
    let names = page.split('`').skip(1).step_by(2).filter(|name| {
        name.contains('_') || name.starts_with(char::is_uppercase) || name.contains('/') || name.ends_with(".rs")
    });
    let mut count = 0;
    for name in names.filter(|name| !name.contains(['\n', '…']) && !name.starts_with("/")) {
        count += 1;
        let is_found = data("../..").join(name).exists()
            || sources.iter().any(|(path, text)| path.ends_with(&format!("/{name}")) || text.contains(name));
        assert!(is_found, "ARCHITECTURE.md names `{name}`, which is nowhere");
    }
    assert!(count > 20, "only {count} names");
}

#[test]
fn the_first_page_is_short() {
    let lines = read(&data("../../README.md")).lines().count();
    assert!(lines <= 120, "README.md has {lines} lines");
}

#[test]
fn every_threat_names_tests_that_exist() {
    let sources: String = files(&[".rs"]).iter().map(|path| read(path)).collect();
    let page = read(&data("../../.github/SECURITY.md"));
    let rows: Vec<Vec<&str>> =
        page.lines().filter(|line| line.starts_with('|')).skip(2).map(|row| row.split('|').collect()).collect();
    assert!(rows.len() > 10, "{} threats", rows.len());
    for row in rows {
        let [_, _, threat, _, tests, targets, _] = row[..] else { panic!("a row of {} columns: {row:?}", row.len()) };
        let names = |text: &str| -> Vec<String> { text.split('`').skip(1).step_by(2).map(str::to_owned).collect() };
        assert!(!names(tests).is_empty(), "no test against `{threat}`");
        for name in names(tests) {
            assert!(sources.contains(&format!("fn {name}(")), "there is no test {name}");
        }
        for name in names(targets) {
            assert!(data("../fuzz/corpus").join(&name).is_dir(), "there is no fuzz target {name}");
        }
    }
}

#[test]
fn every_dependency_comes_from_the_registry() {
    for lock in ["../../Cargo.lock", "../fuzz/libfuzzer/Cargo.lock"] {
        let text = read(&data(lock));
        for source in text.lines().filter_map(|line| line.strip_prefix("source = ")) {
            assert_eq!(source, "\"registry+https://github.com/rust-lang/crates.io-index\"", "{lock}");
        }
        let unpinned = text.split("[[package]]").filter(|it| it.contains("source = ") && !it.contains("checksum = "));
        assert_eq!(unpinned.count(), 0, "{lock} has packages without a checksum");
    }
}

#[test]
fn the_readme_shows_what_the_program_draws() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let drawn = name_in(folder.path(), "drawn.svg");
    for (name, arguments) in [
        ("wide.svg", ["scene", "plot", "wide", "--pose", "1.5,-1,2,0,4,8"].as_slice()),
        ("cell.svg", &["scene", "plot", "bench", "--cell", "0", "--pose", "2,0,0,0,0,0"]),
    ] {
        slitpose!().run(arguments.iter().chain(&["--output", &drawn])).done();
        let is_shown = read(&data("../../host/pictures").join(name)) == read(Path::new(&drawn));
        assert!(is_shown, "{name}: draw it anew with `slitpose {}`", arguments.join(" "));
    }
}
