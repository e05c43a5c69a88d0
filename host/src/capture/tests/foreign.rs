//! Captures that another program has written, or nobody should.

use std::borrow::Cow;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, WriteOptions};

use super::*;
use crate::capture::link_bytes;
use crate::capture::setup::{LinkChannels, METADATA};

/// A capture with one scene, the settings of `boards`, and a message of the link of each.
fn written(compression: Option<Compression>, boards: &[DeviceId]) -> Vec<u8> {
    let file = BENCH.read().unwrap();
    let options = WriteOptions::new().profile("ros2").compression(compression);
    let mut writer = options.create(io::Cursor::new(Vec::new())).unwrap();
    let scene = Attachment {
        log_time: 0,
        create_time: 0,
        name: "bench.toml".to_owned(),
        media_type: "application/toml".to_owned(),
        data: Cow::Borrowed(file.source.as_bytes()),
    };
    writer.attach(&scene).unwrap();
    let channels: Vec<u16> = boards
        .iter()
        .map(|device| {
            // As older captures name it.
            let link = writer.add_channel(0, &format!("/slitpose/{device}/link"), "cdr", &BTreeMap::new()).unwrap();
            let setup = Setup::new(*device, &file.clone().into(), settings());
            let metadata = setup.to_metadata("bench.toml", LinkChannels { link, hello: u16::MAX });
            writer.write_metadata(&Metadata { name: METADATA.to_owned(), metadata }).unwrap();
            link
        })
        .collect();
    for channel_id in channels {
        let mut message = Vec::new();
        link_bytes::encode(&message_of(channel_id), &mut message);
        let header = MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, &message).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn message_of(channel_id: u16) -> Segment {
    let mut segment = Segment::default();
    segment.push(&channel_id.to_le_bytes().repeat(500), Some(BEGIN));
    segment
}

#[test]
fn chunks_of_every_compression_are_read() {
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let bytes = written(compression, &[FIRST, SECOND]);
        let (content, end) = read(&bytes);
        assert!(end.finished && !end.has_loss(), "{compression:?}: {end:?}");
        assert_eq!(segments(content), [message_of(1), message_of(2)], "{compression:?}");
        // And damage is found in each.
        let mut damaged = bytes.clone();
        let at = bytes.windows(4).rposition(|four| four == [1, 0, 1, 0]).unwrap_or(bytes.len() / 2);
        damaged[at] ^= 0x10;
        assert!(read(&damaged).1.has_loss(), "{compression:?}");
    }
}

/// 20,000 records of a few hundred bytes must not become as many pipelines.
#[test]
fn boards_beyond_what_a_host_can_follow_are_refused() {
    let many: Vec<DeviceId> = (0..300_u32)
        .map(|number| {
            let mut device = *b"00000000many";
            device[..4].copy_from_slice(&number.to_be_bytes());
            DeviceId(device)
        })
        .collect();
    let (content, end) = read(&written(Some(Compression::Zstd), &many));
    assert_eq!(content.setups.iter().map(|setup| setup.device).collect::<Vec<_>>(), many[..256]);
    assert_eq!(end.refused, Some(SetupError::TooMany { limit: 256 }));
    assert!(end.has_loss());
}
