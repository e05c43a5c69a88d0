//! The board's image behind a USB port whose host is hostile.

use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};

use slitpose_emulator::faults::Faults;
use slitpose_emulator::image::Image;
use slitpose_emulator::machine::{Reset, Stop};
use slitpose_emulator::peripherals::{ResetCause, TICKS_PER_SECOND, Ticks, UsbPort};
use slitpose_emulator::rig::{Rig, open_image};
use slitpose_emulator::usb_wire::{Answer, BusSignal, FRAME_TICKS, MAX_PACKET_BYTES, OutPacket, data_ticks};
use slitpose_emulator::world::Dark;
use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message};

use crate::wire::steps;

/// Most steps of a script: eight seconds of the board's time, if all of them wait for long. It may take hundreds to meet the
/// driver between two of its accesses.
const MAX_STEPS: usize = 512;

/// Steps between two lines on stderr: runs differ by a thousand times.
const STEPS_TOLD: u64 = 1_000_000;

/// Until a host of good will hears a hello: debouncing, reset and recovery take 160 ms (USB 2.0, 7.1.7), what the driver has
/// missed is seen within 100, requests and the board's answers take the rest.
const RECOVERED: Ticks = TICKS_PER_SECOND / 2;

/// Operations from this number on send SETUP packets of any length.
const ANY_LENGTH: u8 = 0xf8;

/// Packets and tokens that one stage of a transfer takes at most: a device that is not ready answers NAK some dozen times.
const MAX_TRIES: usize = 64;

/// Runs the script against the image that `firmware/build` made last: packets in and out of turn, resets of the bus,
/// silence. The core never stops, no emitter is lit by it, and a host of good will finds the board afterwards and hears its
/// hello. The board may restart: embassy-stm32's driver loops without end on a SETUP that has not eight bytes, which the
/// watchdog ends, and panics at a request for an endpoint beyond the seventh.
pub(crate) fn hostile_host(script: &[u8]) {
    static IMAGE: LazyLock<Image> = LazyLock::new(|| open_image(None).unwrap_or_else(|error| panic!("{error}")));
    static STEPS: AtomicU64 = AtomicU64::new(0);
    let mut host = Hostile::plugged_in(&IMAGE);
    for step in steps(script).take(MAX_STEPS) {
        host.act(step.operation, step.bytes);
        let taken = STEPS.fetch_add(1, Ordering::Relaxed) + 1;
        if taken.is_multiple_of(STEPS_TOLD) {
            eprintln!("{taken} steps");
        }
    }
    host.leave();
}

struct Hostile {
    rig: Rig<Dark>,
    /// What the device was told and has acknowledged.
    address: u8,
    next_frame: Ticks,
    frame: u16,
    /// No start of frame is sent before this.
    silent_until: Ticks,
}

impl Hostile {
    fn plugged_in(image: &Image) -> Self {
        let mut rig = Rig::power_on(image, Dark, Faults::default());
        rig.set_cable(false);
        let mut host = Self { rig, address: 0, next_frame: 0, frame: 0, silent_until: 0 };
        host.wait(TICKS_PER_SECOND / 100);
        assert!(host.device(|device| device.is_pulled_up()), "no pull-up after start");
        host.reset_bus();
        host
    }

    fn device<T>(&mut self, act: impl FnOnce(&mut UsbPort<'_>) -> T) -> T {
        let board = &mut self.rig.machine().board;
        let result = act(&mut board.usb.port(&mut board.effects));
        board.outside_changed();
        result
    }

    /// Lets the board run, with a start of frame each millisecond.
    fn wait(&mut self, ticks: Ticks) {
        let end = self.rig.now() + ticks;
        loop {
            let next = self.next_frame.max(self.silent_until).min(end);
            let stop = self.rig.run_until(next);
            assert_eq!(stop, Stop::Reached, "the core stopped");
            if next == end {
                break;
            }
            self.frame = (self.frame + 1) % 2048;
            let frame = self.frame;
            self.device(|device| device.signal(BusSignal::StartOfFrame(frame)));
            self.next_frame = next + FRAME_TICKS;
        }
        let board = &self.rig.machine().board;
        assert_eq!(board.gates(), 0, "lit without a command");
    }

    fn reset_bus(&mut self) {
        self.device(|device| device.signal(BusSignal::ResetBegins));
        let held = TICKS_PER_SECOND / 100;
        self.silent_until = self.rig.now() + held;
        self.wait(held);
        self.device(|device| device.signal(BusSignal::ResetEnds));
        self.address = 0;
        self.wait(FRAME_TICKS);
    }

    fn put(&mut self, endpoint: u8, setup: bool, toggle: bool, bytes: &[u8]) -> Answer {
        let bytes = &bytes[..bytes.len().min(MAX_PACKET_BYTES)];
        self.wait(data_ticks(bytes));
        let address = self.address;
        self.device(|device| device.packet_out(OutPacket { address, endpoint, setup, toggle, bytes }))
    }

    /// Asks for data. The device sends data that are not acknowledged again.
    fn get(&mut self, endpoint: u8, acknowledges: bool) -> Answer {
        let address = self.address;
        let answer = self.device(|device| device.token_in(address, endpoint));
        if let Answer::Data { bytes, .. } = &answer {
            assert!(bytes.len() <= MAX_PACKET_BYTES, "a packet of {} bytes", bytes.len());
            self.wait(data_ticks(bytes));
            if acknowledges {
                self.device(|device| device.acknowledged(address, endpoint));
            }
        } else {
            self.wait(data_ticks(&[]));
        }
        answer
    }

    fn act(&mut self, operation: u8, bytes: &[u8]) {
        // Eight bytes, for nearly all operations: one SETUP of another length costs the time of a thousand packets, until the
        // watchdog ends the loop of the driver.
        let request = |bytes: &[u8]| {
            let mut request = bytes.to_vec();
            if operation < ANY_LENGTH {
                request.resize(8, 0);
            }
            request
        };
        let (first, rest) = bytes.split_first().map_or((0, bytes), |(&first, rest)| (first, rest));
        let endpoint = first & 0x0f;
        match operation % 8 {
            0 => drop(self.put(0, true, false, &request(bytes))),
            1 => drop(self.get(endpoint, first & 0x10 == 0)),
            2 if first & 0x20 != 0 => drop(self.put(endpoint, true, first & 0x10 != 0, &request(rest))),
            2 => drop(self.put(endpoint, false, first & 0x10 != 0, rest)),
            3 => self.wait(Ticks::from(first) * (FRAME_TICKS / 32)),
            4 => self.reset_bus(),
            5 => {
                // Without frames the bus is suspended after 3 ms.
                let silence = Ticks::from(first) * (FRAME_TICKS / 16);
                self.silent_until = self.rig.now() + silence;
                self.wait(silence);
                self.device(|device| device.signal(BusSignal::ResumeBegins));
                self.wait(FRAME_TICKS);
                self.device(|device| device.signal(BusSignal::ResumeEnds));
            }
            6 => self.address = first & 0x7f,
            _ => self.transfer(bytes),
        }
    }

    /// A control transfer in order: eight bytes of request, and what the data stage sends to the device.
    fn transfer(&mut self, bytes: &[u8]) {
        let mut request = [0; 8];
        let (head, mut data) = bytes.split_at(bytes.len().min(8));
        request[..head.len()].copy_from_slice(head);
        if self.put(0, true, false, &request) != Answer::Ack {
            return;
        }
        let length = usize::from(u16::from_le_bytes([request[6], request[7]]));
        if request[0] & 0x80 != 0 && length > 0 {
            // A short packet is the last.
            let mut packets = (0..length.div_ceil(MAX_PACKET_BYTES)).map(|_| self.get_when_ready());
            packets.find(|packet| packet.as_ref().is_none_or(|bytes| bytes.len() < MAX_PACKET_BYTES));
            self.put_when_ready(true, &[]);
            return;
        }
        let mut toggle = true;
        for _ in 0..length.div_ceil(MAX_PACKET_BYTES) {
            let (packet, left) = data.split_at(data.len().min(MAX_PACKET_BYTES));
            if !self.put_when_ready(toggle, packet) {
                return;
            }
            (data, toggle) = (left, !toggle);
            if packet.len() < MAX_PACKET_BYTES {
                break;
            }
        }
        // SET_ADDRESS takes effect behind the status stage (USB 2.0, 9.4.6).
        if self.get_when_ready().is_some() && request[..2] == [0, 5] {
            self.address = request[2] & 0x7f;
        }
    }

    /// Data of endpoint 0 as soon as it has some; `None` if it has none, or takes too long.
    fn get_when_ready(&mut self) -> Option<Vec<u8>> {
        (0..MAX_TRIES).map(|_| self.get(0, true)).find(|answer| *answer != Answer::Nak).and_then(
            |answer| match answer {
                Answer::Data { bytes, .. } => Some(bytes),
                Answer::Ack | Answer::Nak | Answer::Stall | Answer::Silence => None,
            },
        )
    }

    /// Data to endpoint 0 as soon as it has room; whether it took them.
    fn put_when_ready(&mut self, toggle: bool, bytes: &[u8]) -> bool {
        let answer = (0..MAX_TRIES).map(|_| self.put(0, false, toggle, bytes)).find(|answer| *answer != Answer::Nak);
        answer == Some(Answer::Ack)
    }

    /// The cable goes to a host of good will.
    fn leave(mut self) {
        let from = self.rig.now();
        self.rig.set_cable(true);
        self.rig.set_open(true);
        let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
        let mut has_hello = false;
        while !has_hello && self.rig.now() < from + RECOVERED {
            assert_eq!(self.rig.run_for(1e-3), Stop::Reached, "the core stopped");
            let heard = self.rig.take_bytes();
            let mut heard = heard.as_slice();
            while let Some(message) = decoder.next::<Message<'_>>(&mut heard) {
                has_hello |= matches!(message, Ok(Message::Hello(_)));
            }
        }
        let machine = self.rig.machine();
        let complaints = machine.board.usb_host.complaints();
        assert!(has_hello, "no hello after {:?}", complaints);
        assert!(complaints.is_empty(), "{complaints:?}");
        assert_eq!(machine.board.gates(), 0, "lit without a command");
        let resets = &machine.resets()[1..];
        let restarts = |reset: &Reset| matches!(reset.cause, ResetCause::Watchdog | ResetCause::Software);
        assert!(resets.iter().all(restarts), "reset: {resets:?}");
        let faults = self.rig.faults();
        assert!(faults.is_empty(), "{faults:?}");
    }
}
