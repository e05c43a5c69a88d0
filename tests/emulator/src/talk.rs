//! What the programs of this package say on standard error.

use std::error::Error;
use std::fmt;
use std::io::{self, Write};
use std::process::ExitCode;

use slitpose_head::causes::with_causes;

/// Says something on standard error, if that is open.
pub fn talk(program: &str, text: fmt::Arguments<'_>) {
    let _ = writeln!(io::stderr(), "{program}: {text}");
}

/// How `program` ends: a failure is told with all that caused it.
pub fn ended(program: &str, result: Result<(), impl Error>) -> ExitCode {
    let Err(failure) = result else {
        return ExitCode::SUCCESS;
    };
    talk(program, format_args!("{}", with_causes(&failure)));
    ExitCode::FAILURE
}
