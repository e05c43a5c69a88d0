//! Damaged and lost data, reported at the end.

use super::{Outcome, talk};
use crate::pipeline::Counts;

/// Reports the losses of a stream on standard error, if there are any. A packet under way when the
/// end was `wanted` is not lost: it was not waited for.
pub(super) fn tell(name: &str, counts: &Counts, wanted: bool) -> Outcome {
    match counts.losses(wanted) {
        None => Outcome::Done,
        Some(losses) => {
            talk(format_args!("{name}: {losses}"));
            Outcome::DataLost
        }
    }
}
