//! The `slitpose` command.

#![forbid(unsafe_code)]

use std::io::Write;
use std::process::ExitCode;

use slitpose::commands::run;

fn main() -> ExitCode {
    match run(std::env::args_os()) {
        Ok(outcome) => outcome.into(),
        Err(error) if error.is_broken_pipe() => ExitCode::SUCCESS,
        Err(error) => {
            let code = error.exit_code();
            let error = anyhow::Error::new(error);
            // Nobody is left to tell if even standard error is closed.
            let _ = writeln!(std::io::stderr(), "slitpose: {error:#}");
            code
        }
    }
}
