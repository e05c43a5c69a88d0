//! Damaged and lost data, reported at the end.

use super::{Outcome, talk};
use crate::pipeline::Counts;

/// Reports the losses of a stream on standard error, if there are any. A packet under way when the
/// end was `wanted` is not lost: it was not waited for.
pub(super) fn tell(name: &str, counts: &Counts, wanted: bool) -> Outcome {
    let lossless = if wanted { !counts.has_loss_before_end() } else { !counts.has_loss() };
    if lossless {
        return Outcome::Done;
    }
    let decoder = counts.decoder;
    talk(format_args!(
        "{name}: data were damaged or lost: {} scans missing, {} restarts of the board, {} damaged and {} unreadable packets \
         ({} bytes skipped), {} bytes of a packet that was cut off, {} batches without a hello",
        counts.scans_lost,
        counts.restarts,
        decoder.damaged(),
        decoder.unknown + decoder.malformed + counts.batches_unreadable,
        decoder.bytes_skipped,
        counts.pending_bytes,
        counts.batches_without_hello,
    ));
    Outcome::DataLost
}
