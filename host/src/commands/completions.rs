//! What follows from the command line itself: completions for shells, manual pages, and defaults in the help.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;
use slitpose_head::table::{Output, OutputError};

use super::{CommandError, Outcome, command, options};

/// Prints the script that teaches a shell to complete this command.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose completions bash > ~/.local/share/bash-completion/completions/slitpose\n  \
                  slitpose completions fish > ~/.config/fish/completions/slitpose.fish"
)]
pub(super) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Verbs that have a scene as an argument of its own: the condition of fish for each.
const SCENE_VERBS: [&str; 6] = [
    "__fish_slitpose_using_subcommand model",
    "__fish_slitpose_using_subcommand solve",
    "__fish_slitpose_using_subcommand identify",
    "__fish_slitpose_using_subcommand report",
    "__fish_slitpose_using_subcommand scene; and __fish_seen_subcommand_from check",
    "__fish_slitpose_using_subcommand scene; and __fish_seen_subcommand_from plot",
];

pub(super) fn completions(args: &CompletionsArgs) -> Result<Outcome, CommandError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command(), "slitpose", &mut script);
    // The generators write text only.
    let script = with_files(args.shell, String::from_utf8_lossy(&script).into_owned());
    options::print(&script)
}

/// The generators take a list of names for all there is. Here it stands beside files.
fn with_files(shell: Shell, script: String) -> String {
    let lists = [options::scenes(), options::devices(), options::motions()].map(|names| names.0.join(" "));
    match shell {
        Shell::Bash => lists.iter().fold(script, |script, list| {
            script.replace(&format!("compgen -W \"{list}\" --"), &format!("compgen -f -W \"{list}\" --"))
        }),
        Shell::Zsh => lists.iter().fold(script, |script, list| {
            let files = format!(":{{_alternative \"names\\:name\\:({list})\" \"files\\:file\\:_files\"}}'");
            // `scene show` prints the text of a shipped scene and takes no other.
            let lines = script.split_inclusive('\n').map(|line| match line.starts_with("':name -- ") {
                true => line.to_owned(),
                false => line.replace(&format!(":({list})'"), &files),
            });
            lines.collect()
        }),
        Shell::Fish => {
            let first_names = lists.iter().filter_map(|list| list.split(' ').next());
            let script = first_names.fold(script, |script, first| {
                script.replace(&format!(" -r -f -a \"{first}\\t"), &format!(" -r -F -a \"{first}\\t"))
            });
            let scenes = &lists[0];
            let lines = SCENE_VERBS.map(|verb| format!("complete -c slitpose -n \"{verb}\" -a \"{scenes}\"\n"));
            script + &lines.concat()
        }
        _ => script,
    }
}

/// Writes the manual pages: one for the program, and one for each verb.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose man --output ~/.local/share/man/man1 && man slitpose-run")]
pub(super) struct ManArgs {
    /// Write to this folder
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
}

/// What the foot of a page says it is about.
const SOURCE: &str = concat!("slitpose ", env!("CARGO_PKG_VERSION"));

pub(super) fn man(args: &ManArgs) -> Result<Outcome, CommandError> {
    let folder = &args.output;
    fs::create_dir_all(folder).map_err(|source| OutputError::Create { path: folder.clone(), source })?;
    let mut command = command().disable_help_subcommand(true);
    // Gives verbs their full names.
    command.build();
    write_page(&command, folder)?;
    Ok(Outcome::Done)
}

/// The page of `command`, and those of its verbs.
fn write_page(command: &Command, folder: &Path) -> Result<(), OutputError> {
    let man = Man::new(command.clone()).source(SOURCE).manual("slitpose");
    let mut text = Vec::new();
    // Writing to memory cannot fail; the generator writes text only.
    let _ = man.render(&mut text);
    Output::file(&folder.join(man.get_filename()))?.write_text(&String::from_utf8_lossy(&text))?;
    command.get_subcommands().try_for_each(|verb| write_page(verb, folder))
}

/// Verbs, an option of each, and its default, in the order in which synopses name them. A value has no spaces; anything
/// else is a rule.
const DEFAULTS: [(&str, &str, &str); 22] = [
    ("replay export", "tier", "as recorded, else exact"),
    ("replay export", "tolerance", "as recorded, else 1e-6"),
    ("replay export", "filter", "as recorded, else off"),
    ("replay export", "calibration", "as recorded, else the tolerances of the scene"),
    ("run simulate solve model", "tier", "exact"),
    ("run simulate solve", "tolerance", "1e-6"),
    ("model", "tolerance", "1e-10"),
    ("run", "filter", "off"),
    ("run", "trajectory", "smooth; with --live hand"),
    ("simulate", "trajectory", "smooth"),
    ("run simulate", "seed", "1"),
    ("run replay", "format", "summary on a terminal, else ndjson"),
    ("run", "speed", "1"),
    ("run", "calibration", "the tolerances of the scene, or usual ones; of a simulated board none"),
    ("run", "patience", "forever; with --duration not at all"),
    ("run", "config", "~/.config/slitpose/config.toml or /etc/slitpose/config.toml, if there is one"),
    ("replay", "speed", "max; with --live 1"),
    ("export", "format", "by the ending of --output"),
    ("simulate solve", "calibration", "the tolerances of the scene, if it has any"),
    ("model", "calibration", "none"),
    ("report", "poses", "1000, quick: 100"),
    ("doctor", "scene", "the one the board belongs to"),
];

/// Options of a verb, and their defaults.
fn of_verb(verb: &str) -> impl Iterator<Item = (&'static str, &'static str)> {
    let is_its = move |verbs: &str| verbs.split(' ').any(|other| other == verb);
    DEFAULTS.into_iter().filter(move |(verbs, ..)| is_its(verbs)).map(|(_, option, default)| (option, default))
}

/// The default of `option` of `verb`, if it has one.
pub(super) fn default_of(verb: &str, option: &str) -> Option<&'static str> {
    of_verb(verb).find(|(id, _)| *id == option).map(|(_, default)| default)
}

/// Adds the default to the help of each option.
pub(super) fn in_help(command: Command) -> Command {
    command.mut_subcommands(|verb| {
        let name = verb.get_name().to_owned();
        of_verb(&name).fold(verb, |verb, (option, default)| {
            verb.mut_arg(option, |arg| {
                let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
                let stop = if help.is_empty() { "" } else { " " };
                arg.help(format!("{help}{stop}[default: {default}]"))
            })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::{command, options};
    use slitpose_tracking::solving::MODEL_TOLERANCE;

    #[test]
    fn tolerances_are_those_in_use() {
        for (verb, tolerance) in [
            ("run", options::DEFAULT_TOLERANCE),
            ("simulate", options::DEFAULT_TOLERANCE),
            ("solve", options::DEFAULT_TOLERANCE),
            ("model", MODEL_TOLERANCE),
        ] {
            assert_eq!(default_of(verb, "tolerance").unwrap().parse(), Ok(tolerance), "{verb}");
        }
        assert!(default_of("replay", "tolerance").unwrap().ends_with(default_of("run", "tolerance").unwrap()));
    }

    #[test]
    fn every_option_is_there_and_its_help_says_so() {
        for verb in command().get_subcommands() {
            for (option, default) in of_verb(verb.get_name()) {
                let arg = verb.get_arguments().find(|arg| arg.get_id() == option);
                let arg = arg.unwrap_or_else(|| panic!("{} has no --{option}", verb.get_name()));
                let help = arg.get_help().unwrap().to_string();
                assert_eq!(help.matches("[default: ").count(), 1, "{option}: {help}");
                assert!(help.ends_with(&format!("[default: {default}]")), "{option}: {help}");
                assert!(arg.get_default_values().is_empty(), "{option} has two defaults");
            }
        }
    }
}
