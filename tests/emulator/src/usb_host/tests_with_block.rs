//! The host against the USB block of the microcontroller, with a small driver over its registers.

use super::tests::{CONFIGURATION, DEVICE, SOON};
use super::*;
use crate::peripherals::usb::Usb;
use crate::peripherals::{Effects, interrupt};

const CNTR: u32 = 0x40;
const ISTR: u32 = 0x44;
const DADDR: u32 = 0x4c;
const BCDR: u32 = 0x58;

const RESET: u32 = 1 << 10;
const SUSPEND: u32 = 1 << 11;
const WAKE_UP: u32 = 1 << 12;
const CONTROL: u32 = 0b01 << 9;
const INTERRUPT: u32 = 0b11 << 9;

const DISABLED: u32 = 0;
const NAK: u32 = 0b10;
const VALID: u32 = 0b11;

/// Buffers of 64 bytes behind the table of three entries.
const TX_BUFFER: [u32; 3] = [64, 192, 256];
const RX_BUFFER: [u32; 3] = [128, 0, 320];

/// The driver: enumerates, and sends back what it receives.
#[derive(Debug)]
struct Driver {
    usb: Usb,
    effects: Effects,
    /// Of the control transfer.
    reply: VecDeque<Vec<u8>>,
    address: Option<u8>,
    dtr: bool,
    echo: VecDeque<Vec<u8>>,
    suspensions: u32,
}

impl Driver {
    fn new() -> Self {
        let (usb, effects) = (Usb::new(), Effects::default());
        let mut driver = Self {
            usb,
            effects,
            reply: VecDeque::new(),
            address: None,
            dtr: false,
            echo: VecDeque::new(),
            suspensions: 0,
        };
        driver.usb.set_clock(true, &mut driver.effects);
        driver.write(CNTR, 1);
        driver.effects.now += 170;
        for (index, (tx, rx)) in TX_BUFFER.into_iter().zip(RX_BUFFER).enumerate() {
            let entry = 8 * index as u32;
            driver.usb.write_memory(entry, 2, tx, &mut driver.effects);
            driver.usb.write_memory(entry + 4, 4, rx | (0x8000 | 1 << 10) << 16, &mut driver.effects);
        }
        driver.write(ISTR, 0);
        driver.write(CNTR, 1 << 15 | WAKE_UP | SUSPEND | RESET);
        driver.write(BCDR, 1 << 15);
        driver
    }

    fn write(&mut self, offset: u32, value: u32) {
        self.usb.write(offset, value, &mut self.effects);
    }

    fn read(&mut self, offset: u32) -> u32 {
        self.usb.read(offset, &mut self.effects)
    }

    /// Brings an endpoint into a state by inverting what differs.
    fn set(&mut self, index: u32, kind: u32, rx: u32, tx: u32) {
        let now = self.read(4 * index);
        let toggles = (now ^ (rx << 12 | tx << 4)) & 0x3030;
        self.write(4 * index, 0x8080 | kind | index | toggles);
    }

    fn rx(&mut self, index: u32) -> u32 {
        self.read(4 * index) >> 12 & 3
    }

    fn send(&mut self, index: u32, kind: u32, bytes: &[u8]) {
        for (i, &byte) in bytes.iter().enumerate() {
            let offset = TX_BUFFER[index as usize] + i as u32;
            self.usb.write_memory(offset, 1, u32::from(byte), &mut self.effects);
        }
        self.usb.write_memory(8 * index + 2, 2, bytes.len() as u32, &mut self.effects);
        let rx = self.rx(index);
        self.set(index, kind, rx, VALID);
    }

    fn receive(&mut self, index: u32) -> Vec<u8> {
        let len = self.usb.read_memory(8 * index + 6, 2, &mut self.effects) & 0x3ff;
        let start = RX_BUFFER[index as usize];
        (start..start + len).map(|offset| self.usb.read_memory(offset, 1, &mut self.effects) as u8).collect()
    }

    /// Serves interrupts until there are none.
    fn serve(&mut self) {
        while self.effects.lines()[0] & 1 << interrupt::USB_LP != 0 {
            let status = self.read(ISTR);
            self.write(ISTR, !(status & (RESET | SUSPEND | WAKE_UP)));
            if status & SUSPEND != 0 {
                self.suspensions += 1;
                self.write(CNTR, 1 << 15 | WAKE_UP | SUSPEND | RESET | 1 << 3);
            }
            if status & WAKE_UP != 0 {
                self.write(CNTR, 1 << 15 | WAKE_UP | SUSPEND | RESET);
            }
            if status & RESET != 0 {
                self.write(DADDR, 0x80);
                self.set(0, CONTROL, NAK, NAK);
                self.set(1, INTERRUPT, DISABLED, NAK);
                self.set(2, 0, VALID, NAK);
            }
            if status & 1 << 15 != 0 {
                self.completed(status & 0xf);
            }
        }
    }

    fn completed(&mut self, index: u32) {
        let endpoint = self.read(4 * index);
        let kind = endpoint & 0x0600;
        // Zero clears the flag that was seen, ones keep the other.
        self.write(4 * index, kind | index | (!endpoint & 0x8080));
        if endpoint & 1 << 15 != 0 {
            let bytes = self.receive(index);
            match (index, endpoint & 1 << 11 != 0) {
                (0, true) => self.request(bytes.as_slice()),
                // The status stage of a transfer to the host is empty; line coding is not.
                (0, false) if !bytes.is_empty() => self.send(0, CONTROL, &[]),
                (0, false) => {}
                _ => {
                    self.echo.push_back(bytes);
                    let tx = self.read(8) >> 4 & 3;
                    self.set(2, 0, VALID, tx);
                }
            }
        }
        if endpoint & 1 << 7 != 0 && index == 0 {
            if let Some(address) = self.address.take() {
                self.write(DADDR, 0x80 | u32::from(address));
            }
            match self.reply.pop_front() {
                Some(packet) => self.send(0, CONTROL, &packet),
                None => self.set(0, CONTROL, VALID, NAK),
            }
        }
        if self.read(8) >> 4 & 3 == NAK
            && let Some(bytes) = self.echo.pop_front()
        {
            self.send(2, 0, &bytes);
        }
    }

    fn request(&mut self, setup: &[u8]) {
        let data: &[u8] = match (setup[1], setup[3]) {
            (6, 1) => &DEVICE,
            (6, 2) => &CONFIGURATION,
            (6, 3) if setup[2] == 0 => &[4, 3, 9, 4],
            (6, 3) => &[4, 3, b'x', 0],
            (0x20, _) => return self.set(0, CONTROL, VALID, NAK),
            (request, _) => {
                self.dtr |= request == 0x22;
                self.address = (request == 5).then_some(setup[2]);
                return self.send(0, CONTROL, &[]);
            }
        };
        let len = data.len().min(usize::from(setup[6]));
        self.reply = data[..len].chunks(64).map(<[u8]>::to_vec).collect();
        let first = self.reply.pop_front().unwrap();
        self.send(0, CONTROL, &first);
    }
}

fn run(host: &mut UsbHost, driver: &mut Driver, until: Ticks) {
    loop {
        let now = host.next_event().min(driver.usb.next_event());
        if now > until {
            return;
        }
        driver.effects.now = now.max(driver.effects.now);
        if driver.usb.next_event() <= now {
            driver.usb.advance(&mut driver.effects);
        }
        host.advance(now, &mut driver.usb.port(&mut driver.effects));
        driver.serve();
    }
}

#[test]
fn the_block_enumerates_sleeps_and_echoes() {
    let (mut host, mut driver) = (UsbHost::new(), Driver::new());
    host.set_dtr(true, 0);
    run(&mut host, &mut driver, SOON);
    assert_eq!(host.complaints(), []);
    assert!(host.is_configured() && host.dtr() && driver.dtr);
    // The bus was silent before the host had looked at the port for long enough.
    assert_eq!(driver.suspensions, 1);
    assert_eq!(host.device().configuration, CONFIGURATION);

    let bytes: Vec<u8> = (0..5_000_u32).map(|i| ((i * i) >> 3) as u8).collect();
    host.send(&bytes, SOON);
    run(&mut host, &mut driver, SOON + 20 * MS);
    let echo = |host: &mut UsbHost| -> Vec<u8> { host.take_received().into_iter().flat_map(|it| it.bytes).collect() };
    assert_eq!(echo(&mut host), bytes);

    host.suspend(SOON + 20 * MS);
    run(&mut host, &mut driver, SOON + 40 * MS);
    assert_eq!(driver.suspensions, 2);
    host.send(b"good morning", SOON + 40 * MS);
    host.resume(SOON + 40 * MS);
    run(&mut host, &mut driver, SOON + 80 * MS);
    assert_eq!(echo(&mut host), b"good morning");
    assert_eq!(host.complaints(), []);
    assert_eq!(driver.effects.violations(), []);
}
