//! Text from outside, escaped for a terminal.
//!
//! Names and messages of boards, scene files, tables, captures, file names and answers of other
//! programs may contain any character. On a terminal, control characters of C0 and C1 (ECMA-48) move
//! the cursor, change its title or send input on the user's behalf; bidirectional controls (Unicode
//! Standard Annex #9) change the displayed order; invisible characters hide text. This module replaces
//! them by their escapes, such as `\u{1b}`.
//!
//! * [`printable`] is for a name, a field or a message inside a sentence: one line, bounded.
//! * [`printable_lines`] is for a whole text: lines and tabs stay, and so does its length.

use std::borrow::Cow;
use std::fmt::{self, Write};

/// The most characters of a foreign text inside a sentence: two lines of a terminal.
pub const LONGEST: usize = 160;

/// `text` for use inside a sentence: at most [`LONGEST`] characters, then their total number.
pub fn printable(text: &str) -> Printable<'_> {
    Printable { text, longest: LONGEST }
}

/// `text` with line feeds and tabs as they are.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    let stays = |character: char| matches!(character, '\n' | '\t') || !is_hidden(character);
    if text.chars().all(stays) {
        return Cow::Borrowed(text);
    }
    let mut escaped = String::with_capacity(text.len() + 16);
    for character in text.chars() {
        if stays(character) { escaped.push(character) } else { escaped.extend(character.escape_default()) }
    }
    Cow::Owned(escaped)
}

/// A foreign text that is safe to display.
#[derive(Clone, Copy, Debug)]
pub struct Printable<'a> {
    text: &'a str,
    longest: usize,
}

impl Printable<'_> {
    /// With `longest` characters at most instead of [`LONGEST`].
    pub fn at_most(self, longest: usize) -> Self {
        Self { longest, ..self }
    }
}

impl fmt::Display for Printable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Escapes are longer than their characters: the bound is on the displayed text.
        let mut room = self.longest;
        for character in self.text.chars() {
            let shown = if is_hidden(character) { character.escape_default().count() } else { 1 };
            if shown > room {
                return write!(f, "… ({} characters)", self.text.chars().count());
            }
            room -= shown;
            if shown > 1 { write!(f, "{}", character.escape_default())? } else { f.write_char(character)? }
        }
        Ok(())
    }
}

/// Whether a terminal would act on a character, or not display it.
fn is_hidden(character: char) -> bool {
    character.is_control()
        || matches!(character,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_character_that_a_terminal_acts_on_is_left() {
        // C0, DEL and C1 by ECMA-48; marks, embeddings, overrides and isolates by UAX #9.
        let acted_on = (0..0x20).chain(0x7f..0xa0).chain([0x61c, 0x200e, 0x200f]);
        for code in acted_on.chain(0x202a..=0x202e).chain(0x2066..=0x2069) {
            let character = char::from_u32(code).unwrap();
            let text = format!("a{character}b");
            let shown = printable(&text).to_string();
            assert!(
                !shown.contains(character) && shown.starts_with("a\\") && shown.ends_with('b'),
                "U+{code:04x}: {shown}"
            );
            let is_layout = matches!(character, '\n' | '\t');
            assert_eq!(printable_lines(&text).contains(character), is_layout, "U+{code:04x}");
        }
    }

    #[test]
    fn ordinary_text_of_any_language_stays() {
        for text in ["", "wide", "Kopf Ω 3 µm", "頭", "رأس", "a\\b 'c' \"d\""] {
            assert_eq!(printable(text).to_string(), text);
            assert_eq!(printable_lines(text), text);
        }
    }

    #[test]
    fn long_text_is_cut_and_gives_its_length() {
        let fits = "é".repeat(LONGEST);
        assert_eq!(printable(&fits).to_string(), fits);
        let long = "x".repeat(100_000);
        assert_eq!(printable(&long).to_string(), "x".repeat(LONGEST) + "… (100000 characters)");
        assert_eq!(printable("\u{1b}\u{1b}").at_most(7).to_string(), "\\u{1b}… (2 characters)");
    }
}
