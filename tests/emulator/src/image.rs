//! The image that is flashed: an ELF file as the firmware's build makes it.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use object::Endianness;
use object::elf::{FileHeader32, PT_LOAD, SHT_SYMTAB};
use object::read::elf::{FileHeader, ProgramHeader, Sym};
use thiserror::Error;

use crate::memory::{FLASH_BASE, FLASH_BYTES, FlashArray, RAM_BASE, RAM_BYTES};

/// Why there is no image to run.
#[derive(Debug, Error)]
pub enum ImageError {
    /// The file cannot be read.
    #[error("cannot read the image {}; make it with firmware/build, or give another one with --elf", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is no ELF file for a 32-bit machine.
    #[error("{} is not an image for the board", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: object::read::Error,
    },
    /// It does not lie where the board's flash is.
    #[error(
        "{} has {bytes} bytes at {address:#010x}, which is not in the board's flash: build it for an STM32G474RE",
        path.display()
    )]
    Place {
        /// The file.
        path: PathBuf,
        /// Where a part of it goes.
        address: u64,
        /// How long that part is.
        bytes: usize,
    },
}

/// A program for the board.
#[derive(Clone, Debug)]
pub struct Image {
    parts: Vec<(usize, Vec<u8>)>,
    symbols: HashMap<String, u32>,
    ram_bytes: usize,
}

/// A part of the image is loaded by the debugger, its log; it is not in flash.
fn is_loaded(bytes: usize, address: u64) -> bool {
    bytes > 0 && address >= u64::from(FLASH_BASE)
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// If it is no program for the board.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let file = fs::read(path).map_err(|source| ImageError::Read { path: path.to_owned(), source })?;
        let parse = |source| ImageError::Parse { path: path.to_owned(), source };
        let header = FileHeader32::<Endianness>::parse(&*file).map_err(parse)?;
        let endian = header.endian().map_err(parse)?;
        let mut image = Self { parts: Vec::new(), symbols: HashMap::new(), ram_bytes: 0 };
        for segment in header.program_headers(endian, &*file).map_err(parse)? {
            if segment.p_type(endian) != PT_LOAD {
                continue;
            }
            let in_ram = u64::from(segment.p_vaddr(endian)).wrapping_sub(RAM_BASE.into()) < RAM_BYTES as u64;
            if in_ram {
                image.ram_bytes += segment.p_memsz(endian) as usize;
            }
            let data = segment.data(endian, &*file).unwrap_or(&[]);
            let address = u64::from(segment.p_paddr(endian));
            if is_loaded(data.len(), address) {
                let offset = (address - u64::from(FLASH_BASE)) as usize;
                if offset + data.len() > FLASH_BYTES {
                    return Err(ImageError::Place { path: path.to_owned(), address, bytes: data.len() });
                }
                image.parts.push((offset, data.to_vec()));
            }
        }
        let symbols = header.sections(endian, &*file).and_then(|all| all.symbols(endian, &*file, SHT_SYMTAB));
        let symbols = symbols.map_err(parse)?;
        for symbol in symbols.iter() {
            if let Ok(name) = symbols.symbol_name(endian, symbol) {
                image.symbols.insert(String::from_utf8_lossy(name).into_owned(), symbol.st_value(endian));
            }
        }
        Ok(image)
    }

    /// The file that `firmware/build` made last: in the target directory of the environment, or
    /// that of the sources this was built from.
    pub fn default_path() -> PathBuf {
        let target = std::env::var_os("CARGO_TARGET_DIR")
            .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target"), PathBuf::from);
        target.join("firmware/thumbv7em-none-eabihf/firmware/slitpose-board")
    }

    /// Puts the program into erased flash.
    pub fn flash(&self) -> FlashArray {
        let mut cells = FlashArray::erased();
        for (offset, data) in &self.parts {
            cells.load(*offset, data);
        }
        cells
    }

    /// Bytes of flash.
    pub fn flash_bytes(&self) -> usize {
        self.parts.iter().map(|(_, data)| data.len()).sum()
    }

    /// Bytes of RAM given to variables, without the stack.
    pub fn ram_bytes(&self) -> usize {
        self.ram_bytes
    }

    /// Address of a symbol.
    pub fn symbol(&self, name: &str) -> Option<u32> {
        self.symbols.get(name).copied()
    }
}
