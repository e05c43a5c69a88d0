//! The `slitpose` command.

#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    slitpose::commands::main(std::env::args_os())
}
