//! The host against a device that is a script: descriptors, and what it does with packets.

use super::*;

/// A CDC-ACM device as firmware usually makes them.
const DEVICE: [u8; 18] = [18, 1, 0x10, 2, 0xef, 2, 1, 64, 0xc0, 0x16, 0xdd, 0x27, 0, 1, 1, 2, 3, 1];
#[rustfmt::skip]
const CONFIGURATION: [u8; 75] = [
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
    DataOut,
    StatusIn,
}

#[derive(Debug, Default)]
struct Script {
    mute: bool,
    /// Request code that is answered with STALL.
    refused: Option<u8>,
    address: u8,
    setup: [u8; 8],
    ep0: Ep0,
    ep0_toggle: bool,
    signals: Vec<BusSignal>,
    frames: usize,
    to_host: VecDeque<Vec<u8>>,
    in_toggle: bool,
}

impl Script {
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
            (0x80, 6, 1, 0) => DEVICE.to_vec(),
            (0x80, 6, 2, 0) => CONFIGURATION.to_vec(),
            (0x80, 6, 3, 0) => vec![4, 3, 9, 4],
            (0x80, 6, 3, 1) => text("makers"),
            (0x80, 6, 3, _) => text("a product whose name is longer than one packet can hold"),
            (0x00, 5 | 9, ..) | (0x21, 0x22, ..) => return Ep0::StatusIn,
            (0x21, 0x20, ..) => return Ep0::DataOut,
            _ => return Ep0::Stalled,
        };
        data.truncate(usize::from(u16::from_le_bytes([self.setup[6], self.setup[7]])));
        Ep0::DataIn(data)
    }

    fn finish(&mut self) {
        match self.setup[1] {
            5 => self.address = self.setup[2],
            9 => self.in_toggle = false,
            _ => {}
        }
        self.ep0 = Ep0::Idle;
    }
}

impl FullSpeedDevice for Script {
    fn is_pulled_up(&self) -> bool {
        true
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

    fn token_in(&mut self, address: u8, endpoint: u8) -> Answer {
        if address != self.address || self.mute {
            return Answer::Silence;
        }
        match (endpoint, &self.ep0) {
            (0, Ep0::DataIn(data)) => {
                Answer::Data { toggle: self.ep0_toggle, bytes: data[..data.len().min(64)].to_vec() }
            }
            (0, Ep0::StatusIn) => Answer::Data { toggle: true, bytes: Vec::new() },
            (0, Ep0::Stalled) => Answer::Stall,
            (2, _) => match self.to_host.front() {
                Some(bytes) => Answer::Data { toggle: self.in_toggle, bytes: bytes.clone() },
                None => Answer::Nak,
            },
            _ => Answer::Nak,
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

    fn packet_out(&mut self, packet: OutPacket<'_>) -> Answer {
        if packet.address != self.address || self.mute {
            return Answer::Silence;
        }
        if packet.setup {
            assert!(!packet.toggle, "SETUP goes with DATA0");
            self.setup.copy_from_slice(packet.bytes);
            self.ep0_toggle = true;
            self.ep0 = self.answer();
            return Answer::Ack;
        }
        match &mut self.ep0 {
            Ep0::DataOut => {
                assert_eq!(packet.toggle, self.ep0_toggle);
                self.ep0 = Ep0::StatusIn;
                Answer::Ack
            }
            Ep0::DataIn(_) => {
                assert!(packet.toggle && packet.bytes.is_empty(), "the status stage is an empty DATA1");
                self.finish();
                Answer::Ack
            }
            _ => Answer::Stall,
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
const SOON: Ticks = 250 * MS;

fn texts(host: &UsbHost) -> Vec<&str> {
    host.complaints().iter().map(|complaint| complaint.text.as_str()).collect()
}

fn configured() -> (UsbHost, Script) {
    let (mut host, mut device) = (UsbHost::new(), Script::default());
    run(&mut host, &mut device, SOON);
    assert_eq!(texts(&host), [""; 0]);
    assert!(host.is_configured());
    (host, device)
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
fn a_cable_pulled_during_the_reset_leaves_the_lines_at_rest() {
    let (mut host, mut device) = (UsbHost::new(), Script::default());
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
        let (mut host, mut device) = (UsbHost::new(), Script { refused: Some(refused), ..Script::default() });
        run(&mut host, &mut device, SOON);
        let stage = if refused == 9 { "status" } else { "data" };
        assert_eq!(texts(&host), [format!("{name}: STALL in the {stage} stage")]);
        assert!(!host.is_configured());
    }

    let (mut host, mut device) = (UsbHost::new(), Script { mute: true, ..Script::default() });
    run(&mut host, &mut device, SOON);
    assert_eq!(texts(&host), ["GET_DESCRIPTOR device: no answer in the setup stage"]);
}
