//! `slitpose completions`: what a shell needs to complete the command line.

use clap::CommandFactory;
use clap_complete::Shell;

use super::{Cli, CommandError, Outcome};
use crate::table::Output;

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

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "slitpose", &mut script);
    // The generators write text only.
    Output::open(None)?.write_text(&String::from_utf8_lossy(&script))?;
    Ok(Outcome::Done)
}
