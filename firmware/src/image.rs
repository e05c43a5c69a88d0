//! What an image of the board's firmware says of itself, at a fixed place behind its vector table.
//!
//! Flash of the first bank, from 0x0800_0000 on (`image.x` in this crate lays it out):
//!
//! | offset | bytes | content |
//! |---|---|---|
//! | 0 | 2048 | boot stub: starts the image, or the MCU's boot loader if the image is not whole |
//! | 0x800 | 472 | vector table of the image |
//! | 0x9d8 | 8 | `slitpose` |
//! | 0x9e0 | 16 | name of the board, ASCII, filled up with zeros |
//! | 0x9f0 | 3 | version of the firmware: major, minor, patch |
//! | 0x9f3 | 1 | major version of the protocol |
//! | 0x9f4 | 4 | address behind the image, little endian |
//! | ... | | code and constants |
//! | end - 8 | 8 | zeros, written last |

use slitpose_protocol::PROTOCOL;

/// Address of the flash memory: of the boot stub.
pub const FLASH_BASE: u32 = 0x0800_0000;
/// A page, the least that can be erased; the boot stub has the first one.
pub const PAGE_BYTES: usize = 2048;
/// The image ends here at the earliest: the mark follows header and vector table.
const MIN_IMAGE_END: u32 = FLASH_BASE + 0xa08;
/// The image ends here at the latest: settings lie in the second bank.
const MAX_IMAGE_END: u32 = FLASH_BASE + 0x4_0000;
/// Bytes of the double word that marks the end.
pub const END_MARK_BYTES: usize = 8;
/// Address of the double word with versions and end: zeros, which may be programmed over anything, make an image one that is
/// not whole.
pub const END_ADDRESS: u32 = FLASH_BASE + 0x9f0;

const MAGIC: [u8; 8] = *b"slitpose";
const HEADER_OFFSET: usize = PAGE_BYTES + 0x1d8;
/// Bytes of the header ahead of the end's address, which the linker writes.
pub const HEADER_BYTES: usize = 28;

/// What an image says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageHeader {
    board: [u8; 16],
    /// Version of the firmware: major, minor, patch.
    pub firmware: [u8; 3],
    /// Major version of the protocol it speaks.
    pub protocol_major: u8,
}

impl ImageHeader {
    /// The header of an image of this source for `board`.
    ///
    /// # Panics
    /// If the name is longer than 16 bytes.
    pub const fn of_this_source(board: &str) -> Self {
        let mut name = [0; 16];
        name.split_at_mut(board.len()).0.copy_from_slice(board.as_bytes());
        let firmware = [
            decimal(env!("CARGO_PKG_VERSION_MAJOR")),
            decimal(env!("CARGO_PKG_VERSION_MINOR")),
            decimal(env!("CARGO_PKG_VERSION_PATCH")),
        ];
        Self { board: name, firmware, protocol_major: PROTOCOL.major }
    }

    /// The bytes in flash, without the address of the end.
    pub const fn encode(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        let (magic, rest) = bytes.split_at_mut(8);
        let (board, rest) = rest.split_at_mut(16);
        let (firmware, protocol) = rest.split_at_mut(3);
        magic.copy_from_slice(&MAGIC);
        board.copy_from_slice(&self.board);
        firmware.copy_from_slice(&self.firmware);
        protocol[0] = self.protocol_major;
        bytes
    }

    /// Reads the header in `flash`, the bytes from [`FLASH_BASE`] on, and gives the bytes to the end of the image, too. `None`
    /// if there is no whole image: no header, or no end where the header says.
    pub fn of_flash(flash: &[u8]) -> Option<(Self, &[u8])> {
        let (header, end) = flash.get(HEADER_OFFSET..)?.split_first_chunk::<HEADER_BYTES>()?;
        let end = u32::from_le_bytes(*end.first_chunk()?);
        let whole = flash.get(..end.checked_sub(FLASH_BASE)? as usize)?;
        // As the boot stub has it.
        let is_whole = (MIN_IMAGE_END..=MAX_IMAGE_END).contains(&end)
            && end.is_multiple_of(8)
            && whole.ends_with(&[0; END_MARK_BYTES]);
        let [board, firmware] = [&header[8..24], &header[24..27]];
        let header =
            Self { board: board.try_into().ok()?, firmware: firmware.try_into().ok()?, protocol_major: header[27] };
        (flash[HEADER_OFFSET..].starts_with(&MAGIC) && is_whole).then_some((header, whole))
    }

    /// Name of the board the image is for.
    pub fn board(&self) -> &str {
        str::from_utf8(&self.board).unwrap_or("?").trim_end_matches('\0')
    }
}

const fn decimal(text: &str) -> u8 {
    match u8::from_str_radix(text, 10) {
        Ok(number) => number,
        Err(_) => panic!("a version has numbers below 256"),
    }
}
