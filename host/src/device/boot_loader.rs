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

impl BootLoader {
    /// Opens the only boot loader, or that of `board`, once it is there. `None`: it has not come `within` this time.
    ///
    /// # Errors
    /// If it may not be opened, or if there are several and none is that of `board`.
    pub(crate) fn await_one(board: Option<DeviceId>, within: Duration) -> io::Result<Option<Self>> {
        let begun = Instant::now();
        loop {
            let mut there: Vec<_> = nusb::list_devices()
                .wait()?
                .filter(|device| (device.vendor_id(), device.product_id()) == BOOT_LOADER)
                .collect();
            let is_it = |device: &DeviceInfo| board.is_some_and(|board| device.serial_number() == Some(&serial(board)));
            match there.iter().position(is_it).or((there.len() == 1).then_some(0)) {
                Some(index) => return Self::open(&there.swap_remove(index)).map(Some),
                None if there.len() > 1 => {
                    let text = format!("{} boot loaders are on USB; unplug those of other boards", there.len());
                    return Err(io::Error::other(text));
                }
                None if begun.elapsed() >= within => return Ok(None),
                None => std::thread::sleep(LOOK_AGAIN),
            }
        }
    }

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
