//! The life of a device from its reset to an open serial port: which request comes next, and what
//! its answer means (USB 2.0 chapter 9; Communication Devices PSTN subclass 1.2, section 6.3).

use super::MS;
use crate::peripherals::Ticks;

const ADDRESS: u8 = 5;

/// What a device may take to answer at a new address (section 9.2.6.3).
const ADDRESS_RECOVERY_TICKS: Ticks = 2 * MS;

/// Before its descriptor is known a control endpoint takes at least this much.
const MIN_PACKET_BYTES: usize = 8;

// Descriptor types (table 9-5).
const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
const STRING: u8 = 3;
const INTERFACE: u8 = 4;
const ENDPOINT: u8 = 5;

// Classes of interfaces, and types of endpoints.
const COMMUNICATION: u8 = 0x02;
const COMMUNICATION_DATA: u8 = 0x0a;
const BULK: u8 = 2;
const INTERRUPT: u8 = 3;

/// The line coding a terminal program sets: 115 200 baud, one stop bit, no parity, 8 bits.
const LINE_CODING: [u8; 7] = [0x00, 0xc2, 0x01, 0x00, 0, 0, 8];

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceDescription {
    pub device: Vec<u8>,
    /// The configuration descriptor with all that belongs to it.
    pub configuration: Vec<u8>,
    /// Manufacturer, product and serial number.
    pub texts: [Option<String>; 3],
}

/// A request to the device: its SETUP packet, and what goes to the device with it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    pub setup: [u8; 8],
    pub data: Vec<u8>,
}

/// An endpoint of the serial port; bulk endpoints have no interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoint {
    pub number: u8,
    pub packet_bytes: usize,
    pub interval: Ticks,
}

/// Notification, bulk IN and bulk OUT.
pub type Endpoints = [Endpoint; 3];

/// A serial port (CDC-ACM) in a configuration.
#[derive(Clone, Copy, Debug)]
struct SerialPort {
    configuration: u8,
    control_interface: u8,
    endpoints: Endpoints,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Step {
    #[default]
    Absent,
    DeviceHead,
    Address,
    Device,
    ConfigurationHead,
    Configuration,
    Languages,
    Text(usize),
    Configure,
    LineCoding,
    Ready,
    ControlLines,
    /// A request has failed; nothing more is asked.
    Failed,
}

#[derive(Debug, Default)]
pub struct Enumeration {
    step: Step,
    pub address: u8,
    language: u16,
    pub description: DeviceDescription,
    port: Option<SerialPort>,
    pub dtr: bool,
    wanted_dtr: bool,
    /// What the device may take before the next transaction.
    pub recovery: Ticks,
}

impl Enumeration {
    /// Of a device that has just been reset.
    pub fn begin() -> Self {
        Self { step: Step::DeviceHead, ..Self::default() }
    }

    /// The device is gone; what it said of itself stays readable.
    pub fn lose(&mut self) {
        *self = Self { description: std::mem::take(&mut self.description), ..Self::default() };
    }

    pub fn is_ready(&self) -> bool {
        matches!(self.step, Step::Ready | Step::ControlLines)
    }

    /// bMaxPacketSize0.
    pub fn control_packet_bytes(&self) -> usize {
        self.description.device.get(7).map_or(0, |&bytes| usize::from(bytes)).max(MIN_PACKET_BYTES)
    }

    /// The request that comes next; `dtr` is what DTR shall be. `None`: nothing to ask for now.
    pub fn next_request(&mut self, dtr: bool) -> Option<Request> {
        if self.step == Step::Ready && dtr != self.dtr {
            self.step = Step::ControlLines;
            self.wanted_dtr = dtr;
        }
        let interface = self.port.map_or(0, |port| u16::from(port.control_interface));
        Some(match self.step {
            Step::Absent | Step::Ready | Step::Failed => return None,
            Step::DeviceHead => get_descriptor(DEVICE, 0, 0, 8),
            Step::Address => command(0x00, 5, u16::from(ADDRESS), 0, &[]),
            Step::Device => get_descriptor(DEVICE, 0, 0, 18),
            Step::ConfigurationHead => get_descriptor(CONFIGURATION, 0, 0, 9),
            Step::Configuration => {
                let head = &self.description.configuration;
                get_descriptor(CONFIGURATION, 0, 0, head.get(2..4).map_or(0, le16))
            }
            Step::Languages => get_descriptor(STRING, 0, 0, 255),
            Step::Text(n) => get_descriptor(STRING, self.text_index(n), self.language, 255),
            Step::Configure => command(0x00, 9, self.port.map_or(1, |port| port.configuration).into(), 0, &[]),
            Step::LineCoding => command(0x21, 0x20, 0, interface, &LINE_CODING),
            // DTR and RTS go together, as with a terminal.
            Step::ControlLines => command(0x21, 0x22, if self.wanted_dtr { 3 } else { 0 }, interface, &[]),
        })
    }

    /// iManufacturer, iProduct or iSerialNumber.
    fn text_index(&self, n: usize) -> u8 {
        self.description.device.get(14 + n).copied().unwrap_or_default()
    }

    /// Takes the answer to the last request. When the serial port works, returns its endpoints.
    pub fn answered(&mut self, data: &[u8]) -> Result<Option<Endpoints>, String> {
        self.recovery = 0;
        self.step = match self.step {
            Step::DeviceHead => {
                self.description.device = data.to_vec();
                Step::Address
            }
            Step::Address => {
                self.address = ADDRESS;
                self.recovery = ADDRESS_RECOVERY_TICKS;
                Step::Device
            }
            Step::Device => {
                self.description.device = data.to_vec();
                Step::ConfigurationHead
            }
            Step::ConfigurationHead => {
                self.description.configuration = data.to_vec();
                Step::Configuration
            }
            Step::Configuration => {
                self.description.configuration = data.to_vec();
                self.port = Some(serial_port(data).ok_or("no serial port (CDC-ACM) in it")?);
                Step::Languages
            }
            Step::Languages => {
                self.language = data.get(2..4).map_or(0, le16);
                Step::Text(0)
            }
            Step::Text(n) => {
                self.description.texts[n] = string(data);
                if n < 2 { Step::Text(n + 1) } else { Step::Configure }
            }
            Step::Configure => Step::LineCoding,
            Step::LineCoding => {
                self.step = Step::Ready;
                return Ok(self.port.map(|port| port.endpoints));
            }
            Step::ControlLines => {
                self.dtr = self.wanted_dtr;
                Step::Ready
            }
            Step::Absent | Step::Ready | Step::Failed => self.step,
        };
        Ok(None)
    }

    /// The last request has failed; gives what it was for.
    pub fn fail(&mut self) -> String {
        format!("{:?}", std::mem::replace(&mut self.step, Step::Failed))
    }
}

/// Finds the serial port in a configuration (USB 2.0 section 9.6).
fn serial_port(configuration: &[u8]) -> Option<SerialPort> {
    let (mut class, mut control, mut endpoints) = (0, None, [None; 3]);
    let mut rest = configuration;
    while let [length, kind, ..] = *rest {
        let part = rest.get(..length.into()).filter(|part| part.len() > 1)?;
        rest = &rest[part.len()..];
        match (kind, part) {
            (INTERFACE, &[_, _, number, _, _, its_class, ..]) => {
                class = its_class;
                control = control.or((class == COMMUNICATION).then_some(number));
            }
            (ENDPOINT, &[_, _, address, transfer, low, high, interval_ms, ..]) => {
                let (place, interval) = match (class, transfer & 3, address & 0x80 != 0) {
                    (COMMUNICATION, INTERRUPT, true) => (0, Ticks::from(interval_ms) * MS),
                    (COMMUNICATION_DATA, BULK, true) => (1, 0),
                    (COMMUNICATION_DATA, BULK, false) => (2, 0),
                    _ => continue,
                };
                let packet_bytes = le16(&[low, high]).into();
                endpoints[place] = Some(Endpoint { number: address & 0xf, packet_bytes, interval });
            }
            _ => {}
        }
    }
    let [Some(notification), Some(bulk_in), Some(bulk_out)] = endpoints else { return None };
    Some(SerialPort {
        configuration: *configuration.get(5)?,
        control_interface: control?,
        endpoints: [notification, bulk_in, bulk_out],
    })
}

fn string(data: &[u8]) -> Option<String> {
    let units: Vec<u16> = data.get(2..)?.chunks_exact(2).map(le16).collect();
    String::from_utf16(&units).ok()
}

fn le16(bytes: &[u8]) -> u16 {
    u16::from_le_bytes([bytes[0], bytes[1]])
}

fn get_descriptor(kind: u8, index: u8, language: u16, length: u16) -> Request {
    let [language_low, language_high] = language.to_le_bytes();
    let [low, high] = length.to_le_bytes();
    Request { setup: [0x80, 6, index, kind, language_low, language_high, low, high], data: Vec::new() }
}

fn command(request_type: u8, request: u8, value: u16, index: u16, data: &[u8]) -> Request {
    let [value_low, value_high] = value.to_le_bytes();
    let [index_low, index_high] = index.to_le_bytes();
    let [low, high] = (data.len() as u16).to_le_bytes();
    Request {
        setup: [request_type, request, value_low, value_high, index_low, index_high, low, high],
        data: data.to_vec(),
    }
}
