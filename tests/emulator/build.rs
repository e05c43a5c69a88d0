//! Makes constants of the numbers in the table of facts: `USART_CR1_UE` becomes `USART::CR1_UE`, the offset
//! `USART_TypeDef.CR1` becomes `USART::CR1`, `LSI` becomes `one_word::LSI`; whole ones are `u32`, others `f64`.

use std::collections::BTreeMap;
use std::fmt::Write;

const TABLE: &str = "../data/stm32g474/facts.csv";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed={TABLE}");
    let table = std::fs::read_to_string(TABLE)?;
    let mut units: BTreeMap<String, String> = BTreeMap::new();
    for row in table.lines() {
        let mut fields = row.split(',');
        let (Some(name), Some(value)) = (fields.next(), fields.next()) else { continue };
        let name = name.replace("_TypeDef.", "_");
        let is_name = name.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
        let is_whole = value.starts_with("0x") || value.parse::<u32>().is_ok();
        let kind = if is_whole { "u32" } else { "f64" };
        if is_name && (is_whole || value.parse::<f64>().is_ok()) {
            let (unit, name) = name.split_once('_').unwrap_or(("one_word", &name));
            let mark = if name.starts_with(|letter: char| letter.is_ascii_digit()) { "_" } else { "" };
            writeln!(units.entry(unit.to_owned()).or_default(), "    pub const {mark}{name}: {kind} = {value};")?;
        }
    }
    let modules: String = units.iter().map(|(unit, numbers)| format!("pub mod {unit} {{\n{numbers}}}\n")).collect();
    let folder = std::env::var("OUT_DIR")?;
    Ok(std::fs::write(std::path::Path::new(&folder).join("st.rs"), modules)?)
}
