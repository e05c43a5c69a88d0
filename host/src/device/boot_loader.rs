//! The boot loader of a board's MCU on USB.

use std::io;
use std::time::{Duration, Instant};

use nusb::transfer::{ControlIn, ControlOut, ControlType, Recipient};
use nusb::{DeviceInfo, Interface, MaybeFuture};
use slitpose_tracking::link::DeviceId;

use super::update::DfuPort;

/// ST's DFU device (AN2606).
const BOOT_LOADER: (u16, u16) = (0x0483, 0xdf11);
const TIMEOUT: Duration = Duration::from_secs(5);
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// A boot loader that listens.
pub(crate) struct BootLoader(Interface);

/// Boot loaders on USB.
pub(crate) struct BootLoaders(Vec<DeviceInfo>);

impl BootLoaders {
    /// Those that are there now.
    pub(crate) fn now() -> io::Result<Self> {
        let is_one = |device: &DeviceInfo| (device.vendor_id(), device.product_id()) == BOOT_LOADER;
        Ok(Self(nusb::list_devices().wait()?.filter(is_one).collect()))
    }

    fn of(&self, board: DeviceId) -> Option<&DeviceInfo> {
        self.0.iter().find(|device| device.serial_number() == Some(&serial(board)))
    }

    /// Opens that of `board`, or without one the only one. `None`: it is not there.
    ///
    /// # Errors
    /// If it may not be opened, or if there are several.
    pub(crate) fn open(&self, board: Option<DeviceId>) -> io::Result<Option<BootLoader>> {
        let device = match (board, &self.0[..]) {
            (Some(board), _) => self.of(board),
            (None, [only]) => Some(only),
            (None, []) => None,
            (None, several) => {
                let text = format!("{} boot loaders are on USB; name the board with --device SERIAL", several.len());
                return Err(io::Error::other(text));
            }
        };
        device.map(BootLoader::open).transpose()
    }

    /// Waits for that of `board`, which was told to start it and was none of these, and opens it. A boot loader with a serial
    /// number of its own is taken at the end of the time, if it is the only new one.
    ///
    /// # Errors
    /// If it does not come `within` this time, or may not be opened.
    pub(crate) fn await_new(&self, board: DeviceId, within: Duration) -> io::Result<BootLoader> {
        let until = Instant::now() + within;
        loop {
            let there = Self::now()?;
            let is_last = Instant::now() >= until;
            let is_new = |device: &&DeviceInfo| self.0.iter().all(|before| before.id() != device.id());
            let new: Vec<_> = there.0.iter().filter(is_new).collect();
            let found = there.of(board).or(new.first().copied().filter(|_| is_last && new.len() == 1));
            match found.map(BootLoader::open) {
                Some(Ok(boot_loader)) => return Ok(boot_loader),
                // The system may not have given its rights yet.
                Some(Err(error)) if is_last => return Err(error),
                None if is_last => return Err(io::ErrorKind::NotFound.into()),
                _ => std::thread::sleep(LOOK_AGAIN),
            }
        }
    }
}

impl BootLoader {
    fn open(device: &DeviceInfo) -> io::Result<Self> {
        let interface = device.open().wait()?.claim_interface(0).wait()?;
        // The first setting is the flash memory.
        interface.set_alt_setting(0).wait()?;
        Ok(Self(interface))
    }
}

/// The serial number that the boot loader and ST's examples make of a chip's: the sum of its first and last word, and the
/// upper half of the word between.
fn serial(DeviceId(id): DeviceId) -> String {
    let word = |at: usize| u32::from_le_bytes([id[at], id[at + 1], id[at + 2], id[at + 3]]);
    format!("{:08X}{:04X}", word(0).wrapping_add(word(8)), word(4) >> 16)
}

impl DfuPort for BootLoader {
    fn send(&mut self, request: u8, value: u16, data: &[u8]) -> io::Result<()> {
        let (control_type, recipient) = (ControlType::Class, Recipient::Interface);
        let out = ControlOut { control_type, recipient, request, value, index: 0, data };
        self.0.control_out(out, TIMEOUT).wait().map_err(io::Error::from)
    }

    fn receive(&mut self, request: u8, value: u16, bytes: u16) -> io::Result<Vec<u8>> {
        let (control_type, recipient) = (ControlType::Class, Recipient::Interface);
        let request = ControlIn { control_type, recipient, request, value, index: 0, length: bytes };
        self.0.control_in(request, TIMEOUT).wait().map_err(io::Error::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chip_has_the_serial_number_of_its_boot_loader() {
        let mut id = [0; 12];
        for (bytes, word) in id.chunks_exact_mut(4).zip([0x0032_0045_u32, 0x5848_500b, 0x2036_3152]) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        assert_eq!(serial(DeviceId(id)), "206831975848");
    }
}
