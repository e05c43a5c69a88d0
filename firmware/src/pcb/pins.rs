//! The wiring table, `firmware/wiring.csv`: signals with their pins and contacts, supplies, solder bridges, and the
//! continuity check. The image has its pins from it, `slitpose doctor` names signals by it, and the tables of
//! `firmware/README.md` are its rows. Fields hold no commas, and lists of contacts have spaces between them.

const TABLE: &str = include_str!("../../wiring.csv");

/// A row of the table without its source; a field without a value is empty.
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
        let [name, pin, contact, arduino, function, note] = core::array::from_fn(|_| fields.next().unwrap_or(""));
        is_of_kind.then_some(Row { name, pin, contact, arduino, function, note })
    })
}

include!(concat!(env!("OUT_DIR"), "/wiring.rs"));

#[cfg(test)]
mod tests {
    use std::format;
    use std::string::String;
    use std::vec::Vec;

    const COLUMNS: [(&str, &[usize]); 4] = [
        ("signal", &[1, 2, 5, 3, 4, 6]),
        ("rail", &[1, 3, 6, 7]),
        ("bridge", &[1, 2, 3, 5, 6, 7]),
        ("check", &[1, 5, 6]),
    ];

    #[test]
    fn the_tables_of_the_page_are_the_rows_of_the_wiring_table() {
        let rows: Vec<Vec<&str>> = super::TABLE.lines().map(|line| line.split(',').collect()).collect();
        assert!(rows.iter().all(|row| row.len() == 8), "a field has a comma");
        for (kind, columns) in COLUMNS {
            let cells =
                |row: &Vec<&str>| columns.iter().map(|&column| format!("{} | ", row[column])).collect::<String>();
            let of_kind = rows.iter().filter(|row| row[0] == kind);
            let table: String = of_kind.map(|row| format!("| {}\n", cells(row).trim_end())).collect();
            let is_there = include_str!("../../README.md").contains(&format!("|\n{table}\n"));
            assert!(is_there, "firmware/README.md lacks this table:\n{table}");
        }
    }
}
