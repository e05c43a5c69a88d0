//! Facts on captures besides the data of boards.

use std::collections::{BTreeSet, VecDeque};
use std::fs::{self, File};
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use slitpose_head::scene_file::SceneFile;
use slitpose_head::special_file;
use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message};

use super::{Outline, OutlineNote, PlaybackError, Shelf};
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
pub(super) fn first_log_ns(shelf: &impl Shelf, path: &Path) -> Result<u64, CaptureError> {
    let mut reader = shelf.open(path)?;
    Ok(next_log_ns(&mut reader, &mut Segment::default())?.unwrap_or(0))
}

/// Most notes that are kept, and most characters of one.
const MAX_NOTES: [usize; 2] = [200, 500];

/// Reads captures for their length and notes, those of a series in their order, an entry at a time.
pub struct Survey<I = File> {
    files: VecDeque<PathBuf>,
    reader: Option<CaptureReader<I>>,
    segment: Segment,
    /// Of the first bytes and the last.
    span_ns: Option<[u64; 2]>,
    noted: Vec<(u64, String)>,
}

impl<I: Read + Seek> Survey<I> {
    /// Of the captures called `files`.
    pub fn of(files: &[PathBuf]) -> Self {
        let (files, reader, segment) = (files.iter().cloned().collect(), None, Segment::default());
        Self { files, reader, segment, span_ns: None, noted: Vec::new() }
    }

    /// Reads on to the next bytes of a board; `false` at the end.
    ///
    /// # Errors
    /// Captures that cannot be read.
    pub fn step(&mut self, shelf: &impl Shelf<Input = I>) -> Result<bool, CaptureError> {
        let [most, longest] = MAX_NOTES;
        loop {
            let Some(reader) = &mut self.reader else {
                let Some(path) = self.files.pop_front() else { return Ok(false) };
                self.reader = Some(shelf.open(&path)?);
                continue;
            };
            match reader.next(&mut self.segment)? {
                Some(Entry::Link { log_ns, .. }) => {
                    let [first, last] = self.span_ns.unwrap_or([log_ns; 2]);
                    self.span_ns = Some([first, last.max(log_ns)]);
                    return Ok(true);
                }
                Some(Entry::Note { stamp_ns, text, .. }) if self.noted.len() < most => {
                    self.noted.push((stamp_ns, text.chars().take(longest).collect()));
                }
                Some(Entry::Setup(_) | Entry::Hello { .. } | Entry::Note { .. }) => {}
                None => self.reader = None,
            }
        }
    }

    /// Their length so far, seconds.
    pub fn length_s(&self) -> f64 {
        self.span_ns.map_or(0.0, |[first, last]| since_s(first, last).max(0.0))
    }

    /// What has been found so far.
    pub fn outline(&self) -> Outline {
        let start_ns = self.span_ns.map_or(0, |[first, _]| first);
        let note =
            |(stamp_ns, text): &(u64, String)| OutlineNote { at_s: since_s(start_ns, *stamp_ns), text: text.clone() };
        Outline { length_s: self.length_s(), notes: self.noted.iter().map(note).collect() }
    }
}

/// Seconds from one instant to the other, nanoseconds; below zero if that is earlier.
pub(super) fn since_s(from_ns: u64, to_ns: u64) -> f64 {
    (i128::from(to_ns) - i128::from(from_ns)) as f64 * 1e-9
}

fn next_log_ns<I: Read + Seek>(
    reader: &mut CaptureReader<I>,
    segment: &mut Segment,
) -> Result<Option<u64>, CaptureError> {
    while let Some(entry) = reader.next(segment)? {
        if let Entry::Link { log_ns, .. } = entry {
            return Ok(Some(log_ns));
        }
    }
    Ok(None)
}

/// The scene hash of the first hello in the bytes of a port.
pub(super) fn scene_hash(shelf: &impl Shelf, path: &Path) -> Result<Option<u64>, CaptureError> {
    let mut reader = shelf.open(path)?;
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
