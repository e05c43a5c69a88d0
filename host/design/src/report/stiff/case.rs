//! One extreme case, and its results in both number types.

use std::collections::BTreeMap;

use crate::report::method::Precision;
use crate::report::section::{Table, Value};

/// Errors this many times what is attainable are as good as attained: algorithms round more than
/// once, and a solver that takes its currents for rounded sixteen times stops where that leaves it.
const ENOUGH: f64 = 100.0;

/// A solve that takes longer is not good, however exact: twenty scans at 4 kHz.
const SLOW_S: f64 = 5e-3;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Expected {
    /// One of these words, whatever the number.
    Words(&'static [&'static str]),
    /// A number, as exact as the number type allows.
    Value,
    /// Such a number where less than this error is attainable; elsewhere a word will do that says
    /// why there is none.
    ValueBelow(f64),
    /// Such a number, or a word that says why there is none.
    Honest,
}

impl Expected {
    fn text(self) -> String {
        match self {
            Self::Words(words) => words.join(" or "),
            Self::Value => "value".to_owned(),
            Self::ValueBelow(_) | Self::Honest => "value, or why not".to_owned(),
        }
    }
}

/// The result of a case in one number type.
#[derive(Clone, Debug, Default)]
pub(super) struct Reached {
    /// How many came back without a value.
    pub(super) without_value: usize,
    /// Outcomes, and how often each came.
    pub(super) outcomes: BTreeMap<String, usize>,
    /// Error, in the unit of the case; `None` without a value.
    pub(super) error: Option<f64>,
    /// The attainable error in this number type, in the same unit.
    pub(super) attainable: Option<f64>,
    /// The slowest of the solves, seconds.
    pub(super) slowest_s: Option<f64>,
}

impl Reached {
    pub(super) fn once(outcome: &str, error: Option<f64>, attainable: Option<f64>) -> Self {
        let without_value = usize::from(error.is_none());
        let outcomes = BTreeMap::from([(outcome.to_owned(), 1)]);
        Self { outcomes, without_value, error, attainable, slowest_s: None }
    }

    fn outcome(&self) -> String {
        if let (1, Some((word, _))) = (self.outcomes.len(), self.outcomes.first_key_value()) {
            return word.clone();
        }
        let counted: Vec<String> = self.outcomes.iter().map(|(word, count)| format!("{word} {count}")).collect();
        counted.join(", ")
    }

    fn ratio(&self) -> Option<f64> {
        match (self.error?, self.attainable?) {
            (0.0, _) => Some(0.0),
            (error, attainable) => Some(error / attainable),
        }
    }

    fn is_good(&self, expected: Expected) -> bool {
        let exact = self.ratio().map(|ratio| ratio <= ENOUGH);
        // That a search has found nothing is no reason why there is nothing.
        let is_explained = !self.outcomes.keys().any(|word| word.starts_with("diverged"));
        match expected {
            Expected::Words(words) => self.outcomes.keys().all(|word| words.contains(&word.as_str())),
            Expected::ValueBelow(limit) if self.attainable.is_none_or(|attainable| attainable >= limit) => {
                self.is_good(Expected::Honest)
            }
            Expected::Value | Expected::ValueBelow(_) => exact == Some(true) && self.without_value == 0,
            Expected::Honest => exact != Some(false) && is_explained,
        }
    }
}

#[derive(Clone, Debug)]
pub(super) struct Case {
    pub(super) study: &'static str,
    /// How far it was driven.
    pub(super) case: String,
    /// Condition number of the problem, where it has one.
    pub(super) condition: Option<f64>,
    /// What the error is of, with its unit.
    pub(super) quantity: &'static str,
    pub(super) expected: Expected,
    /// In `f64` and in `f32`, if that number type takes part.
    pub(super) reached: Vec<(Precision, Reached)>,
}

impl Case {
    /// The number types in which the case falls short.
    pub(super) fn short(&self) -> Vec<&'static str> {
        let short = self.reached.iter().filter(|(_, reached)| !reached.is_good(self.expected));
        short.map(|(precision, _)| precision.name()).collect()
    }

    /// The slowest solve of all, where it is too slow, seconds.
    pub(super) fn slow_s(&self) -> Option<f64> {
        let slowest_s = self.reached.iter().filter_map(|(_, reached)| reached.slowest_s).reduce(f64::max);
        slowest_s.filter(|slowest_s| *slowest_s > SLOW_S)
    }

    /// The result in `precision`.
    pub(super) fn reached_in(&self, precision: Precision) -> Option<&Reached> {
        self.reached.iter().find(|(of, _)| *of == precision).map(|(_, reached)| reached)
    }

    fn verdict(&self) -> Value {
        match (&self.short()[..], self.slow_s()) {
            ([], None) => "good".into(),
            ([], Some(slow_s)) => Value::Alert(format!("slow: {:.0} ms", slow_s * 1e3)),
            (short, _) => Value::Alert(format!("short: {}", short.join(", "))),
        }
    }
}

pub(super) fn table(cases: &[Case]) -> Table {
    use Precision::{Double, Single};
    let outcome = |case: &Case, of| Value::from(case.reached_in(of).map(Reached::outcome).unwrap_or_default());
    let number =
        |case: &Case, of, value: fn(&Reached) -> Option<f64>| Value::optional(case.reached_in(of).and_then(value));
    let slowest_us = |reached: &Reached| Some(1e6 * reached.slowest_s?);
    let caption = format!(
        "Extreme cases: what came back, its error, what is attainable in that number type, and their ratio. Good: \
         the ratio is at most {ENOUGH}, each pose came back or a reason why it cannot, and no solve took longer \
         than {:.0} ms",
        SLOW_S * 1e3
    );
    Table::of(
        "stiff",
        caption,
        cases,
        &[
            ("study", "study", &|case| case.study.into()),
            ("case", "case", &|case| case.case.as_str().into()),
            ("condition", "condition number", &|case| Value::optional(case.condition)),
            ("quantity", "error of", &|case| case.quantity.into()),
            ("expected", "expected", &|case| case.expected.text().into()),
            ("f64_outcome", "f64", &|case| outcome(case, Double)),
            ("f64_error", "error", &|case| number(case, Double, |reached| reached.error)),
            ("f64_attainable", "attainable", &|case| number(case, Double, |reached| reached.attainable)),
            ("f64_ratio", "ratio", &|case| number(case, Double, Reached::ratio)),
            ("f64_slowest_us", "slowest / µs", &|case| number(case, Double, slowest_us)),
            ("f32_outcome", "f32", &|case| outcome(case, Single)),
            ("f32_error", "error", &|case| number(case, Single, |reached| reached.error)),
            ("f32_attainable", "attainable", &|case| number(case, Single, |reached| reached.attainable)),
            ("f32_ratio", "ratio", &|case| number(case, Single, Reached::ratio)),
            ("f32_slowest_us", "slowest / µs", &|case| number(case, Single, slowest_us)),
            ("verdict", "verdict", &Case::verdict),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(expected: Expected, reached: Reached) -> Case {
        let reached = vec![(Precision::Double, reached)];
        Case { study: "", case: String::new(), condition: None, quantity: "", expected, reached }
    }

    #[test]
    fn a_slow_solve_is_not_good() {
        let slow = |slowest_s| {
            let reached = Reached::once("converged", Some(1e-17), Some(1e-17));
            case(Expected::Value, Reached { slowest_s: Some(slowest_s), ..reached })
        };
        assert_eq!(slow(0.1).verdict(), Value::Alert("slow: 100 ms".to_owned()));
        assert_eq!(slow(1e-4).verdict(), Value::from("good"));
    }

    #[test]
    fn verdicts_follow_from_what_is_expected() {
        let value = |error| Reached::once("converged", Some(error), Some(1e-17));
        let none = || Reached::once("unobservable", None, Some(1.0));
        for (expected, reached, good) in [
            (Expected::Value, value(1e-15), true),
            (Expected::Value, value(1e-14), false),
            (Expected::Value, none(), false),
            (Expected::ValueBelow(0.1), none(), true),
            (Expected::ValueBelow(2.0), none(), false),
            (Expected::ValueBelow(0.1), value(1e-14), false),
            (Expected::Honest, none(), true),
            (Expected::Honest, value(1e-14), false),
            (Expected::Words(&["unobservable"]), none(), true),
            (Expected::Words(&["unobservable"]), value(0.0), false),
            (Expected::Value, Reached { without_value: 1, ..value(1e-15) }, false),
            (Expected::Honest, Reached { without_value: 1, ..value(1e-15) }, true),
            (Expected::Honest, Reached::once("diverged", None, Some(1.0)), false),
        ] {
            assert_eq!(case(expected, reached.clone()).short().is_empty(), good, "{expected:?} {reached:?}");
        }
    }
}
