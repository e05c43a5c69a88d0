//! Curves over time, as a picture.

use std::fmt::Write;

/// A panel: what it shows, and its curves by name, each of (time in seconds, value).
#[derive(Clone, Debug)]
pub struct Panel {
    /// Heading, with the unit.
    pub heading: String,
    /// Whether the axis is logarithmic.
    pub is_logarithmic: bool,
    /// Names and points.
    pub curves: Vec<(String, Vec<(f64, f64)>)>,
}

/// Size of a panel, and of its margins, pixels.
const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 170.0;
const LEFT: f64 = 70.0;
const TOP: f64 = 26.0;

/// Of curves that are told apart without colour vision, too (Okabe and Ito 2008).
const COLOURS: [&str; 4] = ["#0072b2", "#d55e00", "#009e73", "#000000"];

/// The panels below each other as SVG, with a vertical line and a word at each of `marks`.
pub fn svg(panels: &[Panel], marks: &[(f64, String)]) -> String {
    let points = || panels.iter().flat_map(|panel| &panel.curves).flat_map(|(_, points)| points);
    let end_s = points().map(|(at_s, _)| *at_s).fold(1.0, f64::max);
    let x = |at_s: f64| LEFT + at_s / end_s * (WIDTH - LEFT - 20.0);
    let full = panels.len() as f64 * (HEIGHT + TOP) + 30.0;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{full}\" font-family=\"sans-serif\" font-size=\"11\">\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (number, Panel { heading, is_logarithmic, curves }) in panels.iter().enumerate() {
        let base = (number + 1) as f64 * (HEIGHT + TOP);
        let scale = |value: f64| if *is_logarithmic { value.max(1e-3).log10() } else { value };
        let values =
            || curves.iter().flat_map(|(_, points)| points).map(|(_, value)| scale(*value)).filter(|it| it.is_finite());
        let least = values().fold(if *is_logarithmic { f64::INFINITY } else { 0.0 }, f64::min);
        let most = values().fold(f64::NEG_INFINITY, f64::max).max(least + 1e-9);
        let y = |value: f64| base - (scale(value) - least) / (most - least) * (HEIGHT - 20.0);
        // A string takes everything.
        let _ = writeln!(out, "<text x=\"{LEFT}\" y=\"{}\" font-weight=\"bold\">{heading}</text>", base - HEIGHT + 8.0);
        for (at_s, _) in marks {
            let at = x(*at_s);
            let _ = writeln!(out, "<path d=\"M{at:.1} {base:.1}V{:.1}\" stroke=\"#ddd\"/>", base - HEIGHT + 14.0);
        }
        for value in [least, 0.5 * (least + most), most] {
            let value = if *is_logarithmic { 10_f64.powf(value) } else { value };
            let at = y(value);
            let _ = writeln!(
                out,
                "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{value:.3}</text><path d=\"M{LEFT} {at:.1}H{}\" stroke=\"#eee\"/>",
                LEFT - 6.0,
                at + 4.0,
                WIDTH - 20.0
            );
        }
        for (curve, (name, points)) in curves.iter().enumerate() {
            let colour = COLOURS[curve % COLOURS.len()];
            let mut path = String::new();
            let mut is_down = false;
            for (at_s, value) in points {
                if value.is_finite() {
                    let _ = write!(path, "{}{:.1} {:.1}", if is_down { 'L' } else { 'M' }, x(*at_s), y(*value));
                }
                is_down = value.is_finite();
            }
            let _ = writeln!(out, "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\"/>");
            let (at, above) = (WIDTH - 20.0 - 90.0 * (curves.len() - curve - 1) as f64, base - HEIGHT + 8.0);
            let _ = writeln!(out, "<text x=\"{at}\" y=\"{above}\" text-anchor=\"end\" fill=\"{colour}\">{name}</text>");
        }
    }
    for (at_s, word) in marks {
        let _ = writeln!(out, "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{word}</text>", x(*at_s), full - 10.0);
    }
    let _ = writeln!(out, "<text x=\"8\" y=\"{}\">0 to {end_s:.0} s</text></svg>", full - 10.0);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_breaks_where_nothing_was_measured() {
        let points = vec![(0.0, 1.0), (1.0, 2.0), (2.0, f64::NAN), (3.0, 1.0)];
        let panel = Panel { heading: "h".to_owned(), is_logarithmic: false, curves: vec![("c".to_owned(), points)] };
        let text = svg(&[panel], &[(1.5, "K".to_owned())]);
        let path = text.lines().find(|line| line.contains("fill=\"none\"")).expect("a curve");
        assert_eq!((path.matches('M').count(), path.matches('L').count()), (2, 1), "{path}");
        assert!(text.contains(">K</text>") && !text.contains("NaN"), "{text}");
    }
}
