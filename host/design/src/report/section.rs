//! The parts of a report, independent of its format, and charts side by side on one sheet.

use glam::dvec2;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::aligned;

use crate::plot::{Anchor, Canvas, Chart, TextStyle, three_digits};

pub(crate) fn program() -> (&'static str, String) {
    ("program", format!("slitpose {}", env!("CARGO_PKG_VERSION")))
}

/// The scene, where it came from, and its hash.
pub(crate) fn scene(file: &SceneFile) -> (&'static str, String) {
    ("scene", format!("{} ({}), hash {:016x}", file.name, file.origin, file.hash))
}

/// One entry of a table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    /// A word or two.
    Text(String),
    /// A word that must not be overlooked.
    Alert(String),
    /// A number in the unit of its column.
    Number(f64),
    Count(usize),
    /// There is no such number.
    Missing,
}

impl Value {
    /// A number; `None`, NaN and infinity are missing.
    pub(crate) fn optional(value: Option<f64>) -> Self {
        value.filter(|value| value.is_finite()).map_or(Self::Missing, Self::Number)
    }

    /// A number of millionths.
    pub(crate) fn micro(value: f64) -> Self {
        Self::from(value * 1e6)
    }

    /// As people read it: three significant digits.
    pub(crate) fn shown(&self) -> String {
        match self {
            Self::Text(text) | Self::Alert(text) => text.clone(),
            Self::Number(value) => three_digits(*value),
            Self::Count(count) => count.to_string(),
            Self::Missing => "—".to_owned(),
        }
    }

    /// Whether it stands at the right of its column.
    pub(crate) fn is_number(&self) -> bool {
        !matches!(self, Self::Text(_) | Self::Alert(_))
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Self::optional(Some(value))
    }
}

impl From<usize> for Value {
    fn from(count: usize) -> Self {
        Self::Count(count)
    }
}

/// A table.
#[derive(Clone, Debug)]
pub struct Table {
    pub(crate) name: &'static str,
    pub(crate) caption: String,
    /// Names in CSV, with the unit, such as `least_us`, and headings on a page, such as `time / µs`.
    pub(crate) columns: Vec<(&'static str, &'static str)>,
    /// Its rows, one value for each column.
    pub(crate) rows: Vec<Vec<Value>>,
}

/// A column of a table of `T`: its name in CSV, its heading on a page, and its value in a row.
pub(crate) type Getter<'a, T> = (&'static str, &'static str, &'a dyn Fn(&T) -> Value);

impl Table {
    /// A table with one row for each of `rows`.
    pub(crate) fn of<T>(name: &'static str, caption: impl Into<String>, rows: &[T], columns: &[Getter<'_, T>]) -> Self {
        Self {
            name,
            caption: caption.into(),
            columns: columns.iter().map(|(name, heading, _)| (*name, *heading)).collect(),
            rows: rows.iter().map(|row| columns.iter().map(|(.., value)| value(row)).collect()).collect(),
        }
    }

    /// Whether a column has numbers, by its first row.
    pub(crate) fn is_number(&self, column: usize) -> bool {
        self.rows.first().is_some_and(|row| row.get(column).is_some_and(Value::is_number))
    }

    /// In columns, for people.
    pub fn as_text(&self) -> String {
        let heading: Vec<String> = self.columns.iter().map(|(_, heading)| (*heading).to_owned()).collect();
        let shown = |row: &Vec<Value>| row.iter().map(Value::shown).collect::<Vec<_>>();
        let lines: Vec<Vec<String>> = [heading].into_iter().chain(self.rows.iter().map(shown)).collect();
        aligned(&lines, |column| self.is_number(column)).map(|line| format!("  {line}\n")).collect()
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Picture {
    pub(crate) name: &'static str,
    pub(crate) caption: String,
    pub(crate) svg: String,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Section {
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    /// What a reader of nothing else should know of it; it stands at the head of the report.
    pub(crate) summary: Vec<String>,
    /// Method and conclusions.
    pub(crate) paragraphs: Vec<String>,
    pub(crate) pictures: Vec<Picture>,
    pub(crate) tables: Vec<Table>,
}

/// A whole report.
#[derive(Clone, Debug, Default)]
pub struct Report {
    pub(crate) title: &'static str,
    pub(crate) scene: String,
    /// Conditions under which the numbers hold: names and values.
    pub(crate) conditions: Vec<(&'static str, String)>,
    /// What a reader must know before believing a number.
    pub warnings: Vec<String>,
    pub(crate) sections: Vec<Section>,
    /// Tables too long for a page: they are files only.
    pub(crate) data: Vec<Table>,
}

impl Report {
    /// What a reader of nothing else should know.
    pub fn summary(&self) -> impl Iterator<Item = &str> {
        self.sections.iter().flat_map(|section| &section.summary).map(String::as_str)
    }

    /// The summary and the first table, as a text for people.
    pub fn in_short(&self) -> String {
        let sentences: String = self.summary().map(|said| format!("{said}\n")).collect();
        let table = self.sections.iter().flat_map(|section| &section.tables).next().map(Table::as_text);
        let conditions: String = self.conditions.iter().map(|(name, value)| format!("{name}: {value}\n")).collect();
        format!("{}: {}\n\n{sentences}\n{}\n{conditions}", self.title, self.scene, table.unwrap_or_default())
    }
}

const LEFT: f64 = 84.0;
const GAP: f64 = 84.0;
const RIGHT: f64 = 24.0;
const HEIGHT: f64 = 380.0;

/// Between legend and plotting area: the headings of the panels.
const HEADING: f64 = 22.0;

/// Width of a plotting area that has the sheet for itself, and of one of two.
const ALONE: f64 = 660.0;
const OF_TWO: f64 = 400.0;

/// Charts with a common legend: that of the first.
pub(crate) struct Sheet {
    pub(crate) title: String,
    /// Conditions, in one line.
    pub(crate) note: String,
    pub(crate) panels: Vec<(String, Chart)>,
}

impl Sheet {
    pub(crate) fn draw(mut self, name: &'static str, caption: &str) -> Picture {
        for (_, chart) in self.panels.iter_mut().skip(1) {
            for curve in &mut chart.curves {
                curve.label.clear();
            }
        }
        let width = if self.panels.len() == 1 { ALONE } else { OF_TWO };
        let legend = self.panels.first().map_or(0.0, |(_, chart)| chart.legend_height());
        let top = 66.0 + legend + HEADING;
        let full = LEFT + self.panels.len() as f64 * (width + GAP) - GAP + RIGHT;
        let mut canvas = Canvas::titled(full, top + HEIGHT + 56.0, &self.title, &self.note);
        for (index, (heading, chart)) in self.panels.iter().enumerate() {
            let left = LEFT + index as f64 * (width + GAP);
            let (top_left, bottom_right) = (dvec2(left, top), dvec2(left + width, top + HEIGHT));
            chart.draw(&mut canvas, top_left, bottom_right, HEADING);
            let at = dvec2(bottom_right.x, top - 10.0);
            canvas.text(at, heading, TextStyle::new(13.0).bold().anchored(Anchor::End));
        }
        Picture { name, caption: caption.to_owned(), svg: canvas.into_svg() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::{Axis, CurveStyle, curve};

    #[test]
    fn numbers_are_shown_with_three_digits() {
        let cases = [
            (0.0, "0"),
            (1.0, "1.00"),
            (-2.345_678, "−2.35"),
            (999.7, "1000"),
            (12_345.0, "12300"),
            (0.004_567, "0.00457"),
            (4.567e-9, "4.6e−9"),
            (1e300, "1.0e300"),
        ];
        for (value, text) in cases {
            assert_eq!(Value::from(value).shown(), text);
        }
        assert_eq!(Value::from(f64::NAN), Value::Missing);
        assert_eq!(Value::optional(None).shown(), "—");
    }

    #[test]
    fn the_legend_stands_above_the_headings_however_long_it_is() {
        let label = "a curve with a name as long as the panel is wide, or longer";
        let chart = |label: &str| {
            let curves = vec![curve(label, 0, CurveStyle::Line, vec![[0.0, 0.0], [1.0, 1.0]])];
            Chart::over(curves, |x| Axis::around("x", x), |y| Axis::around("y", y))
        };
        let panels = vec![("first heading".to_owned(), chart(label)), ("second heading".to_owned(), chart(label))];
        let svg = Sheet { title: "t".to_owned(), note: "n".to_owned(), panels }.draw("name", "").svg;
        let height_of = |text: &str| -> f64 {
            let element = svg[..svg.find(text).unwrap()].rfind("translate(").unwrap();
            let place = svg[element..].split([' ', ')']).nth(1).unwrap();
            place.parse().unwrap()
        };
        // Letters of 13 pixels reach some 10 above their base line.
        for heading in ["first heading", "second heading"] {
            assert!(height_of(heading) - height_of(label) >= 14.0, "{svg}");
        }
    }
}
