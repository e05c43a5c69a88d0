//! The user's terminal: the only place that draws there.
//!
//! A view (the state of boards) and a progress line are drawn anew in place, below everything that
//! messages before; messages go above them. `line` lays lines out for a window, `block` keeps
//! account of the rows on the screen, `progress` shows how far a long command has come.
//!
//! Nothing is drawn in place unless the stream is a terminal that can move its cursor (TERM is set
//! and not `dumb`). Colours mark what is wrong; NO_COLOR, set to anything, turns them off.

mod block;
mod line;
mod progress;

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::sync::{Mutex, PoisonError};

use console::Term;

pub(crate) use line::{Line, Tone, WIDTH, layout};
pub(crate) use progress::{Amount, Progress, hide as hide_progress};

use block::{Block, Size};
use slitpose_head::foreign::printable;

/// Longer messages are cut: texts of boards or files may make them long.
const LONGEST_MESSAGE: usize = 4000;

/// Everything that is drawn in place.
static SCREEN: Mutex<Screen> =
    Mutex::new(Screen { view: Vec::new(), progress: None, target: None, block: Block::NONE });

struct Screen {
    view: Vec<Line>,
    progress: Option<Line>,
    /// Where it is drawn; `None`: nowhere, so far.
    target: Option<Term>,
    block: Block,
}

/// Whether standard output can be drawn on in place.
pub(crate) fn is_live() -> bool {
    io::stdout().is_terminal() && !is_dumb()
}

/// A terminal of no known kind is treated as one that only prints.
fn is_dumb() -> bool {
    console::is_dumb() || std::env::var_os("TERM").is_some_and(|name| name.is_empty())
}

/// Whether a stream that `is_terminal` gets colours.
pub(crate) fn has_colours(is_terminal: bool) -> bool {
    // https://no-color.org: set, and not empty.
    is_terminal && !is_dumb() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Draws `lines` on standard output in place of the last ones.
///
/// # Errors
/// Those of standard output.
pub(crate) fn show(lines: Vec<Line>) -> io::Result<()> {
    let mut screen = screen();
    screen.view = lines;
    screen.target.get_or_insert_with(Term::buffered_stdout);
    screen.draw()
}

/// Columns of the terminal of standard output.
pub(crate) fn columns() -> usize {
    Size::of(&Term::stdout()).columns
}

/// Erases the lines drawn in place.
pub(crate) fn clear() {
    let mut screen = screen();
    (screen.view, screen.progress) = (Vec::new(), None);
    // Nobody sees a terminal that cannot be written.
    let _ = screen.draw();
}

/// Writes one line to `output`, standard output, above what is drawn in place.
///
/// # Errors
/// Those of `output`.
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

/// Says why the command ends.
pub(crate) fn complain(text: fmt::Arguments<'_>) {
    write_message(Tone::Wrong, text);
}

fn write_message(tone: Tone, text: fmt::Arguments<'_>) {
    let text = text.to_string();
    let text = printable(&text).at_most(LONGEST_MESSAGE);
    let name = tone.paint("slitpose:", has_colours(io::stderr().is_terminal()));
    let write = || writeln!(io::stderr(), "{name} {text}");
    // Elsewhere it disturbs no view, and does not wait for a terminal that is held (Ctrl-S). Nobody is
    // left to tell if even standard error is closed.
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
        let size = Size::of(target);
        let lines: Vec<&Line> = self.view.iter().chain(&self.progress).collect();
        let rows = line::fit(&lines, size.columns, size.rows.saturating_sub(1));
        target.write_str(&self.block.replace(&rows, size, has_colours(true)))?;
        target.flush()
    }

    /// Writes above what is drawn.
    fn above(&mut self, write: impl FnOnce() -> io::Result<()>) -> io::Result<()> {
        let Some(target) = &self.target else { return write() };
        target.write_str(&self.block.replace(&[], Size::of(target), false))?;
        target.flush()?;
        let written = write();
        written.and(self.draw())
    }
}
