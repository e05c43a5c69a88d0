//! A sheet to draw on: lines, areas and labels to SVG. In labels, text between `$` is set as a formula, `$X_A$` as italic X
//! with a small A below; `_` takes the next letter or a group in braces.

use glam::{DVec2, dvec2};
use quick_xml::escape::escape;

use super::style::{Colour, INK, WHITE};

const FONT: &str = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif";

/// Size and drop of a subscript, as shares of the letter size.
const SUBSCRIPT_SIZE: f64 = 0.72;
const SUBSCRIPT_DROP: f64 = 0.22;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stroke {
    pub(crate) colour: Colour,
    /// Width in pixels.
    pub(crate) width: f64,
    /// Lengths of dash and gap in pixels; `None`: solid.
    pub(crate) dash: Option<[f64; 2]>,
}

impl Stroke {
    pub(crate) const fn new(colour: Colour, width: f64) -> Self {
        Self { colour, width, dash: None }
    }

    pub(crate) const fn dashed(self, dash: f64, gap: f64) -> Self {
        Self { dash: Some([dash, gap]), ..self }
    }
}

/// Which point of a label its position means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TextStyle {
    /// Letter size in pixels.
    pub(crate) size: f64,
    pub(crate) colour: Colour,
    pub(crate) anchor: Anchor,
    pub(crate) bold: bool,
    /// Written upwards instead of to the right.
    pub(crate) upwards: bool,
}

impl TextStyle {
    pub(crate) const fn new(size: f64) -> Self {
        Self { size, colour: INK, anchor: Anchor::Start, bold: false, upwards: false }
    }

    pub(crate) const fn anchored(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }

    pub(crate) const fn coloured(self, colour: Colour) -> Self {
        Self { colour, ..self }
    }

    pub(crate) const fn bold(self) -> Self {
        Self { bold: true, ..self }
    }
}

pub(crate) struct Canvas {
    svg: String,
}

impl Canvas {
    /// An empty white sheet; `title` is for screen readers.
    pub(crate) fn new(width: f64, height: f64, title: &str) -> Self {
        let [w, h] = [width, height].map(number);
        let (font, title) = (escape(FONT), printable(title));
        let svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"{font}\"><title>{}</title>\n",
            escape(&title)
        );
        let mut canvas = Self { svg };
        canvas.area(&[dvec2(0.0, 0.0), dvec2(width, 0.0), dvec2(width, height), dvec2(0.0, height)], WHITE, 1.0);
        canvas
    }

    /// The same with the title and a note on it.
    pub(crate) fn titled(width: f64, height: f64, title: &str, note: &str) -> Self {
        let mut canvas = Self::new(width, height, title);
        canvas.text(dvec2(20.0, 30.0), title, TextStyle::new(16.0).bold());
        canvas.text(dvec2(20.0, 50.0), note, TextStyle::new(12.0));
        canvas
    }

    pub(crate) fn line(&mut self, from: DVec2, to: DVec2, stroke: Stroke) {
        self.path(&[from, to], stroke);
    }

    pub(crate) fn path(&mut self, points: &[DVec2], stroke: Stroke) {
        self.stroked("polyline", &[("points", joined(points)), ("fill", "none".to_owned())], stroke);
    }

    /// A filled area; `opacity` from 0 to 1.
    pub(crate) fn area(&mut self, corners: &[DVec2], fill: Colour, opacity: f64) {
        let attributes = [("points", joined(corners)), ("fill", fill.to_owned()), ("fill-opacity", number(opacity))];
        self.element("polygon", &attributes);
    }

    pub(crate) fn outline(&mut self, corners: &[DVec2], stroke: Stroke) {
        self.stroked("polygon", &[("points", joined(corners)), ("fill", "none".to_owned())], stroke);
    }

    pub(crate) fn disc(&mut self, centre: DVec2, radius: f64, fill: Colour, rim: Stroke) {
        let [x, y, r] = [centre.x, centre.y, radius].map(number);
        self.stroked("circle", &[("cx", x), ("cy", y), ("r", r), ("fill", fill.to_owned())], rim);
    }

    /// A line with an arrow head at `to`; without the head where the line is shorter than that.
    pub(crate) fn arrow(&mut self, from: DVec2, to: DVec2, stroke: Stroke) {
        let direction = (to - from).normalize_or_zero();
        let (length, half_width) = (3.2 * stroke.width + 3.0, 1.2 * stroke.width + 1.2);
        if from.distance(to) < length {
            return self.line(from, to, stroke);
        }
        let base = to - direction * length;
        self.line(from, base, stroke);
        let side = direction.perp() * half_width;
        self.area(&[to, base + side, base - side], stroke.colour, 1.0);
    }

    /// A line with arrow heads at both ends: a dimension.
    pub(crate) fn dimension(&mut self, from: DVec2, to: DVec2, stroke: Stroke) {
        let middle = 0.5 * (from + to);
        self.arrow(middle, from, stroke);
        self.arrow(middle, to, stroke);
    }

    /// A label whose base line starts, is centred or ends at a point. Formulas stand between `$`.
    pub(crate) fn text(&mut self, at: DVec2, label: &str, style: TextStyle) {
        let (x, y, size) = (number(at.x), number(at.y), number(style.size));
        let turned = if style.upwards { " rotate(-90)" } else { "" };
        let weight = if style.bold { " font-weight=\"bold\"" } else { "" };
        let anchor = match style.anchor {
            Anchor::Start => "",
            Anchor::Middle => " text-anchor=\"middle\"",
            Anchor::End => " text-anchor=\"end\"",
        };
        // Else viewers drop the blanks between runs.
        let space = "xml:space=\"preserve\"";
        let colour = style.colour;
        self.svg += &format!(
            "<text transform=\"translate({x} {y}){turned}\" font-size=\"{size}\" fill=\"{colour}\" {space}{weight}{anchor}>"
        );
        let label = printable(label);
        let drop = SUBSCRIPT_DROP * style.size;
        let lowered = format!(" font-size=\"{}\" dy=\"{}\"", number(SUBSCRIPT_SIZE * style.size), number(drop));
        let mut is_low = false;
        for (index, part) in label.split('$').enumerate() {
            let slant = if index % 2 == 0 { "" } else { " font-style=\"italic\"" };
            // Control characters are not printed: there is none.
            let mut parts = part.split(if slant.is_empty() { '\0' } else { '_' });
            let first = parts.next().map(|first| ("", first));
            for (subscript, rest) in first.into_iter().chain(parts.map(subscript_of)) {
                if !subscript.is_empty() {
                    self.span(subscript, &lowered);
                    is_low = true;
                }
                if !rest.is_empty() {
                    let raised = if is_low { format!(" dy=\"{}\"", number(-drop)) } else { String::new() };
                    self.span(rest, &(slant.to_owned() + &raised));
                    is_low = false;
                }
            }
        }
        self.svg += "</text>\n";
    }

    fn span(&mut self, text: &str, attributes: &str) {
        self.svg += &format!("<tspan{attributes}>{}</tspan>", escape(text));
    }

    pub(crate) fn into_svg(self) -> String {
        self.svg + "</svg>\n"
    }

    fn stroked(&mut self, name: &str, attributes: &[(&'static str, String)], stroke: Stroke) {
        let mut attributes = attributes.to_vec();
        attributes.push(("stroke", stroke.colour.to_owned()));
        attributes.push(("stroke-width", number(stroke.width)));
        attributes.push(("stroke-linejoin", "round".to_owned()));
        if let Some([dash, gap]) = stroke.dash {
            attributes.push(("stroke-dasharray", format!("{} {}", number(dash), number(gap))));
        }
        self.element(name, &attributes);
    }

    /// None of these attributes has a character that XML would have to escape.
    fn element(&mut self, name: &str, attributes: &[(&str, String)]) {
        let attributes: String = attributes.iter().map(|(key, value)| format!(" {key}=\"{value}\"")).collect();
        self.svg += &format!("<{name}{attributes}/>\n");
    }
}

/// Without the characters that XML 1.0 has no way to write.
fn printable(text: &str) -> String {
    text.chars().filter(|letter| !letter.is_control() && !matches!(letter, '\u{fffe}' | '\u{ffff}')).collect()
}

fn joined(points: &[DVec2]) -> String {
    let points: Vec<_> = points.iter().map(|point| format!("{},{}", number(point.x), number(point.y))).collect();
    points.join(" ")
}

/// To a hundredth of a pixel; more digits only make the file larger.
fn number(value: f64) -> String {
    format!("{}", (value * 100.0).round() / 100.0 + 0.0)
}

/// The letter or the group in braces that follows `_`, and the rest.
fn subscript_of(text: &str) -> (&str, &str) {
    match text.strip_prefix('{').and_then(|group| group.split_once('}')) {
        Some(group) => group,
        None => text.split_at(text.chars().next().map_or(0, char::len_utf8)),
    }
}
