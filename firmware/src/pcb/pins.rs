//! The wiring table, `firmware/wiring.csv`: signals with their pins and contacts, supplies, solder bridges, and the
//! continuity check. The image takes its inputs from it and does not compile with a pin elsewhere; `slitpose doctor`
//! names signals by it; the tables of `firmware/README.md` are its rows.
//!
//! Fields hold no commas, and lists of contacts have spaces between them.

use super::wiring::CHANNELS;

const TABLE: &str = include_str!("../../wiring.csv");

/// A row of the table, field by field; a field without a value is empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row {
    /// The signal, supply or solder bridge; for a `check`, what is measured.
    pub name: &'static str,
    /// Pin of the MCU, such as `PA0`.
    pub pin: &'static str,
    /// Contacts on the Nucleo's connectors; for a solder bridge, what it joins the pin with.
    pub contact: &'static str,
    /// Arduino name of the contact.
    pub arduino: &'static str,
    /// Peripheral and channel, such as `ADC1_IN1`; for a solder bridge or a check, the state that is needed.
    pub function: &'static str,
    /// What a user must know; for a check, what it means if it fails.
    pub note: &'static str,
    /// Where it was found, and for which revision of the Nucleo.
    pub source: &'static str,
}

/// The rows of `kind`, in their order: `signal`, `rail`, `bridge` or `check`.
///
/// ```
/// use slitpose_firmware::pcb::pins::rows;
///
/// let trigger = rows("signal").find(|row| row.name == "trigger input").unwrap();
/// assert_eq!((trigger.pin, trigger.contact, trigger.function), ("PC12", "CN7-3", "TIM5_CH2"));
/// ```
pub fn rows(kind: &str) -> impl Iterator<Item = Row> {
    TABLE.lines().filter_map(move |line| {
        let mut fields = line.split(',');
        let is_of_kind = fields.next() == Some(kind);
        let [name, pin, contact, arduino, function, note, source] =
            core::array::from_fn(|_| fields.next().unwrap_or(""));
        is_of_kind.then_some(Row { name, pin, contact, arduino, function, note, source })
    })
}

/// Columns of the table, counted from 0.
const NAME: usize = 1;
const PIN: usize = 2;
const FUNCTION: usize = 5;

/// Inputs of the converters by rank (DS12288, ADC channels): I_X1 of each cell on ADC1, I_X2 on ADC2.
pub const ADC_INPUTS: [[u8; CHANNELS as usize]; 2] = {
    let mut inputs = [[0; CHANNELS as usize]; 2];
    let signals = [["I_X1 of cell 0", "ADC1_IN"], ["I_X2 of cell 0", "ADC2_IN"]];
    let mut converter = 0;
    while converter < 2 {
        let [first, function] = signals[converter];
        let mut cell = 0;
        while cell < CHANNELS as usize {
            inputs[converter][cell] = number_behind(function, field(first, cell, FUNCTION));
            cell += 1;
        }
        converter += 1;
    }
    inputs
};

/// Number of the pin of the first gate, on port C; the others follow it.
pub const FIRST_GATE: u32 = number_behind("PC", field("gate of emitter 0", 0, PIN)) as u32;

/// Whether the table has `signal` at `pin`.
///
/// # Panics
/// If the table has no such signal.
pub const fn is_at(signal: &str, pin: &str) -> bool {
    let found = field(signal, 0, PIN);
    starts_with(found, pin) && found.len() == pin.len()
}

/// The field in `column` of the row that comes `after` rows behind the one called `name`.
const fn field(name: &str, after: usize, column: usize) -> &'static str {
    let bytes = TABLE.as_bytes();
    let (mut at, mut start, mut index, mut behind) = (0, 0, 0, None);
    while at < bytes.len() {
        if bytes[at] == b',' || bytes[at] == b'\n' {
            let value = TABLE.split_at(at).0.split_at(start).1;
            if index == NAME && value.len() == name.len() && starts_with(value, name) {
                behind = Some(0);
            }
            if let Some(rows) = behind
                && rows == after
                && index == column
            {
                return value;
            }
            index += 1;
            if bytes[at] == b'\n' {
                index = 0;
                behind = match behind {
                    Some(rows) => Some(rows + 1),
                    None => None,
                };
            }
            start = at + 1;
        }
        at += 1;
    }
    panic!("firmware/wiring.csv has no such signal")
}

const fn starts_with(text: &str, start: &str) -> bool {
    let mut at = 0;
    while at < start.len() && at < text.len() && text.as_bytes()[at] == start.as_bytes()[at] {
        at += 1;
    }
    at == start.len()
}

/// The number behind `start` in `text`.
const fn number_behind(start: &str, text: &str) -> u8 {
    assert!(starts_with(text, start), "a row of firmware/wiring.csv is out of its place");
    let (mut at, mut number) = (start.len(), 0);
    while at < text.len() {
        number = 10 * number + (text.as_bytes()[at] - b'0');
        at += 1;
    }
    number
}

#[cfg(test)]
mod tests {
    use std::format;
    use std::string::String;

    use super::*;

    #[test]
    fn the_tables_of_the_page_are_the_rows_of_the_wiring_table() {
        let page = include_str!("../../README.md");
        let cells = |row: Row, kind: &str| match kind {
            "signal" => format!(
                "{} | {} | {} | {} | {} | {}",
                row.name, row.pin, row.function, row.contact, row.arduino, row.note
            ),
            "rail" => format!("{} | {} | {} | {}", row.name, row.contact, row.note, row.source),
            "bridge" => format!(
                "{} | {} and {} | {} | {} | {}",
                row.name, row.pin, row.contact, row.function, row.note, row.source
            ),
            _ => format!("{} | {} | {}", row.name, row.function, row.note),
        };
        for kind in ["signal", "rail", "bridge", "check"] {
            let table = rows(kind).fold(String::new(), |table, row| table + "| " + &cells(row, kind) + " |\n");
            assert!(page.contains(&format!("|\n{table}\n")), "firmware/README.md lacks this table:\n{table}");
        }
        assert!(TABLE.lines().all(|line| line.split(',').count() == 8), "a field has a comma");
        assert_eq!(
            ["signal", "rail", "bridge", "check"].map(|kind| rows(kind).count()).iter().sum::<usize>() + 1,
            TABLE.lines().count()
        );
    }

    #[test]
    fn constants_of_the_image_are_those_of_the_rows() {
        for (converter, inputs) in ADC_INPUTS.iter().enumerate() {
            for (cell, input) in inputs.iter().enumerate() {
                let name = format!("I_X{} of cell {cell}", converter + 1);
                let row = rows("signal").find(|row| row.name == name).expect("a row");
                assert_eq!(row.function, format!("ADC{}_IN{input}", converter + 1), "{name}");
            }
        }
        assert!(rows("signal").all(|row| is_at(row.name, row.pin) && !is_at(row.name, "PD2")));
        assert_eq!(FIRST_GATE, 6);
    }
}
