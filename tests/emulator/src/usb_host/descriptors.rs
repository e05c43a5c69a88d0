//! What a device says of itself: reading it, and whether it agrees with itself and with the rules
//! (USB 2.0 section 9.6; Class Definitions for Communication Devices 1.2, section 5).

/// A device descriptor.
pub(super) const DEVICE_BYTES: usize = 18;

const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
const STRING: u8 = 3;
const INTERFACE: u8 = 4;
const ENDPOINT: u8 = 5;
const ASSOCIATION: u8 = 11;
const CLASS_INTERFACE: u8 = 0x24;

// Class codes.
const COMMUNICATION: u8 = 0x02;
const ABSTRACT_CONTROL: u8 = 0x02;
const COMMUNICATION_DATA: u8 = 0x0a;
/// "Miscellaneous, common class, interface association".
const WITH_ASSOCIATIONS: [u8; 3] = [0xef, 0x02, 0x01];

// Subtypes of CDC functional descriptors.
const HEADER: u8 = 0x00;
const ABSTRACT_CONTROL_MANAGEMENT: u8 = 0x02;
const UNION: u8 = 0x06;

/// bmCapabilities: the device knows SET_LINE_CODING and SET_CONTROL_LINE_STATE.
const LINE_REQUESTS: u8 = 1 << 1;

const BULK: u8 = 2;
const INTERRUPT: u8 = 3;

/// 500 mA in units of 2 mA.
const MOST_POWER: u8 = 250;

/// An endpoint that the device describes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct EndpointDescriptor {
    address: u8,
    transfer: u8,
    pub(super) max_packet_bytes: u16,
    pub(super) interval_ms: u8,
}

impl EndpointDescriptor {
    pub(super) fn number(&self) -> u8 {
        self.address & 0xf
    }

    fn is_in(&self) -> bool {
        self.address & 0x80 != 0
    }
}

/// The endpoints of a serial port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct AcmEndpoints {
    pub(super) notification: EndpointDescriptor,
    pub(super) bulk_in: EndpointDescriptor,
    pub(super) bulk_out: EndpointDescriptor,
}

/// A serial port in a configuration.
#[derive(Clone, Debug)]
pub(super) struct SerialFunction {
    /// bConfigurationValue.
    pub(super) configuration: u8,
    pub(super) control_interface: u8,
    pub(super) endpoints: AcmEndpoints,
}

/// An interface with what follows it.
#[derive(Debug)]
struct Interface<'a> {
    number: u8,
    class: [u8; 3],
    endpoint_count: u8,
    endpoints: Vec<EndpointDescriptor>,
    /// Class-specific descriptors, whole.
    functional: Vec<&'a [u8]>,
}

impl Interface<'_> {
    fn functional(&self, subtype: u8) -> Option<&[u8]> {
        self.functional.iter().copied().find(|descriptor| descriptor[2] == subtype)
    }

    fn endpoint(&self, transfer: u8, is_in: bool) -> Option<EndpointDescriptor> {
        self.endpoints.iter().find(|endpoint| endpoint.transfer == transfer && endpoint.is_in() == is_in).cloned()
    }
}

/// wTotalLength of a configuration.
pub(super) fn total_length(configuration: &[u8]) -> u16 {
    match configuration {
        [_, _, low, high, ..] => u16::from_le_bytes([*low, *high]),
        _ => 0,
    }
}

/// Checks a device descriptor; `head` is what the device said in its first eight bytes before.
pub(super) fn check_device(device: &[u8], head: &[u8], complaints: &mut Vec<String>) {
    let mut expect = |right: bool, text: String| {
        if !right {
            complaints.push(format!("device descriptor: {text}"));
        }
    };
    expect(device.len() == DEVICE_BYTES, format!("{} bytes long", device.len()));
    if device.len() != DEVICE_BYTES {
        return;
    }
    expect(device[..2] == [DEVICE_BYTES as u8, DEVICE], format!("begins with {:?}", &device[..2]));
    expect(device.starts_with(head), "its beginning has changed".to_owned());
    let version = u16::from_le_bytes([device[2], device[3]]);
    expect((0x0110..=0x0210).contains(&version), format!("bcdUSB is {version:04x}"));
    expect([8, 16, 32, 64].contains(&device[7]), format!("bMaxPacketSize0 is {}", device[7]));
    expect(device[8..12] != [0; 4], "idVendor and idProduct are 0".to_owned());
    expect(device[17] >= 1, "there is no configuration".to_owned());
}

/// Checks a configuration and finds the serial port in it.
pub(super) fn serial_function(
    device: &[u8],
    configuration: &[u8],
    complaints: &mut Vec<String>,
) -> Option<SerialFunction> {
    let mut expect = |right: bool, text: String| {
        if !right {
            complaints.push(format!("configuration descriptor: {text}"));
        }
        right
    };
    let total = usize::from(total_length(configuration));
    if !expect(
        configuration.len() == total && total >= 9 && configuration.starts_with(&[9, CONFIGURATION]),
        format!("{} bytes where wTotalLength is {total}", configuration.len()),
    ) {
        return None;
    }
    let (attributes, power) = (configuration[7], configuration[8]);
    expect(attributes & 0x9f == 0x80, format!("bmAttributes is {attributes:#04x}"));
    expect(power <= MOST_POWER, format!("bMaxPower asks for {} mA", 2 * u32::from(power)));

    let (interfaces, associations) = match parts(configuration) {
        Ok(parts) => parts,
        Err(text) => {
            expect(false, text);
            return None;
        }
    };
    expect(
        usize::from(configuration[4]) == interfaces.len(),
        format!("{} interfaces where bNumInterfaces is {}", interfaces.len(), configuration[4]),
    );
    for (position, interface) in interfaces.iter().enumerate() {
        let number = interface.number;
        expect(usize::from(number) == position, format!("interface {number} comes in place {position}"));
        expect(
            usize::from(interface.endpoint_count) == interface.endpoints.len(),
            format!("interface {number} has {} endpoints", interface.endpoints.len()),
        );
    }
    let endpoints: Vec<&EndpointDescriptor> = interfaces.iter().flat_map(|interface| &interface.endpoints).collect();
    for (position, endpoint) in endpoints.iter().enumerate() {
        let address = endpoint.address;
        expect(
            endpoint.number() != 0 && endpoints[..position].iter().all(|other| other.address != address),
            format!("endpoint {address:#04x} is used twice"),
        );
        let size = endpoint.max_packet_bytes;
        let allowed = match endpoint.transfer {
            BULK => [8, 16, 32, 64].contains(&size),
            INTERRUPT => (1..=64).contains(&size) && endpoint.interval_ms > 0,
            _ => false,
        };
        expect(allowed, format!("endpoint {address:#04x} of type {} has packets of {size} bytes", endpoint.transfer));
    }

    let control = interfaces.iter().find(|interface| interface.class[..2] == [COMMUNICATION, ABSTRACT_CONTROL]);
    let data = interfaces.iter().find(|interface| interface.class[0] == COMMUNICATION_DATA);
    let (Some(control), Some(data)) = (control, data) else {
        expect(false, "no serial port (CDC-ACM) in it".to_owned());
        return None;
    };
    expect(control.functional(HEADER).is_some(), "no CDC header".to_owned());
    let management = control.functional(ABSTRACT_CONTROL_MANAGEMENT);
    expect(
        management.is_some_and(|descriptor| descriptor.get(3).is_some_and(|bits| bits & LINE_REQUESTS != 0)),
        "the serial port does not know line coding".to_owned(),
    );
    let union = control.functional(UNION);
    expect(
        union.is_some_and(|descriptor| descriptor[3..] == [control.number, data.number]),
        "the CDC union does not name both interfaces".to_owned(),
    );
    // A host tells a serial port from its class code, or from an association in a composite device.
    match associations.as_slice() {
        [] => expect(device[4] == COMMUNICATION, format!("device class {:#04x} without association", device[4])),
        [association, ..] => {
            let expected = [8, ASSOCIATION, control.number, 2, COMMUNICATION, ABSTRACT_CONTROL];
            expect(association.starts_with(&expected), format!("interface association {association:?}"))
                & expect(device[4..7] == WITH_ASSOCIATIONS, format!("device class {:?}", &device[4..7]))
        }
    };
    let (Some(notification), Some(bulk_in), Some(bulk_out)) =
        (control.endpoint(INTERRUPT, true), data.endpoint(BULK, true), data.endpoint(BULK, false))
    else {
        expect(false, "an endpoint of the serial port is missing".to_owned());
        return None;
    };
    Some(SerialFunction {
        configuration: configuration[5],
        control_interface: control.number,
        endpoints: AcmEndpoints { notification, bulk_in, bulk_out },
    })
}

/// Cuts a configuration into interfaces and associations.
fn parts(configuration: &[u8]) -> Result<(Vec<Interface<'_>>, Vec<&[u8]>), String> {
    let (mut interfaces, mut associations): (Vec<Interface<'_>>, _) = (Vec::new(), Vec::new());
    let mut rest = &configuration[9..];
    while let [length, kind, ..] = *rest {
        let shortest = match kind {
            INTERFACE => 9,
            ENDPOINT => 7,
            ASSOCIATION => 8,
            CLASS_INTERFACE => 3,
            _ => 2,
        };
        let length = usize::from(length);
        if length < shortest || length > rest.len() {
            return Err(format!("a descriptor of type {kind:#04x} is {length} bytes long, {} are left", rest.len()));
        }
        let (descriptor, behind) = rest.split_at(length);
        rest = behind;
        match (kind, interfaces.last_mut()) {
            // Other settings of the same interface are not used.
            (INTERFACE, _) => interfaces.push(Interface {
                number: descriptor[2],
                class: [descriptor[5], descriptor[6], descriptor[7]],
                endpoint_count: descriptor[4],
                endpoints: Vec::new(),
                functional: Vec::new(),
            }),
            (ENDPOINT, Some(interface)) => interface.endpoints.push(EndpointDescriptor {
                address: descriptor[2],
                transfer: descriptor[3] & 3,
                max_packet_bytes: u16::from_le_bytes([descriptor[4], descriptor[5]]),
                interval_ms: descriptor[6],
            }),
            (CLASS_INTERFACE, Some(interface)) => interface.functional.push(descriptor),
            (ASSOCIATION, _) => associations.push(descriptor),
            _ => return Err(format!("a descriptor of type {kind:#04x} belongs to no interface")),
        }
    }
    if rest.is_empty() { Ok((interfaces, associations)) } else { Err("a byte is left over".to_owned()) }
}

/// From the languages a device knows, `wanted` or else the first.
pub(super) fn choose_language(data: &[u8], wanted: u16, complaints: &mut Vec<String>) -> u16 {
    match units(data) {
        Some(languages) if languages.contains(&wanted) => wanted,
        Some(languages) if !languages.is_empty() => languages[0],
        _ => {
            complaints.push("string descriptor: no languages".to_owned());
            wanted
        }
    }
}

/// The text of a string descriptor.
pub(super) fn string(data: &[u8], name: &str, complaints: &mut Vec<String>) -> Option<String> {
    let text = units(data).and_then(|units| String::from_utf16(&units).ok()).filter(|text| !text.is_empty());
    if text.is_none() {
        complaints.push(format!("string descriptor: the {name} is no text"));
    }
    text
}

/// The 16-bit units of a string descriptor.
fn units(data: &[u8]) -> Option<Vec<u16>> {
    match data {
        [length, STRING, units @ ..] if usize::from(*length) == data.len() && units.len().is_multiple_of(2) => {
            Some(units.chunks_exact(2).map(|unit| u16::from_le_bytes([unit[0], unit[1]])).collect())
        }
        _ => None,
    }
}
