//! The core of a board, over hardware that fails when the script says so.

#[allow(dead_code, reason = "the firmware's tests use the rest")]
#[path = "../../../firmware/tests/testsuite/common/mod.rs"]
mod scripted;

use scripted::{Fake, Finished, identity};
use slitpose_firmware::pcb::{default_configuration, default_scaling};
use slitpose_firmware::{Board, Identity, Link, TRANSMIT_BYTES};
use slitpose_protocol::{Decoder, HardwareFault, MAX_MESSAGE_BYTES, Message};

use crate::wire::{packet, steps};

/// Runs the script: bytes of the link as they are or as payloads with the right checksum, scans, faults, time. Emitters
/// are dark whenever the board does not acquire and the hardware obeys; whatever the board sends is a packet.
pub(crate) fn any_link_and_any_fault(script: &[u8]) {
    let identity = Identity { scaling: default_scaling(), ..identity() };
    let board = Board::new(Fake::default(), identity, default_configuration(), vec![0; 2_048]);
    let mut board = board.expect("the default runs");
    let (mut decoder, mut sent) = (Decoder::<MAX_MESSAGE_BYTES>::new(), [0; TRANSMIT_BYTES]);
    for step in steps(script) {
        let first = step.bytes.first().copied().unwrap_or_default();
        let mut link = Link::Open;
        match step.operation % 8 {
            0 => drop(board.receive(step.bytes)),
            1 => drop(board.receive(&packet(step.bytes))),
            2 => sample(board.hardware_mut(), step.bytes),
            3 => board.hardware_mut().now += u64::from(first) << 14,
            4 => link = Link::Closed,
            5 => fail(board.hardware_mut(), first),
            6 => board.restore_head(step.bytes),
            _ => board.hardware_mut().storing_polls = first.into(),
        }
        board.poll(link);
        let is_acquiring = board.is_acquiring();
        let hardware = board.hardware_mut();
        let obeys = !std::mem::take(&mut hardware.refused_dark);
        assert!(is_acquiring || hardware.running.is_none() || !obeys, "lit without acquisition");
        if link == Link::Closed {
            continue;
        }
        let mut bytes = board.transmit(&mut sent);
        while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
            assert!(message.is_ok(), "the board sent {message:?}");
        }
    }
    // Whatever happened: hardware that obeys is dark when the host is gone for long.
    let hardware = board.hardware_mut();
    (hardware.refuse_dark, hardware.deaf_converters) = (0, false);
    for _ in 0..3 {
        board.hardware_mut().now += u64::from(default_configuration().schedule.tick_hz);
        board.poll(Link::Closed);
    }
    assert!(board.hardware_mut().running.is_none() && !board.is_acquiring(), "lit though the host is gone");
}

/// A frame for each byte, whose words are that byte.
fn sample(hardware: &mut Fake, words: &[u8]) {
    for &word in words {
        hardware.sample(1);
        if let Some(Finished::Scan(scan)) = hardware.finished.back_mut() {
            scan.lit_mut().fill([u16::from(word) << 8, u16::from(word) << 7]);
        }
    }
}

fn fail(hardware: &mut Fake, kind: u8) {
    match kind % 6 {
        0 => hardware.refuse_light = Some(HardwareFault::Converters),
        1 => hardware.refuse_dark = 1,
        2 => hardware.deaf_converters = true,
        3 => hardware.finished.push_back(Finished::Fault(HardwareFault::Converters)),
        4 => hardware.refuse_store = true,
        _ => hardware.overrun(kind.into()),
    }
}
