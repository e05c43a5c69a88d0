//! The host against a device that is a script: descriptors, and what it does with packets.

use super::*;
use crate::usb_wire::{self, FRAME_TICKS, Handshake, InAnswer, OutPacket};
use std::collections::VecDeque;

/// A CDC-ACM device as firmware usually makes them.
pub(super) const DEVICE: [u8; 18] = [18, 1, 0x10, 2, 0xef, 2, 1, 64, 0xc0, 0x16, 0xdd, 0x27, 0, 1, 1, 2, 3, 1];
#[rustfmt::skip]
pub(super) const CONFIGURATION: [u8; 75] = [
    9, 2, 75, 0, 2, 1, 0, 0x80, 50,
    8, 11, 0, 2, 2, 2, 0, 0,
    9, 4, 0, 0, 1, 2, 2, 0, 0,
    5, 0x24, 0, 0x10, 1,
    4, 0x24, 2, 2,
    5, 0x24, 6, 0, 1,
    5, 0x24, 1, 0, 1,
    7, 5, 0x81, 3, 8, 0, 16,
    9, 4, 1, 0, 2, 10, 0, 0, 0,
    7, 5, 0x02, 2, 64, 0, 0,
    7, 5, 0x82, 2, 64, 0, 0,
];

#[derive(Debug, Default, PartialEq)]
enum Ep0 {
    #[default]
    Idle,
    Stalled,
    DataIn(Vec<u8>),
    DataOut(Vec<u8>),
    StatusIn,
}

/// The device.
#[derive(Debug, Default)]
struct Script {
    device: Vec<u8>,
    configuration: Vec<u8>,
    mute: bool,
    unplugged: bool,
    /// Request code that is answered with STALL.
    refused: Option<u8>,
    address: u8,
    setup: [u8; 8],
    ep0: Ep0,
    ep0_toggle: bool,
    signals: Vec<BusSignal>,
    frames: usize,
    tokens: usize,
    line_coding: Vec<u8>,
    control_lines: Vec<u8>,
    to_host: VecDeque<Vec<u8>>,
    in_toggle: bool,
    out_toggle: bool,
    out_naks: usize,
    from_host: Vec<Vec<u8>>,
}

impl Script {
    fn new() -> Self {
        Self { device: DEVICE.to_vec(), configuration: CONFIGURATION.to_vec(), ..Self::default() }
    }

    fn answer(&mut self) -> Ep0 {
        let [request_type, request, index, kind, ..] = self.setup;
        if self.refused == Some(request) {
            return Ep0::Stalled;
        }
        let text = |text: &str| {
            let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
            [&[units.len() as u8 + 2, 3], &units[..]].concat()
        };
        let mut data = match (request_type, request, kind, index) {
            (0x80, 6, 1, 0) => self.device.clone(),
            (0x80, 6, 2, 0) => self.configuration.clone(),
            (0x80, 6, 3, 0) => vec![4, 3, 9, 4],
            (0x80, 6, 3, 1) => text("makers"),
            (0x80, 6, 3, 2) => text("a product whose name is longer than one packet can hold"),
            (0x80, 6, 3, 3) => text("№ 7"),
            (0x00, 5 | 9, ..) | (0x21, 0x22, ..) => return Ep0::StatusIn,
            (0x21, 0x20, ..) => return Ep0::DataOut(Vec::new()),
            _ => return Ep0::Stalled,
        };
        data.truncate(usize::from(u16::from_le_bytes([self.setup[6], self.setup[7]])));
        Ep0::DataIn(data)
    }

    fn finish(&mut self) {
        match self.setup[1] {
            5 => self.address = self.setup[2],
            9 => (self.in_toggle, self.out_toggle) = (false, false),
            0x22 => self.control_lines.push(self.setup[2]),
            _ => {}
        }
        self.ep0 = Ep0::Idle;
    }
}

impl FullSpeedDevice for Script {
    fn is_pulled_up(&self) -> bool {
        !self.unplugged
    }

    fn signal(&mut self, signal: BusSignal) {
        match signal {
            BusSignal::StartOfFrame(_) => self.frames += 1,
            signal => self.signals.push(signal),
        }
        if signal == BusSignal::ResetBegins {
            self.address = 0;
        }
    }

    fn token_in(&mut self, address: u8, endpoint: u8) -> InAnswer {
        self.tokens += 1;
        if address != self.address || self.mute {
            return InAnswer::Silence;
        }
        match (endpoint, &self.ep0) {
            (0, Ep0::DataIn(data)) => {
                InAnswer::Data { toggle: self.ep0_toggle, bytes: data[..data.len().min(64)].to_vec() }
            }
            (0, Ep0::StatusIn) => InAnswer::Data { toggle: true, bytes: Vec::new() },
            (0, Ep0::Stalled) => InAnswer::Stall,
            (2, _) => match self.to_host.front() {
                Some(bytes) => InAnswer::Data { toggle: self.in_toggle, bytes: bytes.clone() },
                None => InAnswer::Nak,
            },
            _ => InAnswer::Nak,
        }
    }

    fn acknowledged(&mut self, _: u8, endpoint: u8) {
        match (endpoint, &mut self.ep0) {
            (0, Ep0::DataIn(data)) => {
                drop(data.drain(..data.len().min(64)));
                self.ep0_toggle = !self.ep0_toggle;
            }
            (0, Ep0::StatusIn) => self.finish(),
            _ => {
                self.to_host.pop_front();
                self.in_toggle = !self.in_toggle;
            }
        }
    }

    fn packet_out(&mut self, packet: OutPacket<'_>) -> Handshake {
        if packet.address != self.address || self.mute {
            return Handshake::Silence;
        }
        if packet.setup {
            assert!(!packet.toggle, "SETUP goes with DATA0");
            self.setup.copy_from_slice(packet.bytes);
            self.ep0_toggle = true;
            self.ep0 = self.answer();
            return Handshake::Ack;
        }
        if packet.endpoint == 2 {
            if self.out_naks > 0 {
                self.out_naks -= 1;
                return Handshake::Nak;
            }
            assert_eq!(packet.toggle, self.out_toggle);
            self.out_toggle = !self.out_toggle;
            self.from_host.push(packet.bytes.to_vec());
            return Handshake::Ack;
        }
        match &mut self.ep0 {
            Ep0::DataOut(data) => {
                assert_eq!(packet.toggle, self.ep0_toggle);
                data.extend_from_slice(packet.bytes);
                self.line_coding = data.clone();
                self.ep0 = Ep0::StatusIn;
                Handshake::Ack
            }
            Ep0::DataIn(_) => {
                assert!(packet.toggle && packet.bytes.is_empty(), "the status stage is an empty DATA1");
                self.finish();
                Handshake::Ack
            }
            _ => Handshake::Stall,
        }
    }
}

fn run(host: &mut UsbHost, device: &mut Script, until: Ticks) {
    while host.next_event() <= until {
        let now = host.next_event();
        host.advance(now, device);
        assert!(host.next_event() > now, "time stands still at {now} in {:?}", host.port);
    }
}

/// Long enough for an enumeration.
pub(super) const SOON: Ticks = 250 * MS;

fn texts(host: &UsbHost) -> Vec<&str> {
    host.complaints().iter().map(|complaint| complaint.text.as_str()).collect()
}

fn configured() -> (UsbHost, Script) {
    let (mut host, mut device) = (UsbHost::new(), Script::new());
    run(&mut host, &mut device, SOON);
    assert_eq!(texts(&host), [""; 0]);
    assert!(host.is_configured());
    (host, device)
}

#[test]
fn a_serial_device_is_found_read_and_opened() {
    let (mut host, mut device) = (UsbHost::new(), Script::new());
    run(&mut host, &mut device, DEBOUNCE_TICKS + RESET_TICKS + RECOVERY_TICKS - 1);
    assert_eq!(device.signals, [BusSignal::ResetBegins, BusSignal::ResetEnds]);
    assert_eq!(device.tokens, 0);
    run(&mut host, &mut device, SOON);
    assert!(host.is_configured());
    let said = host.device();
    assert_eq!((said.device.as_slice(), said.configuration.as_slice()), (&DEVICE[..], &CONFIGURATION[..]));
    assert_eq!(said.manufacturer.as_deref(), Some("makers"));
    assert_eq!(said.product.as_deref(), Some("a product whose name is longer than one packet can hold"));
    assert_eq!(said.serial.as_deref(), Some("№ 7"));
    assert_eq!(device.line_coding, [0x00, 0xc2, 0x01, 0x00, 0, 0, 8]);
    assert!(device.control_lines.is_empty());
    let expected = (SOON - DEBOUNCE_TICKS - RESET_TICKS) / FRAME_TICKS;
    assert!(device.frames.abs_diff(expected as usize) <= 1, "{} frames, {expected} ms", device.frames);
}

#[test]
fn dtr_follows_the_port_and_survives_the_cable() {
    let (mut host, mut device) = configured();
    let mut now = SOON;
    for (dtr, lines) in [(true, vec![3]), (true, vec![3]), (false, vec![3, 0]), (true, vec![3, 0, 3])] {
        host.set_dtr(dtr, now);
        now += 5 * MS;
        run(&mut host, &mut device, now);
        assert_eq!(device.control_lines, lines);
        assert_eq!(host.dtr(), dtr);
    }
    host.detach(now);
    run(&mut host, &mut device, now);
    assert!(!host.is_configured() && !host.dtr());
    let frames = device.frames;
    now += 20 * MS;
    run(&mut host, &mut device, now);
    assert_eq!(device.frames, frames);
    host.attach(now);
    now += SOON;
    run(&mut host, &mut device, now);
    assert!(host.is_configured());
    assert_eq!(device.control_lines, [3, 0, 3, 3]);
    assert_eq!(texts(&host), [""; 0]);
}

#[test]
fn full_packets_come_nineteen_to_a_frame_in_order() {
    let (mut host, mut device) = configured();
    let begin = host.next_frame;
    run(&mut host, &mut device, begin - 1);
    device.to_host = (0..1_000_u32).map(|number| number.to_le_bytes().repeat(16)).collect();
    run(&mut host, &mut device, begin + 20 * FRAME_TICKS - 1);
    let received = host.take_received();
    let per_frame = received.len() as f64 / 20.0;
    assert!((18.5..=19.0).contains(&per_frame), "{per_frame} packets a frame");
    println!("{} B/s of full packets in one direction", per_frame * 64e3);
    for (number, packet) in received.iter().enumerate() {
        assert_eq!(packet.bytes, (number as u32).to_le_bytes().repeat(16));
    }
    assert!(received.is_sorted_by(|a, b| a.at + usb_wire::data_ticks(&[0; 64]) <= b.at));
}

#[test]
fn both_directions_share_the_wire_and_lose_nothing() {
    let (mut host, mut device) = configured();
    let sent: Vec<u8> = (0..10_000_u32).map(|i| ((i * i) >> 5) as u8).collect();
    device.to_host = (0..100).map(|i| vec![i; usize::from(i) % 65]).collect();
    device.out_naks = 50;
    host.send(&sent, SOON);
    run(&mut host, &mut device, SOON + 40 * MS);
    assert_eq!(host.unsent(), 0);
    assert_eq!(device.from_host.concat(), sent);
    let received: Vec<_> = host.take_received().into_iter().map(|packet| packet.bytes).collect();
    assert_eq!(received, (0..100).map(|i| vec![i; usize::from(i) % 65]).collect::<Vec<_>>());
}

#[test]
fn a_port_that_nobody_reads_asks_for_nothing() {
    let (mut host, mut device) = configured();
    host.stop_reading(true, SOON);
    run(&mut host, &mut device, SOON + MS);
    let (tokens, frames) = (device.tokens, device.frames);
    device.to_host.push_back(b"late".to_vec());
    run(&mut host, &mut device, SOON + 11 * MS);
    // The notification endpoint is asked every 16 ms.
    assert!(device.tokens - tokens <= 1);
    assert_eq!(device.frames - frames, 10);
    host.stop_reading(false, SOON + 11 * MS);
    run(&mut host, &mut device, SOON + 12 * MS);
    assert_eq!(host.take_received()[0].bytes, b"late");
}

#[test]
fn a_suspended_bus_is_silent_until_it_is_resumed() {
    let (mut host, mut device) = configured();
    host.suspend(SOON);
    run(&mut host, &mut device, SOON + MS);
    let (tokens, frames) = (device.tokens, device.frames);
    device.signals.clear();
    run(&mut host, &mut device, SOON + 50 * MS);
    assert_eq!((device.tokens, device.frames), (tokens, frames));
    device.to_host.push_back(b"awake".to_vec());
    host.resume(SOON + 50 * MS);
    run(&mut host, &mut device, SOON + 100 * MS);
    assert_eq!(device.signals, [BusSignal::ResumeBegins, BusSignal::ResumeEnds]);
    assert_eq!(host.take_received()[0].bytes, b"awake");
    assert!(host.is_configured());
    assert_eq!(texts(&host), [""; 0]);
}

#[test]
fn a_device_that_leaves_is_found_again() {
    let (mut host, mut device) = configured();
    (device.unplugged, device.mute) = (true, true);
    run(&mut host, &mut device, SOON + 5 * MS);
    assert!(!host.is_configured());
    (device.unplugged, device.mute) = (false, false);
    run(&mut host, &mut device, SOON + 5 * MS + SOON);
    assert!(host.is_configured());
    assert_eq!(texts(&host), [""; 0]);
}

#[test]
fn a_cable_pulled_during_the_reset_leaves_the_lines_at_rest() {
    let (mut host, mut device) = (UsbHost::new(), Script::new());
    let now = DEBOUNCE_TICKS + RESET_TICKS / 2;
    run(&mut host, &mut device, now);
    assert_eq!(device.signals, [BusSignal::ResetBegins]);
    host.detach(now);
    run(&mut host, &mut device, 2 * SOON);
    assert_eq!(device.signals, [BusSignal::ResetBegins, BusSignal::ResetEnds]);
    assert_eq!(device.frames, 0);
    // Out and in between two looks at the port is a new device all the same.
    host.attach(2 * SOON);
    run(&mut host, &mut device, 3 * SOON);
    host.detach(3 * SOON);
    host.attach(3 * SOON);
    run(&mut host, &mut device, 4 * SOON);
    assert!(host.is_configured());
    assert_eq!(device.signals.len(), 6);
}

#[test]
fn whoever_breaks_the_protocol_is_told() {
    let (mut host, mut device) = configured();
    device.in_toggle = true;
    device.to_host.push_back(vec![1; 10]);
    run(&mut host, &mut device, SOON + MS);
    assert_eq!(texts(&host), ["bulk IN: wrong data toggle, 10 bytes thrown away"]);
    device.to_host.push_back(vec![1; 65]);
    run(&mut host, &mut device, SOON + 2 * MS);
    assert_eq!(texts(&host)[1], "bulk IN: babble: 65 bytes where 64 are the most");
    assert!(host.take_received().is_empty());

    for (refused, name) in [(9, "SET_CONFIGURATION"), (0x20, "SET_LINE_CODING")] {
        let (mut host, mut device) = (UsbHost::new(), Script { refused: Some(refused), ..Script::new() });
        run(&mut host, &mut device, SOON);
        let stage = if refused == 9 { "status" } else { "data" };
        assert_eq!(texts(&host), [format!("{name}: STALL in the {stage} stage")]);
        assert!(!host.is_configured());
    }

    let (mut host, mut device) = (UsbHost::new(), Script { mute: true, ..Script::new() });
    run(&mut host, &mut device, SOON);
    assert_eq!(texts(&host), ["GET_DESCRIPTOR device: no answer in the setup stage"]);
}

#[test]
fn descriptors_that_disagree_are_told() {
    // Which descriptor, which byte, what it becomes, what is said.
    let faults: [(bool, usize, u8, &str); 17] = [
        (true, 3, 3, "bcdUSB is 0310"),
        (true, 4, 0, "device class [0, 2, 1]"),
        (true, 7, 60, "bMaxPacketSize0 is 60"),
        (true, 17, 0, "there is no configuration"),
        (false, 2, 74, "a descriptor of type 0x05 is 7 bytes long, 6 are left"),
        (false, 4, 3, "2 interfaces where bNumInterfaces is 3"),
        (false, 7, 0, "bmAttributes is 0x00"),
        (false, 8, 251, "bMaxPower asks for 502 mA"),
        (false, 12, 1, "interface association"),
        (false, 21, 2, "interface 0 has 1 endpoints"),
        (false, 34, 0, "does not know line coding"),
        (false, 39, 2, "the CDC union does not name both interfaces"),
        (false, 51, 0, "endpoint 0x81 of type 3"),
        (false, 54, 2, "interface 2 comes in place 1"),
        (false, 65, 63, "endpoint 0x02 of type 2 has packets of 63 bytes"),
        (false, 70, 0x02, "endpoint 0x02 is used twice"),
        (false, 57, 255, "no serial port"),
    ];
    for (in_device, position, value, text) in faults {
        let (mut host, mut device) = (UsbHost::new(), Script::new());
        let changed = if in_device { &mut device.device } else { &mut device.configuration };
        assert_ne!(changed[position], value);
        changed[position] = value;
        run(&mut host, &mut device, SOON);
        let said = texts(&host).join("; ");
        assert!(said.contains(text), "byte {position} = {value}: expected `{text}`, got `{said}`");
    }
}
