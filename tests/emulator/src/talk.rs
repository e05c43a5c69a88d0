//! What the programs of this package say on standard error.

use std::error::Error;
use std::fmt;
use std::io::{self, Write};
use std::process::ExitCode;

/// Says something on standard error, if that is open.
pub fn talk(program: &str, text: fmt::Arguments<'_>) {
    let _ = writeln!(io::stderr(), "{program}: {text}");
}

/// How `program` ends: a failure is told with all that caused it.
pub fn ended(program: &str, result: Result<(), impl Error>) -> ExitCode {
    let Err(failure) = result else {
        return ExitCode::SUCCESS;
    };
    let mut text = failure.to_string();
    let mut source = failure.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    talk(program, format_args!("{text}"));
    ExitCode::FAILURE
}
