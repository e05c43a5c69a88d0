//! Whether the debug and the release build give the same poses, bit for bit: exit code 1 if not.
//!
//! ```text
//! cargo build -p slitpose && cargo build --release -p slitpose
//! cargo run --release -p slitpose-tests --example builds -- [--slitpose PATH]...
//! ```

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use slitpose_tests::acceptance::builds::Build;
use slitpose_tests::process::Slitpose;
use slitpose_tests::verdicts::Verdicts;

#[derive(Parser)]
#[command(about = "The same poses from each build")]
struct Options {
    /// The builds [default: release and debug, from the folder of this example]
    #[arg(long)]
    slitpose: Vec<PathBuf>,
}

fn main() -> ExitCode {
    let Options { slitpose: mut paths } = Options::parse();
    if paths.is_empty() {
        let example = std::env::current_exe().expect("the running example has a path");
        let target = example.ancestors().nth(3).expect("a target folder");
        paths = ["release", "debug"].map(|profile| target.join(profile).join("slitpose")).into();
    }
    let programs: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).expect("a program")).collect();
    let differ = programs.len() > 1 && programs[1..].iter().all(|program| *program != programs[0]);
    let builds: Vec<Build> = paths.into_iter().map(|path| Build::of(Slitpose::given_or_beside(Some(path)))).collect();
    builds.iter().for_each(|build| println!("{build}"));
    let mut verdicts = Verdicts::default();
    verdicts.check(differ, "there are several builds, and not the same one twice");
    verdicts.check(builds.iter().all(|build| build.equals(&builds[0])), "all give the same");
    verdicts.end()
}
