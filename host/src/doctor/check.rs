//! One thing that was looked at.

use std::fmt;

use serde::Serialize;

use slitpose_head::foreign::printable;

/// A finding that a board makes longer is cut.
const LONGEST_FINDING: usize = 800;

/// How a check ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As it should be.
    Ok,
    /// Poses come, but something may be better.
    Warning,
    /// No poses, or lost ones.
    Failed,
    /// It could not be looked at.
    Skipped,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
        })
    }
}

/// What was looked at, and what was found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What.
    pub name: &'static str,
    /// How it ended.
    pub verdict: Verdict,
    /// What was found, with its numbers.
    pub finding: String,
    /// What to do about it, if anything.
    pub next_step: Option<&'static str>,
}

impl Check {
    pub(super) fn ok(name: &'static str, finding: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Ok, finding: finding.into(), next_step: None }
    }

    pub(super) fn warning(name: &'static str, finding: impl Into<String>, next_step: &'static str) -> Self {
        Self { name, verdict: Verdict::Warning, finding: finding.into(), next_step: Some(next_step) }
    }

    pub(super) fn failed(name: &'static str, finding: impl Into<String>, next_step: &'static str) -> Self {
        Self { name, verdict: Verdict::Failed, finding: finding.into(), next_step: Some(next_step) }
    }

    pub(super) fn skipped(name: &'static str, why: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Skipped, finding: why.into(), next_step: None }
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:<8} {:<14} {}", self.verdict, self.name, printable(&self.finding).at_most(LONGEST_FINDING))?;
        match self.next_step {
            Some(next_step) => writeln!(f, "{:<8} {:<14} -> {next_step}", "", ""),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn findings_stand_below_each_other() {
        let text = Check::ok("scene", "fits").to_string() + &Check::failed("rate", "0 Hz", "reset it").to_string();
        assert_eq!(
            text,
            "ok       scene          fits\n\
             failed   rate           0 Hz\n                        -> reset it\n"
        );
    }
}
