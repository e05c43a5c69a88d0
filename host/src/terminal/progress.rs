//! The progress of a long command, and the rows that are drawn in place.

use std::time::{Duration, Instant};

use console::{Term, measure_text_width};

use super::{Line, Row, screen};

/// Period of redrawing: a person reads no faster.
const RENEWAL: Duration = Duration::from_millis(200);

/// No estimate of the remaining time is shown before this time.
const ESTIMATE_AFTER: Duration = Duration::from_secs(1);

const BAR: u64 = 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Amount {
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
    done: u64,
    began: Instant,
    shown: Option<Instant>,
}

impl Progress {
    /// A progress line of `total`, under `name`.
    pub(crate) fn new(name: &'static str, total: u64, amount: Amount) -> Self {
        Self { name, amount, total, done: 0, began: Instant::now(), shown: None }
    }

    /// Sets the amount done; redrawn a few times per second.
    pub(crate) fn at(&mut self, done: u64) {
        if self.shown.is_none_or(|shown| shown.elapsed() >= RENEWAL) {
            self.step(done, "");
        }
    }

    /// Adds to the amount done; redrawn a few times per second.
    pub(crate) fn add(&mut self, more: u64) {
        self.done += more;
        self.at(self.done);
    }

    /// Sets the amount done and the present step; redrawn at once.
    pub(crate) fn step(&mut self, done: u64, what: &str) {
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

/// Rows and columns of a terminal.
pub(super) fn size(term: &Term) -> [usize; 2] {
    <[u16; 2]>::from(term.size()).map(usize::from)
}

/// Rows on the screen, each narrower than the window was, the cursor below them.
#[derive(Debug)]
pub(super) struct Block {
    rows: usize,
    widest: usize,
}

impl Block {
    pub(super) const NONE: Self = Self { rows: 0, widest: 0 };

    /// The characters that replace the block by `rows`.
    ///
    /// If the user narrows the window below the width of a row, some terminals cut the row and some fold it.
    /// In that case the whole window is cleared, which works for all.
    pub(super) fn replace(&mut self, rows: &[Row], [height, width]: [usize; 2], has_colours: bool) -> String {
        let mut text = match self.rows {
            0 => String::new(),
            _ if self.widest > width || self.rows >= height => "\x1b[H\x1b[2J".to_owned(),
            rows => format!("\r\x1b[{rows}A\x1b[J"),
        };
        for row in rows {
            text += &(row.tone.paint(&row.text, has_colours) + "\n");
        }
        let widest = rows.iter().map(|row| measure_text_width(&row.text)).max().unwrap_or(0);
        *self = Self { rows: rows.len(), widest };
        text
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
