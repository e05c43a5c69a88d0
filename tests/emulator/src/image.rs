//! Program images: ELF files as the linker writes them.

use std::collections::BTreeMap;

use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SectionFlags};

use crate::memory::{CCM_BASE, CCM_BYTES, FLASH_BASE, FLASH_BYTES, FlashArray, RAM_BASE, RAM_BYTES};

/// Why a file is no image for this device.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file is not an ELF file of 32 bits, or is damaged.
    #[error("not a 32-bit ELF file; give the file that firmware/build makes")]
    Elf(#[from] object::Error),
    /// A segment lies outside flash.
    #[error("a segment of {bytes} bytes at {address:#010x} lies outside flash; check memory.x")]
    OutsideFlash {
        /// Physical address.
        address: u32,
        /// Its size.
        bytes: usize,
    },
    /// There is nothing to load.
    #[error("the file has no loadable segment; is it an executable?")]
    Empty,
}

/// A named place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// Its address.
    pub address: u32,
    /// Its size in bytes, as far as the file says.
    pub bytes: u32,
}

/// A program for the device.
#[derive(Clone, Debug)]
pub struct Image {
    segments: Vec<(u32, Vec<u8>)>,
    symbols: BTreeMap<String, Symbol>,
    static_ram_bytes: usize,
    ccm_bytes: usize,
}

impl Image {
    /// Reads an ELF file.
    pub fn from_elf(file: &[u8]) -> Result<Self, ImageError> {
        let elf = ElfFile32::<Endianness>::parse(file)?;
        let segments = loadable_segments(file)?;
        if segments.is_empty() {
            return Err(ImageError::Empty);
        }
        let named = elf.symbols().filter_map(|symbol| {
            let place = Symbol { address: symbol.address() as u32, bytes: symbol.size() as u32 };
            symbol.name().ok().filter(|name| !name.is_empty()).map(|name| (name.to_owned(), place))
        });
        let bytes_in = |base: u32, bytes: usize| {
            let place = u64::from(base)..u64::from(base) + bytes as u64;
            let sections = elf.sections().filter(|section| is_allocated(section) && place.contains(&section.address()));
            sections.filter(|section| section.name() != Ok(".stack")).map(|section| section.size() as usize).sum()
        };
        Ok(Self {
            segments,
            symbols: named.collect(),
            static_ram_bytes: bytes_in(RAM_BASE, RAM_BYTES),
            ccm_bytes: bytes_in(CCM_BASE, CCM_BYTES),
        })
    }

    /// Puts the image into flash, as a programmer's tool does.
    pub fn load_into(&self, flash: &mut FlashArray) {
        for (address, data) in &self.segments {
            flash.load((address - FLASH_BASE) as usize, data);
        }
    }

    /// All symbols, by name; of Rust items the mangled one.
    pub fn symbols(&self) -> impl Iterator<Item = (&str, Symbol)> {
        self.symbols.iter().map(|(name, symbol)| (name.as_str(), *symbol))
    }

    /// Bytes of flash the program takes.
    pub fn flash_bytes(&self) -> usize {
        self.segments.iter().map(|(_, data)| data.len()).sum()
    }

    /// Bytes of RAM its static variables take; the stack comes on top.
    pub fn static_ram_bytes(&self) -> usize {
        self.static_ram_bytes
    }

    /// Bytes of CCM SRAM, seen at its own address, that its code and variables take.
    pub fn ccm_bytes(&self) -> usize {
        self.ccm_bytes
    }
}

fn loadable_segments(file: &[u8]) -> Result<Vec<(u32, Vec<u8>)>, ImageError> {
    let header = FileHeader32::<Endianness>::parse(file)?;
    let endian = header.endian()?;
    let mut segments = Vec::new();
    for segment in header.program_headers(endian, file)? {
        if segment.p_type(endian) != PT_LOAD || segment.p_filesz(endian) == 0 {
            continue;
        }
        let (address, bytes) = (segment.p_paddr(endian), segment.p_filesz(endian) as usize);
        let outside = || ImageError::OutsideFlash { address, bytes };
        let offset = address.checked_sub(FLASH_BASE).ok_or_else(outside)? as usize;
        if offset + bytes > FLASH_BYTES {
            return Err(outside());
        }
        segments.push((address, segment.data(endian, file).map_err(|()| outside())?.to_vec()));
    }
    Ok(segments)
}

/// A section that occupies memory from start to end of the program.
fn is_allocated<'data>(section: &impl ObjectSection<'data>) -> bool {
    match section.flags() {
        SectionFlags::Elf { sh_flags } => sh_flags & u64::from(object::elf::SHF_ALLOC) != 0,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An executable of one segment: 4 bytes at `address`.
    fn elf(address: u32) -> Vec<u8> {
        let mut file = Vec::from(*b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0");
        for half in [2_u16, 40] {
            file.extend(half.to_le_bytes());
        }
        for word in [1_u32, 0, 52, 0, 0] {
            file.extend(word.to_le_bytes());
        }
        for half in [52_u16, 32, 1, 40, 0, 0] {
            file.extend(half.to_le_bytes());
        }
        for word in [PT_LOAD, 84, 0x2000_0000, address, 4, 4, 5, 4] {
            file.extend(word.to_le_bytes());
        }
        file.extend([1, 2, 3, 4]);
        file
    }

    #[test]
    fn segments_go_to_their_physical_address() {
        let image = Image::from_elf(&elf(FLASH_BASE + 0x100)).unwrap();
        let mut flash = FlashArray::erased();
        image.load_into(&mut flash);
        assert_eq!(flash.bytes()[0xFF..0x105], [0xFF, 1, 2, 3, 4, 0xFF]);
        assert_eq!((image.flash_bytes(), image.static_ram_bytes()), (4, 0));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        assert!(matches!(Image::from_elf(&elf(0x2000_0000)), Err(ImageError::OutsideFlash { bytes: 4, .. })));
        assert!(matches!(
            Image::from_elf(&elf(FLASH_BASE + FLASH_BYTES as u32 - 3)),
            Err(ImageError::OutsideFlash { .. })
        ));
        assert!(matches!(Image::from_elf(b"hello"), Err(ImageError::Elf(_))));
    }
}
