//! Captures that another program has written, or nobody should.

use std::borrow::Cow;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, WriteOptions};

use super::*;
use crate::capture::link_bytes;
use crate::capture::setup::{LinkChannels, METADATA};

/// A capture with one scene, the settings of `boards`, and a message of the link of each.
fn written(compression: Option<Compression>, boards: &[DeviceId]) -> Vec<u8> {
    rewritten(compression, boards, "AMD", &[0])
}

/// As [`written`], with attachments, metadata and data, each in a chunk of its own, in this order; the messages of each
/// board have the times `log_ns`.
fn rewritten(compression: Option<Compression>, boards: &[DeviceId], order: &str, log_ns: &[u64]) -> Vec<u8> {
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
    for part in order.chars() {
        match part {
            'A' => writer.attach(&scene).unwrap(),
            'M' => {
                for (link, device) in (1..).zip(boards) {
                    let setup = Setup::new(*device, &file.clone().into(), settings());
                    let metadata = setup.to_metadata("bench.toml", LinkChannels { link, hello: u16::MAX });
                    writer.write_metadata(&Metadata { name: METADATA.to_owned(), metadata }).unwrap();
                }
            }
            _ => {
                for device in boards {
                    // As older captures name it.
                    let topic = format!("/slitpose/{device}/link");
                    writer.add_channel(0, &topic, "cdr", &BTreeMap::new()).unwrap();
                }
                for (log_time, channel_id) in log_ns.iter().flat_map(|at| (1..=boards.len() as u16).map(|id| (*at, id)))
                {
                    let mut message = Vec::new();
                    link_bytes::encode(&message_of(channel_id, log_time), &mut message);
                    let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time: 0 };
                    writer.write_to_known_channel(&header, &message).unwrap();
                }
                writer.flush().unwrap();
            }
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn message_of(channel_id: u16, log_ns: u64) -> Segment {
    let mut segment = Segment::default();
    segment.push(&channel_id.to_le_bytes().repeat(500), Some(later(BEGIN, log_ns)));
    segment
}

/// As `mcap filter`, `sort`, `compress` and `merge` leave captures.
#[test]
fn a_rewritten_capture_reads_in_the_order_of_time_wherever_its_settings_stand() {
    let sorted: Vec<_> = [0, 1, 2].into_iter().flat_map(|at| [1, 2].map(|id| message_of(id, at))).collect();
    for order in ["AMD", "MAD", "ADM", "MDA", "DAM", "DMA", "MMADMM"] {
        for log_ns in [[0, 1, 2], [2, 1, 0], [1, 2, 0]] {
            let bytes = rewritten(Some(Compression::Zstd), &[FIRST, SECOND], order, &log_ns);
            let (content, end) = read(&bytes);
            assert!(end.finished && !end.has_loss(), "{order} {log_ns:?}: {end:?}");
            let devices: Vec<_> = content.setups.iter().map(|setup| setup.device).collect();
            assert_eq!(devices, [FIRST, SECOND], "{order} {log_ns:?}");
            assert!(segments(content) == sorted, "{order} {log_ns:?}");
        }
    }
    // Without the scene, the loss is named.
    let (content, end) = read(&rewritten(None, &[FIRST], "MD", &[0]));
    assert!(content.setups.is_empty() && matches!(end.refused, Some(SetupError::Scene { .. })), "{end:?}");
    let (_, end) = read(&rewritten(None, &[FIRST], "D", &[0]));
    assert_eq!(end.topics, [format!("/slitpose/{FIRST}/link")].into());
}

/// Each chunk of 4 MiB has less than a kilobyte; the file may unpack to 16 MiB, and 256 bytes for each of its own.
#[test]
fn chunks_that_unpack_out_of_proportion_are_damage() {
    let options = WriteOptions::new().compression(Some(Compression::Zstd));
    let mut writer = options.create(io::Cursor::new(Vec::new())).unwrap();
    let channel_id = writer.add_channel(0, "/zeros", "cdr", &BTreeMap::new()).unwrap();
    for _ in 0..100 {
        let header = MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, &[0; 4 << 20]).unwrap();
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    let bytes = writer.into_inner().into_inner();
    let unpacked_chunks = 100 - read(&bytes).1.damaged_records;
    let allowed_bytes = (16 << 20) + 256 * bytes.len() as u64;
    assert!(bytes.len() < 100_000 && unpacked_chunks >= 4, "{} bytes: {unpacked_chunks}", bytes.len());
    assert!(unpacked_chunks << 22 <= allowed_bytes, "{} bytes: {unpacked_chunks}", bytes.len());
}

#[test]
fn chunks_of_every_compression_are_read() {
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let bytes = written(compression, &[FIRST, SECOND]);
        let (content, end) = read(&bytes);
        assert!(end.finished && !end.has_loss(), "{compression:?}: {end:?}");
        assert_eq!(segments(content), [message_of(1, 0), message_of(2, 0)], "{compression:?}");
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
