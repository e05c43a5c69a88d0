//! New firmware for a board by the boot loader in its MCU: USB DFU with ST's extensions (AN3156).
//!
//! The first page of flash, the boot stub, starts the firmware only if it is whole. An update first overwrites the end in the
//! header with zeros, erases the firmware, and writes the mark of the end after all else has been read back: whenever the
//! supply or the cable fails, the board starts in its boot loader again, and the next update completes it. Settings and head
//! lie elsewhere.

use std::io;
use std::thread::sleep;
use std::time::Duration;

use slitpose_firmware::image::{END_ADDRESS, END_MARK_BYTES, FLASH_BASE, ImageHeader, PAGE_BYTES};
use slitpose_protocol::PROTOCOL;
use thiserror::Error;

/// Why a board did not get its firmware.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum UpdateError {
    #[error("this is no firmware of a slitpose board: {reason}; give the .dfu or .bin file of a release")]
    NotFirmware { reason: &'static str },
    #[error("the firmware is for the board {image}, this is a {board}; give the file for that")]
    OtherBoard { image: String, board: String },
    #[error(
        "the firmware speaks version {image} of the protocol, this program version {}; give a file of the program's own \
         release",
        PROTOCOL.major
    )]
    OtherProtocol { image: u8 },
    #[error(
        "the boot loader refused {what} at {address:#010x} with status {status} (USB DFU 1.1, 6.1.2); update again, and if \
         that is refused, too, remove the protection of the MCU's flash memory with STM32CubeProgrammer"
    )]
    Refused { what: &'static str, address: u32, status: u8 },
    #[error(
        "the MCU in its boot loader has no boot stub of slitpose, so it may be another device; unplug what is no slitpose \
         board, or put the firmware there with dfu-util (firmware/README.md)"
    )]
    Foreign,
    #[error("the flash at {address:#010x} reads back otherwise than it was written; update again")]
    Differs { address: u32 },
    #[error("the boot loader does not answer; check the cable, then update again: the board waits in its boot loader")]
    Usb(#[from] io::Error),
}

/// Firmware for a board: what its flash holds from its start on, in whole double words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Firmware {
    flash: Vec<u8>,
    /// What it says of itself.
    pub header: ImageHeader,
}

impl Firmware {
    /// Reads a file in the DfuSe format (ST UM0391), or the bytes of the flash as they are.
    ///
    /// # Errors
    /// If the file is damaged or none of a board's, or if its protocol is another than this program's.
    pub fn read(file: &[u8]) -> Result<Self, UpdateError> {
        let flash = if file.starts_with(b"DfuSe") { dfuse_content(file)? } else { file };
        let (header, flash) = ImageHeader::of_flash(flash)
            .ok_or(UpdateError::NotFirmware { reason: "it has no whole image with the name of a board" })?;
        if header.protocol_major != PROTOCOL.major {
            return Err(UpdateError::OtherProtocol { image: header.protocol_major });
        }
        Ok(Self { flash: flash.to_vec(), header })
    }

    /// Checks that it is for `board`.
    ///
    /// # Errors
    /// If it is for another one.
    pub fn check_board(&self, board: &str) -> Result<(), UpdateError> {
        if self.header.board() != board {
            return Err(UpdateError::OtherBoard { image: self.header.board().to_owned(), board: board.to_owned() });
        }
        Ok(())
    }

    /// Bytes of flash it takes.
    pub fn bytes(&self) -> usize {
        self.flash.len()
    }
}

/// The content of the only element in the only target, which begins at the start of flash.
fn dfuse_content(file: &[u8]) -> Result<&[u8], UpdateError> {
    const PREFIX_BYTES: usize = 11;
    const TARGET_BYTES: usize = 274;
    const SUFFIX_BYTES: usize = 16;
    let damaged = UpdateError::NotFirmware { reason: "it is damaged or cut off" };
    let (body, sum) = match file.split_last_chunk::<4>() {
        Some((body, sum)) if body.len() >= PREFIX_BYTES + TARGET_BYTES + 8 + SUFFIX_BYTES - 4 => (body, *sum),
        _ => return Err(damaged),
    };
    // The file ends with the complement of CRC-32/ISO-HDLC.
    let mut crc = flate2::Crc::new();
    crc.update(body);
    if !crc.sum() != u32::from_le_bytes(sum) {
        return Err(damaged);
    }
    let element = &body[PREFIX_BYTES + TARGET_BYTES..body.len() - (SUFFIX_BYTES - 4)];
    let word = |at: usize| u32::from_le_bytes(element[at..at + 4].try_into().expect("four bytes"));
    if word(0) != FLASH_BASE || word(4) as usize != element.len() - 8 {
        return Err(UpdateError::NotFirmware { reason: "it has other parts than the flash from its start on" });
    }
    Ok(&element[8..])
}

/// Control requests to the DFU interface of a boot loader.
pub trait DfuPort {
    /// A class request with data to the device.
    ///
    /// # Errors
    /// If the device refuses it or is gone.
    fn send(&mut self, request: u8, value: u16, data: &[u8]) -> io::Result<()>;

    /// A class request for up to `bytes` bytes.
    ///
    /// # Errors
    /// If the device refuses it or is gone.
    fn receive(&mut self, request: u8, value: u16, bytes: u16) -> io::Result<Vec<u8>>;
}

/// Requests of USB DFU 1.1.
mod request {
    pub const DOWNLOAD: u8 = 1;
    pub const UPLOAD: u8 = 2;
    pub const GET_STATUS: u8 = 3;
    pub const CLEAR_STATUS: u8 = 4;
    pub const ABORT: u8 = 6;
}

/// States of USB DFU 1.1.
mod state {
    pub const IDLE: u8 = 2;
    pub const BUSY: u8 = 4;
    pub const DOWNLOAD_IDLE: u8 = 5;
    pub const ERROR: u8 = 10;
}

/// errSTALLEDPKT.
const STALLED: u8 = 15;

/// The first block of data; commands are block 0 (AN3156).
const FIRST_BLOCK: u16 = 2;

/// A boot loader is idle after two requests at most; a page is erased in 25 ms, and it asks for that time itself.
const MAX_ATTEMPTS: usize = 10;

/// A boot loader does not ask for more time than this.
const MAX_WAIT: Duration = Duration::from_secs(2);

/// What is known of the MCU behind a boot loader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Known {
    /// It is a board, which was told to start its boot loader.
    Board,
    /// It was in its boot loader: it is a board only if it has the boot stub.
    Waiting,
}

/// Puts `firmware` into the flash behind `port`, reads it back, and starts it. `progress` gets the bytes done, erased ones,
/// written ones and those read back, of three times [`Firmware::bytes`].
///
/// # Errors
/// If the boot loader refuses a step, goes away, or reads back other bytes, or if the MCU may be another device's. Nothing is
/// started then.
pub fn update(
    port: &mut impl DfuPort,
    firmware: &Firmware,
    known: Known,
    mut progress: impl FnMut(usize),
) -> Result<(), UpdateError> {
    let mut flash = Flash { port };
    flash.become_idle()?;
    let (stub, image) = firmware.flash.split_at(PAGE_BYTES);
    // Only a board whose firmware has none yet, or another one: until it is written, a power cut needs the BOOT0 pin.
    if flash.read(FLASH_BASE, PAGE_BYTES)? != stub {
        if known == Known::Waiting {
            return Err(UpdateError::Foreign);
        }
        flash.replace(FLASH_BASE, stub)?;
    }
    flash.invalidate()?;
    let pages = || (FLASH_BASE + PAGE_BYTES as u32..).step_by(PAGE_BYTES);
    let mut done = stub.len();
    let mut advance = |bytes: usize| {
        done += bytes;
        progress(done);
    };
    for (page, content) in pages().zip(image.chunks(PAGE_BYTES)) {
        flash.erase(page)?;
        advance(content.len());
    }
    // Of a flash memory in one bank, pages are twice as large: the stub went with the first.
    if flash.read(FLASH_BASE, PAGE_BYTES)? != stub {
        flash.replace(FLASH_BASE, stub)?;
    }
    let (content, mark) = image.split_at(image.len() - END_MARK_BYTES);
    for (page, content) in pages().zip(content.chunks(PAGE_BYTES)) {
        flash.write(page, content)?;
        advance(content.len());
    }
    for (page, content) in pages().zip(content.chunks(PAGE_BYTES)) {
        flash.verify(page, content)?;
        advance(content.len());
    }
    let end = FLASH_BASE + (firmware.flash.len() - END_MARK_BYTES) as u32;
    flash.write(end, mark)?;
    flash.verify(end, mark)?;
    flash.leave()
}

/// The flash memory behind a boot loader.
struct Flash<'p, P> {
    port: &'p mut P,
}

impl<P: DfuPort> Flash<'_, P> {
    /// Status and state; waits as long as the boot loader asks for.
    fn status(&mut self) -> Result<(u8, u8), UpdateError> {
        let answer = self.port.receive(request::GET_STATUS, 0, 6)?;
        let &[status, a, b, c, state, _] = &answer[..] else {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a status has six bytes").into());
        };
        sleep(Duration::from_millis(u32::from_le_bytes([a, b, c, 0]).into()).min(MAX_WAIT));
        Ok((status, state))
    }

    /// Ends whatever was begun: by this program, or by one that was cut off.
    fn become_idle(&mut self) -> Result<(), UpdateError> {
        for _ in 0..MAX_ATTEMPTS {
            match self.status()? {
                (_, state::IDLE) => return Ok(()),
                (_, state::ERROR) => self.port.send(request::CLEAR_STATUS, 0, &[])?,
                (_, state::BUSY) => {}
                _ => self.port.send(request::ABORT, 0, &[])?,
            }
        }
        Err(io::Error::other("the boot loader does not become idle").into())
    }

    /// Sends a block and has it carried out.
    fn download(&mut self, block: u16, data: &[u8], what: &'static str, address: u32) -> Result<(), UpdateError> {
        let refused = |status| UpdateError::Refused { what, address, status };
        self.port.send(request::DOWNLOAD, block, data).map_err(|error| match error.kind() {
            io::ErrorKind::ConnectionReset => refused(STALLED),
            _ => error.into(),
        })?;
        for _ in 0..MAX_ATTEMPTS {
            match self.status()? {
                (_, state::BUSY) => {}
                (0, state::DOWNLOAD_IDLE) => return Ok(()),
                (status, _) => return Err(refused(status)),
            }
        }
        Err(io::Error::other("the boot loader stays busy").into())
    }

    /// A command of one byte and an address.
    fn command(&mut self, code: u8, what: &'static str, address: u32) -> Result<(), UpdateError> {
        let [a, b, c, d] = address.to_le_bytes();
        self.download(0, &[code, a, b, c, d], what, address)
    }

    fn set_address(&mut self, address: u32) -> Result<(), UpdateError> {
        self.command(0x21, "an address", address)
    }

    fn erase(&mut self, page: u32) -> Result<(), UpdateError> {
        self.command(0x41, "to erase a page", page)
    }

    /// Writes a page or less to erased flash.
    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), UpdateError> {
        self.set_address(address)?;
        self.download(FIRST_BLOCK, bytes, "to write", address)
    }

    /// Erases a page, writes it, and reads it back.
    fn replace(&mut self, page: u32, bytes: &[u8]) -> Result<(), UpdateError> {
        self.erase(page)?;
        self.write(page, bytes)?;
        self.verify(page, bytes)
    }

    /// Makes the image one that is not whole, before anything of it is erased. Zeros may be programmed over anything (RM0440,
    /// "Programming errors"); if the boot loader refuses that, the first page that is erased does it.
    fn invalidate(&mut self) -> Result<(), UpdateError> {
        match self.write(END_ADDRESS, &[0; END_MARK_BYTES]) {
            Err(UpdateError::Refused { .. }) => self.become_idle(),
            done => done,
        }
    }

    fn read(&mut self, address: u32, bytes: usize) -> Result<Vec<u8>, UpdateError> {
        self.set_address(address)?;
        self.become_idle()?;
        let read = self.port.receive(request::UPLOAD, FIRST_BLOCK, bytes as u16)?;
        self.become_idle()?;
        Ok(read)
    }

    fn verify(&mut self, address: u32, bytes: &[u8]) -> Result<(), UpdateError> {
        let read = self.read(address, bytes.len())?;
        let differing = bytes.iter().zip(&read).position(|(wanted, is)| wanted != is);
        match differing.or((read.len() < bytes.len()).then_some(read.len())) {
            None => Ok(()),
            Some(offset) => Err(UpdateError::Differs { address: address + offset as u32 }),
        }
    }

    /// Starts what is in flash. The boot loader disconnects, so that its last answer may be missing.
    fn leave(mut self) -> Result<(), UpdateError> {
        self.set_address(FLASH_BASE)?;
        self.port.send(request::DOWNLOAD, FIRST_BLOCK, &[])?;
        let _ = self.status();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file in the DfuSe format around `content`, with a sum that is right.
    fn dfuse(address: u32, content: &[u8]) -> Vec<u8> {
        let mut file = b"DfuSe".to_vec();
        file.resize(11 + 274, 0);
        for word in [address, content.len() as u32] {
            file.extend(word.to_le_bytes());
        }
        file.extend(content);
        file.extend([0; 12]);
        let mut crc = flate2::Crc::new();
        crc.update(&file);
        file.extend((!crc.sum()).to_le_bytes());
        file
    }

    fn image(board: &str) -> Vec<u8> {
        let mut flash = vec![0xff; 2 * PAGE_BYTES];
        flash[0x9d8..0x9f4].copy_from_slice(&ImageHeader::of_this_source(board).encode());
        flash[0x9f4..0x9f8].copy_from_slice(&(FLASH_BASE + 2 * PAGE_BYTES as u32).to_le_bytes());
        flash[2 * PAGE_BYTES - 8..].fill(0);
        flash
    }

    #[test]
    fn only_whole_firmware_of_the_board_and_of_this_protocol_is_taken() {
        let flash = image("NUCLEO-G474RE");
        let firmware = Firmware::read(&flash).expect("an image");
        assert_eq!(Firmware::read(&dfuse(FLASH_BASE, &flash)).expect("the same"), firmware);
        assert!(firmware.check_board("NUCLEO-G474RE").is_ok());
        let other = firmware.check_board("NUCLEO-H743ZI").expect_err("another").to_string();
        assert!(other.contains("for the board NUCLEO-G474RE, this is a NUCLEO-H743ZI"), "{other}");

        let refused = |file: &[u8]| Firmware::read(file).expect_err("none").to_string();
        let mut damaged = dfuse(FLASH_BASE, &flash);
        damaged[1_000] ^= 1;
        assert!(refused(&damaged).contains("damaged"));
        assert!(refused(&damaged[..200]).contains("damaged"));
        assert!(refused(&dfuse(FLASH_BASE + 8, &flash)).contains("other parts"));
        let mut unfinished = flash.clone();
        unfinished[2 * PAGE_BYTES - 1] = 1;
        // What follows the image is none of it.
        assert_eq!(Firmware::read(&[&flash[..], &[1; 16]].concat()).expect("an image"), firmware);
        for file in [&unfinished[..], &flash[..flash.len() - 8], &flash[..100], b""] {
            assert!(refused(file).contains("no whole image"));
        }
        let mut short = [&flash[..0xa00], &[0; 8]].concat();
        for (end, is_one) in [(0xa08_u32, true), (0xa00, false), (8, false), (0xa0c, false)] {
            short[0x9f4..0x9f8].copy_from_slice(&(FLASH_BASE + end).to_le_bytes());
            assert_eq!(Firmware::read(&short).is_ok(), is_one, "{end:#x}");
        }
        let mut newer = flash;
        newer[0x9f3] += 1;
        assert!(refused(&newer).contains("speaks version 3 of the protocol, this program version 2"));
    }
}
