//! What documents, scenes and programs beside the image say, against numbers from outside the project; the table of those
//! numbers that readers want (`tests/data/stm32g474/README.md`); and `firmware/PANICS.md` against the machine code of the images.
//!
//! The images could panic at no place that it does not give a reason for: every call that ends in the panic handler, with the
//! source of it. What the compiler could prove away is not there, so this is what is left. A direct call is an instruction with
//! the address in it; functions that do nothing but panic are followed until they reach the handler, so that a bounds check or
//! an `expect` counts where it stands, and not in `core`. Debug information, inlined calls included, says where that is.

use crate::common::{Wire, pin, wires};
use addr2line::Context;
use addr2line::gimli::{Dwarf, EndianSlice, LittleEndian, SectionId};
use object::read::elf::ElfFile32;
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SectionFlags, SymbolKind, elf};
use slitpose_emulator::cpu::direct_branch;
use slitpose_emulator::facts::{self, number};
use slitpose_emulator::rig::built_files;
use slitpose_head::scene_file::Shipped;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

#[test]
fn the_wiring_table_has_the_pins_of_microcontroller_and_nucleo() {
    for Wire { signal, pin, function, morpho, arduino } in wires() {
        assert_eq!(morpho, facts::fact(&format!("morpho_{pin}")).value, "{signal}");
        let contact = facts::all().find(|fact| fact.name == format!("arduino_{pin}")).map_or("", |fact| fact.value);
        assert_eq!(arduino, contact, "{signal}");
        if let Some((converter, input)) = function.split_once("_IN") {
            assert_eq!(input, facts::fact(&format!("{converter}_IN_{pin}")).value, "{signal}");
        }
        let of_pin = ["DAC1_OUT1", "DAC2_OUT1", "USB_DM", "USB_DP"].into_iter().find(|name| function.starts_with(name));
        assert!(of_pin.is_none_or(|name| facts::fact(name).value == pin), "{signal}");
    }
    let serial = wires().into_iter().filter(|wire| wire.function.starts_with("LPUART1"));
    let serial: Vec<_> = serial.map(|wire| wire.pin).collect();
    assert_eq!(serial, ["LPUART1_TX", "LPUART1_RX"].map(|name| facts::fact(name).value));
    assert_eq!(pin("light LD2"), facts::fact("LD2").value);
    assert_eq!(pin("poses to a motor controller"), facts::fact("USART1_TX").value);
}

#[test]
fn detectors_are_those_of_the_data_sheet() {
    for name in ["base", "wide"] {
        let file = Shipped::named(name).expect("shipped").read().expect("valid");
        for cell in &file.scene.cells {
            assert_eq!(cell.detector.interelectrode_ohm, Some(1e3 * number("S3932_R_ie")), "{name}");
        }
    }
    let firmware = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware");
    let program = std::fs::read_to_string(firmware.join("analogue")).expect("the program");
    assert!(program.contains(&format!("R_IE = {:.0}e3 ", number("S3932_R_ie"))));
    let page = std::fs::read_to_string(firmware.join("README.md")).expect("the page");
    let [capacitance, error] = ["C_t", "position_error"].map(|name| number(&format!("S3932_{name}")));
    assert!(page.contains(&format!("{:.0} kΩ · {capacitance:.0} pF / π²", number("S3932_R_ie"))));
    assert!(page.contains(&format!("typically {error:.0} µm (S3932)")));
    assert!(page.contains(&format!("onto {} pF", number("C_ADC"))), "the converters' own capacitor");
    assert!(page.contains(&format!("{:.1} µs / 2.2", number("S3932_t_r"))));
    let ranges = [["R_ie_least", "R_ie", "R_ie_most"], ["position_error", "position_error", "position_error_most"]];
    for range in ranges {
        assert!(range.map(|name| number(&format!("S3932_{name}"))).is_sorted());
    }
}

/// Whether `name` is the fact that `pattern` means, in which `*` and `?` stand for anything.
fn means(pattern: &str, name: &str) -> bool {
    let mut parts = pattern.split(['*', '?']);
    let first = parts.next().expect("a pattern");
    let Some(mut rest) = name.strip_prefix(first) else { return false };
    let Some(last) = parts.next_back() else { return rest.is_empty() };
    for part in parts {
        match rest.find(part) {
            Some(at) => rest = &rest[at + part.len()..],
            None => return false,
        }
    }
    rest.ends_with(last)
}

/// The table that readers want stays the table that tests use.
#[test]
fn the_readers_table_names_every_fact_and_tests_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let page = std::fs::read_to_string(root.join("tests/data/stm32g474/README.md")).expect("the page");
    let table = page.split_once("| fact | source |").expect("the table").1;
    let rows: Vec<Vec<&str>> = table
        .lines()
        .skip(2)
        .take_while(|row| row.starts_with('|'))
        .map(|row| row.trim_matches('|').split('|').map(str::trim).collect())
        .collect();
    let code = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    let patterns: Vec<_> = rows.iter().flat_map(|row| code(row[0])).collect();
    for fact in facts::all() {
        assert!(patterns.iter().any(|pattern| means(pattern, fact.name)), "no row for `{}`", fact.name);
    }
    for pattern in &patterns {
        assert!(facts::all().any(|fact| means(pattern, fact.name)), "no fact for `{pattern}`");
    }
    let of_headers = facts::all().filter(|fact| !fact.source.contains(' ') || fact.source.starts_with("HAL "));
    let of_headers = of_headers.filter(|fact| fact.source.contains(':') && !fact.source.contains([';', '('])).count();
    let share = format!("{of_headers} of {}", facts::all().count());
    assert!(page.contains(&share), "rows that check.py compares: {share}");
    for row in &rows {
        let [_, source, image, emulator, test] = row[..] else { panic!("{row:?}") };
        assert!([source, image, emulator, test].iter().all(|cell| !cell.is_empty()), "{row:?}");
        for (cell, folders) in [
            (
                image,
                &[
                    "firmware/src/bin/slitpose-board",
                    "firmware/src/pcb",
                    "firmware/src",
                    "firmware",
                    "host/head/scenes",
                ][..],
            ),
            (emulator, &["tests/emulator/src", "tests/emulator/src/peripherals"]),
        ] {
            for file in code(cell) {
                assert!(folders.iter().any(|folder| root.join(folder).join(&file).exists()), "`{file}` of {row:?}");
            }
        }
        for test in code(test) {
            let (file, name) = test.split_once("::").expect("file and test");
            let folders = ["tests/emulator/tests/testsuite", "tests/emulator/src/peripherals", "tests/emulator/src"];
            let mut sources =
                folders.iter().filter_map(|folder| std::fs::read_to_string(root.join(folder).join(file)).ok());
            assert!(sources.any(|source| source.contains(&format!("fn {name}("))), "`{test}` of {row:?}");
        }
    }
}

#[test]
fn the_tables_of_the_analogue_front_end_are_those_of_the_program() {
    let firmware = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware");
    let printed = Command::new("python3").arg(firmware.join("analogue")).output().expect("python3 runs");
    assert!(printed.status.success(), "{}", String::from_utf8_lossy(&printed.stderr));
    let printed = String::from_utf8(printed.stdout).expect("UTF-8");
    let page = std::fs::read_to_string(firmware.join("README.md")).expect("the page");
    let rows: Vec<&str> = printed.lines().filter(|line| line.starts_with('|')).collect();
    assert!(rows.len() > 20, "{printed}");
    for row in rows {
        assert!(page.lines().any(|line| line == row), "firmware/README.md lacks: {row}");
    }
}

#[test]
fn every_panic_that_the_images_could_reach_has_its_reason() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware/PANICS.md");
    let page = std::fs::read_to_string(page).expect("the page");
    let mut listed = BTreeMap::new();
    for row in page.lines().filter_map(|line| line.strip_prefix("| `")) {
        let columns: Vec<&str> = row.trim_end_matches(" |").split(" | ").collect();
        let [file, count, reason] = columns[..] else { panic!("three columns: {row}") };
        assert!(reason.len() > 5, "{file} has no reason");
        listed.insert(file.trim_end_matches('`').to_owned(), count.parse::<usize>().expect("a number"));
    }
    let images = built_files().unwrap_or_else(|error| panic!("{error}"));
    for file in &images {
        let mut found: BTreeMap<&str, Vec<_>> = BTreeMap::new();
        let sites = sites(file);
        // The bounds checks of the outbox's ring at the least.
        assert!(sites.len() > 20, "{sites:?}");
        sites.iter().for_each(|site| println!("{}:{} {}", site.file, site.line, site.kind));
        sites.iter().for_each(|site| found.entry(&site.file).or_default().push((site.line, &site.kind)));
        for (file, sites) in found {
            let most = listed.get(file).copied().unwrap_or(0);
            assert!(
                sites.len() <= most,
                "{file} could panic in {} places, and firmware/PANICS.md has reasons for {most}: say why, or do without: {sites:?}",
                sites.len()
            );
        }
    }
}

/// A place in the source from which the panic handler can be reached.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Site {
    /// The file, from the project's folder, or `CRATE-VERSION/src/…` of a dependency; that of the innermost inlined
    /// function outside `core`.
    file: String,
    line: u32,
    /// What is called there, such as `panic_bounds_check`.
    kind: String,
}

/// Parts of `core` whose functions may do nothing but panic.
const PANICKING: [&str; 6] =
    ["core::panicking::", "core::option::", "core::result::", "core::slice::", "core::cell::", "core::num::"];

/// The same of a dependency.
const PANICKING_ELSEWHERE: [&str; 1] = ["arrayvec::arrayvec::extend_panic"];

/// What a linker calls a stub that only jumps to a function too far away.
const STUB: &str = "__Thumbv7ABSLongThunk_";

/// All of them, once each, in order.
fn sites(file: &[u8]) -> BTreeSet<Site> {
    let elf = ElfFile32::<Endianness>::parse(file).expect("an ELF file of 32 bits");
    let names = functions(&elf);
    let calls = calls(&elf, &names);
    let panicking = panicking(&names, &calls);
    let section = |id: SectionId| -> Result<_, addr2line::gimli::Error> {
        let data = elf.section_by_name(id.name()).and_then(|section| section.data().ok()).unwrap_or_default();
        Ok(EndianSlice::new(data, LittleEndian))
    };
    let context = Context::from_dwarf(Dwarf::load(section).expect("sections")).expect("debug information");
    let calls = calls.iter().filter(|call| panicking.contains(&call.to) && !panicking.contains(&call.from));
    calls
        .map(|call| {
            let (file, line) = source(&context, call.at).expect("debug information");
            let name = &names[&call.to];
            Site { file, line, kind: name.rsplit("::").next().unwrap_or(name).to_owned() }
        })
        .collect()
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
            let (bytes, target) = direct_branch(at, first, half(at + 2).unwrap_or(0));
            let from = names.range(..=at).next_back().map(|(address, _)| *address);
            if let (Some(to), Some(from)) = (target, from)
                && names.contains_key(&to)
                && to != from
            {
                calls.push(Call { at, from, to });
            }
            at += bytes;
        }
    }
    calls
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
