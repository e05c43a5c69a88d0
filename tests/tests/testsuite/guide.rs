//! Documents do what they say and point to what is there.
//!
//! Every command of `host/guide` is run, in the order of the page, and prints what the page shows:
//!
//! | block | what happens with it |
//! |---|---|
//! | `sh` | runs in bash, in one shell a chapter, in a folder that is empty at first, with `-euo pipefail` |
//! | `text` | is what the `sh` block before it prints; `…` is any text, and any lines where it stands alone |
//! | with a name, as `python ring.py` | becomes that file |
//! | `console` | needs hardware or more rights: verbs and options of its commands must exist |
//! | others | nothing |
#![cfg(target_os = "linux")]

use std::fs;
use std::os::unix::fs::symlink;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;
use slitpose_tests::process::{name_in, names};
use slitpose_tests::slitpose;
use slitpose_tests::table::data;

/// Chapters take seconds. One that waits for what does not come ends as a failure, also on a busy machine.
const PATIENCE: Duration = Duration::from_secs(300);

/// Any text within a line, any lines where it stands alone.
const ANYTHING: &str = "…";

#[derive(Clone, Debug, PartialEq, Eq)]
struct Block {
    /// Line of the page where its fence opens, from 1.
    line: usize,
    language: String,
    /// Second word of the fence.
    file: Option<String>,
    text: Vec<String>,
}

fn guide() -> PathBuf {
    data("../../host/guide")
}

fn page(name: &str) -> String {
    fs::read_to_string(guide().join(name)).unwrap_or_else(|error| panic!("host/guide/{name}: {error}"))
}

fn blocks(page: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut is_open = false;
    for (line, text) in (1..).zip(page.lines()) {
        match (text.strip_prefix("```"), is_open) {
            (Some(_), true) => is_open = false,
            (Some(words), false) => {
                let mut words = words.split(' ');
                let language = words.next().unwrap_or_default().to_owned();
                blocks.push(Block { line, language, file: words.next().map(str::to_owned), text: Vec::new() });
                is_open = true;
            }
            (None, true) => blocks.last_mut().expect("is open").text.push(text.to_owned()),
            (None, false) => {}
        }
    }
    assert!(!is_open, "the last block has no end");
    blocks
}

/// A script whose lines have the numbers they have on the page. Each `sh` block writes to `outputs`/LINE.
fn script(blocks: &[Block], outputs: &Path) -> String {
    let mut script = String::new();
    let mut lines = 1;
    for block in blocks {
        let (open, close) = match (&block.file, block.language.as_str()) {
            (Some(file), _) => (format!("cat >{file} <<'```'"), "```"),
            (None, "sh") => (format!("exec >{}/{} 2>&1", outputs.display(), block.line), ""),
            (None, _) => continue,
        };
        script += &"\n".repeat(block.line - lines);
        let text = [&[open], &block.text[..], &[close.to_owned()]].concat();
        lines = block.line + text.len();
        text.iter().for_each(|line| script += &format!("{line}\n"));
    }
    script
}

/// Whether `line` is `pattern`, in which `…` stands for any text.
fn line_fits(pattern: &str, line: &str) -> bool {
    let Some((start, rest)) = pattern.split_once(ANYTHING) else { return pattern == line };
    let Some(line) = line.strip_prefix(start) else { return false };
    let places = line.char_indices().map(|(place, _)| place).chain([line.len()]);
    places.into_iter().any(|place| line_fits(rest, &line[place..]))
}

/// The number of lines of `shown` that fit `printed` from its start on; all of them if everything fits.
fn fitting(shown: &[String], printed: &[&str]) -> usize {
    match shown.split_first() {
        None => 0,
        Some((first, rest)) if first == ANYTHING => {
            if rest.is_empty() {
                return 1;
            }
            1 + (0..=printed.len()).map(|start| fitting(rest, &printed[start..])).max().expect("one at least")
        }
        Some((first, rest)) => match printed.split_first() {
            Some((line, more)) if line_fits(first.trim_end(), line.trim_end()) => {
                let fits = 1 + fitting(rest, more);
                // Something is printed that is not shown.
                if rest.is_empty() && !more.is_empty() { 0 } else { fits }
            }
            _ => 0,
        },
    }
}

/// Runs the chapter `name` and says what is wrong with it.
fn run(name: &str, page: &str) -> Result<(), String> {
    let folder = tempfile::tempdir().expect("temporary folder");
    let [programs, work, outputs] = ["programs", "work", "outputs"].map(|part| folder.path().join(part));
    for part in [&programs, &work, &outputs] {
        fs::create_dir(part).expect("a folder");
    }
    symlink(slitpose!().path(), programs.join("slitpose")).expect("a link");
    let blocks = blocks(page);
    let file = folder.path().join(name);
    fs::write(&file, script(&blocks, &outputs)).expect("a script");
    let path = std::env::var("PATH").expect("a path");
    let mut shell = Command::new("bash")
        .args(["-euo", "pipefail"])
        .arg(&file)
        .current_dir(&work)
        .env("PATH", format!("{}:{path}", programs.display()))
        .env("SOURCE", data("../.."))
        .env("SLITPOSE_CONFIG", "none")
        .env("NO_COLOR", "1")
        .stdin(Stdio::null())
        .process_group(0)
        .spawn()
        .expect("bash starts");
    let group = Pid::from_raw(i32::try_from(shell.id()).expect("an id"));
    let since = Instant::now();
    let status = loop {
        if let Some(status) = shell.try_wait().expect("a child") {
            break Some(status);
        }
        if since.elapsed() > PATIENCE {
            break None;
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    // What a chapter left running.
    let _ = killpg(group, Signal::SIGKILL);

    let output = |block: &Block| fs::read(outputs.join(block.line.to_string())).ok();
    let commands = || blocks.iter().filter(|block| block.language == "sh" && block.file.is_none());
    let place = |line: usize| format!("host/guide/{name}:{line}");
    if status.is_none_or(|status| !status.success()) {
        let last = commands().rfind(|block| output(block).is_some());
        let printed = last.and_then(output).unwrap_or_default();
        let printed = String::from_utf8_lossy(&printed);
        let what = status.map_or_else(|| format!("did not end in {PATIENCE:?}"), |status| status.to_string());
        return Err(format!("{}: {what}\nThe block prints:\n{printed}", place(last.map_or(1, |block| block.line))));
    }
    let mut before: Option<&Block> = None;
    for block in blocks.iter().filter(|block| block.file.is_none()) {
        match (block.language.as_str(), before) {
            ("sh", _) => before = Some(block),
            ("text", Some(command)) => {
                let printed = String::from_utf8(output(command).expect("it ran")).expect("UTF-8");
                let fits = fitting(&block.text, &printed.lines().collect::<Vec<_>>());
                if fits < block.text.len() {
                    return Err(format!(
                        "{}: is not what the commands of line {} print:\n    {}\nThey print:\n{printed}",
                        place(block.line + 1 + fits),
                        command.line,
                        block.text[fits]
                    ));
                }
            }
            ("text", None) => return Err(format!("{}: no commands before this output", place(block.line))),
            _ => {}
        }
    }
    Ok(())
}

macro_rules! works {
    ($($test:ident: $chapter:literal,)*) => {
        const CHAPTERS: &[&str] = &[$($chapter),*];

        $(#[test]
        fn $test() {
            run($chapter, &page($chapter)).unwrap_or_else(|complaint| panic!("{complaint}"));
        })*
    };
}

works! {
    the_designer_gets_a_head: "designer.md",
    the_designer_gets_a_better_head: "accuracy.md",
    a_head_is_made_and_calibrated_with_its_jig: "build.md",
    the_bench_engineer_finds_the_faults: "bench.md",
    a_raw_head_becomes_a_calibrated_one: "calibration.md",
    poses_are_given_in_a_frame_and_at_the_tip: "frame.md",
    the_lab_user_gets_recordings_and_tables: "lab.md",
    other_instruments_are_on_the_clock_of_the_poses: "sync.md",
    the_application_writer_closes_a_loop: "application.md",
    a_loop_reads_shared_memory: "memory.md",
    the_analyst_judges_poses: "analyst.md",
    faults_are_injected_and_seen: "faults.md",
    an_uncalibrated_head_has_its_first_light: "first_light.md",
    published_instruments_are_predicted: "instruments.md",
}

#[test]
fn every_chapter_is_in_the_index_and_is_run() {
    let index = page("README.md");
    for name in names(&guide()).into_iter().filter(|name| name.ends_with(".md") && name != "README.md") {
        assert!(index.contains(&format!("]({name})")), "host/guide/README.md does not list {name}");
        assert!(CHAPTERS.contains(&name.as_str()), "no test runs {name}");
        let lines = page(&name).lines().count();
        assert!(lines <= 135, "{name} has {lines} lines");
    }
}

#[test]
fn commands_that_are_not_run_exist() {
    for name in CHAPTERS {
        for block in blocks(&page(name)).iter().filter(|block| block.language == "console") {
            for (line, text) in (block.line + 1..).zip(&block.text) {
                let Some(command) = text.strip_prefix("$ slitpose ") else { continue };
                let words: Vec<_> = command.split('#').next().unwrap_or_default().split_whitespace().collect();
                let verbs = words.iter().take_while(|word| !word.starts_with('-'));
                let help = slitpose!().run(verbs.chain([&"--help"]));
                assert_eq!(help.code, 0, "host/guide/{name}:{line}: {text}\n{}", help.stderr);
                let help = String::from_utf8(help.stdout).expect("UTF-8");
                for option in words.iter().filter(|word| word.starts_with("--")) {
                    assert!(help.contains(&format!("{option} ")), "host/guide/{name}:{line}: no {option}");
                }
            }
        }
    }
}

#[test]
fn what_a_page_gets_wrong_is_told_with_its_line() {
    let page = "# Page\n\n```python ring.py\nprint('ring')\n```\n\n```sh\nside=3\npython3 ring.py\n```\n\n\
                ```text\nring\n```\n\n```sh\necho \"side $side\"\ntrue\n```\n\n```text\n…\nside …\n```\n";
    assert_eq!(run("page.md", page), Ok(()));
    for (from, to, line) in [
        ("true", "cat missing | sort", 16),
        ("```text\nring", "```text\nrong", 13),
        ("…\nside …", "side 3\nand more", 23),
        ("…\nside …", "…\nsite …", 23),
        ("print('ring')", "print('ring\\nrang')", 13),
    ] {
        let told = run("page.md", &page.replace(from, to)).expect_err(to);
        assert!(told.starts_with(&format!("host/guide/page.md:{line}: ")), "{told}");
    }
}

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
