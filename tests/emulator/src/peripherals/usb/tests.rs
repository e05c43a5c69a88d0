use super::*;
use crate::facts::assert_facts;
use crate::usb_wire::{BusSignal, FullSpeedDevice, Handshake, InAnswer, OutPacket};

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

fn line(effects: &Effects) -> bool {
    effects.lines()[0] & 1 << interrupt::USB_LP != 0
}

fn run(usb: &mut Usb, effects: &mut Effects, until: Ticks) {
    while usb.next_event() <= until {
        effects.now = usb.next_event();
        usb.advance(effects);
    }
    effects.now = until;
}

#[test]
fn a_setup_packet_arrives_whatever_the_endpoint_says() {
    let (mut usb, mut effects) = running();
    // Reception is refused, transmission stalled.
    usb.write(0, CONTROL | 0b10 << 12 | 0b01 << 4, &mut effects);
    assert_eq!(usb.port(&mut effects).packet_out(packet(&[1; 8], false, true)), Handshake::Nak);
    assert!(!line(&effects));
    let setup = [0x80, 6, 0, 1, 0, 0, 8, 0];
    assert_eq!(usb.port(&mut effects).packet_out(packet(&setup, true, false)), Handshake::Ack);
    assert!(line(&effects));
    assert_eq!(usb.read(ISTR, &mut effects), ISTR_CTR | ISTR_DIR);
    assert_eq!(usb.read_memory(64, 4, &mut effects), 0x0100_0680);
    assert_eq!(usb.read_memory(6, 2, &mut effects) & 0x3ff, 8);
    // The next one is not heard before this one has been seen.
    assert_eq!(usb.port(&mut effects).packet_out(packet(&setup, true, false)), Handshake::Silence);
    usb.write(0, CONTROL | 1 << 7, &mut effects);
    assert!(!line(&effects));
    assert_eq!(usb.port(&mut effects).packet_out(packet(&setup, true, false)), Handshake::Ack);
}

#[test]
fn data_leave_with_alternating_toggles_once_for_each_validation() {
    let (mut usb, mut effects) = running();
    usb.write(0, CONTROL | 0b10 << 4, &mut effects);
    for toggle in [false, true, false] {
        assert_eq!(usb.port(&mut effects).token_in(0, 0), InAnswer::Nak);
        usb.write_memory(128, 2, 0x2211, &mut effects);
        usb.write_memory(130, 1, 0x33, &mut effects);
        usb.write_memory(2, 2, 3, &mut effects);
        usb.write(0, CONTROL | 1 << 15 | 1 << 7 | 0b01 << 4, &mut effects);
        let answer = InAnswer::Data { toggle, bytes: vec![0x11, 0x22, 0x33] };
        // Unacknowledged, it is sent again.
        assert_eq!(usb.port(&mut effects).token_in(0, 0), answer);
        assert_eq!(usb.port(&mut effects).token_in(0, 0), answer);
        usb.port(&mut effects).acknowledged(0, 0);
        assert_eq!(usb.read(ISTR, &mut effects), ISTR_CTR);
        usb.write(0, CONTROL | 1 << 15, &mut effects);
    }
    assert_eq!(effects.violation_count(), 0);
}

#[test]
fn a_repeated_packet_is_acknowledged_and_ignored() {
    let (mut usb, mut effects) = running();
    usb.write(0, CONTROL | 0b11 << 12, &mut effects);
    assert_eq!(usb.port(&mut effects).packet_out(packet(b"first", false, false)), Handshake::Ack);
    usb.write(0, CONTROL | 1 << 7 | 0b01 << 12, &mut effects);
    assert_eq!(usb.port(&mut effects).packet_out(packet(b"again", false, false)), Handshake::Ack);
    assert_eq!(usb.read(ISTR, &mut effects) & ISTR_CTR, 0);
    assert_eq!(usb.port(&mut effects).packet_out(packet(b"after", false, true)), Handshake::Ack);
    assert_eq!(usb.read_memory(64, 1, &mut effects), u32::from(b'a'));
    // More than the buffer holds is not acknowledged.
    usb.write(0, CONTROL | 1 << 7 | 0b01 << 12, &mut effects);
    assert_eq!(usb.port(&mut effects).packet_out(packet(&[0; 65], false, false)), Handshake::Silence);
}

#[test]
fn other_addresses_and_endpoints_hear_nothing() {
    let (mut usb, mut effects) = running();
    usb.write(0, CONTROL | 0b11 << 12 | 0b11 << 4, &mut effects);
    assert_eq!(usb.port(&mut effects).token_in(1, 0), InAnswer::Silence);
    assert_eq!(usb.port(&mut effects).token_in(0, 1), InAnswer::Silence);
    usb.write(DADDR, DADDR_EF | 9, &mut effects);
    assert_eq!(usb.port(&mut effects).token_in(0, 0), InAnswer::Silence);
    assert_ne!(usb.port(&mut effects).token_in(9, 0), InAnswer::Silence);
    usb.write(DADDR, 9, &mut effects);
    assert_eq!(usb.port(&mut effects).token_in(9, 0), InAnswer::Silence);
}

#[test]
fn silence_means_suspension_after_three_milliseconds() {
    let (mut usb, mut effects) = running();
    let begin = effects.now();
    for frame in 0..10 {
        effects.now = begin + u64::from(frame) * FRAME_TICKS;
        usb.port(&mut effects).signal(BusSignal::StartOfFrame(frame));
        run(&mut usb, &mut effects, begin + u64::from(frame + 1) * FRAME_TICKS - 1);
    }
    assert_eq!(usb.read(ISTR, &mut effects), ISTR_SOF);
    assert_eq!(usb.read(FNR, &mut effects), FNR_RXDP | FNR_LCK | 9);
    usb.write(ISTR, 0, &mut effects);
    let last = begin + 9 * FRAME_TICKS;
    run(&mut usb, &mut effects, last + 5 * FRAME_TICKS / 2);
    assert_eq!(usb.read(ISTR, &mut effects), ISTR_ESOF);
    run(&mut usb, &mut effects, last + 7 * FRAME_TICKS / 2);
    assert_eq!(usb.read(ISTR, &mut effects), ISTR_ESOF | ISTR_SUSP);
    usb.write(CNTR, RUNNING | CNTR_FSUSP | CNTR_LPMODE, &mut effects);
    usb.write(ISTR, 0, &mut effects);
    assert!(!line(&effects));
    assert_eq!(usb.next_event(), Ticks::MAX);
    usb.port(&mut effects).signal(BusSignal::ResumeBegins);
    assert_eq!(usb.read(ISTR, &mut effects), ISTR_WKUP);
    assert_eq!(usb.read(CNTR, &mut effects), RUNNING | CNTR_FSUSP);
}

#[test]
fn a_bus_reset_forgets_address_and_endpoints() {
    let (mut usb, mut effects) = running();
    usb.write(0, CONTROL | 0b11 << 12 | 0b11 << 4, &mut effects);
    usb.write(4, 1, &mut effects);
    usb.port(&mut effects).signal(BusSignal::ResetBegins);
    assert!(line(&effects));
    assert_eq!(usb.read(ISTR, &mut effects), ISTR_RESET);
    assert_eq!((usb.read(0, &mut effects), usb.read(4, &mut effects), usb.read(DADDR, &mut effects)), (0, 0, 0));
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

#[test]
fn registers_are_those_of_st() {
    assert_facts!("USB_TypeDef."; CNTR, ISTR, FNR, DADDR, BTABLE, LPMCSR, BCDR);
    assert_facts!("USB_"; CNTR_FRES, CNTR_PDWN, CNTR_LPMODE, CNTR_FSUSP, ISTR_DIR, ISTR_ESOF, ISTR_SOF, ISTR_RESET);
    assert_facts!("USB_"; ISTR_SUSP, ISTR_WKUP, ISTR_CTR, FNR_FRAME = "FNR_FN", FNR_LSOF, FNR_LCK, FNR_RXDP);
    assert_facts!("USB_"; DADDR_EF, BCDR_DPPU);
}
