//! Captures from strangers.

use slitpose::inputs::{Captured, capture as read};
use slitpose_head::table::CAPTURE_MAGIC;

/// Damage is counted, never an error; what is whole and what is lost are parts of the file. From a later instant on, and of
/// a whole file that is cut off, no more is read than of the whole, and a second time the same.
pub(crate) fn capture(bytes: &[u8]) {
    let (&cut, bytes) = bytes.split_first().unwrap_or((&0, &[]));
    let whole = captured(bytes, 0);
    assert_eq!(captured(bytes, 0), whole);
    let later = captured(bytes, u64::from(cut) << 56);
    assert!(later.link_bytes <= whole.link_bytes, "{later:?} after {whole:?}");
    // Of a damaged file a part may show more: a wrong length that swallows what follows is noticed only where that is
    // missing.
    if bytes.starts_with(CAPTURE_MAGIC) && !whole.has_loss {
        let part = captured(&bytes[..bytes.len() * usize::from(cut) / 256], 0);
        assert!(part.link_bytes <= whole.link_bytes, "{part:?} of {whole:?}");
    }
}

fn captured(bytes: &[u8], from_ns: u64) -> Captured {
    let captured = read(bytes, from_ns).expect("bytes in memory can be read");
    assert!(captured.whole_bytes <= bytes.len() as u64 && captured.lost_bytes <= bytes.len() as u64, "{captured:?}");
    captured
}
