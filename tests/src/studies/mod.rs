//! Studies that run at any size. The example `study` runs them in full size, `tests/tests/testsuite/studies.rs` in small, by
//! the same words: each prints a table of what came out and says which bounds were kept.
//!
//! | study | question |
//! |---|---|
//! | [`monte_carlo`] | are poses and covariances right over many random poses? |
//! | [`faults`] | is each kind of injected fault noticed, and what does it cost? |
//! | [`latency`] | how long does a pose take from a board's bytes to a control loop in C? |
//! | [`storm`] | is nothing lost silently, and does nothing grow, with several boards for a long time, in fair weather and foul? |
//! | [`replug`] | does a board that goes in all manners come back? |

pub mod faults;
pub mod latency;
pub mod monte_carlo;
pub mod replug;
pub mod scan_table;
pub mod storm;
mod trials;

use std::fmt;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use slitpose_head::table::aligned;

use crate::process::Slitpose;

/// A study and its conditions.
#[derive(Debug, Subcommand)]
pub enum Study {
    /// Poses and covariances over many random poses; half an hour with `--count 100000`
    #[command(name = "monte_carlo")]
    MonteCarlo(monte_carlo::Conditions),
    /// Every kind of fault against the whole chain
    Faults(faults::Options),
    /// Time from a board's bytes to a control loop in C
    Latency(latency::Conditions),
    /// Several boards for a long time: faulty ones, and a daemon that is suspended, killed, without a disk, and whose clock is
    /// set; or, with `--calm`, none of that
    Storm(storm::Conditions),
    /// A board that goes in all manners and comes back at another port
    Replug(replug::Conditions),
}

impl Study {
    /// Runs it with this program, as far as it needs one.
    pub fn run(&self, slitpose: Slitpose) -> Verdicts {
        match self {
            Self::MonteCarlo(conditions) => monte_carlo::study(conditions),
            Self::Faults(options) => faults::study(options),
            Self::Latency(conditions) => latency::study(slitpose, conditions),
            Self::Storm(conditions) => storm::study(slitpose, conditions),
            Self::Replug(conditions) => replug::study(slitpose, conditions),
        }
    }
}

/// Runs the study that `words` name, and fails if it does not keep its bounds.
pub fn assert_kept(slitpose: Slitpose, words: &str) {
    #[derive(Parser)]
    struct Words {
        #[command(subcommand)]
        study: Study,
    }
    let words = std::iter::once("study").chain(words.split(' '));
    let Words { study } = Words::try_parse_from(words).unwrap_or_else(|error| panic!("{error}"));
    let Verdicts { failed } = study.run(slitpose);
    assert!(failed.is_empty(), "out of bounds: {failed:#?}");
}

/// Prints whether bounds are kept, and remembers those that are not.
#[derive(Clone, Debug, Default)]
pub struct Verdicts {
    pub failed: Vec<String>,
}

impl Verdicts {
    /// Takes note of one bound.
    pub fn check(&mut self, good: bool, what: impl fmt::Display) {
        println!("  {}: {what}", if good { "ok" } else { "FAILS" });
        if !good {
            self.failed.push(what.to_string());
        }
    }

    /// Says how many failed: as an exit code, too.
    pub fn end(self) -> ExitCode {
        println!("{} out of bounds", self.failed.len());
        if self.failed.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
    }
}

/// Rows under a header, columns aligned.
#[derive(Clone, Debug)]
pub struct Table {
    rows: Vec<Vec<String>>,
}

impl Table {
    pub fn new(header: &[&str]) -> Self {
        Self { rows: vec![header.iter().map(|&name| name.to_owned()).collect()] }
    }

    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        aligned(&self.rows, |column| column > 0).try_for_each(|line| writeln!(f, "  {line}"))
    }
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

/// What memory grows by, from the mean of the second quarter of the samples to that of the last: what a program uses for
/// the first time it uses in the first.
fn check_growth(verdicts: &mut Verdicts, resident_bytes: &[u64], most_kib: f64) {
    let mut quarters = [(0.0, 0.0); 4];
    for (number, bytes) in resident_bytes.iter().enumerate() {
        let (sum, count) = &mut quarters[number * 4 / resident_bytes.len()];
        *sum += *bytes as f64 / 1024.0;
        *count += 1.0;
    }
    let [before, after] = [quarters[1], quarters[3]].map(|(sum, count)| sum / count);
    println!("  memory: {:.2} MiB in the second quarter, {:.2} MiB in the last", before / 1024.0, after / 1024.0);
    let growth = after - before;
    verdicts.check(growth <= most_kib, format!("memory grows by {growth:.0} KiB, {most_kib:.0} allowed"));
}
