//! Sets of values that have names on the command line.

use std::marker::PhantomData;
use std::str::FromStr;

use clap::ValueEnum;
use thiserror::Error;

/// Values that are given by name; the name and a phrase about it come from the variant and its documentation.
pub trait Named: ValueEnum + Copy {
    /// What one of them is called.
    const KIND: &'static str;
    /// Whether `all` stands for all of them.
    const HAS_ALL: bool;

    /// Its place in the list, below 32.
    fn index(self) -> u32;

    /// The name on the command line.
    fn name(self) -> String {
        self.to_possible_value().expect("none is hidden").get_name().to_owned()
    }

    /// What it stands for, in a phrase.
    fn what(self) -> String {
        self.to_possible_value().and_then(|value| value.get_help().map(ToString::to_string)).unwrap_or_default()
    }

    /// All of them, a line each, for a help text.
    fn list() -> String {
        Self::value_variants().iter().map(|value| format!("\n  {:16} {}", value.name(), value.what())).collect()
    }
}

/// Some of the values of a kind; none by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Set<T> {
    bits: u32,
    kind: PhantomData<T>,
}

impl<T> Default for Set<T> {
    fn default() -> Self {
        Self { bits: 0, kind: PhantomData }
    }
}

impl<T: Named> Set<T> {
    /// All values.
    pub fn all() -> Self {
        T::value_variants().iter().copied().collect()
    }

    /// These and `value`.
    #[must_use]
    pub fn with(self, value: T) -> Self {
        Self { bits: self.bits | 1 << value.index(), ..self }
    }

    /// Whether `value` is among them.
    #[inline]
    pub fn has(self, value: T) -> bool {
        self.bits >> value.index() & 1 != 0
    }
}

impl<T: Named> FromIterator<T> for Set<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        values.into_iter().fold(Self::default(), Self::with)
    }
}

/// A name that no value has.
#[derive(Debug, Error)]
#[error("no {kind} is called `{name}`; there are {known}")]
pub struct UnknownName {
    kind: &'static str,
    name: String,
    known: String,
}

impl<T: Named> FromStr for Set<T> {
    type Err = UnknownName;

    /// Names separated by commas, or `all` where that is one.
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        const ALL: &str = "all";
        if T::HAS_ALL && text == ALL {
            return Ok(Self::all());
        }
        let of = |name: &str| {
            T::from_str(name, false).map_err(|_| {
                let all = T::HAS_ALL.then(|| ALL.to_owned());
                let known: Vec<_> =
                    all.into_iter().chain(T::value_variants().iter().map(|value| value.name())).collect();
                UnknownName { kind: T::KIND, name: name.to_owned(), known: known.join(", ") }
            })
        };
        text.split(',').map(str::trim).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::silicon::{Fault, Silicon};
    use crate::world::{Flaw, Flaws};

    use super::*;

    #[test]
    fn faults_are_read_by_name_and_unknown_ones_told() {
        let some: Silicon = "hse-dead, adc-stop".parse().expect("names");
        assert!(some.has(Fault::HseDead) && some.has(Fault::AdcStop) && !some.has(Fault::AdcStale));
        assert_eq!("all".parse::<Silicon>().expect("all"), Silicon::all());
        let is_found = |fault: &Fault| fault.name().parse::<Silicon>().expect("a name").has(*fault);
        assert!(Fault::value_variants().iter().all(is_found));
        let error = "adc-stop,x".parse::<Silicon>().expect_err("no such fault").to_string();
        assert!(error.contains("`x`") && error.contains("usb-host"), "{error}");
    }

    #[test]
    fn flaws_are_read_by_name_and_unknown_ones_refused() {
        let some: Flaws = "low-supply, dead-emitter".parse().expect("names");
        assert!(some.has(Flaw::LowSupply) && some.has(Flaw::DeadEmitter) && !some.has(Flaw::OpenElectrode));
        let is_found = |flaw: &Flaw| flaw.name().parse::<Flaws>().expect("a name").has(*flaw);
        assert!(Flaw::value_variants().iter().all(is_found));
        for unknown in ["low-supply,x", "all"] {
            let error = unknown.parse::<Flaws>().expect_err("no such flaw").to_string();
            assert!(error.contains(&format!("`{}`", unknown.trim_start_matches("low-supply,"))), "{error}");
            assert!(error.contains("missing-baffle"), "{error}");
        }
    }

    #[test]
    fn each_has_a_phrase_of_its_own_and_a_place() {
        fn check<T: Named>() {
            let values = T::value_variants();
            let phrases: std::collections::BTreeSet<_> = values.iter().map(|value| value.what()).collect();
            assert!(phrases.len() == values.len() && !phrases.contains(""), "{phrases:?}");
            assert!((0..).zip(values).all(|(place, value)| value.index() == place));
        }
        check::<Fault>();
        check::<Flaw>();
    }
}
