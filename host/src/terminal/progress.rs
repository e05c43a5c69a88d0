//! The progress of a long command.

use std::time::{Duration, Instant};

use super::{Line, screen};

/// Period of redrawing: a person reads no faster.
const RENEWAL: Duration = Duration::from_millis(200);

/// No estimate of the remaining time is shown before this time.
const ESTIMATE_AFTER: Duration = Duration::from_secs(1);

/// Characters of the bar.
const BAR: u64 = 20;

/// The unit of the progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Amount {
    /// Bytes, shown in megabytes.
    Bytes,
    /// Countable things, such as poses or sections.
    Of(&'static str),
}

/// A progress line, drawn on a terminal only, erased at its end.
#[derive(Debug)]
pub(crate) struct Progress {
    name: &'static str,
    amount: Amount,
    total: u64,
    began: Instant,
    shown: Option<Instant>,
}

impl Progress {
    /// A progress line of `total`, under `name`.
    pub(crate) fn new(name: &'static str, total: u64, amount: Amount) -> Self {
        Self { name, amount, total, began: Instant::now(), shown: None }
    }

    /// Sets the amount done; redrawn a few times per second.
    pub(crate) fn at(&mut self, done: u64) {
        if self.shown.is_none_or(|shown| shown.elapsed() >= RENEWAL) {
            self.show(done, "");
        }
    }

    /// Sets the amount done and the present step; redrawn at once.
    pub(crate) fn step(&mut self, done: u64, what: &str) {
        self.show(done, what);
    }

    fn show(&mut self, done: u64, what: &str) {
        self.shown = Some(Instant::now());
        screen().progress(Some(Line::new(self.name, &self.text(done, what, self.began.elapsed()))));
    }

    fn text(&self, done: u64, what: &str, elapsed: Duration) -> String {
        let (done, total) = (done.min(self.total), self.total.max(1));
        let filled = usize::try_from(done * BAR / total).unwrap_or(0);
        let bar = "#".repeat(filled) + &"-".repeat(BAR as usize - filled);
        let counts = match self.amount {
            Amount::Bytes => format!("{:.1} of {:.1} MB", done as f64 * 1e-6, total as f64 * 1e-6),
            Amount::Of(things) => format!("{done} of {total} {things}"),
        };
        let rest = if done > 0 && elapsed >= ESTIMATE_AFTER {
            let rest_s = elapsed.as_secs_f64() * (total - done) as f64 / done as f64;
            let rest = Duration::try_from_secs_f64(rest_s.ceil()).unwrap_or(Duration::MAX);
            format!(", {} left", humantime::format_duration(rest))
        } else {
            String::new()
        };
        let what = if what.is_empty() { String::new() } else { format!(": {what}") };
        format!("{bar} {} %, {counts}{rest}{what}", 100 * done / total)
    }
}

/// Erases the progress line.
pub(crate) fn hide() {
    screen().progress(None);
}

impl Drop for Progress {
    fn drop(&mut self) {
        if self.shown.is_some() {
            hide();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn says_how_far_and_how_long() {
        let bytes = Progress::new("replay", 4_000_000, Amount::Bytes);
        let text = bytes.text(1_000_000, "", Duration::from_secs(3));
        assert_eq!(text, "#####--------------- 25 %, 1.0 of 4.0 MB, 9s left");
        assert_eq!(bytes.text(0, "", Duration::ZERO), "-------------------- 0 %, 0.0 of 4.0 MB");
        // A file that grows meanwhile counts as at its end.
        assert!(bytes.text(9_000_000, "", Duration::ZERO).contains("100 %, 4.0 of 4.0 MB"));
        let sections = Progress::new("report", 4, Amount::Of("sections"));
        assert!(sections.text(1, "forward", Duration::ZERO).ends_with("1 of 4 sections: forward"));
    }
}
