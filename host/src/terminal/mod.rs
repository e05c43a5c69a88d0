//! The user's terminal: the only module that draws on it.
//!
//! A view (the state of boards) and a progress line are redrawn in place; messages are printed above
//! them. `line` lays lines out for a window, `block` tracks the rows on the screen, `progress` shows
//! the progress of a long command.
//!
//! Nothing is drawn in place unless the stream is a terminal that can move its cursor (TERM is set
//! and not `dumb`). Colours mark faults; a non-empty NO_COLOR turns them off.

mod line;
mod progress;

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::sync::{Mutex, PoisonError};

use console::Term;

pub(crate) use line::{Line, Tone, WIDTH, layout};
pub(crate) use progress::{Amount, Progress, hide as hide_progress};

use progress::{Block, Size};
use slitpose_head::foreign::printable;

/// Longer messages, with texts from boards or files, are cut.
const LONGEST_MESSAGE: usize = 4000;

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

/// Columns of the terminal of standard output.
pub(crate) fn columns() -> usize {
    Size::of(&Term::stdout()).columns
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
    let text = printable(&text).at_most(LONGEST_MESSAGE);
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
        let size = Size::of(target);
        let lines: Vec<&Line> = self.view.iter().chain(&self.progress).collect();
        let rows = line::fit(&lines, size.columns, size.rows.saturating_sub(1));
        target.write_str(&self.block.replace(&rows, size, has_colours(true)))?;
        target.flush()
    }

    fn above(&mut self, write: impl FnOnce() -> io::Result<()>) -> io::Result<()> {
        let Some(target) = &self.target else { return write() };
        target.write_str(&self.block.replace(&[], Size::of(target), false))?;
        target.flush()?;
        let written = write();
        written.and(self.draw())
    }
}
