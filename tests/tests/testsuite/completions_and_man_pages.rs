//! `slitpose completions` and `slitpose man`: a script the shell takes, and a page for each verb with each of its
//! options.

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

use clap::CommandFactory;
use slitpose::commands::Cli;
use slitpose_tests::slitpose;

#[test]
fn the_shell_takes_its_script() {
    let script = slitpose!().run(["completions", "bash"]).done();
    for word in ["device", "identify", "--boot-loader", "--trajectory", "complete -F _slitpose"] {
        assert!(script.contains(word), "`{word}` is not in the script");
    }
    let mut bash = Command::new("bash").arg("-n").stdin(Stdio::piped()).spawn().expect("bash starts");
    bash.stdin.take().expect("piped").write_all(script.as_bytes()).expect("read");
    assert!(bash.wait().expect("ends").success());
    for shell in ["zsh", "fish", "elvish", "powershell"] {
        assert!(slitpose!().run(["completions", shell]).done().contains("boot-loader"), "{shell}");
    }
    assert_eq!(slitpose!().run(["completions", "dish"]).code, 2);
}

/// What bash offers for the last of `words`.
fn offered(script: &std::path::Path, folder: &std::path::Path, words: &[&str]) -> Vec<String> {
    let quoted: Vec<String> = words.iter().map(|word| format!("'{word}'")).collect();
    let (last, before) = (&quoted[quoted.len() - 1], &quoted[quoted.len() - 2]);
    let commands = format!(
        "source '{}'; COMP_WORDS=({}); COMP_CWORD={}; _slitpose slitpose {last} {before}; printf '%s\\n' \"${{COMPREPLY[@]}}\"",
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
        && line.contains("(wide fine redundant spacemouse maglev base bench)")
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
        fish.lines().any(|line| line.contains("from check\" -a \"wide fine redundant spacemouse maglev base bench\"")),
        "{fish}"
    );
}

/// Asserts that `command` has a page with all its options, and so have its verbs; gives how many there are.
fn assert_documented(command: &clap::Command, name: &str, folder: &std::path::Path) -> usize {
    let page = fs::read_to_string(folder.join(format!("{name}.1"))).unwrap_or_else(|error| panic!("{name}: {error}"));
    let options = command.get_arguments().filter(|argument| !argument.is_hide_set());
    for option in options.filter_map(clap::Arg::get_long) {
        // Hyphens are escaped.
        let escaped = format!("--{option}").replace('-', "\\-");
        assert!(page.contains(&escaped), "--{option} is not on the page of {name}");
    }
    let verbs = command.get_subcommands().filter(|verb| verb.get_name() != "help");
    1 + verbs.map(|verb| assert_documented(verb, &format!("{name}-{}", verb.get_name()), folder)).sum::<usize>()
}

#[test]
fn each_verb_has_its_page_with_each_option() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let pages = folder.path().join("man1");
    slitpose!().run(["man", "--output", pages.to_str().expect("UTF-8")]).done();
    let page = fs::read_to_string(pages.join("slitpose-simulate.1")).expect("page");
    let synopsis = page.split(".SH").find(|section| section.starts_with(" SYNOPSIS")).expect("a synopsis");
    for part in [
        "\\fBslitpose simulate\\fR",
        "[\\fB\\-\\-scene\\fR \\fISCENE\\fR]",
        " \\fB\\-\\-output\\fR \\fIFILE\\fR",
        "[\\fB\\-\\-raw\\fR]",
    ] {
        assert!(synopsis.contains(part), "`{part}` is not in: {synopsis}");
    }
    let mut command = Cli::command();
    command.build();
    let documented = assert_documented(&command, "slitpose", &pages);
    assert_eq!(fs::read_dir(&pages).expect("folder").count(), documented, "pages of nothing");
    assert!(pages.join("slitpose-device-reboot.1").exists() && pages.join("slitpose-scene-check.1").exists());
}
