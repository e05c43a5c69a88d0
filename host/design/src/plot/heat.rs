//! Values over planes, as bands of colour.

use glam::{DVec2, dvec2};

use super::canvas::{ALERT, BANDS, Canvas, Colour, INK, SOFT_INK, Stroke, TextStyle, WHITE, three_digits};
use super::chart::{Axis, Chart, Scale};

const LEFT: f64 = 80.0;
const TOP: f64 = 96.0;
const SIZE: f64 = 210.0;
const GAP: DVec2 = DVec2::new(74.0, 78.0);
const LEGEND: f64 = 56.0;

#[derive(Clone, Debug)]
pub(crate) struct Heat {
    /// What is shown; formulas between `$`.
    pub heading: String,
    /// Names of the coordinates, with units.
    pub labels: [String; 2],
    /// Half extents of the coordinates.
    pub extents: [f64; 2],
    /// Points along each side.
    pub side: usize,
    /// Row by row from below; infinite: there is none.
    pub values: Vec<f64>,
}

/// Share of the values that the bands divide; what is beyond shares the last.
const SHOWN: f64 = 0.98;

/// Ratio of greatest to least value from which bands have equal ratios instead of equal widths.
const WIDE: f64 = 3.0;

/// Edges of the bands: least, and between; what is above the last is in the last. `None`: there are no values.
fn edges(heats: &[Heat]) -> Option<[f64; BANDS.len()]> {
    let mut values: Vec<f64> =
        heats.iter().flat_map(|heat| heat.values.iter().copied()).filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let (least, most) = (*values.first()?, values[((values.len() - 1) as f64 * SHOWN) as usize]);
    let share = |k: usize| k as f64 / BANDS.len() as f64;
    Some(std::array::from_fn(|k| {
        if least > 0.0 && most > WIDE * least {
            least * (most / least).powf(share(k))
        } else {
            least + (most - least) * share(k)
        }
    }))
}

fn band(edges: &[f64; BANDS.len()], value: f64) -> usize {
    edges[1..].iter().take_while(|edge| value >= **edge).count()
}

/// All `heats` with one scale, `columns` beside each other.
pub(crate) fn heat_picture(title: &str, note: &str, unit: &str, columns: usize, heats: &[Heat]) -> String {
    let rows = heats.len().div_ceil(columns);
    let pitch = DVec2::splat(SIZE) + GAP;
    let width = LEFT + columns as f64 * pitch.x - GAP.x + 30.0;
    let bottom = TOP + rows as f64 * pitch.y;
    let mut canvas = Canvas::titled(width, bottom + LEGEND, title, note);
    let edges = edges(heats);
    for (index, heat) in heats.iter().enumerate() {
        let corner = dvec2(LEFT, TOP) + pitch * dvec2((index % columns) as f64, (index / columns) as f64);
        draw(&mut canvas, corner, heat, edges.as_ref());
    }
    let Some(edges) = edges else { return canvas.into_svg() };
    let step = (width - LEFT - 30.0) / (BANDS.len() + 1) as f64;
    let swatch = |canvas: &mut Canvas, index: usize, colour: Colour, label: &str| {
        let at = dvec2(LEFT + index as f64 * step, bottom - 4.0);
        let corners = [at, at + dvec2(26.0, 0.0), at + dvec2(26.0, 14.0), at + dvec2(0.0, 14.0)];
        canvas.area(&corners, colour, 1.0);
        canvas.outline(&corners, Stroke::new(SOFT_INK, 0.8));
        canvas.text(at + dvec2(0.0, 30.0), label, TextStyle::new(12.0));
        corners
    };
    for (index, (colour, edge)) in BANDS.into_iter().zip(edges).enumerate() {
        swatch(&mut canvas, index, colour, &format!("from {}", three_digits(edge)));
    }
    let [corner, .., below] = swatch(&mut canvas, BANDS.len(), WHITE, "no pose");
    canvas.line(below, corner + dvec2(26.0, 0.0), Stroke::new(ALERT, 1.4));
    canvas.text(dvec2(LEFT, bottom + 46.0), unit, TextStyle::new(12.0).coloured(SOFT_INK));
    canvas.into_svg()
}

fn draw(canvas: &mut Canvas, corner: DVec2, heat: &Heat, edges: Option<&[f64; BANDS.len()]>) {
    let axis = |k: usize| {
        let extent = heat.extents[k].max(f64::MIN_POSITIVE);
        Axis { label: heat.labels[k].clone(), range: [-extent, extent], scale: Scale::Linear }
    };
    let axes = Chart { x: axis(0), y: axis(1), curves: Vec::new(), notes: Vec::new() };
    axes.draw(canvas, corner, corner + SIZE, 0.0);
    let pixel = SIZE / heat.side as f64;
    let band = |value: f64| edges.filter(|_| value.is_finite()).map(|edges| band(edges, value));
    for (row, values) in heat.values.chunks(heat.side).enumerate() {
        let top = corner.y + SIZE - (row + 1) as f64 * pixel;
        let mut from = 0;
        // Neighbours of one band are one area; areas overlap by a pixel, so that nothing shines through between them.
        for run in values.chunk_by(|a, b| band(*a) == band(*b)) {
            let (left, right) = (corner.x + from as f64 * pixel, corner.x + (from + run.len()) as f64 * pixel);
            let right = (right + 1.0).min(corner.x + SIZE);
            let lower = (top + pixel + 1.0).min(corner.y + SIZE);
            let corners = [dvec2(left, top), dvec2(right, top), dvec2(right, lower), dvec2(left, lower)];
            match run.first().and_then(|value| band(*value)) {
                Some(number) => canvas.area(&corners, BANDS[number], 1.0),
                None => canvas.line(dvec2(left, top + pixel), dvec2(right, top), Stroke::new(ALERT, 0.9)),
            }
            from += run.len();
        }
    }
    canvas.outline(&[corner, corner + DVec2::X * SIZE, corner + SIZE, corner + DVec2::Y * SIZE], Stroke::new(INK, 1.0));
    canvas.text(corner + dvec2(0.0, -9.0), &heat.heading, TextStyle::new(13.0).bold());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heat(values: &[f64]) -> Heat {
        let labels = ["x / mm", "y / mm"].map(str::to_owned);
        Heat { heading: "h".to_owned(), labels, extents: [4.0, 4.0], side: 3, values: values.to_vec() }
    }

    #[test]
    fn bands_part_the_values_and_what_has_none_is_crossed_out() {
        let heats = [heat(&[1.0, 1.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, f64::INFINITY])];
        // A ratio of 16 (the greatest value is beyond the share shown) in eight bands: √2 each.
        let edges = edges(&heats).unwrap();
        assert_eq!([1.0, 1.9, 2.1, 8.1, 32.0].map(|value| band(&edges, value)), [0, 1, 2, 6, 7]);
        let svg = heat_picture("t", "n", "µm", 1, &heats);
        // One in the map, one in the legend.
        assert_eq!(svg.matches(ALERT).count(), 2, "{svg}");
        // Three equal neighbours are one area: besides the sheet and eight swatches and their white neighbour, six.
        assert_eq!(svg.matches(BANDS[0]).count(), 2, "{svg}");
    }

    #[test]
    fn nothing_to_show_is_a_picture_all_the_same() {
        assert!(heat_picture("t", "n", "µm", 1, &[heat(&[f64::INFINITY; 9])]).contains("</svg>"));
    }
}
