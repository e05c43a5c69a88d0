//! Round numbers for axes.

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
}
