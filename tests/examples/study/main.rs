//! Studies in full size: tables on stdout, exit code 1 if one is out of bounds. `study help` lists them, `study NAME --help`
//! their conditions.
//!
//! `cargo run --release -p slitpose-tests --example study -- NAME [OPTIONS]`
//!
//! The command that is studied is this program once more: cargo builds no other for an example, and `slitpose` is what its
//! arguments make of it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use slitpose_tests::process::Slitpose;
use slitpose_tests::studies::Study;

/// Verbs of `slitpose` that studies use; none is the name of a study.
const VERBS: [&str; 3] = ["run", "replay", "simulate"];

#[derive(Parser)]
#[command(about = "Studies of slitpose in full size")]
struct Options {
    /// Another `slitpose` to study
    #[arg(long, value_name = "PROGRAM")]
    slitpose: Option<PathBuf>,
    #[command(subcommand)]
    study: Study,
}

fn main() -> ExitCode {
    if std::env::args().nth(1).is_some_and(|verb| VERBS.contains(&verb.as_str())) {
        return slitpose::commands::main(std::env::args_os());
    }
    let Options { slitpose, study } = Options::parse();
    let path = slitpose.unwrap_or_else(|| std::env::current_exe().expect("this program"));
    // Once in a process.
    study.run(Slitpose::at(path.into_os_string().into_string().expect("UTF-8 path").leak())).end()
}
