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
    let mut command = Cli::command();
    command.build();
    let documented = assert_documented(&command, "slitpose", &pages);
    assert_eq!(fs::read_dir(&pages).expect("folder").count(), documented, "pages of nothing");
    assert!(pages.join("slitpose-device-reboot.1").exists() && pages.join("slitpose-scene-check.1").exists());
}
