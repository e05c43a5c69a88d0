//! What all pictures have in common: colours, round numbers, sizes of sheets.

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
pub(super) fn ticks([from, to]: [f64; 2], count: usize) -> (Vec<f64>, usize) {
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
pub(super) fn round_step(wanted: f64) -> f64 {
    let power = 10f64.powf(wanted.log10().floor());
    let factor = [1.0, 2.0, 2.5, 5.0].into_iter().find(|factor| factor * power >= wanted * (1.0 - 1e-9));
    factor.unwrap_or(10.0) * power
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Decades {
    /// Positions with a number, ascending.
    pub(super) numbered: Vec<f64>,
    /// Positions of a grid line only.
    pub(super) minor: Vec<f64>,
    /// Whether all numbers are short enough to be written without powers of ten.
    pub(super) plain: bool,
}

/// Widest span of decades whose grid has lines within each: more would be a grey area.
const FINE_DECADES: f64 = 8.0;

/// Ticks at powers of ten inside a range of positive numbers, every so many of them that about
/// `count` are numbered; at 2 and 5 times powers of ten, too, where those alone would be too few.
pub(super) fn decades([from, to]: [f64; 2], count: usize) -> Decades {
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
pub(super) fn quantity(value: f64) -> String {
    let plain = (1e-3..1e6).contains(&value.abs()) || value.abs() < 1e-9;
    let text = if plain { format!("{}", (value * 1e3).round() / 1e3 + 0.0) } else { format!("{value:.2e}") };
    text.replace('-', "−")
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
