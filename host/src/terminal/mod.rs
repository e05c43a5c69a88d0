//! The user's terminal: the only module that draws on it.
//!
//! A view (the state of boards) and a progress line are redrawn in place; messages are printed above
//! them. `progress` shows the progress of a long command, and tracks the rows on the screen.
//!
//! Nothing is drawn in place unless the stream is a terminal that can move its cursor (TERM is set
//! and not `dumb`). Colours mark faults; a non-empty NO_COLOR turns them off.

mod progress;

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::sync::{Mutex, PoisonError};

use console::Term;
use progress::{Block, size};
use slitpose_head::finding::Grade;
use slitpose_head::foreign::printable;
use textwrap::{Options, WordSeparator, WordSplitter, WrapAlgorithm};

pub(crate) use progress::{Amount, Progress, hide as hide_progress};

/// Longer messages, with texts from boards or files, are cut.
const MAX_MESSAGE: usize = 4000;

static SCREEN: Mutex<Screen> =
    Mutex::new(Screen { view: Vec::new(), progress: None, target: None, block: Block::NONE });

struct Screen {
    view: Vec<Line>,
    progress: Option<Line>,
    /// The terminal it is drawn on; `None` before the first drawing.
    target: Option<Term>,
    block: Block,
}

/// Whether standard output can be drawn on in place.
pub(crate) fn is_live() -> bool {
    io::stdout().is_terminal() && !is_dumb()
}

/// Whether the terminal can only print; also if its kind is unknown.
fn is_dumb() -> bool {
    console::is_dumb() || std::env::var_os("TERM").is_some_and(|name| name.is_empty())
}

/// Whether a stream gets colours; `is_terminal`: it is a terminal.
pub(crate) fn has_colours(is_terminal: bool) -> bool {
    // https://no-color.org: set, and not empty.
    is_terminal && !is_dumb() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Draws `lines` on standard output in place of the last ones.
pub(crate) fn show(lines: Vec<Line>) -> io::Result<()> {
    let mut screen = screen();
    screen.view = lines;
    screen.target.get_or_insert_with(Term::buffered_stdout);
    screen.draw()
}

pub(crate) fn columns() -> usize {
    size(&Term::stdout())[1]
}

pub(crate) fn clear() {
    let mut screen = screen();
    (screen.view, screen.progress) = (Vec::new(), None);
    // An error does not matter: such a terminal shows nothing.
    let _ = screen.draw();
}

/// Writes one line to `output`, standard output, above what is drawn in place.
pub(crate) fn print(output: &mut impl Write, line: fmt::Arguments<'_>) -> io::Result<()> {
    screen().above(|| {
        writeln!(output, "{line}")?;
        output.flush()
    })
}

/// Prints a message on standard error, in one line, above what is drawn in place.
pub(crate) fn say(text: fmt::Arguments<'_>) {
    write_message(Tone::Plain, text);
}

/// Prints the reason why the command ends.
pub(crate) fn complain(text: fmt::Arguments<'_>) {
    write_message(Tone::Wrong, text);
}

fn write_message(tone: Tone, text: fmt::Arguments<'_>) {
    let text = text.to_string();
    let text = printable(&text).at_most(MAX_MESSAGE);
    let name = tone.paint("slitpose:", has_colours(io::stderr().is_terminal()));
    let write = || writeln!(io::stderr(), "{name} {text}");
    // Elsewhere it disturbs no view, and does not wait for a terminal that is held (Ctrl-S). An error
    // of standard error cannot be reported.
    let _ = if io::stderr().is_terminal() { screen().above(write) } else { write() };
}

fn screen() -> std::sync::MutexGuard<'static, Screen> {
    SCREEN.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Screen {
    /// Shows the progress line, below the view if there is one, else on standard error.
    fn progress(&mut self, line: Option<Line>) {
        self.progress = line;
        if self.target.is_none() && io::stderr().is_terminal() && !is_dumb() {
            self.target = Some(Term::buffered_stderr());
        }
        let _ = self.draw();
    }

    fn draw(&mut self) -> io::Result<()> {
        let Some(target) = &self.target else { return Ok(()) };
        let size = size(target);
        let lines: Vec<&Line> = self.view.iter().chain(&self.progress).collect();
        let rows = fit(&lines, size[1], size[0].saturating_sub(1));
        target.write_str(&self.block.replace(&rows, size, has_colours(true)))?;
        target.flush()
    }

    fn above(&mut self, write: impl FnOnce() -> io::Result<()>) -> io::Result<()> {
        let Some(target) = &self.target else { return write() };
        target.write_str(&self.block.replace(&[], size(target), false))?;
        target.flush()?;
        let written = write();
        written.and(self.draw())
    }
}

/// Columns of pages without a window.
pub(crate) const WIDTH: usize = 100;

/// Width of the column with the names of the lines.
const INDENT: usize = 12;

/// Longer texts, from boards or files, are cut.
const MAX_TEXT: usize = 800;

/// The importance of a line, shown by its colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Tone {
    #[default]
    Plain,
    Careful,
    Wrong,
}

impl Tone {
    /// `text` in its colour (SGR of ECMA-48), if it `has_colours`.
    pub(crate) fn paint(self, text: &str, has_colours: bool) -> String {
        match self {
            Self::Careful if has_colours => format!("\x1b[33m{text}\x1b[0m"),
            Self::Wrong if has_colours => format!("\x1b[1;31m{text}\x1b[0m"),
            _ => text.to_owned(),
        }
    }
}

impl From<Grade> for Tone {
    fn from(grade: Grade) -> Self {
        match grade {
            Grade::Ok | Grade::Skipped => Self::Plain,
            Grade::Warning => Self::Careful,
            Grade::Failed => Self::Wrong,
        }
    }
}

/// A name and the text under it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Line {
    name: &'static str,
    text: String,
    tone: Tone,
    rank: u8,
}

/// Ranks of lines, from the last to the first left out in a low window.
const RANKS: std::ops::RangeInclusive<u8> = 0..=3;

impl Line {
    /// `text` under `name`; control characters in it are escaped.
    pub(crate) fn new(name: &'static str, text: &str) -> Self {
        Self { name, text: printable(text).at_most(MAX_TEXT).to_string(), ..Self::default() }
    }

    /// A blank line, for use between boards.
    pub(crate) fn blank() -> Self {
        Self { rank: *RANKS.end(), ..Self::default() }
    }

    pub(crate) fn tone(&mut self, tone: Tone) -> &mut Self {
        self.tone = tone;
        self
    }

    /// Sets the rank, 0 to 3, by default 0: a window that is too low leaves out lines of higher ranks first.
    pub(crate) fn rank(&mut self, rank: u8) -> &mut Self {
        self.rank = rank;
        self
    }

    /// The rows of this line in `width` columns.
    fn rows(&self, width: usize) -> Vec<Row> {
        let width = width.max(1);
        let indent = INDENT.min(width / 4);
        let mut name = format!("{:<indent$}", self.name.chars().take(width).collect::<String>());
        if self.name.chars().count() >= indent && !self.text.is_empty() && indent > 0 {
            name.push(' ');
        }
        let rest = " ".repeat(indent);
        let options = Options::new(width).initial_indent(&name).subsequent_indent(&rest);
        let options = options.word_separator(WordSeparator::AsciiSpace).word_splitter(WordSplitter::NoHyphenation);
        let rows = textwrap::wrap(&self.text, options.wrap_algorithm(WrapAlgorithm::FirstFit));
        rows.into_iter().map(|text| Row { text: text.trim_end().to_owned(), tone: self.tone }).collect()
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Row {
    text: String,
    tone: Tone,
}

/// All of `lines` in `width` columns.
pub(crate) fn layout(lines: &[Line], width: usize) -> Vec<String> {
    lines.iter().flat_map(|line| line.rows(width)).map(|row| row.text).collect()
}

/// As many of `lines` as `height` rows of `width` columns hold, those of low rank first.
fn fit(lines: &[&Line], width: usize, height: usize) -> Vec<Row> {
    let of_rank = |most: u8| -> Vec<Row> {
        lines.iter().filter(|line| line.rank <= most).flat_map(|line| line.rows(width)).collect()
    };
    let fitting = RANKS.rev().map(of_rank).find(|rows| rows.len() <= height);
    fitting.unwrap_or_else(|| {
        let mut rows = of_rank(*RANKS.start());
        rows.truncate(height.saturating_sub(1));
        rows.push(Row { text: "… more".chars().take(width).collect(), tone: Tone::Plain });
        rows.truncate(height);
        rows
    })
}

#[cfg(test)]
mod tests {
    use console::measure_text_width;

    use super::*;

    #[test]
    fn rows_keep_to_the_width_and_lose_no_word() {
        let words = "the quick brown fox 頭頭頭 jumps over averyveryveryveryveryveryverylongword 12345";
        for name in ["name", "a long name"] {
            for width in [1, 2, 5, 12, 13, 20, 40, 80, 100, 300] {
                let rows = layout(&[Line::new(name, words)], width);
                let longest = rows.iter().map(|row| measure_text_width(row)).max().unwrap();
                // A wide character does not fit a window of one column.
                assert!(longest <= width.max(2), "{width}: {rows:#?}");
                let all = |text: &str| text.chars().filter(|c| *c != ' ').collect::<String>();
                let shown = all(&rows.concat());
                assert!(shown.ends_with(&all(words)), "{width}: {rows:#?}");
            }
        }
    }

    #[test]
    fn a_low_window_keeps_what_matters() {
        let mut lines = [Line::new("pose", "1 2 3"), Line::new("rate", "4000"), Line::new("clock", "fine")];
        lines[1].rank(1);
        lines[2].rank(3);
        let lines: Vec<_> = lines.iter().collect();
        let names = |height| {
            let rows = fit(&lines, 40, height);
            rows.iter().map(|row| row.text.split(' ').next().unwrap_or_default().to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(names(5), ["pose", "rate", "clock"]);
        assert_eq!(names(2), ["pose", "rate"]);
        assert_eq!(names(1), ["pose"]);
        assert_eq!(names(0), [""; 0]);
    }

    #[test]
    fn control_characters_are_escaped() {
        assert_eq!(layout(&[Line::new("said", "a\u{1b}[2Jb\nc")], 80), ["said        a\\u{1b}[2Jb\\nc"]);
    }
}
