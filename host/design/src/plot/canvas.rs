//! A sheet to draw on: lines, areas and labels to SVG, in colours and with numbers that all pictures share. In labels, text between `$` is set as a formula, `$X_A$` as italic X
//! with a small A below; `_` takes the next letter or a group in braces.

use glam::{DVec2, dvec2};
use quick_xml::escape::escape;

/// A colour as SVG writes it.
pub(crate) type Colour = &'static str;

pub(crate) const INK: Colour = "#222222";
/// Secondary text, dimension lines.
pub(crate) const SOFT_INK: Colour = "#666666";
/// Grid lines, outlines of secondary objects.
pub(crate) const PALE: Colour = "#d4d4d4";
pub(crate) const FAINT: Colour = "#ededed";
pub(crate) const TOOL: Colour = "#9a9a9a";
pub(crate) const MASK: Colour = "#3c3c3c";
pub(crate) const ALERT: Colour = "#c1121f";
pub(crate) const WHITE: Colour = "#ffffff";

/// Colours of cells, in order; distinguishable with the common forms of colour blindness
/// (Okabe and Ito 2008, the yellow left out for want of contrast on white).
const CELLS: [Colour; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#5a5a5a"];

/// The colour of a cell in every picture.
pub(crate) fn cell_colour(cell: usize) -> Colour {
    CELLS[cell % CELLS.len()]
}

/// Bands of a value, ascending: lightness grows steadily, for all eyes and in print (cividis; Nuñez, Anderton, Renslow
/// 2018).
pub(crate) const BANDS: [Colour; 8] =
    ["#00224e", "#213b6e", "#4c556c", "#6c6e72", "#8e8978", "#b1a570", "#d9c55c", "#fee838"];

/// Positions of about `count` ticks inside a range, at multiples of 1, 2, 2.5 or 5 times a power
/// of ten, and how many decimals they need.
pub(crate) fn ticks([from, to]: [f64; 2], count: usize) -> (Vec<f64>, usize) {
    let step = round_step((to - from) / count as f64);
    let slack = 1e-9 * step;
    let (first, last) = (((from - slack) / step).ceil() as i64, ((to + slack) / step).floor() as i64);
    let decimals = (0..12).find(|decimals| {
        let scaled = step * 10f64.powi(*decimals);
        (scaled - scaled.round()).abs() < 1e-6 * scaled
    });
    ((first..=last).map(|index| index as f64 * step).collect(), decimals.unwrap_or(0) as usize)
}

/// The round number nearest to `wanted` that is not below it.
pub(crate) fn round_step(wanted: f64) -> f64 {
    let power = 10f64.powf(wanted.log10().floor());
    let factor = [1.0, 2.0, 2.5, 5.0].into_iter().find(|factor| factor * power >= wanted * (1.0 - 1e-9));
    factor.unwrap_or(10.0) * power
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Decades {
    /// Positions with a number, ascending.
    pub(crate) numbered: Vec<f64>,
    /// Positions of a grid line only.
    pub(crate) minor: Vec<f64>,
    /// Whether all numbers are short enough to be written without powers of ten.
    pub(crate) plain: bool,
}

/// Widest span of decades whose grid has lines within each: more would be a grey area.
const FINE_DECADES: f64 = 8.0;

/// Ticks at powers of ten inside a range of positive numbers, every so many of them that about
/// `count` are numbered; at 2 and 5 times powers of ten, too, where those alone would be too few.
pub(crate) fn decades([from, to]: [f64; 2], count: usize) -> Decades {
    let (low, high) = (from.log10(), to.log10());
    let inside = |value: &f64| (from * (1.0 - 1e-9)..=to * (1.0 + 1e-9)).contains(value);
    let step = ((high - low) / count.max(1) as f64).ceil().max(1.0) as i32;
    let exponents = low.floor() as i32..=high.ceil() as i32;
    let multiples = |factors: &'static [f64]| {
        exponents.clone().flat_map(move |exponent| factors.iter().map(move |factor| factor * 10f64.powi(exponent)))
    };
    let powers: Vec<f64> = exponents
        .clone()
        .filter(|exponent| exponent.rem_euclid(step) == 0)
        .map(|e| 10f64.powi(e))
        .filter(inside)
        .collect();
    let few = high - low < 2.0 && 3 * powers.len() <= count;
    let numbered: Vec<f64> = if few { multiples(&[1.0, 2.0, 5.0]).filter(inside).collect() } else { powers };
    let all: &[f64] = if high - low <= FINE_DECADES { &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0] } else { &[1.0] };
    let minor = multiples(all).filter(|tick| inside(tick) && !numbered.contains(tick)).collect();
    Decades { numbered, minor, plain: low >= -3.0 && high <= 4.5 }
}

/// Three significant digits, powers of ten where zeros would have to be counted, a true minus sign.
pub(crate) fn three_digits(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    // Rounded first: 999.7 is a number of four digits.
    let rounded: f64 = format!("{value:.2e}").parse().unwrap_or(value);
    let exponent = rounded.abs().log10().floor();
    let text = if (-3.0..5.0).contains(&exponent) {
        format!("{rounded:.*}", (2.0 - exponent).max(0.0) as usize)
    } else {
        format!("{rounded:.1e}")
    };
    text.replace('-', "−")
}

/// A number for a label: three decimals at most and none that say nothing, powers of ten where
/// those would not do, a true minus sign.
pub(crate) fn quantity(value: f64) -> String {
    let plain = (1e-3..1e6).contains(&value.abs()) || value.abs() < 1e-9;
    let text = if plain { format!("{}", (value * 1e3).round() / 1e3 + 0.0) } else { format!("{value:.2e}") };
    text.replace('-', "−")
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let (positions, decimals) = ticks([-6.0, 6.0], 6);
        assert_eq!((positions, decimals), (vec![-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0], 0));
        let (positions, decimals) = ticks([0.02, 0.98], 4);
        assert_eq!((positions, decimals), (vec![0.25, 0.5, 0.75], 2));
    }

    #[test]
    fn steps_are_never_finer_than_wanted() {
        for wanted in [1e-9, 0.3, 1.0, 1.01, 2.4, 4.9, 7.0, 1e6] {
            let step = round_step(wanted);
            assert!(step >= wanted * 0.999_999 && step <= wanted * 10.0 / 4.9, "{wanted}: {step}");
        }
    }

    #[test]
    fn decades_are_numbered_and_divided() {
        let ticks = decades([0.05, 200.0], 5);
        assert_eq!(ticks.numbered, [0.1, 1.0, 10.0, 100.0]);
        assert!(ticks.plain && ticks.minor.contains(&0.2) && ticks.minor.contains(&90.0), "{ticks:?}");
        assert!(ticks.minor.iter().all(|tick| (0.05..=200.0).contains(tick) && !ticks.numbered.contains(tick)));
    }

    #[test]
    fn many_decades_skip_numbers_and_few_add_some() {
        let many = decades([1e-16, 1.0], 6);
        assert_eq!(many.numbered.len(), 6, "{many:?}");
        assert!(!many.plain && many.minor.len() == 11, "{many:?}");
        let few = decades([0.9, 9.0], 8);
        assert_eq!(few.numbered, [1.0, 2.0, 5.0]);
        assert_eq!(few.minor, [0.9, 3.0, 4.0, 6.0, 7.0, 8.0, 9.0]);
    }

    #[test]
    fn numbers_are_short() {
        let cases = [(1.0, "1"), (-2.345_678, "−2.346"), (-1e-17, "0"), (4.2e-5, "4.20e−5"), (1e300, "1.00e300")];
        for (value, text) in cases {
            assert_eq!(quantity(value), text);
        }
    }
}
