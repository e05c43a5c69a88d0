use super::*;
use crate::usb_wire::{Answer, BusSignal, OutPacket};

const CONTROL: u32 = 0b01 << 9;
const RUNNING: u32 = 0xbf00;

/// Powered, clocked and out of reset as the manual asks for, after a bus reset, at address 0.
fn running() -> (Usb, Effects) {
    let (mut usb, mut effects) = (Usb::new(), Effects::default());
    usb.set_clock(true, &mut effects);
    usb.write(CNTR, CNTR_FRES, &mut effects);
    effects.now += STARTUP_TICKS;
    usb.write(CNTR, RUNNING, &mut effects);
    usb.write(BCDR, BCDR_DPPU, &mut effects);
    usb.port(&mut effects).signal(BusSignal::ResetBegins);
    usb.port(&mut effects).signal(BusSignal::ResetEnds);
    usb.write(ISTR, 0, &mut effects);
    usb.write(DADDR, DADDR_EF, &mut effects);
    // Endpoint 0: 8 bytes out at 64 + 0, 64 bytes in at 128.
    usb.write_memory(0, 2, 128, &mut effects);
    usb.write_memory(4, 2, 64, &mut effects);
    usb.write_memory(6, 2, 1 << 15 | 1 << 10, &mut effects);
    assert_eq!(effects.violation_count(), 0);
    (usb, effects)
}

fn packet(bytes: &[u8], setup: bool, toggle: bool) -> OutPacket<'_> {
    OutPacket { address: 0, endpoint: 0, setup, toggle, bytes }
}

#[test]
fn a_repeated_packet_is_acknowledged_and_ignored() {
    let (mut usb, mut effects) = running();
    usb.write(0, CONTROL | 0b11 << 12, &mut effects);
    assert_eq!(usb.port(&mut effects).packet_out(packet(b"first", false, false)), Answer::Ack);
    usb.write(0, CONTROL | 1 << 7 | 0b01 << 12, &mut effects);
    assert_eq!(usb.port(&mut effects).packet_out(packet(b"again", false, false)), Answer::Ack);
    assert_eq!(usb.read(ISTR, &mut effects) & ISTR_CTR, 0);
    assert_eq!(usb.port(&mut effects).packet_out(packet(b"after", false, true)), Answer::Ack);
    assert_eq!(usb.read_memory(64, 1, &mut effects), u32::from(b'a'));
    // More than the buffer holds is not acknowledged.
    usb.write(0, CONTROL | 1 << 7 | 0b01 << 12, &mut effects);
    assert_eq!(usb.port(&mut effects).packet_out(packet(&[0; 65], false, false)), Answer::Silence);
}

#[test]
fn rules_are_watched() {
    let (mut usb, mut effects) = (Usb::new(), Effects::default());
    let mut count = 0;
    let mut broken = |effects: &Effects, rule: &str| {
        count += 1;
        assert_eq!(effects.violation_count(), count, "{rule}: {:?}", effects.violations().last());
        assert!(effects.violations()[count as usize - 1].rule.contains(rule), "{:?}", effects.violations().last());
    };
    usb.write(0, CONTROL, &mut effects);
    broken(&effects, "held in reset");
    usb.write(DADDR, DADDR_EF, &mut effects);
    broken(&effects, "held in reset");
    usb.set_clock(true, &mut effects);
    usb.write(CNTR, CNTR_FRES, &mut effects);
    usb.write(CNTR, 0, &mut effects);
    broken(&effects, "start-up time");
    usb.write(CNTR, CNTR_FRES, &mut effects);
    effects.now += STARTUP_TICKS;
    usb.set_clock(false, &mut effects);
    usb.write(CNTR, 0, &mut effects);
    broken(&effects, "without the 48 MHz clock");
    usb.set_clock(true, &mut effects);
    usb.set_clock(false, &mut effects);
    broken(&effects, "stopped");

    let (mut usb, mut effects) = running();
    count = 0;
    let mut broken = |effects: &Effects, rule: &str| {
        count += 1;
        assert_eq!(effects.violation_count(), count, "{rule}: {:?}", effects.violations());
        assert!(effects.violations()[count as usize - 1].rule.contains(rule), "{:?}", effects.violations().last());
    };
    // Transmission from the reception buffer of the same endpoint is its own business; from the
    // buffer table it is not.
    usb.write_memory(2, 2, 8, &mut effects);
    usb.write_memory(0, 2, 0, &mut effects);
    usb.write(0, CONTROL | 0b11 << 12 | 0b11 << 4, &mut effects);
    broken(&effects, "buffer table");
    usb.write_memory(64, 2, 1, &mut effects);
    broken(&effects, "receive into it");
    usb.read_memory(64, 2, &mut effects);
    broken(&effects, "receive into it");
    usb.write_memory(2, 2, 1, &mut effects);
    broken(&effects, "may send it");
    usb.write(BTABLE, 512, &mut effects);
    broken(&effects, "BTABLE");
}
