//! Where an image could panic: every call in its machine code that ends in the panic handler, with the source of it.
//!
//! What the compiler could prove away is not there, so this is what is left. A direct call is an instruction with the
//! address in it; functions that do nothing but panic are followed until they reach the handler, so that a bounds check or
//! an `expect` counts where it stands, and not in `core`. Debug information, inlined calls included, says where that is.

use std::collections::{BTreeMap, BTreeSet};

use addr2line::Context;
use addr2line::gimli::{Dwarf, EndianSlice, LittleEndian, SectionId};
use object::read::elf::ElfFile32;
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SectionFlags, SymbolKind, elf};

use crate::image::ImageError;

/// Why the panics of an image cannot be listed.
#[derive(Debug, thiserror::Error)]
pub enum PanicsError {
    /// It is no image.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Its debug information cannot be read.
    #[error("the image has no debug information to find its source by; build it with firmware/build")]
    Debug(#[from] addr2line::gimli::Error),
    /// It has no panic handler, or nothing that calls it.
    #[error("nothing in the image panics: is it one that firmware/build has made?")]
    None,
}

/// A place in the source from which the panic handler can be reached.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Site {
    /// The file, from the project's folder, or `CRATE-VERSION/src/…` of a dependency; that of the innermost inlined
    /// function outside `core`.
    pub file: String,
    /// The line.
    pub line: u32,
    /// What is called there, such as `panic_bounds_check`.
    pub kind: String,
}

/// Parts of `core` whose functions may do nothing but panic.
const PANICKING: [&str; 6] =
    ["core::panicking::", "core::option::", "core::result::", "core::slice::", "core::cell::", "core::num::"];

/// The same of a dependency.
const PANICKING_ELSEWHERE: [&str; 1] = ["arrayvec::arrayvec::extend_panic"];

/// What a linker calls a stub that only jumps to a function too far away.
const STUB: &str = "__Thumbv7ABSLongThunk_";

/// All of them, once each, in order.
///
/// # Errors
/// If `file` is no ELF file with debug information.
pub fn sites(file: &[u8]) -> Result<Vec<Site>, PanicsError> {
    let elf = ElfFile32::<Endianness>::parse(file).map_err(ImageError::from)?;
    let names = functions(&elf);
    let calls = calls(&elf, &names);
    let panicking = panicking(&names, &calls);
    let section = |id: SectionId| -> Result<_, addr2line::gimli::Error> {
        let data = elf.section_by_name(id.name()).and_then(|section| section.data().ok()).unwrap_or_default();
        Ok(EndianSlice::new(data, LittleEndian))
    };
    let context = Context::from_dwarf(Dwarf::load(section)?)?;
    let mut sites = BTreeSet::new();
    for call in calls.iter().filter(|call| panicking.contains(&call.to) && !panicking.contains(&call.from)) {
        let (file, line) = source(&context, call.at)?;
        let name = &names[&call.to];
        let kind = name.rsplit("::").next().unwrap_or(name).to_owned();
        sites.insert(Site { file, line, kind });
    }
    if sites.is_empty() { Err(PanicsError::None) } else { Ok(sites.into_iter().collect()) }
}

/// Functions by address, demangled; a stub has the name of what it jumps to.
fn functions(elf: &ElfFile32<'_, Endianness>) -> BTreeMap<u32, String> {
    let is_code = |symbol: &object::read::elf::ElfSymbol32<'_, '_, Endianness>| {
        symbol.kind() == SymbolKind::Text && symbol.size() > 0
    };
    elf.symbols()
        .filter(is_code)
        .filter_map(|symbol| {
            let name = symbol.name().ok()?;
            let name = name.strip_prefix(STUB).unwrap_or(name);
            Some((symbol.address() as u32 & !1, format!("{:#}", rustc_demangle::demangle(name))))
        })
        .collect()
}

/// A direct call or jump from one function to the beginning of another.
struct Call {
    at: u32,
    /// The functions' addresses.
    from: u32,
    to: u32,
}

fn calls(elf: &ElfFile32<'_, Endianness>, names: &BTreeMap<u32, String>) -> Vec<Call> {
    // Of AAELF32, 5.5.5: `$t` begins Thumb code, `$d` data among it.
    let marks: BTreeMap<u32, bool> = elf
        .symbols()
        .filter_map(|symbol| {
            let name = symbol.name().ok()?;
            let is_code = name.starts_with("$t");
            (is_code || name.starts_with("$d")).then_some((symbol.address() as u32, is_code))
        })
        .collect();
    let mut calls = Vec::new();
    for section in elf.sections() {
        let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
        if sh_flags & u64::from(elf::SHF_EXECINSTR) == 0 {
            continue;
        }
        let (base, data) = (section.address() as u32, section.data().unwrap_or_default());
        let half = |at: u32| {
            let at = (at - base) as usize;
            data.get(at..at + 2).map(|bytes| u16::from_le_bytes([bytes[0], bytes[1]]))
        };
        let mut at = base;
        while let Some(first) = half(at) {
            if marks.range(..=at).next_back().is_some_and(|(_, is_code)| !is_code) {
                at = marks.range(at + 1..).find(|(_, is_code)| **is_code).map_or(u32::MAX, |(next, _)| *next);
                if at == u32::MAX {
                    break;
                }
                continue;
            }
            let is_wide = first >> 11 >= 0b11101;
            let target =
                if is_wide { half(at + 2).and_then(|second| wide(at, first, second)) } else { narrow(at, first) };
            let from = names.range(..=at).next_back().map(|(address, _)| *address);
            if let (Some(to), Some(from)) = (target, from)
                && names.contains_key(&to)
                && to != from
            {
                calls.push(Call { at, from, to });
            }
            at += if is_wide { 4 } else { 2 };
        }
    }
    calls
}

/// The target of `B` with 16 bits (ARMv7-M ARM, A7.7.12, encodings T1 and T2).
fn narrow(at: u32, code: u16) -> Option<u32> {
    let code = i32::from(code);
    let offset = match code >> 11 {
        0b11100 => (code << 21) >> 20,
        // The condition `1110` is `UDF`, `1111` is `SVC`.
        0b11010 | 0b11011 if (code >> 8) & 0xf < 0xe => (code << 24) >> 23,
        _ => return None,
    };
    Some((at + 4).wrapping_add_signed(offset))
}

/// The target of `B` and `BL` with 32 bits (A7.7.12, encodings T3 and T4; A7.7.18).
fn wide(at: u32, first: u16, second: u16) -> Option<u32> {
    let (high, low) = (i32::from(first), i32::from(second));
    if high >> 11 != 0b11110 || low >> 15 != 1 {
        return None;
    }
    let bit = |word: i32, number: i32| (word >> number) & 1;
    let (sign, j1, j2) = (bit(high, 10), bit(low, 13), bit(low, 11));
    let offset = if bit(low, 12) == 1 {
        let (i1, i2) = (1 ^ j1 ^ sign, 1 ^ j2 ^ sign);
        (-sign << 24) | (i1 << 23) | (i2 << 22) | ((high & 0x3ff) << 12) | ((low & 0x7ff) << 1)
    } else if bit(low, 14) == 0 && (high >> 6) & 0xf < 0xe {
        (-sign << 20) | (j2 << 19) | (j1 << 18) | ((high & 0x3f) << 12) | ((low & 0x7ff) << 1)
    } else {
        return None;
    };
    Some((at + 4).wrapping_add_signed(offset))
}

/// Addresses of the functions that only panic: the handler's entry, and what of `core` calls one of them.
fn panicking(names: &BTreeMap<u32, String>, calls: &[Call]) -> BTreeSet<u32> {
    let mut found: BTreeSet<u32> =
        names.iter().filter(|(_, name)| *name == "core::panicking::panic_fmt").map(|(address, _)| *address).collect();
    let may = |address: &u32| {
        let name = &names[address];
        PANICKING.iter().any(|part| name.starts_with(part)) || PANICKING_ELSEWHERE.contains(&name.as_str())
    };
    // A stub has the name of its target.
    let named: BTreeSet<&String> = found.iter().map(|address| &names[address]).collect();
    let stubs: Vec<u32> = names.iter().filter(|(_, name)| named.contains(name)).map(|(address, _)| *address).collect();
    found.extend(stubs);
    loop {
        let more: Vec<u32> = calls
            .iter()
            .filter(|call| found.contains(&call.to) && !found.contains(&call.from) && may(&call.from))
            .flat_map(|call| names.iter().filter(|(_, name)| **name == names[&call.from]).map(|(address, _)| *address))
            .collect();
        if more.is_empty() {
            return found;
        }
        found.extend(more);
    }
}

/// File and line of the instruction at `address`: of the innermost function that is not of `core`.
fn source<'a>(
    context: &Context<EndianSlice<'a, LittleEndian>>,
    address: u32,
) -> Result<(String, u32), addr2line::gimli::Error> {
    let mut frames = context.find_frames(address.into()).skip_all_loads()?;
    let mut last = ("?".to_owned(), 0);
    while let Some(frame) = frames.next()? {
        let Some(location) = frame.location else { continue };
        let file = location.file.unwrap_or("?");
        last = (short(file), location.line.unwrap_or(0));
        if !file.contains("/library/") && !file.starts_with("/rustc/") {
            break;
        }
    }
    Ok(last)
}

/// Without the folders of the machine that built it: of the project, of the registry, of what a build script has made, or
/// of the compiler.
fn short(file: &str) -> String {
    let behind = |mark: &str| file.split_once(mark).map(|(_, rest)| rest);
    let of_registry =
        || behind("/registry/src/").and_then(|rest| rest.split_once('/')).map(|(_, rest)| rest.to_owned());
    // `target/…/build/NAME-HASH/out/FILE`.
    let of_script = || {
        let (folder, name) = behind("/build/")?.split_once("/out/")?;
        Some(format!("{}/out/{name}", folder.rsplit_once('-')?.0))
    };
    let of_compiler = || Some(behind("/library/")?.to_owned());
    let found = of_script().or_else(of_registry).or_else(of_compiler);
    let mut parts: Vec<&str> = Vec::new();
    for part in found.as_deref().unwrap_or(file.trim_start_matches("/slitpose/")).split('/') {
        if part == ".." {
            parts.pop();
        } else {
            parts.push(part);
        }
    }
    parts.join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_has_the_same_name_wherever_it_was_built() {
        for (file, name) in [
            ("/slitpose/model/src/lib.rs", "model/src/lib.rs"),
            ("/cargo/registry/src/index.crates.io-1949/cobs-0.5.1/src/dec.rs", "cobs-0.5.1/src/dec.rs"),
            ("/cargo/registry/src/i/pac-21.0.0/src/chips/c/../../x/adc.rs", "pac-21.0.0/src/x/adc.rs"),
            (
                "/slitpose/target/firmware/t/build/embassy-stm32-eff5ac/out/_generated.rs",
                "embassy-stm32/out/_generated.rs",
            ),
            ("/rustc/5980/library/core/src/fmt/num.rs", "core/src/fmt/num.rs"),
        ] {
            assert_eq!(short(file), name);
        }
    }

    /// Encodings by LLVM 22's assembler (`llvm-mc -triple=thumbv7em -show-encoding`), relative to the address 0x1000.
    #[test]
    fn branches_go_where_an_assembler_says() {
        for (first, second, target) in [
            (0xf000, 0xf802, 0x1008),
            (0xf7ff, 0xfffe, 0x1000),
            (0xf000, 0xb802, 0x1008),
            (0xf7fe, 0xbffe, 0x0000),
            (0xf000, 0x8002, 0x1008),
            (0xf43f, 0xaffe, 0x1000),
        ] {
            assert_eq!(wide(0x1000, first, second), Some(target), "{first:x} {second:x}");
        }
        assert_eq!((narrow(0x1000, 0xe7fe), narrow(0x1000, 0xd002)), (Some(0x1000), Some(0x1008)));
        // UDF, SVC, `ldr`, `blx r0`, and a wide `mov`.
        assert_eq!([0xde00, 0xdf00, 0x4800, 0x4780].map(|code| narrow(0x1000, code)), [None; 4]);
        assert_eq!(wide(0x1000, 0xf04f, 0x0001), None);
    }
}
