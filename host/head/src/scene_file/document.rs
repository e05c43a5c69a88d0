//! The parsed text of a scene file: every value with its place.
//!
//! One look-up rule serves reading and error messages alike: a key of a cell is sought in the
//! cell's own table of that section, then in the section of defaults.

use std::ops::{Range, RangeInclusive};

use slitpose_model::{Fault, MAX_CELLS, Place, SceneError};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::keys::{self, FilePlace, KeyPath, Kind, SceneFileError, nearest};
use crate::foreign::printable;

pub(super) type Entry<'a> = Spanned<DeValue<'a>>;

/// A value longer than this, in characters, is cut in messages.
const MAX_QUOTE: usize = 60;

pub(super) struct Document<'a> {
    origin: &'a str,
    text: &'a str,
    root: DeTable<'a>,
}

impl<'a> Document<'a> {
    /// Parses the text and checks it by the table of keys.
    pub(super) fn parse(origin: &'a str, text: &'a str) -> Result<Self, SceneFileError> {
        let root = DeTable::parse(text).map_err(|error| {
            let offset = error.span().map_or(0, |span| span.start);
            let message = error.message().replace('\n', ", ");
            let text_of_error = format!("not valid TOML here: {}; correct this line", printable(&message));
            SceneFileError::Content(FilePlace::of(origin, text, offset), text_of_error)
        })?;
        let document = Self { origin, text, root: root.into_inner() };
        document.check_keys()?;
        Ok(document)
    }

    /// Refuses unknown keys, sections that are no tables, and values of another kind than their key's.
    fn check_keys(&self) -> Result<(), SceneFileError> {
        self.check_table(&self.root, "the scene file", &keys::top())?;
        self.root
            .get("name")
            .into_iter()
            .try_for_each(|entry| self.check_value(KeyPath::top("name"), Kind::Text, entry))?;
        for section in &keys::SECTIONS {
            if let Some(entry) = self.root.get(section.name) {
                let table = self.as_table(KeyPath::top(section.name), entry)?;
                self.check_section(table, &format!("[{}]", section.name), None, section)?;
            }
        }
        if let Some(entry) = self.root.get("cell").filter(|entry| entry.get_ref().as_array().is_none()) {
            return Err(self.wrong_type(KeyPath::top("cell"), entry, "cells as [[cell]] sections"));
        }
        for (number, entry) in self.cells().iter().enumerate() {
            let cell = self.as_table(KeyPath::top("cell"), entry)?;
            self.check_table(cell, &format!("[[cell]] number {number}"), &keys::of_cell())?;
            self.check_values(cell, &keys::OWN, |key| KeyPath::of_cell(number, "cell", key))?;
            for section in &keys::SECTIONS[..keys::PER_CELL] {
                if let Some(entry) = cell.get(section.name) {
                    let table = self.as_table(KeyPath::of_cell(number, "cell", section.name), entry)?;
                    self.check_section(table, &format!("`{}` of cell {number}", section.name), Some(number), section)?;
                }
            }
        }
        Ok(())
    }

    fn check_section(
        &self,
        table: &DeTable<'_>,
        title: &str,
        cell: Option<usize>,
        section: &keys::Section,
    ) -> Result<(), SceneFileError> {
        self.check_table(table, title, &section.keys.iter().map(|key| key.name).collect::<Vec<_>>())?;
        self.check_values(table, section.keys, |key| KeyPath { cell, section: section.name, key })
    }

    fn check_values(
        &self,
        table: &DeTable<'_>,
        keys: &[keys::Key],
        path: impl Fn(&'static str) -> KeyPath,
    ) -> Result<(), SceneFileError> {
        let given = keys.iter().filter_map(|key| Some((key, table.get(key.name)?)));
        given.into_iter().try_for_each(|(key, entry)| self.check_value(path(key.name), key.kind, entry))
    }

    fn check_value(&self, path: KeyPath, kind: Kind, entry: &Entry<'_>) -> Result<(), SceneFileError> {
        let of = |kind| move |item: &Entry<'_>| self.check_value(path, kind, item);
        let row = |count| move |row: &Entry<'_>| self.check_items(path, kind, row, count..=count, of(Kind::Number));
        let is_fit = match kind {
            Kind::Vector(count, _) => return self.check_items(path, kind, entry, count..=count, of(Kind::Number)),
            Kind::List(most) => return self.check_items(path, kind, entry, 0..=most, of(Kind::Number)),
            Kind::Matrix(rows, columns, _) => return self.check_items(path, kind, entry, rows..=rows, row(columns)),
            Kind::Pairs(most) => match entries_of(entry).len() {
                knots if knots > most => {
                    return Err(self.error_at(entry.span(), format!("{path} has {knots} knots; give at most {most}")));
                }
                _ => return self.check_items(path, kind, entry, 0..=most, row(2)),
            },
            Kind::Slots => {
                let emitter = Kind::Whole(0, MAX_CELLS as u64 - 1);
                let slot = |slot: &Entry<'_>| self.check_items(path, kind, slot, 0..=usize::MAX, of(emitter));
                return self.check_items(path, kind, entry, 0..=usize::MAX, slot);
            }
            Kind::Text => entry.get_ref().as_str().map(|_| true),
            Kind::OneOf(words) => entry.get_ref().as_str().map(|word| words.contains(&word)),
            Kind::Number => number_of(entry).map(f64::is_finite),
            Kind::Whole(least, most) => {
                integer_of(entry).map(|value| u64::try_from(value).is_ok_and(|value| (least..=most).contains(&value)))
            }
        };
        match is_fit {
            Some(true) => Ok(()),
            Some(false) if kind == Kind::Number => Err(self.out_of_range(path, entry, "a finite number")),
            Some(false) => Err(self.out_of_range(path, entry, &kind.to_string())),
            None => Err(self.wrong_type(path, entry, &kind.to_string())),
        }
    }

    /// Checks an array of so many items, which is `kind` as a whole.
    fn check_items<'s>(
        &self,
        path: KeyPath,
        kind: Kind,
        entry: &'s Entry<'a>,
        counts: RangeInclusive<usize>,
        check: impl FnMut(&'s Entry<'a>) -> Result<(), SceneFileError>,
    ) -> Result<(), SceneFileError> {
        match entry.get_ref().as_array().filter(|array| counts.contains(&array.len())) {
            Some(array) => array.iter().try_for_each(check),
            None => Err(self.wrong_type(path, entry, &kind.to_string())),
        }
    }

    fn check_table(&self, table: &DeTable<'_>, section: &str, known: &[&'static str]) -> Result<(), SceneFileError> {
        let unknown =
            table.keys().filter(|key| !known.contains(&key.get_ref().as_ref())).min_by_key(|key| key.span().start);
        let Some(key) = unknown else {
            return Ok(());
        };
        let suggestion = match nearest(key.get_ref(), known) {
            Some(nearest) => format!("did you mean `{nearest}`?"),
            None => format!("known keys: {}", known.join(", ")),
        };
        let text = format!("unknown key `{}` in {section}; {suggestion}", printable(key.get_ref()));
        Err(self.error_at(key.span(), text))
    }

    pub(super) fn cells(&self) -> &[Entry<'a>] {
        self.root.get("cell").map_or(&[], entries_of)
    }

    /// The value of a key, by the look-up rule at the head of this file.
    pub(super) fn find(&self, path: KeyPath) -> Option<&Entry<'a>> {
        let own = path.cell.and_then(|cell| self.find_own(cell, path.section, path.key));
        own.or_else(|| match path.section {
            "" => self.root.get(path.key),
            section => table_of(self.root.get(section)?)?.get(path.key),
        })
    }

    /// The value of a key if it stands in the cell itself, not in the defaults.
    pub(super) fn find_own(&self, cell: usize, section: &str, key: &str) -> Option<&Entry<'a>> {
        let cell = table_of(self.cells().get(cell)?)?;
        match section {
            "cell" => cell.get(key),
            section => table_of(cell.get(section)?)?.get(key),
        }
    }

    /// The profile keys that count for a cell. They count as one: a cell that gives any of them replaces the defaults'.
    pub(super) fn profiles_given(&self, cell: usize) -> Vec<&'static str> {
        let own = |key: &&'static str| self.find_own(cell, "emitter", key).is_some();
        let any = |key: &&'static str| self.find(KeyPath::section("emitter", key)).is_some();
        let given = keys::PROFILES.into_iter().filter(own).collect::<Vec<_>>();
        if given.is_empty() { keys::PROFILES.into_iter().filter(any).collect() } else { given }
    }

    /// Whether a section is in the file.
    pub(super) fn has_section(&self, section: &str) -> bool {
        self.root.contains_key(section)
    }

    /// Whether a section has keys, and no others than these.
    pub(super) fn has_only(&self, section: &str, keys: &[&str]) -> bool {
        let table = self.root.get(section).and_then(table_of);
        table.is_some_and(|table| {
            !table.is_empty() && table.iter().all(|(key, _)| keys.contains(&key.get_ref().as_ref()))
        })
    }

    /// Whether a section is in the file, or of its own in a cell.
    pub(super) fn has_section_for(&self, cell: usize, section: &str) -> bool {
        self.has_section(section) || self.find_own(cell, "cell", section).is_some()
    }

    pub(super) fn text(&self, path: KeyPath) -> Option<&str> {
        self.find(path)?.get_ref().as_str()
    }

    pub(super) fn whole(&self, path: KeyPath) -> Option<u32> {
        integer_of(self.find(path)?)?.try_into().ok()
    }

    /// A number in SI, if the key is there.
    pub(super) fn number(&self, path: KeyPath) -> Option<f64> {
        Some(self.written(path)? * path.unit())
    }

    /// A number in the file's own unit, if the key is there.
    pub(super) fn written(&self, path: KeyPath) -> Option<f64> {
        number_of(self.find(path)?)
    }

    /// A number in SI that must be there.
    pub(super) fn required(&self, path: KeyPath) -> Result<f64, SceneFileError> {
        self.number(path).ok_or_else(|| self.missing(path))
    }

    /// A number in SI; out of range unless `is_allowed`, which `allowed` says in words.
    pub(super) fn within(
        &self,
        path: KeyPath,
        value: f64,
        is_allowed: impl FnOnce(f64) -> bool,
        allowed: &str,
    ) -> Result<f64, SceneFileError> {
        match self.find(path) {
            Some(entry) if !is_allowed(value) => Err(self.out_of_range(path, entry, allowed)),
            _ => Ok(value),
        }
    }

    /// A number of zero or more in SI; `default` if the key is not there.
    pub(super) fn not_negative(&self, path: KeyPath, default: f64) -> Result<f64, SceneFileError> {
        let value = self.number(path).unwrap_or(default);
        self.within(path, value, |value| value >= 0.0, "zero or more")
    }

    /// A vector in SI, if the key is there.
    pub(super) fn vector<const N: usize>(&self, path: KeyPath) -> Option<[f64; N]> {
        self.find(path).map(|entry| vector_of(entry).map(|value| value * path.unit()))
    }

    /// Rows of numbers in the file's own unit, if the key is there.
    pub(super) fn matrix<const N: usize, const M: usize>(&self, path: KeyPath) -> Option<[[f64; M]; N]> {
        let rows = entries_of(self.find(path)?);
        Some(std::array::from_fn(|row| rows.get(row).map_or([0.0; M], vector_of)))
    }

    /// Numbers in SI; none if the key is not there.
    pub(super) fn list<const N: usize>(&self, path: KeyPath) -> heapless::Vec<f64, N> {
        let numbers = self.find(path).map_or(&[][..], entries_of).iter().filter_map(number_of);
        numbers.map(|number| number * path.unit()).take(N).collect()
    }

    fn as_table<'s>(&self, path: KeyPath, entry: &'s Entry<'a>) -> Result<&'s DeTable<'a>, SceneFileError> {
        table_of(entry).ok_or_else(|| self.wrong_type(path, entry, "a table"))
    }

    /// The error `text` at a key; at the key's section or cell, if the key is not written.
    pub(super) fn error(&self, path: KeyPath, text: String) -> SceneFileError {
        let section = || self.root.get(path.section).filter(|_| path.section != "cell");
        let cell = || self.cells().get(path.cell?);
        let place = self.find(path).or_else(section).or_else(cell);
        self.error_at(place.map_or(0..0, Spanned::span), text)
    }

    /// The error `text` at a span of the text.
    pub(super) fn error_at(&self, span: Range<usize>, text: String) -> SceneFileError {
        SceneFileError::Content(FilePlace::of(self.origin, self.text, span.start), text)
    }

    pub(super) fn missing(&self, path: KeyPath) -> SceneFileError {
        self.error(path, format!("{path} is missing; add `{} = …` to {}", path.key, path.home()))
    }

    pub(super) fn wrong_type(&self, path: KeyPath, entry: &Entry<'_>, expected: &str) -> SceneFileError {
        let (text, found) = (self.quote(entry.span()), kind_of(entry.get_ref()));
        self.error_at(entry.span(), format!("{path} = {text} is {found}; give {expected}"))
    }

    pub(super) fn out_of_range(&self, path: KeyPath, entry: &Entry<'_>, allowed: &str) -> SceneFileError {
        let text = self.quote(entry.span());
        self.error_at(entry.span(), format!("{path} = {text} is out of range; give {allowed}"))
    }

    /// What the model says of a value, at the place of that value, in the file's own unit.
    pub(super) fn optics_error(&self, error: SceneError) -> SceneFileError {
        let Place { cell, section, key } = error.place;
        let mut path = KeyPath { cell, section, key };
        let diameter = KeyPath { key: "diameter_mm", ..path };
        // The model has the diameter of a hole as its width and length.
        let is_size = path.section == "slit" && matches!(path.key, "width_mm" | "length_mm");
        if is_size && self.find(path).is_none() && self.find(diameter).is_some() {
            path = diameter;
        }
        // It has a half angle as the exponent that follows from it.
        let given = path.cell.filter(|_| path.key == "profile_exponent").map(|cell| self.profiles_given(cell));
        if given.is_some_and(|given| given == ["half_angle_deg"]) {
            let path = KeyPath { key: "half_angle_deg", ..path };
            let text = self.quoted(path);
            return self.error(path, format!("{path} = {text} degrees is too narrow to compute; give 0.07 or more"));
        }
        let entry = self.find(path);
        let written = entry.and_then(number_of);
        let fault = match (error.fault, written) {
            (Fault::NotFinite(_), Some(value)) => Fault::NotFinite(value),
            (Fault::Negative(_), Some(value)) => Fault::Negative(value),
            (Fault::TooLarge(_), Some(value)) => Fault::TooLarge(value),
            (Fault::NotPositive(_), Some(value)) => Fault::NotPositive(value),
            (fault, _) => fault,
        };
        let text = entry.map(|entry| format!(" = {}", self.quote(entry.span()))).unwrap_or_default();
        self.error(path, format!("{path}{text}: {fault}"))
    }

    /// The value of a key as the file writes it.
    pub(super) fn quoted(&self, path: KeyPath) -> String {
        self.find(path).map(|entry| self.quote(entry.span())).unwrap_or_default()
    }

    /// The text of a span, on one line and not too long.
    fn quote(&self, span: Range<usize>) -> String {
        let line = self.text.get(span).unwrap_or_default().split_whitespace();
        printable(&line.collect::<Vec<_>>().join(" ")).at_most(MAX_QUOTE).to_string()
    }
}

fn table_of<'s, 'a>(entry: &'s Entry<'a>) -> Option<&'s DeTable<'a>> {
    entry.get_ref().as_table()
}

/// What an array holds; nothing of what is none.
pub(super) fn entries_of<'s, 'a>(entry: &'s Entry<'a>) -> &'s [Entry<'a>] {
    entry.get_ref().as_array().map_or(&[], |array| array)
}

/// The numbers of an array that has been checked.
pub(super) fn vector_of<const N: usize>(entry: &Entry<'_>) -> [f64; N] {
    let entries = entries_of(entry);
    std::array::from_fn(|at| entries.get(at).and_then(number_of).unwrap_or(f64::NAN))
}

fn number_of(entry: &Entry<'_>) -> Option<f64> {
    match entry.get_ref() {
        DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok(),
        DeValue::Integer(_) => integer_of(entry).map(|value| value as f64),
        DeValue::Float(float) => float.as_str().parse().ok(),
        _ => None,
    }
}

pub(super) fn integer_of(entry: &Entry<'_>) -> Option<i64> {
    let integer = entry.get_ref().as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

fn kind_of(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "a text",
        DeValue::Integer(_) | DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "an array",
        DeValue::Table(_) => "a table",
    }
}
