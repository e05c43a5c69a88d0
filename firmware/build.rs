//! Tells the linker how to lay out an image for the board, and gives it the pins of the wiring table.

use std::path::Path;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=wiring.csv");
    let table = include_str!("wiring.csv");
    let out = std::env::var("OUT_DIR").expect("cargo names it");
    std::fs::write(Path::new(&out).join("wiring.rs"), wiring(table)).expect("a folder to write to");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    // No page alignment between sections: flash addresses are file offsets of their own.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    let has_ccm = std::env::var_os("CARGO_FEATURE_POSE").is_some();
    // Ahead of the runtime's script: the first to name a part of the code has it.
    println!("cargo:rustc-link-search={}", env!("CARGO_MANIFEST_DIR"));
    println!("cargo:rerun-if-changed=memory.x");
    for script in has_ccm.then_some("ccm.x").into_iter().chain(["image.x", "stack.x"]) {
        println!("cargo:rerun-if-changed={script}");
        println!("cargo:rustc-link-arg-bins=-T{}/{script}", env!("CARGO_MANIFEST_DIR"));
    }
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    if std::env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
}

/// What the image takes from the wiring table: the pin of each signal, the converters' inputs, the number of the first gate.
fn wiring(table: &str) -> String {
    let signals: Vec<Vec<&str>> =
        table.lines().map(|row| row.split(',').collect()).filter(|row: &Vec<_>| row[0] == "signal").collect();
    let arm = |row: &Vec<&str>| {
        let name = row[1].to_lowercase().replace(' ', "_").replace('\'', "");
        format!("($pins:ident.{name}) => {{{{ $pins.{} }}}};", row[2])
    };
    let inputs = ["ADC1_IN", "ADC2_IN"]
        .map(|adc| signals.iter().filter_map(|row| row[5].strip_prefix(adc)).collect::<Vec<_>>().join(","));
    let first_gate = signals.iter().find_map(|row| row[2].strip_prefix("PC").filter(|_| row[1] == "gate of emitter 0"));
    format!(
        "/// The pin of a signal of the wiring table, `pin!(p.gate_of_emitter_0)`.\n#[macro_export]\n\
         macro_rules! pin {{ {} }}\n\
         /// Inputs of ADC1 and ADC2 by cell: I_X1 and I_X2.\n\
         pub const ADC_INPUTS: [[u8; 6]; 2] = [[{}], [{}]];\n\
         /// Number of the first gate's pin, on port C; the others follow it.\n\
         pub const FIRST_GATE: u32 = {};\n",
        signals.iter().map(arm).collect::<String>(),
        inputs[0],
        inputs[1],
        first_gate.expect("a gate on port C")
    )
}
