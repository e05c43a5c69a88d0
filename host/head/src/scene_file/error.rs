//! Errors in a scene file, with place and next step.

use std::fmt;

use slitpose_model::{Fault, Place};
use thiserror::Error;

use super::shipped::SHIPPED;
use super::spelling::nearest;
use crate::foreign::printable;
use crate::text_file::TextFileError;

/// Why a scene cannot be had from a file.
#[derive(Debug, Error)]
pub enum SceneFileError {
    /// There is no such file and no such shipped scene, or the file cannot be read.
    #[error(
        "cannot read scene `{}`; {}give a scene file or a shipped scene ({})",
        printable(argument),
        meant(argument),
        shipped_names()
    )]
    Read {
        /// The SCENE argument.
        argument: String,
        /// Why not.
        source: TextFileError,
    },
    /// The text is not a usable scene.
    #[error("{0}")]
    Content(Box<ContentError>),
}

impl SceneFileError {
    pub(super) fn content(place: FilePlace, fault: ContentFault) -> Self {
        Self::Content(Box::new(ContentError { place, fault }))
    }
}

fn shipped_names() -> String {
    SHIPPED.map(|shipped| shipped.name).join(", ")
}

/// The shipped scene whose name is spelt almost like `argument`.
fn meant(argument: &str) -> String {
    let nearest = nearest(argument, &SHIPPED.map(|shipped| shipped.name));
    nearest.map_or_else(String::new, |name| format!("did you mean `{name}`? Otherwise "))
}

/// One fault at one place in the text.
#[derive(Debug, Error)]
#[error("{place}: {fault}")]
pub struct ContentError {
    /// Where in the file.
    pub place: FilePlace,
    /// What is wrong there.
    pub fault: ContentFault,
}

/// A place in a file, as editors jump to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilePlace {
    /// The file's path or the shipped scene's name.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
}

impl FilePlace {
    /// The place of a byte offset in `text`.
    pub fn of(file: &str, text: &str, offset: usize) -> Self {
        let before = text.get(..offset).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        Self {
            file: file.to_owned(),
            line: before.matches('\n').count() + 1,
            column: before[line_start..].chars().count() + 1,
        }
    }
}

impl fmt::Display for FilePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", printable(&self.file), self.line, self.column)
    }
}

/// A key of the scene file, in the words of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeyPath {
    /// The cell's number; `None`: not of a cell.
    pub cell: Option<usize>,
    /// The section; empty at the top level, `cell` for keys of `[[cell]]` itself.
    pub section: &'static str,
    /// The key.
    pub key: &'static str,
}

impl KeyPath {
    pub(super) const fn top(key: &'static str) -> Self {
        Self::section("", key)
    }

    pub(super) const fn section(section: &'static str, key: &'static str) -> Self {
        Self { cell: None, section, key }
    }

    pub(super) const fn of_cell(cell: usize, section: &'static str, key: &'static str) -> Self {
        Self { cell: Some(cell), section, key }
    }
}

impl From<Place> for KeyPath {
    fn from(place: Place) -> Self {
        Self { cell: place.cell, section: place.section, key: place.key }
    }
}

impl fmt::Display for KeyPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(cell) = self.cell {
            write!(f, "cell {cell}, ")?;
        }
        match self.section {
            "" | "cell" => f.write_str(self.key),
            section => write!(f, "{section}.{}", self.key),
        }
    }
}

/// Errors at a place of the file. `text` is always the value as the file writes it.
#[derive(Debug, Error)]
pub enum ContentFault {
    /// A byte that is no text.
    #[error("byte 0x{byte:02x} is not UTF-8 text; save the file as UTF-8")]
    NotText {
        /// The byte.
        byte: u8,
    },
    /// Not TOML.
    #[error("not valid TOML here: {}; correct this line", printable(message))]
    Syntax {
        /// What the TOML parser said.
        message: String,
    },
    /// An unknown key.
    #[error("unknown key `{}` in {section}; {}", printable(key), suggestion(*nearest, known))]
    UnknownKey {
        /// Where it stands, e.g. `[slit]`.
        section: String,
        /// The key.
        key: String,
        /// A known key that is spelled almost like it.
        nearest: Option<&'static str>,
        /// The keys this section may have.
        known: &'static [&'static str],
    },
    /// A key that must be there and is not.
    #[error("{path} is missing; add `{} = …` to {}", path.key, home_of(path))]
    MissingKey {
        /// The key.
        path: KeyPath,
    },
    /// A value of another kind than the key needs.
    #[error("{path} = {text} is {found}; give {expected}")]
    WrongType {
        /// The key.
        path: KeyPath,
        /// The value as written.
        text: String,
        /// What it is.
        found: &'static str,
        /// What it should be.
        expected: &'static str,
    },
    /// A number outside what the key can mean.
    #[error("{path} = {text} is out of range; give {allowed}")]
    OutOfRange {
        /// The key.
        path: KeyPath,
        /// The value as written.
        text: String,
        /// The allowed numbers, in words.
        allowed: &'static str,
    },
    /// More than one way to give the profile, or none.
    #[error(
        "cell {cell} has {count} emission profiles; give exactly one of half_angle_deg, profile_exponent, profile in [emitter]"
    )]
    ProfileChoice {
        /// The cell's number.
        cell: usize,
        /// How many were given in the section that counts.
        count: usize,
    },
    /// A lobe too narrow to compute.
    #[error("{path} = {text} degrees is too narrow to compute; give 0.07 or more")]
    TooNarrow {
        /// The key.
        path: KeyPath,
        /// The value as written.
        text: String,
    },
    /// Keys of one slit that do not go together.
    #[error("{path} = {text}: {why}")]
    Opening {
        /// The key.
        path: KeyPath,
        /// The value as written.
        text: String,
        /// What is wrong, and the next step.
        why: &'static str,
    },
    /// A second axis of what has none.
    #[error("{path} = {given} {why}; give the number of an earlier cell that has a detector of its own")]
    SecondAxis {
        /// The key.
        path: KeyPath,
        /// The cell that was given.
        given: i64,
        /// What is wrong with it.
        why: &'static str,
    },
    /// A key of a second axis that follows from the first.
    #[error("{path} cannot be given for a second axis, which has everything from cell {first}; remove it")]
    OfFirstAxis {
        /// The key.
        path: KeyPath,
        /// The cell of the first axis.
        first: usize,
    },
    /// A profile table with too many knots.
    #[error("{path} has {count} knots; give at most {most}")]
    TooManyKnots {
        /// The key.
        path: KeyPath,
        /// How many.
        count: usize,
        /// How many are possible.
        most: usize,
    },
    /// More cells than a scene can have.
    #[error("the scene has {count} cells; at most {most} are possible, remove the others")]
    TooManyCells {
        /// How many.
        count: usize,
        /// How many are possible.
        most: usize,
    },
    /// The optical model refuses a value.
    #[error("{}: {fault}", with_text(path, text.as_deref()))]
    Optics {
        /// The key.
        path: KeyPath,
        /// The value as written, if it is written at all.
        text: Option<String>,
        /// What the model says of it.
        fault: Fault,
    },
    /// The lighting schedule makes no sense.
    #[error("lighting.slots: {0}")]
    Lighting(LightingFault),
}

/// Errors in the order in which emitters are lit.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum LightingFault {
    /// An emitter the scene does not have.
    #[error("emitter {emitter} does not exist; the scene has the cells 0 to {last}")]
    Unknown {
        /// The number given.
        emitter: i64,
        /// The last cell's number.
        last: usize,
    },
    /// An emitter lit more than once.
    #[error("emitter {emitter} is lit in slot {first} and again in slot {second}; light each emitter in one slot only")]
    Twice {
        /// The emitter.
        emitter: usize,
        /// Its first slot.
        first: usize,
        /// The slot that repeats it.
        second: usize,
    },
    /// An emitter that is never lit.
    #[error("emitter {emitter} is in no slot; add it to one, or remove its cell")]
    Never {
        /// The emitter.
        emitter: usize,
    },
    /// Both axes of a detector in different slots: they have one emitter.
    #[error("cells {first} and {second} read both axes of one detector; give them one slot, for they have one emitter")]
    Apart {
        /// The cell of the first axis.
        first: usize,
        /// That of the second.
        second: usize,
    },
    /// More than one dark slot.
    #[error("slots {first} and {second} are both dark; keep one `[]`")]
    TwoDark {
        /// The first dark slot.
        first: usize,
        /// The second.
        second: usize,
    },
    /// The schedule is longer than a frame.
    #[error(
        "{slots} slots of {slot_us:.1} µs take {:.1} µs, the frame period is {period_us:.1} µs; \
         light more emitters together, or lower front_end.frame_rate_hz, oversampling or settling_s",
        *slots as f64 * slot_us
    )]
    DoNotFit {
        /// How many slots.
        slots: usize,
        /// The duration of one.
        slot_us: f64,
        /// The frame period.
        period_us: f64,
    },
}

fn suggestion(nearest: Option<&'static str>, known: &[&str]) -> String {
    match nearest {
        Some(nearest) => format!("did you mean `{nearest}`?"),
        None => format!("known keys: {}", known.join(", ")),
    }
}

fn home_of(path: &KeyPath) -> String {
    match (path.cell, path.section) {
        (_, "") => "the top of the file".to_owned(),
        (Some(cell), "cell") => format!("[[cell]] number {cell}"),
        (Some(_), section) => format!("[{section}], or to the cell's own `{section}` table"),
        (None, section) => format!("[{section}]"),
    }
}

fn with_text(path: &KeyPath, text: Option<&str>) -> String {
    match text {
        Some(text) => format!("{path} = {text}"),
        None => path.to_string(),
    }
}
