//! What documents, scenes and programs beside the image say, against numbers from outside the project.

use crate::common::pin;
use slitpose_emulator::facts::{self, number};
use slitpose_firmware::pcb::pins::{Row, rows};
use slitpose_head::scene_file::Shipped;
use std::path::Path;
use std::process::Command;

#[test]
fn the_wiring_table_has_the_pins_of_microcontroller_and_nucleo() {
    for Row { name: signal, pin, function, contact, arduino, .. } in rows("signal") {
        // Of the serial port's pins Zephyr and the schematic contradict each other; it needs no contact.
        let has_none = function.starts_with("LPUART1") && contact.is_empty();
        assert!(has_none || contact == facts::fact(&format!("morpho_{pin}")).value, "{signal}: {contact}");
        let name = facts::all().find(|fact| fact.name == format!("arduino_{pin}")).map_or("", |fact| fact.value);
        assert_eq!(arduino, name, "{signal}");
        if let Some((converter, input)) = function.split_once("_IN") {
            assert_eq!(input, facts::fact(&format!("{converter}_IN_{pin}")).value, "{signal}");
        }
        let of_pin = facts::all().find(|fact| fact.unit == "pin" && fact.name == function);
        assert!(of_pin.is_none_or(|fact| fact.value == pin), "{signal}");
    }
    assert_eq!(pin("light LD2"), facts::fact("LD2").value);
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
