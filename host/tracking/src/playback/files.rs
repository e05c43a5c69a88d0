//! Facts on captures besides the data of boards.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use slitpose_head::scene_file::SceneFile;
use slitpose_head::special_file;
use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message};

use super::{Outline, OutlineNote, PlaybackError};
use crate::capture::{CaptureError, CaptureReader, End, Entry};
use crate::link::Segment;
use crate::pipeline::SceneMatch;

/// That another scene is used than the capture was made with, if so.
pub(super) fn other_scene(file: &SceneFile, hash: Option<u64>, scene_match: SceneMatch) -> Option<String> {
    let hash = hash.filter(|hash| scene_match == SceneMatch::Waived && *hash != file.hash)?;
    Some(format!(
        "the capture was made with the scene of hash {hash:016x}; solving it with `{}` ({:016x}) as asked",
        file.name, file.hash
    ))
}

pub(super) fn losses(path: &Path, end: &End) -> Vec<String> {
    let mut losses = Vec::new();
    if !end.has_loss() {
        return losses;
    }
    let path = path.display();
    if end.damaged_records > 0 {
        losses.push(format!(
            "{path} is damaged in {} places, {} bytes together: what stood there, up to a second each time, is missing",
            end.damaged_records, end.lost_bytes
        ));
    } else if end.checksum_failed {
        losses.push(format!("{path} is damaged, as its checksum says, in a place that holds nothing of a board"));
    }
    if end.index_damaged {
        losses.push(format!(
            "the index at the end of {path} is damaged: nothing is missing, but other programs may refuse the file; \
             `mcap recover` writes another"
        ));
    }
    if end.trailing_bytes > 0 {
        losses.push(format!(
            "{path}: {} bytes behind the end of the capture are not read; if they are another capture, take both apart, and \
             replay them as a series: `slitpose replay a.mcap b.mcap`",
            end.trailing_bytes
        ));
    }
    if end.unordered_messages > 0 {
        losses.push(format!(
            "{path}: {} messages stand behind later ones, and their scans cannot be solved in order; \
             `mcap sort {path} -o sorted.mcap` sorts them",
            end.unordered_messages
        ));
    }
    if let Some(refused) = &end.refused {
        losses.push(format!("{path}: {refused}"));
    }
    if !end.finished {
        losses.push(format!(
            "{path} was not ended by its recorder: it was cut off, or is still being recorded; what came after its \
             last flush is missing ({} bytes of the file are whole, {} cannot be read)",
            end.whole_bytes, end.lost_bytes
        ));
    }
    losses
}

/// That captures can be read more than once, and each is given once.
pub(super) fn check(files: &[PathBuf]) -> Result<(), PlaybackError> {
    let mut known = BTreeSet::new();
    for path in files {
        // What is not there is told when it is read.
        if special_file::is_special(path) {
            return Err(PlaybackError::NotAFile { path: path.clone() });
        }
        if !known.insert(fs::canonicalize(path).unwrap_or_else(|_| path.clone())) {
            return Err(PlaybackError::Twice { path: path.clone() });
        }
    }
    Ok(())
}

/// When the first bytes of a capture came; 0 in bytes of a port.
pub(super) fn first_log_ns(path: &Path) -> Result<u64, CaptureError> {
    let mut reader = CaptureReader::open(path)?;
    Ok(next_log_ns(&mut reader, &mut Segment::default())?.unwrap_or(0))
}

/// Most notes that are kept, and most characters of one.
const MAX_NOTES: [usize; 2] = [200, 500];

/// Length and notes of captures, those of a series in their order; reads all of them, as long as `goes_on` allows, which is
/// given the length so far.
pub(super) fn outline(files: &[PathBuf], goes_on: &mut dyn FnMut(f64) -> bool) -> Result<Outline, CaptureError> {
    let [most, longest] = MAX_NOTES;
    let (mut start_ns, mut last_ns, mut noted) = (None, 0, Vec::new());
    for path in files {
        let (mut reader, mut segment) = (CaptureReader::open(path)?, Segment::default());
        while let Some(entry) = reader.next(&mut segment)? {
            match entry {
                Entry::Link { log_ns, .. } => {
                    last_ns = last_ns.max(log_ns);
                    if !goes_on(since_s(*start_ns.get_or_insert(log_ns), last_ns)) {
                        return Ok(Outline::default());
                    }
                }
                Entry::Note { stamp_ns, text, .. } if noted.len() < most => {
                    noted.push((stamp_ns, text.chars().take(longest).collect()));
                }
                Entry::Setup(_) | Entry::Hello { .. } | Entry::Note { .. } => {}
            }
        }
    }
    let start_ns = start_ns.unwrap_or(0);
    let note = |(stamp_ns, text)| OutlineNote { at_s: since_s(start_ns, stamp_ns), text };
    Ok(Outline { length_s: since_s(start_ns, last_ns).max(0.0), notes: noted.into_iter().map(note).collect() })
}

/// Seconds from one instant to the other, nanoseconds; below zero if that is earlier.
pub(super) fn since_s(from_ns: u64, to_ns: u64) -> f64 {
    (i128::from(to_ns) - i128::from(from_ns)) as f64 * 1e-9
}

fn next_log_ns(reader: &mut CaptureReader, segment: &mut Segment) -> Result<Option<u64>, CaptureError> {
    while let Some(entry) = reader.next(segment)? {
        if let Entry::Link { log_ns, .. } = entry {
            return Ok(Some(log_ns));
        }
    }
    Ok(None)
}

/// The scene hash of the first hello in the bytes of a port.
pub(super) fn scene_hash(path: &Path) -> Result<Option<u64>, CaptureError> {
    let mut reader = CaptureReader::open(path)?;
    let mut segment = Segment::default();
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    while reader.next(&mut segment)?.is_some() {
        let mut bytes = &segment.bytes[..];
        while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
            if let Ok(Message::Hello(hello)) = message {
                return Ok(hello.hashes.scene);
            }
        }
    }
    Ok(None)
}
