//! Rows drawn in place, and their removal.

use console::{Term, measure_text_width};

use super::line::Row;

/// A window, in characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Size {
    pub(super) columns: usize,
    pub(super) rows: usize,
}

impl Size {
    pub(super) fn of(term: &Term) -> Self {
        let (rows, columns) = term.size();
        Self { columns: columns.into(), rows: rows.into() }
    }
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
    pub(super) fn replace(&mut self, rows: &[Row], size: Size, has_colours: bool) -> String {
        let mut text = match self.rows {
            0 => String::new(),
            _ if self.widest > size.columns || self.rows >= size.rows => "\x1b[H\x1b[2J".to_owned(),
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
    use std::num::NonZero;

    use super::*;
    use crate::terminal::{Line, line::fit};

    /// A terminal (of the crate vt100) and what was drawn on it.
    struct Drawn {
        parser: vt100::Parser,
        block: Block,
    }

    impl Drawn {
        fn new(rows: u16, columns: u16) -> Self {
            let mut parser = vt100::Parser::new(count(rows), count(columns), 0);
            parser.process(b"$ slitpose run\r\n");
            Self { parser, block: Block::NONE }
        }

        fn draw(&mut self, lines: &[Line]) -> Vec<String> {
            let (rows, columns) = self.parser.screen().size();
            let (rows, columns) = (rows.get(), columns.get());
            let size = Size { columns: columns.into(), rows: rows.into() };
            let rows = fit(&lines.iter().collect::<Vec<_>>(), size.columns, size.rows - 1);
            // The line discipline makes CR LF of LF (POSIX, ONLCR).
            let text = self.block.replace(&rows, size, true).replace('\n', "\r\n");
            self.parser.process(text.as_bytes());
            let wrapped = (0..size.rows as u16).find(|row| self.parser.screen().row_wrapped(*row));
            assert_eq!(wrapped, None, "a row was wrapped by the terminal:\n{}", self.parser.screen().contents());
            self.parser.screen().rows(0, columns).map(|row| row.trim_end().to_owned()).collect()
        }
    }

    fn count(characters: u16) -> NonZero<u16> {
        NonZero::new(characters).unwrap()
    }

    fn lines(number: usize, words: usize) -> Vec<Line> {
        (0..number).map(|i| Line::new("line", &format!("{i} {}", "word ".repeat(words)))).collect()
    }

    #[test]
    fn drawn_again_nothing_is_left_over() {
        for (rows, columns) in [(24, 80), (10, 40), (50, 200), (5, 20)] {
            let mut drawn = Drawn::new(rows, columns);
            // Longer, shorter, higher and lower than before, and than the window has room for.
            for (count, words) in [(3, 5), (1, 1), (3, 40), (30, 30), (2, 2), (0, 0), (4, 100)] {
                let rows = drawn.draw(&lines(count, words));
                let begun = rows.iter().filter(|row| row.starts_with("line")).count();
                assert!(begun <= count, "{begun} of {count} lines: {rows:#?}");
                assert_eq!(rows.iter().any(|row| row.starts_with("line")), count > 0, "{rows:#?}");
            }
        }
    }

    #[test]
    fn a_window_of_another_size_holds_the_lines_once() {
        let mut drawn = Drawn::new(24, 80);
        drawn.draw(&lines(6, 14));
        for (rows, columns) in [(24, 40), (10, 40), (10, 100), (24, 30), (4, 80), (24, 80)] {
            drawn.parser.screen_mut().set_size(count(rows), count(columns));
            let shown = drawn.draw(&lines(6, 14));
            let begun: Vec<_> = shown.iter().filter(|row| row.starts_with("line")).collect();
            assert!(!begun.is_empty() && begun.len() <= 6, "{rows} x {columns}: {shown:#?}");
            let mut once = begun.clone();
            once.dedup();
            assert_eq!(begun, once, "{rows} x {columns}");
        }
    }

    #[test]
    fn earlier_messages_stay() {
        let mut drawn = Drawn::new(24, 80);
        drawn.draw(&lines(3, 3));
        assert_eq!(drawn.draw(&lines(3, 3))[0], "$ slitpose run");
    }
}
