//! `slitpose completions`: what a shell needs to complete the command line.

use clap_complete::Shell;

use super::{CommandError, Outcome, command, options};
use slitpose_head::table::Output;

/// Prints the script that teaches a shell to complete this command.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose completions bash > ~/.local/share/bash-completion/completions/slitpose\n  \
                  slitpose completions fish > ~/.config/fish/completions/slitpose.fish"
)]
pub(super) struct Args {
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

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command(), "slitpose", &mut script);
    // The generators write text only.
    let script = with_files(args.shell, String::from_utf8_lossy(&script).into_owned());
    Output::open(None)?.write_text(&script)?;
    Ok(Outcome::Done)
}

/// The generators take a list of names for all there is. Here it stands beside files.
fn with_files(shell: Shell, script: String) -> String {
    let lists = [options::scenes(), options::devices(), options::motions()].map(|names| names.list().join(" "));
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
