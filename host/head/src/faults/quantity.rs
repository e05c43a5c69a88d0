//! Numbers with units, as they stand in the text of a fault.

/// What kind of number a key takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// The number of a cell or of an emitter, from 0.
    Number,
    /// A count, at least 1.
    Count,
    /// A probability, above 0 and at most 1.
    Rate,
    /// A ratio, 0 to 10.
    Ratio,
    /// A duration, at least 0.
    Time,
    /// A difference of times, of either sign.
    TimeStep,
    /// Parts per million, of either sign.
    Ppm,
    /// A current, at least 0.
    Current,
    /// A length, of either sign.
    Length,
    /// A difference of temperatures, of either sign.
    Kelvin,
}

/// Longest time that the text of a fault may give: a day.
const MOST_S: f64 = 86_400.0;

impl Unit {
    /// Endings of a text, with the factor to SI; the longest first.
    fn endings(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::Time | Self::TimeStep => &[("min", 60.0), ("ms", 1e-3), ("us", 1e-6), ("s", 1.0)],
            Self::Ppm => &[("ppm", 1.0)],
            Self::Current => &[("nA", 1e-9), ("uA", 1e-6), ("mA", 1e-3)],
            Self::Length => &[("nm", 1e-9), ("um", 1e-6), ("mm", 1e-3)],
            Self::Kelvin => &[("K", 1.0)],
            Self::Number | Self::Count | Self::Rate | Self::Ratio => &[("", 1.0)],
        }
    }

    fn is_fit(self, value: f64) -> bool {
        match self {
            Self::Number => value.fract() == 0.0 && (0.0..256.0).contains(&value),
            Self::Count => value.fract() == 0.0 && (1.0..=1e6).contains(&value),
            Self::Rate => value > 0.0 && value <= 1.0,
            Self::Ratio => (0.0..=10.0).contains(&value),
            Self::Time => (0.0..=MOST_S).contains(&value),
            Self::TimeStep => value.abs() <= MOST_S,
            Self::Ppm => value.abs() <= 1e5,
            Self::Current => (0.0..=1e-3).contains(&value),
            Self::Length => value.abs() <= 0.1,
            Self::Kelvin => value.abs() <= 200.0,
        }
    }

    /// What such a value looks like, for messages.
    pub fn example(self) -> &'static str {
        match self {
            Self::Number => "a number from 0, such as 2",
            Self::Count => "a whole number from 1, such as 8",
            Self::Rate => "a probability above 0 and up to 1, such as 1e-5",
            Self::Ratio => "a ratio from 0 to 10, such as 0.5",
            Self::Time => "a time from 0 to 1440min, such as 0.5s, 20ms or 250us",
            Self::TimeStep => "a time of either sign, such as 10ms or -2s",
            Self::Ppm => "parts per million up to 1e5, such as 50ppm",
            Self::Current => "a current up to 1mA, such as 200nA or 1.5uA",
            Self::Length => "a length up to 100mm, such as 50um or -0.1mm",
            Self::Kelvin => "a difference up to 200K, such as 20K",
        }
    }

    /// The value of `text` in SI units; `None` if it is none, or out of range.
    pub fn parse(self, text: &str) -> Option<f64> {
        let (number, factor) =
            self.endings().iter().find_map(|&(ending, factor)| Some((text.strip_suffix(ending)?, factor)))?;
        // Neither `inf` nor `nan` begins or ends with a digit.
        let is_plain = number.ends_with(|last: char| last.is_ascii_digit() || last == '.');
        let value = number.parse::<f64>().ok().filter(|_| is_plain)? * factor;
        self.is_fit(value).then_some(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_are_read_with_their_units_and_refused_without() {
        for (unit, text, value) in [
            (Unit::Time, "500ms", 0.5),
            (Unit::Time, "0.5s", 0.5),
            (Unit::Time, "2min", 120.0),
            (Unit::Time, "250us", 250e-6),
            (Unit::TimeStep, "-10ms", -0.01),
            (Unit::Rate, "1e-5", 1e-5),
            (Unit::Ppm, "-50ppm", -50.0),
            (Unit::Current, "200nA", 200e-9),
            (Unit::Length, "-0.1mm", -1e-4),
            (Unit::Kelvin, "20K", 20.0),
            (Unit::Number, "0", 0.0),
        ] {
            let parsed = unit.parse(text).unwrap_or_else(|| panic!("{text} is refused"));
            assert!((parsed - value).abs() <= 1e-12 * value.abs(), "{text}: {parsed}");
            // The example of each unit is one.
            let example = unit.example().split("such as ").nth(1).and_then(|some| some.split([',', ' ']).next());
            assert!(example.is_some_and(|example| unit.parse(example).is_some()), "{unit:?}");
        }
        for (unit, text) in [
            (Unit::Time, "500"),
            (Unit::Time, "-1s"),
            (Unit::Time, "infs"),
            (Unit::Time, "s"),
            (Unit::Rate, "0"),
            (Unit::Rate, "1.5"),
            (Unit::Rate, "nan"),
            (Unit::Number, "1.5"),
            (Unit::Number, "-1"),
            (Unit::Count, "0"),
            (Unit::Current, "2A"),
            (Unit::Length, "1e300mm"),
        ] {
            assert_eq!(unit.parse(text), None, "{text} as {unit:?}");
        }
    }
}
