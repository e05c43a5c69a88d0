//! The `slitpose` command.

#![forbid(unsafe_code)]

use std::process::ExitCode;

use slitpose::commands::run;
use slitpose::terminal::complain;

fn main() -> ExitCode {
    match run(std::env::args_os()) {
        Ok(outcome) => outcome.into(),
        Err(error) if error.is_broken_pipe() => ExitCode::SUCCESS,
        Err(error) => {
            let code = error.exit_code();
            let error = anyhow::Error::new(error);
            complain(format_args!("{error:#}"));
            code
        }
    }
}
