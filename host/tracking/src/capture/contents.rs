//! What a capture holds, by the summary at its end.

use std::fs::File;
use std::io::{self, Read, Seek};
use std::path::Path;

use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};

use crate::link::DeviceId;
use crate::ros;

/// A longer summary is that of no capture.
const MAX_RECORD_BYTES: usize = 1 << 28;

/// What a capture holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contents {
    /// Boards with data.
    pub boards: Vec<DeviceId>,
    /// Time between the first message and the last, seconds.
    pub length_s: f64,
    /// Number of notes.
    pub notes: u64,
}

/// What the capture at `path` holds; `None` without a whole summary, which is written last: the file is still being
/// recorded, was cut off, or is no capture.
///
/// # Errors
/// A file that cannot be read.
pub fn contents(path: &Path) -> io::Result<Option<Contents>> {
    let mut file = File::open(path)?;
    let size = file.metadata()?.len();
    let options = SummaryReaderOptions::default().with_file_size(size).with_record_length_limit(MAX_RECORD_BYTES);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(SummaryReadEvent::ReadRequest(count)) => {
                let read = file.read(reader.insert(count))?;
                reader.notify_read(read);
            }
            Ok(SummaryReadEvent::SeekRequest(to)) => reader.notify_seeked(file.seek(to)?),
            // It ends in the middle, or is no capture.
            Err(_) => return Ok(None),
        }
    }
    let Some(summary) = reader.finish() else { return Ok(None) };
    let Some(statistics) = summary.stats else { return Ok(None) };
    let messages = |id: &u16| statistics.channel_message_counts.get(id).copied().unwrap_or(0);
    let mut contents = Contents {
        length_s: statistics.message_end_time.saturating_sub(statistics.message_start_time) as f64 * 1e-9,
        ..Contents::default()
    };
    for (id, channel) in summary.channels.iter().filter(|(id, _)| messages(id) > 0) {
        match ros::board_of(&channel.topic) {
            Some((device, "link")) => contents.boards.push(device),
            _ if channel.topic == ros::NOTES => contents.notes += messages(id),
            _ => {}
        }
    }
    contents.boards.sort();
    Ok(Some(contents))
}
