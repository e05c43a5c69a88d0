//! Bounds that a study keeps or not.

use std::process::ExitCode;

/// Prints whether bounds are kept, and remembers those that are not.
#[derive(Clone, Debug, Default)]
pub struct Verdicts {
    /// What is out of bounds.
    pub failed: Vec<String>,
}

impl Verdicts {
    /// Takes note of one bound.
    pub fn check(&mut self, good: bool, what: &str) {
        println!("  {}: {what}", if good { "ok" } else { "FAILS" });
        if !good {
            self.failed.push(what.to_owned());
        }
    }

    /// Says how many failed: as an exit code, too.
    pub fn end(self) -> ExitCode {
        println!("{} out of bounds", self.failed.len());
        if self.failed.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
    }

    /// The same for a test.
    ///
    /// # Panics
    /// If one failed.
    pub fn assert_kept(self) {
        assert!(self.failed.is_empty(), "out of bounds: {:#?}", self.failed);
    }
}
