//! A message as a row of numbers.

use core::ops::Deref;

use glam::DVec3;
use heapless::Vec;

use crate::mailbox::SLOTS;

/// Numbers in the order in which they are said. An absent one is NaN.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Numbers(Vec<f64, SLOTS>);

impl Numbers {
    /// Says `values`.
    ///
    /// # Panics
    /// If there are more than a mailbox holds.
    pub(crate) fn put(&mut self, values: &[f64]) {
        self.0.extend_from_slice(values).expect("every message fits the mailbox");
    }

    pub(crate) fn put_option(&mut self, value: Option<f64>) {
        self.put(&[value.unwrap_or(f64::NAN)]);
    }

    /// Begins to take the numbers, in the same order.
    pub(crate) fn reader(&self) -> Reader<'_> {
        Reader(&self.0)
    }
}

impl Deref for Numbers {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        &self.0
    }
}

impl FromIterator<f64> for Numbers {
    fn from_iter<T: IntoIterator<Item = f64>>(numbers: T) -> Self {
        Self(numbers.into_iter().collect())
    }
}

/// Takes numbers, as long as there are any.
pub(crate) struct Reader<'a>(&'a [f64]);

impl Reader<'_> {
    pub(crate) fn number(&mut self) -> Option<f64> {
        let (first, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(*first)
    }

    /// A number that may be absent.
    pub(crate) fn option(&mut self) -> Option<Option<f64>> {
        self.number().map(|value| (!value.is_nan()).then_some(value))
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Option<[f64; N]> {
        let (first, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*first)
    }

    pub(crate) fn vector(&mut self) -> Option<DVec3> {
        self.array().map(DVec3::from_array)
    }
}
