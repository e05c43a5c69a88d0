//! Findings on scenes, boards, heads and hosts: what is wrong, and what to do about it.

use std::borrow::Cow;
use std::fmt;

use serde::Serialize;

use crate::foreign::printable;

/// A text that a board or a file makes longer is cut.
const MAX_TEXT: usize = 800;

/// How grave a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// As it should be.
    Ok,
    /// It could not be checked.
    Skipped,
    /// It works, but may be better.
    Warning,
    /// It keeps good poses from coming.
    Failed,
}

impl fmt::Display for Grade {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// A finding in one place. The keys of its JSON are those of the report that `slitpose doctor --bundle` packs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Where: a part, or the name of a check.
    #[serde(rename = "name")]
    pub place: Cow<'static, str>,
    /// How grave it is.
    #[serde(rename = "verdict")]
    pub grade: Grade,
    /// What was found, with its numbers.
    #[serde(rename = "finding")]
    pub text: String,
    /// What to do about it; `None` if there is nothing to do, or the text says it.
    pub next_step: Option<Cow<'static, str>>,
}

impl Finding {
    /// A finding without a next step.
    pub fn new(grade: Grade, place: impl Into<Cow<'static, str>>, text: impl Into<String>) -> Self {
        Self { place: place.into(), grade, text: text.into(), next_step: None }
    }

    /// Something as it should be.
    pub fn ok(place: impl Into<Cow<'static, str>>, text: impl Into<String>) -> Self {
        Self::new(Grade::Ok, place, text)
    }

    /// Something that could not be checked, and why.
    pub fn skipped(place: impl Into<Cow<'static, str>>, reason: impl Into<String>) -> Self {
        Self::new(Grade::Skipped, place, reason)
    }

    /// Something that works, but may be better.
    pub fn warning(
        place: impl Into<Cow<'static, str>>,
        text: impl Into<String>,
        next_step: impl Into<Cow<'static, str>>,
    ) -> Self {
        Self { next_step: Some(next_step.into()), ..Self::new(Grade::Warning, place, text) }
    }

    /// Something that keeps good poses from coming.
    pub fn failed(
        place: impl Into<Cow<'static, str>>,
        text: impl Into<String>,
        next_step: impl Into<Cow<'static, str>>,
    ) -> Self {
        Self { next_step: Some(next_step.into()), ..Self::new(Grade::Failed, place, text) }
    }

    /// The same with `whole`, such as a board, of which the place is a part.
    #[must_use]
    pub fn within(self, whole: &str) -> Self {
        Self { place: format!("{whole}, {}", self.place).into(), ..self }
    }
}

impl fmt::Display for Finding {
    /// One line, `place: text; next step`. With `{:#}` a row of a table, and another for the next step.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (place, text) = (printable(&self.place), printable(&self.text).at_most(MAX_TEXT));
        let is_row = f.alternate();
        if is_row {
            write!(f, "{:<8} {:<14} {text}", self.grade, place.to_string())?;
        } else {
            write!(f, "{place}: {text}")?;
        }
        match &self.next_step {
            Some(next_step) if is_row => write!(f, "\n{:<8} {:<14} -> {next_step}", "", ""),
            Some(next_step) => write!(f, "; {next_step}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn findings_as_rows_stand_below_each_other() {
        let text = [Finding::ok("scene", "fits"), Finding::failed("rate", "0 Hz", "reset it")];
        assert_eq!(
            text.map(|finding| format!("{finding:#}\n")).concat(),
            "ok       scene          fits\n\
             failed   rate           0 Hz\n                        -> reset it\n"
        );
    }

    #[test]
    fn a_finding_in_a_line_says_where_what_and_what_to_do() {
        let finding = Finding::failed("cell 1", "no light", "check its plugs").within("port");
        assert_eq!(finding.to_string(), "port, cell 1: no light; check its plugs");
        assert_eq!(Finding::skipped("clock\u{1b}", "a\nb").to_string(), "clock\\u{1b}: a\\nb");
    }
}
