//! Program images: ELF files as the linker writes them, and whether they are what the sources would make now.
//!
//! Beside an image that `firmware/build` has made lies `NAME.sources`: for each file it was made from the line that POSIX
//! `cksum` prints. An image that is older than one of them would be tested in place of what is
//! written, so it is not run.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, ensure};
use crc::{CRC_32_CKSUM, Crc};
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SectionFlags};

use crate::memory::{FLASH_BASE, FLASH_BYTES, FlashArray, RAM_BASE, RAM_BYTES};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Symbol {
    pub address: u32,
    /// Its size in bytes, as far as the file says.
    pub bytes: u32,
}

#[derive(Clone, Debug)]
pub struct Image {
    segments: Vec<(u32, Vec<u8>)>,
    symbols: BTreeMap<String, Symbol>,
    /// Bytes of RAM its static variables take; the stack comes on top.
    pub static_ram_bytes: usize,
}

impl Image {
    /// Reads an ELF file.
    pub fn from_elf(file: &[u8]) -> Result<Self> {
        let elf = ElfFile32::<Endianness>::parse(file)
            .context("not a 32-bit ELF file; give the file that firmware/build makes")?;
        let segments = loadable_segments(file)?;
        ensure!(!segments.is_empty(), "the file has no loadable segment; is it an executable?");
        let named = elf.symbols().filter_map(|symbol| {
            let place = Symbol { address: symbol.address() as u32, bytes: symbol.size() as u32 };
            symbol.name().ok().filter(|name| !name.is_empty()).map(|name| (name.to_owned(), place))
        });
        let ram = u64::from(RAM_BASE)..u64::from(RAM_BASE) + RAM_BYTES as u64;
        let variables = elf.sections().filter(|section| is_allocated(section) && ram.contains(&section.address()));
        let variables = variables.filter(|section| section.name() != Ok(".stack"));
        let static_ram_bytes = variables.map(|section| section.size() as usize).sum();
        Ok(Self { segments, symbols: named.collect(), static_ram_bytes })
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
}

fn loadable_segments(file: &[u8]) -> Result<Vec<(u32, Vec<u8>)>> {
    let header = FileHeader32::<Endianness>::parse(file)?;
    let endian = header.endian()?;
    let mut segments = Vec::new();
    for segment in header.program_headers(endian, file)? {
        if segment.p_type(endian) != PT_LOAD || segment.p_filesz(endian) == 0 {
            continue;
        }
        let (address, bytes) = (segment.p_paddr(endian), segment.p_filesz(endian) as usize);
        let outside = || anyhow!("a segment of {bytes} bytes at {address:#010x} lies outside flash; check memory.x");
        let offset = address.checked_sub(FLASH_BASE).ok_or_else(outside)? as usize;
        ensure!(offset + bytes <= FLASH_BYTES, outside());
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

/// The root of the project, to which paths of sources are relative.
fn project() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Where `firmware/build` puts the image `name`: in the target directory of the environment, or that
/// of the sources this was built from.
pub(crate) fn image_path(name: &str) -> PathBuf {
    // Relative to the project, as for firmware/build.
    let target = std::env::var_os("CARGO_TARGET_DIR").filter(|target| !target.is_empty());
    let target = project().join(target.map_or_else(|| PathBuf::from("target"), PathBuf::from));
    target.join("firmware/thumbv7em-none-eabihf/firmware").join(name)
}

/// Checks that `image`, which `firmware/build` has made, is not older than any of its sources.
pub(crate) fn check_sources(image: &Path) -> Result<()> {
    changed_since(image, &project())
        .map_err(|change| anyhow!("the image {} is out of date: {change}; run firmware/build again", image.display()))
}

fn changed_since(image: &Path, project: &Path) -> Result<(), String> {
    const NO_RECORD: &str = "its last build did not end";
    let record = std::fs::read_to_string(image.with_extension("sources")).unwrap_or_default();
    // Never of nothing.
    if record.is_empty() {
        return Err(NO_RECORD.to_owned());
    }
    for line in record.lines() {
        let [sum, _, source] = line.splitn(3, ' ').collect::<Vec<_>>()[..] else { return Err(NO_RECORD.to_owned()) };
        if !std::fs::read(project.join(source)).is_ok_and(|bytes| cksum(&bytes).to_string() == sum) {
            return Err(format!("{source} has changed since"));
        }
    }
    Ok(())
}

/// The checksum of POSIX `cksum`: a CRC of the bytes and of their number, least significant byte first,
/// without the zeros at its end.
fn cksum(bytes: &[u8]) -> u32 {
    static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_CKSUM);
    let length = bytes.len().to_le_bytes();
    let used = length.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
    let mut digest = CRC.digest();
    digest.update(bytes);
    digest.update(&length[..used]);
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use std::process::Command;

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
    fn what_does_not_fit_is_refused() {
        let refused = |file: &[u8]| Image::from_elf(file).expect_err("no image").to_string();
        assert!(refused(&elf(0x2000_0000)).contains("of 4 bytes at 0x20000000 lies outside flash"));
        assert!(refused(&elf(FLASH_BASE + FLASH_BYTES as u32 - 3)).contains("outside flash"));
        assert!(refused(b"hello").contains("not a 32-bit ELF"));
    }

    /// Against the system's own `cksum`, over files of every kind of length.
    #[test]
    fn an_image_is_refused_when_any_of_its_sources_has_changed() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let image = folder.path().join("image");
        let no_record = Err("its last build did not end".to_owned());
        assert_eq!(changed_since(&image, folder.path()), no_record);
        let sources = [("empty", 0), ("one byte", 1), ("a longer one", 300), ("longest", 70_000)];
        for (name, bytes) in sources {
            std::fs::write(folder.path().join(name), vec![0x5a; bytes]).expect("written");
        }
        let names = sources.map(|(name, _)| name);
        let record = Command::new("cksum").args(names).current_dir(folder.path()).output().expect("POSIX has it");
        std::fs::write(folder.path().join("image.sources"), record.stdout).expect("written");
        assert_eq!(changed_since(&image, folder.path()), Ok(()));
        for (name, bytes) in sources {
            let source = folder.path().join(name);
            let mut changed = vec![0x5a; bytes];
            changed.pop();
            changed.push(0x5b);
            let error = Err(format!("{name} has changed since"));
            std::fs::write(&source, &changed).expect("written");
            assert_eq!(changed_since(&image, folder.path()), error);
            std::fs::remove_file(&source).expect("removed");
            assert_eq!(changed_since(&image, folder.path()), error);
            std::fs::write(&source, vec![0x5a; bytes]).expect("written");
        }
        std::fs::write(folder.path().join("image.sources"), "").expect("written");
        assert_eq!(changed_since(&image, folder.path()), no_record);
        let told = check_sources(&image).expect_err("no record").to_string();
        assert!(told.contains("image is out of date: its last build") && told.contains("run firmware/build"), "{told}");
    }
}
