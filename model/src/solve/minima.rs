//! The minima that a search has found, and the poses that its rough approaches have led to.

use arrayvec::ArrayVec;

use crate::pose::Transform;
use crate::scalar::Number;

use super::accept::{ALIKE, DISTINCT_SIGMAS, Fit};
use super::levenberg_marquardt::Minimum;
use super::observability;

/// Rough approaches that are remembered, so that none is refined twice.
const REMEMBERED: usize = 15;

/// Displacement, in σ of a rough approach, up to which two approaches have led to one place.
const SAME_SIGMAS: f64 = 0.3;

/// Where rough approaches have led.
pub(super) struct Seen<S: Number> {
    places: ArrayVec<Transform<S>, REMEMBERED>,
    /// How many led to a known one.
    pub(super) again: usize,
}

impl<S: Number> Seen<S> {
    pub(super) fn new() -> Self {
        Self { places: ArrayVec::new(), again: 0 }
    }

    /// Whether `approach` has led where another has before; it is remembered.
    pub(super) fn has(&mut self, approach: &Minimum<S>, length_scale_m: S) -> bool {
        let is_known = self.places.iter().any(|before| {
            approach.factor.as_ref().is_some_and(|factor| {
                observability::sigmas_between(factor, before, &approach.pose, length_scale_m) <= S::of(SAME_SIGMAS)
            })
        });
        if is_known {
            self.again += 1;
        } else {
            // One that does not fit only makes for more work.
            let _ = self.places.try_push(approach.pose);
        }
        is_known
    }
}

/// The best pose so far, and the best of those that are not the same.
#[derive(Clone, Copy, Debug)]
pub(super) struct Minima<S: Number> {
    pub(super) best: Option<(Minimum<S>, Fit)>,
    rival: Option<(Minimum<S>, Fit)>,
    length_scale_m: S,
}

impl<S: Number> Minima<S> {
    pub(super) fn new(length_scale_m: S) -> Self {
        Self { best: None, rival: None, length_scale_m }
    }

    pub(super) fn add(&mut self, minimum: Minimum<S>, fit: Fit) {
        let is_better = |other: &Option<(Minimum<S>, Fit)>| {
            other.is_none_or(|(other, other_fit)| fit > other_fit || fit == other_fit && minimum.chi2 < other.chi2)
        };
        let is_new = self.best.is_none_or(|(best, _)| are_distinct(&best, &minimum, self.length_scale_m));
        if is_better(&self.best) {
            if is_new {
                self.rival = self.best;
            }
            self.best = Some((minimum, fit));
        } else if is_new && is_better(&self.rival) {
            self.rival = Some((minimum, fit));
        }
    }

    pub(super) fn places(&self) -> [Option<Transform<S>>; 2] {
        [self.best, self.rival].map(|found| found.map(|(minimum, _)| minimum.pose))
    }

    /// Whether the data leave directions free at the best pose.
    pub(super) fn is_singular(&self) -> bool {
        self.best.is_some_and(|(best, _)| best.factor.as_ref().is_none_or(observability::is_singular))
    }

    pub(super) fn best_fit(&self) -> Fit {
        self.best.map_or(Fit::None, |(_, fit)| fit)
    }

    /// Whether two poses fit alike, and no third can be so much better that neither counts.
    pub(super) fn are_alike(&self) -> bool {
        match (self.best, self.rival) {
            (Some((best, fit)), Some((rival, rival_fit))) => {
                fit != Fit::None && rival_fit == fit && rival.chi2 - best.chi2 < S::of(ALIKE)
            }
            _ => false,
        }
    }

    pub(super) fn cannot_be_beaten(&self) -> bool {
        self.best.is_some_and(|(best, fit)| fit == Fit::Full && best.chi2 < S::of(ALIKE))
    }
}

/// Whether two poses differ by more than the data of either allow.
pub(super) fn are_distinct<S: Number>(a: &Minimum<S>, b: &Minimum<S>, length_scale_m: S) -> bool {
    [a, b].iter().any(|by| {
        by.factor.as_ref().is_none_or(|factor| {
            let sigmas = observability::sigmas_between(factor, &a.pose, &b.pose, length_scale_m);
            sigmas.is_nan() || sigmas > S::of(DISTINCT_SIGMAS)
        })
    })
}
