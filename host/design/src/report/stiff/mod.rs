//! Stiff and extreme cases, which are numerically difficult, and their results.
//!
//! `cell` drives one cell's optics to extremes and compares with an integration of its own; `pose` drives solves there and
//! compares with what is attainable. A [`Case`] is judged by the ratio of its error to that.

mod cell;
mod pose;

use std::collections::BTreeMap;

use slitpose_model::Tier;

use super::head::Head;
use super::section::{Section, Table, Value};
use super::{ReportError, Settings};

pub(super) const TITLE: &str = "Stiff and extreme cases";

/// Errors this many times what is attainable are as good as attained: algorithms round more than
/// once, and a solver that takes its currents for rounded sixteen times stops where that leaves it.
const ENOUGH: f64 = 100.0;

/// A solve that takes longer is not good, however exact: twenty scans at 4 kHz.
const SLOW_S: f64 = 5e-3;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Expected {
    /// One of these words, whatever the number.
    Words(&'static [&'static str]),
    /// A number, as exact as rounding allows.
    Value,
    /// Such a number where less than this error is attainable; elsewhere a word will do that says
    /// why there is none.
    ValueBelow(f64),
    /// Such a number, or a word that says why there is none.
    Honest,
}

/// The result of a case.
#[derive(Clone, Debug, Default)]
struct Reached {
    /// How many came back without a value.
    without_value: usize,
    outcomes: BTreeMap<String, usize>,
    /// Error, in the unit of the case; `None` without a value.
    error: Option<f64>,
    /// The attainable error, in the same unit.
    attainable: Option<f64>,
    /// The slowest of the solves, seconds.
    slowest_s: Option<f64>,
}

impl Reached {
    fn once(outcome: &str, error: Option<f64>, attainable: Option<f64>) -> Self {
        let outcomes = BTreeMap::from([(outcome.to_owned(), 1)]);
        Self { outcomes, without_value: usize::from(error.is_none()), error, attainable, slowest_s: None }
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
struct Case {
    study: &'static str,
    case: String,
    /// Condition number of the problem, where it has one.
    condition: Option<f64>,
    /// What the error is of, with its unit.
    quantity: &'static str,
    expected: Expected,
    reached: Reached,
}

/// The exact tier at the tightest tolerance that is of use: a solver weighs by it, and stops when it has come so near.
const TIGHTEST: Tier = Tier::Exact { tolerance: 1e-15 };

const UNIT_ROUNDOFF: f64 = 0.5 * f64::EPSILON;

impl Case {
    fn is_good(&self) -> bool {
        self.reached.is_good(self.expected)
    }

    /// The slowest solve of all, where it is too slow, seconds.
    fn slow_s(&self) -> Option<f64> {
        self.reached.slowest_s.filter(|it| *it > SLOW_S)
    }

    fn verdict(&self) -> Value {
        match (self.is_good(), self.slow_s()) {
            (true, None) => "good".into(),
            (true, Some(slow_s)) => Value::Alert(format!("slow: {:.0} ms", slow_s * 1e3)),
            (false, _) => Value::Alert("short".to_owned()),
        }
    }
}

pub(super) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, ReportError> {
    let mut cases = cell::cases(&head.scene)?;
    cases.extend(pose::cases(head, settings)?);
    let summary = summary(&cases);
    let of_slits = if head.is_of_slits() {
        ""
    } else {
        " Those of one cell are of a slit on the base with the dimensions of the first cell."
    };
    Ok(Section {
        name: "stiff",
        title: TITLE,
        summary: vec![format!("Extreme cases: {}{}", summary[..1].to_lowercase(), &summary[1..])],
        paragraphs: vec![
            format!(
                "Each case is driven towards the point where it must fail. The condition number of a case says by how \
                 much it magnifies a relative error of what goes in; what is attainable is what remains when every \
                 number that goes in is rounded once: the condition number times that rounding. Currents of one cell are compared with an integration that shares nothing with the \
                 model; poses, {} near home in each case, with the truth.{of_slits}",
                pose::POSES
            ),
            summary,
        ],
        tables: vec![table(&cases)],
        ..Section::default()
    })
}

/// How many cases fall short, by study.
fn summary(cases: &[Case]) -> String {
    let mut short: BTreeMap<&str, usize> = BTreeMap::new();
    for case in cases.iter().filter(|case| !case.is_good()) {
        *short.entry(case.study).or_default() += 1;
    }
    let slow: Vec<f64> = cases.iter().filter_map(Case::slow_s).collect();
    let slow = match slow.iter().copied().reduce(f64::max) {
        Some(slow_s) => {
            let cases = if slow.len() == 1 { "case is" } else { "cases are" };
            format!(" {} {cases} slow: up to {} ms a solve.", slow.len(), Value::from(slow_s * 1e3).shown())
        }
        None => String::new(),
    };
    if short.is_empty() {
        return format!("All {} cases came out as they must.{slow}", cases.len());
    }
    let of = |study: &str| cases.iter().filter(|case| case.study == study).count();
    let names: Vec<String> =
        short.into_iter().map(|(study, count)| format!("{study} ({count} of {})", of(study))).collect();
    format!("Of {} cases these fall short, and are marked in the table: {}.{slow}", cases.len(), names.join(", "))
}

fn table(cases: &[Case]) -> Table {
    let expected = |case: &Case| match case.expected {
        Expected::Words(words) => words.join(" or "),
        Expected::Value => "value".to_owned(),
        Expected::ValueBelow(_) | Expected::Honest => "value, or why not".to_owned(),
    };
    let caption = format!(
        "Extreme cases: what came back, its error, what is attainable, and their ratio. Good: \
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
            ("expected", "expected", &|case| expected(case).into()),
            ("outcome", "outcome", &|case| case.reached.outcome().into()),
            ("error", "error", &|case| Value::optional(case.reached.error)),
            ("attainable", "attainable", &|case| Value::optional(case.reached.attainable)),
            ("ratio", "ratio", &|case| Value::optional(case.reached.ratio())),
            ("slowest_us", "slowest / µs", &|case| Value::optional(case.reached.slowest_s.map(|s| 1e6 * s))),
            ("verdict", "verdict", &Case::verdict),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_follow_from_what_is_expected_and_from_the_time() {
        let case = |expected, reached| Case {
            study: "",
            case: String::new(),
            condition: None,
            quantity: "",
            expected,
            reached,
        };
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
            assert_eq!(case(expected, reached.clone()).is_good(), good, "{expected:?} {reached:?}");
        }
        let slow = |slowest_s| case(Expected::Value, Reached { slowest_s: Some(slowest_s), ..value(1e-17) }).verdict();
        assert_eq!(slow(0.1), Value::Alert("slow: 100 ms".to_owned()));
        assert_eq!(slow(1e-4), Value::from("good"));
    }
}
