//! The options of `run` from flags, environment and file, as a process sees them; scripts for shells, and a page
//! for each verb.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use slitpose_tests::process::{Finished, text};
use slitpose_tests::slitpose;
use tempfile::TempDir;

/// A place for configuration files, and for a home without one.
struct Bench(TempDir);

impl Bench {
    fn new() -> Self {
        Self(TempDir::new().expect("temporary folder"))
    }

    fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("folder");
        fs::write(&path, text).expect("file");
        path
    }

    /// `slitpose run` with nothing in the environment that could configure it.
    fn run(&self, environment: &[(&str, &str)], arguments: &[&str]) -> Finished {
        let mut command = slitpose!().command(["run"].iter().chain(arguments));
        let inherited = std::env::vars_os().map(|(name, _)| name);
        for name in inherited.filter(|name| name.to_string_lossy().starts_with("SLITPOSE_")) {
            command.env_remove(name);
        }
        command.env("XDG_CONFIG_HOME", self.0.path()).envs(environment.iter().copied());
        command.output().expect("slitpose runs").into()
    }

    fn printed(&self, environment: &[(&str, &str)], arguments: &[&str]) -> String {
        let arguments = [arguments, &["--print-config"]].concat();
        self.run(environment, &arguments).done()
    }
}

/// The line of an option in a printed configuration.
fn line<'a>(printed: &'a str, option: &str) -> &'a str {
    let is_of = |line: &&str| line.trim_start_matches("# ").starts_with(&format!("{option} = "));
    printed.lines().find(is_of).unwrap_or_else(|| panic!("no `{option}` in:\n{printed}"))
}

/// What a printed configuration says, without where it comes from.
fn values(printed: &str) -> Vec<&str> {
    let lines = printed.lines().filter(|line| !line.starts_with("# with"));
    lines.map(|line| line.rsplit_once("  # ").expect("a source").0).collect()
}

#[test]
fn a_flag_counts_before_the_environment_before_the_file_before_the_default() {
    let bench = Bench::new();
    let file = bench.file("some.toml", "device = 'sim'\nseed = 5\nwithout_clipped = true\nscene = ['base']\n");
    let file = text(&file);
    let unconfigured = bench.printed(&[], &["--config", "none"]);
    assert_eq!(line(&unconfigured, "device"), r#"device = ["auto"]  # default"#);
    assert_eq!(line(&unconfigured, "seed"), r#"# seed = "1"  # default"#);
    assert_eq!(line(&unconfigured, "without_clipped"), "without_clipped = false  # default");

    let configured = bench.printed(&[], &["--config", file]);
    assert!(configured.starts_with(&format!("# with {file}\n")), "{configured}");
    assert_eq!(line(&configured, "device"), r#"device = ["sim"]  # file"#);
    assert_eq!(line(&configured, "seed"), r#"seed = "5"  # file"#);
    assert_eq!(line(&configured, "without_clipped"), "without_clipped = true  # file");
    assert_eq!(line(&configured, "record_poses"), r#"record_poses = "25"  # default"#);

    let environment = [("SLITPOSE_DEVICE", "a,b"), ("SLITPOSE_SEED", "6"), ("SLITPOSE_CONFIG", file)];
    let from_environment = bench.printed(&environment, &[]);
    assert_eq!(line(&from_environment, "device"), r#"device = ["a", "b"]  # environment"#);
    assert_eq!(line(&from_environment, "seed"), r#"seed = "6"  # environment"#);
    assert_eq!(line(&from_environment, "scene"), r#"scene = ["base"]  # file"#);

    let flagged = bench.printed(&environment, &["--seed", "7"]);
    assert_eq!(line(&flagged, "seed"), r#"seed = "7"  # flag"#);
    assert_eq!(line(&flagged, "device"), r#"device = ["a", "b"]  # environment"#);
    assert_eq!(line(&flagged, "scene"), r#"scene = ["base"]  # file"#);
    // A flag may ask for another file than the environment, and for none.
    assert_eq!(line(&bench.printed(&environment, &["--config", "none"]), "scene"), r#"scene = ["wide"]  # default"#);
}

#[test]
fn the_users_own_file_is_found() {
    let bench = Bench::new();
    bench.file("slitpose/config.toml", "seed = 9\n");
    assert_eq!(line(&bench.printed(&[], &[]), "seed"), r#"seed = "9"  # file"#);
}

#[test]
fn what_is_printed_configures_the_same() {
    let bench = Bench::new();
    let odd_path = "a \"quoted\\ fol'der/\u{e9}\u{7f}.mcap";
    let flags = [
        &["--device", "sim", "--device", "sim", "--scene", "base", "--duration", "1500ms", "--format", "csv"][..],
        &["--filter", "5ms", "--without-clipped", "--tier", "exact", "--tolerance", "1e-7", "--record", odd_path],
        &["--overwrite", "--record-size", "500MB", "--record-poses", "0", "--publish", "unix:a,udp:127.0.0.1:0"],
        &["--status", "127.0.0.1:0", "--patience", "forever", "--real-time", "50", "--speed", "max", "--seed", "3"],
    ]
    .concat();
    for flags in [&flags[..], &[]] {
        let printed = bench.printed(&[], flags);
        let file = bench.file("printed.toml", &printed);
        let again = bench.printed(&[], &["--config", text(&file)]);
        assert_eq!(values(&again), values(&printed));
        assert!(!again.contains("# flag"), "{again}");
    }
}

#[test]
fn what_counts_without_being_given_is_printed() {
    let printed = Bench::new().printed(&[], &[]);
    assert!(!printed.contains("\"\""), "an empty value: {printed}");
    for line in ["# tier = \"exact\"  # default", "# tolerance = \"1e-6\"  # default", "# seed = \"1\"  # default"] {
        assert!(printed.lines().any(|printed| printed == line), "{line}: {printed}");
    }
    for beginning in
        ["# patience: forever;", "# format: summary on a terminal", "# record: none", "device = [\"auto\"]"]
    {
        assert!(printed.lines().any(|printed| printed.starts_with(beginning)), "{beginning}: {printed}");
    }
}

#[test]
fn a_file_configures_a_run() {
    let bench = Bench::new();
    let file = "device = 'sim'\nspeed = 'max'\nduration = '100ms'\nformat = 'csv'\ntier = 'paper'\n";
    let file = bench.file("run.toml", file);
    let configured = bench.run(&[], &["--config", text(&file)]).done();
    let flags = "--device sim --speed max --duration 100ms --format csv --tier paper";
    assert_eq!(configured, bench.run(&[], &flags.split(' ').collect::<Vec<_>>()).done());
    assert_eq!(configured.lines().count(), 401);
}

/// Which mistakes are found is a test of the host's reader of configurations.
#[test]
fn mistakes_are_wrong_usage_and_named_with_their_place() {
    let bench = Bench::new();
    let file = bench.file("wrong.toml", "seed = 1\ndevise = 'sim'\n");
    let place = format!("{}:2:1", file.display());
    bench.run(&[], &["--config", text(&file)]).assert_refused(2, &[&place, "`devise`", "`device` is"]);
    bench.run(&[], &["--config", "/nowhere.toml"]).assert_refused(2, &["/nowhere.toml", "--config none"]);
    bench.run(&[("SLITPOSE_SEED", "many")], &["--config", "none"]).assert_refused(2, &["'many'", "--seed"]);
    let file = bench.file("wrong.toml", "print_config = true\n");
    bench.run(&[], &["--config", text(&file)]).assert_refused(2, &["1:1", "`print_config`"]);
    let file = bench.file("wrong.toml", "real_time = 100\n");
    bench.run(&[], &["--config", text(&file)]).assert_refused(2, &["1:13", "1..=99"]);
}

/// What bash offers for the last of `words`.
fn offered(script: &std::path::Path, folder: &std::path::Path, words: &[&str]) -> Vec<String> {
    let quoted: Vec<String> = words.iter().map(|word| format!("'{word}'")).collect();
    let (last, before) = (&quoted[quoted.len() - 1], &quoted[quoted.len() - 2]);
    let commands = format!(
        "source '{}' || exit; COMP_WORDS=({}); COMP_CWORD={}; _slitpose slitpose {last} {before}; printf '%s\\n' \"${{COMPREPLY[@]}}\"",
        script.display(),
        quoted.join(" "),
        quoted.len() - 1
    );
    let output = Command::new("bash").args(["--norc", "-c", &commands]).current_dir(folder).output().expect("bash");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("UTF-8").lines().map(str::to_owned).collect()
}

#[test]
fn names_and_files_are_completed_where_both_are_taken() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let script = folder.path().join("script.bash");
    fs::write(&script, slitpose!().run(["completions", "bash"]).done()).expect("written");
    fs::write(folder.path().join("bench-of-mine.toml"), "").expect("written");
    for (words, expected) in [
        (&["slitpose", "run", "--scene", "b"][..], &["base", "bench", "bench-of-mine.toml"][..]),
        (&["slitpose", "replay", "x.mcap", "--scene", "wi"], &["wide"]),
        (&["slitpose", "device", "set", "--scene", "wi"], &["wide"]),
        (&["slitpose", "run", "--device", "s"], &["script.bash", "sim"]),
        (&["slitpose", "doctor", "--device", "a"], &["auto"]),
        (&["slitpose", "simulate", "--trajectory", "s"], &["script.bash", "smooth", "still"]),
        // Where there is no word bash looks for files itself.
        (&["slitpose", "scene", "check", "b"], &["base", "bench"]),
        (&["slitpose", "model", "w"], &["wide"]),
        (&["slitpose", "scene", "show", "b"], &["base", "bench"]),
    ] {
        let mut found = offered(&script, folder.path(), words);
        found.sort();
        assert_eq!(found, expected, "{words:?}");
    }
    let zsh = slitpose!().run(["completions", "zsh"]).done();
    assert!(zsh.lines().any(|line| line.contains("--scene=")
        && line.contains("(wide fine redundant orderable spacemouse maglev base bench)")
        && line.contains("_files")));
    assert!(
        zsh.lines().any(|line| line.contains("':name -- ") && !line.contains("_files")),
        "`scene show` takes no file"
    );
    let fish = slitpose!().run(["completions", "fish"]).done();
    let option =
        |name: &str| fish.lines().any(|line| line.contains(&format!("-l {name} ")) && line.contains(" -r -F -a \""));
    assert!(["scene", "device", "trajectory"].iter().all(|name| option(name)), "{fish}");
    assert!(
        fish.lines().any(|line| line.contains("from check\" -a \"wide fine redundant orderable spacemouse maglev base bench\"")),
        "{fish}"
    );
}

/// That a page has all options of its verb is the generator's business.
#[test]
fn each_verb_has_its_page() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let pages = folder.path().join("man1");
    slitpose!().run(["man", "--output", text(&pages)]).done();
    for (verb, option) in [("run", "patience"), ("device-reboot", "boot\\-loader"), ("scene-check", "samples")] {
        let page = fs::read_to_string(pages.join(format!("slitpose-{verb}.1"))).expect(verb);
        assert!(page.contains(&format!("\\-\\-{option}")), "{verb}: {page}");
    }
}
