//! The life of a device from its reset to an open serial port: which request comes next, and what
//! its answer means (USB 2.0 chapter 9; Communication Devices PSTN subclass 1.2, section 6.3).

use super::MS;
use super::descriptors::{self, AcmEndpoints, SerialFunction};
use super::transfer::Request;
use crate::peripherals::Ticks;

/// The address the device is given.
const ADDRESS: u8 = 5;

/// What a device may take to answer at a new address (section 9.2.6.3).
const ADDRESS_RECOVERY_TICKS: Ticks = 2 * MS;

/// Before its descriptor is known a control endpoint takes at least this much.
const SMALLEST_PACKET_BYTES: usize = 8;

/// US English, the language asked for if the device knows it.
const ENGLISH: u16 = 0x0409;

// Descriptor types (table 9-5).
const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
const STRING: u8 = 3;

/// The line coding a terminal program sets: 115 200 baud, one stop bit, no parity, 8 bits.
const LINE_CODING: [u8; 7] = [0x00, 0xc2, 0x01, 0x00, 0, 0, 8];

/// What a device says of itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceDescription {
    /// The device descriptor.
    pub device: Vec<u8>,
    /// The configuration descriptor with all that belongs to it.
    pub configuration: Vec<u8>,
    /// Who made it.
    pub manufacturer: Option<String>,
    /// What it is.
    pub product: Option<String>,
    /// Which one it is.
    pub serial: Option<String>,
}

/// Where the device is in its life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Step {
    /// There is no device.
    #[default]
    Absent,
    DeviceHead,
    Address,
    Device,
    ConfigurationHead,
    Configuration,
    Languages,
    Manufacturer,
    Product,
    Serial,
    Configure,
    LineCoding,
    /// The serial port works.
    Ready,
    ControlLines,
    /// A request has failed; nothing more is asked.
    Failed,
}

/// The enumeration of one device.
#[derive(Debug, Default)]
pub(super) struct Enumeration {
    step: Step,
    address: u8,
    language: u16,
    description: DeviceDescription,
    function: Option<SerialFunction>,
    dtr: bool,
    wanted_dtr: bool,
    recovery: Ticks,
}

impl Enumeration {
    /// Of a device that has just been reset.
    pub(super) fn begin() -> Self {
        Self { step: Step::DeviceHead, ..Self::default() }
    }

    /// The device is gone; what it said of itself stays readable.
    pub(super) fn lose(&mut self) {
        *self = Self { description: std::mem::take(&mut self.description), ..Self::default() };
    }

    pub(super) fn address(&self) -> u8 {
        self.address
    }

    pub(super) fn is_ready(&self) -> bool {
        matches!(self.step, Step::Ready | Step::ControlLines)
    }

    pub(super) fn dtr(&self) -> bool {
        self.dtr
    }

    pub(super) fn description(&self) -> &DeviceDescription {
        &self.description
    }

    /// What the device may take before the next transaction.
    pub(super) fn recovery_ticks(&self) -> Ticks {
        self.recovery
    }

    /// bMaxPacketSize0.
    pub(super) fn control_packet_bytes(&self) -> usize {
        self.description.device.get(7).map_or(0, |&bytes| usize::from(bytes)).max(SMALLEST_PACKET_BYTES)
    }

    /// The request that comes next; `dtr` is what DTR shall be. `None`: nothing to ask for now.
    pub(super) fn next_request(&mut self, dtr: bool) -> Option<Request> {
        if self.step == Step::Ready && dtr != self.dtr {
            self.step = Step::ControlLines;
            self.wanted_dtr = dtr;
        }
        let interface = self.function.as_ref().map_or(0, |function| u16::from(function.control_interface));
        let string = |index: usize| get_descriptor(STRING, self.description.device[index], self.language, 255);
        let whole = descriptors::total_length(&self.description.configuration);
        Some(match self.step {
            Step::Absent | Step::Ready | Step::Failed => return None,
            Step::DeviceHead => get_descriptor(DEVICE, 0, 0, 8),
            Step::Address => command(0x00, 5, u16::from(ADDRESS), 0, &[]),
            Step::Device => get_descriptor(DEVICE, 0, 0, 18),
            Step::ConfigurationHead => get_descriptor(CONFIGURATION, 0, 0, 9),
            Step::Configuration => get_descriptor(CONFIGURATION, 0, 0, whole),
            Step::Languages => get_descriptor(STRING, 0, 0, 255),
            Step::Manufacturer => string(14),
            Step::Product => string(15),
            Step::Serial => string(16),
            Step::Configure => {
                let value = self.function.as_ref().map_or(1, |function| function.configuration);
                command(0x00, 9, u16::from(value), 0, &[])
            }
            Step::LineCoding => command(0x21, 0x20, 0, interface, &LINE_CODING),
            // DTR and RTS go together, as with a terminal.
            Step::ControlLines => command(0x21, 0x22, if self.wanted_dtr { 3 } else { 0 }, interface, &[]),
        })
    }

    /// Takes the answer to the last request; what is wrong with it goes to `complaints`. When the
    /// serial port works, returns its endpoints.
    pub(super) fn answered(&mut self, data: &[u8], complaints: &mut Vec<String>) -> Option<AcmEndpoints> {
        self.recovery = 0;
        let next = match self.step {
            Step::DeviceHead => {
                if data.len() != 8 {
                    complaints.push(format!("device descriptor: {} bytes where 8 were asked for", data.len()));
                    return self.give_up();
                }
                self.description.device = data.to_vec();
                Step::Address
            }
            Step::Address => {
                self.address = ADDRESS;
                self.recovery = ADDRESS_RECOVERY_TICKS;
                Step::Device
            }
            Step::Device => {
                let head = std::mem::replace(&mut self.description.device, data.to_vec());
                descriptors::check_device(data, &head, complaints);
                if data.len() != descriptors::DEVICE_BYTES {
                    return self.give_up();
                }
                Step::ConfigurationHead
            }
            Step::ConfigurationHead => {
                self.description.configuration = data.to_vec();
                Step::Configuration
            }
            Step::Configuration => {
                self.description.configuration = data.to_vec();
                self.function = descriptors::serial_function(&self.description.device, data, complaints);
                if self.function.is_none() {
                    return self.give_up();
                }
                Step::Languages
            }
            Step::Languages => {
                self.language = descriptors::choose_language(data, ENGLISH, complaints);
                Step::Manufacturer
            }
            Step::Manufacturer => {
                self.description.manufacturer = descriptors::string(data, "manufacturer", complaints);
                Step::Product
            }
            Step::Product => {
                self.description.product = descriptors::string(data, "product", complaints);
                Step::Serial
            }
            Step::Serial => {
                self.description.serial = descriptors::string(data, "serial number", complaints);
                Step::Configure
            }
            Step::Configure => Step::LineCoding,
            Step::LineCoding => {
                self.step = Step::Ready;
                return self.function.as_ref().map(|function| function.endpoints.clone());
            }
            Step::ControlLines => {
                self.dtr = self.wanted_dtr;
                Step::Ready
            }
            Step::Absent | Step::Ready | Step::Failed => self.step,
        };
        self.step = self.past_absent_strings(next);
        None
    }

    /// The last request has failed.
    pub(super) fn failed(&mut self) {
        self.step = Step::Failed;
    }

    /// What the last request was for.
    pub(super) fn current_name(&self) -> &'static str {
        match self.step {
            Step::Absent | Step::Ready | Step::Failed => "no request",
            Step::DeviceHead | Step::Device => "GET_DESCRIPTOR device",
            Step::Address => "SET_ADDRESS",
            Step::ConfigurationHead | Step::Configuration => "GET_DESCRIPTOR configuration",
            Step::Languages | Step::Manufacturer | Step::Product | Step::Serial => "GET_DESCRIPTOR string",
            Step::Configure => "SET_CONFIGURATION",
            Step::LineCoding => "SET_LINE_CODING",
            Step::ControlLines => "SET_CONTROL_LINE_STATE",
        }
    }

    fn give_up(&mut self) -> Option<AcmEndpoints> {
        self.step = Step::Failed;
        None
    }

    /// A string whose index is 0 does not exist (section 9.6.1); without any there are no languages.
    fn past_absent_strings(&self, mut step: Step) -> Step {
        let absent = |index: usize| self.description.device[index] == 0;
        if step == Step::Languages && (14..=16).all(absent) {
            return Step::Configure;
        }
        for (this, index, next) in [
            (Step::Manufacturer, 14, Step::Product),
            (Step::Product, 15, Step::Serial),
            (Step::Serial, 16, Step::Configure),
        ] {
            if step == this && absent(index) {
                step = next;
            }
        }
        step
    }
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
