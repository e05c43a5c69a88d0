//! Poses on the line to a motor controller: a frame for each, the same numbers as over USB, and in time.
//!
//! What is read here follows the table of `slitpose_firmware::pose::frame`; its code has no part in it.

use crate::common::talk::Talk;
use crate::common::{SEED, scene, us};
use slitpose_emulator::peripherals::{SentByte, Ticks};
use slitpose_emulator::world::NoiseSource;
use slitpose_firmware::pcb::default_configuration;
use slitpose_protocol::poses::{PoseStatus, READY_TICKS};
use slitpose_protocol::{Command, Level, PoseRecord, Stream};

const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

const BYTES: usize = 64;

/// 34 periods a bit, ten bits a byte.
const BYTE_TICKS: Ticks = 340;

/// The third channel of DMA2, which begins with the ninth of all.
const CHANNEL: usize = 8 + 2;

/// A frame whose checksum is right.
#[derive(Debug)]
struct Frame {
    bytes: [u8; BYTES],
    /// The beginning of its first start bit, and the end of its last stop bit.
    began: Ticks,
    over: Ticks,
}

impl Frame {
    fn half(&self, at: usize) -> u16 {
        u16::from_le_bytes([self.bytes[at], self.bytes[at + 1]])
    }

    fn word(&self, at: usize) -> u32 {
        u32::from(self.half(at)) | u32::from(self.half(at + 2)) << 16
    }

    fn number(&self, at: usize) -> f32 {
        f32::from_bits(self.word(at))
    }

    fn unsent(&self) -> u16 {
        self.half(14)
    }

    fn has_pose(&self) -> bool {
        self.bytes[3] < 4
    }

    /// Asserts that it is of the pose of USB with these numbers.
    fn assert_is(&self, (sequence, tick, record): &(u64, u64, PoseRecord)) {
        let record_bytes = record.write();
        assert_eq!((self.word(4), self.word(8)), (*sequence as u32, *tick as u32), "frame {sequence}");
        assert_eq!((self.bytes[2], self.bytes[3]), (1, record_bytes[0]), "frame {sequence}");
        let counts = (self.half(12), self.half(16), self.half(18));
        assert_eq!(counts, (record.ready, record.cells_used, record.excluded), "frame {sequence}");
        assert_eq!(self.bytes[20..48], record_bytes[8..36], "frame {sequence}");
        assert_eq!(self.bytes[56..60], record_bytes[36..], "frame {sequence}");
    }
}

/// The frames in what has come, and the number of bytes that belong to none.
fn frames(sent: &[SentByte]) -> (Vec<Frame>, usize) {
    let (mut found, mut others, mut at) = (Vec::new(), 0, 0);
    while at < sent.len() {
        let bytes = sent.get(at..at + BYTES).map(|sent| std::array::from_fn(|k| sent[k].byte));
        let whole = bytes.filter(|bytes: &[u8; BYTES]| {
            bytes[..2] == [0xa5, 0x5a] && CRC.checksum(&bytes[..60]).to_le_bytes() == bytes[60..]
        });
        if let Some(bytes) = whole {
            let (began, over) = (sent[at].at - BYTE_TICKS, sent[at + BYTES - 1].at);
            found.push(Frame { bytes, began, over });
            at += BYTES;
        } else {
            others += 1;
            at += 1;
        }
    }
    (found, others)
}

/// Ends sampling, and gives what has come to the controller since the last call.
fn stop(talk: &mut Talk) -> (Vec<Frame>, usize) {
    talk.rig.send(Command::Stop);
    talk.run_ms(5.0);
    frames(&talk.rig.take_controller_bytes())
}

/// A second at 4 kHz, a moving tool, poses alone over USB.
#[test]
fn every_pose_is_on_the_line_bit_for_bit_and_none_is_missing_at_4_khz() {
    let mut talk = Talk::solving(&scene(), NoiseSource::Seeded(SEED));
    talk.rig.listen_as_controller();
    talk.start_poses();
    talk.run_ms(1_000.0);
    let (frames, others) = stop(&mut talk);
    assert_eq!((others, talk.ear.missed, talk.ear.damaged()), (0, 0, 0));
    assert!(frames.len() >= 3_990, "{}", frames.len());
    assert_eq!(frames.len(), talk.ear.poses.len());
    for (frame, (_, pose)) in frames.iter().zip(&talk.ear.poses) {
        frame.assert_is(pose);
        assert_eq!(frame.unsent(), 0);
    }
    for (index, triangle) in &talk.ear.covariances {
        for (at, places) in [(48, [0, 2, 5]), (52, [9, 14, 20])] {
            let sigma = places.iter().map(|&place| f64::from(triangle[place])).sum::<f64>().sqrt();
            let off = f64::from(frames[*index].number(at)) / sigma - 1.0;
            assert!(off.abs() < 1e-6, "{off}");
        }
    }

    // From the reading of the clock that the record tells, in units of 64 ticks, to the line.
    let origin = talk.origin();
    let ready =
        |(_, tick, record): &(u64, u64, PoseRecord)| origin + tick + u64::from(record.ready) * u64::from(READY_TICKS);
    let pairs = || frames.iter().zip(&talk.ear.poses);
    let mut begin: Vec<_> = pairs().map(|(frame, (_, pose))| frame.began - ready(pose)).collect();
    let mut over: Vec<_> = pairs().map(|(frame, (_, pose))| frame.over - ready(pose)).collect();
    begin.sort_unstable();
    over.sort_unstable();
    let (middle, last) = (frames.len() / 2, frames.len() - 1);
    println!(
        "pose to first bit: median {:.2} µs, at most {:.2} µs; to the last: {:.2} µs, {:.2} µs",
        us(begin[middle]),
        us(begin[last]),
        us(over[middle]),
        us(over[last])
    );
    assert!(us(begin[last]) < 6.0 && us(over[last]) < 134.0);
    // When the last byte has come; the first poses are found from nothing.
    let schedule = talk.ear.schedule();
    let passed = |since: Ticks| {
        let after = pairs().skip(40).map(|(frame, (_, (_, tick, _)))| frame.over - (origin + tick + since));
        let mut after: Vec<_> = after.collect();
        after.sort_unstable();
        (us(after[after.len() / 2]), us(after[after.len() - 1]))
    };
    let of_last_conversion = passed(schedule.last_sample_ticks());
    let age = passed(schedule.reference_ticks() as Ticks);
    println!("last conversion to last byte: median and most {of_last_conversion:.1?} µs; age: {age:.1?} µs");
    assert!(age.0 < 500.0 && age.1 < 1_000.0);
    let nearest = frames.windows(2).map(|pair| pair[1].began - pair[0].began).min().expect("frames");
    println!("least distance of two frames: {:.1} µs", us(nearest));
    assert!(frames.iter().all(|frame| frame.over - frame.began == BYTES as Ticks * BYTE_TICKS), "without a gap");
}

/// The stream is the host's: the controller has every pose with scans alone, and with each tenth pose.
#[test]
fn frames_leave_whatever_the_host_asks_for() {
    let mut talk = Talk::solving(&scene(), NoiseSource::Off);
    talk.rig.listen_as_controller();
    for stream in [Stream::SCANS, Stream { scans: 0, poses: 10 }] {
        talk.rig.send(Command::Stream(stream));
        talk.run_ms(1.0);
        talk.ear.poses.clear();
        talk.rig.send(Command::Start);
        talk.run_ms(100.0);
        let (frames, others) = stop(&mut talk);
        assert_eq!(others, 0);
        // While the tool is looked for, scans are passed over, some two dozen at most.
        let span = frames[frames.len() - 1].word(4) - frames[0].word(4);
        assert!(span >= 385 && frames.len() >= 360, "{stream:?}: {} of {span}", frames.len());
        assert!(frames[40..].windows(2).all(|pair| pair[1].word(4) == pair[0].word(4) + 1), "{stream:?}");
        assert_eq!(talk.ear.poses.len() > 30, stream.poses > 0);
        for (_, pose) in &talk.ear.poses {
            frames.iter().find(|frame| frame.word(4) == pose.0 as u32).expect("it is among them").assert_is(pose);
        }
    }
}

/// The tool is taken away and comes back: frames say that there is no pose, and what was not sent is counted.
#[test]
fn without_a_tool_frames_have_a_status_and_no_numbers() {
    let mut talk = Talk::solving(&scene(), NoiseSource::Seeded(SEED));
    talk.rig.listen_as_controller();
    talk.start_poses();
    talk.run_ms(50.0);
    let mut dark = default_configuration();
    dark.levels.iter_mut().for_each(|level| *level = Level(0));
    for configuration in [dark, default_configuration()] {
        talk.rig.send(Command::Configure(configuration));
        talk.run_ms(50.0);
    }
    let (frames, others) = stop(&mut talk);
    assert_eq!((others, talk.ear.damaged()), (0, 0));
    let without: Vec<_> = frames.iter().filter(|frame| !frame.has_pose()).collect();
    assert!(without.len() > 100, "{}", without.len());
    for frame in without {
        assert!((20..56).step_by(4).all(|at| frame.number(at).is_nan()), "{frame:?}");
    }
    assert!(frames[frames.len() - 20..].iter().all(Frame::has_pose), "it is back");
    let unsent = frames[frames.len() - 1].unsent();
    println!("{} frames, {unsent} not sent, {} poses over USB", frames.len(), talk.ear.poses.len());
    assert_eq!(frames.len() + usize::from(unsent), talk.ear.poses.len());
    for (_, pose) in &talk.ear.poses {
        match frames.iter().find(|frame| frame.word(4) == pose.0 as u32) {
            Some(frame) => frame.assert_is(pose),
            // Only scans without a pose follow one another faster than frames.
            None => assert!(!pose.2.status.has_pose(), "{pose:?}"),
        }
    }
}

/// The DMA meets a bus error within a frame: that one is cut short, the next one counts it and all others are right.
#[test]
fn a_frame_that_the_dma_has_cut_short_costs_no_other() {
    let mut talk = Talk::solving(&scene(), NoiseSource::Off);
    talk.rig.listen_as_controller();
    talk.start_poses();
    talk.run_ms(20.0);
    talk.rig.take_controller_bytes();
    // Until the first bytes of a frame are there; they are not looked at again.
    while talk.rig.take_controller_bytes().is_empty() {
        let _ = talk.rig.run_for(1e-6);
    }
    talk.rig.machine.board.dma.fail_next(CHANNEL);
    talk.run_ms(20.0);
    let (frames, others) = stop(&mut talk);
    assert!((1..BYTES).contains(&others), "the rest of one frame: {others}");
    assert!(frames.len() > 70 && frames.iter().all(|frame| frame.unsent() == 1), "{}", frames.len());
    assert!(frames.iter().all(|frame| frame.bytes[3] == PoseStatus::Converged as u8));
    for frame in &frames {
        let pose = talk.ear.poses.iter().find(|(_, pose)| pose.0 as u32 == frame.word(4)).expect("it is among them");
        frame.assert_is(&pose.1);
    }
    assert!(frames.windows(2).all(|pair| pair[1].word(4) == pair[0].word(4) + 1), "none between them");
}

/// Prints what the header reads from the line, numbers as their bits.
const PRINT_FRAMES: &str = r#"
#include <inttypes.h>
#include <stdio.h>
#include "slitpose_frame.h"
static void print(const float *numbers, int count)
{
    for (int i = 0; i < count; i++) {
        uint32_t word;
        memcpy(&word, numbers + i, 4);
        printf(" %" PRIx32, word);
    }
}
int main(void)
{
    static struct slitpose_receiver receiver;
    struct slitpose_frame f;
    for (int byte; (byte = getchar()) != EOF;)
        if (slitpose_receive(&receiver, (uint8_t)byte, &f)) {
            printf("%d %d %" PRIu32 " %" PRIu32 " %" PRIu32, f.status, slitpose_has_pose(&f), f.sequence, f.tick,
                   f.ready_ticks);
            printf(" %d %d %d", f.unsent, f.cells_used, f.excluded_cells);
            print(f.translation_m, 3);
            print(f.rotation_xyzw, 4);
            print(&f.sigma_m, 1);
            print(&f.sigma_rad, 1);
            print(&f.chi2, 1);
            printf("\n");
        }
    return 0;
}
"#;

/// Bytes of the board, some of them damaged or missing, through the header for controllers in C.
#[test]
fn a_controller_in_c_reads_what_the_board_sends() {
    let mut talk = Talk::solving(&scene(), NoiseSource::Seeded(SEED));
    talk.rig.listen_as_controller();
    talk.rig.send(Command::Start);
    talk.run_ms(20.0);
    let mut sent = talk.rig.take_controller_bytes();
    // Begins within a frame; one is damaged in the middle, one lacks a byte, one lacks its end.
    sent[20 * BYTES + 30].byte ^= 0x10;
    for gap in [50 * BYTES + 20..51 * BYTES, 40 * BYTES + 7..40 * BYTES + 8, 0..10] {
        sent.drain(gap);
    }
    let (frames, _) = frames(&sent);

    let folder = tempfile::tempdir().expect("a folder");
    let (source, program) = (folder.path().join("frames.c"), folder.path().join("frames"));
    std::fs::write(&source, PRINT_FRAMES).expect("room");
    let header = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware/include");
    let warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wundef", "-Werror", "-std=c99"];
    let mut compiler = std::process::Command::new("cc");
    let compiled = compiler.args(warnings).arg("-I").arg(header).arg("-o").args([&program, &source]).output();
    let compiled = compiled.expect("a C compiler, as `cc`");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let line = folder.path().join("line");
    std::fs::write(&line, sent.iter().map(|sent| sent.byte).collect::<Vec<_>>()).expect("room");
    let output = std::process::Command::new(&program).stdin(std::fs::File::open(&line).expect("written")).output();
    let text = String::from_utf8(output.expect("it runs").stdout).expect("text");

    let expected: String = frames
        .iter()
        .map(|frame| {
            let ready_ticks = u32::from(frame.half(12)) * READY_TICKS;
            let counts = [14, 16, 18].map(|at| frame.half(at).to_string()).join(" ");
            let numbers: Vec<_> = (20..60).step_by(4).map(|at| format!("{:x}", frame.word(at))).collect();
            let has_pose = u8::from(frame.has_pose());
            let (status, sequence, tick) = (frame.bytes[3], frame.word(4), frame.word(8));
            format!("{status} {has_pose} {sequence} {tick} {ready_ticks} {counts} {}\n", numbers.join(" "))
        })
        .collect();
    assert!(frames.len() > 50, "{}", frames.len());
    assert_eq!(text, expected);
}
