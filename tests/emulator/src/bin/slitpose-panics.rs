//! `slitpose-panics`: where an image could panic.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use slitpose_emulator::panics::{PanicsError, sites};
use slitpose_emulator::rig::{OpenError, built_files};
use slitpose_emulator::talk::ended;
use thiserror::Error;

/// Every place in the source from which an image's panic handler can be reached, as CSV.
///
/// `firmware/PANICS.md` says of each file why none of them is.
#[derive(Debug, Parser)]
#[command(name = "slitpose-panics", version)]
struct Args {
    /// The image [default: both that firmware/build made last]
    elf: Option<PathBuf>,
}

#[derive(Debug, Error)]
enum Failure {
    #[error("cannot read the image {}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error(transparent)]
    Image(#[from] OpenError),
    #[error(transparent)]
    Panics(#[from] PanicsError),
    #[error("cannot write to standard output")]
    Output(#[from] csv::Error),
    #[error("cannot write to standard output")]
    Flush(#[from] io::Error),
}

fn main() -> ExitCode {
    ended("slitpose-panics", run(Args::parse()))
}

fn run(args: Args) -> Result<(), Failure> {
    let files = match args.elf {
        Some(path) => vec![fs::read(&path).map_err(|source| Failure::Read { path, source })?],
        None => built_files()?.into(),
    };
    let mut all = BTreeSet::new();
    for file in files {
        all.extend(sites(&file)?);
    }
    let mut out = csv::Writer::from_writer(io::stdout());
    out.write_record(["file", "line", "kind"])?;
    for site in all {
        out.write_record([&site.file, &site.line.to_string(), &site.kind])?;
    }
    Ok(out.flush()?)
}
